"""trials.sqlite of somebody else: other tables, wrong types and bombs are one sentence and exit code 2."""

import json
import shutil
import sqlite3
import time
import zlib
from contextlib import closing

import numpy as np
import pytest
from small_experiment import cli, ran, write

from rmpc_bench import load_results
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.received.store import FILE, SCHEMA, MissingError, WriteError
from rmpc_bench.store.store import Store

KEYS = {"record": "{runs: 2}", "evaluate": "[runs, ensemble]"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the directory of a small experiment with rows in most tables."""
    place = tmp_path_factory.mktemp("made")
    ran(write(place, **KEYS), place / "out")
    with closing(sqlite3.connect(place / "out" / FILE)) as connection, connection:
        connection.execute("INSERT INTO held VALUES (1, 0, 3)")
        connection.execute("INSERT INTO warnings VALUES (1, 0, 6, 'slow', 2)")
        connection.execute("INSERT INTO failed_steps VALUES (1, 0, 3, 1)")
        # Durations of a block in which something was compiled are not stored.
        connection.execute("INSERT OR REPLACE INTO durations VALUES (1, 0, 6, 'step', 1e-3, '[[5, 6]]')")
        failure = {"run": 0, "status": 3, "component": "plant", "k": 1, "message": "\u001b[31mred"}
        connection.execute("INSERT INTO failures VALUES (1, 0, ?)", (json.dumps(failure),))
    assert load_results(place / "out").trials.notes["S-MPC"]
    return place / "out"


@pytest.fixture
def place(made, tmp_path):
    """Return a copy of it."""
    shutil.copytree(made, tmp_path / "out")
    return tmp_path / "out"


def changed(place, *statements, **texts):
    """Execute statements in a store, without the checks of SQLite."""
    with closing(sqlite3.connect(place / FILE, isolation_level=None)) as connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        connection.execute("PRAGMA writable_schema = ON")
        for statement in statements:
            connection.execute(statement, texts if ":" in statement else {})


def refused(place, *said):
    """Check that `report` says in one sentence what is wrong."""
    start = time.process_time()
    result = cli("report", place, "--to", place.parent / "to")
    assert result.exit_code == 2, result.output
    assert FILE in result.stderr and all(each in result.stderr for each in said), result.stderr
    assert len(result.stderr) < 1000 and time.process_time() - start < 8
    assert not (place.parent / "to").exists()


RECURSIVE = (
    "WITH RECURSIVE a(key, value) AS (SELECT 'a', 'b' UNION ALL SELECT key || 'a', value FROM a) SELECT * FROM a"
)


@pytest.mark.parametrize(
    "statements",
    [
        ("DROP TABLE meta", f"CREATE VIEW meta AS {RECURSIVE}"),
        ("CREATE VIEW other AS SELECT 1",),
        ("CREATE TRIGGER t AFTER INSERT ON meta BEGIN DELETE FROM keys; END",),
        ("CREATE TABLE other (a)",),
        ("CREATE INDEX i ON held (n)",),
        ("ALTER TABLE held ADD COLUMN m INTEGER",),
        ("ALTER TABLE meta ADD COLUMN m TEXT GENERATED ALWAYS AS (hex(zeroblob(100000000)))",),
        ("CREATE VIRTUAL TABLE other USING fts5(a)",),
        ("DROP TABLE held", "CREATE VIRTUAL TABLE held USING fts5(method, run, n)"),
        ("DROP TABLE warnings",),
        ("UPDATE sqlite_master SET sql = replace(sql, 'value TEXT', 'value TEXT DEFAULT 1') WHERE name = 'meta'",),
    ],
)
def test_other_tables_than_those_of_a_store(place, statements):
    """Views, triggers, indices, generated columns and virtual tables are refused before any row is read."""
    changed(place, *statements)
    refused(place)


def test_a_store_of_an_earlier_writer(place):
    """It has no table `failed_steps` and stays readable; a writer adds the table."""
    changed(place, "DROP TABLE failed_steps")
    assert cli("report", place).exit_code == 0
    with Store(place) as store:
        assert store.failed_steps("m", 10) == {}
    with closing(sqlite3.connect(place / FILE)) as connection:
        assert connection.execute("SELECT count(*) FROM failed_steps").fetchall() == [(0,)]


def columns():
    """Yield table and column of every column of a store."""
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.executescript(SCHEMA)
        tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        for table in tables:
            yield from ((table, row[1]) for row in connection.execute(f"PRAGMA table_info({table})"))


@pytest.mark.parametrize("where", [*columns()], ids=".".join)
def test_wrong_values_in_every_column(made, tmp_path, where):
    """Results, or a sentence; no other exception."""
    table, column = where
    values = ("-1", "2000000000", "9223372036854775807", "'abc'", "x'00ff'", "1e308", "9e999", "0", "zeroblob(1000000)")
    for value in values:
        shutil.copy(made / FILE, tmp_path / FILE)
        try:
            changed(tmp_path, f"UPDATE OR REPLACE {table} SET {column} = {value}")
            load_results(tmp_path)
        except sqlite3.IntegrityError:
            continue
        except (MissingError, StoreError, WriteError) as error:
            assert FILE in str(error) or str(tmp_path) in str(error)
            assert len(str(error)) < 1000


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("UPDATE chunks SET number = -1 WHERE number = 0", "chunks.chunk must be a whole number"),
        ("UPDATE held SET n = 'abc'", "held.n must be a whole number"),
        ("UPDATE methods SET code = x'00'", "methods.code must be text"),
        ("UPDATE durations SET largest = 9e999", "durations.largest must be a number"),
        ("UPDATE durations SET counts = '[[1, 2, 3]]'", "the store is damaged"),
        ("UPDATE traces SET width = 7", "the store is damaged"),
        ("UPDATE traces SET width = 4611686018427387904", "traces.width must be a whole number"),
        ("UPDATE ensemble_groups SET first = -1", "ensemble_groups.first must be a whole number"),
        ("UPDATE arrays SET shape = '[-1]'", "arrays.shape must be a list of sizes"),
        ("UPDATE arrays SET shape = '[1, 1]'", "arrays.data has not the 8 bytes"),
    ],
)
def test_values_that_the_message_names(place, statement, said):
    """The table, the column and the value."""
    changed(place, statement)
    refused(place, said)


@pytest.mark.parametrize("shape", ["[125000000]", "[24000000]", "[" * 90, "[1e9]", "[100000, 100000]"])
def test_a_compressed_bomb(place, shape):
    """Not unpacked beyond what the shape says, and a shape says no more than the file may have."""
    compressor = zlib.compressobj(9)
    data = b"".join(compressor.compress(bytes(10**7)) for _ in range(30)) + compressor.flush()
    with closing(sqlite3.connect(place / FILE)) as connection, connection:
        connection.execute("UPDATE arrays SET shape = ?, data = ?", (shape, data))
    refused(place, "arrays.")


def edited(place, path, value):
    """Set a value of the stored layout."""
    with closing(sqlite3.connect(place / FILE)) as connection, connection:
        [(text,)] = connection.execute("SELECT value FROM meta WHERE key = 'layout'").fetchall()
        data = at = json.loads(text)
        for key in path[:-1]:
            at = at[key]
        at[path[-1]] = value
        connection.execute("UPDATE meta SET value = ? WHERE key = 'layout'", (json.dumps(data),))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("name",), "../../ESC"),
        (("name",), "/tmp/ESC"),
        (("name",), ".."),
        (("paper",), "../ESC"),
        (("title",), "a\u202eb"),
        (("baseline",), "nobody"),
        (("primary",), "nothing"),
        (("n_runs",), -1),
        (("n_runs",), 10**12),
        (("points",), []),
        (("points", 0, "methods"), {}),
        (("points", 0, "methods", "\u001b]0;pwn\u0007"), {"definition": "a", "code": {"numerics": 1}}),
        (("points", 0, "title"), "\u009b31m"),
        (("points", 0, "n_recorded"), -2),
        (("points", 0, "Ts"), -1.0),
        (("report", "order"), ["nobody"]),
        (("axes",), [["a.b"]]),
        (("figures",), [{"metric": "mse"}]),
        (("figures",), [{"kind": ["boxplot"]}]),
    ],
)
def test_layouts_that_no_configuration_has(place, path, value):
    """Nothing is written anywhere, also with several directories below one."""
    edited(place, path, value)
    refused(place)
    to = place.parent / "deep" / "to"
    result = cli("report", place, place, "--to", to)
    assert result.exit_code == 2 and not to.exists()
    assert {each.name for each in place.parent.iterdir()} <= {"out"}


def test_pages_that_refer_to_each_other(place):
    """A page of a table that has itself as a child does not end a query, or fill the memory."""
    with closing(sqlite3.connect(place / FILE)) as connection, connection:
        connection.executemany("INSERT INTO held VALUES (1, ?, 1)", [(n,) for n in range(1, 300_000)])
        [(root,)] = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'held'").fetchall()
    content = np.frombuffer((place / FILE).read_bytes(), dtype=np.uint8).copy()
    pages = content.reshape(-1, 4096)
    top = pages[root - 1]
    assert top[0] == 2  # an inner page of a table without row numbers
    child = bytes(top[8:12])
    for at in range(12, 12 + 2 * int.from_bytes(bytes(top[3:5])), 2):
        cell = int.from_bytes(bytes(top[at : at + 2]))
        top[cell : cell + 4] = np.frombuffer(child, dtype=np.uint8)
    (place / FILE).write_bytes(content.tobytes())
    start = time.process_time()
    result = cli("report", place)
    assert result.exit_code in (0, 2) and time.process_time() - start < 10


@pytest.mark.parametrize("name", [FILE, "code", "manifest.json"])
def test_merge_writes_nothing_through_a_link(tmp_path, name):
    """The store, the copies and the record of the whole experiment stay below the named directory."""
    path, out, elsewhere = write(tmp_path), tmp_path / "out", tmp_path / "elsewhere"
    for shard in ("1/2", "2/2"):
        assert cli("run", path, "-o", out, "--shard", shard, "-j", 1).exit_code == 0
    copy = out / "shards" / "1-of-2" / "code" / "0123456789abcdef"
    copy.mkdir(parents=True)
    (copy / "x.py").write_text("x = 1")
    elsewhere.mkdir()
    (out / name).unlink(missing_ok=True)
    (out / name).symlink_to(elsewhere if name == "code" else elsewhere / "file")
    result = cli("merge", out)
    assert result.exit_code in (0, 2, 74), result.output
    assert not [*elsewhere.iterdir()]
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("linked", ["shards", "shards/1-of-2"])
def test_shards_that_lie_elsewhere(place, linked):
    """A shard of another directory is not opened: that would complete the last write of its store."""
    elsewhere, mine = place.parent / "elsewhere", place.parent / "mine"
    (elsewhere / "1-of-2").parent.mkdir()
    shutil.copytree(place, elsewhere / "1-of-2")
    (mine / linked).parent.mkdir(parents=True)
    (mine / linked).symlink_to(elsewhere if linked == "shards" else elsewhere / "1-of-2")
    journal = elsewhere / "1-of-2" / f"{FILE}-journal"
    journal.write_bytes(b"a transaction that was not completed")
    before = {path: path.read_bytes() for path in elsewhere.rglob("*") if path.is_file()}
    for command in (["merge", mine], ["status", mine]):
        result = cli(*command)
        assert result.exit_code == 2 and "is a symbolic link" in result.stderr and not result.stdout
    assert {path: path.read_bytes() for path in elsewhere.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("name", ["trials.csv", "report.html", "tables/summary.md"])
def test_a_directory_in_place_of_a_file(place, name):
    """Its name, and no error of writing."""
    (place / name).unlink(missing_ok=True)
    (place / name).mkdir(parents=True)
    result = cli("report", place)
    assert result.exit_code == 2 and f"{name}: is a directory; move it away" in result.stderr


@pytest.mark.parametrize("change", ["point", "method"])
def test_shards_with_other_layouts(tmp_path, change):
    """The hash of the experiment is theirs, the layout is not."""
    path = write(tmp_path)
    for shard in ("1/2", "2/2"):
        assert cli("run", path, "-o", tmp_path / "out", "-j", 1, "--shard", shard, "--progress", "none").exit_code == 0
    with closing(sqlite3.connect(tmp_path / "out" / "shards" / "2-of-2" / FILE)) as connection, connection:
        [(text,)] = connection.execute("SELECT value FROM meta WHERE key = 'layout'").fetchall()
        layout = json.loads(text)
        if change == "point":
            layout["points"] *= 2
        text = json.dumps(layout)
        text = text.replace("R-MPC", "X-MPC") if change == "method" else text
        connection.execute("UPDATE meta SET value = ? WHERE key = 'layout'", (text,))
    result = cli("merge", tmp_path / "out")
    assert result.exit_code in (2, 5) and "Traceback" not in result.stderr and "shards" in result.stderr
