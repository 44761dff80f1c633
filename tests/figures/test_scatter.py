"""Methods in the plane of two metrics, read back from the artists."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import ROUND
from data_frames import arrays
from figure_tables import legend
from matplotlib.colors import to_hex

from rmpc_bench.analysis.traces import Traces
from rmpc_bench.figures.axes import FAR
from rmpc_bench.figures.palette import DIM, METHODS
from rmpc_bench.figures.scatter import Scatter, dots_of, not_dominated
from rmpc_bench.figures.style import Rendering, rendered
from rmpc_bench.types import DesignError, MetricInfo


def scatter(trials, **keys):
    return Scatter(**keys).draw(trials)


ERROR, EFFORT = MetricInfo("error", "mm", "lower"), MetricInfo("effort", "N m", "lower")
SCORE, BIAS, RATIO = MetricInfo("score", "", "higher"), MetricInfo("bias", "mm", "zero"), MetricInfo("nees", "x", "one")
INF = math.inf


@pytest.fixture
def columns():
    """Nine runs of four methods; the medians of A to D are 1, 2, 3, 4 times those of another column."""
    base = np.exp(0.1 * np.random.default_rng(7).normal(size=9))
    return {name: list(number * base) for number, name in enumerate("ABCD", start=1)}


@pytest.fixture
def trials(make_trials, columns):
    """Error grows from A to D; effort falls from A to C, and D is dominated by C."""
    effort = {"A": columns["D"], "B": columns["B"], "C": columns["A"], "D": columns["C"]}
    return make_trials({"error": columns, "effort": effort}, infos=(ERROR, EFFORT))


def draw(trials, **keys):
    return scatter(trials, **{"x": "error", "y": "effort", **keys})


def dots(figure):
    """Colour -> (x, y, whether it is filled) of the dots, in the order in which they are drawn."""
    found = {}
    for line in figure.axes[0].lines:
        if line.get_marker() != "None":
            place = (line.get_xdata()[0], line.get_ydata()[0], to_hex(line.get_markerfacecolor()) != "#ffffff")
            found.setdefault(to_hex(line.get_markeredgecolor()), []).append(place)
    return found


def steps(figure):
    (line,) = [line for line in figure.axes[0].lines if line.get_color() == DIM]
    return [tuple(corner) for corner in np.array(line.get_xydata()).tolist()]


def bars(figure):
    """Ends of the bars, as ((x, x), (y, y)), those without a length left out."""
    lines = [np.array(line.get_xydata()).T for line in figure.axes[0].lines if line.get_zorder() == 2.4]
    return [line.tolist() for line in lines]


def texts(figure):
    return [text.get_text() for text in figure.axes[0].texts]


def test_medians_with_quartiles_and_means_with_standard_errors(trials):
    """Quartiles of numpy, or s / sqrt(n) on both sides; labels beside the dots, metrics with units on the axes."""
    figure = draw(trials)
    expected = []
    for name, color in zip("ABCD", METHODS, strict=False):
        x, y = (np.quantile(trials.column(metric, name), [0.25, 0.5, 0.75]) for metric in ("error", "effort"))
        ((drawn_x, drawn_y, _),) = dots(figure)[color]
        np.testing.assert_allclose([drawn_x, drawn_y], [x[1], y[1]], **ROUND)
        expected += [[[x[0], x[2]], [y[1], y[1]]], [[x[1], x[1]], [y[0], y[2]]]]
    np.testing.assert_allclose(bars(figure), expected, **ROUND)
    assert texts(figure) == ["A", "B", "C", "D"] and legend(figure) == ["not dominated"]
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("error [mm]", "effort [N m]")
    assert axes.get_title() == "medians, bars: interquartile range, 9 runs"
    figure = draw(trials, bars="se", order=["B"])
    values = trials.column("error", "B")
    se = values.std(ddof=1) / 3.0
    ((x, *_),) = dots(figure)[METHODS[1]]
    np.testing.assert_allclose(x, values.mean(), **ROUND)
    np.testing.assert_allclose(bars(figure)[0][0], [values.mean() - se, values.mean() + se], **ROUND)
    assert figure.axes[0].get_title() == "means, bars: standard errors, 9 runs"


def brute_force(points):
    """Points that no other one is at least as good as in both, better in one; smaller is better."""
    return [a for a in points if not any(all(q <= p for p, q in zip(a, b, strict=True)) and a != b for b in points)]


def test_the_front_against_brute_force(trials, make_trials):
    """Filled dots are those of the front; steps go from one to the next, first to the side, then down."""
    figure = draw(trials)
    filled = [each[:2] for color in METHODS[:4] for each in dots(figure).get(color, []) if each[2]]
    every = [each[:2] for each in (dots(figure)[color][0] for color in METHODS[:4])]
    front = sorted(brute_force(every))
    assert sorted(filled) == front and len(front) == 3
    (a, b, c) = front
    assert steps(figure) == [a, (b[0], a[1]), b, (c[0], b[1]), c]
    rng = np.random.default_rng(3)
    names = "abcdefghijkl"
    for _ in range(5):
        made = {metric: {name: [float(rng.integers(1, 6))] for name in names} for metric in ("error", "effort")}
        table = make_trials(made, infos=(ERROR, EFFORT))
        found = not_dominated(dots_of([table], names, (ERROR, EFFORT), "quartiles"), (ERROR, EFFORT))
        points = [(made["error"][name][0], made["effort"][name][0]) for name in names]
        assert [dot.at for dot in found] == sorted(brute_force(points))


def test_larger_may_be_better(trials, make_trials):
    """Steps then go the other way; the corner lies on the side of what is worse.  Without a front all are filled."""
    score, effort = {"A": [5.0], "B": [3.0], "C": [2.0]}, {"A": [4.0], "B": [1.0], "C": [2.0]}
    figure = scatter(make_trials({"score": score, "effort": effort}, (SCORE, EFFORT)), x="score", y="effort")
    assert [dots(figure)[color][0][2] for color in METHODS[:3]] == [True, True, False]
    assert steps(figure) == [(5.0, 4.0), (3.0, 4.0), (3.0, 1.0)] and figure.axes[0].get_title() == "1 run"
    figure = draw(trials, front=False)
    assert all(each[2] for found in dots(figure).values() for each in found) and not figure.legends
    assert DIM not in [line.get_color() for line in figure.axes[0].lines]


def test_axes_of_distances_and_logarithmic_axes(make_trials, trials):
    table = make_trials({"bias": {"A": [-3.0, 1.0, -2.0]}, "nees": {"A": [0.5, 1.0, 8.0]}}, infos=(BIAS, RATIO))
    figure = scatter(table, x="bias", y="nees")
    ((x, y, _),) = dots(figure)[METHODS[0]]
    np.testing.assert_allclose([x, y], [2.0, 2.0], **ROUND)
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("|bias| [mm]", "max(NEES, 1/NEES)")
    axes = draw(trials, log=True).axes[0]
    assert axes.get_xscale() == axes.get_yscale() == "log"
    table = make_trials({"error": {"A": [0.0, 0.0, 1.0]}, "effort": {"A": [1.0, 2.0, 3.0]}}, infos=(ERROR, EFFORT))
    axes = draw(table, log=True).axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("linear", "log")
    assert axes.get_xlabel() == "error [mm]\n(linear: some <= 0)"


def test_failed_and_infinite(make_trials):
    """Failed runs do not count, and the label says so; an infinite bar ends at the edge."""
    nan = "diverged"
    table = make_trials(
        {
            "error": {"A": [1.0, 2.0, 3.0, nan], "B": [1.0, 1.0, INF, 1.0], "C": [INF, INF, 1.0, INF]},
            "effort": {"A": [2.0, 4.0, 6.0, 5.0], "B": [1.0, 2.0, 3.0, 4.0], "C": [1.0] * 4},
        },
        infos=(ERROR, EFFORT),
    )
    figure = draw(table)
    ((x, y, _),) = dots(figure)[METHODS[0]]
    assert (x, y) == (2.0, 4.0) and texts(figure) == ["A, 3/4", "B, n=4"]
    assert figure.axes[0].get_title() == "medians, bars: interquartile range; left out: C"
    assert [bar for bar in bars(figure) if max(bar[0]) > 1e99] == [[[1.0, FAR], [2.5, 2.5]]]
    assert METHODS[2] not in dots(figure) and max(figure.axes[0].get_xlim()) < 5
    with pytest.raises(DesignError, match="no method has a value of both error and effort"):
        draw(make_trials({"error": {"A": [nan]}, "effort": {"A": [nan]}}, infos=(ERROR, EFFORT)))


@pytest.fixture
def sweep(trials, make_sweep):
    """B does not depend on the path; A is better in error and worse in effort from point to point."""
    tables = []
    for number in range(3):
        frame = trials.frame[trials.frame["method"].isin(["A", "B"])].copy()
        mine = frame["method"] == "A"
        frame.loc[mine, "error"] /= 1.0 + number
        frame.loc[mine, "effort"] *= 1.0 + number
        value = str(number)
        keys = {"A": value, "B": "b"}
        tables.append(
            ({"kp": value}, replace(trials, methods=("A", "B"), columns=arrays(frame), keys=keys, title=f"kp={value}"))
        )
    table = make_sweep(*tables)
    return replace(table, columns=arrays(pd.concat([each.frame for _, each in tables])))


def test_the_points_of_a_sweep(sweep):
    """In its order, joined; what points share is one dot with the name of its method, the others have their values."""
    figure = draw(sweep)
    mine = [each[:2] for each in dots(figure)[METHODS[0]]]
    expected = [[np.median(point.column(metric, "A")) for metric in ("error", "effort")] for point in sweep.points]
    np.testing.assert_allclose(mine, expected, **ROUND)
    (line,) = [each for each in figure.axes[0].lines if len(each.get_xdata()) == 3]
    np.testing.assert_allclose(line.get_xydata(), expected, **ROUND)
    assert len(dots(figure)[METHODS[1]]) == 1
    assert texts(figure) == ["kp=0", "kp=1", "kp=2", "B"] and legend(figure) == ["A", "not dominated"]
    assert texts(draw(sweep, at=[{"kp": 2}, {"kp": 0}])) == ["kp=2", "kp=0", "B"]
    assert texts(draw(sweep, at=[{"kp": 1}])) == ["A", "B"]


@pytest.mark.parametrize("n", [1, 8])
def test_labels_cover_nothing(make_trials, n):
    """Short ones stand beside the dots, inside the panel; where they do not fit, all of them are in the legend."""
    rng = np.random.default_rng(11)
    names = [f"M{number}" for number in range(n)]
    made = {metric: {name: list(rng.random(3)) for name in names} for metric in ("error", "effort")}
    table = make_trials(made, infos=(ERROR, EFFORT))
    figure = draw(table)
    panel = figure.axes[0].get_window_extent()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts]
    assert len(boxes) == n
    for number, box in enumerate(boxes):
        assert panel.x0 <= box.x0 and box.x1 <= panel.x1 and panel.y0 <= box.y0 and box.y1 <= panel.y1
        assert not any(box.overlaps(other) for other in boxes[:number])
    long = {name: f"tuned penalties and a Kalman filter, $c=10^{{{name[1:]}}}$" for name in names}
    with rendered(Rendering(labels=True)):
        figure = draw(replace(table, labels=long))
    assert (texts(figure) == []) == (n == 8) and (long["M0"] in legend(figure)) == (n == 8)


@pytest.fixture
def runs(make_trials):
    """Two runs of two methods with two outputs of one unit, which lag behind a circle; run 1 of B failed."""
    t = np.linspace(0, 2 * np.pi, 41)
    r = np.stack([np.cos(t), np.sin(t)], axis=1)
    traces = {}
    for k, name in enumerate("AB"):
        y = np.stack([np.stack([np.cos(t - d), np.sin(t - d)], axis=1) for d in (0.1 * (k + 1), 0.2)])
        x = y.copy()
        if name == "B":
            y[1, 20:] = 1e200
        bursts = np.zeros((2, 41, 1))
        bursts[:, 10:15] = 1.0
        traces[name] = Traces(np.arange(2), {"y": y, "x": x, "bursts": bursts}, r)
    table = make_trials({"error": {"A": [1.0, 2.0], "B": [2.0, "diverged"]}}, infos=(ERROR,))
    limits = {"A": {"x.1": (None, 1.2)}, "B": {"x.0": (-9.0, 9.0)}}
    return replace(table, traces=traces, Ts=0.5, units={"y": "m"}, limits=limits)


def paths(figure):
    """Colour -> points of the lines of a panel that have more than two."""
    lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) > 2 and line.get_linestyle() != "None"]
    return {to_hex(line.get_color()): np.array(line.get_xydata()) for line in lines}


@pytest.mark.parametrize("magnify", [1.0, 10.0])
def test_the_path_of_a_run(runs, magnify):
    """The stored outputs, or the reference with enlarged distances; both axes have one scale."""
    figure = scatter(runs, x="y.0", y="y.1", magnify=magnify, from_=2.0)
    found = paths(figure)
    r = runs.traces["A"].r[4:]
    for color, name in zip(METHODS, "AB", strict=False):
        y = runs.traces[name].signals["y"][0, 4:]
        np.testing.assert_allclose(found[color], r + magnify * (y - r), atol=1e-12)
    np.testing.assert_array_equal(found[DIM], r)
    assert figure.axes[0].get_aspect() == 1.0 and legend(figure) == ["A", "B", "reference", "burst"]
    assert ("\N{MULTIPLICATION SIGN}10" in figure.axes[0].get_xlabel()) == (magnify == 10.0)
    assert "run 0 for A and B, t = 2 to 20 s; dashed: reference" in Scatter(x="y.0", y="y.1", from_=2.0).caption(runs)


def test_marks_failed_runs_and_limits_of_paths(runs):
    """Marks have times, a failed run does not change the axes, and near limits are drawn; states have no reference."""
    figure = scatter(runs, x="y.0", y="y.1", marks=5.0)
    assert texts(figure) == ["0", "5", "10", "15", "20"]
    (circles,) = [line for line in figure.axes[0].lines if line.get_markersize() == 3.2]
    np.testing.assert_array_equal(circles.get_xydata(), runs.traces["A"].r[::10])
    figure = scatter(runs, x="y.0", y="y.1", run=1)
    assert max(map(abs, figure.axes[0].get_xlim())) < 5
    assert "failed: B diverged" in Scatter(x="y.0", y="y.1", run=1).caption(runs)
    figure = scatter(runs, x="x.0", y="x.1")
    lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) == 2]
    assert [line.get_ydata()[0] for line in lines] == [1.2] and legend(figure) == ["A", "B", "limit"]
