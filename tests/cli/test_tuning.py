"""Tuning on the command line: what is shown, what is computed once, interruption, shards and archives."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from small_experiment import cli, ran, spied
from tuned_experiment import record, run, write

from rmpc_bench import load_config, load_results
from rmpc_bench.execution.status import read_status
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.results.tuning import read_record

COMMAND = Path(sys.executable).with_name("rmpc-bench")
RKF = "RKF: {estimator: {kind: robust-kalman, c: 0.1}, tune: {estimator.c: [0.001, 1]}}"
OWN = """
import time
from rmpc_bench import single_run

@single_run
class Slow:
    def __init__(self, model, *, gain: float = 0.5):
        self.gain = gain
    def start(self, x0):
        self.x_hat = x0
    def update(self, y, k):
        if k == 2:
            time.sleep(0.02)
        self.x_hat = self.x_hat + self.gain * (y - self.x_hat)
        return self.x_hat
"""
SLOW = "{KF: {estimator: {kind: kalman}}, slow: {estimator: {file: 'own.py:Slow'}, tune: {estimator.gain: [0.01, 1]}}}"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A configuration, its finished directory and what the command line has shown."""
    directory = tmp_path_factory.mktemp("finished")
    path = write(directory, figures="[boxplot]")
    result = cli("run", path, "-o", directory / "out", "-j", 1, "--progress", "plain")
    assert result.exit_code == 0, result.output
    return path, directory / "out", result


def test_progress_names_the_tuning(finished):
    """One display for all rounds, and then that of the experiment."""
    lines = [line for line in finished[2].stderr.splitlines() if line.endswith(" trials")]
    # 6 values x 5 runs, and 7 rows x 8 runs for the regret.
    assert lines == ["tuning: 1 method x 6 values, 5 runs: 86 trials", "tuned: 16 trials"]


def test_check_and_dry_run_name_its_trials(tmp_path):
    path = write(tmp_path)
    shown = " ".join(cli("check", path).stdout.split())
    assert "tuning at most 30 trials (1 method x 6 values x 5 runs), and 56 for the regret" in shown
    plan = cli("run", path, "-o", tmp_path / "out", "-n").stdout
    assert "tuning comes first: at most 30 trials" in plan and not (tmp_path / "out").exists()


def test_a_finished_directory_names_no_tuning(finished):
    path, directory, _ = finished
    plan = cli("run", path, "-o", directory, "-n").stdout
    assert "0 of 16 trials to compute" in plan and "tuning comes first" not in plan


def test_the_same_command_again_does_nothing(finished, monkeypatch):
    """It shows the same, and neither the configuration nor tuning.json is read by a second one."""
    path, directory, first = finished
    blocks = spied(monkeypatch)
    before = {file: file.stat().st_mtime_ns for file in directory.rglob("*") if file.is_file()}
    again = cli("run", path, "-o", directory, "-j", 1, "--progress", "plain", "-v")
    assert again.exit_code == 0 and not blocks
    assert "nothing has changed" in again.stderr
    assert {file: file.stat().st_mtime_ns for file in directory.rglob("*") if file.is_file()} == before
    assert again.stdout.split("\n", 1)[1] == first.stdout.split("\n", 1)[1]


def test_another_record_is_noticed(finished, tmp_path):
    """tuning.json decides the configuration: without it the same trials are found again, and the same bytes."""
    path = write(tmp_path)
    ran(path, tmp_path / "out")
    before = record(tmp_path / "out")
    (tmp_path / "out" / "tuning.json").unlink()
    shown = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "plain")
    assert shown.exit_code == 0 and "tuning: 1 method" in shown.stderr
    assert record(tmp_path / "out") == before


def test_fresh_tunes_again(tmp_path, monkeypatch):
    path = write(tmp_path)
    run(path, tmp_path / "out", "-j", 1)
    blocks = spied(monkeypatch)
    run(path, tmp_path / "out", "-j", 1, "--fresh")
    assert sum(len(runs) for name, runs in blocks if name.startswith("KFR~")) == 6 * 5 + 7 * 8


