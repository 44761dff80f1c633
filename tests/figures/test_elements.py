"""The entries of a reported matrix over time, read back from the artists."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND
from data_frames import arrays
from figure_tables import legend
from matplotlib.patches import Rectangle

from rmpc_bench.analysis.traces import Traces
from rmpc_bench.figures.elements import Elements
from rmpc_bench.figures.palette import METHODS
from rmpc_bench.types import DesignError


def elements(trials, **keys):
    return Elements(**{"signal": "Q_yw"} | keys).draw(trials)


N, RUNS = 50, 2
NAMES = ("constant", "tuned", "KF")
ALL = [(i, j) for i in range(3) for j in range(3)]


@pytest.fixture
def matrices():
    """Q of two methods, (runs, samples, 3, 3); that of `tuned` has no value before k = 4."""
    rng = np.random.default_rng(4)
    Q = {name: rng.normal(size=(RUNS, N, 3, 3)) + 3.0 * np.eye(3) for name in NAMES[:2]}
    Q["tuned"][:, :4] = np.nan
    return Q


@pytest.fixture
def trials(make_trials, matrices):
    """Two methods report a matrix and a vector, the third nothing; the noise has a burst."""
    table = make_trials({"mse": dict.fromkeys(NAMES, [1.0] * RUNS)}, labels={"KF": "Kalman"})
    bursts = np.zeros((RUNS, N + 1, 1))
    bursts[:, 10:21] = 1.0
    traces = {}
    for name in NAMES:
        signals = {"y": np.zeros((RUNS, N + 1, 3)), "bursts": bursts}
        shapes = {}
        if name in matrices:
            signals |= {"Q_yw": matrices[name].reshape(RUNS, N, 9), "r": np.zeros((RUNS, N + 1, 4))}
            shapes = {"Q_yw": (3, 3), "r": (4,)}
        traces[name] = Traces(np.arange(RUNS), signals, np.zeros((N + 1, 3)), shapes)
    return replace(table, traces=traces, Ts=0.1)


def panel(figure, i, j):
    return figure.axes[3 * i + j]


def line(axes, name):
    (found,) = [each for each in axes.lines if each.get_color() == METHODS[NAMES.index(name)]]
    return found


def test_an_entry_is_in_its_place(trials, matrices):
    """Row i, column j: held values in steps, the last one to the end, gaps where there is none."""
    figure = elements(trials, run=1)
    assert len(figure.axes) == 9
    for i, j in ALL:
        for name, Q in matrices.items():
            drawn = line(panel(figure, i, j), name)
            np.testing.assert_array_equal(drawn.get_ydata(), np.append(Q[1, :, i, j], Q[1, -1, i, j]))
            np.testing.assert_array_equal(drawn.get_xdata(), 0.1 * np.arange(N + 1))
            assert drawn.get_drawstyle() == "steps-post"
    assert [panel(figure, 0, j).get_title() for j in range(3)] == [rf"$(Q_{{yw}})_{{\cdot,{j}}}$" for j in range(3)]
    assert [panel(figure, i, 0).get_ylabel() for i in range(3)] == [rf"$(Q_{{yw}})_{{{i},\cdot}}$" for i in range(3)]
    assert legend(figure) == ["constant", "tuned", "burst"]
    assert figure.legends[0].get_title().get_text() == "run 1"
    assert figure.get_supxlabel() == "$t$ [s]"


@pytest.mark.parametrize("rough", [False, True])
def test_samples_of_the_legend_look_as_the_lines(make_trials, trials, rough):
    """Any number of methods: no marker where lines have none, no dashes where lines of rough signals have none."""
    names = [f"M{k}" for k in range(5)]
    own = trials.traces["constant"]
    values = np.full((RUNS, N, 9), 1.0)
    values[:, ::2] += 1.0 if rough else 0.0
    traces = dict.fromkeys(names, own._replace(signals={**own.signals, "Q_yw": values}))
    table = replace(make_trials({"mse": dict.fromkeys(names, [1.0] * RUNS)}), traces=traces, Ts=0.1)
    figure = elements(table)
    samples = figure.legends[0].get_lines()
    assert len(samples) == 5 and len({str(each.get_color()) for each in samples}) == 5
    for sample, drawn in zip(samples, figure.axes[0].lines, strict=True):
        assert sample.get_marker() == drawn.get_marker() == "None"
        assert sample.is_dashed() == drawn.is_dashed()
    assert any(each.is_dashed() for each in samples) != rough


def test_axes_of_the_diagonal_bursts_window_and_a_single_entry(trials):
    figure = elements(trials)
    for group in ([each for each in ALL if each[0] == each[1]], [each for each in ALL if each[0] != each[1]]):
        ((low, high),) = {panel(figure, *each).get_ylim() for each in group}
        values = np.concatenate([line.get_ydata() for each in group for line in panel(figure, *each).lines])
        assert low <= np.nanmin(values) and np.nanmax(values) <= high
    assert panel(figure, 0, 0).get_ylim() != panel(figure, 0, 1).get_ylim()
    assert len({axes.get_xlim() for axes in figure.axes}) == 1
    figure = elements(trials, from_=1.5, to=4.0)
    for axes in figure.axes:
        (band,) = [each for each in axes.patches if isinstance(each, Rectangle)]
        np.testing.assert_allclose([band.get_x(), band.get_width()], [1.5, 0.55], **ROUND)
        np.testing.assert_allclose(axes.get_xlim(), (1.5, 4.0), **ROUND)
    assert legend(elements(trials, from_=3.0, order=["tuned"])) == ["tuned"]
    traces = trials.traces["tuned"]
    S = np.random.default_rng(1).normal(size=(RUNS, N + 1, 1))
    traces = traces._replace(signals={**traces.signals, "S": S}, shapes={"S": (1, 1)})
    figure = elements(replace(trials, traces={"tuned": traces}), signal="S")
    (axes,) = figure.axes
    np.testing.assert_array_equal(line(axes, "tuned").get_ydata(), S[0, :, 0])
    assert line(axes, "tuned").get_drawstyle() == "default" and legend(figure) == ["tuned", "burst"]


def test_a_method_that_failed_does_not_shrink_the_others(trials):
    frame = trials.frame.copy()
    frame.loc[(frame["method"] == "constant") & (frame["run"] == 0), "status"] = "diverged"
    wild = trials.traces["constant"]
    signals = {**wild.signals, "Q_yw": np.full((RUNS, N, 9), 1e99)}
    figure = elements(
        replace(trials, columns=arrays(frame), traces=trials.traces | {"constant": wild._replace(signals=signals)})
    )
    assert figure.legends[0].get_title().get_text() == "run 0, constant diverged"
    alone = elements(trials, order=["tuned"])
    assert [axes.get_ylim() for axes in figure.axes] == [axes.get_ylim() for axes in alone.axes]


def test_errors_show_the_choices(trials):
    """What recorded runs say of the layout; `test_checks` has all other messages."""
    with pytest.raises(DesignError, match=r"r is not a square matrix \(4\): show it with signals"):
        elements(trials, signal="r")
    traces = trials.traces["tuned"]
    other = traces._replace(signals={**traces.signals, "Q_yw": np.ones((RUNS, N, 4))}, shapes={"Q_yw": (2, 2)})
    with pytest.raises(DesignError, match="Q_yw has different sizes in the methods: select some with `order`"):
        elements(replace(trials, traces=trials.traces | {"tuned": other}))


@pytest.mark.parametrize("text", ["A", "tuned penalties and a filter with a rather long name"])
def test_nothing_covers_anything(trials, text):
    """Legend and note above the titles of the columns, all inside the picture; panels large enough to be read."""
    figure = elements(replace(trials, labels=dict.fromkeys(NAMES, text)))
    box = figure.legends[0].get_window_extent()
    assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1 + 1
    for axes in figure.axes:
        extent = axes.get_window_extent()
        assert extent.width > 50 and extent.height > 40  # at 100 dpi
        assert axes.title.get_window_extent().y1 <= box.y0
