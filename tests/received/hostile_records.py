"""Records of results with wrong types in every field: JSON files, the stored layout, and the files of an archive."""

import json
import sqlite3
from contextlib import closing

from received.box import Case, each_of, verify
from received.hostile_archives import METADATA, archive

LAYOUT = "layout"
"""The layout is a text in the table `meta` of the store."""
WRONG = (
    *(None, True, False, -1, 0, 2**70, 1e308, 0.5, float("nan"), "", "abc", "../../../ESC", "/ESC", "a\0b", "\ud800"),
    *("\x1b]0;pwn\x07", "a\u202eb", "x" * 100_000, "=1+1", "<script>alert(5)</script>", [], [[]], {}, {"a": 1}),
    *([1], ["a"], [None], {"": {}}, {"../ESC": 1}, {"\x1b[2J": 1}, [[[[[[1]]]]]], {"__class__": "os.system"}),
)
"""Values of any type."""
FIELDS = {
    "manifest.json": (
        *("name", "experiment", "seed", "modified", "versions", "numerics", "blas", "git", "platform", "looks"),
        *("sessions", "report", "file"),
    ),
    "progress.json": (
        *("name", "experiment", "shard", "runs", "n_runs", "all_trials", "methods", "host", "pid", "started", "state"),
        *("why", "updated", "every", "total", "done", "seconds", "rate", "left_seconds", "failed", "metric", "means"),
    ),
    "tuning.json": ("version", "protocol", "searches"),
    "claims.json": ("schema", "experiment", "claims"),
    "published.json": ("fingerprint", "state", "command", "shown", "files"),
    LAYOUT: (
        *(
            "name",
            "paper",
            "title",
            "hash",
            "n_runs",
            "has_runs",
            "axes",
            "labels",
            "primary",
            "baseline",
            "confidence",
        ),
        *("relevant", "margins", "average", "headline", "max_failures", "alike", "overrides", "figures", "claims"),
        *("points", "expected_failures", "report", "ranks", "requirements", "lost", "added", "stop", "parameters"),
        *("tuning", "two_way", "adjust", "calibration", "imported"),
    ),
}
"""Every field at the top of every record; a test compares them with those of new results."""
POINT = (
    *(
        "coordinates",
        "title",
        "seed",
        "Ts",
        "nx",
        "n_steps",
        "units",
        "metrics",
        "metric_keys",
        "methods",
        "n_recorded",
    ),
    *("has_ensemble", "reference", "uncertainty_key", "uncertainty", "names", "random_besides", "limitations"),
    *("laws", "angles"),
)
"""Every field of a point of the layout."""
EXPERIMENT = {"tuning.json": "tuned"}
"""The honest results that have a record, where they are not the plain ones."""
VERBS = {
    "manifest.json": ("compare pack", "report sites"),
    "progress.json": ("status json", "report"),
    "tuning.json": ("compare pack", "report sites"),
    "claims.json": ("sites", "pack report"),
    "published.json": ("compare", "report pack"),
    LAYOUT: ("compare show", "report pack sites"),
}
"""Commands for every alteration, and further ones for some."""


def load(place, record):
    """Return the content of a record."""
    if record != LAYOUT:
        return json.loads((place / record).read_text(encoding="utf-8"))
    with closing(sqlite3.connect(place / "trials.sqlite")) as connection:
        [(text,)] = connection.execute("SELECT value FROM meta WHERE key = 'layout'").fetchall()
    return json.loads(text)


def save(place, record, data):
    """Write the content of a record."""
    text = json.dumps(data)
    if record != LAYOUT:
        (place / record).write_text(text, encoding="utf-8")
        return
    with closing(sqlite3.connect(place / "trials.sqlite")) as connection, connection:
        connection.execute("UPDATE meta SET value = ? WHERE key = 'layout'", (text,))


def paths(data, path=()):
    """Yield the paths of all values below a value, itself first."""
    yield path
    entries = data.items() if isinstance(data, dict) else enumerate(data[:3]) if isinstance(data, list) else ()
    for name, value in entries:
        yield from paths(value, (*path, name))


def replaced(data, path, value):
    """Return a copy with another value at a path."""
    if not path:
        return value
    found = data.copy()
    found[path[0]] = replaced(data[path[0]], path[1:], value)
    return found