def test_an_added_method_is_tuned_alone(tmp_path, monkeypatch):
    """In a filled directory, which keeps the method and its values."""
    path = write(tmp_path)
    run(path, tmp_path / "out", "-j", 1)
    before = read_record(tmp_path / "out")
    blocks = spied(monkeypatch)
    run(path, tmp_path / "out", "-j", 1, "--add-method", RKF)
    assert {name.partition("~")[0] for name, _ in blocks} == {"RKF"}
    after = read_record(tmp_path / "out")
    assert len(after) == 2
    for key, found in before.items():
        np.testing.assert_array_equal(found.tuning, after[key].tuning)
    blocks.clear()
    run(path, tmp_path / "out", "-j", 1)
    assert not blocks
    assert [each.method for each in load_results(tmp_path / "out").tuning.searches] == ["KFR", "RKF"]


def test_only_an_added_method_is_tuned(tmp_path, monkeypatch):
    """The section is there for it, and a later command without the option finds it in the directory."""
    path = write(tmp_path, methods="{KF: {estimator: {kind: kalman}}}")
    run(path, tmp_path / "out", "-j", 1, "--add-method", RKF)
    blocks = spied(monkeypatch)
    run(path, tmp_path / "out", "-j", 1)
    assert not blocks
    assert [each.method for each in load_results(tmp_path / "out").tuning.searches] == ["RKF"]


def test_smoke_tunes_with_three_values(tmp_path, monkeypatch):
    path = write(tmp_path)
    blocks = spied(monkeypatch)
    run(path, tmp_path / "out", "-j", 1, "--smoke")
    assert sum(len(runs) for name, runs in blocks if "~" in name) == 3 * 4
    search = load_results(tmp_path / "out").tuning.search("KFR")
    assert search.tuning.shape == (3, 4) and search.test is None


def test_an_error_in_the_tuning_loses_nothing(finished, tmp_path, monkeypatch):
    """Finished blocks are stored; the same command goes on and ends with the same bytes."""
    from rmpc_bench.execution import missing

    path, whole, _ = finished
    stored, store_block = [], missing.store_block

    def full(store, point, done):
        if len(stored) == 5:
            raise OSError("no space left")
        stored.append(done.task.method)
        store_block(store, point, done)

    monkeypatch.setattr(missing, "store_block", full)
    assert cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none").exit_code != 0
    assert not (tmp_path / "out" / "tuning.json").exists()
    [part] = read_status(tmp_path / "out").shards
    assert (part.state, part.why, part.done, part.total) == ("interrupted", "OSError", 25, 86)
    shown = " ".join(cli("status", tmp_path / "out").stdout.split())
    assert "interrupted (OSError)" in shown and "; tuning: 1 method x 6 values, 5 runs" in shown
    monkeypatch.setattr(missing, "store_block", store_block)
    blocks = spied(monkeypatch)
    assert ran(path, tmp_path / "out") == (whole / "trials.csv").read_bytes()
    # Of the blocks of six values, one each, the last was not stored.
    assert stored == [f"KFR~{number}" for number in range(5)]
    assert {name for name, runs in blocks if runs == [0, 1, 2, 3, 4]} == {"KFR~5"}
    assert record(tmp_path / "out") == record(whole)
    [part] = read_status(tmp_path / "out").shards
    assert (part.state, part.stage, part.done, part.total) == ("finished", "", 16, 16)


@pytest.mark.kill
@pytest.mark.slow
def test_killed_and_interrupted_in_the_tuning(tmp_path):
    """By kill -9 and by Ctrl-C, with an estimator from a file, which is tuned as any other."""
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    keys = {"methods": SLOW, "tune": "{budget: 3, runs: 12, regret: false}", "execution": "{block: 1}"}
    path = write(tmp_path, **keys)
    run(path, tmp_path / "whole")
    for sent in (signal.SIGKILL, signal.SIGINT):
        interrupted(path, tmp_path / "out", sent)
        assert not (tmp_path / "out" / "tuning.json").exists()
    run(path, tmp_path / "out", "-j", 1)
    assert record(tmp_path / "out") == record(tmp_path / "whole")
    search = load_results(tmp_path / "out").tuning.search("slow")
    assert search.default == (0.5,) and 0.01 <= search.values["estimator.gain"] <= 1


