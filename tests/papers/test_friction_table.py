"""estimators/friction: changes of the MSE on the plants of Fig. 7, as an independent study has them."""

import numpy as np
import pytest
from conftest import STAT

pytestmark = pytest.mark.slow

WITHOUT_NOISE = {
    "R-MPC": -10.9,
    "WKF-0.1": -5.1,
    "WKF-1": -13.7,
    "h-infinity": -5.2,
    "fading-1.05": -12.6,
    "fading-1.2": -16.2,
    "KF-R": -16.3,
    "UKF": -1.2,
    "EKF-narrow": -8.0,
    "EKF": -7.8,
}
"""Geometric mean of the ratios to S-MPC, as a change [%]; the study has these plants, and filters of its own."""
PRINTED = 0.1
"""One unit of the last printed digit of the study [%]."""


@pytest.fixture
def columns(trials_of):
    """Return a function from a metric, a method and the name of a point to the values of all runs."""
    trials = trials_of("estimators/friction")[1]

    def column(metric, method, name="no noise"):
        (table,) = [each for each in trials.points if each.point["name"] == name]
        return table.column(metric, method)

    return column


def log_ratio(columns, method, name="no noise"):
    """Return the logarithm of the ratio of the MSE to that of S-MPC, run by run."""
    return np.log(columns("mse", method, name) / columns("mse", "S-MPC", name))


@pytest.mark.parametrize("method", WITHOUT_NOISE)
def test_changes_without_noise_to_the_printed_digit(columns, method):
    """Oracle: the study."""
    change = 100.0 * np.expm1(log_ratio(columns, method).mean())
    assert change == pytest.approx(WITHOUT_NOISE[method], abs=PRINTED)


def test_the_mean_of_the_reference(columns):
    """Oracle: the study, 0.1209 with a standard error of 0.0016."""
    assert columns("mse", "S-MPC").mean() == pytest.approx(0.1209, abs=5e-5)


@pytest.mark.parametrize("method", ["KF-R", "UKF", "EKF", "fading-1.2"])
def test_a_little_noise_changes_nothing(columns, method):
    """The study: the same table to 0.1 % with 0.02 rad; the noise is ours, so the pairs decide."""
    difference = log_ratio(columns, method, "0.02 rad") - log_ratio(columns, method)
    assert abs(difference.mean()) <= STAT * difference.std(ddof=1) / np.sqrt(len(difference)) + 1e-3


def test_runs_that_do_not_settle(columns):
    """Oracle: the study, 13 of 200 runs with a tiny step and none with one of a standard deviation."""
    assert np.sum(~(columns("settling_time", "EKF-narrow") < 20.0)) == 13
    assert np.all(columns("settling_time", "EKF") < 20.0)


def test_roughness_of_the_voltage_with_noise(columns):
    """Oracle: the study, S-MPC 7.75 V at 0.1 rad, with noises of its own."""
    values = columns("input_roughness", "S-MPC", "0.1 rad")
    assert abs(values.mean() - 7.75) <= STAT * values.std(ddof=1) / np.sqrt(len(values)) + 5e-3  # the printed digit
