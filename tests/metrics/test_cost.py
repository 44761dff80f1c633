"""The quadratic cost of a run against a plain loop and hand calculation."""

import numpy as np
import pytest
from conftest import ROUND, random_psd
from metrics.test_metrics_of_estimates import UNITS, N, plant, trajectories

from rmpc_bench.config.reader import parse
from rmpc_bench.config.schema import model_of, validate
from rmpc_bench.metrics.cost import cost
from rmpc_bench.metrics.tracking import Units
from rmpc_bench.types import DesignError, Record


@pytest.mark.parametrize(
    ("bounds", "samples"), [({}, range(N)), ({"from_": 1.0}, range(2, N)), ({"from_": 0.5, "to": 1.5}, range(1, 4))]
)
def test_cost_against_a_plain_loop(bounds, samples, rng):
    """Oracle: ma2025 (36), sample by sample: the state that an input leads to counts with it."""
    block, Q, R = trajectories(rng), random_psd(rng, 3), 0.7
    values = cost(UNITS, Q_x=Q.tolist(), R_u=R, **bounds).evaluate(block)
    for i, value in enumerate(values):
        total = sum(block.x[i, k + 1] @ Q @ block.x[i, k + 1] + R * block.u[i, k] @ block.u[i, k] for k in samples)
        np.testing.assert_allclose(value, total, **ROUND)


def test_the_first_state_costs_nothing_and_the_last_one_does():
    """Oracle: x = 7, 2, 3 and u = 1, 5 by hand: 10 (4 + 9) + 2 (1 + 25)."""
    x = np.array([7.0, 2.0, 3.0]).reshape(1, 3, 1)
    u = np.array([1.0, 5.0]).reshape(1, 2, 1)
    block = Record(1.0, x, x, x, u, x[0])
    assert cost(Units(2, 1.0, "", ""), Q_x=10.0, R_u=2.0).evaluate(block) == [182.0]
    assert cost(Units(2, 1.0, "", ""), Q_x=10.0, R_u=2.0, to=0.0).evaluate(block) == [42.0]


def test_short_forms_are_matrices(rng):
    """Oracle: a number is that times the identity, a list the diagonal."""
    block = trajectories(rng)
    for short, full in ((2.0, 2.0 * np.eye(3)), ([1.0, 0.0, 4.0], np.diag([1.0, 0.0, 4.0]))):
        expected = cost(UNITS, Q_x=full.tolist(), R_u=[[1.0]]).evaluate(block)
        np.testing.assert_array_equal(cost(UNITS, Q_x=short, R_u=1.0).evaluate(block), expected)


def test_what_it_is():
    """Oracle: no unit, as those of states and inputs differ; less is better; there is no input at k = N."""
    metric = cost(UNITS, Q_x=1.0, R_u=1.0)
    assert (metric.info, metric.window) == (("cost", "", "lower", False), (0, N - 1))
    with pytest.raises(DesignError, match="window from 0 to 6"):
        cost(UNITS, Q_x=1.0, R_u=1.0, to=0.5 * N)


@pytest.mark.parametrize(
    ("keys", "parameter", "message"),
    [
        ({"Q_x": [1.0, 2.0]}, "Q_x", r"shape \(2,\) does not fit"),
        ({"R_u": [1.0, 2.0]}, "R_u", r"shape \(2,\) does not fit"),
        ({"Q_x": -1.0}, "Q_x", "positive semidefinite"),
        ({"Q_x": [[1.0, 2.0], [0.0, 1.0]]}, "Q_x", "does not fit"),
    ],
)
def test_a_weight_that_is_none(keys, parameter, message):
    """Oracle: a plant of three states and one input; refused before any run."""
    with pytest.raises(DesignError, match=message) as caught:
        cost(UNITS._replace(plant=plant(3)), **({"Q_x": 1.0, "R_u": 1.0} | keys))
    assert caught.value.parameter == parameter


def test_keys():
    """As a configuration writes them."""
    problems = []
    keys = validate(model_of("metrics", "cost"), parse("{Q_x: [10, 1], R_u: 50%, from: 2}", "f.yaml"), [], problems)
    assert not problems and (keys.Q_x, keys.R_u, keys.from_) == ([10.0, 1.0], 0.5, 2.0)
    validate(model_of("metrics", "cost"), parse("{Q_x: 1}", "f.yaml"), [], problems)
    assert [problem.message for problem in problems] == ["'R_u' is missing"]
