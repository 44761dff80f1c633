"""Promises under disturbance: writers that start at once, and a full disk."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest
from small_experiment import ran
from small_experiment import write as write_keys

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
def test_a_full_disk(tmp_path, size):
    """Before the first trial, and in the report: exit 74 in a few lines, and with room the same command ends well."""
    path = write_keys(tmp_path, figures="[boxplot]")

    def small_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    code, err = ended(start(path, "-j", "1", preexec_fn=small_disk))
    assert code == 74 and "cannot be written" in err and len(err.splitlines()) < 6, err
    expected = ran(path, tmp_path / "other")
    assert ran(path, tmp_path / "out") == expected
