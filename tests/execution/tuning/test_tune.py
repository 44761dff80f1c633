"""Tuning of an experiment: what it chooses, on which runs, and what it keeps."""

import json

import numpy as np
import pytest
import small_experiment
from small_experiment import spied
from tuned_experiment import KEYS, STD, record, run, write

import rmpc_bench
from rmpc_bench import load_config, load_results
from rmpc_bench.config.experiment_config import tuning_seed
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.execution.status import read_status
from rmpc_bench.execution.tuning import tune
from rmpc_bench.execution.tuning.rounds import Rounds, rounded
from rmpc_bench.execution.tuning.search import Candidate
from rmpc_bench.results.tuning import read_record, read_seconds
from rmpc_bench.types.tuning import TuningProtocol

KFR = "{estimator: {kind: kalman}, tune: {model.P_v: [0.01, 1000]}}"
RKF = "{estimator: {kind: robust-kalman, c: 0.1}, tune: {estimator.c: [0.001, 1]}}"
TWO = f"{{KF: {{estimator: {{kind: kalman}}}}, KFR: {KFR}, RKF: {RKF}}}"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A configuration of two tuned methods and its directory."""
    directory = tmp_path_factory.mktemp("finished")
    path = write(directory, methods=TWO)
    run(path, directory / "out", "-j", 1)
    return path, directory / "out"


def steady_mse(P_v):
    """Mean square error of a Kalman filter that believes in P_v, in the steady state of the scalar system."""
    a, P = 0.9, 1.0
    for _ in range(1000):
        P_pred = a * a * P + 1.0
        P = P_pred * P_v / (P_pred + P_v)
    gain = P_pred / (P_pred + P_v)
    # e+ = (1 - K)(a e + w) - K v
    return ((1 - gain) ** 2 + gain**2 * STD**2) / (1 - (1 - gain) ** 2 * a * a)


@pytest.mark.long
def test_the_tuned_noise_is_the_true_one(tmp_path):
    """The objective is flat at its minimum: its value is that of the closed form, and the tuned one lies close by."""
    path = write(tmp_path, runs=5, tune="{budget: 16, runs: 80, regret: false}", time="{steps: 120}")
    config = load_config(path)
    results = rmpc_bench.run(config, directory=tmp_path / "out", jobs=1)
    search = results.tuning.search("KFR")
    grid = np.geomspace(0.01, 1000, 4001)
    exact = [steady_mse(value) for value in grid]
    assert grid[np.argmin(exact)] == pytest.approx(STD**2, rel=0.01)  # steps of the grid are 0.3 %
    assert search.values["model.P_v"] == pytest.approx(STD**2, rel=0.3)  # 1 % of the mean square error
    assert steady_mse(search.values["model.P_v"]) <= 1.01 * min(exact)
    assert not any(search.at_end) and search.default == (1.0,)


def test_tuning_equals_brute_force_on_the_same_runs(tmp_path):
    """An ordinary experiment with the seed of the tuning has the metrics that tuning has seen, for every value."""
    path = write(tmp_path, tune="{budget: 16, runs: 12}")
    results = rmpc_bench.run(load_config(path), directory=tmp_path / "out", jobs=1)
    search = results.tuning.search("KFR")
    grid = np.unique([*np.geomspace(0.1, 100, 61), *search.candidates[:, 0]]).tolist()
    methods = ", ".join(f"'v{value!r}': {{estimator: {{kind: kalman}}, model: {{P_v: {value!r}}}}}" for value in grid)
    seed = tuning_seed(int(KEYS["seed"]), 0)
    brute = write(tmp_path, file="brute.yaml", methods=f"{{{methods}}}", tune=None, seed=seed, runs=12)
    table = rmpc_bench.run(load_config(brute), directory=tmp_path / "brute", jobs=1).trials.frame
    means = table.groupby("method", sort=False).estimation_mse.mean()
    for value, runs in zip(search.candidates[:, 0].tolist(), search.tuning, strict=True):
        expected = table[table.method == f"v{value!r}"].estimation_mse.to_numpy()
        np.testing.assert_array_equal(runs, rounded(expected))
    best = search.objectives[search.chosen]
    assert best == search.objectives.min()
    assert best <= means.min() * (1 + 1e-4)  # seven golden steps leave 3 % of the grid's step


def test_tuning_runs_are_never_those_of_the_experiment(finished):
    """No metric of a tuning run is one of a run of the experiment, for the same value."""
    config, results = load_config(finished[0]), load_results(finished[1])
    assert not {*config.tuning.seeds} & {point.experiment.scenario.seed for point in config.points}
    for search in results.tuning.searches:
        assert not np.intersect1d(search.tuning, search.test).size
    seeds = [tuning_seed(seed, number) for seed in range(50) for number in range(50)]
    assert len({*seeds, *range(50)}) == len(seeds) + 50


def test_regret_is_on_the_runs_of_the_experiment(finished):
    """The row of the chosen value has the metrics of the experiment, the last row those of the file's value."""
    results = load_results(finished[1])
    for search in results.tuning.searches:
        frame = results.trials.frame
        own = frame[frame.method == search.method].estimation_mse.to_numpy()
        np.testing.assert_array_equal(search.test[search.chosen], rounded(own))
        assert search.test.shape == (len(search.candidates) + 1, int(KEYS["runs"]))
    plain = results.trials.frame[results.trials.frame.method == "KF"].estimation_mse.to_numpy()
    np.testing.assert_array_equal(results.tuning.search("KFR").test[-1], rounded(plain))


