"""Promises under disturbance: random kills, writers that start at once, a full disk, and hash seeds."""

import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from small_experiment import ran
from small_experiment import write as write_keys
from stored_rows import n_stored

COMMAND = Path(sys.executable).with_name("rmpc-bench")
OWN = """
import time
from rmpc_bench import single_run

@single_run
class Slow:
    def __init__(self, model):
        pass
    def start(self, x0, run):
        self.x_hat = x0
    def update(self, y, k):
        if k == 2:
            time.sleep({seconds})
        return self.x_hat
"""
METHODS = "{S-MPC: {estimator: {kind: kalman}}, slow: {estimator: {file: 'own.py:Slow'}}}"
DURATION = re.compile(rb"(<p>)?Computing all runs took [^\n]*\n+")
"""The line of a page on the duration of the run, which is left out for less than a second."""
TIMED = {"manifest.json", "progress.json", "published.json", "timings.csv", "trials.sqlite"}
"""Files with times."""
TWO = ["-j", "2", "--engine", "joblib"]
KILLED = [["--engine", "serial"], TWO, ["--shard", "1/2", *TWO], ["--shard", "2/2", "-j", "1"]]


def write(directory, seconds, **keys):
    """Write an experiment with a component that waits in every run; the time of waiting changes no number."""
    directory.mkdir(exist_ok=True)
    (directory / "own.py").write_text(OWN.format(seconds=seconds), encoding="utf-8")
    noise = "{process: {gaussian: {std: 0.01}}}"
    return write_keys(directory, noise=noise, methods=METHODS, **keys)


def start(path, *options, **keywords):
    """Start a run in a process group of its own."""
    command = [COMMAND, "run", path, "-o", path.parent / "out", "--progress", "none", *options]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, start_new_session=True, **pipes, **keywords)


def ended(process):
    """Wait for the end of a run; return its exit code and stderr, in which there is no traceback."""
    _, err = process.communicate(timeout=300)
    assert "Traceback" not in err, err
    return process.returncode, err


@pytest.mark.long
def test_writers_that_start_at_once(tmp_path):
    """In a new directory one computes everything; every other one is refused, or comes later and has nothing to do."""
    path = write(tmp_path, 0.05, runs=20)
    ends = [ended(each) for each in [start(path, "-j", "1") for _ in range(3)]]
    assert 0 in [code for code, _ in ends]
    for code, err in ends:
        assert code == 0 or (code == 5 and "another process writes to it" in err), err
    expected = ran(write(tmp_path / "undisturbed", 0.0, runs=20), tmp_path / "undisturbed" / "out")
    assert (tmp_path / "out" / "trials.csv").read_bytes() == expected


@pytest.mark.parametrize("size", [0, 30_000, pytest.param(80_000, marks=pytest.mark.slow)])
@pytest.mark.long
def test_a_full_disk(tmp_path, size):
    """Before the first trial, and in the report: exit 74 in a few lines, and with room the same command ends well."""
    path = write_keys(tmp_path, figures="[boxplot]")

    def small_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    code, err = ended(start(path, "-j", "1", preexec_fn=small_disk))
    assert code == 74 and "cannot be written" in err and len(err.splitlines()) < 6, err
    expected = ran(path, tmp_path / "other")
    assert ran(path, tmp_path / "out") == expected


@pytest.mark.kill
@pytest.mark.parametrize("n_kills", [4, pytest.param(20, marks=pytest.mark.slow)])
def test_kills_at_random_moments(tmp_path, n_kills):
    """No stored trial is lost, and what remains ends in the bytes of a run that nobody disturbs."""
    rng, runs = np.random.default_rng(n_kills), 30 * n_kills
    path = write(tmp_path / "killed", 0.05, runs=runs)
    before, n_hit = dict[str, int](), 0
    for number in range(n_kills):
        process = start(path, *KILLED[number % len(KILLED)])
        time.sleep(rng.uniform(0.2, 5.0))
        n_hit += process.poll() is None
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        assert process.communicate(timeout=60) and process.returncode in (0, -signal.SIGKILL)
        places = [path.parent / "out", *(path.parent / "out" / "shards").glob("*")]
        after = {place.name: n_stored(place) for place in places if (place / "trials.sqlite").exists()}
        assert all(after[name] >= n for name, n in before.items())
        before = after
    assert n_hit >= n_kills / 2
    code, err = ended(start(path, "--missing", *TWO))
    assert code == 0, err
    expected = ran(write(tmp_path / "undisturbed", 0.0, runs=runs), tmp_path / "undisturbed" / "out")
    assert (path.parent / "out" / "trials.csv").read_bytes() == expected


@pytest.mark.parametrize("n_seeds", [2, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.long
def test_hash_seeds(tmp_path, n_seeds):
    """No file of the results depends on the order of sets."""
    path = write_keys(tmp_path, runs=12, figures="[boxplot, rows]")
    found = []
    for seed in range(1, 1 + n_seeds):
        out = tmp_path / str(seed) / "out"
        process = start(path, "-j", "1", "-o", out, env={**os.environ, "PYTHONHASHSEED": str(seed)})
        assert ended(process)[0] == 0
        files = {each.relative_to(out).as_posix(): each for each in sorted(out.rglob("*")) if each.is_file()}
        found.append({name: DURATION.sub(b"", each.read_bytes()) for name, each in files.items() if name not in TIMED})
    for name, content in found[0].items():
        assert all(each[name] == content for each in found), name
    assert all(each.keys() == found[0].keys() for each in found)
