"""Paired change against the baseline, read back from the artists."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND
from scipy import stats

from rmpc_bench.analysis.comparison import levels
from rmpc_bench.config.schema import model_of
from rmpc_bench.figures.files import save
from rmpc_bench.figures.paired import BAND, MARKER, Paired, changes_of
from rmpc_bench.figures.style import COLOURS, REFERENCE
from rmpc_bench.types import DesignError, MetricInfo, ResultLayout

INF = math.inf
MSE = MetricInfo("mse", "rad^2", "lower")


def paired(trials, **keys):
    return Paired(**keys).draw(trials)


@pytest.fixture
def columns():
    """Twenty runs of a baseline, of a method at 0.8 of it with some scatter, and of one at 1.5 of it."""
    rng = np.random.default_rng(5)
    base = np.exp(rng.normal(size=20))
    return {"S": list(base), "R": list(0.8 * base * np.exp(0.1 * rng.normal(size=20))), "T": list(1.5 * base)}


@pytest.fixture
def trials(make_trials, columns):
    return make_trials({"mse": columns}, labels={"R": "robust, $c=1$"})


def rows(figure, panel=0):
    """Colour -> (row, change, ends of the interval)."""
    found = {}
    for line in figure.axes[panel].lines:
        if line.get_marker() == MARKER["marker"]:
            found.setdefault(line.get_color(), [line.get_ydata()[0], line.get_xdata()[0], None])
    for line in figure.axes[panel].lines:
        if line.get_marker() == "None" and line.get_color() in found:
            found[line.get_color()][2] = tuple(line.get_xdata())
    return found


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_change_and_interval_against_a_plain_computation(trials, columns):
    """Geometric mean of the paired ratios with Student's t on the logs; the baseline has no row."""
    figure = paired(trials)
    logs = np.log(np.array(columns["R"]) / np.array(columns["S"]))
    # Two methods are compared, so that each interval has a higher level.
    low, high = stats.t.interval(levels(trials).held, 19, logs.mean(), stats.sem(logs))
    found = rows(figure)
    row, change, ends = found[COLOURS[1]]
    np.testing.assert_allclose([change, *ends], 100 * (np.exp([logs.mean(), low, high]) - 1), **ROUND)
    assert row == 0 and found[COLOURS[2]][0] == 1 and len(found) == 2
    assert found[COLOURS[2]][1] == pytest.approx(50.0, rel=1e-12)  # a constant ratio, up to the rounding of logs
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.get_yticklabels()] == ["robust, $c=1$", "T"]
    assert axes.get_ylim() == (1.5, -0.5)


def test_band_and_zero_line(trials):
    """From minus to plus the margin of relevance, in every panel; both are explained in the legend."""
    figure = paired(replace(trials, relevant=0.05, confidence=0.9))
    (axes,) = figure.axes
    (band,) = axes.patches
    assert (band.get_x(), band.get_x() + band.get_width()) == pytest.approx((-5.0, 5.0), rel=1e-12)
    assert band.get_facecolor()[:3] == pytest.approx(tuple(int(BAND[i : i + 2], 16) / 255 for i in (1, 3, 5)))
    zero = [line for line in axes.lines if line.get_color() == REFERENCE]
    assert [list(line.get_xdata()) for line in zero] == [[0, 0]]
    assert legend(figure) == ["90 % interval", "within 5 %"]
    assert axes.get_xlabel() == "change of mse against S [%]\n(lower is better)"
    assert axes.get_title() == "20 paired runs"


@pytest.mark.parametrize(
    ("direction", "text"), [("higher", "score"), ("zero", "|score|"), ("one", "max(score, 1/score)")]
)
def test_the_axis_names_what_is_compared_and_which_side_is_better(make_trials, direction, text):
    """Of a metric that is best at 0 the absolute value, of a ratio that is best at 1 the factor that it is off."""
    table = make_trials({"score": {"A": [2.0, 3.0], "B": [4.0, 5.0]}}, infos=[MetricInfo("score", "", direction)])
    words = "higher is better" if direction == "higher" else "lower is better"
    assert paired(table).axes[0].get_xlabel().replace("\n", " ") == f"change of {text} against A [%] ({words})"


def test_no_change_in_per_cent(make_trials):
    """Where runs did not settle the row gives counts; a failed run makes no pair and is lost."""
    table = make_trials(
        {"mse": {"A": [1.0, 2.0, INF, 4.0], "B": [2.0, 1.0, 3.0, "diverged"], "C": [1.0, 1.0, INF, 4.0]}}
    )
    figure = paired(table)
    assert rows(figure) == {}
    assert [text.get_text() for text in figure.axes[0].texts] == ["2 won, 2 lost, 0 tied", "1 won, 0 lost, 3 tied"]
    assert figure.axes[0].get_title() == "3 to 4 paired runs"


def test_counts_stay_inside_the_axes(make_trials):
    """Of many runs too, where no other row has a change in per cent."""
    runs = [1.0, INF, 3.0] * 500
    figure = paired(make_trials({"mse": {"A": runs, "B": [INF, 2.0, 3.0] * 500, "a long name of a method": runs}}))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    for text in axes.texts:
        box, frame = text.get_window_extent(), axes.get_window_extent()
        assert frame.x0 <= box.x0 and box.x1 <= frame.x1


