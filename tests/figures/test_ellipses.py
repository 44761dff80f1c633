"""Covariance ellipses among the runs, read back from the artists."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from conftest import ROUND
from data_frames import arrays
from data_frames import series as series_of
from figure_tables import legend

from rmpc_bench.figures.ellipses import Ellipse, Ellipses, outline
from rmpc_bench.figures.files import save
from rmpc_bench.figures.palette import DIM, METHODS, paler
from rmpc_bench.types import DesignError, MetricInfo
from rmpc_bench.types.result_layout import NO_MOMENTS, NO_P


def ellipses(trials, **keys):
    return Ellipses(**{"x": "x0_end", "y": "x1_end"} | keys).draw(trials)


INFOS = (MetricInfo("x0_end", "m", "zero"), MetricInfo("x1_end", "m/s^2", "zero"))
ROBUST = np.array([[14.4, -22.7], [-22.7, 76.4]])  # souto2011, section 5
CLASSIC = np.array([[3.7, -0.6], [-0.6, 0.1]])
N = 20


def x_hat(method, k):
    return np.array([1.0 + k, -2.0 * k]) * (1 if method == "classic" else 3)


@pytest.fixture
def runs():
    return np.random.default_rng(3).normal(size=(2, 30))  # values of two metrics


@pytest.fixture
def trials(make_trials, with_series, runs):
    """Two methods with the matrices of the chapter, that of the classic one over k, and the same true states."""
    x, y = (dict.fromkeys(("classic", "robust"), list(values)) for values in runs)
    table = make_trials({"x0_end": x, "x1_end": y}, INFOS)
    entries = []
    for method in ("classic", "robust"):
        for i in (0, 1):
            over_k = np.array([x_hat(method, k)[i] for k in range(N + 1)])
            entries += [(method, "mean(x_hat)", f"{i}", over_k + 9, 500), (method, "mean(x_hat)", f"{i}", over_k, 0)]
            for j in (0, 1):
                constant = [ROBUST[i, j]]
                growing = CLASSIC[i, j] * (1 + np.arange(N + 1.0))
                entries.append((method, "P", f"{i},{j}", growing if method == "classic" else constant, 0))
    return with_series(table, *entries)


def rings(figure, color):
    """The ellipses of a colour, without the centre."""
    lines = [line for line in figure.axes[0].lines if line.get_color() == color and line.get_marker() == "None"]
    return [np.array(line.get_xydata()) for line in lines]


def centre(figure, color):
    (line,) = [line for line in figure.axes[0].lines if line.get_color() == color and line.get_marker() == "+"]
    return np.array(line.get_xydata())[0]


def dots(figure):
    lines = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    return {line.get_color(): np.array(line.get_xydata()).T for line in lines}


def distances(points, centre, P):
    """Squared distance of points from a centre in the metric of P."""
    return np.einsum("pi,ij,pj->p", points - centre, np.linalg.inv(P), points - centre)


@pytest.mark.parametrize("k", [None, 0, 7])
def test_points_satisfy_the_equation(trials, k):
    """(z - c)' P^-1 (z - c) = s^2, all around; the last sample by default; exact centres count."""
    figure = ellipses(trials, k=k)
    at = N if k is None else k
    for color, method in zip(METHODS, ("classic", "robust"), strict=False):
        P = CLASSIC * (1 + at) if method == "classic" else ROBUST
        c = x_hat(method, at)
        assert np.array_equal(centre(figure, color), c)
        for radius, points in zip((1.0, 3.0), rings(figure, color), strict=True):
            np.testing.assert_allclose(distances(points, c, P), radius**2, rtol=1e-9)  # P of condition 1e3
            np.testing.assert_allclose(points[0], points[-1], **ROUND)
            reach = radius * np.sqrt(np.diag(P))
            np.testing.assert_allclose(points.max(axis=0) - c, reach, rtol=1e-3)  # between two of 181 points
            np.testing.assert_allclose(c - points.min(axis=0), reach, rtol=1e-3)
    assert figure.axes[0].get_title() == f"at k = {at}"


