"""Filters of filterpy against the Kalman filter of the bench, in a closed loop and alone."""

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("filterpy")

import adapters.filterpy_filters as filters
from adapters.loops import alone, loop, signals
from components.one_run import designed, kalman

from rmpc_bench.adapters.filterpy import filterpy_estimator
from rmpc_bench.components.single_run import design_function
from rmpc_bench.config_file.keys import keys_of

EQUAL = {
    "kf": 1e-12,
    "kf_column": 1e-12,
    "square_root": 1e-12,
    "ekf": 1e-12,
    "ekf_column": 1e-12,
    "imm": 1e-12,
    "ukf": 1e-10,
    "ckf_redrawn": 1e-10,
}
"""Filters that are the Kalman filter on a linear model, with the largest difference that rounding may leave."""


@pytest.mark.parametrize("name", [*EQUAL, "information"])
def test_it_is_the_kalman_filter_in_a_closed_loop(name):
    """It has its estimates, and with them the same inputs and states."""
    ours, theirs = loop(kalman()), loop(designed("estimators", getattr(filters, name)))
    for signal in ("x_hat", "u", "x"):
        np.testing.assert_allclose(theirs[signal], ours[signal], rtol=0, atol=EQUAL.get(name, 1e-12))


@pytest.mark.parametrize("name", EQUAL)
def test_it_is_the_kalman_filter_alone(name):
    """x_hat(0) uses y(0), and the reported covariance is that of x_hat(k)."""
    y, u = signals()
    estimates = alone(designed("estimators", getattr(filters, name)), y, u)
    for got, expected in zip(estimates, alone(kalman(), y, u), strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=EQUAL[name])


def test_every_object_with_predict_and_update():
    """It needs `x`; without `P` no covariance is reported, and without `u` it must not need the input."""

    class Decay:
        def __init__(self, x):
            self.x = x

        def predict(self, u):
            self.x = 0.5 * self.x + u

        def update(self, z):
            self.x = self.x + 0.1 * z

    @filterpy_estimator
    def decay(x0, P0):
        return Decay(x0)

    made = designed("estimators", decay)
    state, first = made.correct(0, made.init(1), np.array([[1.0]]))
    made.predict(0, state, np.array([[2.0]]))
    _, second = made.correct(1, state, np.array([[1.0]]))
    assert first.P is None
    np.testing.assert_allclose(first.x_hat, [[0.6, -0.4]])
    np.testing.assert_allclose(second.x_hat, [[2.4, 1.9]])


def test_keys_are_those_of_the_function():
    """They are validated as keys of a built-in component."""
    fields = keys_of("estimators", "ukf", design_function("estimators", filters.ukf)).model_fields
    assert {*fields} == {"alpha", "on_failure", "max_held"}


def test_the_library_is_imported_on_use():
    """A program that imports the adapters imports neither library."""
    code = (
        "import sys, rmpc_bench.adapters.filterpy, rmpc_bench.adapters.stonesoup\n"
        "assert not {'filterpy', 'stonesoup'} & {*sys.modules}"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
