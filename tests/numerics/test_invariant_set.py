"""Largest invariant sets against brute force over many steps, and hulls by SciPy."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, HalfspaceIntersection

from rmpc_bench.numerics.stability import spectral_radius
from rmpc_bench.numerics.zonotope import irredundant, largest_invariant

STEPS = 200
"""Steps after which a state of the systems below is 0 up to rounding."""


def stable(rng, n):
    """Return a random matrix with spectral radius 0.9."""
    A = rng.standard_normal((n, n))
    return 0.9 * A / spectral_radius(A)


def falling(b, b_inf, rate=0.7):
    """Return bounds that fall from b to b_inf."""
    return lambda t: b_inf + (b - b_inf) * rate**t


def admissible(A, H, bounds, x):
    """Say which rows of x keep all limits over many steps."""
    kept = np.ones(len(x), dtype=bool)
    for t in range(STEPS):
        kept &= (x @ H.T <= bounds(t)).all(axis=1)
        x = x @ A.T
    return kept


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("tightens", [False, True])
def test_states_of_the_set_and_no_others_keep_the_limits(n, tightens):
    """Oracle: simulation of random states over 200 steps."""
    rng = np.random.default_rng(n)
    A, H = stable(rng, n), np.vstack([rng.standard_normal((n, n)), -rng.standard_normal((n, n))])
    b = rng.uniform(0.5, 2.0, len(H))
    b_inf = 0.6 * b if tightens else b
    bounds = falling(b, b_inf)
    found = largest_invariant(A, H, bounds, b_inf)
    x = rng.standard_normal((20_000, n))
    inside = (x @ found.H.T <= found.b).all(axis=1)
    assert 50 < inside.sum() < len(x) - 50
    np.testing.assert_array_equal(inside, admissible(A, H, bounds, x))


def test_rows_of_the_limits_alone_are_not_enough():
    """Trap: a rotation leaves a box at its corners, so that the naive set, H x <= b, is not invariant."""
    A, H, b = 0.95 * np.array([[0.8, -0.6], [0.6, 0.8]]), np.vstack([np.eye(2), -np.eye(2)]), np.ones(4)
    corner = np.array([0.99, -0.99])
    assert (H @ corner <= b).all()
    assert (H @ A @ corner > b).any()
    found = largest_invariant(A, H, lambda t: b, b)
    assert (found.H @ corner > found.b).any()
    hull = ConvexHull(HalfspaceIntersection(np.c_[found.H, -found.b], np.zeros(2)).intersections)
    # Every vertex moves into the set.
    moved = hull.points @ A.T
    assert (moved @ found.H.T <= found.b + 1e-12).all()
    assert len(hull.vertices) == len(found.H)


def test_redundant_rows_are_left_out():
    """Oracle: a square, with a row that touches a corner, one outside it, and a row twice."""
    H = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, 1.0], [1.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    b = np.array([1.0, 1.0, 1.0, 1.0, 2.0, 5.0, 1.0, 1.5])
    assert irredundant(H, b) == [0, 1, 2, 3, 7]


def test_a_set_that_is_not_bounded():
    """Oracle: a limit on the first of two states that do not affect each other."""
    H, b = np.array([[1.0, 0.0]]), np.array([2.0])
    found = largest_invariant(np.diag([0.5, 0.9]), H, lambda t: b, b)
    np.testing.assert_allclose(found.H / found.b[:, None], [[0.5, 0.0]])
    assert found.steps == 0


def test_states_of_very_different_sizes():
    """Oracle: the same set in other units; the linear programs need entries of size 1."""
    rng = np.random.default_rng(3)
    A, H, b = stable(rng, 2), np.vstack([np.eye(2), -np.eye(2)]), np.ones(4)
    units = np.array([1e-6, 1e5])
    plain = largest_invariant(A, H, lambda t: b, b)
    scaled = largest_invariant(A * units[:, None] / units, H / units, lambda t: b, b)
    np.testing.assert_allclose(scaled.H * units, plain.H, rtol=1e-9, atol=1e-12)


def test_zero_must_be_inside():
    """Oracle: the message."""
    with pytest.raises(ValueError, match="must be inside all limits"):
        largest_invariant(np.array([[0.5]]), np.array([[1.0]]), lambda t: np.ones(1), np.array([-0.1]))
