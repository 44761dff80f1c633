"""Numbers of an unfinished experiment rest on the runs that every method has, finished or failed.

Oracle: the numbers of a finished experiment with as many runs.
"""

import numpy as np
import pandas as pd
import pytest
from data_frames import tail_frame
from small_experiment import cli, write

import rmpc_bench
from rmpc_bench.analysis.result_rows import result_table
from rmpc_bench.claims.record import claims_table
from rmpc_bench.received.store import MissingError
from rmpc_bench.report.point_tables import trials_csv
from rmpc_bench.report.run_notes import failure_files
from rmpc_bench.report.run_tables import lost_table, tail_columns
from rmpc_bench.results.evaluate import drivers, requirements
from rmpc_bench.store.store import Store

FAILS = """
from rmpc_bench import SolverError, single_run

@single_run
class Fails:
    def __init__(self, model):
        pass
    def start(self, x0, run):
        self.x_hat, self.run = x0, run
    def update(self, y, k):
        if self.run in (5, 47) and k == 3:
            raise SolverError("no solution")
        return self.x_hat
"""
KEYS = {
    "runs": 60,
    "noise": "{process: {gaussian: {std: 0.01}}, measurement: {gaussian: {std: 0.01}}}",
    "execution": "{block: 1}",
    "statistics": "{requirement: input_power < 400, lost: 2}",
    "claims": '[{says: R is better, check: "mean(mse[R-MPC]) < mean(mse[S-MPC])", source: none}]',
}


def interrupted(monkeypatch, after):
    """Let Ctrl-C end a run behind so many stored blocks."""
    stored, add = [], Store.add_block

    def add_block(store, *arguments):
        add(store, *arguments)
        stored.append(arguments[0])
        if len(stored) == after:
            raise KeyboardInterrupt

    monkeypatch.setattr(Store, "add_block", add_block)


def killed(monkeypatch, path, directory, after, *, runs=None, only=None):
    """Compute so many blocks of an experiment."""
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        interrupted(patch, after)
        rmpc_bench.run(rmpc_bench.load_config(path, runs=runs), directory=directory, jobs=1, only=only)
    return rmpc_bench.load_results(directory)


def finished(path, directory, runs=None):
    """Compute an experiment with another number of runs."""
    return rmpc_bench.run(rmpc_bench.load_config(path, runs=runs), directory=directory, jobs=1)


def numbers(results):
    """Return what tables and claims say, as text."""
    tables = rmpc_bench.summarise(results)
    frames = [tables.described, tables.compared, drivers(results).frame, requirements(results).frame]
    frames += [pd.DataFrame(lost_table(results.trials)), tail_frame(results.trials)]
    texts = [frame.to_csv() for frame in frames]
    return [*texts, tables.to_markdown(), claims_table(rmpc_bench.judge(results)), tail_columns(results.trials)]


def table_of(results):
    """Return the rows of the primary metric."""
    tables = rmpc_bench.summarise(results)
    return {row.method: row for row in result_table(*tables.points[0], results.trials.metrics[0]).rows}


def test_a_killed_run_without_a_failure(tmp_path, monkeypatch):
    """A has runs 0 to 47, B 0 to 46, all ok, 60 planned: n = 47, no failure, 47 of 60."""
    path = write(tmp_path, **KEYS)
    killed(monkeypatch, path, tmp_path / "a", 47, only=["R-MPC"])
    results = killed(monkeypatch, path, tmp_path / "a", 48, only=["S-MPC"])
    assert [len(each.runs) for each in (results.stored, results.trials)] == [48, 47]
    assert (results.extent.text, results.extent.n, results.extent.absent) == ("47 of 60 runs", 47, ())
    assert not results.is_final and not results.extent.is_complete
    assert {(row.n, row.n_failed) for row in table_of(results).values()} == {(47, 0)}
    assert numbers(results) == numbers(finished(path, tmp_path / "b", 47))
    trials_csv(results.stored, tmp_path / "trials.csv")
    assert len((tmp_path / "trials.csv").read_text().splitlines()) == 1 + 48 + 47
    whole = finished(path, tmp_path / "a")
    assert whole.trials is whole.stored and whole.extent.is_complete and whole.is_final


