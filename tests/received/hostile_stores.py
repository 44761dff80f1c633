"""Trial stores that somebody has made to harm the reader: other tables, wrong types in every column, and bombs."""

import shutil
import sqlite3
import zlib
from contextlib import closing

from received.box import Case, each_of
from received.hostile_configs import pickled

FILE = "trials.sqlite"
ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT x"


def altered(box, statements, *, rows=(), name="plain"):
    """Copy honest results and execute SQL on the store; `rows` are statements with their values."""
    place = box.here / name
    shutil.rmtree(place, ignore_errors=True)
    box.results(name)
    with closing(sqlite3.connect(place / FILE)) as connection:
        connection.create_function("evil", -1, lambda *_: 1, deterministic=True)
        connection.executescript(statements)
        for statement, values in rows:
            connection.execute(statement, values)
        connection.commit()
    return place


def _sql(statements, *, refused=True, verbs="report status compare pack show sites"):
    def cases(box):
        place = altered(box, statements.replace("OUTSIDE", str(box.outside)))
        yield from each_of(box, place, verbs, refused=("report", "compare", "show", "sites") if refused else ())

    return cases


def _view(table, columns, source):
    return f"ALTER TABLE {table} RENAME TO old_{table}; CREATE VIEW {table}({columns}) AS {source};"


SCHEMAS = {
    "view-endless": _view("chunks", "column, number, stored, data", f"{ENDLESS}, 0, NULL, zeroblob(100) FROM c"),
    "view-endless-meta": _view("meta", "key, value", f"{ENDLESS}, 'x' FROM c"),
    "view-endless-keys": _view("keys", "number, key", f"{ENDLESS}, 'x' || x FROM c"),
    "view-large": _view("arrays", "name, shape, data", "SELECT name, shape, zeroblob(900000000) FROM old_arrays"),
    "view-honest": _view("warnings", "method, first, stop, text, n", "SELECT * FROM old_warnings"),
    "view-of-a-file": "CREATE VIEW other AS SELECT * FROM pragma_database_list;",
    "trigger": "CREATE TRIGGER t AFTER INSERT ON meta BEGIN DELETE FROM chunks; END;",
    "trigger-endless": f"CREATE TRIGGER t BEFORE INSERT ON keys BEGIN SELECT count(x) FROM ({ENDLESS} FROM c); END;",
    "trigger-on-view": "CREATE VIEW v AS SELECT 1 AS a; CREATE TRIGGER t INSTEAD OF INSERT ON v BEGIN SELECT 1; END;",
    "virtual": "DROP TABLE held; CREATE VIRTUAL TABLE held USING fts5(method, run, n);",
    "virtual-beside": "CREATE VIRTUAL TABLE other USING rtree(id, a, b);",
    "generated": "DROP TABLE held; CREATE TABLE held (method, run, n AS (zeroblob(1000000000)));",
    "generated-beside": "ALTER TABLE held ADD COLUMN more AS (zeroblob(900000000));",
    "table-beside": "CREATE TABLE other (a); INSERT INTO other VALUES (1);",
    "column-beside": "ALTER TABLE chunks ADD COLUMN more;",
    "column-gone": "DROP TABLE traces; CREATE TABLE traces (method, signal, run, width);",
    "column-renamed": "ALTER TABLE chunks RENAME COLUMN data TO content;",
    "table-gone": "DROP TABLE chunks;",
    "index-on-expression": "CREATE INDEX i ON held (evil(n));",
    "index-partial": "CREATE INDEX i ON keys (key) WHERE evil(key);",
    "check": "DROP TABLE held; CREATE TABLE held (method, run, n CHECK (length(randomblob(900000000)) > 0));",
    "default": "DROP TABLE held; CREATE TABLE held (method, run, n DEFAULT (randomblob(900000000)));",
    "other-types": "DROP TABLE held; CREATE TABLE held (method TEXT, run TEXT, n TEXT);",
    "foreign-key": "DROP TABLE held; CREATE TABLE held (method REFERENCES keys ON DELETE CASCADE, run, n);",
    "temporary-name": 'CREATE TABLE "sqlite stat" (a);',
    "statistics": "ANALYZE; UPDATE sqlite_stat1 SET stat = '1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1';",
}
MAY = {"other-types", "statistics"}
"""Of no harm: the values are checked."""
HEADERS = {
    "application": ("PRAGMA application_id = 1;", True),
    "version-later": ("PRAGMA user_version = 2000000000;", True),
    "version-earlier": ("PRAGMA user_version = -1;", True),
    "journal-of-writes": ("PRAGMA journal_mode = WAL;", False),
    "schema-text": (
        "PRAGMA writable_schema = ON; UPDATE sqlite_master SET sql = 'CREATE TABLE held (' || hex(zeroblob(50000))"
        " || ')' WHERE name = 'held';",
        True,
    ),
    "schema-root": (
        "PRAGMA writable_schema = ON; UPDATE sqlite_master SET rootpage = (SELECT rootpage FROM sqlite_master"
        " WHERE name = 'meta') WHERE name = 'chunks';",
        True,
    ),
    "schema-root-far": (
        "PRAGMA writable_schema = ON; UPDATE sqlite_master SET rootpage = 2000000000 WHERE name = 'chunks';",
        True,
    ),
    "schema-type": ("PRAGMA writable_schema = ON; UPDATE sqlite_master SET type = 'view' WHERE name = 'chunks';", True),
}


