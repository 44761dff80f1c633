"""The S against what can be said of it in closed form, and against differences."""

import numpy as np
import pytest
from scipy.integrate import quad

from rmpc_bench.numerics.s_shape import s_curve

COS, SIN = np.cos(np.pi / 8), np.sin(np.pi / 4)


def differences(order, n=80_000):
    """Times between samples and the derivative of an order, by differences, [samples, 3]."""
    t = np.linspace(0.0, 8.0, n + 1)
    return np.diff(s_curve(t), order, axis=0) / (8.0 / n) ** order


def test_where_it_starts_and_ends():
    """Oracle: f = -pi/8 and 9 pi/8; it stands still before and after."""
    ends = s_curve(np.array([-1.0, 0.0, 8.0, 9.0]))
    expected = np.array([[0.08 * SIN, 0.1 * COS, 0.0], [-0.08 * SIN, -0.1 * COS, 0.0]])
    np.testing.assert_allclose(ends[1:3], expected, atol=1e-16)
    np.testing.assert_array_equal(ends[[0, 3]], ends[[1, 2]])
    np.testing.assert_allclose(ends[1, :2], [0.0566, 0.0924], atol=5e-5)


def test_half_way_it_is_in_the_middle_and_turned_most():
    """Oracle: g = 1/2, f = pi/2; a half turn of the plane about the middle maps the S into itself, backwards."""
    np.testing.assert_allclose(s_curve(np.array([4.0])), [[0.0, 0.0, 0.2]], atol=1e-16)
    t = np.linspace(0.0, 8.0, 101)
    np.testing.assert_allclose(s_curve(8.0 - t), s_curve(t) * [-1.0, -1.0, 1.0], atol=1e-15)


def test_its_length():
    """Oracle: the integral over f, which knows nothing of time; 0.516 m."""
    length = quad(lambda f: np.hypot(0.16 * np.cos(2 * f), 0.1 * np.sin(f)), -np.pi / 8, 9 * np.pi / 8, epsrel=1e-12)[0]
    steps = np.diff(s_curve(np.linspace(0.0, 8.0, 80_001))[:, :2], axis=0)
    np.testing.assert_allclose(np.hypot(*steps.T).sum(), length, rtol=1e-7)  # chords are shorter than arcs
    assert length == pytest.approx(0.516, abs=5e-4)


def test_it_goes_from_rest_to_rest():
    """Oracle: differences; at the ends the velocity is of second order in the time, the acceleration of first."""
    for order, size in ((1, 1e-6), (2, 1e-3)):
        ends = differences(order)[[0, -1]]
        assert np.abs(ends).max() < size


def test_how_fast_it_is():
    """Oracle: differences against another program, which prints three digits."""
    np.testing.assert_allclose(np.abs(differences(1)).max(axis=0), [0.147, 0.092, 0.128], atol=6e-4)
    np.testing.assert_allclose(np.abs(differences(2, 8000)).max(axis=0), [0.236, 0.064, 0.217], atol=6e-4)
