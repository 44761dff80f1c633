"""Digits that stay the same when rounding errors change."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rmpc_bench.analysis.rounding import (
    decimal_text,
    negligible,
    rounded,
    significant,
    significant_text,
    without_noise,
)


@given(st.integers(1, 10**7 - 1), st.integers(-30, 30), st.sampled_from([-1e-13, 1e-13, 3e-14]))
def test_a_border_is_one_number(digits, exponent, noise):
    """Also a number of seven digits, the last of which is rounded away, keeps its text."""
    value = float(f"{digits}e{exponent}")
    assert significant_text(value * (1 + noise)) == significant_text(value)
    assert significant(value * (1 + noise)) == significant(value) == pytest.approx(value, rel=6e-6)


@pytest.mark.parametrize(
    ("value", "text"),
    [(123456.5, "123456"), (0.1 + 0.2, "0.3"), (2.5e-7, "2.5e-07"), (-0.0, "0"), (1e22, "1e+22"), (-1.25, "-1.25")],
)
def test_by_hand(value, text):
    """Six digits, without the zeros that say nothing."""
    assert significant_text(value) == text


def test_decimals():
    """A border of decimals is one number, too, and no zero has a sign."""
    assert decimal_text(0.125, 2) == decimal_text(math.nextafter(0.125, 1), 2) == decimal_text(0.125 * (1 - 1e-13), 2)
    assert (decimal_text(-0.001, 2), decimal_text(-0.0, 0), decimal_text(-1.5, 1)) == ("0.00", "0", "-1.5")


def test_what_is_no_finite_number_stays():
    """There is nothing to round."""
    assert significant(math.inf) == math.inf and math.isnan(significant(math.nan))


def test_negligible():
    """Beside its scale; infinity hides nothing."""
    assert negligible(1e-17, 1.0) and negligible(-1e-17, -1.0) and negligible(0.0, 1.0)
    assert not negligible(1e-8, 1.0) and not negligible(1.0, math.inf) and not negligible(1.0, math.nan)


def test_digits_that_a_computation_supports():
    """Nine to ten of the scale, by hand; a scale on a power of ten is one number."""
    assert (without_noise(0.0232562499, 2e4), without_noise(6e-15, 30.0)) == (0.02326, 0.0)
    assert (without_noise(-123.456789012345, 200.0), without_noise(-1e-12, 1.0)) == (-123.4567890, 0.0)
    assert without_noise(1 / 3, 1.0) == without_noise(1 / 3, 1 - 1e-14) == 0.333333333
    assert (without_noise(1e-300, 0.0), without_noise(1.5, math.inf), without_noise(math.inf, 1.0)) == (
        1e-300,
        1.5,
        math.inf,
    )


def test_an_array_is_rounded_as_its_numbers(rng):
    """Random numbers of all sizes, numbers that stand on a border, and powers of ten from either side."""
    values = np.concatenate(
        [
            rng.standard_normal(2000) * 10.0 ** rng.integers(-40, 40, 2000),
            rng.integers(0, 10**7, 2000) / 10 ** rng.integers(0, 9, 2000),
            *([sign * 10.0 ** np.arange(-20, 21) * (1 + noise)] for sign in (1, -1) for noise in (0.0, 1e-15, -1e-15)),
        ],
        axis=None,
    )
    assert rounded(values).tolist() == [significant(value) for value in values]
    noise = 1 + rng.uniform(-1e-14, 1e-14, values.shape)
    assert rounded(values * noise).tolist() == rounded(values).tolist()


def test_nothing_is_kept_below_the_scale():
    """Neither a number nor a digit; a number beside nothing, or beside infinity, keeps its digits."""
    assert rounded(np.array([1.23456789e-8, 9e-10, -1e-17, 2.0]), 1.0).tolist() == [1.2e-8, 0.0, 0.0, 2.0]
    assert rounded(np.array([1.23456789e-8, 1e-30]), np.array([0.0, math.inf])).tolist() == [1.23457e-8, 1e-30]


@pytest.mark.parametrize("exponent", [-30, -5, -1, 0, 1, 3, 30])
def test_a_scale_on_a_border_is_one_scale(exponent):
    """A power of ten with rounding errors keeps as many digits as without."""
    scale = float(f"1e{exponent}")
    near = scale * np.array([1.0, 1 - 1e-15, 1 + 1e-15, 1 - 1e-13, 1 + 1e-13])
    expected = float(f"5.9130e{exponent - 5}")
    assert rounded(5.913027e-5 * scale, near).tolist() == [expected] * 5
    assert [without_noise(5.913027e-5 * scale, each) for each in near] == [expected] * 5


def test_an_array_keeps_what_is_no_finite_number():
    """Zero loses its sign; the largest and the smallest numbers stay what they are."""
    values = np.array([math.inf, -math.inf, math.nan, -0.0, 1.7e308, 5e-324])
    assert [repr(value) for value in rounded(values).tolist()] == ["inf", "-inf", "nan", "0.0", "1.7e+308", "5e-324"]
