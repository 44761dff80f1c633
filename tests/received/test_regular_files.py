"""Only regular files of limited size are read as configuration, and messages quote little of a value."""

import os

import numpy as np
import pytest
from small_experiment import KEYS, cli, write

from rmpc_bench.received.plain_files import MAX_BYTES, content_of
from rmpc_bench.types.errors import MAX_QUOTED, shortened

SPECIAL = {
    "pipe": (os.mkfifo, "is not a regular file"),
    "device": (lambda path: path.symlink_to("/dev/zero"), "is not a regular file"),
    "directory": (lambda path: path.mkdir(), "is a directory|Is a directory"),
    "large": (lambda path: path.write_bytes(b"#" * (MAX_BYTES + 1)), "is larger than 10 MB"),
}
LINEAR = {
    "uncertainty": None,
    "plant": "{kind: linear, A: {file: FILE}, B: [[1]], C: [[1]]}",
    "model": "{from: plant}",
    "controller": None,
    "methods": "{KF: {estimator: {kind: kalman}}}",
}


@pytest.mark.parametrize("kind", SPECIAL)
def test_a_file_that_is_not_read(tmp_path, kind):
    """A pipe does not make the reader wait, a device does not fill the memory."""
    SPECIAL[kind][0](tmp_path / "a.yaml")
    with pytest.raises(OSError, match=SPECIAL[kind][1]):
        content_of(tmp_path / "a.yaml")


def test_the_largest_file(tmp_path):
    """Exactly the limit is read."""
    (tmp_path / "a").write_bytes(b"#" * 100)
    assert content_of(tmp_path / "a", 100) == b"#" * 100
    with pytest.raises(OSError, match="is larger than"):
        content_of(tmp_path / "a", 99)


@pytest.mark.parametrize("kind", SPECIAL)
@pytest.mark.parametrize("name", ["x.yaml", "x.csv", "x.npz", "x.mat"])
@pytest.mark.parametrize("key", ["run", "extends", "plant.from", "matrix"])
def test_every_file_of_a_configuration(tmp_path, kind, name, key):
    """The command ends at once with the place and the reason, and exit code 2."""
    if (name == "x.yaml") == (key == "matrix"):
        pytest.skip("a matrix has another ending than a configuration")
    make, _ = SPECIAL[kind]
    make(tmp_path / name)
    keys = {
        "run": {},
        "extends": {"extends": name},
        "plant.from": {"plant": f"{{from: {name}}}"},
        "matrix": LINEAR | {"plant": LINEAR["plant"].replace("FILE", name)},
    }[key]
    path = tmp_path / name if key == "run" else write(tmp_path, **keys)
    result = cli("check", path)
    assert result.exit_code == 2, result.output
    assert name in result.stderr and "Traceback" not in result.stderr
    assert any(
        text in result.stderr for text in ("regular file", "directory", "larger than 10 MB", "larger than 3 MB")
    ), result.stderr


def test_a_pipe_beside_a_configuration(tmp_path):
    """Other files of the folder are looked at for claims with the same id."""
    os.mkfifo(tmp_path / "other.yaml")
    claim = "[{id: c, says: S, source: Fig. 1, check: 'mean(mse[S-MPC]) > 0', finding: confirmed}]"
    result = cli("check", write(tmp_path, paper="p", claims=claim.replace(", finding: confirmed", "")))
    assert result.exit_code in (0, 2) and "Traceback" not in result.stderr


@pytest.mark.parametrize("key", [*KEYS, "extends", "execution", "sweep", "stop", "record", "paper"])
@pytest.mark.parametrize("value", ["'{}'", "{{kind: '{}'}}", "['{}', '{}']", "{{'{}': 1}}", "'+-{}%'", "'2*{}'"])
def test_messages_quote_little(tmp_path, key, value):
    """Whatever the key and the kind of value: no line has more than its place, its key and 200 characters of it."""
    long = "ab c" * 5000 if key != "title" else "x" * 5000
    result = cli("check", write(tmp_path, **{key: value.replace("{}", long).replace("{{", "{").replace("}}", "}")}))
    lines = result.stderr.splitlines()
    assert "Traceback" not in result.stderr
    assert all("ab c" * (MAX_QUOTED // 4 + 1) not in line for line in lines), max(lines, key=len)[:3000]
    assert all(len(line) < 5000 for line in lines)


def test_short_values_are_quoted_whole():
    """And apostrophes of a sentence quote nothing."""
    for text in (
        "a" * 190,
        f"must be a number (got '{'a' * 190}')",
        "the plant's " + "long sentence " * 30 + "plant's",
    ):
        assert shortened(text) == text
    assert shortened(f"{'é' * 300!r} is unknown; known: b") == f"'{'é' * 200}...' is unknown; known: b"
    rng = np.random.default_rng(1)
    for _ in range(50):
        given = "".join(map(chr, rng.integers(32, 127, 3000)))
        assert given[: MAX_QUOTED + 3] not in shortened(f"must be a number (got {given!r})")
