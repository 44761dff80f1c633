"""Recursions that end when they are steady, for states whose units differ by many orders of magnitude."""

import numpy as np
import pytest
from conftest import ROUND

from rmpc_bench.estimators import h_infinity, kalman, moving_horizon, wasserstein_kalman
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import nearly_equal

STEPS, LARGE, SMALL = 60, 1e4, 1e-10
START = {"x0": np.zeros(2), "P0": np.diag([LARGE, SMALL])}


@pytest.fixture
def model():
    """Two states that do not act on each other: the large one is steady at once, the small one is slow."""
    return LinearModel(
        np.diag([0.0, 0.99]), [[0.0], [0.0]], [[0.0, 1.0]], np.diag([LARGE, 0.01 * SMALL]), 100.0 * SMALL
    )


@pytest.mark.parametrize(
    ("design", "keys"), [(wasserstein_kalman.design, {"radius": 0.0}), (h_infinity.design, {"theta": 0.0})]
)
def test_gains_are_those_of_the_kalman_filter(design, keys, model):
    """Oracle: `kalman`, whose gain of the small state still changes."""
    expected = kalman.design(model, STEPS, **START).L
    assert expected[1, 1, 0] > 1.5 * expected[STEPS, 1, 0]
    np.testing.assert_allclose(design(model, STEPS, **START, **keys).L, expected, **ROUND)


def test_windows_are_those_of_the_kalman_filter(model, rng):
    """Oracle: `kalman`; also for a run with a missing measurement."""
    y, u = 3.0 * np.sqrt(SMALL) * rng.standard_normal((3, STEPS + 1, 1)), np.zeros((3, 1))
    y[1, 4] = np.nan
    filters = moving_horizon.design(model, STEPS, **START, window=3), kalman.design(model, STEPS, **START)
    states = [each.init(3) for each in filters]
    for k in range(STEPS + 1):
        x_hat = []
        for i, each in enumerate(filters):
            state, estimate = each.correct(k, states[i], y[:, k])
            x_hat.append(estimate.x_hat[:, 1])
            states[i] = each.predict(k, state, u)
        np.testing.assert_allclose(*x_hat, rtol=1e-10, atol=1e-10 * np.sqrt(SMALL))  # two methods, over 60 steps


def test_equal_covariances_in_any_units(rng):
    """Oracle: the same matrices in other units."""
    P, units = np.array([[2.0, 0.5], [0.5, 1.0]]), np.outer([1e6, 1e-6], [1e6, 1e-6])
    for change, same in ((1e-12, True), (1e-8, False)):
        for i, j in ((0, 0), (0, 1), (1, 1)):
            other = P.copy()
            other[i, j] += change
            assert nearly_equal(other, P, 1e-10) == same
            assert nearly_equal(other * units, P * units, 1e-10) == same
    stack = np.stack([P, P + 1e-8, np.full((2, 2), np.nan)])
    np.testing.assert_array_equal(nearly_equal(stack, P, 1e-10), [True, False, False])
    assert nearly_equal(np.zeros((2, 2)), np.zeros((2, 2)), 1e-10)