@pytest.mark.long
def test_a_killed_run_with_failures(tmp_path, monkeypatch):
    """B failed in run 5 and in run 47, which A does not have: n = 47, failed 1, pairs 46."""
    (tmp_path / "own.py").write_text(FAILS, encoding="utf-8")
    methods = "{S-MPC: {estimator: {kind: kalman}}, B: {estimator: {file: 'own.py:Fails'}}}"
    path = write(tmp_path, **KEYS | {"methods": methods, "claims": None})
    killed(monkeypatch, path, tmp_path / "a", 47, only=["S-MPC"])
    results = killed(monkeypatch, path, tmp_path / "a", 48, only=["B"])
    rows, row = table_of(results), table_of(results)["B"]
    assert (row.n, row.n_failed, row.n + row.n_failed) == (46, 1, 47) and rows["S-MPC"].n == 47
    assert (row.compared["n_pairs"], row.compared["failed_only"]) == (46, 1)
    assert (results.trials.n_failed_trials, results.stored.n_failed_trials) == (1, 2)
    assert [each.run for each in results.trials.notes["B"].failures] == [5]
    assert numbers(results) == numbers(finished(path, tmp_path / "b", 47))
    assert [*failure_files(results.trials, "a", results.uncertainty, {})] == ["B-5.txt"]


def test_a_method_that_is_added_later(tmp_path, monkeypatch):
    """Without a row it restricts nothing and is not computed; with some rows all methods rest on these."""
    three = "{S-MPC: {estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.1}}, "
    path = write(
        tmp_path, **KEYS | {"runs": 12, "methods": three + "F: {estimator: {kind: fading-kalman, alpha: 1.01}}}"}
    )
    before = rmpc_bench.run(rmpc_bench.load_config(path), directory=tmp_path / "a", jobs=1, only=["S-MPC", "R-MPC"])
    rows = table_of(before)
    assert [*rows] == ["S-MPC", "R-MPC", "F"] and (rows["F"].word, rows["F"].n) == ("not computed", 0)
    assert np.isnan(rows["F"].mean.value) and not rows["F"].compared and rows["R-MPC"].n == 12
    assert (before.extent.text, before.extent.is_complete) == ("12 of 12 runs, F not computed", False)
    results = killed(monkeypatch, path, tmp_path / "a", 5)
    assert {row.n for row in table_of(results).values()} == {5} and results.extent.text == "5 of 12 runs"
    assert len(results.stored.frame) == 12 + 12 + 5


def test_a_sweep_that_has_not_come_to_its_end(tmp_path, monkeypatch):
    """Each point has runs of its own; a method may be absent at one, and a point without a run is blank."""
    swept = KEYS | {"runs": 6, "sweep": "{grid: {controller.Hp: [8, 9, 10]}}", "claims": None}
    path = write(tmp_path, **swept)
    results = killed(monkeypatch, path, tmp_path / "a", 3)
    shown, page = cli("report", tmp_path / "a"), tmp_path / "a" / "report.md"
    assert shown.exit_code == 0 and "INTERRUPTED at 2 of 18 runs at 3 points" in shown.stdout
    assert "1 not computed." in shown.stdout and "**Unfinished: 2 of 18 runs at 3 points.**" in page.read_text("utf-8")
    assert [(point.n, point.absent) for point in results.extent.points] == [
        (1, ()),
        (1, ("R-MPC",)),
        (0, ("S-MPC", "R-MPC")),
    ]
    assert (results.extent.text, results.extent.absent) == ("2 of 18 runs at 3 points", ())
    assert [each.coordinates for each in results.extent.blank] == [{"controller.Hp": "10"}]
    results = killed(monkeypatch, path, tmp_path / "a", 14)
    sizes = [point.n for point in results.extent.points]
    assert sizes == [3, 3, 2] and results.extent.text == "8 of 18 runs at 3 points"
    assert [len(point.runs) for point in results.stored.points] == [3, 3, 3]
    assert (len(results.trials.frame), len(results.stored.frame)) == (16, 17)
    summary = rmpc_bench.summarise(results).described
    assert summary.groupby("controller.Hp", sort=False)["n"].unique().map(list).tolist() == [[n] for n in sizes]