def _beside(name, content, *, link=False):
    """A journal, or files of a log, of other databases beside the store."""

    def cases(box):
        place = box.results()
        given = content(box) if callable(content) else content
        if link:
            (place / name).symlink_to(given)
        else:
            (place / name).write_bytes(given)
        yield from each_of(box, place, "report status compare show")

    return cases


def _journal(box):
    """The journal of a transaction over two databases, which names a file of the reader to delete."""
    name = str(box.outside / "precious").encode()
    magic = bytes.fromhex("d9d505f920a163d7")
    total = sum(name) & 0xFFFFFFFF
    head = magic + bytes(4) + bytes(4) + (10).to_bytes(4, "big") + (512).to_bytes(4, "big") + (4096).to_bytes(4, "big")
    return head.ljust(512, b"\0") + name + len(name).to_bytes(4, "big") + total.to_bytes(4, "big") + magic


def _hot_journal(box):
    """The journal of a killed writer, whose pages are those of somebody else."""
    magic = bytes.fromhex("d9d505f920a163d7")
    head = magic + (1).to_bytes(4, "big") + bytes(4) + (1).to_bytes(4, "big") + (512).to_bytes(4, "big")
    page = b"SQLite format 3\0" + bytes(box.random.randbytes(4080))
    return (head + (4096).to_bytes(4, "big")).ljust(512, b"\0") + (1).to_bytes(4, "big") + page + bytes(4)


JOURNALS = {
    "of-two-databases": _beside(f"{FILE}-journal", _journal),
    "hot": _beside(f"{FILE}-journal", _hot_journal),
    "link": _beside(f"{FILE}-journal", lambda box: box.outside / "precious", link=True),
    "log": _beside(f"{FILE}-wal", lambda box: box.random.randbytes(10_000)),
    "shared-memory": _beside(f"{FILE}-shm", lambda box: box.outside / "ESC", link=True),
}


def _content(make):
    def cases(box):
        place = box.results()
        (place / FILE).write_bytes(make((place / FILE).read_bytes(), box))
        yield from each_of(box, place, "report status compare pack show sites")

    return cases


def _scattered(content, box):
    found = bytearray(content)
    for _ in range(300):
        found[box.random.randrange(100, len(found))] = box.random.randrange(256)
    return bytes(found)


