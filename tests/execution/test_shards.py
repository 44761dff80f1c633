"""Shards: every run once, the bytes of one process when they are joined, and refusals of what does not fit together."""

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
from engines.test_isolation import OWN
from small_experiment import cli, ran, spied, write
from store.test_ensemble_store import write_estimation

from rmpc_bench.execution.progress_file import read
from rmpc_bench.execution.shards import Shard, parse_shard, shards_in
from rmpc_bench.received import store

KEYS = {
    "runs": 20,
    "uncertainty": "{eps: +-20%}",
    "noise": "{process: {gaussian: {std: 0.01}}, measurement: {gaussian: {std: 0.01}}}",
    "record": "{runs: 5}",
}


def shard(path, out, text, *options):
    """Compute a shard; anything but exit 0 fails the test."""
    result = cli("run", path, "-o", out, "-j", 1, "--progress", "none", "--shard", text, *options)
    assert result.exit_code == 0, result.output
    return result


def all_shards(path, out, n, *options, but=()):
    """Compute all shards but some."""
    for number in range(1, n + 1):
        if number not in but:
            shard(path, out, f"{number}/{n}", *options)


def joined(out, *options):
    """Join the shards and return the result of the command."""
    return cli("merge", out, *options)


def same(one, other, *names, looks=1):
    """Compare files of two directories byte by byte; the comparison has the number of publications before it."""
    compared = ["comparisons.csv"] if looks == 1 else []
    for name in ("trials.csv", "uncertainty.csv", "series.csv", "summary.csv", *compared, *names):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """Return the configuration and the results of one process."""
    directory = tmp_path_factory.mktemp("serial")
    path = write(directory, **KEYS)
    ran(path, directory / "out")
    return path, directory / "out"


@pytest.mark.parametrize("n_runs", [0, 1, 7, 49, 50, 120, 200, 1000, 999_983])
@pytest.mark.parametrize("total", [1, 2, 3, 7, 20, 64])
def test_every_run_is_in_one_shard(n_runs, total):
    parts = [Shard(number, total).runs(n_runs) for number in range(1, total + 1)]
    assert parts[0].start == 0 and parts[-1].stop == n_runs
    assert all(one.stop == other.start for one, other in zip(parts[:-1], parts[1:], strict=True))
    # Rounding to groups of runs moves each end by a tenth of a shard at most.
    assert all(abs(len(part) - n_runs / total) <= 0.2 * n_runs / total + 1.0 for part in parts)


