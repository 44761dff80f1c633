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
    [("KF", 1.492, 5.031, 2.208), ("ESM", 1.152, 3.733, 1.882), ("MIX", 1.155, 3.745, 1.885)],
)
def test_errors_of_the_study(trials_of, method, mae, mse, rmse):
    """Oracle: the study's Table I, 4000 rounds of other draws, noise as printed, x(0) of (77) with a uniform part."""
    _, trials = trials_of("ma2025/table1")
    for metric, expected, se in (("mae", mae, 0.003), ("mse", mse, 0.031), ("rmse", rmse, 0.008)):
        assert agrees(column(trials, metric, method), expected, se), metric


@pytest.mark.parametrize(
    ("method", "error", "mse"),
    [("RCKF", 2.854, (35.77, 0.12)), ("RCESM", 1.682, (33.10, 0.07)), ("RCMIX", 1.694, (32.96, 0.07))],
)
def test_another_interpretation_of_the_study(trials_of, method, error, mse):
    """Oracle: the study's Tables I and II where noise is moved to the edge and rounds start at x_hat(0)."""
    _, trials = trials_of("ma2025/noise-laws")
    columns = [column(trials, metric, method, name="project from x_hat(0)") for metric in ("error", "mse")]
    assert agrees(columns[0], error, 0.010) and agrees(columns[1], *mse)


@pytest.mark.parametrize(
    ("method", "mse"),
    [("RCKF", (36.9, 1.1)), ("RCESM", (34.2, 1.1)), ("RCMIX", (34.1, 1.1))],
)
def test_regulation_of_the_study(trials_of, method, mse):
    """Oracle: the study's Table II, 100 rounds of other draws, noise moved to the edge, x(0) of (77)."""
    _, trials = trials_of("ma2025/noise-laws")
    assert agrees(column(trials, "mse", method, name="project"), *mse)


DIFFERENCES = {  # of the mean square from that of LQR-MIX, with their errors; symmetric v, then asymmetric v
    "LQG": ((3.0101, 0.0089), (1.7589, 0.0071)),
    "LQG-mm": ((2.4663, 0.0074), (1.3998, 0.0058)),
    "LQR-ESM": ((0.1368, 0.0005), (0.0593, 0.0004)),
    "game-MIX": ((-0.3204, 0.0015), (-0.1497, 0.0013)),
}


@pytest.mark.parametrize("method", DIFFERENCES)
def test_where_the_gain_comes_from(trials_of, method):
    """Oracle: paired differences of a replay in NumPy, 4000 rounds of other draws, noise and x(0) as printed."""
    _, trials = trials_of("ma2025/ablation")
    for point, expected in zip(("symmetric v", "asymmetric v"), DIFFERENCES[method], strict=True):
        difference = column(trials, "mse", method, name=point) - column(trials, "mse", "LQR-MIX", name=point)
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
