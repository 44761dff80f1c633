"""progress.json and `rmpc-bench status`: counts, means with their errors, and writers that have died."""

import json
import os
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_experiment import cli, ran, write

from rmpc_bench.execution import progress_file
from rmpc_bench.execution.status import read_status, time_text
from rmpc_bench.results.running import RunningMean, mean_of

SLOW = """
import time
from rmpc_bench import single_run

@single_run
class Slow:
    def start(self, x0, run):
        self.x_hat, self.run = x0, run
    def update(self, y, k):
        if self.run == 5:
            time.sleep(1000)
        return self.x_hat
"""


def shards(path, out, *texts):
    for text in texts:
        result = cli("run", path, "-o", out, "-j", 1, "--progress", "none", "--shard", text)
        assert result.exit_code == 0, result.output


def changed(directory, **keys):
    """Change some keys of a progress file."""
    file = directory / "progress.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | keys))


def test_joined_means_are_those_of_all_values():
    """Oracle: the mean and the standard error of the whole sample."""
    rng = np.random.default_rng(3)
    values = rng.lognormal(size=300)
    values[[5, 70]] = np.inf, np.nan
    found = RunningMean()
    for part in np.split(values, [1, 2, 40, 40, 170]):
        found = found.joined(mean_of(part))
    good = values[np.isfinite(values)]
    assert (found.n, found.n_other) == (298, 2)
    np.testing.assert_allclose(found.mean, good.mean(), rtol=1e-12)
    np.testing.assert_allclose(found.se, good.std(ddof=1) / np.sqrt(298), rtol=1e-12)


def test_the_file_of_a_finished_run(tmp_path):
    """Its means are those of summary.csv."""
    out = tmp_path / "out"
    ran(write(tmp_path), out)
    data = progress_file.read(out)
    assert (data["state"], data["done"], data["total"], data["failed"]) == ("finished", 12, 12, {})
    summary = pd.read_csv(out / "summary.csv").query("metric == 'mse'").set_index("method")
    status = read_status(out).to_json()
    assert [each["method"] for each in status["means"]] == ["S-MPC", "R-MPC"]
    for each in status["means"]:
        np.testing.assert_allclose(each["mean"], summary.loc[each["method"], "mean"], rtol=1e-5)
        np.testing.assert_allclose(each["se"], summary.loc[each["method"], "se"], rtol=1e-5)
    text = cli("status", out).stdout
    assert text.startswith("tiny   12 of 12 trials (100 %), 0 failed") and "finished" in text


def test_runs_that_are_computed_again_count_once(tmp_path):
    out = tmp_path / "out"
    ran(write(tmp_path, metrics="[mse]"), out)
    ran(write(tmp_path), out)
    data = progress_file.read(out)
    assert (data["done"], data["total"]) == (12, 12) and [each["n"] for each in data["means"]] == [6, 6]


def test_a_run_with_nothing_to_do_leaves_the_file(tmp_path):
    path, out = write(tmp_path), tmp_path / "out"
    ran(path, out)
    before = (out / "progress.json").read_bytes()
    ran(path, out)
    assert (out / "progress.json").read_bytes() == before
    # One that is lost is made again from the store.
    (out / "progress.json").unlink()
    ran(path, out)
    keys = ("done", "total", "means", "failed")
    assert [json.loads(before)[key] for key in keys] == [progress_file.read(out)[key] for key in keys]


def test_shards_that_are_there_and_one_that_is_not(tmp_path):
    path, out = write(tmp_path, runs=9), tmp_path / "out"
    shards(path, out, "1/3", "3/3")
    found = read_status(out)
    assert (found.done, found.total, found.not_computed) == (12, 18, 6)
    assert [(part.name, part.state) for part in found.shards] == [
        ("1-of-3", "finished"),
        ("2-of-3", "absent"),
        ("3-of-3", "finished"),
    ]
    text = str(found)
    assert "12 of 18 trials (67 %)" in text and "6 missing trials that no process computes" in text
    assert "no file: not started, or lost" in text
    whole = pd.read_csv(ran_table(path, tmp_path))
    values = whole[(whole.method == "S-MPC") & ~whole.run.between(3, 5)].mse
    [mean] = [each for each in found.to_json()["means"] if each["method"] == "S-MPC"]
    np.testing.assert_allclose([mean["mean"], mean["se"]], [values.mean(), values.sem()], rtol=1e-9)