BYTES = {
    "nothing": lambda content, box: b"",
    "cut": lambda content, box: content[: len(content) // 2],
    "text": lambda content, box: b"trials\n" * 1000,
    "pages": lambda content, box: content[:16] + b"\x02\x00" + content[18:],
    "scattered": _scattered,
    "zeros": lambda content, box: content[:100] + bytes(len(content) - 100),
    "encoding": lambda content, box: content[:56] + b"\0\0\0\2" + content[60:],
    "format": lambda content, box: content[:18] + b"\x09\x09" + content[20:],
}
COLUMNS = {
    "meta": ("key", "value"),
    "keys": ("number", "key"),
    "methods": ("method", "definition", "code"),
    "columns": ("number", "kind", "owner", "name"),
    "chunks": ("column", "number", "stored", "data"),
    "traces": ("method", "signal", "run", "width", "data"),
    "ensemble_groups": ("method", "first", "stop", "n", "width", "mean", "second"),
    "arrays": ("name", "shape", "data"),
    "failures": ("method", "run", "failure"),
    "held": ("method", "run", "n"),
    "warnings": ("method", "first", "stop", "text", "n"),
    "durations": ("method", "first", "stop", "phase", "largest", "counts"),
    "failed_steps": ("method", "run", "status", "n"),
}
"""Every column of every table; a test compares them with those of a new store."""
ROWS = {
    "failures": (1, 0, '{"component": "estimator", "k": 1, "type": "E", "message": "m", "trace": ""}'),
    "held": (1, 0, 1),
    "warnings": (1, 0, 4, "a warning", 1),
    "failed_steps": (1, 0, 1, 1),
}
"""Rows of tables that are empty in honest results."""
WRONG = (
    *(-1, -(2**63), 2**62, 2**31, 0.5, 1e308, float("inf"), "", "abc", "-1", "[[[[", "{}", "null", "[1e999]"),
    *(b"", b"\0", b"\xff\xfe\xff", b"\x80" * 8, "\x1b]0;pwn\x07", "a\u202eb", "x" * 200_000, "../../ESC", "a\0b"),
)
"""Values of other types and sizes, and of the right type with other texts."""


def _columns(table):
    """One value after the other of a table is wrong."""

    def cases(box):
        for column in COLUMNS[table]:
            yield from _with_value(box, table, column, box.random.choice(WRONG))

    return cases


def _with_value(box, table, column, value):
    rows = []
    if table in ROWS:
        marks = ", ".join("?" * len(ROWS[table]))
        rows.append((f"INSERT OR REPLACE INTO {table} VALUES ({marks})", ROWS[table]))
    first = f"(SELECT {COLUMNS[table][0]} FROM {table} LIMIT 1)"
    where = f"{COLUMNS[table][0]} = {first}" if table in ("meta", "keys", "methods", "columns", "arrays") else "1"
    rows.append((f"UPDATE OR REPLACE {table} SET {column} = ? WHERE {where}", (value,)))
    try:
        place = altered(box, "", rows=rows)
    except (sqlite3.Error, OverflowError):
        return  # the column takes no such value
    note = f"{table}.{column} = {str(value)[:30]!r}"
    verbs = "compare show pack report" if box.random.random() < 0.2 else "compare show"
    yield from each_of(box, place, verbs, note=note)


def _bomb(table, column, make):
    def cases(box):
        place = altered(box, "", rows=[(f"UPDATE {table} SET {column} = ?", (make(box),))])
        yield from each_of(box, place, "report compare show pack")

    return cases


BOMBS = {
    "zlib-chunks": _bomb("chunks", "data", lambda box: zlib.compress(bytes(1_000_000_000))),
    "zlib-stored": _bomb("chunks", "stored", lambda box: zlib.compress(bytes(1_000_000_000))),
    "zlib-arrays": _bomb("arrays", "data", lambda box: zlib.compress(bytes(1_000_000_000))),
    "shape": _bomb("arrays", "shape", lambda box: "[1000000000, 1000000000]"),
    "shape-deep": _bomb("arrays", "shape", lambda box: "[" * 200_000),
    "zlib-moments": _bomb("ensemble_groups", "mean", lambda box: zlib.compress(bytes(1_000_000_000))),
    "width": _bomb("traces", "width", lambda box: 2**40),
    "chunk-far": _bomb("chunks", "number", lambda box: 2**40),
    "text": _bomb("methods", "code", lambda box: "[" * 5_000_000),
    "pickle-chunks": _bomb("chunks", "data", pickled),
    "pickle-arrays": _bomb("arrays", "data", lambda box: zlib.compress(pickled(box))),
    "pickle-traces": _bomb("traces", "data", pickled),
}


def _many_rows(box):
    """A million rows of a table that has a few."""
    rows = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c WHERE x < 1000000)"
    place = altered(box, f"{rows} INSERT INTO warnings SELECT 1, x, x + 1, 'w' || x, 1 FROM c;")
    yield from each_of(box, place, "compare report")


CASES = [
    *(Case("store-schema", name, _sql(text, refused=name not in MAY)) for name, text in SCHEMAS.items()),
    *(Case("store-schema", name, _sql(text, refused=refused)) for name, (text, refused) in HEADERS.items()),
    *(Case("store-journal", name, make) for name, make in JOURNALS.items()),
    *(Case("store-bytes", name, _content(make)) for name, make in BYTES.items()),
    *(Case("store-column", table, _columns(table)) for table in COLUMNS),
    *(Case("store-bomb", name, make) for name, make in BOMBS.items()),
    Case("store-bomb", "rows", _many_rows),
]
