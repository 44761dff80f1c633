"""The search for the worst noise, against enumeration and in cases with a closed form."""

from itertools import product

import numpy as np
import pytest
from conftest import ROUND
from controllers import minimax_oracles as oracles

from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.lq_windows import Stages, worst_cost


def cost(stages, U, x, noise):
    """Cost of one sequence of noise, e first, by simulation."""
    now, total = x + noise[0], 0.0
    for t in range(len(U)):
        now = stages.A[t] @ now + stages.B[t] @ U[t] + noise[t + 1]
        total += now @ stages.Q[t] @ now + U[t] @ stages.R[t] @ U[t]
    return total


@pytest.mark.parametrize("seed", range(5))
def test_scalar_noise_by_enumeration(seed):
    """Oracle: a convex function has its maximum at an end of every interval; all 2^6 of them."""
    rng = np.random.default_rng(seed)
    stages = oracles.random_stages(rng, 1, 1, 5)
    U, x, sets = rng.standard_normal((5, 1)), rng.standard_normal(1), rng.uniform(0.1, 2.0, 6)
    ends = (np.array(signs)[:, None] * np.sqrt(sets)[:, None] for signs in product((-1.0, 1.0), repeat=6))
    expected = max(cost(stages, U, x, noise) for noise in ends)
    ours = worst_cost(stages, U, x, np.sqrt(sets[0]) * np.eye(1), np.sqrt(sets[1:, None, None]), 40)
    np.testing.assert_allclose(ours, expected, **ROUND)


def test_one_ellipsoid_from_zero():
    """Oracle: for x = 0, U = 0 and no w it is the largest eigenvalue of the error's map."""
    rng = np.random.default_rng(8)
    stages = oracles.random_stages(rng, 3, 1, 4)
    M, _ = oracles.random_sets(rng, 3, 1)
    root, C = psd_sqrt(M[None])[0], oracles.matrices(stages).C[:3, :3]
    ours = worst_cost(stages, np.zeros((4, 1)), np.zeros(3), root, np.zeros((4, 3, 3)), 10)
    np.testing.assert_allclose(ours, np.linalg.eigvalsh(root @ C @ root)[-1], rtol=1e-9)  # power steps stop at 1e-13


def test_random_noise_is_never_worse():
    """Oracle: 20,000 points of the ellipsoids; the search contains its starts."""
    rng = np.random.default_rng(9)
    stages = oracles.random_stages(rng, 2, 1, 3)
    M, M_w = oracles.random_sets(rng, 2, 3)
    U, x, maps = rng.standard_normal((3, 1)), rng.standard_normal(2), psd_sqrt(np.array([M, *M_w]))
    ours = worst_cost(stages, U, x, maps[0], maps[1:], 40)
    z = rng.standard_normal((20_000, 4, 2))
    points = np.einsum("tij,btj->bti", maps, z / np.linalg.norm(z, axis=2, keepdims=True))
    sampled = max(cost(stages, U, x, noise) for noise in points)
    assert sampled <= ours <= 1.1 * sampled


def test_noise_in_one_ellipsoid():
    """Oracle: for x = 0, U = 0 and no e it is the largest eigenvalue of the map of all w; each in its own is worse."""
    rng = np.random.default_rng(10)
    stages = oracles.random_stages(rng, 2, 1, 4)
    _, M_w = oracles.random_sets(rng, 2, 4)
    roots, U, x = psd_sqrt(np.array(M_w)), np.zeros((4, 1)), np.zeros(2)
    C = oracles.matrices(stages).C[2:, 2:]
    root = np.zeros((8, 8))
    for t, each in enumerate(roots):
        root[2 * t : 2 * t + 2, 2 * t : 2 * t + 2] = each
    together = worst_cost(stages, U, x, np.zeros((2, 2)), roots, 10, shared=True)
    np.testing.assert_allclose(together, np.linalg.eigvalsh(root @ C @ root)[-1], rtol=1e-9)  # as above
    assert together < worst_cost(stages, U, x, np.zeros((2, 2)), roots, 10)


def test_no_noise():
    """Oracle: the cost of the controls alone."""
    rng = np.random.default_rng(10)
    stages: Stages = oracles.random_stages(rng, 2, 1, 3)
    U, x = rng.standard_normal((3, 1)), rng.standard_normal(2)
    ours = worst_cost(stages, U, x, np.zeros((2, 2)), np.zeros((3, 2, 2)), 2)
    np.testing.assert_allclose(ours, cost(stages, U, x, np.zeros((4, 2))), **ROUND)