def test_results_say_where_parameters_come_from(finished):
    experiment = load_results(finished[1]).experiment
    words = "tuned (budget 6, 5 runs)"
    assert experiment.parameters == {"KF": "default", "KFR": words, "RKF": words}
    assert load_results(finished[1]).tuning.parameters == experiment.parameters


@pytest.mark.parametrize(
    "options", [("-j", 2, "--engine", "joblib"), ("--engine", "serial"), ("-s", "execution.block=3"), ("-j", 1)]
)
@pytest.mark.long
def test_the_choice_does_not_depend_on_how_it_is_computed(finished, tmp_path, options):
    """Same bytes of tuning.json for any workers, engine and block."""
    run(finished[0], tmp_path / "out", *options)
    assert record(tmp_path / "out") == record(finished[1])


def test_a_known_search_is_not_made_again(finished, tmp_path, monkeypatch):
    """The record is enough, without any trial; and the directory itself computes nothing."""
    path, directory = finished
    blocks = spied(monkeypatch)
    run(path, directory, "-j", 1)
    assert not blocks
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "tuning.json").write_bytes(record(directory))
    run(path, tmp_path / "out", "-j", 1)
    assert {name for name, _ in blocks} == {"KF", "KFR", "RKF"}
    assert record(tmp_path / "out") == record(directory)
    assert not (tmp_path / "out" / "tuning").exists()


