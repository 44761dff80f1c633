"""Steady states by a damped Newton method: against closed forms, near bounds, with free coordinates."""

import numpy as np
from plants import tanks

from rmpc_bench.numerics.jacobian import find_zero
from rmpc_bench.types import Parameters

P = Parameters(tanks.PARAMETERS)
NONE = np.full(2, -np.inf), np.full(2, np.inf)


def test_two_tanks_from_any_guess():
    """Oracle: the closed form; from a guess far away full Newton steps leave the bounds."""
    exact = tanks.steady_state(8.0, tanks.PARAMETERS)
    for guess in ([0.1, 0.1], [1.9, 1e-4], [1e-4, 1.9]):
        zero = find_zero(
            lambda x: np.array(tanks.rhs(x, np.array([8.0]), P)), np.array(guess), np.zeros(2), np.full(2, 2.0)
        )
        assert zero.converged
        np.testing.assert_allclose(zero.x, exact, rtol=1e-12)


def test_damping_is_needed():
    """Newton steps of arctan diverge from 2."""
    zero = find_zero(np.arctan, np.array([2.0, -3.0]), *NONE)
    assert zero.converged
    np.testing.assert_allclose(zero.x, 0.0, atol=1e-12)


def test_a_free_coordinate_keeps_its_guess():
    """A cart may stand anywhere."""
    zero = find_zero(lambda x: np.array([np.sin(x[1]) - 0.5, 0.0 * x[0]]), np.array([0.7, 0.1]), *NONE)
    assert zero.converged
    assert zero.x[0] == 0.7
    np.testing.assert_allclose(zero.x[1], np.pi / 6, rtol=1e-12)


def test_no_zero_is_not_converged():
    """x^2 + 1 has its least value at 0; a zero beyond a bound is none."""
    assert not find_zero(lambda x: x * x + 1.0, np.array([1.0, 2.0]), *NONE).converged
    zero = find_zero(lambda x: x - 5.0, np.ones(2), np.zeros(2), np.full(2, 2.0))
    assert not zero.converged
    assert (zero.x <= 2.0).all()
    assert not find_zero(lambda x: x * np.nan, np.ones(2), *NONE).converged


def test_a_linear_system_takes_one_step(rng):
    """Two, since the second one finds nothing smaller than rounding."""
    A, b = rng.standard_normal((2, 2)), rng.standard_normal(2)
    zero = find_zero(lambda x: A @ x - b, np.zeros(2), *NONE)
    assert zero.converged
    assert zero.iterations <= 3
    np.testing.assert_allclose(zero.x, np.linalg.solve(A, b), rtol=1e-10)
