"""Rows and boxplots: what is drawn is read back from the artists and compared with the records of the analysis."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from data_frames import comparison_frame, summary_frame
from matplotlib.patches import Rectangle

from rmpc_bench.analysis.intervals import wilson
from rmpc_bench.analysis.ranks import ranking
from rmpc_bench.figures.boxplot import MOST_DOTS, Boxplot
from rmpc_bench.figures.palette import INK, PRINT
from rmpc_bench.figures.rows import Rows
from rmpc_bench.figures.style import Rendering, rendered
from rmpc_bench.types import DesignError, MetricInfo

LENGTH, GAP = MetricInfo("length", "m", "lower"), MetricInfo("gap", "m", "zero")
TIME, RUNAWAY = MetricInfo("time", "s", "lower", may_not_occur=True), MetricInfo("runaway", "", "lower")
LEVELS = [0.05, 0.25, 0.5, 0.75, 0.95]


@pytest.fixture
def trials_of(make_trials):
    """Make a table of named methods; method k is 1 + k x 4 % as large as the first, with some noise."""

    def make(names, n=100, info=LENGTH, factors=None, **keys):
        rng = np.random.default_rng(8)
        base = np.exp(0.3 * rng.normal(size=n))
        factors = factors or [1 + 0.04 * k for k in range(len(names))]
        values = {
            name: list(base * factor * np.exp(0.02 * k * rng.normal(size=n)))
            for k, (name, factor) in enumerate(zip(names, factors, strict=True))
        }
        return make_trials({info.name: values}, (info,), **keys)

    return make


def of(artists, method):
    return [each for each in artists if each.get_gid() == f"method-{method}"]


def box(axes, method, upright=False):
    """Low end, quartiles, median and high end of a drawn box."""
    (patch,) = [each for each in of(axes.patches, method) if isinstance(each, Rectangle)]
    whiskers, median = [line.get_xydata()[:, int(upright)] for line in of(axes.lines, method)[:2]]
    ends = patch.get_bbox().intervaly if upright else patch.get_bbox().intervalx
    return [np.nanmin(whiskers), ends[0], np.nanmean(median), ends[1], np.nanmax(whiskers)]


def names(axes):
    return [text.get_text() for text in axes.get_yticklabels()]


@pytest.mark.parametrize("n", [1, 2, 3, 6, 9, 30])
def test_boxes_and_changes_are_the_records(trials_of, n):
    """Quantiles of the runs, changes and intervals of comparisons.csv, colours of the verdicts; rows in their order."""
    methods = [f"M{k}" for k in range(n)]
    trials = trials_of(methods)
    figure = Rows().draw(trials)
    for method in methods:
        np.testing.assert_allclose(box(figure.axes[0], method), np.quantile(trials.column("length", method), LEVELS))
    rows = comparison_frame(trials).set_index("method")
    wanted = methods
    if n > 6:
        change = rows["change_pct"].to_dict() | {"M0": 0.0}
        wanted = sorted(methods, key=lambda name: change[name])
    assert names(figure.axes[0]) == wanted
    assert len(figure.axes) == (2 if n > 1 else 1)
    for method in methods[1:]:
        drawn = of(figure.axes[1].lines, method)
        if len(drawn) == 2:
            interval, middle = drawn
            ends = [1 + rows.loc[method, end] / 100 for end in ("ci_low", "ci_high")]
            np.testing.assert_allclose(interval.get_xdata(), ends)
            np.testing.assert_allclose(middle.get_xdata(), [1 + rows.loc[method, "change_pct"] / 100])
            colours = {"better": PRINT["better"], "worse": PRINT["worse"]}
            assert middle.get_color() == colours.get(rows.loc[method, "verdict"].split("-")[0], INK)
        else:
            assert len(of(figure.axes[1].texts, method)) == 1


def test_a_change_beyond_the_axis_is_an_arrow_with_its_size(trials_of):
    """A method 1000 times worse does not squeeze the others, and one 1000 times better neither."""
    figure = Rows().draw(trials_of(["A", "B", "C", "D", "E"], factors=[1, 0.97, 1.02, 1000, 0.001]))
    texts = {text.get_gid(): text.get_text() for text in figure.axes[1].texts}
    assert texts == {"method-D": "×1008 ▶", "method-E": "◀ ×0.0010"}
    low, high = figure.axes[1].get_xlim()
    assert 0.9 < low < 0.97 and 1.02 < high < 1.1


def test_values_are_logarithmic_where_the_spread_asks_for_it(trials_of):
    """Where the largest end exceeds 20 times the smallest; linear with a remark where a value is not positive."""
    narrow, wide = trials_of(["A", "B"]), trials_of(["A", "B"], factors=[1, 100])
    assert [Rows(log=log).draw(narrow).axes[0].get_xscale() for log in ("auto", True)] == ["linear", "log"]
    assert [Rows(log=log).draw(wide).axes[0].get_xscale() for log in ("auto", False)] == ["log", "linear"]
    assert [Boxplot(log=log).draw(wide).axes[0].get_yscale() for log in ("auto", False)] == ["log", "linear"]
    signed = trials_of(["A", "B"], factors=[-1, 1])
    for keys in (Rows(log=True), Boxplot(log=True)):
        axes = keys.draw(signed).axes[0]
        assert "linear" in axes.get_xlabel() + axes.get_ylabel()


def test_runs_beyond_the_whiskers_are_points(trials_of):
    trials = trials_of(["A", "B"], n=200)
    axes = Boxplot().draw(trials).axes[0]
    for place, method in enumerate("AB"):
        values = np.sort(trials.column("length", method))
        low, high = np.quantile(values, [0.05, 0.95])
        np.testing.assert_allclose(box(axes, method, upright=True), np.quantile(values, LEVELS))
        dots = of(axes.lines, method)[2].get_xydata()
        assert set(dots[:, 0]) == {place}
        np.testing.assert_allclose(dots[:, 1], values[(values < low) | (values > high)])
        assert axes.get_ylim()[0] < values[0] and axes.get_ylim()[1] > values[-1]
    many = trials_of(["A"], n=20_000)
    dots = of(Boxplot().draw(many).axes[0].lines, "A")[2].get_ydata()
    values = many.column("length", "A")
    assert len(dots) == MOST_DOTS and (dots[0], dots[-1]) == (values.min(), values.max())


def test_events_that_never_occur_and_metrics_that_are_best_at_0(make_trials):
    """Superiority, counts, an empty box or one that ends in an arrow; differences on a linear axis with the unit."""
    rng = np.random.default_rng(0)
    values = {"A": [math.inf] * 20, "B": [*rng.uniform(1, 2, 15), *[math.inf] * 5], "C": list(rng.uniform(1, 2, 20))}
    trials = make_trials({"time": values}, (TIME,))
    figure = Rows(show=["values", "change", "share"]).draw(trials)
    boxes, changes, shares = figure.axes
    assert [line.get_marker() for line in of(boxes.lines, "B")][-1] == ">"
    assert [line.get_marker() for line in of(boxes.lines, "C")][-1] == "None"
    rows = comparison_frame(trials).set_index("method")
    assert of(changes.lines, "C")[1].get_xdata() == [rows.loc["C", "superiority"]]
    assert [text.get_text() for text in shares.texts] == ["0 of 20", "15 of 20", "20 of 20"]
    all_lost = make_trials({"time": {"A": [math.inf] * 5, "B": [math.inf] * 5}}, (TIME,))
    assert Rows().draw(all_lost) and Boxplot().draw(all_lost)
    rng = np.random.default_rng(0)
    trials = make_trials({"gap": {"A": list(rng.normal(size=50)), "B": list(rng.normal(1.0, 1.0, 50))}}, (GAP,))
    axes = Rows().draw(trials).axes[1]
    assert axes.get_xlabel() == "difference from A [m]" and axes.get_xscale() == "linear"
    np.testing.assert_allclose(of(axes.lines, "B")[1].get_xdata(), comparison_frame(trials)["difference"])


def test_shares_have_wilson_intervals_and_means_those_of_the_summary(make_trials, trials_of):
    """Of a metric of 0 and 1, and of runs above a number; failed runs do not count."""
    values = {"A": [0.0] * 30 + [1.0] * 10, "B": [0.0] * 39 + ["diverged"]}
    trials = make_trials({"runaway": values}, (RUNAWAY,))
    (axes,) = Rows(show="share").draw(trials).axes
    assert [text.get_text() for text in axes.texts] == ["10 of 40", "0 of 39"]
    np.testing.assert_allclose(of(axes.lines, "A")[0].get_xdata(), 100 * np.array(wilson(10, 40, 0.95)))
    assert axes.get_xlabel() == "runs with runaway [%]"
    longer = make_trials({"length": {"A": [1.0, 2.0, 3.0], "B": [3.0, 3.0, 3.0]}}, (LENGTH,))
    (axes,) = Rows(show="share", above=2.0).draw(longer).axes
    assert [text.get_text() for text in axes.texts] == ["1 of 3", "3 of 3"]
    assert axes.get_xlabel() == "runs with length above 2 m [%]"
    trials = trials_of(["A", "B", "C"])
    (axes,) = Rows(show="mean").draw(trials).axes
    rows = summary_frame(trials).set_index("method")
    for method in "ABC":
        interval, middle = of(axes.lines, method)
        np.testing.assert_allclose(interval.get_xdata(), [rows.loc[method, "ci_low"], rows.loc[method, "ci_high"]])
        np.testing.assert_allclose(middle.get_xdata(), [rows.loc[method, "mean"]])


def test_ranks_are_over_all_points(trials_of, make_sweep):
    """Rows in the order of the ranks, with the changes of all points; without ranks the figure says what it needs."""
    points = [({"plant.a": text}, trials_of(["A", "B", "C"], factors=[1, 1.5, 0.5])) for text in ("1", "2")]
    trials = replace(make_sweep(*points), ranks=True, axes=(("plant.a",),))
    changes, ranks = Rows(show=["change", "rank"]).draw(trials).axes
    found = ranking(trials)
    assert names(changes) == [row.method for row in found.rows] == ["C", "A", "B"]
    for row in found.rows:
        assert list(of(ranks.lines, row.method)[0].get_xdata()) == [row.rank_low, row.rank_high]
    ratio = next(row.ratio for row in found.rows if row.method == "C")
    assert of(changes.texts, "C") or of(changes.lines, "C")[1].get_xdata() == [ratio.ratio]
    with pytest.raises(DesignError, match="statistics"):
        Rows(show="rank").draw(replace(trials, ranks=False))


def test_a_method_without_finished_runs_has_an_empty_row(make_trials):
    """Its name is there; nothing is drawn for it.  Values of runs that diverge can be as large as a float."""
    trials = make_trials({"length": {"A": [1.0, 2.0, 3.0], "B": ["diverged"] * 3}}, (LENGTH,))
    for figure in (Rows(show=["values", "mean", "change"]).draw(trials), Boxplot().draw(trials)):
        assert not any(of([*axes.lines, *axes.patches, *axes.texts], "B") for axes in figure.axes)
    assert names(Rows().draw(trials).axes[0]) == ["A", "B"]
    assert "failed runs are left out (B 3)" in Rows().caption(trials)
    lost = {"A": ["diverged"], "B": ["diverged"]}
    wild = {"A": [1.0, 2.0, 3.0], "B": [1e300, 1e305, 1.7e308], "C": [1e-300, 1.0, 1e308]}
    kinds = Rows(show=["share", "values"]), Rows(show=["values", "change", "mean"]), Boxplot(), Boxplot(log=False)
    for keys, values in product(kinds, (lost, wild)):
        assert keys.draw(make_trials({"length": values}, (LENGTH,)))


def test_of_more_than_six_points_the_first_six_are_drawn(trials_of, make_sweep):
    points = [({"plant.a": f"{k}"}, trials_of(["A", "B"], factors=[1 + k, 1.2 + k])) for k in range(7)]
    trials = make_sweep(*points)
    for keys, columns in ((Rows(), 2), (Boxplot(), 1)):
        figure = keys.draw(trials)
        assert len(figure.axes) == 6 * columns
        assert "at the first 6 of 7 points" in keys.caption(trials)
        assert len({axes.get_xlim() + axes.get_ylim() for axes in figure.axes[::columns]}) == 1
        some = replace(keys, at=[{"plant.a": 5}, {"plant.a": 1}])
        assert len(some.draw(trials).axes) == 2 * columns and "first 6" not in some.caption(trials)


def test_ticks_have_room_and_the_label_of_all_panels_is_not_cut(trials_of, make_sweep):
    """A browser draws an exponent in a box as high as a letter, which is more than its ink."""
    figure = Rows(width=3.5).draw(trials_of(["a method with a name", "B", "C"], factors=[1, 0.8, 1.3]))
    renderer = figure._get_renderer()
    for axes in figure.axes:
        boxes = [text.get_window_extent(renderer) for text in axes.get_xticklabels()]
        assert len(boxes) > 1 and all(a.x1 < b.x0 for a, b in zip(boxes, boxes[1:], strict=False))
    trials = make_sweep(*(({"plant.a": f"{k}"}, trials_of(["A", "B"], factors=[1, 1.2])) for k in range(2)))
    figure = Boxplot().draw(trials)
    left = figure.get_tightbbox(figure._get_renderer()).x0 * 72
    assert figure.texts and left >= 3.9


def test_captions_are_one_sentence(trials_of):
    trials = trials_of(["A", "B"])
    assert Boxplot().caption(trials) == (
        "Boxes of length [m]: median, quartiles, whiskers from 5 to 95 % of the runs, and the runs beyond them; "
        "n = 100 runs of every method; no run failed."
    )
    assert Rows(show=["change", "mean"]).caption(trials) == (
        "length [m]: changes against A with 95 % intervals, beyond the axis as arrows, means with 95 % intervals; "
        "n = 100 runs of every method; no run failed."
    )


@pytest.mark.parametrize("kind", [Rows, Boxplot])
def test_a_label_stands_in_files_for_papers_only(trials_of, kind):
    trials = replace(trials_of(["A", "B"]), labels={"B": "Label of B"})

    def texts():
        figure = kind().draw(trials)
        return {text.get_text() for axes in figure.axes for text in (*axes.get_yticklabels(), *axes.get_xticklabels())}

    assert "B" in texts() and "Label of B" not in texts()
    with rendered(Rendering(labels=True)):
        assert {"Label of B", "Label\nof B"} & texts() and "B" not in texts()