def test_large_shards_have_whole_groups():
    """A group of 50 runs that two shards share is stored run by run until they are joined."""
    assert [Shard(number, 7).runs(10_000).stop for number in range(1, 7)] == [1450, 2850, 4300, 5700, 7150, 8550]
    assert [Shard(number, 3).runs(120).stop for number in range(1, 4)] == [40, 80, 120]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0/3", "the shards of 3 are 1/3 to 3/3"),
        ("4/3", "the shards of 3 are 1/3 to 3/3"),
        ("2", "neither I/N, such as 2/7, nor 'auto'"),
        ("1/0", "the shards of 0"),
        ("-1/3", "neither I/N"),
        ("two/3", "neither I/N"),
    ],
)
def test_wrong_shards(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        parse_shard(text)
    result = cli("run", write(tmp_path), "-o", tmp_path / "out", "--shard", text)
    assert result.exit_code == 2 and message in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("total", [2, 7, 25])
@pytest.mark.long
def test_joined_shards_have_the_bytes_of_one_process(serial, tmp_path, total):
    """Also with more shards than runs."""
    path, out = serial
    all_shards(path, tmp_path / "out", total)
    result = joined(tmp_path / "out")
    assert result.exit_code == 0, result.output
    same(out, tmp_path / "out", "traces.npz")
    # A second time nothing changes, and then `run` has nothing to do.
    before = (tmp_path / "out" / "trials.csv").read_bytes()
    assert joined(tmp_path / "out").exit_code == 0
    assert ran(path, tmp_path / "out") == before


def test_joined_shards_need_no_computing(serial, tmp_path, monkeypatch):
    path, out = serial
    all_shards(path, tmp_path / "out", 2)
    blocks = spied(monkeypatch)
    joined(tmp_path / "out")
    ran(path, tmp_path / "out")
    assert blocks == []
    same(out, tmp_path / "out")


def test_a_lost_shard_is_refused_and_filled(serial, tmp_path, monkeypatch):
    """`merge` names it, `--missing` computes its runs only, and the bytes are those of one process."""
    path, out = serial
    all_shards(path, tmp_path / "out", 7)
    shutil.rmtree(tmp_path / "out" / "shards" / "3-of-7")
    refused = joined(tmp_path / "out")
    assert refused.exit_code == 5 and not (tmp_path / "out" / "trials.csv").exists()
    assert "runs 5 to 7 are missing (S-MPC, R-MPC)" in refused.stderr
    assert "shards without a store: 3-of-7" in refused.stderr
    blocks = spied(monkeypatch)
    ran(path, tmp_path / "out", "--missing")
    assert blocks == [("S-MPC", [5, 6, 7]), ("R-MPC", [5, 6, 7])]
    same(out, tmp_path / "out", "traces.npz")


def test_the_lost_shard_again(serial, tmp_path):
    path, out = serial
    all_shards(path, tmp_path / "out", 7, but=[3])
    shard(path, tmp_path / "out", "3/7")
    assert joined(tmp_path / "out").exit_code == 0
    same(out, tmp_path / "out")


def test_a_part_of_the_shards(serial, tmp_path):
    """`--partial` joins what is there, and the results say that they are incomplete; more shards may follow."""
    path, out = serial
    all_shards(path, tmp_path / "out", 2, but=[2])
    result = joined(tmp_path / "out", "--partial")
    assert result.exit_code == 0, result.output
    assert "10 of 20 runs" in result.stdout and "runs 10 to 19 are missing" in result.stderr
    assert len((tmp_path / "out" / "trials.csv").read_text().splitlines()) == 21
    shard(path, tmp_path / "out", "2/2")
    assert joined(tmp_path / "out").exit_code == 0
    same(out, tmp_path / "out", looks=2)


def test_a_shard_continues_and_computes_nothing_twice(serial, tmp_path, monkeypatch):
    path, _ = serial
    shard(path, tmp_path / "out", "1/2", "--only", "S-MPC")
    blocks = spied(monkeypatch)
    shard(path, tmp_path / "out", "1/2")
    assert blocks == [("R-MPC", [*range(10)])]


def test_a_shard_leaves_out_what_the_directory_has(serial, tmp_path, monkeypatch):
    """As when an experiment that is there gets more runs on a cluster."""
    path, out = serial
    ran(path, tmp_path / "out", "--runs", 12)
    blocks = spied(monkeypatch)
    all_shards(path, tmp_path / "out", 2)
    assert blocks == [("S-MPC", [*range(12, 20)]), ("R-MPC", [*range(12, 20)])]
    assert joined(tmp_path / "out").exit_code == 0
    same(out, tmp_path / "out", looks=2)


def test_shards_of_two_divisions(serial, tmp_path):
    """Runs that two shards have are the same."""
    path, out = serial
    all_shards(path, tmp_path / "out", 3, but=[2])
    all_shards(path, tmp_path / "out", 2)
    assert joined(tmp_path / "out").exit_code == 0
    same(out, tmp_path / "out")


@pytest.mark.long
def test_groups_of_an_ensemble_that_shards_cut(tmp_path):
    """Mean and covariance over the runs are those of one process, bit for bit."""
    path = write_estimation(tmp_path, runs=130, evaluate="[runs, ensemble]", execution="{max_failures: 1000}")
    ran(path, tmp_path / "serial")
    all_shards(path, tmp_path / "out", 3, but=[2])
    ran(path, tmp_path / "out", "--missing")
    same(tmp_path / "serial", tmp_path / "out")
    all_shards(path, tmp_path / "seven", 7)
    assert joined(tmp_path / "seven").exit_code == 0
    same(tmp_path / "serial", tmp_path / "seven")


def test_a_shard_joins_a_directory_with_the_first_runs(tmp_path, monkeypatch):
    """Nothing is left to compute, and the ensemble is that of one process."""
    path = write_estimation(tmp_path, runs=60, evaluate="[runs, ensemble]", execution="{max_failures: 1000}")
    ran(path, tmp_path / "serial")
    shard(path, tmp_path / "out", "1/1")
    ran(path, tmp_path / "out", "--runs", 3)
    assert joined(tmp_path / "out").exit_code == 0
    blocks = spied(monkeypatch)
    ran(path, tmp_path / "out")
    assert blocks == []
    same(tmp_path / "serial", tmp_path / "out", looks=2)


@pytest.mark.long
def test_random_delays_do_not_depend_on_the_division(tmp_path):
    """Delays of single samples and of whole runs: the bits of one process for two workers and for shards."""
    measured = "{sum: [{gaussian: {std: 0.01}}, {delayed: {samples: [0, 3]}}, {missing: {probability: 0.2}}]}"
    late = "{delayed: {samples: [0, 2], per: run}}"
    noise = f"{{process: {{gaussian: {{std: 0.01}}}}, measurement: {measured}, input: {late}}}"
    path = write(tmp_path, runs=12, noise=noise)
    alone = ran(path, tmp_path / "serial")
    assert ran(path, tmp_path / "two", jobs=2) == alone
    all_shards(path, tmp_path / "out", 5)
    assert joined(tmp_path / "out").exit_code == 0
    same(tmp_path / "serial", tmp_path / "out")


def test_shards_of_a_sweep(tmp_path):
    keys = {"sweep": "{grid: {controller.Hp: [8, 10]}}", "runs": 9}
    path = write(tmp_path, **keys)
    ran(path, tmp_path / "serial")
    all_shards(path, tmp_path / "out", 2)
    assert joined(tmp_path / "out").exit_code == 0
    same(tmp_path / "serial", tmp_path / "out")


def test_other_experiments_are_refused(serial, tmp_path):
    path, _ = serial
    shard(path, tmp_path / "out", "1/2")
    other = write(tmp_path, **KEYS, seed=8)
    shard(other, tmp_path / "other", "2/2")
    shutil.move(tmp_path / "other" / "shards" / "2-of-2", tmp_path / "out" / "shards" / "2-of-2")
    for options in ((), ("--partial",)):
        refused = joined(tmp_path / "out", *options)
        assert refused.exit_code == 5
        assert "shards/2-of-2 is a shard of another experiment than 1-of-2" in refused.stderr
    assert not (tmp_path / "out" / "trials.sqlite").exists()
    refused = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--missing")
    assert refused.exit_code == 5 and "2-of-2 holds another experiment:\n  seed" in refused.stderr


def test_a_directory_with_another_experiment_is_refused(serial, tmp_path):
    path, _ = serial
    ran(write(tmp_path, **KEYS, seed=8), tmp_path / "out", "--runs", 2)
    refused = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--shard", "1/2")
    assert refused.exit_code == 5 and "holds another experiment" in refused.stderr


def test_another_version_of_the_arithmetic_is_refused(serial, tmp_path, monkeypatch):
    path, _ = serial
    all_shards(path, tmp_path / "out", 2)
    monkeypatch.setattr("rmpc_bench.NUMERICS", 99)
    refused = joined(tmp_path / "out")
    assert refused.exit_code == 5
    assert "shards/1-of-2: S-MPC was computed by another version of the bench than this one" in refused.stderr


def test_other_code_of_the_user_is_refused(tmp_path):
    """The shards of a file that has changed between them do not make one experiment."""
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    path = write(tmp_path, methods="{A: {estimator: {file: own.py:Own}}}", runs=6)
    shard(path, tmp_path / "out", "1/2")
    (tmp_path / "own.py").write_text(OWN.replace("return self.x_hat", "return 1.0 * self.x_hat"), encoding="utf-8")
    shard(path, tmp_path / "out", "2/2")
    refused = joined(tmp_path / "out")
    assert refused.exit_code == 5
    assert "shards/2-of-2: A was computed by other code than in 1-of-2 (own.py has changed)" in refused.stderr


@pytest.mark.long
def test_components_that_end_their_process(tmp_path):
    """Shards contain them as one process does: only the bad runs fail, `merge` counts them, the bytes are equal."""
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    methods = ", ".join(f"{act}: {{estimator: {{file: own.py:Own, act: {act}}}}}" for act in ("none", "exit", "raise"))
    path = write(tmp_path, methods=f"{{{methods}}}", runs=30, time="{step: 0.1, steps: 5}")
    whole = cli("run", path, "-o", tmp_path / "whole", "-j", 1, "--progress", "none")
    assert whole.exit_code == 3
    done = shard(path, tmp_path / "out", "1/2")
    assert "2 failed, crashed 2" in done.stdout
    shard(path, tmp_path / "out", "2/2")
    result = joined(tmp_path / "out")
    assert result.exit_code == 3, result.output
    same(tmp_path / "whole", tmp_path / "out")
    names = {file.name for file in (tmp_path / "whole" / "failures").iterdir()}
    assert names == {file.name for file in (tmp_path / "out" / "failures").iterdir()} and len(names) == 4
    # Copies of the files of the user make the runs of the directory repeatable.
    shown = cli("show", tmp_path / "out", "--run", "7", "--method", "raise")
    assert "OSError: no licence" in shown.output


@pytest.mark.parametrize("content", [b"", b"garbage" * 1000])
def test_a_damaged_shard(serial, tmp_path, content):
    """`merge` names it; `--missing` computes its runs again."""
    path, out = serial
    all_shards(path, tmp_path / "out", 2)
    (tmp_path / "out" / "shards" / "2-of-2" / "trials.sqlite").write_bytes(content)
    refused = joined(tmp_path / "out")
    assert refused.exit_code in (2, 5) and "2-of-2" in refused.stderr and "Traceback" not in refused.stderr
    partial = joined(tmp_path / "out", "--partial")
    assert partial.exit_code == 0, partial.output
    assert "left out: shards/2-of-2, which cannot be read" in partial.stderr
    ran(path, tmp_path / "out", "--missing")
    same(out, tmp_path / "out", looks=2)


def test_an_empty_store_of_the_directory_is_no_store(serial, tmp_path):
    """A start that was killed has left it; shards, their plan and `merge` go on."""
    path, out = serial
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "trials.sqlite").touch()
    plan = cli("run", path, "-o", tmp_path / "out", "--dry-run")
    assert plan.exit_code == 0 and "40 of 40 trials to compute" in plan.stdout
    all_shards(path, tmp_path / "out", 2)
    result = joined(tmp_path / "out")
    assert result.exit_code == 0, result.output
    same(out, tmp_path / "out")


