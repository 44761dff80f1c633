"""Stopping rules: the same stop whatever the way, on the runs of each look only."""

import json
import math

import numpy as np
import pytest
from comparison_tables import table
from data_frames import comparison_frame
from small_experiment import cli, spied, write

from rmpc_bench import load_config, load_results, run
from rmpc_bench.analysis.intervals import student
from rmpc_bench.analysis.resolution import half_widths
from rmpc_bench.execution import progress_file
from rmpc_bench.results.record import Looks, StoredStop, read_looks
from rmpc_bench.results.results import load_experiment
from rmpc_bench.store.store import Store
from rmpc_bench.types import Status

NOISE = "{measurement: {gaussian: {std: 0.1}}}"
THREE = (
    "{S-MPC: {estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.1}},"
    " R2-MPC: {estimator: {kind: robust-kalman, c: 1}}}"
)
CLEAR = '{says: clear, source: additional result, check: "mean(mse[R-MPC]) < 2 * mean(mse[S-MPC])"}'
CLOSE = '{says: close, source: additional result, check: "mean(mse[R-MPC]) < mean(mse[S-MPC])"}'
WIDTH = {"noise": NOISE, "methods": THREE, "stop": "{resolve: 0.004%, min_runs: 10, every: 5, max_runs: 200}"}
FAILING = "{kind: servo-linear, perturb: {J_l: 1 + eps}, bounds: {x: [-1e-6, 1e-6]}}"
CLAIMS = {"noise": NOISE, "claims": f"[{CLEAR}, {CLOSE}]", "stop": "{decide: claims, min_runs: 5, max_runs: 40}"}


def computed(path, directory, *overrides, jobs=1, runs=None, only=None):
    """Run without a report and return the table of trials as text."""
    config = load_config(path, overrides=overrides, runs=runs)
    engine = "joblib" if jobs > 1 else None
    return run(config, directory=directory, jobs=jobs, only=only, engine=engine).trials.frame.to_csv()


def looks(directory):
    """The stored looks."""
    with Store(directory, writable=False) as store:
        return read_looks(store)


@pytest.fixture
def width(tmp_path):
    """An experiment that stops at the width of its intervals."""
    return write(tmp_path, file="width.yaml", **WIDTH)


@pytest.fixture
def claims(tmp_path):
    """An experiment with a claim that is decided at once and one that never is."""
    return write(tmp_path, file="claims.yaml", **CLAIMS)


def test_the_half_widths_are_those_of_the_printed_intervals(tmp_path):
    """Oracle: Student's t of the logs at the level of the verdicts, from the columns of the table."""
    path = write(tmp_path, noise=NOISE, methods=THREE, runs=40, statistics="{adjust: none}")
    computed(path, tmp_path / "a")
    trials = load_results(tmp_path / "a").trials
    level = comparison_frame(trials)["ci_level"].iloc[0]
    assert level >= 0.95
    found = half_widths(trials)
    assert [each.method for each in found] == ["R-MPC", "R2-MPC"]
    for each in found:
        low, high = student(np.log(trials.column("mse", each.method) / trials.column("mse", "S-MPC")), level)
        assert each.value == pytest.approx(math.expm1((high - low) / 2), rel=1e-9)


def test_one_method_has_the_width_of_its_mean(tmp_path):
    """Without a comparison."""
    path = write(tmp_path, noise=NOISE, methods="{S-MPC: {estimator: {kind: kalman}}}", runs=20)
    computed(path, tmp_path / "a")
    trials = load_results(tmp_path / "a").trials
    low, high = student(trials.column("mse", "S-MPC"), 0.95)
    (each,) = half_widths(trials)
    assert each.value == pytest.approx((high - low) / (high + low), rel=1e-9)


def test_a_signed_metric_is_relative_to_its_size(tmp_path):
    """Mean absolute value of both methods."""
    path = write(tmp_path, noise=NOISE, metrics="[steady_state_error]", runs=20, statistics="{adjust: none}")
    computed(path, tmp_path / "a")
    trials = load_results(tmp_path / "a").trials
    a, b = (np.abs(trials.column("steady_state_error", name)) for name in ("R-MPC", "S-MPC"))
    low, high = student(a - b, 0.95)
    (each,) = half_widths(trials)
    assert each.value == pytest.approx((high - low) / 2 / np.concatenate([a, b]).mean(), rel=1e-4)


