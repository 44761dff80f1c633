"""Trajectories of what methods report, of control errors, and in bursts, read back from the artists."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND
from matplotlib.patches import Rectangle

from rmpc_bench.figures.burst_bands import PALE
from rmpc_bench.figures.files import save
from rmpc_bench.figures.labels import symbol
from rmpc_bench.figures.style import COLOURS
from rmpc_bench.figures.trajectories import Trajectories
from rmpc_bench.types import DesignError


def trajectories(trials, **keys):
    return Trajectories(**keys).draw(trials)


TWO = {"mse": {"A": [1.0] * 3, "B": [2.0] * 3}}
N = 40


def lines(figure, panel, method):
    """Lines of a method in a panel, those below first."""
    color = COLOURS["AB".index(method)]
    found = [line for line in figure.axes[panel].lines if line.get_color() == color]
    return sorted(found, key=lambda line: line.get_zorder())


def shaded(figure, panel=0):
    """Left and right ends of the bands of a panel."""
    bands = [each for each in figure.axes[panel].patches if isinstance(each, Rectangle)]
    return [(each.get_x(), each.get_x() + each.get_width()) for each in bands]


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.fixture
def trials(make_trials, record):
    """Three runs; B reports a matrix, which has no value before k = 5, and a vector at all samples."""
    table = record(make_trials(TWO), {"A": 3, "B": 3}, n_steps=N)
    rng = np.random.default_rng(2)
    Q = rng.normal(size=(3, N, 4))
    Q[:, :5] = np.nan
    traces = table.traces["B"]
    own = {**traces.signals, "Q_yw": Q, "r_breve": rng.random((3, N + 1, 2))}
    traces = traces._replace(signals=own, shapes={"Q_yw": (2, 2), "r_breve": (2,)})
    return replace(table, traces=table.traces | {"B": traces})


def with_bursts(trials, flags):
    """Add bursts, (runs, samples), to all methods."""
    traces = {
        name: each._replace(signals={**each.signals, "bursts": np.array(flags, dtype=float)[: len(each.runs), :, None]})
        for name, each in trials.traces.items()
    }
    return replace(trials, traces=traces)


def only(trials, run):
    """One recorded run."""
    traces = {
        name: each._replace(
            runs=each.runs[run : run + 1], signals={k: v[run : run + 1] for k, v in each.signals.items()}
        )
        for name, each in trials.traces.items()
    }
    return replace(trials, traces=traces)


def in_bursts(*spans):
    """Flags of the samples first..last of every burst."""
    k = np.arange(N + 1)
    return np.any([(first <= k) & (k <= last) for first, last in spans], axis=0)


def test_the_control_error(trials):
    """r - y, with the unit of y; it goes without being recorded."""
    figure = trajectories(only(trials, 1), signals=["e"], from_=1.0, to=5.0)
    for method in "AB":
        (line,) = lines(figure, 0, method)
        traces = trials.traces[method]
        np.testing.assert_array_equal(line.get_ydata(), (traces.r - traces.signals["y"][1])[2:11, 0])
        assert line.get_drawstyle() == "default"
    assert figure.axes[0].get_ylabel() == "$e$ [rad]" and legend(figure) == ["A", "B"]
    median = lines(trajectories(trials, signals=["e.0"], runs=0), 0, "B")[-1].get_ydata()
    traces = trials.traces["B"]
    np.testing.assert_allclose(median, np.median(traces.r - traces.signals["y"], axis=0)[:, 0], **ROUND)


def test_there_is_no_error_of_an_output_that_is_not_recorded(trials):
    """Nor of a component that y does not have."""
    without = {name: each._replace(signals={"u": each.signals["u"]}) for name, each in trials.traces.items()}
    for table, signal, message in (
        (replace(trials, traces=without), "e", "'e' is not recorded (recorded: u)"),
        (trials, "e.1", "'e.1' is not a component (they count from e.0 to e.0)"),
    ):
        with pytest.raises(DesignError) as error:
            trajectories(table, signals=[signal])
        assert str(error.value) == message


def test_what_one_method_reports(trials):
    """Steps where it has no value at the last sample, a gap where it has none yet; the other method is left out."""
    figure = trajectories(only(trials, 2), signals=["Q_yw.1", "r_breve.1", "y"])
    (Q,), (r,) = lines(figure, 0, "B"), lines(figure, 1, "B")
    signals = trials.traces["B"].signals
    expected = signals["Q_yw"][2, :, 1]
    np.testing.assert_array_equal(Q.get_ydata(), np.append(expected, expected[-1]))
    np.testing.assert_array_equal(r.get_ydata(), signals["r_breve"][2, :, 1])
    assert (Q.get_drawstyle(), r.get_drawstyle()) == ("steps-post", "default")
    assert lines(figure, 0, "A") == lines(figure, 1, "A") == [] and len(lines(figure, 2, "A")) == 1
    assert legend(figure) == ["A", "B", "reference"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["$(Q_{yw})_{0,1}$", r"$\breve{r}_1$", "$y$ [rad]"]
    assert legend(trajectories(trials, signals=["Q_yw.0"])) == ["B"]
    assert len(trajectories(trials, signals=["Q_yw"]).axes) == 4


def test_units_of_components(trials):
    """A component's own unit comes before that of the signal."""
    table = replace(trials, units={"x": "m", "x.1": "rad", "y.0": "mm"})
    figure = trajectories(table, signals=["x", "e"])
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["$x_0$ [m]", "$x_1$ [rad]", "$x_2$ [m]", "$e$ [mm]"]