def renamed(data, path, name):
    """Return a copy in which the last part of a path is another name."""
    if len(path) > 1:
        return replaced(data, path[:1], renamed(data[path[0]], path[1:], name))
    return {(name if key == path[0] else key): value for key, value in data.items()}


def _without(data, path):
    if len(path) > 1:
        return replaced(data, path[:1], _without(data[path[0]], path[1:]))
    return {key: value for key, value in data.items() if key != path[0]}


def alterations(box, data, start, n):
    """Yield altered copies with a note: the field itself, and ``n`` values inside it, have other values."""
    inside = data
    for part in start:
        inside = inside[part]
    below = [path for path in paths(inside, start) if path != start]
    for path in [start, *box.random.sample(below, min(n, len(below)))]:
        value = box.random.choice(WRONG)
        yield replaced(data, path, value), f"{'.'.join(map(str, path))} = {str(value)[:30]!r}"
    if isinstance(start[-1], str):
        yield _without(data, start), f"{'.'.join(map(str, start))} is missing"


def _fields(record, starts, n=1):
    def cases(box):
        name = EXPERIMENT.get(record, "plain")
        place = box.results(name)
        honest = load(place, record)
        always, sometimes = VERBS[record]
        for start in starts:
            for data, note in alterations(box, honest, start, n):
                save(place, record, data)
                verbs = f"{always} {box.random.choice(sometimes.split())}" if box.random.random() < 0.25 else always
                yield from each_of(box, place, verbs, name=name, note=f"{record}: {note}")

    return cases


def _grouped(fields, size):
    """Return names of groups and the fields of each."""
    parts = [fields[start : start + size] for start in range(0, len(fields), size)]
    return {f"{part[0]}..{part[-1]}" if len(part) > 1 else part[0]: part for part in parts}


def _wrong_top(record):
    """The whole record is another value."""

    def cases(box):
        name = EXPERIMENT.get(record, "plain")
        place = box.results(name)
        for value in (*box.random.sample(WRONG, 4), [], {}):
            save(place, record, value)
            yield from each_of(box, place, VERBS[record][0], name=name, note=f"{record} = {str(value)[:30]!r}")
        yield from each_of(box, place, VERBS[record][1], name=name, note=f"{record} = {{}}")

    return cases


NAMES = {
    "parent": "../../../ESC",
    "absolute": "{outside}/ESC",
    "escape": "\x1b]0;pwn\x07",
    "direction": "a\u202eb",
    "script": "<script>alert(5)</script>",
    "link": "[x](javascript:alert(5))",
    "formula": "=HYPERLINK(1)",
    "line": "a\nb",
    "latex": "\\input{/etc/passwd}",
    "long": "x" * 5000,
    "dot": ".",
    "nul": "a\0b",
}
REFUSED = {"parent", "absolute", "escape", "direction", "line", "nul", "dot"}
"""Names that a configuration does not allow either, in a place that makes a file."""


def _named(name, text):
    """A name of the layout is another one: of the experiment, a method, a metric, a figure."""

    def cases(box):
        place, given = box.results(), text.replace("{outside}", str(box.outside))
        honest = load(place, LAYOUT)
        metric = ("points", 0, "metrics", 0, 0)
        kinds = {
            "name": replaced(honest, ("name",), given),
            "paper": replaced(honest, ("paper",), given),
            "primary": replaced(replaced(honest, metric, given), ("primary",), given),
            "method": json.loads(json.dumps(honest).replace('"S-MPC"', json.dumps(given))),
            "label": replaced(honest, ("labels", "S-MPC"), given),
            "title": replaced(honest, ("title",), given),
            "figure": replaced(honest, ("figures",), [{"kind": given}]),
        }
        for kind, data in kinds.items():
            save(place, LAYOUT, data)
            refused = ("report", "sites") if name in REFUSED and kind in ("name", "paper", "primary") else ()
            verbs = "report sites" if kind in ("name", "paper") else box.random.choice(["report", "compare show"])
            yield from each_of(box, place, verbs, note=f"{kind} = {given[:30]!r}", refused=refused)
        progress = load(place, "progress.json")
        save(place, LAYOUT, honest)
        for path in (("name",), ("methods", 0), ("host",), ("state",), ("why",), ("metric",), ("means", 0, "method")):
            save(place, "progress.json", replaced(progress, path, given))
            yield from each_of(box, place, "status json", note=f"progress {path} = {given[:30]!r}")

    return cases