def test_failures_never_meet_a_rule(tmp_path):
    """Every run leaves the range: the shares of failures are known to 7 %, the change is not known at all."""
    stop = "{resolve: 50%, min_runs: 50, max_runs: 100}"
    path = write(tmp_path, plant=FAILING, stop=stop, metrics="[mse, settling_time]")
    computed(path, tmp_path / "a")
    assert looks(tmp_path / "a").runs == (50, 100) and load_experiment(tmp_path / "a").stop.is_unmet
    assert looks(tmp_path / "a").open == ("R-MPC has no interval",)
    assert [each.value for each in half_widths(load_results(tmp_path / "a").trials)] == [math.inf]
    options = ["-o", tmp_path / "a", "--progress", "none", "--no-report", "-s", "execution.max_failures=1000"]
    assert cli("run", path, *options).exit_code == 4


@pytest.mark.parametrize("finished", [0, 1, 2, 8, 40])
def test_a_width_rests_on_the_runs_that_both_methods_finished(finished):
    """Oracle: the same table without the other runs; below two finished pairs nothing is known."""
    rng = np.random.default_rng(4)
    for infinite in (False, True):
        a, b = rng.lognormal(size=(2, 40))
        if infinite:  # counts decide: an event that mostly does not occur
            a[rng.random(40) < 0.7], b[rng.random(40) < 0.7] = np.inf, np.inf
        whole = table({"B": b[:finished], "A": a[:finished]}, may_not_occur=infinite)
        a[finished:] = b[finished:] = np.nan
        (each,) = half_widths(table({"B": b, "A": a}, may_not_occur=infinite))
        expected = half_widths(whole)[0].value if finished > 1 else math.inf
        assert each.value == pytest.approx(expected, rel=1e-12)


def test_it_stops_at_the_first_look_with_narrow_intervals(width, tmp_path):
    """Every earlier look is too wide; the bytes are those of an experiment with that number of runs."""
    csv = computed(width, tmp_path / "a")
    found = looks(tmp_path / "a")
    assert found.is_met and len(found.runs) > 2 and found.runs[0] == 10
    assert all((n - 10) % 5 == 0 for n in found.runs) and found.runs[-1] < 200
    for n in found.runs:
        assert computed(width, tmp_path / str(n), runs=n).count("\n") == 3 * n + 1
        worst = max(each.value for each in half_widths(load_results(tmp_path / str(n)).trials))
        assert (worst <= 0.004 / 100) == (n == found.runs[-1])
    assert load_results(tmp_path / str(found.runs[-1])).trials.frame.to_csv() == csv


@pytest.mark.parametrize(("jobs", "block"), [(1, 3), (2, 7), (2, 50)])
@pytest.mark.long
def test_workers_and_blocks_do_not_move_the_stop(width, tmp_path, jobs, block):
    """Same looks, same bytes."""
    csv = computed(width, tmp_path / "a")
    assert computed(width, tmp_path / "b", f"execution.block={block}", jobs=jobs) == csv
    assert looks(tmp_path / "a") == looks(tmp_path / "b")


@pytest.mark.parametrize("engine", ["joblib", "dask"])
@pytest.mark.long
def test_engines_do_not_move_the_stop(width, tmp_path, engine):
    """Tasks of the next look are added while the engine works."""
    pytest.importorskip("distributed" if engine == "dask" else "joblib")
    csv = computed(width, tmp_path / "a")
    run(load_config(width), directory=tmp_path / "b", jobs=2, engine=engine)
    assert load_results(tmp_path / "b").trials.frame.to_csv() == csv
    assert looks(tmp_path / "a") == looks(tmp_path / "b")


@pytest.mark.parametrize("after", [1, 4, 8])
@pytest.mark.long
def test_an_interruption_does_not_move_the_stop(width, tmp_path, monkeypatch, after):
    """Within a look or at its end, before it is stored or after."""
    csv = computed(width, tmp_path / "a")
    blocks, add = [], Store.add_block

    def interrupted(store, *arguments):
        add(store, *arguments)
        blocks.append(arguments[0])
        if len(blocks) == after:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Store, "add_block", interrupted)
        options = ["-j", 1, "-s", "execution.block=5", "--progress", "none"]
        assert cli("run", width, "-o", tmp_path / "b", *options).exit_code == 130
    assert computed(width, tmp_path / "b") == csv
    assert looks(tmp_path / "a") == looks(tmp_path / "b")


def test_an_interruption_between_a_look_and_its_record(claims, tmp_path, monkeypatch):
    """The look is taken again."""

    def lost(store, found):
        raise KeyboardInterrupt

    arguments = ["run", claims, "-o", tmp_path / "a", "-j", 1, "--progress", "none"]
    with monkeypatch.context() as patch:
        patch.setattr("rmpc_bench.execution.stopping.note_looks", lost)
        assert cli(*arguments).exit_code == 130
    assert looks(tmp_path / "a") is None
    assert cli(*arguments).exit_code == 4
    assert looks(tmp_path / "a").runs == (5, 10, 20, 40)