def test_of_several_divisions_the_newest_one_counts(tmp_path):
    """Oracle: a directory with that division only."""
    path, out, alone = write(tmp_path, runs=9), tmp_path / "out", tmp_path / "alone"
    shards(path, out, "1/2", "2/2", "1/3", "3/3")
    shards(path, alone, "1/3", "3/3")
    found, expected = read_status(out).to_json(), read_status(alone).to_json()
    assert [part["name"] for part in found["shards"]] == ["1-of-3", "2-of-3", "3-of-3"]
    for key in ("done", "total", "not_computed", "failed", "means"):
        assert found[key] == expected[key]


def ran_table(path, tmp_path):
    ran(path, tmp_path / "whole")
    return tmp_path / "whole" / "trials.csv"


def test_the_whole_directory_after_merge(tmp_path):
    """The newest file decides what is shown."""
    path, out = write(tmp_path), tmp_path / "out"
    shards(path, out, "1/2")
    assert cli("merge", out, "--partial").exit_code == 0
    [part] = read_status(out).shards
    assert (part.name, part.state, part.done, part.total) == ("", "incomplete", 6, 12)
    shards(path, out, "2/2")
    assert [part.name for part in read_status(out).shards] == ["1-of-2", "2-of-2"]
    assert cli("merge", out).exit_code == 0
    [part] = read_status(out).shards
    assert (part.state, part.done, part.total) == ("finished", 12, 12)


def test_json_is_all_that_a_program_needs(tmp_path):
    path, out = write(tmp_path), tmp_path / "out"
    shards(path, out, "1/2")
    data = json.loads(cli("status", out, "--json").stdout)
    assert (data["done"], data["total"], data["metric"]) == (6, 12, "mse")
    assert [part["state"] for part in data["shards"]] == ["finished", "absent"]


@pytest.mark.parametrize(
    ("keys", "age", "state"),
    [
        ({"pid": 2**22 + 1}, 1.0, "running"),
        ({"pid": 2**22 + 1}, 5.0, "killed"),
        ({"pid": os.getpid()}, 5.0, "running"),
        ({"pid": os.getpid()}, 60.0, "stale"),
        ({"host": "elsewhere", "pid": 2**22 + 1}, 5.0, "running"),
        ({"host": "elsewhere", "pid": 2**22 + 1}, 60.0, "stale"),
        # The clock of the other machine may be ahead.
        ({"host": "elsewhere"}, -60.0, "running"),
    ],
)
def test_writers_that_have_died(tmp_path, keys, age, state):
    out = tmp_path / "out"
    ran(write(tmp_path), out)
    now = datetime.now(UTC)
    updated = (now - timedelta(seconds=age)).isoformat()
    changed(out, state="running", done=6, rate=3.0, left_seconds=2.0, updated=updated, **keys)
    found = read_status(out, now=now)
    assert [part.state for part in found.shards] == [state]
    assert found.rate == (3.0 if state == "running" else 0.0)
    assert found.left_seconds == (2.0 if state == "running" else None)
    assert found.not_computed == (0 if state == "running" else 6)


