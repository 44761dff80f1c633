"""Paired change against the baseline, read back from the artists."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND
from scipy import stats

from rmpc_bench.analysis.comparison import comparisons, levels
from rmpc_bench.config.schema import model_of
from rmpc_bench.figures.files import save
from rmpc_bench.figures.paired import BAND, MARKERS, Paired, changes_of
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


def rows(figure, panel=0, marker=MARKERS["geometric"]):
    """Colour -> (vertical position, change, ends of the interval), of the rows with a marker."""
    lines = [line for line in figure.axes[panel].lines if line.get_color() != REFERENCE]
    found = {}
    for interval, point in zip(lines[::2], lines[1::2], strict=True):
        assert interval.get_marker() == "None" and list(interval.get_ydata()) == [point.get_ydata()[0]] * 2
        if point.get_marker() == marker:
            found[point.get_color()] = [point.get_ydata()[0], point.get_xdata()[0], tuple(interval.get_xdata())]
    return found


def band(figure, panel=0):
    """Ends of the grey band."""
    (patch,) = figure.axes[panel].patches
    return patch.get_x(), patch.get_x() + patch.get_width()


def legend(figure):
    return [text.get_text().replace("\n", " ") for text in figure.legends[0].get_texts()]


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
    """A band from 1/1.05 to 1.05 times the baseline; both are explained in the legend."""
    figure = paired(replace(trials, relevant=0.05, confidence=0.9))
    (axes,) = figure.axes
    assert band(figure) == pytest.approx((-100 / 21, 5.0), rel=1e-12)
    assert axes.patches[0].get_facecolor()[:3] == pytest.approx(
        tuple(int(BAND[i : i + 2], 16) / 255 for i in (1, 3, 5))
    )
    zero = [line for line in axes.lines if line.get_color() == REFERENCE]
    assert [list(line.get_xdata()) for line in zero] == [[0, 0]]
    # Those of R and T hold together.
    assert legend(figure) == ["simultaneous 90 % interval", "within 5 %"]
    text = "change of MSE against S [%] (geometric mean of the ratios; lower is better)"
    assert axes.get_xlabel().replace("\n", " ") == text
    assert axes.get_title() == "20 paired runs"


@pytest.mark.parametrize(
    ("direction", "text"),
    [
        ("higher", "change of score against A [%] (geometric mean of the ratios; higher is better)"),
        ("zero", "difference of |score| from A [m] (lower is better)"),
        ("one", "change of max(score, 1/score) against A [%] (geometric mean of the ratios; lower is better)"),
    ],
)
def test_the_axis_names_what_is_compared_and_which_side_is_better(make_trials, direction, text):
    """Of a metric that is best at 0 the absolute value, of a ratio that is best at 1 the factor that it is off."""
    table = make_trials({"score": {"A": [2.0, 3.0], "B": [4.0, 5.0]}}, infos=[MetricInfo("score", "m", direction)])
    assert paired(table).axes[0].get_xlabel().replace("\n", " ") == text


@pytest.mark.parametrize("d", [0.005, 0.01, 0.05, 0.3])
def test_the_verdict_can_be_read_off_the_interval_and_the_band(make_trials, d):
    """Beyond the band: better or worse; inside: equivalent; exchanged methods, too."""
    noise = 1e-3 * np.resize([1.0, -1.0], 40)
    base = np.linspace(1.0, 2.0, 40)
    for factor in (1 / 1.4, 1 / 1.052, 1 / 1.0495, 0.9525, 0.97, 1.0, 1.003, 1.02, 1.0495, 1.052, 1.4):
        values = {"S": base, "R": base * factor * np.exp(noise)}
        for table in (make_trials({"mse": values}), make_trials({"mse": dict(reversed(values.items()))})):
            table = replace(table, relevant=d)
            figure, word = paired(table), comparisons(table)["verdict"].iloc[0]
            (_, _, (low, high)), (left, right) = rows(figure)[COLOURS[1]], band(figure)
            if word in ("better", "worse"):
                assert high < left if word == "better" else low > right
            elif word == "equivalent":
                assert left <= low and high <= right
            else:
                assert low <= left <= high or low <= right <= high


def test_averages_that_contradict_each_other_are_both_drawn(make_trials):
    """Most runs are better by a fifth; one in ten is twice as bad, where the values are large."""
    large = np.arange(200) % 10 == 0
    base = np.where(large, 20.0, 1.0)
    table = make_trials({"mse": {"S": base, "R": base * np.where(large, 2.0, 0.8), "T": 1.1 * base}})
    figure = paired(table)
    compared = comparisons(table).set_index("method").loc["R"]
    assert compared["verdict"] == "depends-on-average"
    for kind in ("geometric", "mean"):
        y, change, ends = rows(figure, marker=MARKERS[kind])[COLOURS[1]]
        assert [change, *ends] == [compared[f"{kind}_{end}"] for end in ("pct", "low", "high")]
        assert (change < 0, y < 0) == (kind == "geometric", kind == "geometric")
    assert rows(figure, marker=MARKERS["mean"]).keys() == {COLOURS[1]}  # both averages of T have the same sign
    names = ["geometric mean of the ratios", "ratio of the means", "simultaneous 95 % interval", "within 1 %"]
    assert legend(figure) == names


def test_signed_metric_has_its_unit_and_its_own_margin(make_trials):
    """By hand: 0.2 nearer to 0 in all runs; without a margin of its own nothing counts as tied."""
    values = {"S": [1.0, -1.0, 1.0], "R": [0.8, -0.8, 0.8]}
    table = make_trials({"e": values}, infos=[MetricInfo("e", "rad", "zero")])
    figure = paired(replace(table, margins={"e": 0.1}))
    assert rows(figure)[COLOURS[1]][1] == pytest.approx(-0.2, rel=1e-9)
    assert band(figure) == (-0.1, 0.1) and legend(figure) == ["95 % interval", "within 0.1 rad"]
    assert band(paired(table)) == (0.0, 0.0) and legend(paired(table)) == ["95 % interval"]


def test_changes_of_different_size_can_be_told_apart(make_trials):
    """Equal ratios have equal lengths; the ticks are per cent, and the data are as before."""
    base = np.linspace(1.0, 2.0, 30)
    values = {"S": base, "half": base / 2, "double": base * 2, "far": base * 200}
    figure = paired(make_trials({"mse": values}))
    (axes,) = figure.axes
    places = [axes.transData.transform((x, 0))[0] for x in (-50, 0, 100, 19900)]
    assert places[1] - places[0] == pytest.approx(places[2] - places[1], rel=1e-9)
    left, right = axes.get_window_extent().x0, axes.get_window_extent().x1
    assert left < places[0] and places[3] < right
    ticks = [text.get_text() for text in axes.get_xticklabels()]
    assert ticks == ["0", "+900", "+9900"]
    assert rows(figure)[COLOURS[3]][1] == pytest.approx(19900, rel=1e-9)


def test_no_change_in_per_cent(make_trials):
    """Where runs did not settle the row gives counts; a failed run makes no pair and is lost."""
    table = make_trials(
        {"mse": {"A": [1.0, 2.0, INF, 4.0], "B": [2.0, 1.0, 3.0, "diverged"], "C": [1.0, 1.0, INF, 4.0]}}
    )
    figure = paired(table)
    assert rows(figure) == {}
    assert [text.get_text() for text in figure.axes[0].texts] == ["2 won, 2 lost, 0 tied", "1 won, 0 lost, 3 tied"]
    assert figure.axes[0].get_title() == "3 to 4 paired runs, failed: B 1"


def test_counts_stay_inside_the_axes(make_trials):
    """Of many runs too, where no other row has a change in per cent."""
    runs = [1.0, INF, 3.0] * 500
    figure = paired(make_trials({"mse": {"A": runs, "B": [INF, 2.0, 3.0] * 500, "a long name of a method": runs}}))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    for text in axes.texts:
        box, frame = text.get_window_extent(), axes.get_window_extent()
        assert frame.x0 <= box.x0 and box.x1 <= frame.x1


def test_long_labels_do_not_overlap(make_trials, columns):
    """Labels of three lines make the rows higher."""
    long = "LQE of a library with a long name, MPC of another library with a long name"
    figure = paired(make_trials({"mse": columns}, labels={"R": long, "T": long}))
    figure.canvas.draw()
    upper, lower = (label.get_window_extent() for label in figure.axes[0].get_yticklabels())
    assert upper.y0 >= lower.y1


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
    assert rows(figure, 0)[COLOURS[1]][1] == changes_of(tables[0], MSE, ["R"])[0].averages[0].value
    assert figure.axes[0].get_xlim() == figure.axes[1].get_xlim() and figure.axes[0].get_xlabel() == ""
    assert len(paired(sweep, at=[{"controller.Hp": 15}]).axes) == 1


def test_metric_order_and_size(make_trials, columns):
    """The keys that a configuration may give; methods keep their colours."""
    infos = [MSE, MetricInfo("power", "V^2", "lower")]
    table = make_trials({"mse": columns, "power": columns | {"T": columns["S"]}}, infos)
    figure = paired(table, metric="power", order=["T", "S", "R"], width=5, height=3)
    assert {color: row for color, (row, *_) in rows(figure).items()} == {COLOURS[2]: 0, COLOURS[1]: 1}
    # Pairs that never differ have no interval.
    assert rows(figure)[COLOURS[2]][1] == 0.0 and np.isnan(rows(figure)[COLOURS[2]][2]).all()
    assert list(figure.get_size_inches()) == [5, 3]
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
        figure.axes[0].xaxis.label.get_window_extent(),
    ]
    for box in boxes:
        assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1 + 1
    assert figure.axes[0].get_window_extent().width > 100  # at 100 dpi


def test_same_bytes(trials, tmp_path):
    """Drawn twice, saved twice."""
    paths = [save(paired(trials), tmp_path, stem) for stem in ("one", "other")]
    assert [path.read_bytes() for path in paths[0]] == [path.read_bytes() for path in paths[1]]