def test_twice_is_once(width, tmp_path, monkeypatch):
    """A stop is not decided again."""
    csv = computed(width, tmp_path / "a")
    monkeypatch.setattr("rmpc_bench.execution.stopping.Stopping._look", pytest.fail)
    blocks = spied(monkeypatch)
    assert computed(width, tmp_path / "a") == csv
    assert blocks == []


def test_an_unmet_rule_ends_with_4(claims, tmp_path):
    """Looks at powers of 2, named on the screen; the results are final."""
    result = cli("run", claims, "-o", tmp_path / "a", "-j", 1, "--progress", "none")
    assert result.exit_code == 4, result.output
    assert looks(tmp_path / "a").runs == (5, 10, 20, 40)
    text = "decide: claims: not met at look 4 of 4, 40 runs, the largest number; inconclusive: close"
    assert text in " ".join(result.stdout.split()) and "98.75 %" in result.stdout
    results = load_results(tmp_path / "a")
    assert results.is_final and results.experiment.n_runs == 40
    assert cli("report", tmp_path / "a").exit_code == 4
    judged = json.loads((tmp_path / "a" / "claims.json").read_text(encoding="utf-8"))
    assert {claim["confidence"] for claim in judged["claims"]} == {0.9875}


def test_a_rule_that_is_met_ends_with_0(tmp_path):
    """At the first look, as the claim is clear."""
    path = write(tmp_path, **{**CLAIMS, "claims": f"[{CLEAR}]"})
    result = cli("run", path, "-o", tmp_path / "a", "-j", 1, "--progress", "none")
    assert result.exit_code == 0, result.output
    assert "decide: claims: met at look 1 of 4, 5 runs" in result.stdout
    assert load_experiment(tmp_path / "a").n_runs == 5


@pytest.mark.parametrize(
    "check", ["mean(mse[R-MPC]) < 2 * mean(mse[S-MPC])", "mean(mse[R-MPC]) > 2 * mean(mse[S-MPC])"]
)
def test_a_rule_does_not_stop_at_one_run(tmp_path, check):
    """A single run decides no claim, whichever way its numbers point."""
    claim = f'[{{says: clear, source: additional result, check: "{check}"}}]'
    path = write(tmp_path, **{**CLAIMS, "claims": claim, "stop": "{decide: claims, min_runs: 1, max_runs: 16}"})
    computed(path, tmp_path / "a")
    runs = looks(tmp_path / "a").runs
    assert runs[0] == 1 and runs[-1] > 1 and looks(tmp_path / "a").is_met


def test_a_new_claim_continues(claims, tmp_path):
    """What was decided before is decided again, at the same looks."""
    path = write(tmp_path, **{**CLAIMS, "claims": f"[{CLEAR}]"})
    computed(path, tmp_path / "a")
    assert cli("run", claims, "-o", tmp_path / "a", "-j", 1, "--progress", "none").exit_code == 4
    assert looks(tmp_path / "a").runs == (5, 10, 20, 40)
    assert computed(path, tmp_path / "a").count("\n") == 2 * 5 + 1


def test_one_method_after_the_other(width, tmp_path):
    """No look takes place while runs of a method are missing; the results say so."""
    csv = computed(width, tmp_path / "a")
    computed(width, tmp_path / "b", only=["S-MPC"])
    assert looks(tmp_path / "b") is None
    results = load_results(tmp_path / "b")
    assert not results.is_final and "not ended (no look yet" in results.incomplete[-1]
    assert computed(width, tmp_path / "b") == csv


def test_runs_by_hand_have_no_rule(width, tmp_path):
    """The number that is given is computed; the rule takes its runs later and is not moved by more of them."""
    csv = computed(width, tmp_path / "a")
    assert computed(width, tmp_path / "b", runs=150).count("\n") == 3 * 150 + 1
    assert load_experiment(tmp_path / "b").stop is None
    assert computed(width, tmp_path / "b") == csv
    assert looks(tmp_path / "a") == looks(tmp_path / "b")


def test_a_sweep_waits_for_its_widest_point(tmp_path):
    """All points at every look; the baseline that points share is computed once."""
    keys = {**WIDTH, "stop": "{resolve: 0.02%, min_runs: 8, every: 4, max_runs: 100}"}
    path = write(tmp_path, **keys, sweep="{grid: {methods.R-MPC.estimator.c: [0.1, 10]}}")
    computed(path, tmp_path / "a")
    trials = load_results(tmp_path / "a").trials
    assert max(each.value for each in half_widths(trials)) <= 0.0002
    assert len({len(point.runs) for point in trials.points}) == 1