def test_dots_axes_and_legend(trials, runs):
    """The values of the runs, once, as they are the same for both; names with units; the radii by their lines."""
    figure = ellipses(trials)
    assert list(dots(figure)) == [DIM] and np.array_equal(dots(figure)[DIM], runs)
    assert figure.axes[0].get_xlabel() == "x0 end [m]" and figure.axes[0].get_ylabel() == "x1 end [m/s$^{2}$]"
    assert sorted(legend(figure)) == [r"$1\sigma$", r"$3\sigma$", "30 runs", "classic", "robust"]
    (box,) = figure.legends
    samples = dict(zip((text.get_text() for text in box.get_texts()), box.get_lines(), strict=True))
    lines = [line for line in figure.axes[0].lines if line.get_color() == METHODS[0]]
    for line, text, dashes in zip(lines, (r"$1\sigma$", r"$3\sigma$"), ("-", "--"), strict=False):
        assert line.get_linestyle() == samples[text].get_linestyle() == dashes
    assert lines[0].get_linewidth() > lines[1].get_linewidth() and samples["robust"].get_color() == METHODS[1]
    assert figure.axes[0].get_aspect() == "auto"


def test_radii_and_components(trials):
    figure = ellipses(trials, x="x1_end", y="x0_end", sigmas=(0.5, 1, 2, 2.5), components=(1, 0), order=["robust"])
    found = rings(figure, METHODS[1])
    for radius, points in zip((0.5, 1, 2, 2.5), found, strict=True):
        away = distances(points, x_hat("robust", N)[::-1], ROBUST[::-1, ::-1])
        np.testing.assert_allclose(away, radius**2, rtol=1e-9)
    assert rings(figure, METHODS[0]) == [] and r"$2.5\sigma$" in legend(figure) and "classic" not in legend(figure)


def test_values_that_depend_on_the_method(trials, runs):
    """Each method has its own dots, paler; failed runs have none and do not make values depend on the method."""
    frame = trials.frame.copy()
    robust = frame["method"] == "robust"
    frame.loc[robust, "x0_end"] += 1
    frame.loc[robust & (frame["run"] < 2), "status"] = "diverged"
    frame.loc[robust & (frame["run"] == 2), "x1_end"] = np.inf
    figure = ellipses(replace(trials, columns=arrays(frame)))
    assert set(dots(figure)) == {paler(color, 0.35) for color in METHODS[:2]}
    assert np.array_equal(dots(figure)[paler(METHODS[0], 0.35)], runs)
    assert np.array_equal(dots(figure)[paler(METHODS[1], 0.35)], (runs + [[1], [0]])[:, 3:])
    assert figure.axes[0].get_title() == "at k = 20, 2 failed, 1 did not occur" and "27 to 30 runs" in legend(figure)
    frame = trials.frame.copy()
    frame.loc[(frame["method"] == "classic") & (frame["run"] == 4), ["status", "x0_end"]] = ["diverged", np.nan]
    figure = ellipses(replace(trials, columns=arrays(frame)))
    assert np.array_equal(dots(figure)[DIM], np.delete(runs, 4, axis=1))
    assert figure.axes[0].get_title() == "at k = 20, 1 failed" and "29 runs" in legend(figure)