@pytest.mark.long
def test_a_shard_that_is_being_computed(serial, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "READER_WAITS", 0.1)
    path, _ = serial
    all_shards(path, tmp_path / "out", 2)
    with closing(sqlite3.connect(tmp_path / "out" / "shards" / "2-of-2" / "trials.sqlite", timeout=0.0)) as writer:
        writer.execute("PRAGMA locking_mode = EXCLUSIVE")
        writer.execute("BEGIN EXCLUSIVE")
        refused = joined(tmp_path / "out")
        assert refused.exit_code == 5 and "2-of-2 is being computed" in refused.stderr
        partial = joined(tmp_path / "out", "--partial")
        assert partial.exit_code == 0 and "left out: shards/2-of-2, which is being computed" in partial.stderr
        refused = cli("run", path, "-o", tmp_path / "out", "--missing")
        assert refused.exit_code == 5 and "2-of-2 is being computed" in refused.stderr


def test_no_shards(tmp_path):
    result = joined(tmp_path)
    assert result.exit_code == 2 and "there are no shards" in result.stderr


def test_the_manifest_names_the_sessions_of_the_shards(serial, tmp_path):
    path, _ = serial
    all_shards(path, tmp_path / "out", 2)
    for _ in range(2):
        joined(tmp_path / "out")
        found = json.loads((tmp_path / "out" / "manifest.json").read_text())
        assert [session["shard"] for session in found["sessions"]] == ["1-of-2", "2-of-2"]
    assert found["looks"] == [20] and found["name"] == "tiny"