def interrupted(path, directory, sent):
    """Run until trials of the tuning are stored, and send a signal."""
    arguments = [COMMAND, "run", path, "-o", directory, "-j", "1", "--progress", "none", "--no-report"]
    process = subprocess.Popen([str(each) for each in arguments], stderr=subprocess.DEVNULL, start_new_session=True)
    before, deadline = changes(directory), time.monotonic() + 60
    while changes(directory) == before and time.monotonic() < deadline:
        time.sleep(0.01)
    (os.killpg if sent == signal.SIGKILL else os.kill)(process.pid, sent)
    process.wait()
    assert process.returncode == (-signal.SIGKILL if sent == signal.SIGKILL else 130)


def changes(directory):
    """Times of the last changes of the stored trials of the tuning."""
    return [file.stat().st_mtime_ns for file in directory.glob("tuning/*/trials.sqlite")]


def test_shards_tune_alike(finished, tmp_path):
    """Each by itself, and the joined directory has the record and the bytes of one process."""
    path, whole, _ = finished
    for number in (1, 2):
        run(path, tmp_path / "out", "-j", 1, "--shard", f"{number}/2")
        assert record(tmp_path / "out" / "shards" / f"{number}-of-2") == record(whole)
    assert cli("merge", tmp_path / "out").exit_code == 0
    assert record(tmp_path / "out") == record(whole)
    assert (tmp_path / "out" / "trials.csv").read_bytes() == (whole / "trials.csv").read_bytes()
    assert load_results(tmp_path / "out").tuning.search("KFR").values == load_results(whole).tuning.search("KFR").values


def test_status_shows_the_tuning_of_a_shard(tmp_path, monkeypatch):
    """Its trials are counted; a shard that is not there has those of the experiment."""
    from rmpc_bench.execution.tuning import tune

    seen = []

    def test(rounds, searches, found, tested):
        seen.append(read_status(tmp_path / "out"))
        raise OSError("no space left")

    monkeypatch.setattr(tune, "_test", test)
    path = write(tmp_path)
    assert cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none", "--shard", "1/2").exit_code != 0
    [here, other] = seen[0].shards
    assert (here.name, here.state, here.runs, here.total) == ("1-of-2", "running", (0, 4), 86)
    assert here.stage == "tuning: 1 method x 6 values, 5 runs"
    # The filter with its default is the other one, so far.
    assert (other.state, other.runs, other.total) == ("absent", (4, 8), 4)


def test_shards_use_the_record_of_their_directory(finished, tmp_path, monkeypatch):
    """So that an array job tunes once."""
    path, whole, _ = finished
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "tuning.json").write_bytes(record(whole))
    blocks = spied(monkeypatch)
    run(path, tmp_path / "out", "-j", 1, "--shard", "1/2")
    assert blocks and not [name for name, _ in blocks if "~" in name]


def test_missing_takes_the_record_of_shards(finished, tmp_path, monkeypatch):
    path, whole, _ = finished
    run(path, tmp_path / "out", "-j", 1, "--shard", "2/2")
    blocks = spied(monkeypatch)
    assert ran(path, tmp_path / "out", "--missing") == (whole / "trials.csv").read_bytes()
    assert not [name for name, _ in blocks if "~" in name]
    assert record(tmp_path / "out") == record(whole)


def test_a_report_needs_no_simulation(finished, monkeypatch):
    _, directory, _ = finished
    blocks = spied(monkeypatch)
    before = (directory / "summary.csv").read_bytes()
    shown = cli("report", directory)
    assert shown.exit_code == 0 and not blocks
    assert (directory / "summary.csv").read_bytes() == before


def test_one_run_is_shown_again_with_the_tuned_value(finished):
    """Bit for bit as it is stored."""
    _, directory, _ = finished
    shown = cli("show", directory, "--run", "3", "--method", "KFR")
    assert shown.exit_code == 0, shown.output
    from rmpc_bench import replay

    assert replay(directory, 3, "KFR").differing == {}


