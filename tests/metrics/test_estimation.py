"""Metrics of outputs, states and estimates against plain loops, and what they require of an estimator."""

import numpy as np
import pytest
from conftest import ROUND
from metrics.estimate_records import LAYOUT, TOY, N, method, plant, trajectories
from metrics.issue_checks import no_issue, only_issue

from rmpc_bench.metrics.consistency import Nees
from rmpc_bench.metrics.estimation import EstimationMse
from rmpc_bench.metrics.input import InputPower
from rmpc_bench.metrics.tracking import Mae, Mse, Rmse
from rmpc_bench.types import DesignError, Estimator, Method, MetricLayout

SIZES = {Mse: lambda e: e * e, Rmse: lambda e: e * e, Mae: abs}


# -- of: output, state, estimate ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SIZES)
@pytest.mark.parametrize("of", ["output", "state", "estimate"])
@pytest.mark.parametrize(("bounds", "samples"), [({}, range(0, 6)), ({"to": "N"}, range(0, 7))])
def test_mean_errors_against_plain_loops(kind, of, bounds, samples, rng):
    """Oracle: loops over runs, samples and coordinates."""
    block = trajectories(rng)
    for i, value in enumerate(kind(of=of, **bounds).evaluate(block)):
        sizes = []
        for k in samples:
            e = {"output": block.y[i, k] - block.r[k], "state": block.x[i, k]}.get(
                of, block.x_hat[i, k] - block.x[i, k]
            )
            sizes += [SIZES[kind](float(each)) for each in e]
        mean = sum(sizes) / len(sizes)
        np.testing.assert_allclose(value, mean**0.5 if kind is Rmse else mean, **ROUND)


def test_the_default_signal_is_the_output(rng):
    """Oracle: the same bits."""
    block = trajectories(rng)
    for kind in SIZES:
        np.testing.assert_array_equal(kind().evaluate(block), kind(of="output").evaluate(block))


def test_estimation_mse_is_the_mse_of_the_estimate(rng):
    """Oracle: product.md section 7; the same bits and window under another name."""
    block, one = trajectories(rng), EstimationMse(from_=0.5, to="N")
    other = Mse(of="estimate", from_=0.5, to="N")
    np.testing.assert_array_equal(one.evaluate(block), other.evaluate(block))
    assert (one.info(LAYOUT), one.window(LAYOUT)) == (("estimation_mse", "", "lower", False, ""), (1, 6))
    assert EstimationMse(name="mine").info(LAYOUT).name == "mine"


@pytest.mark.parametrize(("kind", "units"), [(Mse, ("rad^2", "", "")), (Rmse, ("rad", "", "")), (Mae, ("rad", "", ""))])
def test_states_have_no_unit(kind, units):
    """Oracle: coordinates of a state differ in theirs."""
    assert tuple(kind(of=of).unit(LAYOUT) for of in ("output", "state", "estimate")) == units


def test_the_square_of_no_unit_is_none():
    """Oracle: a plant without units has no `^2`."""
    layout = MetricLayout(N, 0.5)
    assert Mse().unit(layout) == InputPower().unit(layout) == Rmse().unit(layout) == ""


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("metric", "key"),
    [
        (Mse(of="estimate"), "of"),
        (Rmse(of="estimate"), "of"),
        (Mae(of="estimate"), "of"),
        (EstimationMse(), ""),
        (Nees(), ""),
    ],
)
def test_an_estimate_of_another_length_is_refused(metric, key, rng):
    """Oracle: x_hat - x needs equal lengths; before any run where methods are known, else when it is evaluated."""
    methods = method(5, P=np.eye(5)), method(4, P=np.eye(4), name="S-MPC")
    layout = LAYOUT._replace(plant=plant(5), methods=methods)
    only_issue(metric, layout, key, "x_hat of method 'S-MPC' has 4 components and x of the plant 5")
    no_issue(metric, layout._replace(methods=methods[:1]))
    block = trajectories(rng)
    for n in (1, 2):
        with pytest.raises(DesignError, match=f"x_hat has {n} components and x of the plant 3"):
            metric.evaluate(block._replace(x_hat=block.x_hat[:, :, :n]))


def test_metrics_of_output_and_state_do_not_use_the_estimator():
    """Oracle: there is none."""
    layout = LAYOUT._replace(plant=plant(5), methods=(Method("M", None, None),))
    for kind in SIZES:
        no_issue(kind(), layout)
        no_issue(kind(of="state"), layout)
        assert kind().window(layout) == kind(of="state").window(layout) == (0, 5)


def test_an_oracle_estimator_is_not_used_before_a_plant_is_drawn():
    """Oracle: its `init` needs more than the number of runs, and `correct` is not there."""
    oracle = type("Oracle", (Estimator,), {"knows_uncertainty": True, "init": lambda self, n_runs, delta: None})()
    no_issue(Nees(), LAYOUT._replace(plant=plant(5), methods=(Method("oracle", oracle, None),)))


def test_nees_without_a_covariance_is_refused(rng):
    """Oracle: the toy's estimator gives no P; where methods are not known, no run has a value."""
    layout = LAYOUT._replace(plant=plant(1), methods=(method(1, P=np.eye(1)), TOY, method(1, name="other")))
    only_issue(Nees(), layout, "", rf"estimator of '{TOY.name}', 'other' does not give; leave the metric or")
    no_issue(Nees(), layout._replace(methods=layout.methods[:1]))
    np.testing.assert_array_equal(Nees().evaluate(trajectories(rng)), np.full(4, np.nan))
