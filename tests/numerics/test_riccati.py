"""One Riccati step against the paper's formulas and the steady state of SciPy."""

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd
from scipy.linalg import solve_discrete_are

from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.riccati import (
    error_map,
    error_radius,
    filter_step,
    predictor_step,
)
from rmpc_bench.numerics.square_root import conditional, covariance_of


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (4, 1), (3, 2), (2, 3)])
def test_the_step_is_the_papers(nx, ny, rng):
    """Oracle: (7), (8) of zenere2018 written out with an explicit inverse."""
    m = random_model(rng, nx, 1, ny)
    V = random_psd(rng, nx)
    step = filter_step(m.A, m.C, m.Q_w, m.R_v, psd_sqrt(V))
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
        step = filter_step(m.A, m.C, m.Q_w, 1e-10 * np.eye(2), psd_sqrt(random_psd(rng, 4, condition)))
        for P in (step.P, step.P_next):
            np.testing.assert_array_equal(P, P.T)
            assert np.linalg.eigvalsh(P)[0] >= -4 * np.finfo(float).eps * np.linalg.norm(P)  # rounding of eigvalsh


@pytest.mark.parametrize("radius", [0.5, 0.95, 1.1])
def test_the_steady_step_solves_the_algebraic_equation(radius, rng):
    """Oracle: scipy.linalg.solve_discrete_are, for an unstable model too."""
    m = random_model(rng, 3, 1, 2, radius)
    P = np.eye(3)
    for _ in range(500):
        P = filter_step(m.A, m.C, m.Q_w, m.R_v, psd_sqrt(P)).P_next
    np.testing.assert_allclose(P, solve_discrete_are(m.A.T, m.C.T, m.Q_w, m.R_v), rtol=1e-9)


def test_a_singular_innovation_is_an_error():
    """Oracle: no noise at all makes C V C' + R_v = 0."""
    with pytest.raises(np.linalg.LinAlgError):
        filter_step(np.eye(2), np.eye(2)[:1], np.zeros((2, 2)), np.zeros((1, 1)), np.zeros((2, 2)))


def test_one_perfect_sensor_of_nothing_is_an_error_too():
    """Oracle: as above with one output, which is divided by instead of solved for, and with two."""
    for ny in (1, 2):
        with pytest.raises(np.linalg.LinAlgError):
            filter_step(np.eye(2), np.zeros((ny, 2)), np.eye(2), np.zeros((ny, ny)), np.eye(2))


def test_the_radius_of_the_error_is_that_of_each_matrix(rng):
    """Oracle: a loop; with a constant model and gains over time, and with constant gains; by hand for one state."""
    A, C, K = rng.standard_normal((1, 3, 3)), rng.standard_normal((1, 2, 3)), rng.standard_normal((5, 3, 2))
    each = [np.abs(np.linalg.eigvals(A[0] - gain @ C[0])).max() for gain in K]
    np.testing.assert_allclose(error_radius(A, K, C), each, **ROUND)
    assert error_radius(A, K[:1], C).shape == (1,)
    one = error_radius(np.array([[[0.5]]]), np.array([[[2.0]], [[0.0]]]), np.array([[[1.0]]]))
    np.testing.assert_array_equal(one, [1.5, 0.5])


def joint_noise(rng, nx, ny):
    """Random covariance of two correlated noises."""
    return random_psd(rng, nx + ny)


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (4, 1), (3, 2), (2, 3)])
def test_the_predictor_step_is_the_textbooks(nx, ny, rng):
    """Oracle: the gain and the Riccati equation with correlated noises, written out with an explicit inverse."""
    m, J, P = random_model(rng, nx, 1, ny), joint_noise(rng, nx, ny), random_psd(rng, nx)
    Q, S, R = J[:nx, :nx], J[:nx, nx:], J[nx:, nx:]
    step = predictor_step(np.vstack([m.A, m.C]), J, psd_sqrt(P))
    Y = m.C @ P @ m.C.T + R
    K = (m.A @ P @ m.C.T + S) @ np.linalg.inv(Y)
    np.testing.assert_allclose(step.K, K, atol=1e-11)
    np.testing.assert_allclose(step.P_next, m.A @ P @ m.A.T + Q - K @ Y @ K.T, atol=1e-11)
    np.testing.assert_array_equal(step.P_next, step.P_next.T)
    np.testing.assert_array_equal(error_map(K), np.hstack([np.eye(nx), -K]))


def test_the_steady_predictor_solves_the_algebraic_equation(rng):
    """Oracle: scipy.linalg.solve_discrete_are with a cross term."""
    m, J, P = random_model(rng, 3, 1, 2), joint_noise(rng, 3, 2), np.eye(3)
    for _ in range(500):
        P = predictor_step(np.vstack([m.A, m.C]), J, psd_sqrt(P)).P_next
    np.testing.assert_allclose(P, solve_discrete_are(m.A.T, m.C.T, J[:3, :3], J[3:, 3:], s=J[:3, 3:]), rtol=1e-9)


def test_a_predictor_of_a_perfectly_known_output_learns_nothing_from_it(rng):
    """Oracle: by hand; the innovation is 0, so that K = 0 and P+ = A P A' + Q."""
    m, J = random_model(rng, 3, 1, 1), np.zeros((4, 4))
    J[:3, :3] = random_psd(rng, 3)
    step = predictor_step(np.vstack([m.A, m.C]), J, np.zeros((3, 3)))
    np.testing.assert_array_equal(step.K, np.zeros((3, 1)))
    np.testing.assert_allclose(step.P_next, J[:3, :3], **ROUND)


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
def test_redundant_sensors_share_their_gain(unit, rng):
    """Oracle: one sensor alone, whatever the unit of its twin; K y is the same for measurements that agree."""
    N = rng.standard_normal((3, 3))
    C, scale = rng.standard_normal((1, 3)), np.array([[1.0], [unit]])
    once = conditional(C, N).gain
    twice = conditional(scale @ C, N)
    np.testing.assert_allclose(twice.gain @ scale, once, rtol=1e-12)
    assert not twice.regular
    np.testing.assert_allclose(covariance_of(twice.root), covariance_of(N - once @ C), **ROUND, atol=1e-14)


def test_a_precise_sensor_beside_a_poor_one_is_not_taken_for_singular():
    """Oracle: by hand; variances 1e-18 and 1 apart."""
    found = conditional(np.diag([1e-9, 1.0]), np.array([[1e-9, 0.5]]))
    np.testing.assert_allclose(found.gain, [[1.0, 0.5]], **ROUND)
    assert found.regular


def test_an_unmeasured_step_is_a_step_without_information(rng):
    """Oracle: a measurement of nothing, C = 0, by the usual step; with the C of a sensor that says nothing."""
    A, C, Q_w, V = rng.standard_normal((3, 3)), rng.standard_normal((2, 3)), random_psd(rng, 3), random_psd(rng, 3)
    ours = filter_step(A, C, Q_w, np.eye(2), psd_sqrt(V), measured=False)
    theirs = filter_step(A, np.zeros((2, 3)), Q_w, np.eye(2), psd_sqrt(V))
    np.testing.assert_array_equal(ours.K, theirs.K)
    for name in ("P", "P_next"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), **ROUND)
