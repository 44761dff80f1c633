"""Filters of filterpy against the Kalman filter of the bench, in a closed loop and alone."""

import numpy as np
import pytest

pytest.importorskip("filterpy")

import adapters.filterpy_filters as filters
from components.one_run import designed, experiment, kalman, simulated

from rmpc_bench.components.single_run import single_run


@single_run
class Law:
    """A state feedback, so that an error of the estimate acts on the plant."""

    def control(self, x_hat, k):
        """Feed back, and excite the plant."""
        return [0.5 * np.sin(k) - x_hat[0] - 0.4 * x_hat[1]]


def loop(estimator):
    """Return the trajectories of a closed loop."""
    status, _, traces, journals = simulated(experiment(estimator, designed("controllers", Law)))
    assert not status.any(), journals[0].failures
    return traces


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("kf", 1e-12),
        ("kf_column", 1e-12),
        ("square_root", 1e-12),
        ("information", 1e-12),
        ("ekf", 1e-12),
        ("ekf_column", 1e-12),
        ("imm", 1e-12),
        ("ukf", 1e-10),
        ("ckf_redrawn", 1e-10),
    ],
)
def test_it_is_the_kalman_filter(name, tolerance):
    """On a linear model all of them have its estimates, inputs and states."""
    ours, theirs = loop(kalman()), loop(designed("estimators", getattr(filters, name)))
    assert np.abs(ours["u"]).min() > 1e-3
    for signal in ("x_hat", "u", "x"):
        np.testing.assert_allclose(theirs[signal], ours[signal], rtol=0, atol=tolerance)