def test_a_method_of_some_shards_only(serial, tmp_path):
    """Series of designs come from the shard that has computed the method."""
    path, out = serial
    shard(path, tmp_path / "out", "1/2", "--only", "S-MPC")
    shard(path, tmp_path / "out", "2/2")
    refused = joined(tmp_path / "out")
    assert refused.exit_code == 5 and "runs 0 to 9 are missing (R-MPC)" in refused.stderr
    ran(path, tmp_path / "out", "--missing")
    same(out, tmp_path / "out")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--shard", "1/2", "--missing"], "--shard computes one shard"),
        (["--shard", "1/2", "--strict"], "--strict needs all runs"),
        (["--no-report", "--strict"], "--no-report leaves out"),
        (["--missing", "--fresh"], "--fresh sets them aside"),
        (["-q", "-v"], "give -q or -v"),
        (["--engine", "serial", "--scheduler", "tcp://localhost:1"], "--scheduler needs --engine dask"),
    ],
)
def test_options_that_exclude_each_other(tmp_path, options, message):
    result = cli("run", write(tmp_path), "-o", tmp_path / "out", *options)
    assert result.exit_code == 2 and message in result.stderr


def test_shards_that_a_run_does_not_use(serial, tmp_path):
    path, _ = serial
    shard(path, tmp_path / "out", "1/2")
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none")
    assert "has shards, which are not used; with --missing their trials are taken" in result.stderr


