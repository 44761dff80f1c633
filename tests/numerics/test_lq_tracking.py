"""Steady states and gains with integrals: linear systems, constrained least squares, python-control."""

import numpy as np
import pytest
from conftest import random_model, random_psd

from rmpc_bench.numerics.lq_tracking import integral_gain, steady_map, steady_rank

SOLVED = {"rtol": 1e-9, "atol": 1e-10}
"""Linear systems with conditions up to 1e4."""


@pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (4, 2, 2), (3, 3, 1), (2, 3, 2)])
def test_a_steady_state_satisfies_its_equations(rng, nx, nu, ny):
    """Oracle: the equations; of several, no other one has less u' R u (the condition of Lagrange)."""
    m, R = random_model(rng, nx, nu, ny), random_psd(rng, nu)
    T, f, z = steady_map(m.A, m.B, m.C, R), rng.standard_normal(nx), rng.standard_normal(ny)
    x, u = np.split(T @ np.concatenate([f, z]), [nx])
    np.testing.assert_allclose(m.A @ x + m.B @ u + f, x, **SOLVED)
    np.testing.assert_allclose(m.C @ x, z, **SOLVED)
    # Bordered system: minimise u' R u subject to the equations; x has no weight of its own.
    M = np.block([[m.A - np.eye(nx), m.B], [m.C, np.zeros((ny, nu))]])
    W = np.zeros((nx + nu, nx + nu))
    W[nx:, nx:] = R
    bordered = np.block([[W, M.T], [M, np.zeros((len(M), len(M)))]])
    right = np.concatenate([np.zeros(nx + nu), -f, z])
    expected = np.linalg.lstsq(bordered, right, rcond=None)[0][nx : nx + nu]
    np.testing.assert_allclose(u, expected, rtol=1e-7, atol=1e-8)


def test_rank_of_a_zero_at_one():
    """(z - 1) / (z^2 - 0.9 z + 0.2) holds no output but 0; a zero at 0.99 does, in any units."""
    A, B = np.array([[0.9, -0.2], [1.0, 0.0]]), np.array([[1.0], [0.0]])
    units = np.diag([1e6, 1e-5])
    scaled, driven = units @ A @ np.linalg.inv(units), units @ B * 1e4
    for zero, rank in ((1.0, 2), (0.99, 3)):
        C = np.array([[1.0, -zero]])
        assert steady_rank(A, B, C) == (rank, 3)
        assert steady_rank(scaled, driven, 1e-3 * C @ np.linalg.inv(units)) == (rank, 3)


def test_more_outputs_than_inputs_have_no_steady_state(rng):
    """Oracle: the number of unknowns."""
    m = random_model(rng, 3, 1, 2)
    assert steady_rank(m.A, m.B, m.C) == (4, 5)


@pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (4, 2, 2), (3, 2, 1)])
def test_integral_gain(rng, nx, nu, ny):
    """Oracle: python-control's dlqr of the augmented model, and its closed-loop eigenvalues."""
    control = pytest.importorskip("control")
    m = random_model(rng, nx, nu, ny, 1.1)
    Q_x, Q_i, R = random_psd(rng, nx), random_psd(rng, ny), random_psd(rng, nu)
    found = integral_gain(m.A, m.B, m.C, Q_x, Q_i, R)
    A = np.block([[m.A, np.zeros((nx, ny))], [m.C, np.eye(ny)]])
    B, Q = np.vstack([m.B, np.zeros((ny, nu))]), np.zeros((nx + ny, nx + ny))
    Q[:nx, :nx], Q[nx:, nx:] = Q_x, Q_i
    K, P, poles = control.dlqr(A, B, Q, R, method="scipy")
    np.testing.assert_allclose(np.hstack([found.K_x, found.K_q]), K, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.P, P, rtol=1e-8, atol=1e-10)
    ours = np.linalg.eigvals(A - B @ np.hstack([found.K_x, found.K_q]))
    np.testing.assert_allclose(np.sort_complex(ours), np.sort_complex(poles), rtol=1e-7, atol=1e-9)


def test_a_mode_that_no_input_controls_has_no_gain():
    """Oracle: the sum of an output that no input can reach."""
    A, B = np.diag([0.5, 0.6]), np.array([[1.0], [0.0]])
    with pytest.raises(np.linalg.LinAlgError):
        integral_gain(A, B, np.array([[0.0, 1.0]]), np.eye(2), np.eye(1), np.eye(1))