def test_one_run_has_a_change_and_no_interval(make_trials):
    """By hand: 3 against 2 is 50 per cent more."""
    figure = paired(make_trials({"mse": {"A": [2.0], "B": [3.0]}}))
    row, change, ends = rows(figure)[COLOURS[1]]
    assert change == pytest.approx(50.0, rel=1e-12) and np.isnan(ends).all()
    assert figure.axes[0].get_title() == "1 paired run"


def test_points_of_a_sweep_are_panels(make_trials, make_sweep, columns):
    """On a common axis, each with its own changes."""
    other = columns | {"R": [2.0 * value for value in columns["S"]]}
    tables = [make_trials({"mse": each}) for each in (columns, other)]
    sweep = make_sweep(*zip([{"controller.Hp": "10"}, {"controller.Hp": "15"}], tables, strict=True))
    figure = paired(sweep)
    assert [axes.get_title() for axes in figure.axes] == ["Hp=10, 20 paired runs", "Hp=15, 20 paired runs"]
    assert rows(figure, 1)[COLOURS[1]][1] == pytest.approx(100.0, rel=1e-12)  # up to the rounding of logs
    assert rows(figure, 0)[COLOURS[1]][1] == changes_of(tables[0], MSE, ["R"])[0].change
    assert figure.axes[0].get_xlim() == figure.axes[1].get_xlim() and figure.axes[0].get_xlabel() == ""
    assert len(paired(sweep, at=[{"controller.Hp": 15}]).axes) == 1


def test_metric_order_and_size(make_trials, columns):
    """The keys that a configuration may give; methods keep their colours."""
    infos = [MSE, MetricInfo("power", "V^2", "lower")]
    table = make_trials({"mse": columns, "power": columns | {"T": columns["S"]}}, infos)
    figure = paired(table, metric="power", order=["T", "S", "R"], width=5, height=3)
    assert {color: row for color, (row, *_) in rows(figure).items()} == {COLOURS[2]: 0, COLOURS[1]: 1}
    assert rows(figure)[COLOURS[2]][1:] == [0.0, (0.0, 0.0)] and list(figure.get_size_inches()) == [5, 3]
    assert set(model_of("figures", "paired").model_fields) == {"metric", "width", "height", "order", "at"}


@pytest.mark.parametrize(
    ("given", "parameter", "message"),
    [
        ({"metric": "mae"}, "metric", "'mae' is not a known metric of this configuration; did you mean 'mse'?"),
        ({"order": ["S"]}, "order", "must name a method besides the baseline 'S'"),
        ({"order": ["Q"]}, "order", "'Q' is not a known method; known: S, R, T"),
        ({"at": [{"controller.Hp": 3}]}, "at", "nothing is swept in this configuration"),
        ({"width": 0.5}, "width", "must be at least 1 inch (got 0.5)"),
    ],
)
def test_errors_show_the_choices(trials, given, parameter, message):
    """A figure that cannot be drawn is left out with a reason."""
    with pytest.raises(DesignError) as error:
        paired(trials, **given)
    assert (str(error.value), error.value.parameter) == (message, parameter)


def test_what_it_requires():
    """A method besides the baseline, points that fit."""
    alone = ResultLayout(methods=("A",), metrics=("mse",), points=({},))
    assert list(Paired().check(alone)) == [("", "compares methods with the baseline: needs at least two methods")]
    many = replace(alone, methods=("A", "B"), points=tuple({"k": str(number)} for number in range(7)))
    message = "7 points of the sweep do not fit into one figure (at most 6): choose some with `at`"
    assert list(Paired().check(many)) == [("at", message)]
    assert list(Paired(at=[{"k": 3}]).check(many)) == []


@pytest.mark.parametrize("values", [[1e300, 1e308], [1e-300, 1e-308], [1.0, 1.0], [0.0, 0.0], [1.0, -1.0]])
def test_no_warning_on_odd_values(make_trials, tmp_path, values):
    """The edges of floating point, equal values, a baseline of 0, both signs; one run has no interval."""
    for n in (1, 2):
        save(paired(make_trials({"mse": {"A": [1.0, 2.0][:n], "B": values[:n]}})), tmp_path, "odd")
        save(paired(make_trials({"mse": {"A": values[:n], "B": [1.0, 2.0][:n]}})), tmp_path, "odd")


def test_nothing_is_cut_off(trials):
    """Long names of methods are broken; legend and labels are inside the picture."""
    long = {name: f"robust model predictive control, number {name}" for name in trials.methods}
    figure = paired(replace(trials, labels=long))
    boxes = [
        figure.legends[0].get_window_extent(),
        *(each.get_window_extent() for each in figure.axes[0].get_yticklabels()),
    ]
    for box in boxes:
        assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1 + 1
    assert figure.axes[0].get_window_extent().width > 100  # at 100 dpi


def test_same_bytes(trials, tmp_path):
    """Drawn twice, saved twice."""
    paths = [save(paired(trials), tmp_path, stem) for stem in ("one", "other")]
    assert [path.read_bytes() for path in paths[0]] == [path.read_bytes() for path in paths[1]]
