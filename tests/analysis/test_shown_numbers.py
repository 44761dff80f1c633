"""Numbers as a reader sees them: the cases of the design, each derived by hand."""

import math

import pytest

from rmpc_bench.analysis.shown_numbers import (
    Estimate,
    change_texts,
    difference_texts,
    interval_text,
    mean_text,
    number,
    places,
    plain,
    short,
)


@pytest.mark.parametrize(
    ("mean", "text"),
    [
        ((0.117389, 0.112445, 0.122332), "0.117 ± 0.005"),
        ((0.104440, 0.102502, 0.106377), "0.1044 ± 0.0019"),
        ((59.7743, 51.29, 68.2587), "60 ± 8"),
        ((1234567.0, 1234000.0, 1235134.0), "(1.2346 ± 0.0006)e6"),
        ((2e-7, 1e-7, 3e-7), "(2.0 ± 1.0)e−7"),
        ((12.0, 12.0, 12.0), "12"),
        ((3.14159, math.nan, math.nan), "3.142"),
        ((math.nan, math.nan, math.nan), "-"),
        ((-0.02, -0.03, -0.01), "−0.020 ± 0.010"),
    ],
)
def test_means(mean, text):
    """The half width has two digits if it begins with 1 to 3, else one."""
    assert mean_text(Estimate(*mean)) == text


@pytest.mark.parametrize(
    ("x", "digits", "text"),
    [
        (1287.4, 3, "1290"),
        (69149.0, 3, "69100"),
        (999960.0, 4, "1e6"),
        (-999940.0, 4, "\u2212999900"),
        (0.00012345, 3, "0.000123"),
        (0.000012345, 3, "1.23e\u22125"),
        (1.5, 3, "1.5"),
        (-0.0, 3, "0"),
        (math.inf, 3, "inf"),
        (math.nan, 3, "-"),
    ],
)
def test_numbers_without_an_interval(x, digits, text):
    """A power of ten stands only where a mean with its interval has one: below 1e-4 and from 1e6 on."""
    assert short(x, digits) == text


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ((-11.1105, -15.2737, -6.74284), "-11 % [-15, -7]"),
        ((-0.002, -0.003, -0.001), "-0.002 % [-0.003, -0.001]"),
        ((-10.53, -19.93, -0.04), "-10.53 % [-19.93, -0.04]"),
        ((161, 107, 228), "x2.6 [2.1, 3.3]"),
        ((40000, 30000, 54000), "x401 [301, 541]"),
        ((-99.9, -99.92, -99.88), "x0.0010 [0.00080, 0.0012]"),
        ((100, 90, 110), "+100 % [+90, +110]"),
        ((-80, -81, -79), "-80.0 % [-81.0, -79.0]"),
        ((0.0, -0.02, 0.01), "0.00 % [-0.02, +0.01]"),
        ((3.0, math.nan, math.nan), "+3.0 %"),
    ],
)
def test_changes(change, text):
    """Per cent from a fifth to twice the baseline, else factors of two digits."""
    assert plain(" ".join(filter(None, change_texts(Estimate(*change))))) == text


def test_a_mirrored_change_is_a_positive_reduction():
    """Its ends are in order; there is no change without a value."""
    assert change_texts(Estimate(-11.1105, -15.2737, -6.74284), mirrored=True) == ("11 %", "[7, 15]")
    assert difference_texts(Estimate(-0.02, -0.03, -0.01), "rad", mirrored=True) == ("0.020 rad", "[0.010, 0.030]")
    large, small = Estimate(-6.2e6, -8.4e6, -4.3e6), Estimate(0.0012, 1e-5, 0.0024)
    assert difference_texts(large, "m") == ("\u22126.2e6 m", "[\u22128.4e6, \u22124.3e6]")
    assert difference_texts(small) == ("+0.00120", "[+0.00001, +0.00240]")
    assert change_texts(Estimate()) == difference_texts(Estimate()) == ("", "")


def test_intervals_and_numbers():
    """Both ends have the decimals of the estimate; below the point numbers are rounded; a zero has no sign."""
    assert interval_text(Estimate(0.117389, 0.112445, 0.122332)) == "0.117 [0.112, 0.122]"
    assert interval_text(Estimate(20911.0, 12041.0, 27027.0)) == "21000 [12000, 27000]"
    assert interval_text(Estimate(5.0, 5.0, 5.0)) == "5"
    assert number(-0.0004, 2) == number(0.0004, 2, sign=True) == "0.00"
    assert number(math.inf, 2) == "inf" and number(-math.inf, 2) == "−inf"


@pytest.mark.parametrize("half", [0.0, -1.0, math.nan, math.inf])
def test_decimals_without_a_width(half):
    """Three."""
    assert places(half) == 3


def test_half_widths_keep_one_or_two_digits():
    """For any width the rounded half width differs from the true one by at most 12.5 %, half a unit of 4."""
    for k in range(1, 4000):
        half = 10 ** (k / 500 - 4)
        shown = round(half, places(half))
        assert abs(shown - half) <= 0.125 * half
