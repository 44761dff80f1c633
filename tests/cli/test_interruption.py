"""A run that is interrupted for real: by Ctrl-C, by SIGTERM, by kill -9, by a full disk."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_experiment import cli, ran
from small_experiment import write as write_keys
from stored_rows import n_stored

from rmpc_bench.received.store import LATER

COMMAND = Path(sys.executable).with_name("rmpc-bench")
OWN = """
import time
from pathlib import Path
from rmpc_bench import single_run

@single_run
class Slow:
    def __init__(self, model):
        pass
    def start(self, x0, run):
        self.x_hat, self.run = x0, run
    def update(self, y, k):
        if k == 2:
            time.sleep(0.03)
        while self.run >= 50 and not Path(__file__).with_name("go_on").exists():
            time.sleep(0.01)
        return self.x_hat
"""
KEYS = {
    "runs": "60",
    "time": "{step: 0.1, steps: 100}",
    "noise": "{process: {gaussian: {std: 0.01}}}",
    "methods": "{S-MPC: {estimator: {kind: kalman}}, slow: {estimator: {file: 'own.py:Slow'}}}",
    "execution": "{block: 1}",
}
N_TRIALS = 120


def write(directory, **keys):
    """Write an experiment of two seconds; it waits in its last runs until it may go on, so that it is interrupted."""
    (directory / "own.py").write_text(OWN, encoding="utf-8")
    return write_keys(directory, **keys)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """Return the trials.csv of a run that nobody disturbs."""
    directory = tmp_path_factory.mktemp("uninterrupted")
    may_go_on(directory)
    return ran(write(directory, **KEYS), directory / "out", "-s", "execution.block=50")


def may_go_on(directory):
    """Let the last runs of the experiment end."""
    (directory / "go_on").touch()


def start(path, jobs=1, **keywords):
    """Start a run in a process group of its own, as a shell does."""
    command = [COMMAND, "run", path, "-o", path.parent / "out", "-j", str(jobs), "--progress", "none"]
    command += ["--engine", "joblib"] if jobs > 1 else []
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, start_new_session=True, **pipes, **keywords)


def again(path, jobs=1):
    """Give the same command again and return the trials.csv."""
    may_go_on(path.parent)
    process = start(path, jobs)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return (path.parent / "out" / "trials.csv").read_bytes()


def wait_for_blocks(process, path):
    """Wait until a transaction with a column of statuses is complete, when the header of the journal is empty.

    The definition of one table has the word, too.
    """
    store, deadline = path.parent / "out" / "trials.sqlite", time.monotonic() + 60.0
    journal = store.with_name(f"{store.name}-journal")
    while process.poll() is None:
        is_written = store.exists() and store.read_bytes().count(b"status") > LATER.count("status")
        if is_written and not (journal.exists() and journal.read_bytes()[:8].strip(b"\0")):
            break
        assert time.monotonic() < deadline
        time.sleep(0.005)
    assert process.poll() is None, process.communicate()


def stored(path):
    """Count the trials of a store that must be sound."""
    return n_stored(path.parent / "out")


@pytest.mark.kill
@pytest.mark.parametrize(
    ("number", "jobs", "code", "message"),
    [
        (signal.SIGINT, 1, 130, "interrupted; finished blocks are stored, the same command continues"),
        (signal.SIGINT, 2, 130, "interrupted; finished blocks are stored, the same command continues"),
        (signal.SIGTERM, 2, 143, "terminated; finished blocks are stored, the same command continues"),
        (signal.SIGKILL, 1, -9, ""),
    ],
)
def test_a_signal_in_the_middle(tmp_path, uninterrupted, number, jobs, code, message):
    """Finished blocks are stored, no process stays, and the same command ends in the same bytes."""
    path = write(tmp_path, **KEYS)
    process = start(path, jobs)
    wait_for_blocks(process, path)
    if number == signal.SIGINT:  # a terminal sends it to the whole group
        os.killpg(process.pid, number)
    else:
        process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (code, "")
    assert message in err and "Traceback" not in err
    with pytest.raises(ProcessLookupError):
        gone(process.pid)
    assert 0 < stored(path) < N_TRIALS
    assert again(path, jobs) == uninterrupted


def gone(group, seconds=10.0):
    """Raise ProcessLookupError as soon as a process group has no member left."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        os.killpg(group, 0)
        time.sleep(0.05)


@pytest.mark.long
def test_a_full_disk(tmp_path, uninterrupted):
    """Exit 74 in one line, the store is sound and holds what was finished, and with room it goes on."""
    path = write(tmp_path, **KEYS, record="{runs: all}")

    def small_disk():
        # The first trials make a file of 143 kB, all of them one of 385 kB.
        resource.setrlimit(resource.RLIMIT_FSIZE, (250_000, 250_000))

    may_go_on(tmp_path)
    process = start(path, preexec_fn=small_disk)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (74, ""), err
    assert "results cannot be written" in err and "Traceback" not in err
    assert 0 < stored(path) < N_TRIALS
    assert again(path) == uninterrupted


@pytest.mark.long
def test_a_second_process(tmp_path, uninterrupted):
    """It is refused with exit 5 while the first one works, and the first does not notice."""
    path = write(tmp_path, **KEYS)
    process = start(path)
    wait_for_blocks(process, path)
    second = cli("run", path, "-o", tmp_path / "out", "-j", 1)
    may_go_on(tmp_path)
    out, err = process.communicate(timeout=60)
    assert second.exit_code == 5 and "another process writes to it" in second.stderr
    assert process.returncode == 0, err
    assert (tmp_path / "out" / "trials.csv").read_bytes() == uninterrupted
