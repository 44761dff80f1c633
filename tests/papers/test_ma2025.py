"""ma2025 at full size: the numbers of an independent study of the paper."""

import numpy as np
import pytest

pytestmark = pytest.mark.slow


def column(trials, metric, method, **point):
    """Values of a metric over the runs, in order."""
    rows = trials.frame[trials.frame["method"] == method]
    for name, value in point.items():
        rows = rows[rows[name] == value]
    return rows.sort_values("run")[metric].to_numpy()


def agrees(values, expected, se):
    """Whether a mean is within 5 standard errors, ours and the study's together, of what the study measured."""
    own = values.std(ddof=1) / np.sqrt(len(values))
    return abs(values.mean() - expected) <= 5.0 * np.hypot(own, se)


@pytest.mark.parametrize(
    ("method", "mae", "mse", "rmse"),
    [("KF", 1.334, 2.854, 1.683), ("ESM", 1.022, 1.682, 1.294), ("MIX", 1.026, 1.694, 1.299)],
)
def test_errors_of_the_study(trials_of, method, mae, mse, rmse):
    """Oracle: the study's Table I, 4000 rounds of other draws, noise moved to the edge, x(0) = x_hat(0)."""
    _, trials = trials_of("ma2025/table1")
    for metric, expected, se in (("mae", mae, 0.003), ("mse", mse, 0.010), ("rmse", rmse, 0.003)):
        assert agrees(column(trials, metric, method), expected, se), metric


@pytest.mark.parametrize(
    ("method", "mae", "mse"),
    [
        ("RCKF", (2.999, 0.022), (35.77, 0.12)),
        ("RCESM", (2.455, 0.016), (33.10, 0.07)),
        ("RCMIX", (2.424, 0.016), (32.96, 0.07)),
    ],
)
def test_regulation_of_the_study(trials_of, method, mae, mse):
    """Oracle: the study's Table II, 100 rounds of other draws."""
    _, trials = trials_of("ma2025/table2")
    assert agrees(column(trials, "mae", method), *mae) and agrees(column(trials, "mse", method), *mse)


DIFFERENCES = {  # of the mean square from RCMIX's, with their errors; symmetric v, then asymmetric v (there at N = 20)
    "LQG": ((2.811, 0.055), (1.611, 0.041)),
    "LQG-mm": ((2.301, 0.046), (1.278, 0.034)),
    "RCKF": ((2.802, 0.055), (1.598, 0.041)),
    "LQR-ESM": ((0.140, 0.003), (0.064, 0.002)),
    "game-MIX": ((-0.249, 0.007), (-0.091, 0.005)),
    "LQG-known": ((-2.428, 0.051), (-0.006, 0.051)),
}


@pytest.mark.parametrize("method", DIFFERENCES)
def test_where_the_gain_comes_from_in_the_study(trials_of, method):
    """Oracle: the study's paired differences, 100 rounds of other draws; horizons 20 and 100 differ by less."""
    _, trials = trials_of("ma2025/ablation")
    for point, expected in zip(("symmetric v", "asymmetric v"), DIFFERENCES[method], strict=True):
        difference = column(trials, "mse", method, name=point) - column(trials, "mse", "RCMIX", name=point)
        assert agrees(difference, *expected), point


@pytest.mark.parametrize(
    ("method", "trace", "det"),
    [
        ("MIX", 44.348, 295.90),
        ("MIX-l", 44.352, 295.84),
        ("MIX-1", 43.946, 284.35),
        ("ESM", 110.98, 1879.0),
        ("ESM-b", 44.318, 295.44),
    ],
)
def test_sizes_of_sets_to_the_digits_of_the_study(trials_of, method, trace, det):
    """Oracle: the study's traces and volumes; they do not depend on chance."""
    _, trials = trials_of("ma2025/table1")
    M = trials.matrix_series("M", method)[1:]
    digits = [0.0005 if trace < 100 else 0.005, 0.005 if det < 1000 else 0.05]
    ours = np.trace(M, axis1=1, axis2=2).mean(), np.linalg.det(M).mean()
    assert abs(ours[0] - trace) <= digits[0] and abs(ours[1] - det) <= digits[1]


def test_the_printed_bound_is_exceeded_at_the_horizon_of_the_paper(trials_of):
    """Oracle: the study's rho and the cost that its own search found at N = 100, k = 20, to the digits given."""
    _, trials = trials_of("ma2025/certificate")
    point = {"controller.set": "stacked", "controller.horizon": "100"}
    rho, ratio = (column(trials, metric, "RCMIX", **point) for metric in ("rho", "at_20"))
    assert np.all(np.abs(rho - 62_908) <= 0.5) and np.all(np.abs(rho * ratio - 4.12e6) <= 0.005e6)