def test_shards_that_are_half_done(tmp_path, monkeypatch):
    """Two halves of which one lacks runs of a method; and two methods without any common run."""
    path = write(tmp_path, **KEYS | {"runs": 20, "claims": None})
    options = ["-o", tmp_path / "a", "-j", 1, "--progress", "none"]
    assert cli("run", path, *options, "--shard", "1/2").exit_code == 0
    assert cli("run", path, *options, "--shard", "2/2", "--only", "R-MPC").exit_code == 0
    assert cli("merge", tmp_path / "a", "--partial").exit_code == 0
    results = rmpc_bench.load_results(tmp_path / "a")
    assert results.trials.runs.tolist() == [*range(10)] and results.extent.text == "10 of 20 runs"
    assert {row.n for row in table_of(results).values()} == {10}
    options[1] = tmp_path / "b"
    assert cli("run", path, *options, "--shard", "1/2", "--only", "S-MPC").exit_code == 0
    assert cli("run", path, *options, "--shard", "2/2", "--only", "R-MPC").exit_code == 0
    refused = cli("merge", tmp_path / "b", "--partial")
    assert refused.exit_code == 2 and "no run is stored of every method yet" in refused.stderr
    with pytest.raises(MissingError, match="no run is stored of every method yet"):
        rmpc_bench.load_results(tmp_path / "b")


def test_a_look_sees_the_runs_of_every_method(tmp_path, monkeypatch):
    """A rule is applied when all methods have the runs of a look, however many one of them has."""
    stop = "{decide: claims, min_runs: 8, max_runs: 32}"
    path = write(tmp_path, **KEYS | {"stop": stop})
    results = killed(monkeypatch, path, tmp_path / "a", 13)
    assert results.experiment.stop.looks.runs == () and results.extent.text == "6 of 8 runs"
    found = [finished(path, tmp_path / name) for name in "ab"]
    assert found[0].experiment.stop.looks == found[1].experiment.stop.looks
    assert found[0].trials.frame.equals(found[1].trials.frame)


def test_an_archive_of_an_unfinished_experiment(tmp_path, monkeypatch):
    """What is packed is verified: summary.csv follows from the common ones of its rows."""
    path = write(tmp_path, **KEYS | {"runs": 12, "claims": None})
    killed(monkeypatch, path, tmp_path / "a", 4, only=["R-MPC"])
    killed(monkeypatch, path, tmp_path / "a", 7, only=["S-MPC"])
    assert cli("report", tmp_path / "a").exit_code == 0
    assert cli("pack", tmp_path / "a", "-o", tmp_path / "a.zip").exit_code == 0
    assert cli("verify", tmp_path / "a.zip", "--no-run").exit_code == 0
    result = cli("verify", tmp_path / "a.zip")
    assert "R-MPC: 3 runs are computed only here" in result.stdout and "equal bytes" in result.stdout
    assert "summary.csv" not in result.stdout


def test_ensembles_have_the_common_runs(tmp_path, monkeypatch):
    """A moment over the runs rests on groups of which every run counts."""
    path = write(tmp_path, **KEYS | {"runs": 12, "evaluate": "[runs, ensemble]", "claims": None})
    killed(monkeypatch, path, tmp_path / "a", 4, only=["R-MPC"])
    results = killed(monkeypatch, path, tmp_path / "a", 7, only=["S-MPC"])
    assert {results.trials.n_of("cov(e)", name) for name in ("S-MPC", "R-MPC")} == {4}
    expected = finished(path, tmp_path / "b", 4).trials
    for name in ("S-MPC", "R-MPC"):
        found = [trials.matrix_series("cov(e)", name) for trials in (results.trials, expected)]
        np.testing.assert_array_equal(*found)