def test_bursts_are_bands(trials):
    """Half a sample beyond their ends, in every panel, behind everything; one entry in the legend."""
    flags = in_bursts((4, 9), (20, 20), (38, 40))
    figure = trajectories(with_bursts(trials, [flags] * 3), signals=["y", "u"])
    for panel in (0, 1):
        np.testing.assert_allclose(shaded(figure, panel), [(1.75, 4.75), (9.75, 10.25), (18.75, 20.0)], **ROUND)
        lowest = min(line.get_zorder() for line in figure.axes[panel].lines)
        assert all(each.get_zorder() < 0.5 < lowest for each in figure.axes[panel].patches)  # 0.5: the grid
    assert legend(figure) == ["A", "B", "reference", "burst"]
    limits = trajectories(trials, signals=["y", "u"])
    for axes, other in zip(figure.axes, limits.axes, strict=True):
        assert (axes.get_xlim(), axes.get_ylim()) == (other.get_xlim(), other.get_ylim())


@pytest.mark.parametrize(
    ("window", "expected"), [((3.0, 4.0), [(3.0, 4.0)]), ((0.0, 2.5), [(1.75, 2.5)]), ((6, 9), [])]
)
def test_bursts_end_with_the_window(trials, window, expected):
    """Where there is none in the window, the legend does not speak of it."""
    figure = trajectories(with_bursts(trials, [in_bursts((4, 9))] * 3), from_=window[0], to=window[1])
    np.testing.assert_allclose(shaded(figure), np.array(expected), **ROUND)
    assert ("burst" in legend(figure)) == bool(expected)


def test_bursts_of_runs_that_do_not_agree(trials):
    """Each has its own: none is shown, unless a single run is, or those that differ have failed."""
    flags = [in_bursts((4, 9)), in_bursts((4, 9)), in_bursts((5, 9))]
    table = with_bursts(trials, flags)
    assert shaded(trajectories(table)) == [] and "burst" not in legend(trajectories(table))
    np.testing.assert_allclose(shaded(trajectories(only(table, 2))), [(2.25, 4.75)], **ROUND)
    frame = table.frame.copy()
    frame.loc[frame["run"] == 2, "status"] = "diverged"
    np.testing.assert_allclose(shaded(trajectories(replace(table, frame=frame))), [(1.75, 4.75)], **ROUND)


def test_nothing_changes_without_bursts(trials, tmp_path):
    """The same bytes, whether nobody knows of bursts or there are none."""
    calm = with_bursts(trials, np.zeros((3, N + 1)))
    one, other = (save(trajectories(table), tmp_path, name) for table, name in ((trials, "one"), (calm, "other")))
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]
    assert PALE.encode() not in one[0].read_bytes()


@pytest.mark.parametrize(
    ("name", "component", "expected"),
    [
        ("x_hat", "2", r"$\hat{x}_2$"),
        ("Q_yw", "0,1", "$(Q_{yw})_{0,1}$"),
        ("C_y", "", "$C_{y}$"),
        ("rho_breve", "", r"$\breve{\rho}$"),
        ("Pi", "", r"$\Pi$"),
        ("fallback", "", "fallback"),
        ("P_pred", "", "P_pred"),
        ("x_", "", "x_"),
        ("no_hat", "", "no_hat"),
    ],
)
def test_symbols(name, component, expected):
    """Letters with accents or short indices are formulas; words stay words."""
    assert symbol(name, component) == expected
