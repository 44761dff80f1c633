"""Shares and curves, read back from the artists."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import ROUND

from rmpc_bench.analysis.driver_text import share_text
from rmpc_bench.analysis.drivers import drivers
from rmpc_bench.figures.drivers import N_CURVE, NO_QUANTITY, Drivers
from rmpc_bench.types import DesignError, ResultLayout

N = 80


@pytest.fixture
def trials(make_trials):
    """Two methods and a baseline; the log ratio of R depends on a and a little on b, that of T on nothing."""
    rng = np.random.default_rng(3)
    table = pd.DataFrame({"run": np.arange(N), "b": rng.uniform(-1, 1, N), "a": rng.uniform(1, 2, N)})
    base = np.exp(rng.normal(size=N))
    ratio = {"S": np.ones(N), "R": np.exp(table["a"] ** 2 - 2 + 0.1 * table["b"]), "T": np.exp(rng.normal(size=N))}
    found = make_trials({"mse": {name: list(base * each) for name, each in ratio.items()}})
    return replace(found, uncertainty=table)


def test_bars_are_the_shares_with_their_intervals(trials):
    """The strongest quantity stands on top, and the last group is what is not explained."""
    figure = Drivers(order=["R"]).draw(trials)
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a", "b", "not explained"]
    rows = drivers(trials)
    rows = rows[rows["method"] == "R"].set_index("quantity").loc[["a", "b", "(rest)"]]
    np.testing.assert_allclose([bar.get_width() for bar in axes.patches], 100 * rows["share"].clip(0, 1), **ROUND)
    ends = [line.get_xdata() for line in axes.lines]
    np.testing.assert_allclose(ends, 100 * rows[["share_low", "share_high"]].clip(0, 1), **ROUND)


def test_what_is_not_resolved_is_a_text_and_no_bar(trials):
    """T depends on nothing: a share of chance would look like a result."""
    axes = Drivers(order=["T"]).draw(trials).axes[0]
    rows = drivers(trials)
    rows = rows[rows["method"] == "T"].to_dict("records")
    expected = [share_text(row) for row in rows if not row["resolved"]]
    assert expected and sorted(text.get_text() for text in axes.texts) == sorted(expected)
    assert len(axes.patches) == len(rows) - len(expected)


def test_points_and_curve_of_the_strongest_quantity(trials):
    """Every run in per cent, and the parabola of the logs, which is exact for the main quantity but for b."""
    figure = Drivers(order=["R"], panels=1).draw(trials)
    points, curve = (line for line in figure.axes[1].lines if len(line.get_xdata()) in (N, N_CURVE))
    a, b = trials.pairs("mse", "R", "S")
    np.testing.assert_allclose(points.get_ydata(), 100 * (a / b - 1), rtol=1e-9)
    x = trials.uncertainty["a"].to_numpy()
    np.testing.assert_array_equal(points.get_xdata(), x)
    expected = np.polyval(np.polyfit(x, np.log(a / b), 2), curve.get_xdata())
    np.testing.assert_allclose(np.log1p(curve.get_ydata() / 100), expected, rtol=1e-6, atol=1e-8)  # the ridge


def test_below_fifty_runs_there_is_neither_bar_nor_curve(trials):
    """The points are there."""
    short = replace(trials, frame=trials.frame[trials.frame["run"] < 20])
    figure = Drivers(order=["R"], panels=1).draw(short)
    assert not figure.axes[0].patches
    assert sorted(len(line.get_xdata()) for line in figure.axes[1].lines) == [0, 2, 20]


def test_the_caption_has_the_numbers(trials):
    """With what bars, lines and curves are."""
    caption = Drivers().caption(trials)
    row = drivers(trials).iloc[[1]]
    assert row.iloc[0]["quantity"] == "a"
    rows = drivers(trials)
    a = rows[(rows["method"] == "R") & (rows["quantity"] == "a")].to_dict("records")[0]
    assert f"R: a {share_text(a)}" in caption
    assert "log ratio of mse to S" in caption and "need not sum to 100 %" in caption and "80 runs" in caption


def test_what_cannot_be_drawn(trials):
    """Without uncertain quantities, and the baseline beside others."""
    with pytest.raises(DesignError, match="uncertain quantity"):
        Drivers().draw(replace(trials, uncertainty=pd.DataFrame({"run": np.arange(N)})))
    with pytest.raises(DesignError, match="show it alone"):
        Drivers(order=["S", "R"]).draw(trials)
    layout = ResultLayout(methods=("S", "R"), metrics=("mse",), points=({},), is_uncertain=False)
    assert [issue.message for issue in Drivers().check(layout)] == [NO_QUANTITY]
    assert len(Drivers(order=["S"]).draw(trials).axes[0].get_yticklabels()) == 3


def test_caption_says_that_not_all_runs_are_points(make_trials):
    """More than 500 runs: a part of them is drawn, and the caption does not say that all are."""
    rng = np.random.default_rng(8)
    for n, words in ((400, "every run"), (1200, "at most 500 runs of a method")):
        values = rng.uniform(-1, 1, n)
        table = make_trials({"mse": {"A": np.exp(values), "B": np.exp(0.5 * values + rng.normal(0, 0.1, n))}})
        table = replace(table, uncertainty=pd.DataFrame({"run": np.arange(n), "eps": values}))
        assert f"Below: {words} against eps" in Drivers().caption(table)
        points = [line for axes in Drivers().draw(table).axes for line in axes.lines if line.get_markersize() == 1.6]
        assert points and all(300 < len(line.get_xdata()) <= 500 for line in points)