def test_an_archive_is_verified(finished, tmp_path):
    """With the tuned values, which are not found again."""
    pytest.importorskip("rocrate")
    _, directory, _ = finished
    archive = tmp_path / "tuned.zip"
    assert cli("pack", directory, "-o", archive).exit_code == 0
    verified = cli("verify", archive)
    assert verified.exit_code == 0, verified.output


def test_two_directories_are_compared(finished, tmp_path):
    path, directory, _ = finished
    ran(path, tmp_path / "out", "-s", "tune.budget=4")
    compared = cli("compare", directory, tmp_path / "out")
    assert compared.exit_code == 1 and "-s tune.budget=4" in compared.stdout


def test_another_experiment_in_the_directory_is_refused_before_the_tuning(tmp_path, monkeypatch):
    path = write(tmp_path)
    run(path, tmp_path / "out", "-j", 1)
    write(tmp_path, seed=5)
    blocks = spied(monkeypatch)
    refused = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none")
    assert refused.exit_code != 0 and "holds another experiment" in refused.stderr
    assert not blocks


def test_a_damaged_record_is_named(tmp_path):
    path = write(tmp_path)
    (tmp_path / "out").mkdir()
    texts = ('{"a": {"method": "KFR"}}', "[]", '{"a": []}')
    searches = [f'{{"version": 1, "searches": {text}}}' for text in texts]
    for text in ("{}", "[1", *searches, '{"version": 2, "searches": {}}'):
        (tmp_path / "out" / "tuning.json").write_text(text)
        result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none")
        assert result.exit_code != 0
        assert "tuning.json: " in result.stderr and "tunes again" in result.stderr and "Traceback" not in result.output


def test_runs_of_a_record_that_do_not_fit_its_values_are_named(finished, tmp_path):
    data = json.loads(record(finished[1]))
    [search] = data["searches"].values()
    search["test"]["values"].pop()
    (tmp_path / "tuning.json").write_text(json.dumps(data))
    with pytest.raises(StoreError, match="is no record of a tuning .its lists differ in length"):
        read_record(tmp_path)


def test_results_without_a_record_of_the_tuning_are_reported(finished, tmp_path):
    """The methods that are not tuned were computed alone, or the record was removed."""
    path, whole, _ = finished
    shown = cli("run", path, "-o", tmp_path / "part", "-j", 1, "--progress", "none", "--only", "KF")
    assert shown.exit_code == 0 and "KF" in shown.stdout and not (tmp_path / "part" / "tuning.csv").exists()
    shutil.copytree(whole, tmp_path / "out")
    (tmp_path / "out" / "tuning.json").unlink()
    assert cli("report", tmp_path / "out").exit_code == 0
    assert not (tmp_path / "out" / "tuning.csv").exists() and (tmp_path / "out" / "summary.csv").exists()


def test_where_no_value_has_a_design_the_default_stays(tmp_path):
    methods = "{RS: {estimator: {kind: risk-sensitive, theta: 0.001}, tune: {estimator.theta: [500, 1000]}}}"
    path = write(tmp_path, methods=methods)
    assert cli("check", path).exit_code == 0
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none")
    assert result.exit_code == 0 and "tuned: RS nothing found; budget 6, 5 runs" in result.stdout


def test_an_experiment_without_tuning_is_as_before(tmp_path):
    """No file, no line and no key of its own."""
    path = write(tmp_path, tune=None, methods="{KF: {estimator: {kind: kalman}}}")
    shown = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "plain")
    assert "tuning" not in shown.stderr and not [*(tmp_path / "out").glob("tuning*")]
    assert "tune" not in load_config(path).resolved
    assert load_results(tmp_path / "out").tuning is None


def test_help_and_check_import_no_search(tmp_path):
    """SciPy's optimisation is for several parameters only, and the searches for a run."""
    path = write(tmp_path)
    code = (
        "import sys; from rmpc_bench.cli import main; sys.argv = ['rmpc-bench', 'check', sys.argv[1]]\n"
        "try: main()\nexcept SystemExit: pass\n"
        "print([name for name in ('scipy.optimize', 'scipy.stats', 'rmpc_bench.execution.tuning.search') "
        "if name in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert shown.stdout.splitlines()[-1] == "[]"
