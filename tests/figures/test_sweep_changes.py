"""Changes over a sweep: the numbers of comparisons.csv, curves, rows of categories, and captions."""

import numpy as np
import pytest

from rmpc_bench.figures.sweep_axis import axis_of, in_words, other_paths, usual_path
from rmpc_bench.figures.sweep_lines import SweepLines
from rmpc_bench.report.kept_tables import comparisons_table, summary_table
from rmpc_bench.report.summary import summarise
from rmpc_bench.types import DesignError, MetricInfo

RUNS = 30
HP = "controller.Hp"


@pytest.fixture
def sweep(make_trials, make_sweep):
    """Baseline A, and B whose ratio to it grows with Hp; a run of B failed at Hp = 20."""
    rng = np.random.default_rng(3)

    def table(Hp):
        base = rng.lognormal(0.0, 0.3, RUNS)
        other = list(base * (0.8 + 0.02 * Hp) * rng.lognormal(0.0, 0.05, RUNS))
        if Hp == 20:
            other[4] = "diverged"
        return make_trials({"mse": {"A": list(base), "B": other}})

    return make_sweep(*[({HP: str(Hp)}, table(Hp)) for Hp in (5, 20, 10)])


def curve(axes):
    """The line with markers: x, y."""
    (line,) = (line for line in axes.lines if line.get_marker() not in ("None", ""))
    return np.array(line.get_xydata()).T


def band(axes):
    """Lower and upper end of the band at every x, from its polygon."""
    (area,) = (made for made in axes.collections if type(made).__name__ == "FillBetweenPolyCollection")
    corners = area.get_paths()[0].vertices
    return {x: (corners[corners[:, 0] == x, 1].min(), corners[corners[:, 0] == x, 1].max()) for x in set(corners[:, 0])}


def test_changes_and_intervals_are_those_of_comparisons_csv(sweep):
    """Oracle: the table that is written, of all points together, so with the same simultaneous level."""
    kept = comparisons_table(summarise(sweep).compared)
    kept = kept[kept["metric"] == "mse"].astype({HP: float}).sort_values(HP)
    (axes,) = SweepLines(show="change").draw(sweep).axes
    np.testing.assert_allclose(curve(axes), [kept[HP], kept["change_pct"]], rtol=1e-5)
    ends = band(axes)
    for row in kept.to_dict("records"):
        np.testing.assert_allclose(ends[row[HP]], (row["ci_low"], row["ci_high"]), rtol=1e-5)
    assert axes.get_ylabel().replace("\n", " ") == "change of MSE against A [%]"
    assert "simultaneous 95 % intervals; 29 to 30 paired runs, 1 left out in total" in axes.get_title().replace(
        "\n", " "
    )


@pytest.mark.parametrize(
    ("spread", "columns"), [("interval", ("ci_low", "mean", "ci_high")), ("quartiles", ("q25", "median", "q75"))]
)
def test_values_are_those_of_summary_csv(sweep, spread, columns):
    """Oracle: the table that is written."""
    kept = summary_table(summarise(sweep).described)
    kept = kept[kept["method"] == "B"].astype({HP: float}).sort_values(HP)
    (axes,) = SweepLines(spread=spread, order=["B"]).draw(sweep).axes
    np.testing.assert_allclose(curve(axes), [kept[HP], kept[columns[1]]], rtol=1e-5)
    ends = band(axes)
    for row in kept.to_dict("records"):
        np.testing.assert_allclose(ends[row[HP]], (row[columns[0]], row[columns[2]]), rtol=1e-5)


def test_categories_are_rows(make_trials, make_sweep):
    """Names that determine the swept values are rows from top to bottom, in the order of the sweep."""
    rng = np.random.default_rng(5)
    base = rng.lognormal(0.0, 0.3, RUNS)

    def table(factor):
        noise = rng.lognormal(0.0, 0.01, RUNS)
        return make_trials({"mse": {"A": list(base), "B": list(factor * base * noise), "C": list(base)}})

    names = {"wide law": 2.0, "no noise": 0.5, "half": 1.0}
    sweep = make_sweep(
        *[
            ({"name": name, "plant.low": str(place)}, table(factor))
            for place, (name, factor) in enumerate(names.items())
        ]
    )
    (axes,) = SweepLines(show="change").draw(sweep).axes
    assert [text.get_text() for text in axes.get_yticklabels()] == list(names) and axes.yaxis_inverted()
    marks = [np.array(line.get_xydata()) for line in axes.lines if line.get_marker() not in ("None", "")]
    assert len(marks) == 2
    B, C = marks
    logs = [np.log(sweep.points[i].column("mse", "B") / sweep.points[i].column("mse", "A")).mean() for i in range(3)]
    np.testing.assert_allclose(B[:, 0], 100 * np.expm1(logs), rtol=1e-9)
    np.testing.assert_allclose(C[:, 0], 0.0, atol=1e-12)
    assert (np.round(B[:, 1]) == [0, 1, 2]).all() and (B[:, 1] < C[:, 1]).all()
    caption = SweepLines(show="change").caption(sweep)
    assert "B: from -5" in caption and "(no noise) to +" in caption and "(wide law)." in caption