def test_a_dry_run_of_a_shard(serial, tmp_path):
    path, _ = serial
    result = cli("run", path, "-o", tmp_path / "out", "--shard", "2/7", "-n")
    assert "shard 2/7: 6 of 6 trials to compute (S-MPC, R-MPC)" in result.stdout
    assert not (tmp_path / "out").exists()


def test_other_directories_are_no_shards(tmp_path):
    for name in ("1-of-2", "1-of-2.20260101-000000", "01-of-2", "x"):
        (tmp_path / "shards" / name).mkdir(parents=True)
        (tmp_path / "shards" / name / "f").touch()
    assert [*shards_in(tmp_path, "f")] == [Shard(1, 2)]


def test_fresh_sets_one_shard_aside(serial, tmp_path, monkeypatch):
    path, out = serial
    all_shards(path, tmp_path / "out", 2)
    blocks = spied(monkeypatch)
    shard(path, tmp_path / "out", "2/2", "--fresh")
    assert {run for _, runs in blocks for run in runs} == {*range(10, 20)}
    assert len([*(tmp_path / "out" / "shards").iterdir()]) == 3
    assert joined(tmp_path / "out").exit_code == 0
    same(out, tmp_path / "out")


STEADY = """
import time
from pathlib import Path
from rmpc_bench import single_run

@single_run
class Steady:
    def start(self, x0, run):
        self.x_hat, self.run = x0, run
    def update(self, y, k):
        while self.run % 50 > 30 and not Path(__file__).with_name("go_on").exists():
            time.sleep(0.01)
        return self.x_hat
"""


def children(pid):
    """Process numbers of the children of a process."""
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.kill
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds the workers in /proc")
def test_shards_at_the_same_time_and_kills_from_outside(tmp_path):
    """A worker of one is killed, the whole second is killed and started again: the bytes are those of one process."""
    (tmp_path / "steady.py").write_text(STEADY, encoding="utf-8")
    keys = {"methods": "{A: {estimator: {file: steady.py:Steady}}}", "execution": "{block: 5}"}
    path = write(tmp_path, runs=100, **keys)
    command = [Path(sys.executable).with_name("rmpc-bench"), "run", path, "-o", tmp_path / "out", "-j", "1"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    started = [subprocess.Popen([*command, "--shard", f"{number}/2"], **pipes) for number in (1, 2)]
    try:
        for number, process in enumerate(started, 1):
            place, deadline = tmp_path / "out" / "shards" / f"{number}-of-2", time.monotonic() + 120.0
            while (read(place) or {"done": 0})["done"] < 5 and time.monotonic() < deadline:
                time.sleep(0.02)
            assert process.poll() is None, process.communicate()
            os.kill(process.pid if number == 2 else children(process.pid)[0], signal.SIGKILL)
        (tmp_path / "go_on").touch()
        codes = [(process.communicate(timeout=120), process.returncode) for process in started]
    finally:
        for process in started:
            process.kill()
            process.communicate()
    assert [code for _, code in codes] == [0, -signal.SIGKILL], codes
    shard(path, tmp_path / "out", "2/2")
    result = joined(tmp_path / "out")
    assert result.exit_code == 0, result.output
    ran(path, tmp_path / "whole")
    same(tmp_path / "whole", tmp_path / "out")