def test_failed_runs_do_not_block_a_look(tmp_path):
    """A run that failed is stored and counts as finished for the look."""
    path = write(tmp_path, **{**WIDTH, "plant": "{kind: servo-linear, perturb: {J_l: 1 + eps}, diverged: 1e-9}"})
    result = cli("run", path, "-o", tmp_path / "a", "-j", 1, "--progress", "none", "-s", "stop.max_runs=20")
    # Failed runs have precedence over the rule.
    assert result.exit_code == 3, result.output
    found = looks(tmp_path / "a")
    assert not found.is_met and found.runs[-1] == 20
    statuses = set(load_results(tmp_path / "a").trials.frame["status"])
    assert statuses == {Status.DIVERGED.word}


def test_progress_counts_up_to_the_next_look(claims, tmp_path):
    """The total grows with every look."""
    result = cli("run", claims, "-o", tmp_path / "a", "-j", 1, "--progress", "json")
    lines = [json.loads(line) for line in result.stderr.splitlines() if line.startswith("{")]
    assert (lines[0]["trials"], lines[-1]["trials"], lines[-1]["done"]) == (10, 80, 80)
    said = [line["text"] for line in lines if line["event"] == "message"]
    assert said[0] == "decide: claims: not ended (look 1 of 4, 5 runs; the next one is at 10 runs)"


def test_the_progress_file_ends_where_the_runs_end(tmp_path):
    """A method that was stored before has more runs than the next look needs; they count when the look reaches them."""
    keys = {**CLAIMS, "stop": "{decide: claims, min_runs: 5, max_runs: 10}"}
    path = write(tmp_path, **keys)
    computed(path, tmp_path / "a", only=["S-MPC"], runs=10)
    computed(path, tmp_path / "a")
    assert looks(tmp_path / "a").runs == (5, 10)
    found = progress_file.read(tmp_path / "a")
    assert (found["runs"], found["done"], found["total"]) == ([0, 10], 20, 20)
    assert [(each["method"], each["n"]) for each in found["means"]] == [("S-MPC", 10), ("R-MPC", 10)]


def test_the_plan_ends_at_the_next_look(claims, tmp_path):
    """What follows depends on the results."""
    plan = cli("run", claims, "-o", tmp_path / "a", "--dry-run").stdout
    assert "tiny: 10 of 10 trials to compute (S-MPC, R-MPC), up to the next look of `decide: claims`" in plan
    cli("run", claims, "-o", tmp_path / "a", "-j", 1, "--progress", "none")
    plan = cli("run", claims, "-o", tmp_path / "a", "--dry-run").stdout
    assert "tiny: 0 of 80 trials to compute (S-MPC, R-MPC)\n" in plan


def test_a_shard_cannot_look_at_all_runs(claims, tmp_path):
    """It says so; a number of runs by hand has no rule."""
    result = cli("run", claims, "-o", tmp_path / "a", "--shard", "1/2")
    assert result.exit_code == 2
    assert "a shard cannot decide `stop: decide: claims`, which looks at all runs; --runs N gives them" in result.stderr
    assert cli("run", claims, "-o", tmp_path / "a", "--shard", "1/2", "--runs", 4, "-j", 1).exit_code == 0


def test_trials_without_a_report(claims, tmp_path):
    """The exit code and the numbers of runs are those of the last look."""
    result = cli("run", claims, "-o", tmp_path / "a", "-j", 1, "--no-report")
    assert result.exit_code == 4, result.output
    assert "runs 0 to 39, 80 of 80 trials" in result.stdout


def test_check_names_the_rule(claims):
    """Before any run."""
    assert "at most 40 runs (stop: decide: claims)" in cli("check", claims).stdout


def test_recorded_runs_end_with_the_stop(tmp_path):
    """`all` are those of the results."""
    path = write(tmp_path, **{**CLAIMS, "claims": f"[{CLEAR}]"}, record="{runs: all, signals: [y]}")
    results = run(load_config(path), directory=tmp_path / "a", jobs=1)
    assert results.is_final and len(results.traces["S-MPC"].runs) == 5


def test_words():
    """What a reader sees of a rule."""
    of = {"rule": "resolve: 2 %", "max_runs": 100, "n_looks": 0, "level": 0.95, "confidence": 0.95}
    stop = StoredStop(**of, looks=Looks("", wanted=10))
    assert stop.text == "resolve: 2 %: not ended (no look yet; the next one is at 10 runs)"
    stop = StoredStop(**of, looks=Looks("", (10, 15), 15, is_met=True))
    assert stop.text == "resolve: 2 %: met at look 2, 15 runs" and stop.is_over and not stop.is_unmet
    stop = StoredStop(**of, looks=Looks("", (10, 100), 100, open=("B is known to 3 %",)))
    assert stop.is_unmet and stop.text.endswith("look 2, 100 runs, the largest number; B is known to 3 %")