def test_caption_states_the_extremes(sweep):
    """Full sentences: what is drawn, the runs, the margin, smallest and largest change with their places."""
    figure = SweepLines(show="change")
    kept = summarise(sweep).compared.set_index(HP)["change_pct"]
    caption = figure.caption(sweep)
    assert caption.startswith("Change of MSE against A over Hp of the controller. Marks are the geometric mean")
    assert "The grey band from -0.99 to +1 % is the margin of relevance." in caption
    low, high = f"{kept['5']:+.1f} %", f"{kept['20']:+.1f} %"
    assert f"B: from {low} [" in caption and f"to {high} [" in caption and caption.endswith("(Hp = 20).")
    assert SweepLines().caption(sweep).startswith("MSE in rad^2 over Hp of the controller. Marks are the median")


@pytest.mark.parametrize(
    ("values", "log"),
    [
        (["10", "20", "40", "70", "100"], True),
        (["1e-6", "1e-3", "0.1", "1"], True),
        (["1", "2", "3", "4"], False),
        (["1", "5", "10", "15"], False),
        (["0", "1", "10", "100"], False),
        (["1", "100"], False),
    ],
)
def test_logarithmic_where_values_are_geometric(values, log):
    """Equal ratios rather than equal differences, over more than a factor of eight."""
    axis = axis_of([{"x": value} for value in reversed(values)], "x")
    assert axis.is_geometric == log and list(axis.texts) == values


def test_numbers_with_units_and_categories():
    """Per cent is a unit; a text among numbers makes categories."""
    axis = axis_of([{"plant.perturb.R": "20%"}, {"plant.perturb.R": "5 %"}], "plant.perturb.R")
    assert list(axis.numbers) == [5.0, 20.0] and axis.label == "R of the plant [%]"
    axis = axis_of([{"uncertainty.e": "+-40%"}, {"uncertainty.e": "+-8%"}], "uncertainty.e")
    assert list(axis.numbers) == [8.0, 40.0] and axis.unit == "\N{PLUS-MINUS SIGN}%"
    assert axis_of([{"x": "1"}, {"x": "none"}], "x").numbers is None
    assert axis_of([{"x": "1"}, {"x": "2 %"}], "x").numbers is None
    assert in_words("methods.R.M-1.estimator.tau_max") == "tau max of the estimator of R.M-1"


def test_paths_that_change_together():
    """The names of a zip determine its values; a grid beside it stays."""
    zipped = [{"name": "a", "x": "1"}, {"name": "b", "x": "2"}]
    assert usual_path(zipped) == "name" and other_paths(zipped, "name") == []
    both = [{"N": N, **point} for N in ("5", "6") for point in zipped]
    assert usual_path(both) is None and other_paths(both, "N") == ["name", "x"] and other_paths(both, "name") == ["N"]
    assert other_paths(both, "points") == []


def test_every_point_is_a_category(sweep):
    """With `points` numbers are categories as well."""
    (axes,) = SweepLines(path="points").draw(sweep).axes
    assert [text.get_text() for text in axes.get_yticklabels()] == ["Hp=5", "Hp=20", "Hp=10"]


def test_a_metric_without_an_average_change(make_trials, make_sweep):
    """The way out is to show its value."""
    info = MetricInfo("settling_time", "s", "lower", may_not_occur=True)
    table = make_trials({"settling_time": {"A": [1.0, 2.0], "B": [1.0, np.inf]}}, (info,))
    sweep = make_sweep(({HP: "1"}, table), ({HP: "2"}, table))
    with pytest.raises(DesignError, match="no average change"):
        SweepLines(show="change").draw(sweep)
    assert isinstance(SweepLines(show="value").draw(sweep).axes, list)


def test_methods_that_are_missing_at_a_point(make_trials, make_sweep):
    """A method that has not been computed everywhere has a shorter line."""
    both, one = make_trials({"mse": {"A": [1.0, 2.0], "B": [2.0, 3.0]}}), make_trials({"mse": {"A": [1.0, 2.0]}})
    sweep = make_sweep(({HP: "1"}, both), ({HP: "2"}, one), ({HP: "3"}, both))
    (axes,) = SweepLines(order=["B"]).draw(sweep).axes
    assert list(curve(axes)[0]) == [1.0, 3.0]