def test_very_different_scales_are_no_segment():
    """A state in nanometres beside one in kilometres: condition 1e24, but no correlation of 1."""
    P = np.array([[1e-18, 0.5e-6 * 1e-6], [0.5e-6 * 1e-6, 1e6]])
    points = outline(Ellipse(np.zeros(2), P), 1.0)
    assert len(points) > 100
    scale = np.sqrt(np.diag(P))
    np.testing.assert_allclose(distances(points / scale, np.zeros(2), P / np.outer(scale, scale)), 1.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("P", "shape", "ends"),
    [
        ([[4.0, 1.0], [1.0, 9.0]], "ellipse", None),
        ([[4.0, -6.0], [-6.0, 9.0]], "segment", [[2, -3], [-2, 3]]),
        ([[3.6, -0.6], [-0.6, 0.1]], "segment", [[3.6**0.5, -(0.1**0.5)], [-(3.6**0.5), 0.1**0.5]]),
        # The sides of this ellipse are 0.01 standard deviations from its axis.
        ([[1.0, 0.99995], [0.99995, 1.0]], "segment", None),
        ([[4.0, 0.0], [0.0, 0.0]], "segment", [[2, 0], [-2, 0]]),
        ([[0.0, 0.0], [0.0, 9.0]], "segment", [[0, 3], [0, -3]]),
        ([[0.0, 0.0], [0.0, 0.0]], "point", [[0, 0], [0, 0]]),
        ([[1.0, 2.0], [2.0, 1.0]], "none", None),
        ([[-1.0, 0.0], [0.0, 1.0]], "none", None),
        ([[np.nan, 0.0], [0.0, 1.0]], "none", None),
    ],
)
def test_a_degenerate_ellipse_is_seen_and_named(trials, tmp_path, P, shape, ends):
    """A broad line with marks at its ends, a large cross, or none; the legend says so, and the others are drawn.

    A segment lies along the only direction, to the radius, drawn once so that dashes stay dashes.
    """
    ellipse = Ellipse(np.array([1.0, -1.0]), np.array(P))
    points = outline(ellipse, 2.0)
    assert ellipse.shape == shape and (points is None) == (shape == "none")
    if ends:
        np.testing.assert_allclose(points, [1.0, -1.0] + 2.0 * np.array(ends), atol=1e-12)  # the centre's rounding
    series = trials.series.copy()
    for i, j in product((0, 1), repeat=2):
        its = (series["method"] == "robust") & (series["quantity"] == "P") & (series["component"] == f"{i},{j}")
        series.loc[its, "value"] = P[i][j]
    figure = ellipses(replace(trials, over_time=series_of(series)))
    mine = [line for line in figure.axes[0].lines if line.get_color() == METHODS[1]]
    broad = [line for line in mine if line.get_linewidth() > 2.0 and line.get_linestyle() != "None"]
    crosses = [line for line in mine if line.get_marker() == "x" and line.get_markersize() >= 8]
    assert bool(broad) == (shape == "segment") and bool(crosses) == (shape == "point")
    assert len(rings(figure, METHODS[0])) == 2 and bool(rings(figure, METHODS[1])) == (shape in ("ellipse", "segment"))
    text = {"segment": " (segment: $P$ is singular)", "point": " (point: $P = 0$)", "none": " (no ellipse)"}
    assert f"robust{text.get(shape, '')}" in [each.replace("\n", " ") for each in legend(figure)]
    save(figure, tmp_path, shape)


def test_centres_from_runs_and_points_of_a_sweep(trials, make_sweep):
    """The mean over the runs where there are no exact ones; a point is named above the sample."""
    sampled = replace(trials, over_time=[each for each in trials.over_time if each.n or each.quantity == "P"])
    assert np.array_equal(centre(ellipses(sampled), METHODS[0]), x_hat("classic", N) + 9)
    sweep = make_sweep(({"model.d": "1"}, trials), ({"model.d": "2"}, trials))
    assert ellipses(sweep, at={"model.d": 2}).axes[0].get_title() == "d=2\nat k = 20"


def test_a_method_without_P(trials):
    """It has no ellipse, and is not shown unless asked for.  Errors have the way out."""
    P, method = trials.series["quantity"] == "P", trials.series["method"]
    lacking = trials.series[~(P & (method == "classic"))]
    assert "classic" not in legend(ellipses(replace(trials, over_time=series_of(lacking))))
    for series, keys, message in (
        (lacking, {"order": ["classic"]}, "'classic' has no P (those that have: robust)"),
        (trials.series[P], {}, NO_MOMENTS),
        (trials.series[trials.series["quantity"] == "mean(x_hat)"], {}, NO_P),
        (trials.series, {"k": 21}, "there is no sample 21 (the samples are 0 to 20)"),
        (trials.series, {"sigmas": ()}, "must be 1 to 4 positive numbers"),
        (trials.series, {"sigmas": (1, -1)}, "must be 1 to 4 positive numbers"),
    ):
        with pytest.raises(DesignError) as error:
            ellipses(replace(trials, over_time=series_of(series)), **keys)
        assert str(error.value) == message and error.value.parameter == next(iter(keys), "")
