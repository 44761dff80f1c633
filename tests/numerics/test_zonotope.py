"""Zonotopes against vertices: all corners of the cube of the generators, and hulls by SciPy."""

from itertools import product

import numpy as np
import pytest
from conftest import ROUND
from scipy.spatial import ConvexHull

from rmpc_bench.numerics.zonotope import Zonotope, box, reached, robust_invariant

A_K = np.array([[0.66957340, 0.33697030], [-0.66085320, -0.32605933]])
"""Closed loop of the example of Mayne, Seron and Rakovic (2005), K to eight digits."""


def corners(zonotope):
    """Return G e of every e with entries -1 and 1; their hull is the set."""
    G = zonotope.generators
    return np.array(list(product([-1.0, 1.0], repeat=G.shape[1]))) @ G.T


@pytest.fixture(params=[(1, 3), (2, 2), (2, 7), (3, 6)], ids=str)
def zonotope(request):
    """Return a random set of some dimension and number of generators."""
    return Zonotope(np.random.default_rng(4).standard_normal(request.param))


def test_support_and_half_widths(zonotope):
    """Oracle: the largest product over all corners."""
    points, n = corners(zonotope), len(zonotope.generators)
    directions = np.random.default_rng(5).standard_normal((20, n))
    np.testing.assert_allclose(zonotope.support(directions), (directions @ points.T).max(axis=1), **ROUND)
    np.testing.assert_allclose(zonotope.half_widths, points.max(axis=0), **ROUND)


def test_map_sum_and_scale(zonotope):
    """Oracle: the corners of the set, mapped, and all sums of corners of two sets."""
    n = len(zonotope.generators)
    M, other = np.random.default_rng(6).standard_normal((2, n)), box(np.arange(1.0, n + 1.0))
    directions = np.random.default_rng(7).standard_normal((20, 2))
    mapped = 3.0 * corners(zonotope) @ M.T
    np.testing.assert_allclose(
        zonotope.mapped(M).scaled(3.0).support(directions), (directions @ mapped.T).max(axis=1), **ROUND
    )
    sums = (corners(zonotope)[:, None] + corners(other)[None]).reshape(-1, n)
    axes = np.random.default_rng(8).standard_normal((20, n))
    np.testing.assert_allclose((zonotope + other).support(axes), (axes @ sums.T).max(axis=1), **ROUND)


@pytest.mark.parametrize("size", [(2, 4), (2, 9), (3, 6), (4, 6)], ids=str)
def test_facets(size):
    """Oracle: the facets of the hull of the corners, in pairs, each with all corners on one side."""
    zonotope = Zonotope(np.random.default_rng(9).standard_normal(size))
    points, (normals, bounds) = corners(zonotope), zonotope.facets()
    np.testing.assert_allclose((points @ normals.T).max(axis=0), bounds, **ROUND)
    hull = {tuple(np.round(each, 8)) for each in ConvexHull(points).equations[:, :-1]}
    ours = {tuple(np.round(sign * each, 8)) for each in normals for sign in (1.0, -1.0)}
    assert len(normals) <= zonotope.most_facets()
    assert hull == ours


def test_parallel_generators_have_one_facet():
    """Oracle: a rectangle of half widths 3 and 1, also with a generator of length 0."""
    found = Zonotope(np.array([[1.0, 2.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]])).facets()
    assert sorted(zip(np.abs(found.normals).round(12).tolist(), found.bounds.tolist(), strict=True)) == [
        ([0.0, 1.0], 1.0),
        ([1.0, 0.0], 3.0),
    ]


def test_a_set_without_interior_has_no_facets():
    """Oracle: two parallel generators span a segment."""
    with pytest.raises(ValueError, match="no interior"):
        Zonotope(np.array([[1.0, 2.0], [1.0, 2.0]])).facets()


@pytest.mark.parametrize("m", [2, 3, 8])
def test_area_and_outline(m):
    """Oracle: hull of the corners; the outline is counterclockwise and has the same hull."""
    zonotope = Zonotope(np.random.default_rng(m).standard_normal((2, m)))
    hull, outline = ConvexHull(corners(zonotope)), zonotope.outline()
    np.testing.assert_allclose(zonotope.area, hull.volume, **ROUND)
    x, y = outline.T
    shoelace = 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()
    np.testing.assert_allclose(shoelace, hull.volume, **ROUND)
    with pytest.raises(ValueError, match="3 dimensions"):
        _ = box([1.0, 1.0, 1.0]).area


def test_reached_states():
    """Oracle: the largest state over all corner noises of four steps."""
    noises = np.array(list(product([-0.1, 0.1], repeat=8))).reshape(-1, 4, 2)
    x = np.zeros((len(noises), 2))
    for step in range(4):
        x = x @ A_K.T + noises[:, step]
    np.testing.assert_allclose(reached(A_K, box([0.1, 0.1]), 4).half_widths, np.abs(x).max(axis=0), **ROUND)
    assert reached(A_K, box([0.1, 0.1]), 0).half_widths.tolist() == [0.0, 0.0]


def test_robust_invariant_set_contains_its_successors_and_the_minimal_set():
    """Oracle: A_K Z + W inside Z in every direction of a facet, which the sum without the factor violates."""
    W = box([0.1, 0.1])
    found = robust_invariant(A_K, np.array([0.1, 0.1]), 1e-5)
    normals, bounds = found.set.facets()
    after = (found.set.mapped(A_K) + W).support(normals)
    assert (after <= bounds + 1e-15).all()
    # The naive form, the finite sum alone, is left by the next noise.
    naive = reached(A_K, W, found.terms)
    assert ((naive.mapped(A_K) + W).support(normals) > naive.support(normals) + 1e-9).any()
    assert (reached(A_K, W, 200).support(normals) <= bounds).all()


def test_robust_invariant_set_of_unequal_noises():
    """Oracle: the definition of alpha by the half widths of A^s W."""
    half_widths = np.array([1.0, 1e-3])
    found = robust_invariant(A_K, half_widths, 0.1)
    widths = [box(half_widths).mapped(np.linalg.matrix_power(A_K, s)).half_widths for s in range(found.terms + 1)]
    alphas = [float((each / half_widths).max()) for each in widths]
    np.testing.assert_allclose(found.alpha, alphas[-1], **ROUND)
    assert found.alpha <= 0.1 < min(alphas[:-1])
    assert found.set.generators.shape == (2, 2 * found.terms)


def test_a_slow_system_needs_too_many_terms():
    """Oracle: 0.99^10 is above 0.1."""
    with pytest.raises(ValueError, match="10 terms do not reach alpha = 0.1"):
        robust_invariant(np.array([[0.99]]), np.array([1.0]), 0.1, most_terms=10)
