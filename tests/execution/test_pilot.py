"""The pilot of an experiment: what it measures, and what it makes of it."""

import subprocess
import sys

import numpy as np
import pytest
import tuned_experiment
from small_experiment import cli, ran, write

from rmpc_bench import load_config, load_results, run
from rmpc_bench.execution.pilot import Pilot, PilotError, _with_runs, enlarged, measure, runs_of_shard

MADE = Pilot(n_runs=1000, n_pilot=30, start=2.0, per_run=0.1, report=4.0, megabytes=200.0)


def test_times_of_the_whole_and_of_shards():
    """2 + 1000 * 0.1 + 4; ten shards of 100 runs without a report; two workers share the runs."""
    assert MADE.total == pytest.approx(106.0)
    assert MADE.of_shard(10) == pytest.approx(12.0)
    assert MADE.elapsed(2) == pytest.approx(2.0 + 50.0 + 1.2 + 4.0)
    assert MADE.elapsed(1) == pytest.approx(MADE.total)


@pytest.mark.parametrize(("n_runs", "shards", "largest"), [(1000, 3, 350), (200, 7, 29), (60, 2, 50), (5, 8, 1)])
def test_runs_of_a_shard(n_runs, shards, largest):
    assert runs_of_shard(n_runs, shards) == largest
    assert runs_of_shard(n_runs, shards) * shards >= n_runs


@pytest.mark.parametrize("sweep", [None, "{grid: {controller.Hp: [5, 10]}}"])
def test_enlarged_tables_are_sorted_and_complete(tmp_path, sweep):
    """Run 6 + i has the numbers of run i."""
    ran(write(tmp_path, sweep=sweep), tmp_path / "out")
    results = load_results(tmp_path / "out")
    larger = enlarged(results, 100)
    assert len(larger.trials.frame) == len(results.trials.frame) // 6 * 100
    for small, large in zip(results.trials.each, larger.trials.each, strict=True):
        assert large.runs.tolist() == list(range(100)) and len(large.uncertainty) == 100
        for method in small.methods:
            column = large.column("mse", method)
            np.testing.assert_array_equal(column, np.resize(small.column("mse", method), 100))
    assert list(larger.trials.frame.columns) == list(results.trials.frame.columns)


@pytest.mark.long
def test_a_pilot_measures_in_its_own_process(tmp_path):
    found = measure(write(tmp_path, runs=5000))
    assert found.n_runs == 5000 and 2 <= found.n_pilot <= 5000
    assert found.per_run > 0 and found.start > 0.3 and found.report > 0.1 and 50 < found.megabytes < 2000


@pytest.mark.long
def test_the_memory_is_not_that_of_the_process_that_asks():
    """Of half a gigabyte here, which a new process inherits as its largest memory, nothing is counted."""
    here = np.ones(70_000_000)
    code = "from rmpc_bench.execution.pilot import _megabytes; print(_megabytes())"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert here.nbytes > 5e8 and 10 < float(found.stdout) < 400


def test_a_pilot_of_a_stopping_rule_ends(tmp_path):
    """The rule asks for 20 runs, of which a pilot of 2 would never have enough."""
    config = load_config(write(tmp_path, stop="{resolve: 50%, min_runs: 5, max_runs: 20}"))
    results = run(_with_runs(config, 2), directory=tmp_path / "out", jobs=1)
    assert config.stop is not None and len(results.trials.runs) == 2


def test_a_pilot_of_a_tuned_experiment_has_its_own_runs(tmp_path):
    """Oracle: 2 of 8 runs, and no file of a search; tuning would load the experiment with all runs."""
    config = load_config(tuned_experiment.write(tmp_path, tune="{budget: 2, runs: 2, regret: false}"))
    results = run(_with_runs(config, 2), directory=tmp_path / "out", jobs=1)
    assert config.tuning is not None and len(results.trials.runs) == 2
    assert not (tmp_path / "out" / "tuning.json").exists()


def test_a_pilot_that_fails_is_said(tmp_path):
    with pytest.raises(PilotError, match="no_such_module"):
        measure(write(tmp_path), modules=["no_such_module"])


@pytest.mark.long
def test_check_prints_time_memory_and_shards(tmp_path):
    path = write(tmp_path, runs=400)
    found = cli("check", path, "--shards", 4)
    assert found.exit_code == 0, found.output
    assert "s of CPU time, from" in found.stdout
    assert "MB of memory in the process that writes the report" in found.stdout
    assert "4, each of at most 100 runs" in found.stdout
    assert "time limit for a batch script: 00:0" in found.stdout
    assert "measure time and model mismatch: rmpc-bench check ... --deep" in " ".join(cli("check", path).stdout.split())