def _printed(box):
    """Texts of warnings and failures of the store are printed as text."""
    place = box.results()
    failure = {
        "component": "\x1b[31m",
        "k": 1,
        "type": "\x1b[2J",
        "message": "\x1b]0;pwn\x07\u202e",
        "trace": "\x1b[2J",
    }
    with closing(sqlite3.connect(place / "trials.sqlite")) as connection, connection:
        connection.execute("INSERT INTO warnings VALUES (1, 0, 4, ?, 3)", ("\x1b]0;pwn\x07\u202e<script>",))
        connection.execute("INSERT INTO failures VALUES (1, 0, ?)", (json.dumps(failure),))
        connection.execute("UPDATE chunks SET data = x'01010101' WHERE length(data) = 4")
    yield from each_of(box, place, "report compare show pack sites")


PACKED = ("manifest.json", "claims.json", "verified_on.json", METADATA)
"""Records of an archive."""


def _packed(record):
    """One field after the other of a record of an archive has another type, its hash recomputed."""

    def cases(box):
        import packed

        honest = json.loads(packed.contents(box.honest.archive("plain"))[record])
        every = [path for path in paths(honest) if path]
        contents = [
            replaced(honest, path, box.random.choice(WRONG)) for path in box.random.sample(every, min(4, len(every)))
        ]
        contents += [box.random.choice(WRONG), "[" * 200_000]
        for content in contents:
            text = content if content == "[" * 200_000 else json.dumps(content)
            no_run, few, every_run = verify(archive(box, {record: text.encode()}), note=f"{record}: {text[:60]}")
            yield box.random.choice([no_run, few, every_run])

    return cases


TABLES = ("trials.csv", "summary.csv", "comparisons.csv", "series.csv", "uncertainty.csv", "traces.npz")
CONTENTS = {
    "empty": b"",
    "binary": bytes(range(256)) * 10,
    "wide": b"method,run," + b",".join(b"c%d" % i for i in range(300_000)) + b"\n",
    "quote": b'method,run\n"' + b"x" * 1_000_000,
    "words": b"method,run,mse\nS-MPC,0,abc\n",
    "runs": b"method,run,status,mse\nS-MPC,-1,ok,1\nS-MPC,99999999999999999999,ok,1\n",
    "columns": b"method,run,status,mse,mse\nS-MPC,0,ok,1,2\n",
    "escapes": "method,run,status\n\x1b]0;pwn\x07,0,\u202e\n".encode(),
    "formula": b"method,run,status\n=1+1,0,ok\n",
}


def _table(name):
    """A table of an archive has another content, its hash recomputed."""

    def cases(box):
        for kind, content in CONTENTS.items():
            no_run, few, _ = verify(archive(box, {name: content}), note=f"{name}: {kind}")
            yield from (no_run, few)[: box.random.choice([1, 2])]

    return cases


CASES = [
    *(
        Case("field", f"{record}-{name}", _fields(record, [(each,) for each in part], 5 if size == 1 else 1))
        for record, size in {"manifest.json": 4, "progress.json": 4, "published.json": 3, "layout": 4}.items()
        for name, part in _grouped(FIELDS[record], size).items()
    ),
    *(
        Case("field", f"{record}-{name}", _fields(record, [(name,)], 6))
        for record in ("tuning.json", "claims.json")
        for name in FIELDS[record]
    ),
    *(
        Case("field", f"point-{name}", _fields(LAYOUT, [("points", 0, each) for each in part]))
        for name, part in _grouped(POINT, 4).items()
    ),
    *(Case("field", f"{record}-whole", _wrong_top(record)) for record in FIELDS),
    *(Case("name", name, _named(name, text)) for name, text in NAMES.items()),
    Case("name", "printed", _printed),
    *(Case("packed", record, _packed(record)) for record in PACKED),
    *(Case("packed", table, _table(table)) for table in TABLES),
]
