"""`report` of a directory that somebody else has made: nothing outside of it changes, and damage is one sentence."""

import json
import os
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from small_experiment import cli, ran, write

from rmpc_bench import load_results
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.received.store import FILE, MissingError, WriteError

HOSTILE = "<script>alert(1)</script>|`x`$\\input{/etc/passwd}$ =HYPERLINK(1) ![](http://x) %"
KEYS = {
    "title": json.dumps(HOSTILE),
    "methods": f"{{S-MPC: {{estimator: {{kind: kalman}}, label: {json.dumps(HOSTILE)}}},"
    " '=1+1|../../x': {estimator: {kind: robust-kalman, c: 0.1}}}",
    "record": "{runs: 2}",
    "evaluate": "[runs, ensemble]",
    "figures": "[boxplot]",
    "claims": f"[{{says: {json.dumps(HOSTILE)}, source: {json.dumps(HOSTILE)}, check: 'mean(mse[S-MPC]) > 0',"
    " finding: confirmed}]",
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the directory of a small experiment with all kinds of files."""
    directory = tmp_path_factory.mktemp("made")
    ran(write(directory, **KEYS), directory / "out")
    return directory / "out"


@pytest.fixture
def place(made, tmp_path):
    """Return a copy of it, beside a file that nobody may change."""
    shutil.copytree(made, tmp_path / "out")
    (tmp_path / "precious").write_text("mine", encoding="utf-8")
    return tmp_path / "out"


def outside(place):
    """Names and bytes of everything beside the directory."""
    return {path.name: path.read_bytes() for path in place.parent.iterdir() if path != place}


def test_symbolic_links_at_every_file(place):
    """Each is replaced by a file, or read; what it leads to stays as it is."""
    files = [path for path in place.rglob("*") if path.is_file() and path.name not in (FILE, "manifest.json")]
    for file in files:
        file.unlink()
        file.symlink_to(place.parent / "precious")
    before = outside(place)
    result = cli("report", place)
    assert result.exit_code == 0, result.output
    assert outside(place) == before
    derived = [file for file in files if not file.name.startswith(("config", "manifest", "progress", "published"))]
    assert derived and [file.name for file in derived if file.is_symlink()] == []


def test_pipes_at_every_file(place):
    """None of them is waited for."""
    for file in [path for path in place.rglob("*") if path.is_file() and path.name != FILE]:
        file.unlink()
        os.mkfifo(file)
    result = cli("report", place)
    assert result.exit_code == 2 and "manifest.json: is not a regular file" in result.stderr
    (place / "manifest.json").unlink()
    assert cli("report", place).exit_code == 0


@pytest.mark.parametrize("name", ["tables", "figures"])
def test_symbolic_links_at_folders(place, name):
    """They are refused, and nothing is written into them."""
    shutil.rmtree(place / name)
    elsewhere = place.parent.parent / f"{place.parent.name}-elsewhere"
    elsewhere.mkdir()
    (place / name).symlink_to(elsewhere)
    before = outside(place)
    result = cli("report", place)
    assert result.exit_code == 74 and "is a symbolic link" in result.stderr
    assert outside(place) == before and not any(elsewhere.iterdir())


def test_a_store_that_is_a_symbolic_link(place, tmp_path_factory):
    """It is read only, also where a writer was killed."""
    other = tmp_path_factory.mktemp("other") / FILE
    shutil.move(place / FILE, other)
    (place / FILE).symlink_to(other)
    before = other.read_bytes(), sorted(path.name for path in other.parent.iterdir())
    assert cli("report", place).exit_code == 0
    assert (other.read_bytes(), sorted(path.name for path in other.parent.iterdir())) == before


def test_texts_are_escaped(place):
    """In CSV, HTML, Markdown and LaTeX."""
    page = (place / "report.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page
    for name in ("report.md", "claims.md", "tables/summary.md"):
        blocks = (place / name).read_text(encoding="utf-8").split("```")
        assert "<script>" not in "".join(blocks[::2])
    for table in (place / "tables").glob("*.tex"):
        text = table.read_text(encoding="utf-8")
        assert "\\input{/etc/passwd}" not in "".join(line for line in text.splitlines(True) if line[0] != "%")


def test_a_metric_named_like_a_path(place):
    """Tables have the names of metrics; one that leads out of the directory is refused."""
    before = outside(place)
    with closing(sqlite3.connect(place / FILE)) as connection, connection:
        [(text,)] = connection.execute("SELECT value FROM meta WHERE key = 'layout'").fetchall()
        text = text.replace('[["mse"', '[["../../evil"')
        connection.execute("UPDATE meta SET value = ? WHERE key = 'layout'", (text,))
    result = cli("report", place)
    assert result.exit_code == 2 and "a metric has no valid name" in result.stderr
    assert outside(place) == before


@pytest.mark.parametrize("seed", range(60))
def test_damaged_bytes(made, tmp_path, seed):
    """Some bytes of the store are wrong, or its end is missing: a sentence, or results, but no traceback."""
    rng = np.random.default_rng(seed)
    content = np.frombuffer((made / FILE).read_bytes(), dtype=np.uint8).copy()
    at = rng.integers(100 if seed % 2 else 4096, len(content), 400)
    content[at] = rng.integers(0, 256, len(at))
    if seed % 5 == 0:
        content = content[: rng.integers(100, len(content))]
    (tmp_path / FILE).write_bytes(content.tobytes())
    try:
        load_results(tmp_path)
    except (MissingError, StoreError, WriteError) as error:
        assert len(str(error)) < 1000


@pytest.mark.parametrize("table", ["chunks", "traces", "ensemble_groups", "arrays"])
@pytest.mark.parametrize("cut", [1, 9])
def test_blobs_of_a_wrong_length(place, table, cut):
    """They are found when they are read."""
    column = {"ensemble_groups": "mean"}.get(table, "data")
    with closing(sqlite3.connect(place / FILE)) as connection, connection:
        connection.execute(f"UPDATE {table} SET {column} = substr({column}, {cut + 1})")
    result = cli("report", place)
    if table == "chunks" and cut == 9:
        # A status is one byte: runs seem to be missing.
        assert result.exit_code in (0, 2, 5)
    else:
        assert result.exit_code == 2 and "the store is damaged" in result.stderr, result.output
    assert "Traceback" not in result.stderr
