"""Axes of changes and values: the ends of the design, ticks that have room, places of values."""

import math

import numpy as np
import pytest

from rmpc_bench.analysis.shown_numbers import Estimate
from rmpc_bench.figures.axes import APART, difference_axis, ratio_axis, share_axis, value_axis

FOUR = [(0.9, 0.85, 0.95), (1.1, 1, 1.2), (1.05, 1, 1.1), (50, 40, 60)]


def changes(*rows):
    """Changes in per cent from ratios with their ends."""
    return [Estimate(*(100 * (ratio - 1) for ratio in row)) for row in rows]


@pytest.mark.parametrize(
    ("rows", "low", "high", "beyond", "ticks"),
    [
        (FOUR, 0.8355, 1.2209, [3], ["−10 %", "0", "+10 %", "+20 %"]),
        ([(0.9, 0.85, 0.95), (50, 40, 60)], 0.8423, 1.0293, [1], None),
        ([(1, 0.999, 1.001)], math.exp(-0.02178), math.exp(0.02178), [], None),
    ],
)
def test_ends_of_an_axis_of_ratios(rows, low, high, beyond, ticks):
    """A row that reaches 8 times as far as the middle one lies beyond the end; the margin is 1 %."""
    axis = ratio_axis(changes(*rows), 0.01)
    assert [round(math.exp(axis.low), 4), round(math.exp(axis.high), 4)] == [round(low, 4), round(high, 4)]
    assert [k for k, row in enumerate(rows) if not 0 <= axis.place(row[0]) <= 1] == beyond
    assert ticks is None or [tick.label for tick in axis.ticks] == ticks


def test_ticks_leave_room_and_lie_on_the_axis():
    """Whatever the rows: at least one tick, no change among them, neighbours apart, labels true."""
    rng = np.random.default_rng(7)
    for _ in range(500):
        n = int(rng.integers(1, 12))
        logs = rng.normal(scale=10 ** rng.uniform(-3, 1), size=n)
        halves = np.abs(rng.normal(scale=10 ** rng.uniform(-3, 0), size=n))
        rows = [tuple(np.exp([m, m - h, m + h])) for m, h in zip(logs, halves, strict=True)]
        axis = ratio_axis(changes(*rows), 0.01)
        places = [tick.at for tick in axis.ticks]
        assert 0.0 in places and places == sorted(places)
        assert all(axis.low <= at <= axis.high for at in places)
        assert all(b - a >= APART * (axis.high - axis.low) for a, b in zip(places, places[1:], strict=False))
        for tick in axis.ticks:
            text = tick.label.replace("−", "-")
            value = float(text[1:]) if text[0] == "×" else 1 + float(text.removesuffix(" %")) / 100
            assert math.log(value) == pytest.approx(tick.at, abs=1e-12)


def test_axes_of_values_and_of_rows_without_an_interval():
    """Logarithmic above a factor of 20, else linear; equal values have an axis, too."""
    assert value_axis([1.0, 25.0]).log and not value_axis([1.0, 20.0]).log and not value_axis([-1.0, 100.0]).log
    assert [tick.label for tick in value_axis([0.1, 0.5]).ticks] == ["0.1", "0.2", "0.3", "0.4", "0.5"]
    for values in ([3.0], [0.0, 0.0], [], [math.inf, 2.0], [1e-9, 1e9], [1e-15, 3e-15], [-5.0, 7.0]):
        axis = value_axis(values)
        assert axis.low < axis.high and 1 <= len(axis.ticks) <= 6
        finite = [value for value in values if math.isfinite(value)]
        assert all(0 <= axis.place(value) <= 1 for value in finite)
    axis = ratio_axis([Estimate(-10.0), Estimate(-100.0, -100.0, -100.0), Estimate(5.0, 1.0, 9.0)], 0.01)
    assert math.isfinite(axis.low) and axis.place(0.0) < 0 < axis.place(1.05) < 1


def test_axis_of_differences_and_of_shares():
    rows = [Estimate(-0.02, -0.03, -0.01), Estimate(0.01, 0.0, 0.02), Estimate(0.015, 0.01, 0.02), Estimate(9, 8, 10)]
    axis = difference_axis(rows, 0.0)
    assert "0.00" in [tick.label for tick in axis.ticks] or "0" in [tick.label for tick in axis.ticks]
    assert axis.place(9) > 1 and 0 < axis.place(-0.03) < axis.place(0.02) < 1
    assert difference_axis([Estimate(0, 0, 0)], 0.0).place(0) == pytest.approx(0.5)
    assert share_axis().place(0.5) == pytest.approx(0.5)
