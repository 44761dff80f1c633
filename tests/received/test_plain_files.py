"""JSON of a directory that somebody else has made: one sentence with file and field, in bounded time and memory."""

import json
import shutil
import time
import tracemalloc

import pytest
from small_experiment import cli, ran, write

from rmpc_bench.received.plain_files import MANIFEST, PROGRESS, DamagedError, checked, json_of

BIG = 10_000_000
EXPENSIVE = {
    "brackets": lambda: "[" * 200_000,
    "lists": lambda: "[" + "[]," * (BIG // 3) + "[]]",
    "lists in lists": lambda: "[" * 59 + "[[]]," * (BIG // 5),
    "small objects": lambda: "[" + '{"":0},' * (BIG // 7) + "0]",
    "small lists": lambda: "[" + "[1]," * (BIG // 4) + "0]",
    "deep and long": lambda: "[" + ("[" * 61 + "]" * 61 + "," * 300) * (BIG // 430) + "0]",
    "digits": lambda: '{"seed": ' + "9" * 10_000 + "}",
    "digits of a float": lambda: '{"seed": ' + "9" * 4_000 + "}",
    "names": lambda: "{" + ",".join(f'"{n}": 0' for n in range(500_000)) + ', "1": 1}',
    "names with the pair at the end": lambda: "{" + ",".join(f'"{n}": 0' for n in [*range(500_000), 499_999]) + "}",
    "texts": lambda: "[" + '"[[",' * (BIG // 5) + "0]",
    "not UTF-8": lambda: b'{"seed": "\xff"}',
    "half of a pair": lambda: '{"name": "\\ud800"}',
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the directory of a small experiment."""
    place = tmp_path_factory.mktemp("made")
    ran(write(place), place / "out")
    return place / "out"


@pytest.mark.parametrize("kind", EXPENSIVE)
def test_expensive_texts(kind):
    """Each is refused within 2 s and 500 MB."""
    text = EXPENSIVE[kind]()
    content = text if isinstance(text, bytes) else text.encode()
    tracemalloc.start() if len(content) < 300_000 else None
    start = time.process_time()
    with pytest.raises(ValueError):
        checked(content, MANIFEST)
    assert time.process_time() - start < 6.0  # three times the limit, as other tests run beside this one
    if tracemalloc.is_tracing():
        assert tracemalloc.get_traced_memory()[1] < 20e6
        tracemalloc.stop()


def mutations(value, path=()):
    """Yield a path into plain data for every field of it."""
    if path:
        yield path
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in entries:
        yield from mutations(each, (*path, key))


WRONG = (None, True, -1, 10**30, 1.5, float("nan"), "abc", "\u001b]0;x\u0007", [], {}, [[]], {"a": {"b": -1}})


@pytest.mark.parametrize(("name", "shape"), [("progress.json", PROGRESS), ("manifest.json", MANIFEST)])
def test_wrong_types_in_every_field(made, tmp_path, name, shape):
    """A file is read, or it is a sentence with its name."""
    whole = json.loads((made / name).read_text())
    n_refused = 0
    for path in mutations(whole):
        for wrong in WRONG:
            data = json.loads(json.dumps(whole))
            at = data
            for key in path[:-1]:
                at = at[key]
            at[path[-1]] = wrong
            (tmp_path / name).write_text(json.dumps(data))
            try:
                json_of(tmp_path / name, shape, "way out")
            except DamagedError as error:
                n_refused += 1
                assert str(error).startswith(str(tmp_path / name)) and str(error).endswith("way out")
                assert len(str(error)) < 500 and str(error).isprintable()
    assert n_refused > 100


@pytest.mark.parametrize("seed", range(12))
def test_status_of_wrong_fields(made, tmp_path, seed):
    """Exit code 0 or 2 and no traceback, with one file and with shards."""
    whole = json.loads((made / "progress.json").read_text())
    paths = [*mutations(whole)]
    for number in range(seed, len(paths) * len(WRONG), 12 * 5):
        data = json.loads(json.dumps(whole))
        path, at = paths[number % len(paths)], data
        for key in path[:-1]:
            at = at[key]
        at[path[-1]] = WRONG[number // len(paths)]
        place = tmp_path / "shards" / "1-of-3" if number % 2 else tmp_path
        place.mkdir(parents=True, exist_ok=True)
        (place / "progress.json").write_text(json.dumps(data))
        result = cli("status", tmp_path)
        assert result.exit_code in (0, 2), (path, result.output, result.exception)
        assert result.exit_code == 0 or "progress.json" in result.stderr


@pytest.mark.parametrize("command", ["report", "compare", "run"])
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 200_000, "too many lists and objects"),
        ("[" * 5_000, "levels deep"),
        ('{"looks": {"a": 1}, "versions": [1]}', "versions: must be an object"),
        ('{"seed": 1, "seed": 2}', "'seed' is given twice"),
        ('{"name": "a\\u202eb"}', "name: contains the control character U+202E"),
    ],
)
def test_a_manifest_that_is_refused(made, tmp_path, command, text, said):
    """The file, the field and what removes it; nothing is written."""
    shutil.copytree(made, tmp_path / "out")
    (tmp_path / "out" / "manifest.json").write_text(text)
    arguments = {"report": [tmp_path / "out", "--to", tmp_path / "to"], "compare": [made, tmp_path / "out"]}
    result = cli(command, *arguments.get(command, [write(tmp_path), "-o", tmp_path / "out", "--runs", 8]))
    assert result.exit_code == 2, result.output
    assert "manifest.json: " in result.stderr and said in result.stderr and "remove the file" in result.stderr
    assert not [path for path in tmp_path.glob("to/**/*") if path.is_file()]


def test_a_directory_that_says_it_has_a_thousand_million_shards(made, tmp_path):
    """Its number is no number of shards; the status of the others is shown at once."""
    place = tmp_path / "shards" / "1-of-1000000000"
    place.mkdir(parents=True)
    shutil.copy(made / "progress.json", place)
    start = time.monotonic()
    assert cli("status", tmp_path).exit_code == 2 and time.monotonic() - start < 5


def test_a_published_state_of_somebody_else(made, tmp_path):
    """It only says that nothing is to be done: it is written again."""
    shutil.copytree(made, tmp_path / "out")
    for text in ("[" * 200_000, '{"shown": 1}', '{"files": {"a": "b"}}'):
        (tmp_path / "out" / "published.json").write_text(text)
        assert cli("run", write(tmp_path), "-o", tmp_path / "out", "-j", 1).exit_code == 0
        assert json.loads((tmp_path / "out" / "published.json").read_text())["files"]
