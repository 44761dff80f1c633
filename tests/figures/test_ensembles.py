"""Means and variances of the ensemble, read back from the artists."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from rmpc_bench.config.reader import parse
from rmpc_bench.config.schema import model_of, validate
from rmpc_bench.figures.files import save
from rmpc_bench.figures.line_styles import paler
from rmpc_bench.figures.means import Means
from rmpc_bench.figures.style import COLOURS
from rmpc_bench.figures.variance_with_bound import VarianceWithBound
from rmpc_bench.types import DesignError
from rmpc_bench.types.result_layout import NO_MOMENTS, NO_P


def means(trials, **keys):
    return Means(**keys).draw(trials)


def variance_with_bound(trials, **keys):
    return VarianceWithBound(**keys).draw(trials)


THREE = {"mse": {"A": [1.0, 2.0], "B": [2.0, 3.0], "C": [3.0, 4.0]}}
K = np.arange(31.0)
BLACK = "#000000"


def variance(method, i):
    return 4.0 + ("AB".index(method) + 1) * (i + 1) * K


def rough(values):
    return values * (1 + 0.1 * (-1.0) ** K)


def x_hat(method, i):
    return np.sin(K / 5) + i + "AB".index(method)


@pytest.fixture
def trials(make_trials, with_series):
    """Two methods with moments and P, that of A constant; exact and from 500 runs; C has none."""
    entries = []
    for method in "AB":
        for i in (0, 1):
            entries += [(method, "cov(e)", f"{i},{j}", variance(method, i) * (i == j), 0) for j in (0, 1)]
            entries += [(method, "cov(e)", f"{i},{i}", rough(variance(method, i)), 500)]
            entries += [(method, "P", f"{i},{i}", [9.0 + i] if method == "A" else 9.0 + i + K, 0)]
            entries += [(method, "mean(x)", f"{i}", K + i, 0), (method, "mean(x)", f"{i}", rough(K + i), 500)]
            entries += [(method, "mean(x_hat)", f"{i}", x_hat(method, i), 0)]
            entries += [(method, "mean(x_hat)", f"{i}", rough(x_hat(method, i)), 500)]
    return with_series(make_trials(THREE, labels={"B": "robust"}), *entries)


def only(trials, keep):
    """The table with the rows that `keep` says."""
    return replace(trials, series=trials.series[keep(trials.series)])


def drawn(figure, panel, color, **wanted):
    """Values of the lines of a panel that have a colour and these properties, those below first."""
    lines = [line for line in figure.axes[panel].lines if line.get_color() == color]
    lines = [line for line in lines if all(getattr(line, f"get_{name}")() == value for name, value in wanted.items())]
    return [np.array(line.get_xydata()) for line in sorted(lines, key=lambda line: line.get_zorder())]


def legend(figure):
    """Texts of the legend, without the empty ones that end a row."""
    return [text for text in (text.get_text() for text in figure.legends[0].get_texts()) if text]


def sample(figure, text):
    """The line that stands for a text of the legend."""
    (legend,) = figure.legends
    return next(
        line for line, each in zip(legend.get_lines(), legend.get_texts(), strict=True) if each.get_text() == text
    )


def test_variance_and_bound(trials):
    """Solid: the exact one; pale: from runs; dashed: the reported one, which covers the panel if it is constant."""
    figure = variance_with_bound(trials)
    for i in (0, 1):
        for color, method in zip(COLOURS, "AB", strict=False):
            (solid,), (dashed,) = (drawn(figure, i, color, linestyle=style) for style in ("-", "--"))
            (pale,) = drawn(figure, i, paler(color))
            assert np.array_equal(solid, np.stack([K, variance(method, i)], axis=1))
            assert np.array_equal(pale, np.stack([K, rough(variance(method, i))], axis=1))
            shown = [[0, 9.0 + i], [30, 9.0 + i]] if method == "A" else np.stack([K, 9.0 + i + K], axis=1)
            assert np.array_equal(dashed, shown)
    assert [axes.get_ylabel() for axes in figure.axes] == ["var $e_0$", "var $e_1$"]
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "$k$"]
    assert figure.axes[0].get_xlim() == (0, 30) and list(figure.get_size_inches())[0] == 3.5


def test_the_legend_says_which_is_which(trials):
    """Methods by colour in the first row, the kinds of lines in grey in the second."""
    figure = variance_with_bound(trials)
    assert sorted(legend(figure)) == ["A", "from 500 runs", "reported covariance", "robust", "variance"]
    assert sample(figure, "robust").get_color() == COLOURS[1]
    assert (sample(figure, "reported covariance").get_linestyle(), sample(figure, "variance").get_linestyle()) == (
        "--",
        "-",
    )
    thin, thick = sample(figure, "from 500 runs"), sample(figure, "variance")
    assert thin.get_linewidth() < thick.get_linewidth()
    assert sum(to_rgb(thin.get_color())) > sum(to_rgb(thick.get_color()))
    figure.draw_without_rendering()
    boxes = {text.get_text(): text.get_window_extent() for text in figure.legends[0].get_texts()}
    middles = {text: box.y0 + box.y1 for text, box in boxes.items()}
    assert middles["A"] == pytest.approx(middles["robust"], abs=2) and middles["A"] > middles["variance"] + 10
    assert middles["variance"] == pytest.approx(middles["reported covariance"], abs=3)


def test_exact_lines_lie_above_all_that_is_rough(trials):
    """Else 1500 rough samples of one method would hide the exact line of another."""
    for figure in (means(trials), variance_with_bound(trials)):
        pale = {paler(color) for color in (*COLOURS, BLACK)}
        above = [line.get_zorder() for line in figure.axes[0].lines if line.get_color() not in pale]
        assert min(above) > max(line.get_zorder() for line in figure.axes[0].lines if line.get_color() in pale)


def test_means(trials):
    """The true state is black and one for all methods; exact, and paler from runs."""
    figure = means(trials)
    for i in (0, 1):
        (pale,), (black,) = drawn(figure, i, paler(BLACK)), drawn(figure, i, BLACK)
        assert np.array_equal(black[:, 1], K + i) and np.array_equal(pale[:, 1], rough(K + i))
        for color, method in zip(COLOURS, "AB", strict=False):
            (pale,), (solid,) = drawn(figure, i, paler(color)), drawn(figure, i, color)
            assert np.array_equal(solid[:, 1], x_hat(method, i)) and np.array_equal(pale[:, 1], rough(x_hat(method, i)))
    assert sorted(legend(figure)) == ["A", "exact", "from 500 runs", "robust", "true state"]
    assert sample(figure, "true state").get_color() == BLACK
    assert [axes.get_ylabel() for axes in figure.axes] == ["mean $x_0$", "mean $x_1$"]


@pytest.mark.parametrize(("factor", "n_true"), [(1 + 1e-13, 1), (1.5, 2)])
def test_a_true_state_of_every_method(trials, factor, n_true):
    """Under feedback it depends on the method: dotted; a difference by rounding, or by chance in the runs, is none."""
    series = trials.series.copy()
    its = (series["method"] == "B") & (series["quantity"] == "mean(x)")
    series.loc[its & (series["n"] == 0), "value"] *= factor
    series.loc[its & (series["n"] > 0), "value"] *= 1.1
    figure = means(replace(trials, series=series))
    dotted = [line[:, 1] for color in COLOURS for line in drawn(figure, 0, color, linestyle="--")]
    assert "true state" in legend(figure)
    if n_true == 1:
        assert len(drawn(figure, 0, BLACK)) == 1 and not dotted
    else:
        assert drawn(figure, 0, BLACK) == [] and np.array_equal(dotted, [K, 1.5 * K])
        assert sample(figure, "true state").get_linestyle() == "--"


def test_from_runs_only(trials):
    """They are the lines then, in full colour."""
    figure = variance_with_bound(only(trials, lambda table: (table["n"] > 0) | (table["quantity"] == "P")))
    (solid,) = drawn(figure, 0, COLOURS[0], linestyle="-")
    assert np.array_equal(solid[:, 1], rough(variance("A", 0))) and drawn(figure, 0, paler(COLOURS[0])) == []
    assert sorted(legend(figure)) == ["A", "reported covariance", "robust", "variance from 500 runs"]
    figure = means(only(trials, lambda table: table["n"] > 0))
    assert sorted(legend(figure)) == ["A", "mean from 500 runs", "robust", "true state"]


def test_exact_only(trials):
    """Nothing is said of runs."""
    figure = variance_with_bound(only(trials, lambda table: table["n"] == 0))
    assert sorted(legend(figure)) == ["A", "reported covariance", "robust", "variance"]


def test_exact_of_one_method_only(trials):
    """The other one is marked in the legend."""
    figure = means(only(trials, lambda table: (table["n"] > 0) | (table["method"] == "A")))
    assert sorted(legend(figure)) == ["A", "exact", "from 500 runs", "robust (from 500 runs)", "true state"]


def test_numbers_of_runs_that_change(trials, with_series):
    """At every sample the value from most runs counts, and the legend gives the range."""
    few = with_series(only(trials, lambda table: table["n"] == 0), ("A", "cov(e)", "0,0", 2 + K, 480))
    both = with_series(few, ("A", "cov(e)", "0,0", 3 + K[:11], 500))
    figure = variance_with_bound(both, component=0)
    assert "from 480 to 500 runs" in legend(figure)
    (pale,) = drawn(figure, 0, paler(COLOURS[0]))
    assert np.array_equal(pale[:, 1], np.where(K < 11, 3 + K, 2 + K))


def test_a_method_without_a_bound(trials):
    """It has its variance."""
    figure = variance_with_bound(only(trials, lambda table: ~((table["quantity"] == "P") & (table["method"] == "A"))))
    assert drawn(figure, 0, COLOURS[0], linestyle="--") == [] and len(drawn(figure, 0, COLOURS[0])) == 1


def test_logarithmic_over_three_decades(trials):
    """Powers of ten as ticks; linear, and said so, where a variance is 0."""
    wide = replace(trials, series=trials.series.assign(value=np.maximum(1e-2, trials.series["value"] ** 3 / 50)))
    axes = variance_with_bound(wide, log=True, component=1).axes[0]
    low, high = axes.get_ylim()
    ticks = [tick for tick in axes.get_yticks() if low <= tick <= high]
    assert axes.get_yscale() == "log" and high > 1e3 * low and len(ticks) >= 3
    assert all(np.log10(tick) == pytest.approx(round(np.log10(tick)), abs=1e-9) for tick in ticks)
    zero = replace(trials, series=trials.series.assign(value=trials.series["value"].where(trials.series["k"] > 0, 0.0)))
    axes = variance_with_bound(zero, log=True).axes[0]
    assert axes.get_yscale() == "linear" and "linear" in axes.get_ylabel()
    assert variance_with_bound(zero, log=True, from_=1, order=["B"]).axes[0].get_yscale() == "log"


def test_window_units_component_and_order(trials):
    """Seconds where the sampling time is known; a method keeps its colour."""
    timed = replace(trials, Ts=0.5, units={"x": "m/s", "x.1": "rad"})
    figure = variance_with_bound(timed, from_=5.0, to=10.0, order=["B"], component=1)
    (solid,) = drawn(figure, 0, COLOURS[1], linestyle="-")
    assert np.array_equal(solid, np.stack([0.5 * K[10:21], variance("B", 1)[10:21]], axis=1))
    assert len(figure.axes) == 1 and figure.axes[0].get_xlabel() == "$t$ [s]"
    assert figure.axes[0].get_ylabel() == "var $e_1$ [rad$^{2}$]" and "A" not in legend(figure)
    assert variance_with_bound(timed).axes[0].get_ylabel() == "var $e_0$ [(m/s)$^{2}$]"
    assert [axes.get_ylabel() for axes in means(timed).axes] == ["mean $x_0$ [m/s]", "mean $x_1$ [rad]"]


def test_a_point_of_a_sweep(trials, make_sweep):
    """The first one without a choice."""
    sweep = make_sweep(({"model.d": "1"}, trials), ({"model.d": "2"}, trials))
    assert means(sweep, at={"model.d": 2}).axes[0].get_title() == "d=2"
    assert variance_with_bound(sweep).axes[0].get_title() == "d=1 (first of 2 points)"


@pytest.mark.parametrize(
    ("figure", "given", "message"),
    [
        (means, {"component": 2}, "there is no state 2 (they count from 0 to 1)"),
        (variance_with_bound, {"component": -1}, "there is no state -1 (they count from 0 to 1)"),
        (means, {"order": ["C"]}, "'C' has no mean(x), mean(x_hat) (those that have: A, B)"),
        (variance_with_bound, {"order": ["D"]}, "'D' is not a known method; known: A, B, C"),
        (variance_with_bound, {"order": []}, "must name at least one method, and each one once"),
        (means, {"from_": 30.0}, "fewer than two samples lie between `from` and `to` (there are 0 to 30)"),
        (means, {"width": 0.5}, "must be at least 1 inch (got 0.5)"),
    ],
)
def test_errors_show_the_choices(trials, figure, given, message):
    """A figure that cannot be drawn is left out with a reason."""
    with pytest.raises(DesignError) as error:
        figure(trials, **given)
    assert str(error.value) == message and error.value.parameter in {name.rstrip("_") for name in given}


def test_more_states_than_panels(make_trials, with_series):
    """One has to be chosen."""
    series = [("A", name, f"{i},{i}", K + 1, 0) for i in range(7) for name in ("cov(e)", "P")]
    table = with_series(make_trials(THREE), *series)
    with pytest.raises(DesignError, match="7 states do not fit .* .at most 6.: choose one of 0 to 6"):
        variance_with_bound(table)
    assert len(variance_with_bound(table, component=6).axes) == 1


def test_without_moments_or_bound(make_trials, trials):
    """The way out is a key of the configuration."""
    for figure in (means, variance_with_bound):
        with pytest.raises(DesignError) as error:
            figure(make_trials(THREE))
        assert str(error.value) == NO_MOMENTS == "needs ensemble moments: evaluate: [runs, moments]"
    with pytest.raises(DesignError) as error:
        variance_with_bound(only(trials, lambda table: table["quantity"] != "P"))
    assert str(error.value) == NO_P


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1e300, 1e-300])
@pytest.mark.parametrize("log", [False, True])
def test_no_warning_on_odd_values(trials, tmp_path, value, log):
    """Gaps, nothing finite, nothing at all, the edges of floating point."""
    for keep in (lambda table: table["k"] > 40, lambda table: table["k"].between(10, 20)):
        series = trials.series.assign(value=trials.series["value"].where(keep(trials.series), value))
        odd = replace(trials, series=series)
        save(variance_with_bound(odd, log=log, component=0), tmp_path, "variance")
        save(means(odd, component=0), tmp_path, "means")


@pytest.mark.parametrize("n", [1, 2, 5, 9])
def test_legend_covers_nothing(make_trials, with_series, n):
    """Short names, formulas, names wider than the picture: above the panels, inside the picture, groups apart."""
    names = [f"{i}" for i in range(n)]
    for text in ("S-MPC", "R-MPC1, $c=10^{-1}$", "robust model predictive control " * 3):
        table = make_trials({"mse": {name: [1.0] for name in names}}, labels={name: f"{text} {name}" for name in names})
        series = [(name, "cov(e)", "0,0", K + 1, runs) for name in names for runs in (0, 500)]
        figure = variance_with_bound(with_series(table, *series, *((name, "P", "0,0", [5.0], 0) for name in names)))
        figure.draw_without_rendering()
        box, panel = figure.legends[0].get_window_extent(), figure.axes[0].get_window_extent()
        assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1 + 1
        assert panel.y1 <= box.y0 and panel.height > 50 and len(legend(figure)) == n + 3
        bottom = {each.get_text(): each.get_window_extent().y0 for each in figure.legends[0].get_texts()}
        grey = [bottom.pop(word) for word in ("variance", "reported covariance", "from 500 runs")]
        bottom.pop("", None)
        assert min(bottom.values()) > max(grey)


def test_same_bytes(trials, tmp_path):
    """Drawn twice, saved twice."""
    for figure in (means, variance_with_bound):
        paths = [save(figure(trials), tmp_path, stem) for stem in ("one", "other")]
        assert [path.read_bytes() for path in paths[0]] == [path.read_bytes() for path in paths[1]]


def test_keys():
    """As a configuration writes them."""
    problems = []
    tree = parse("{component: 1, log: true, from: 2, to: 2*5, order: [A], at: {model.d: 2}}", "f.yaml")
    keys = validate(model_of("figures", "variance-with-bound"), tree, [], problems)
    assert not problems and (keys.component, keys.log, keys.from_, keys.to) == (1, True, 2, 10)
    validate(model_of("figures", "means"), parse("{component: -1, log: true}", "f.yaml"), [], problems)
    assert sorted(str(problem).split(": ", 1)[1] for problem in problems)[0] == "component: must be >= 0 (got -1)"
    fields = [set(model_of("figures", kind).model_fields) for kind in ("variance-with-bound", "means")]
    assert fields[0] - fields[1] == {"log"} and fields[1] < fields[0]
