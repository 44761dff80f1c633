"""Figure of shares: what it counts, its intervals, words and rows."""

import numpy as np
import pytest

from rmpc_bench.analysis.intervals import wilson
from rmpc_bench.figures.shares import Shares
from rmpc_bench.types import DesignError, MetricInfo

RUNAWAY = MetricInfo("runaway", "", "lower")
TORQUE = MetricInfo("largest", "N m", "lower", label="largest torque")


@pytest.fixture
def table(make_trials):
    """Two of ten runs of A run away, none of B, of which one failed."""
    values = {
        "runaway": {"A": [1.0, 1.0] + [0.0] * 8, "B": ["diverged"] + [0.0] * 9},
        "largest": {"A": [30.0, 60.0] + [10.0] * 8, "B": [90.0] * 10},
    }
    return make_trials(values, (RUNAWAY, TORQUE), labels={"B": "S + input"})


def texts(figure):
    """All texts of the panel: names of the rows, counts, and the label of the axis."""
    (axes,) = figure.axes
    return [label.get_text() for label in axes.get_yticklabels()], [text.get_text() for text in axes.texts], axes


def bars(axes):
    """Ends of the bars from top to bottom [%]."""
    return [tuple(segment[:, 0]) for lines in axes.collections for segment in lines.get_segments()]


def test_rows_show_shares_with_wilson_intervals(table):
    """Oracle: the counts by hand; the interval of 2 of 10 at 95 % is 5.7 to 51.0 %, of 0 of 9 it is 0 to 29.9 %.

    Trap: the t interval of a mean over runs without a runaway is the point 0.
    """
    names, counts, axes = texts(Shares(metric="runaway").draw(table))
    assert names == ["A", "S + input"] and counts == ["2 of 10", "0 of 9"]
    assert axes.get_xlabel() == "share of runs: runaway [%]"
    np.testing.assert_allclose(bars(axes), [(5.668, 50.984), (0.0, 29.915)], atol=5e-3)
    assert [line.get_xdata()[0] for line in axes.lines if line.get_marker() not in ("", "None", None)] == [20.0, 0.0]


def test_runs_above_a_number(table):
    """Oracle: one run of A and all finished ones of B are above 50 N m; equal to the number is not above."""
    _, counts, axes = texts(Shares(metric="largest", above=50.0).draw(table))
    assert counts == ["1 of 10", "9 of 9"]
    assert axes.get_xlabel().split() == "share of runs: largest torque above 50 N m [%]".split()
    _, counts, _ = texts(Shares(metric="largest", above=60.0, order=["A"]).draw(table))
    assert counts == ["0 of 10"]


def test_caption(table):
    """Oracle: the counts by hand, and the upper end of the interval of 0 of 9."""
    text = Shares(metric="runaway").caption(table)
    assert text.startswith("Share of the runs: runaway. Marks are the shares, bars their 95 % Wilson intervals")
    assert "Largest share: A, 2 of 10." in text
    assert "In no run: S + input (upper end of the interval at most 30 %)." in text
    assert wilson(0, 9, 0.95)[1] == pytest.approx(0.2991, abs=1e-4)
    assert "failed runs are left out (S + input 1)" in text


def test_points_of_a_sweep_lie_together(make_sweep, table):
    """Oracle: a row per point and method; the points name the rows, the methods are in the legend."""
    sweep = make_sweep(*[({"model.disturbance.at": at}, table) for at in ("input", "load")])
    figure = Shares(metric="runaway").draw(sweep)
    names, counts, axes = texts(figure)
    assert names == ["at=input", "at=load"] and counts == ["2 of 10", "0 of 9"] * 2
    y = [segment[0, 1] for lines in axes.collections for segment in lines.get_segments()]
    assert y[2] - y[1] > y[1] - y[0] == 1.0
    legend = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert legend == ["A", "S + input"]
    one = Shares(metric="runaway", at=[{"model.disturbance.at": "load"}])
    assert texts(one.draw(sweep))[0] == ["A", "S + input"]
    assert "Largest share: A at at=input, 2 of 10." in Shares(metric="runaway").caption(sweep)


def test_a_method_without_values(make_trials):
    """Oracle: a metric that a method has no value of, as the shares of QPs of a method that clips."""
    table = make_trials({"runaway": {"A": [1.0, 0.0], "B": [np.nan, np.nan]}}, (RUNAWAY,))
    _, counts, axes = texts(Shares(metric="runaway").draw(table))
    assert counts == ["1 of 2", "no value"] and len(bars(axes)) == 1


def test_check(table, make_sweep):
    """Oracle: the names of metrics and methods, and the rows that fit."""
    for keys, key in (({"metric": "runawy"}, "metric"), ({"order": ["C"]}, "order")):
        with pytest.raises(DesignError) as found:
            Shares(**keys).draw(table)
        assert found.value.parameter == key
    sweep = make_sweep(*[({"controller.Hp": str(Hp)}, table) for Hp in range(25)])
    with pytest.raises(DesignError, match="50 rows do not fit into one figure"):
        Shares().draw(sweep)