LATE = "[estimation_mse, {kind: estimation_mse, name: late, from: 10}]"
OTHER = TWO.replace("KFR: {estimator: {kind: kalman}", "KFR: {estimator: {kind: robust-kalman, c: 0.01}")
CHANGES = {
    "budget": {"tune": "{budget: 7, runs: 5}"},
    "runs": {"tune": "{budget: 6, runs: 4}"},
    "statistic": {"tune": "{budget: 6, runs: 5, statistic: median}"},
    "penalty": {"tune": "{budget: 6, runs: 5, penalty: 3}"},
    "stream": {"tune": "{budget: 6, runs: 5, seed: 1}"},
    "metric": {"tune": "{budget: 6, runs: 5, metric: late}", "metrics": LATE},
    "seed": {"seed": 4},
    "noise": {"noise": "{process: {gaussian: {std: 1}}, measurement: {gaussian: {std: 2}}}"},
    "range": {"methods": TWO.replace("[0.01, 1000]", "[0.1, 1000]")},
    "method": {"methods": OTHER},
}
KEPT = {
    "default": {"model": KEYS["model"].replace("P_v: 1", "P_v: 2")},
    "runs of the experiment": {"runs": 11},
    "labels": {"title": "another", "figures": "[boxplot]"},
    "another metric": {"metrics": LATE},
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_changes_a_search_changes_its_key(finished, tmp_path, name):
    """The first search of the range and of the method, and of all others both."""
    before = load_config(finished[0])
    after = load_config(write(tmp_path, **{"methods": TWO} | CHANGES[name]))
    same = [one.key == other.key for one, other in zip(before.tuning.searches, after.tuning.searches, strict=True)]
    assert same == ([False, True] if name in ("range", "method") else [False, False])


@pytest.mark.parametrize("name", KEPT)
def test_what_does_not_change_a_search_keeps_its_key(finished, tmp_path, name):
    """The value of the file is none of the values that are tried."""
    before = load_config(finished[0])
    after = load_config(write(tmp_path, **{"methods": TWO} | KEPT[name]))
    keys = [[each.key for each in config.tuning.searches] for config in (before, after)]
    # RKF uses the model of all methods, whose noise is no default of its own.
    assert keys[0][0] == keys[1][0]
    assert (keys[0][1] == keys[1][1]) == (name != "default")


def test_more_runs_of_the_experiment_tune_nothing_again(tmp_path, monkeypatch):
    """Only the regret is computed for the new runs."""
    path = write(tmp_path)
    run(path, tmp_path / "out", "-j", 1)
    before = read_record(tmp_path / "out")
    blocks = spied(monkeypatch)
    run(path, tmp_path / "out", "-j", 1, "--runs", 10)
    assert {tuple(runs) for _, runs in blocks} == {(8, 9)}
    after = read_record(tmp_path / "out")
    assert [*before] == [*after]
    for key in before:
        np.testing.assert_array_equal(before[key].tuning, after[key].tuning)
        np.testing.assert_array_equal(before[key].test, after[key].test[:, :8])


def test_without_regret_the_record_is_short(tmp_path):
    """It has the objective of every value and the runs of the chosen one; with regret the search is made again."""
    tables = {}
    for name in ("true", "false"):
        (tmp_path / name).mkdir()
        path = write(tmp_path / name, tune=f"{{budget: 7, runs: 12, regret: {name}}}")
        run(path, tmp_path / name / "out", "-j", 1)
        tables[name] = read_record(tmp_path / name / "out")
    protocol = load_config(path).tuning.protocol
    assert [*tables["true"]] == [*tables["false"]]
    for key, found in tables["true"].items():
        short = tables["false"][key]
        assert short.is_short and not found.is_short and short.values == found.values
        np.testing.assert_array_equal(short.tuning[short.chosen], found.tuning[found.chosen])
        objectives = [protocol.objective(each.tuning) for each in (short, found)]
        np.testing.assert_allclose(*objectives, rtol=1e-5)  # 6 digits
    size = (tmp_path / "false/out/tuning.json").stat().st_size
    assert 2 * size < (tmp_path / "true/out/tuning.json").stat().st_size
    run(path, tmp_path / "false/out", "-j", 1, "-s", "tune.regret=true")
    assert not any(each.is_short for each in read_record(tmp_path / "false/out").values())


def test_the_resolved_configuration_is_the_tuned_one(finished):
    """It loads without the record, to the same trials, and has nothing to tune."""
    path, directory = finished
    resolved = load_config(directory / "config.resolved.yaml")
    assert not resolved.tuning.missing
    experiment = load_results(directory).experiment
    assert resolved.points[0].method_keys == {name: each.key for name, each in experiment.points[0].methods.items()}
    assert resolved.resolved == load_config(directory / "config.resolved.yaml").resolved
    # What was tried first stays known.
    assert resolved.tuning.searches[0].key == load_config(path).tuning.searches[0].key
    assert resolved.tuning.searches[0].default == (1.0,)
    assert resolved.resolved["methods"]["KFR"]["model"]["P_v"] == 1.0
    assert resolved.methods["KFR"]["model"]["P_v"] == load_results(directory).tuning.search("KFR").values["model.P_v"]


def test_points_of_a_sweep_are_tuned_apart(tmp_path):
    """Each with its own noise; points that are equal share a search."""
    path = write(
        tmp_path,
        sweep="{grid: {noise.measurement.gaussian.std: [0.3, 3, 9]}}",
        tune="{budget: 9, runs: 30, regret: false}",
        time="{steps: 80}",
    )
    run(path, tmp_path / "out", "-j", 1)
    results = load_results(tmp_path / "out")
    values = [each.values["model.P_v"] for each in results.tuning.searches]
    assert len(values) == 3 and values == pytest.approx([0.09, 9.0, 81.0], rel=0.6)  # 80 samples of 30 runs
    points = [f"noise.measurement.gaussian.std={std}" for std in ("0.3", "3", "9")]
    assert [each.point for each in results.tuning.searches] == points
    resolved = load_config(tmp_path / "out" / "config.resolved.yaml")
    assert [dict(each.values) for each in resolved.tuning.searches] == [each.values for each in results.tuning.searches]
    keys = [{name: each.key for name, each in point.methods.items()} for point in results.experiment.points]
    assert [point.method_keys for point in resolved.points] == keys


def test_points_that_differ_in_another_method_share_a_search(tmp_path, monkeypatch):
    keys = {"sweep": "{grid: {methods.KF.model.P_w: [1, 2]}}", "tune": "{budget: 3, runs: 2, regret: false}"}
    path = write(tmp_path, methods=TWO, **keys)
    config = load_config(path)
    assert len(config.tuning.searches) == 4
    assert len({each.key for each in config.tuning.searches}) == 2
    assert config.tuning.n_trials() == (2 * 3 * 2, 0)
    blocks = spied(monkeypatch)
    run(path, tmp_path / "out", "-j", 1)
    assert sum(len(runs) for name, runs in blocks if "~" in name) == 2 * 3 * 2
    assert len(load_results(tmp_path / "out").tuning.searches) == 4


def test_several_parameters_are_tuned_together(tmp_path):
    """Equal noise ratios give equal filters: the ratio of the tuned noises is the true one, 9."""
    both = "{KF: {estimator: {kind: kalman}, tune: {model.P_v: [0.1, 100], model.P_w: [0.1, 10]}}}"
    path = write(tmp_path, methods=both, tune="{budget: 30, runs: 40, regret: false}", time="{steps: 60}")
    results = rmpc_bench.run(load_config(path), directory=tmp_path / "out", jobs=1)
    search = results.tuning.search("KF")
    assert search.candidates.shape == (30, 2)
    assert {*search.stages} == {"quasi-random", "nelder-mead"}
    values = search.values
    assert values["model.P_v"] / values["model.P_w"] == pytest.approx(9.0, rel=0.4)  # flat objective


def test_a_value_without_a_design_counts_as_failed(tmp_path):
    """Above the largest theta there is no filter; the search goes on below it, and the file is no error."""
    methods = "{RS: {estimator: {kind: risk-sensitive, theta: 0.001}, tune: {estimator.theta: [0.001, 1000]}}}"
    path = write(tmp_path, methods=methods, tune="{budget: 10, runs: 3}")
    results = rmpc_bench.run(load_config(path), directory=tmp_path / "out", jobs=1)
    search = results.tuning.search("RS")
    failed = np.isnan(search.tuning).all(axis=1)
    assert 0 < failed.sum() < 10
    np.testing.assert_array_equal(np.isinf(search.objectives), failed)
    assert np.isfinite(search.objectives[search.chosen])
    np.testing.assert_array_equal(np.isnan(search.test[:-1]).all(axis=1), failed)
    assert search.candidates[failed].min() > search.values["estimator.theta"]


def test_the_last_bits_of_an_objective_choose_nothing(finished):
    """Sums in another order are another number, also on another CPU; the first of equal values is chosen."""
    plan, rows = load_config(finished[0]).tuning, [np.array([0.1, 0.2, 0.3]), np.array([0.3, 0.2, 0.1])]
    assert plan.protocol.objective(rows[0]) != plan.protocol.objective(rows[1])
    used = [Candidate((1.0,), "grid"), Candidate((2.0,), "grid")]
    found = tune._chosen(plan, plan.searches[0], used, {each.row: row for each, row in zip(used, rows, strict=True)})
    assert found.chosen == 0


def test_failed_runs_are_a_penalty_on_the_statistic():
    """By hand: the mean of the finished runs times 1 + 10 x the share of failed ones; infinite where all failed."""
    values = np.array([[1.0, 3.0, np.nan, np.inf], [2.0, 2.0, 2.0, 2.0], [np.nan] * 4])
    assert TuningProtocol(1, 4, "mse").objective(values).tolist() == [2.0 * (1 + 10 * 0.5), 2.0, np.inf]
    assert TuningProtocol(1, 4, "mse", "median", 0.0).objective(values)[0] == 2.0
    row = np.arange(1.0, 12.0)
    assert TuningProtocol(1, 4, "mse", "quantile 90%").objective(row).item() == 10.0
    assert TuningProtocol(1, 4, "mse").objective(-values)[0] == -2.0 * (1 - 10 * 0.5)


def test_times_are_known_and_in_no_kept_file(finished):
    results = load_results(finished[1])
    assert all(each.seconds > 0 for each in results.tuning.searches)
    assert [*read_seconds(finished[1])] and "seconds" not in record(finished[1]).decode()
    data = json.loads(record(finished[1]))
    assert {entry["method"] for entry in data["searches"].values()} == {"KFR", "RKF"}


def test_only_the_named_method_is_tuned(tmp_path):
    path = write(tmp_path, methods=TWO)
    run(path, tmp_path / "out", "-j", 1, "--only", "RKF")
    assert [each.method for each in load_results(tmp_path / "out").tuning.searches] == ["RKF"]
    before = {each.method: each.values for each in load_results(tmp_path / "out").tuning.searches}
    run(path, tmp_path / "out", "-j", 1)
    after = {each.method: each.values for each in load_results(tmp_path / "out").tuning.searches}
    assert [*after] == ["KFR", "RKF"] and after["RKF"] == before["RKF"]


def test_an_empty_store_of_the_directory_is_no_store(tmp_path):
    """A start that was killed has left it."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "trials.sqlite").touch()
    run(write(tmp_path, methods=TWO), tmp_path / "out", "-j", 1, "--only", "RKF")
    assert [each.method for each in load_results(tmp_path / "out").tuning.searches] == ["RKF"]


def test_equal_methods_share_a_search(tmp_path, monkeypatch):
    path = write(tmp_path, methods=f"{{A: {KFR}, B: {KFR}}}", tune="{budget: 3, runs: 2, regret: false}")
    blocks = spied(monkeypatch)
    results = rmpc_bench.run(load_config(path), directory=tmp_path / "out", jobs=1)
    assert sum(len(runs) for name, runs in blocks if "~" in name) == 6
    assert results.tuning.search("A").values == results.tuning.search("B").values


@pytest.mark.long
def test_engines_and_blocks_of_a_servomechanism(tmp_path):
    """A closed loop, whose controller and estimator are tuned, with a rule that ends the experiment."""
    path = small_experiment.write(
        tmp_path,
        methods="{S-MPC: {estimator: {kind: kalman}, tune: {controller.R: [0.01, 10]}}, "
        "R-MPC: {estimator: {kind: robust-kalman, c: 0.1}, tune: {estimator.c: [0.001, 1]}}}",
        tune="{budget: 4, runs: 3}",
        stop="{min_runs: 10, max_runs: 80, resolve: 50%}",
    )
    run(path, tmp_path / "out", "-j", 1)
    run(path, tmp_path / "other", "--engine", "serial", "-s", "execution.block=2")
    assert record(tmp_path / "out") == record(tmp_path / "other")
    made = load_results(tmp_path / "out")
    n = len(made.trials.runs)
    assert {each.test.shape for each in made.tuning.searches} == {(5, n)} and n == made.experiment.stop.looks.wanted


STOPPED = {"stop": "{max_runs: 24, resolve: 5%, every: 8}", "methods": TWO, "tune": "{budget: 3, runs: 3}"}


def test_where_a_rule_stops_values_are_compared_on_all_runs_that_were_made(tmp_path, monkeypatch):
    """In one command and in Python; then nothing is left to compute, and the status has ended."""
    path = write(tmp_path, **STOPPED)
    result = small_experiment.cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none", "--no-report")
    assert result.exit_code == 4, result.output
    results = load_results(tmp_path / "out")
    assert len(results.trials.runs) == 24
    report = rmpc_bench.tuning(results)
    for each in results.tuning.searches:
        own = results.trials.frame.query("method == @each.method").estimation_mse.to_numpy()
        np.testing.assert_array_equal(each.test[each.chosen], rounded(own))
    assert report.ranks[""].methods == ("KF", "KFR", "RKF") and not report.unranked
    (status,) = read_status(tmp_path / "out").shards
    assert status.state == "finished" and status.stage == "" and status.done == status.total == 72
    python = rmpc_bench.run(load_config(path), directory=tmp_path / "python", jobs=1)
    assert record(tmp_path / "python") == record(tmp_path / "out") and python.tuning.searches[0].test.shape == (4, 24)
    blocks = spied(monkeypatch)
    rmpc_bench.run(load_config(path), directory=tmp_path / "out", jobs=1)
    assert not blocks


def test_without_the_runs_of_the_values_the_words_say_why_there_are_no_ranks(tmp_path, monkeypatch):
    """As after an interruption between the last look and the regret."""
    path = write(tmp_path, **STOPPED)
    with monkeypatch.context() as patch:
        patch.setattr("rmpc_bench.execution.tuning.rounds.Rounds.values", interrupted_at_the_test(Rounds.values))
        with pytest.raises(KeyboardInterrupt):
            rmpc_bench.run(load_config(path), directory=tmp_path / "out", jobs=1)
    why = "No ranks: the values were computed on no runs of the experiment, which has 24."
    assert rmpc_bench.tuning(load_results(tmp_path / "out")).sentences[-1] == why
    rmpc_bench.run(load_config(path), directory=tmp_path / "out", jobs=1)
    assert rmpc_bench.tuning(load_results(tmp_path / "out")).ranks


def interrupted_at_the_test(values):
    """Interrupt where values are computed on the runs of the experiment."""

    def replaced(self, trials, *, tested=False):
        if tested:
            raise KeyboardInterrupt
        return values(self, trials, tested=tested)

    return replaced


def test_a_large_round_is_computed_in_parts(finished, tmp_path, monkeypatch):
    """With the same bytes: neither the parts nor the designs that are kept decide anything."""
    monkeypatch.setattr("rmpc_bench.execution.tuning.rounds.MOST_TRIALS", 4)
    monkeypatch.setattr("rmpc_bench.config.rounds.MOST_DESIGNS", 2)
    run(finished[0], tmp_path / "out", "-j", 1)
    assert record(tmp_path / "out") == record(finished[1])


OUT_OF_RANGE = "{kind: uncertain-linear, A: 0.9, B: 1, C: 1, Bw: 1, Dv: 1, bounds: {x: [-0.01, 0.01]}}"


@pytest.mark.parametrize("regret", ["true", "false"])
def test_where_nothing_can_be_measured_the_default_stays_and_the_words_say_so(tmp_path, regret):
    """Every tuning run leaves the range; the record and config.resolved.yaml keep that, so nothing is tried again."""
    methods = f"{{A: {KFR}, B: {{estimator: {{kind: kalman}}, tune: {{model.P_w: [0.1, 10]}}}}}}"
    path = write(tmp_path, methods=methods, plant=OUT_OF_RANGE, tune=f"{{budget: 3, runs: 2, regret: {regret}}}")
    results = rmpc_bench.run(load_config(path), directory=tmp_path / "out", jobs=1)
    assert {each.method: each.values for each in results.tuning.searches} == {"A": {}, "B": {}}
    word = "default (nothing could be tuned)"
    assert results.experiment.origins == {"A": word, "B": word} and not rmpc_bench.tuning(results).ranks
    before = record(tmp_path / "out")
    again = rmpc_bench.run(load_config(path), directory=tmp_path / "out", jobs=1)
    assert record(tmp_path / "out") == before and again.experiment.origins == {"A": word, "B": word}
    untuned = methods.replace(", tune: {model.P_v: [0.01, 1000]}", "").replace(", tune: {model.P_w: [0.1, 10]}", "")
    plain = load_config(write(tmp_path, file="plain.yaml", methods=untuned, plant=OUT_OF_RANGE, tune=None))
    resolved = load_config(tmp_path / "out" / "config.resolved.yaml")
    assert resolved.points[0].method_keys == plain.points[0].method_keys and not resolved.tuning.missing


@pytest.mark.parametrize(
    ("change", "is_tuned"),
    [
        ("runs=5", True),
        ("title=other", True),
        ("tune.budget=4", False),
        ("tune.runs=4", False),
        ("tune.statistic=median", False),
        ("methods.KFR.tune={model.P_v: [0.001, 1000]}", False),
        ("methods.KFR.model.P_w=2", False),
        ("plant.A=0.8", False),
        ("seed=4", False),
    ],
)
def test_values_are_tuned_only_for_the_search_whose_key_they_carry(finished, tmp_path, change, is_tuned):
    """As config.resolved.yaml writes them; also after a second round through it, and for one of two methods."""
    path = finished[1] / "config.resolved.yaml"
    config = load_config(path, overrides=[change])
    assert not config.tuning.missing
    other = "tuned for other settings"
    words = dict.fromkeys(("KFR", "RKF"), config.tuning.protocol.words if is_tuned else other)
    # A change of one method leaves the search of the other as it was.
    words |= {"RKF": config.tuning.protocol.words} if change.startswith("methods.KFR") else {}
    assert config.parameters == {"KF": "default", **words}
    again = tmp_path / "again.yaml"
    again.write_text(dump(config.resolved), encoding="utf-8")
    assert load_config(again).parameters == config.parameters
    without = load_config(path, overrides=["tune.values=[{method: KFR, values: {model.P_v: 9}}]"])
    assert without.parameters["KFR"] == other and without.tuning.missing
