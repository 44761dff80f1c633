"""Numbers as text; the oracles are texts written by hand after the three rules of the module."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rmpc_bench.analysis.number_text import decimals, interval_text, median_text, with_error

INF = math.inf


@pytest.mark.parametrize(
    ("value", "se", "text"),
    [
        (0.11861, 0.00149, "0.1186(15)"),
        (0.10541, 0.00071, "0.1054(7)"),
        (-0.10541, 0.00071, "-0.1054(7)"),
        (12.3456, 0.0997, "12.35(10)"),
        (323.5, 12.1, "324(12)"),
        (3235.0, 470.0, "3200(500)"),
        (1.23456e-7, 4.1e-9, "1.23(4)e-07"),
        (1.23456e8, 2.0e6, "1.235(20)e+08"),
        (0.0, 0.5, "0.0(5)"),
        (2.0, 0.0, "2"),
        (2.0, 1e-15, "2"),
        (1 / 3, math.nan, "0.3333"),
        (INF, math.nan, "inf"),
        (math.nan, 1.0, "-"),
    ],
)
def test_a_value_with_its_standard_error(value, se, text):
    """The bracket is the error of the last digits."""
    assert with_error(value, se) == text


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 10))
def test_a_value_stays_within_its_error(value, se):
    """Rounding moves a value by at most half of its error."""
    body = with_error(value, se)
    shown = float(body[: body.index("(")] + body[body.index(")") + 1 :])
    assert abs(shown - value) <= 0.5 * se * 1.001


@pytest.mark.parametrize(
    ("median", "low", "high", "n", "text"),
    [
        # Fig. 7 of zenere2018, as the specification of the screen has it.
        (0.114489, 0.10213, 0.135736, 200, "0.114 [0.102, 0.136]"),
        (0.103125, 0.0993514, 0.110188, 200, "0.103 [0.099, 0.110]"),
        # One digit of the spread is not enough, however few runs there are.
        (0.1112, 0.1034, 0.1147, 4, "0.111 [0.103, 0.115]"),
        (18.21, 3.43, 19.06, 8, "18.2 [3.4, 19.1]"),
        # One exponent for all would write the quartiles as 0e+60 and 235430e+60.
        (1.04e61, 3.1e57, 2.3543e65, 40, "1.0e+61 [3.1e+57, 2.4e+65]"),
        (1.22e7, 1.04e7, 1.4e7, 10, "1.22e+07 [1.04e+07, 1.40e+07]"),
        (INF, 3.62, INF, 200, "inf [3.62, inf]"),
        (7.5, 3.6, INF, 200, "7.5 [3.6, inf]"),
        (2.0, 2.0, 2.0, 20, "2 [2, 2]"),
        (0.0, 0.0, 0.0, 4, "0 [0, 0]"),
        (math.nan, math.nan, math.nan, 0, "-"),
    ],
)
def test_a_median_with_its_quartiles(median, low, high, n, text):
    assert median_text(median, low, high, n) == text


@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.integers(2, 10_000))
def test_quartiles_that_differ_are_told_apart(median, below, above, n):
    """The spread is shown to a twentieth of itself."""
    low, high = median - below, median + above
    shown = [float(text) for text in re.findall(r"-?[\d.]+(?:e[+-]\d+)?", median_text(median, low, high, n))]
    assert abs(shown[2] - shown[1] - (high - low)) <= (high - low) / 10
    assert shown[1] < shown[2]


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        (-10.9134, -12.077, -9.73443, "-10.9 % [-12.1, -9.7]"),
        (-5.0, -9.0, -0.8, "-5.0 % [-9.0, -0.8]"),
        (20.12, 15.8, 24.9, "+20.1 % [+15.8, +24.9]"),
        (1.2e9, 3.4e7, 5.6e11, "+1.20e+09 % [+3.40e+07, +5.60e+11]"),
        (1031.3, 953.1, 1114.2, "+1031 % [+953, +1114]"),
        (1.5, math.nan, math.nan, "+1.5 %"),
        (0.0, 0.0, 0.0, "0 % [0, 0]"),
        (0.004, -1.0, 1.2, "0.0 % [-1.0, +1.2]"),
        (0.0, math.nan, math.nan, "0 %"),
        (math.nan, math.nan, math.nan, "-"),
    ],
)
def test_a_change_with_its_interval(value, low, high, text):
    assert interval_text(value, low, high, unit="%") == text


@given(st.floats(-1e5, 1e5), st.floats(1e-4, 1e3))
def test_an_interval_shows_two_digits_of_its_width(value, reach):
    """The printed ends differ from the computed ones by at most a twentieth of half the width."""
    shown = [float(text) for text in re.findall(r"-?[\d.]+", interval_text(value, value - reach, value + reach))]
    for number, computed in zip(shown, (value, value - reach, value + reach), strict=True):
        assert abs(number - computed) <= 0.0501 * reach


def test_decimals():
    assert [decimals(size) for size in (0.0123, 1.0, 4.5, 35.0, 0.0, math.nan, 1e-30)] == [3, 1, 1, 0, 3, 3, 12]
