"""Jacobians by differences: against closed forms and sympy, for functions that a complex step gets wrong, and kinks."""

import math

import numpy as np
import pytest
import sympy
from plants import tanks

from rmpc_bench.numerics.jacobian import derivative, jacobian
from rmpc_bench.types import Parameters

P = Parameters(tanks.PARAMETERS)
TABLE = [0.0, 1.0, 2.0], [0.0, 1.0, 5.0]


def in_place(x):
    """Write into an array of real numbers."""
    dx = np.zeros(2)
    dx[0], dx[1] = x[0] ** 2, x[0] * x[1]
    return dx


def overwriting(x):
    """Write into the argument."""
    x[0] = x[0] ** 2
    x[1] *= x[0]
    return x


def branching(x):
    """Choose by the state."""
    return np.array([x[0] ** 3 if x[0] > 0.0 else -x[0], math.sin(float(x[1]))])


# f, x, the derivatives; a complex step gives 0 for the first six, or an error for the seventh.
CASES = {
    "abs": (lambda x: np.array([abs(x[0])]), [-2.0], [[-1.0]]),
    "norm": (lambda x: np.array([np.linalg.norm(x)]), [3.0, 4.0], [[0.6, 0.8]]),
    "interp": (lambda x: np.array([np.interp(x[0], *TABLE)]), [1.3], [[4.0]]),
    "float": (lambda x: np.array([float(x[0]) ** 2]), [3.0], [[6.0]]),
    "math": (lambda x: np.array([math.sin(x[0])]), [1.0], [[math.cos(1.0)]]),
    "in place": (in_place, [3.0, 2.0], [[6.0, 0.0], [2.0, 3.0]]),
    "arctan2": (lambda x: np.array([np.arctan2(x[0], x[1])]), [1.0, 2.0], [[0.4, -0.2]]),
    "overwritten": (overwriting, [3.0, 2.0], [[6.0, 0.0], [12.0, 9.0]]),
    "branch": (branching, [2.0, 1.0], [[12.0, 0.0], [0.0, math.cos(1.0)]]),
    "small": (lambda x: np.sqrt(x), [1e-6], [[500.0]]),
    "large": (lambda x: x**3, [1e6], [[3e12]]),
    "zero": (lambda x: np.sin(x), [0.0], [[1.0]]),
    # A pressure and a flow: the steps of one must not have the size of the other.
    "units": (lambda x: np.array([x[0] - 1e13 * x[1] * abs(x[1]), 0.0]), [1e5, 1e-4], [[1.0, -2e9], [0.0, 0.0]]),
    # Quadratic friction at rest has a derivative, although its second derivative has a jump.
    "at rest": (lambda x: np.array([x[1] - 0.8 * x[0] * abs(x[0])]), [0.0, 0.0], [[0.0, 1.0]]),
}


@pytest.mark.parametrize("name", CASES)
def test_functions_as_users_write_them(name):
    """Oracle: closed forms."""
    function, x, exact = CASES[name]
    found = derivative(function, np.array(x))
    # Fourth order in a step of 7e-4.
    np.testing.assert_allclose(found.J, exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())
    assert found.kinks == ()


def test_two_tanks_have_ten_digits():
    """Oracle: the closed form at the steady state."""
    x = np.array(tanks.steady_state(8.0, tanks.PARAMETERS))
    found = derivative(lambda z: np.array(tanks.rhs(z, np.array([8.0]), P)), x)
    flow = [P[name] / tanks.S1 * math.sqrt(tanks.G / (2 * h)) for name, h in zip(("a1", "a2"), x, strict=True)]
    exact = np.array([[-flow[0], 0.0], [flow[0], -flow[1]]])
    np.testing.assert_allclose(found.J, exact, rtol=1e-10, atol=1e-14)
    assert found.kinks == ()


def test_a_pendulum_agrees_with_symbolic_derivatives(rng):
    """Oracle: sympy."""
    s = sympy.symbols("s v a w f")
    M, m, length, g = 0.5, 0.2, 0.3, 9.81
    sin, cos = sympy.sin(s[2]), sympy.cos(s[2])
    acceleration = (s[4] + m * sin * (length * s[3] ** 2 - g * cos)) / (M + m * sin**2)
    exact = sympy.Matrix([s[1], acceleration, s[3], (g * sin - cos * acceleration) / length])
    function, J = (sympy.lambdify([s], each, "numpy") for each in (exact, exact.jacobian(s)))
    for _ in range(3):
        x = rng.standard_normal(5)
        found = derivative(lambda z: np.array(function(z), dtype=float).ravel(), x)
        np.testing.assert_allclose(found.J, np.array(J(x), dtype=float), rtol=1e-9, atol=1e-9)
        assert found.kinks == ()


@pytest.mark.parametrize("x", [0.0, 1e-9, -1e-9])
def test_a_kink_is_named(x):
    """The central difference of |x| at 0 is 0 and looks harmless."""
    found = derivative(lambda z: np.array([z[0] + abs(z[1]), z[0]]), np.array([0.5, x]))
    assert found.kinks == (1,)


def test_a_kink_of_a_table_is_named():
    """At a point of the table, and not between two."""
    f = lambda z: np.array([np.interp(z[0], *TABLE)])  # noqa: E731
    assert derivative(f, np.array([1.0])).kinks == (0,)
    assert derivative(f, np.array([1.01])).kinks == ()


def test_a_near_kink_is_named():
    """The wide steps of the central difference meet it, those of the one-sided differences do not."""
    assert derivative(lambda z: np.abs(z - 1.0003), np.array([1.0])).kinks == (0,)


def test_no_coordinates_and_undefined_points():
    """A function without arguments has no columns; at the edge of its domain a derivative is NaN."""
    assert jacobian(lambda z: np.array([1.0, 2.0]), np.zeros(0)).shape == (2, 0)
    with np.errstate(invalid="ignore"):
        assert np.isnan(jacobian(np.sqrt, np.array([0.0]))).all()
