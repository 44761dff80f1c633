"""The quadratic cost of a run against a plain loop and hand calculation."""

import numpy as np
import pytest
from conftest import ROUND, random_psd
from metrics.estimate_records import LAYOUT, N, plant, trajectories
from metrics.issue_checks import only_issue

from rmpc_bench.config_file.keys import model_of, validate
from rmpc_bench.config_file.tree import Problems
from rmpc_bench.config_file.yaml import parse
from rmpc_bench.metrics.cost import Cost
from rmpc_bench.types import Record


@pytest.mark.parametrize(
    ("bounds", "samples"), [({}, range(N)), ({"from_": 1.0}, range(2, N)), ({"from_": 0.5, "to": 1.5}, range(1, 4))]
)
def test_cost_against_a_plain_loop(bounds, samples, rng):
    """Oracle: ma2025 (36), sample by sample: the state that an input leads to counts with it."""
    block, Q, R = trajectories(rng), random_psd(rng, 3), 0.7
    values = Cost(Q_x=Q.tolist(), R_u=R, **bounds).evaluate(block)
    for i, value in enumerate(values):
        total = sum(block.x[i, k + 1] @ Q @ block.x[i, k + 1] + R * block.u[i, k] @ block.u[i, k] for k in samples)
        np.testing.assert_allclose(value, total, **ROUND)


def test_the_first_state_costs_nothing_and_the_last_one_does():
    """Oracle: x = 7, 2, 3 and u = 1, 5 by hand: 10 (4 + 9) + 2 (1 + 25)."""
    x = np.array([7.0, 2.0, 3.0]).reshape(1, 3, 1)
    u = np.array([1.0, 5.0]).reshape(1, 2, 1)
    block = Record(1.0, x, x, x, u, x[0])
    assert Cost(Q_x=10.0, R_u=2.0).evaluate(block) == [182.0]
    assert Cost(Q_x=10.0, R_u=2.0, to=0.0).evaluate(block) == [42.0]


def test_short_forms_are_matrices(rng):
    """Oracle: a number is that times the identity, a list the diagonal."""
    block = trajectories(rng)
    for short, full in ((2.0, 2.0 * np.eye(3)), ([1.0, 0.0, 4.0], np.diag([1.0, 0.0, 4.0]))):
        expected = Cost(Q_x=full.tolist(), R_u=[[1.0]]).evaluate(block)
        np.testing.assert_array_equal(Cost(Q_x=short, R_u=1.0).evaluate(block), expected)


def test_its_column():
    """Oracle: no unit, as those of states and inputs differ; less is better; there is no input at k = N."""
    metric = Cost(Q_x=1.0, R_u=1.0)
    assert (metric.info(LAYOUT), metric.window(LAYOUT)) == (("cost", "", "lower", False, ""), (0, N - 1))
    only_issue(Cost(Q_x=1.0, R_u=1.0, to=0.5 * N), LAYOUT, "", "window from 0 to 6")


@pytest.mark.parametrize(
    ("keys", "parameter", "message"),
    [
        ({"Q_x": [1.0, 2.0]}, "Q_x", r"shape \(2,\) does not fit"),
        ({"R_u": [1.0, 2.0]}, "R_u", r"shape \(2,\) does not fit"),
        ({"Q_x": -1.0}, "Q_x", "positive semidefinite"),
        ({"Q_x": [[1.0, 2.0], [0.0, 1.0]]}, "Q_x", "does not fit"),
    ],
)
def test_an_impossible_weight(keys, parameter, message):
    """Oracle: a plant of three states and one input; refused before any run."""
    only_issue(Cost(**({"Q_x": 1.0, "R_u": 1.0} | keys)), LAYOUT._replace(plant=plant(3)), parameter, message)


def test_keys():
    """As a configuration writes them."""
    problems = Problems()
    keys = problems.tried(
        validate, model_of("metrics", "cost"), parse("{Q_x: [10, 1], R_u: 50%, from: 2}", "f.yaml"), []
    )
    assert not problems and (keys.Q_x, keys.R_u, keys.from_) == ([10.0, 1.0], 0.5, 2.0)
    problems.tried(validate, model_of("metrics", "cost"), parse("{Q_x: 1}", "f.yaml"), [])
    assert [problem.message for problem in problems] == ["'R_u' is missing"]