@pytest.mark.kill
@pytest.mark.parametrize(("number", "state"), [(signal.SIGTERM, "interrupted"), (signal.SIGKILL, "killed")])
def test_a_shard_that_is_ended(tmp_path, number, state):
    """While it hangs its file is renewed; after its end `status` says so, and the same command would continue."""
    (tmp_path / "slow.py").write_text(SLOW, encoding="utf-8")
    path = write(tmp_path, methods="{A: {estimator: {file: slow.py:Slow}}}", runs=8)
    command = [Path(sys.executable).with_name("rmpc-bench"), "run", path, "-o", tmp_path / "out", "--shard", "1/1"]
    process = subprocess.Popen(
        [*command, "-j", "1", "-s", "execution.block=1"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    place, deadline = tmp_path / "out" / "shards" / "1-of-1", time.monotonic() + 120.0
    try:
        while (progress_file.read(place) or {"done": 0})["done"] < 5 and time.monotonic() < deadline:
            time.sleep(0.1)
        before = progress_file.read(place)["updated"]
        while progress_file.read(place)["updated"] == before and time.monotonic() < deadline:
            time.sleep(0.1)
        [part] = read_status(tmp_path / "out").shards
        assert (part.state, part.done, part.total) == ("running", 5, 8)
    finally:
        process.send_signal(number)
        process.communicate(timeout=60)
    later = datetime.now(UTC) + timedelta(seconds=5)
    [part] = read_status(tmp_path / "out", now=later).shards
    assert (part.state, part.done) == (state, 5)
    assert part.why == ("Terminated" if number == signal.SIGTERM else "")


def test_no_progress_file(tmp_path):
    result = cli("status", tmp_path)
    assert result.exit_code == 2 and "there is no progress.json" in result.stderr


def test_times_in_words():
    assert [time_text(s) for s in (0.0, 119.0, 120.0, 7199.0, 7200.0, 172799.0, 172800.0)] == [
        *("0 s", "119 s", "2 min", "120 min", "2.0 h", "48.0 h", "2.0 d")
    ]


def test_a_file_that_cannot_be_written_does_not_end_the_run(tmp_path, monkeypatch):
    def refuse(path, text):
        raise OSError("no space left")

    monkeypatch.setattr(progress_file, "replace_text", refuse)
    ran(write(tmp_path), tmp_path / "out")
    assert not (tmp_path / "out" / "progress.json").exists()


def test_options_for_less_and_more_text(tmp_path):
    path = write(tmp_path, uncertainty="{eps: +-20%}")
    quiet = cli("run", path, "-o", tmp_path / "a", "-j", 1, "-q")
    assert quiet.exit_code == 0 and quiet.stderr == "" and quiet.stdout.startswith("tiny   6 of 6 runs, 0 failed, ")
    verbose = cli("run", path, "-o", tmp_path / "b", "-j", 1, "-v", "--progress", "none")
    assert f"written: {tmp_path / 'b' / 'trials.csv'}" in verbose.stderr and " s, report " in verbose.stderr


def test_without_a_report(tmp_path):
    path, out = write(tmp_path), tmp_path / "out"
    result = cli("run", path, "-o", out, "-j", 1, "--progress", "none", "--no-report")
    assert result.exit_code == 0 and "runs 0 to 5, 12 of 12 trials, 0 failed" in result.stdout
    assert not (out / "trials.csv").exists()
    assert cli("report", out).exit_code == 0
    assert (out / "trials.csv").read_bytes() == ran(path, tmp_path / "other")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Return the text of the progress file of a run."""
    directory = tmp_path_factory.mktemp("finished")
    ran(write(directory, runs=1), directory / "out")
    return (directory / "out" / "progress.json").read_text()


@pytest.mark.parametrize("content", ['{"state": "running"}', '{"updated": 3}', "[]", "{", '{"updated": "today"}'])
def test_a_damaged_file(tmp_path, content):
    """One line and exit code 2, no traceback."""
    (tmp_path / "progress.json").write_text(content)
    result = cli("status", tmp_path)
    assert result.exit_code == 2 and "progress.json" in result.stderr and "Traceback" not in result.stderr


@pytest.mark.parametrize("key", ["means", "done", "failed", "runs", "host", "every", "rate", "pid", "left_seconds"])
@pytest.mark.parametrize("value", [None, "x", [1], {"a": 1}, -1e300])
def test_a_file_with_other_values(tmp_path, finished, key, value):
    (tmp_path / "progress.json").write_text(finished)
    changed(tmp_path, state="running", **{key: value})
    for options in ((), ("--json",)):
        assert cli("status", tmp_path, *options).exit_code in (0, 2)
