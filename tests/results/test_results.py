"""Stored trials as tables."""

from typing import NamedTuple

import numpy as np
import pytest
from small_experiment import ran, write

from rmpc_bench import load_config, load_results, load_trials, run
from rmpc_bench.analysis.traces import Traces
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.received.store import MissingError
from rmpc_bench.results.tables import with_estimates


class Arm(NamedTuple):
    """An experiment whose plant has units for its components."""

    nx: int = 2
    units: dict = {"y": "", "u": "N m", "y.0": "m", "y.1": "rad", "x.0": "m", "x.1": "m/s"}  # noqa: RUF012


FAILING = {"uncertainty": "{eps: +-150%}"}


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the small experiment with some keys replaced."""
    return lambda **keys: load_config(write(tmp_path, **keys))


def test_trials_in_the_order_of_the_configuration(load, tmp_path):
    """Methods as they are written, then runs; what labels and statistics say goes along."""
    config = load(
        methods="{z: {estimator: {kind: kalman}, label: Z}, a: {estimator: {kind: robust-kalman, c: 0.1}}}",
        statistics="{baseline: a, confidence: 90%, relevant: 2%}",
    )
    trials = run(config, directory=tmp_path / "out", jobs=1).trials
    assert list(trials.frame["method"]) == ["z"] * 6 + ["a"] * 6
    assert list(trials.frame["run"]) == [*range(6)] * 2
    assert list(trials.frame.columns) == ["method", "run", "status", "mse", "input_power"]
    assert trials.labels == {"z": "Z", "a": "a"}
    assert (trials.baseline, trials.confidence, trials.relevant) == ("a", 0.9, 0.02)


def test_a_failed_run_has_a_status_and_no_values(load, tmp_path):
    """It is counted for every method that meets it."""
    trials = run(load(**FAILING, runs="20"), directory=tmp_path / "out", jobs=1).trials
    failed = trials.frame["status"] == "out-of-range"
    assert 0 < failed.sum() < 40
    assert trials.frame.loc[failed, ["mse", "input_power"]].isna().all(axis=None)
    assert not trials.frame.loc[~failed, ["mse", "input_power"]].isna().any(axis=None)
    assert trials.n_failed_trials == failed.sum() == sum(trials.n_failed(method) for method in trials.methods)
    assert trials.n_failed("S-MPC") == trials.n_failed("R-MPC")


def test_a_failed_run_is_one_whose_parameter_means_nothing(load, tmp_path):
    """The sampled values say why."""
    config = load(**FAILING, runs="20")
    results = run(config, directory=tmp_path / "out", jobs=1)
    eps = results.uncertainty["eps"]
    np.testing.assert_array_equal(np.isnan(results.trials.column("mse", "S-MPC")), 1.0 + eps <= 0.0)


def test_uncertain_values_by_run(load, tmp_path):
    """A column per quantity in the order of the configuration; none without uncertainty."""
    config = load(uncertainty="{eps: +-20%, a: {dist: fixed, value: 2}}")
    table = run(config, directory=tmp_path / "out", jobs=1).uncertainty
    assert list(table.columns) == ["run", "eps", "a"] and list(table["run"]) == [*range(6)]
    assert table["eps"].between(-0.2, 0.2).all() and set(table["a"]) == {2.0}
    assert table["eps"].tolist() == [config.experiment.scenario.named_values(run)["eps"] for run in range(6)]
    config = load(uncertainty="{}", plant="{kind: servo-linear}")
    assert list(run(config, directory=tmp_path / "none", jobs=1).uncertainty.columns) == ["run"]


def test_series_of_the_designs(load, tmp_path):
    """One row per k and component, exact; matrices come back whole."""
    config = load()
    table = run(config, directory=tmp_path / "out", jobs=1).series
    assert list(table.columns) == ["method", "quantity", "component", "k", "n", "value"]
    assert set(table["n"]) == {0} and set(table["method"]) == {"S-MPC", "R-MPC"}
    P = config.experiment.method("R-MPC").estimator.series()["P"]
    chosen = table[(table["method"] == "R-MPC") & (table["quantity"] == "P") & (table["component"] == "1,3")]
    assert chosen["k"].tolist() == [*range(11)] and chosen["value"].tolist() == P[:, 1, 3].tolist()
    theta = table[(table["method"] == "R-MPC") & (table["quantity"] == "theta")]
    assert set(theta["component"]) == {""} and len(theta) == 11


def test_matrix_series_survives_the_table(load, tmp_path):
    """What claims read is what the design said."""
    config = load()
    trials = run(config, directory=tmp_path / "out", jobs=1).trials
    for quantity, values in config.experiment.method("S-MPC").estimator.series().items():
        np.testing.assert_array_equal(trials.matrix_series(quantity, "S-MPC"), values)


def test_methods_without_a_run_are_left_out(load, tmp_path):
    """And another takes the place of the baseline."""
    config = load()
    trials = run(config, directory=tmp_path / "out", jobs=1, only=["R-MPC"]).trials
    assert trials.methods == ("R-MPC",) and trials.baseline == "R-MPC"
    assert set(trials.series["method"]) == {"R-MPC"}


def test_load_trials_of_a_directory(tmp_path):
    """All that was shown at the end of the run is there."""
    ran(write(tmp_path), tmp_path / "out")
    trials = load_trials(tmp_path / "out")
    assert trials.name == "tiny" and len(trials.frame) == 12
    assert load_trials(str(tmp_path / "out")).frame.equals(trials.frame)


def test_no_results(load, tmp_path):
    """Neither a directory without a store nor one without trials of the configuration makes a table."""
    with pytest.raises(MissingError, match="there is no trials.sqlite; fill the directory with `rmpc-bench run`"):
        load_trials(tmp_path)
    run(load(), directory=tmp_path / "out", jobs=1)
    other = load(methods="{a: {estimator: {kind: robust-kalman, c: 9}}}")
    with pytest.raises(MissingError, match="no trial of this configuration is stored"):
        run(other, directory=tmp_path / "out", only=())


def test_another_experiment_is_not_shown(load, tmp_path):
    """Trials of another seed are no trials of this configuration; what is stored stays readable."""
    run(load(), directory=tmp_path / "out", jobs=1)
    with pytest.raises(StoreError):
        run(load(seed=8), directory=tmp_path / "out")
    assert load_results(tmp_path / "out").trials.seed == 7


@pytest.mark.parametrize(("widths", "known"), [((2, 2), True), ((2, 3), False), ((), False)])
def test_units_of_components(widths, known):
    """As the plant tells them; estimates have those of the states where they are estimates of these."""
    traces = [Traces(np.arange(1), {"x_hat": np.zeros((1, 5, n))}, np.zeros((5, 2))) for n in widths]
    expected = dict(Arm().units)
    if known:
        expected |= {"x_hat.0": "m", "x_hat.1": "m/s"}
    assert with_estimates(Arm(), Arm().units, traces) == expected
