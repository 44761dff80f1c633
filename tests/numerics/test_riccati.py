"""One Riccati step against the paper's formulas and the steady state of SciPy."""

import numpy as np
import pytest
from conftest import random_model, random_psd
from scipy.linalg import solve_discrete_are

from rmpc_bench.numerics.riccati import filter_step


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (4, 1), (3, 2), (2, 3)])
def test_the_step_is_the_papers(nx, ny, rng):
    """Oracle: (7), (8) of zenere2018 written out with an explicit inverse."""
    m = random_model(rng, nx, 1, ny)
    V = random_psd(rng, nx)
    step = filter_step(m.A, m.C, m.Q_w, m.R_v, V)
    S = m.C @ V @ m.C.T + m.R_v
    L = V @ m.C.T @ np.linalg.inv(S)
    np.testing.assert_allclose(step.L, L, atol=1e-12)
    np.testing.assert_allclose(step.K, m.A @ L, atol=1e-12)
    np.testing.assert_allclose(step.P, V - L @ S @ L.T, atol=1e-12)
    np.testing.assert_allclose(step.P_next, m.A @ V @ m.A.T - m.A @ L @ S @ L.T @ m.A.T + m.Q_w, atol=1e-12)


@pytest.mark.parametrize("condition", [1e2, 1e8, 1e14])
def test_covariances_stay_symmetric_and_semidefinite(condition, rng):
    """Oracle: the property, where V - L S L' would lose it by cancellation (precise sensor, ill-conditioned V)."""
    m = random_model(rng, 4, 1, 2)
    for _ in range(20):
        step = filter_step(m.A, m.C, m.Q_w, 1e-10 * np.eye(2), random_psd(rng, 4, condition))
        for P in (step.P, step.P_next):
            np.testing.assert_array_equal(P, P.T)
            assert np.linalg.eigvalsh(P)[0] >= -4 * np.finfo(float).eps * np.linalg.norm(P)  # rounding of eigvalsh


@pytest.mark.parametrize("radius", [0.5, 0.95, 1.1])
def test_the_steady_step_solves_the_algebraic_equation(radius, rng):
    """Oracle: scipy.linalg.solve_discrete_are, for an unstable model too."""
    m = random_model(rng, 3, 1, 2, radius)
    P = np.eye(3)
    for _ in range(500):
        P = filter_step(m.A, m.C, m.Q_w, m.R_v, P).P_next
    np.testing.assert_allclose(P, solve_discrete_are(m.A.T, m.C.T, m.Q_w, m.R_v), rtol=1e-9)


def test_a_singular_innovation_is_an_error():
    """Oracle: no noise at all makes C V C' + R_v = 0."""
    with pytest.raises(np.linalg.LinAlgError):
        filter_step(np.eye(2), np.eye(2)[:1], np.zeros((2, 2)), np.zeros((1, 1)), np.zeros((2, 2)))
