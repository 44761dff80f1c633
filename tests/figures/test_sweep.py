"""Figures over a sweep: what is drawn is read back from the artists and compared with the records of the analysis."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from data_frames import comparison_frame, summary_frame
from matplotlib.collections import PolyCollection
from matplotlib.patches import Rectangle

from rmpc_bench.analysis.comparison import levels
from rmpc_bench.figures.palette import DIM, METHODS, line_styles
from rmpc_bench.figures.points import tables_of
from rmpc_bench.figures.style import style
from rmpc_bench.figures.sweep import PAGE, Sweep, page_drawings
from rmpc_bench.figures.sweep_content import APART, content_of, main_paths
from rmpc_bench.figures.sweep_panels import apart, draw_lines
from rmpc_bench.types import DesignError, MetricInfo

LENGTH, GAP = MetricInfo("length", "m", "lower"), MetricInfo("gap", "m", "zero")
TIME = MetricInfo("time", "s", "lower", may_not_occur=True)
NUMBERS = {1: [3.0], 6: [-2.0, -1.0, 0.0, 1.0, 2.0, 4.0], 7: [0.01 * 3**k for k in range(7)], 12: range(1, 13)}


@pytest.fixture
def sweep_of(make_trials, make_sweep):
    """Make a sweep of named methods over points; method k is about 1 + k x as large as the first at the number x."""

    def make(names, points, info=LENGTH, n=20, labels=None, relevant=0.01):
        rng = np.random.default_rng(3)
        base = np.exp(0.3 * rng.normal(size=n))
        tables = []
        for number, point in enumerate(points):
            noise = np.exp(0.1 * rng.normal(size=(len(names), n)))
            factors = 1 + 0.05 * np.arange(len(names)) * (number - 1)
            values = {name: list(f * base * each) for name, f, each in zip(names, factors, noise, strict=True)}
            values[names[0]] = list(base)
            tables.append((point, replace(make_trials({info.name: values}, (info,), labels), relevant=relevant)))
        return make_sweep(*tables)

    return make


def over(numbers, path="plant.a"):
    return [{path: f"{number:g}"} for number in numbers]


def lines(axes):
    """Method -> points of its line, the reference left out."""
    return {
        line.get_gid().removeprefix("method-"): line.get_xydata()
        for line in axes.lines
        if line.get_gid() and len(line.get_xydata()) and line.get_transform() == axes.transData
    }


def bands(axes):
    """Method -> lowest and highest value of its band at every number."""
    found = {}
    for area in axes.collections:
        if isinstance(area, PolyCollection):
            corners = np.concatenate([path.vertices for path in area.get_paths()])
            found[area.get_gid().removeprefix("method-")] = {
                x: (corners[corners[:, 0] == x, 1].min(), corners[corners[:, 0] == x, 1].max())
                for x in np.unique(corners[:, 0])
            }
    return found


@pytest.mark.parametrize("n_points", NUMBERS)
@pytest.mark.parametrize("n_methods", range(1, 10))
def test_lines_are_the_records_and_all_points_lie_within_the_axes(sweep_of, n_methods, n_points):
    """Changes and intervals of comparisons.csv, for 1 to 9 methods and up to 12 points, linear and logarithmic."""
    names = [f"M{k}" for k in range(n_methods)]
    trials = sweep_of(names, over(NUMBERS[n_points]))
    (axes,) = Sweep().draw(trials).axes
    low, high = axes.get_xlim()
    drawn, areas = lines(axes), bands(axes)
    assert set(drawn) == set(names[1:] or names)
    for x, point in zip(NUMBERS[n_points], trials.each, strict=True):
        assert low < x < high
        rows = comparison_frame(point, levels(trials)).set_index("method")
        for name in names[1:]:
            ((_, y),) = drawn[name][np.isclose(drawn[name][:, 0], x)]
            assert y == pytest.approx(1 + rows.loc[name, "change_pct"] / 100)
            (ends,) = [ends for at, ends in areas[name].items() if math.isclose(at, x)]
            assert ends == pytest.approx([1 + rows.loc[name, end] / 100 for end in ("ci_low", "ci_high")])
    assert axes.get_xscale() == ("log" if n_points == 7 else "linear")
    scaled = np.log if n_points == 7 else np.asarray
    ends, numbers = scaled([low, high]), scaled(list(NUMBERS[n_points]))
    if n_points > 1:
        pad = 0.02 * np.ptp(numbers)
        np.testing.assert_allclose(ends, [numbers.min() - pad, numbers.max() + pad])
    assert all(low <= tick <= high for tick in axes.get_xticks()) and len(axes.get_xticks())


def test_seven_methods_have_colours_and_more_are_thin_and_grey(sweep_of):
    """The place of a method among all methods gives its colour, dashes and marker, which it has in every figure."""
    names = [f"M{k}" for k in range(9)]
    (axes,) = Sweep(show="value").draw(sweep_of(names, over([1, 2, 3]))).axes
    looks = [(line.get_color(), line.get_marker()) for line in axes.lines]
    assert [color for color, _ in looks] == [*METHODS, DIM, DIM]
    assert len({marker for _, marker in looks[:7]}) == 7 and looks[7][1] == "None"
    assert len({str(line.get_linestyle()) + str(line._dash_pattern) for line in axes.lines[:7]}) == 7
    assert all(line.get_linewidth() < axes.lines[0].get_linewidth() for line in axes.lines[7:])
    few, many = (line_styles(names, shown) for shown in (["M7", "M3", "M0"], names))
    same = [(each[name].color, each[name].marker, each[name].linestyle) for each in (few, many) for name in few]
    assert same[:3] == same[3:]


def test_names_stand_at_the_ends_of_lines_and_not_on_each_other(sweep_of):
    names = [f"M{k}" for k in range(7)]
    trials = sweep_of(names, over([1, 2, 3]))
    figure = Sweep().draw(trials)
    (axes,) = figure.axes
    texts = [text for text in axes.texts if text.get_visible()]
    assert sorted(text.get_text() for text in texts) == names
    renderer = figure._get_renderer()
    boxes = sorted((text.get_window_extent(renderer) for text in texts), key=lambda box: box.y0)
    assert all(a.y1 <= b.y1 and b.y0 - a.y0 >= 0.9 * (a.y1 - a.y0) for a, b in zip(boxes, boxes[1:], strict=False))
    assert all(box.x1 <= figure.bbox.x1 for box in boxes)


def test_names_are_moved_as_little_as_possible_and_paths_tell_points_apart():
    """Least squares with a smallest distance, within 0 and 1; names determine the values that change with them."""
    assert apart([0.2, 0.8], 0.1) == [0.2, 0.8]
    assert apart([0.5, 0.5], 0.1) == pytest.approx([0.45, 0.55])
    assert apart([1.0, 1.0, 0.0], 0.1) == pytest.approx([0.9, 1.0, 0.0])
    assert apart([0.0, 0.01, 0.02], 0.5) == pytest.approx([0.0, 0.5, 1.0])
    assert main_paths([{"name": "p", "a": "1"}, {"name": "q", "a": "2"}]) == ["name"]
    assert main_paths([{"a": "1", "b": "3"}, {"a": "2", "b": "5"}]) == ["a"]
    assert main_paths([{"a": a, "b": b} for a in "12" for b in "34"]) == ["a", "b"]
    assert main_paths([{}]) == []


def test_a_line_far_beyond_the_others_has_an_arrow_at_its_name(make_trials, make_sweep):
    rng = np.random.default_rng(0)
    base = np.exp(0.3 * rng.normal(size=30))
    noise = [np.exp(0.02 * rng.normal(size=30)) for _ in range(2)]
    values = {"A": base, "B": base * noise[0], "C": 0.95 * base * noise[1], "far": 1000 * base}
    table = make_trials({"length": {name: list(each) for name, each in values.items()}}, (LENGTH,))
    (axes,) = Sweep().draw(make_sweep(*[(point, table) for point in over([1, 2])])).axes
    assert axes.get_ylim()[1] < 2
    assert {text.get_text() for text in axes.texts} == {"A", "B", "C", "far ▲"}


def test_differences_have_a_linear_axis_and_events_are_shares_of_the_runs(make_trials, make_sweep):
    """In the unit of the metric, around no difference; superiority from 0 to 1 where no average is defined."""
    rng = np.random.default_rng(0)
    values = {"A": list(rng.normal(size=30)), "B": list(rng.normal(0.5, 1.0, size=30))}
    trials = make_sweep(*[(point, make_trials({"gap": values}, (GAP,))) for point in over([1, 2, 3])])
    (axes,) = Sweep().draw(trials).axes
    rows = comparison_frame(trials.each[0], levels(trials))
    assert axes.get_yscale() == "linear" and axes.get_title(loc="left").startswith("difference of")
    assert lines(axes)["B"][0, 1] == pytest.approx(rows["difference"][0])
    rng = np.random.default_rng(0)
    never, times = [math.inf] * 10, list(rng.uniform(1, 2, size=10))
    points = [{"A": never, "B": never}, {"A": times, "B": [0.5 * each for each in times]}, {"A": never, "B": times}]
    tables = [make_trials({"time": values}, (TIME,)) for values in points]
    (axes,) = Sweep().draw(make_sweep(*zip(over([1, 2, 3]), tables, strict=True))).axes
    np.testing.assert_allclose(lines(axes)["B"], [[1, 0.5], [2, 1.0], [3, 1.0]])
    assert [text.get_text() for text in axes.get_yticklabels()] == ["0 %", "25 %", "equal", "75 %", "100 %"]


def test_a_method_without_finished_runs_has_no_line_and_a_single_one_its_values(make_trials, make_sweep, sweep_of):
    """Its name does not stand there either; the others are drawn.  The caption is a sentence."""
    values = {"A": [1.0, 2.0, 3.0], "B": ["diverged"] * 3, "C": [0.5, 1.0, 1.6]}
    trials = make_sweep(*[(point, make_trials({"length": values}, (LENGTH,))) for point in over([1, 2])])
    (axes,) = Sweep().draw(trials).axes
    assert set(lines(axes)) == {"C"} and {text.get_text() for text in axes.texts} == {"A", "C"}
    assert Sweep(show="value").draw(trials).axes[0].texts
    trials = sweep_of(["A"], over([1, 2, 3]))
    assert len(lines(Sweep().draw(trials).axes[0])["A"]) == 3
    words = "Mean length [m] over a of the plant with 95 % intervals, 20 runs per point and method."
    assert Sweep().caption(trials) == words


def test_values_are_those_of_the_summary(sweep_of):
    """Means with intervals, medians with quartiles, on the axis that is asked for."""
    trials = sweep_of(["A", "B"], over([1, 2, 3]))
    tables = [summary_frame(point).set_index("method") for point in trials.each]
    for spread, columns in (("interval", ("mean", "ci_low", "ci_high")), ("quartiles", ("median", "q25", "q75"))):
        (axes,) = Sweep(show="value", spread=spread, log=True).draw(trials).axes
        assert axes.get_yscale() == "log"
        wanted = [[table.loc["B", column] for column in columns] for table in tables]
        np.testing.assert_allclose(lines(axes)["B"][:, 1], [row[0] for row in wanted])
        found = bands(axes)["B"]
        np.testing.assert_allclose([found[x] for x in (1.0, 2.0, 3.0)], [row[1:] for row in wanted])
    assert Sweep(show="value", log=False).draw(trials).axes[0].get_yscale() == "linear"


def cells(axes):
    """Text of every cell by row and column."""
    return {(int(text.get_position()[1]), int(text.get_position()[0])): text.get_text() for text in axes.texts}


def test_names_are_a_matrix_whose_longer_side_goes_down(sweep_of):
    """Changes without decimals, the means of the baseline first, the colour of the verdict behind it."""
    trials = sweep_of(["A", "B", "C"], [{"name": text} for text in ("one", "two", "three", "four")])
    (axes,) = Sweep().draw(trials).axes
    assert [text.get_text() for text in axes.get_yticklabels()] == ["one", "two", "three", "four"]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["A, mean", "B", "C"]
    found = cells(axes)
    for place, table in enumerate(tables_of(trials, trials.each, LENGTH)):
        for column, row in enumerate(table.rows[1:], start=1):
            text = f"{row.change.value:+.0f} %".replace("-", "−").replace("+0", "0").replace("−0", "0")
            marks = {"inconclusive": " ?", "equivalent": " ≈"}
            assert found[place, column] == text + marks.get(row.word, "")
    n_coloured = sum("?" not in text and "%" in text and "≈" not in text for text in found.values())
    assert len([each for each in axes.patches if isinstance(each, Rectangle)]) == n_coloured
    assert len(Sweep(order=["B"]).draw(trials).axes[0].get_xticklabels()) == 2
    with pytest.raises(DesignError, match="besides the baseline"):
        Sweep(order=["A"]).draw(trials)


def test_two_paths_are_a_table_per_method_or_panels_on_the_same_axes(sweep_of):
    """Points that the sweep leaves out stay empty; panels have the other coordinate as title."""
    grid = [{"plant.a": a, "model.b": b} for a in ("1", "2", "3") for b in ("x", "y")][:-1]
    trials = sweep_of(["A", "B", "C"], grid)
    figure = Sweep().draw(trials)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["B", "C"]
    assert all(len(cells(axes)) == 5 for axes in figure.axes)
    values = Sweep(show="value", path=["model.b", "plant.a"]).draw(trials)
    assert [axes.get_title(loc="left") for axes in values.axes] == ["A", "B", "C"]
    assert [text.get_text() for text in values.axes[0].get_xticklabels()] == ["x", "y"]
    grid = [{"plant.a": a, "model.b": b} for b in ("wide", "narrow") for a in ("1", "2", "3")]
    first, second = Sweep(path="plant.a").draw(sweep_of(["A", "B"], grid)).axes
    assert first.get_title(loc="left").endswith("b=wide") and second.get_title(loc="left") == "b=narrow"
    assert first.get_ylim() == second.get_ylim() and len(lines(second)["B"]) == 3


def test_the_page_has_two_drawings_of_a_sweep_of_one_number(sweep_of):
    """Texts have at least 9 px in a window of 400 px, of which the page leaves 368 for the figure."""
    trials = sweep_of(["A", "B", "C"], over([1, 2, 3]))
    drawings = page_drawings(tables_of(trials, trials.each, LENGTH))
    assert [*drawings] == ["wide", "narrow"]
    for name, svg in drawings.items():
        assert f'class="{name}"' in svg and 'data-method="B"' in svg and len(svg) < 30_000
    width = float(re.search(r'viewBox="0 0 ([\d.]+)', drawings["narrow"])[1])
    sizes = [float(size) for size in re.findall(r"font-size:\s*([\d.]+)px", drawings["narrow"])]
    assert min(sizes) * 368 / width >= 9
    names = sweep_of(["A", "B"], [{"name": "p"}, {"name": "q"}])
    assert page_drawings(tables_of(names, names.each, LENGTH)) == {}


@pytest.mark.parametrize("numbers", [[3e-4, 1e-3, 3e-3, 1e-2, 2e-2, 3e-2, 0.1], [0, 0.125, 0.25, 0.375], range(1, 40)])
def test_ticks_of_a_narrow_drawing_have_room(sweep_of, numbers):
    """Round numbers are as many as fit, not six of any width."""
    content = content_of(tables_of(trials := sweep_of(["A", "a name"], over(numbers), n=4), trials.each, LENGTH))
    with style():
        figure = draw_lines(content, PAGE["narrow"])
        renderer = figure._get_renderer()
        boxes = [text.get_window_extent(renderer) for text in figure.axes[0].get_xticklabels()]
    assert len(boxes) > 1 and all(b.x0 - a.x1 > 0.5 * APART for a, b in zip(boxes, boxes[1:], strict=False))
