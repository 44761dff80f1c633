"""Responses over a horizon, and unknowns of unit curvature."""

import daqp
import numpy as np
from conftest import ROUND
from controllers.gpc_twin import dense

from rmpc_bench.numerics.condensed import residuals, responses, unit_rows
from rmpc_bench.numerics.qp import QuadraticProgram


def system(rng, nx=3, nu=2, ny=2):
    """A random model with a constant part and roots of weights."""
    A, B, C = (rng.standard_normal(shape) for shape in ((nx, nx), (nx, nu), (ny, nx)))
    return 0.5 * A, B, rng.standard_normal(nx), C, rng.standard_normal((ny, ny)), np.eye(nu) + 0.1


def test_responses_are_the_simulated_states(rng):
    """Oracle: the model, step by step."""
    A, B, f, *_ = system(rng)
    found, x, U = responses(A, B, f, 6), rng.standard_normal(3), rng.standard_normal((6, 2))
    now = x
    for j in range(6):
        now = A @ now + B @ U[j] + f
        ours = found.Psi[j] @ x + found.held[j] + np.einsum("mnu,nu->m", found.Theta[j], U)
        np.testing.assert_allclose(ours, now, **ROUND)


def test_residuals_have_the_minimum_of_the_stacked_system(rng):
    """Oracle: (12), filled entry by entry, by lstsq."""
    A, B, f, C, Q_yw, Q_u = system(rng)
    x, w, found = rng.standard_normal(3), rng.standard_normal((6, 2)), responses(A, B, f, 6)
    free = np.array([Q_yw @ (w[j] - C @ (found.Psi[j] @ x + found.held[j])) for j in range(6)])
    b = np.concatenate([free.ravel(), np.zeros(12)])
    U = np.linalg.lstsq(residuals(found.Theta, C, Q_yw, Q_u), b, rcond=None)[0]
    np.testing.assert_allclose(U[:2], dense(A, B, f, C, Q_yw, Q_u, w, x)[0], rtol=1e-9, atol=1e-11)


def test_unit_rows_are_the_rows_in_the_new_unknowns(rng):
    """Oracle: the definition V = g R U; the longest row has the length 1, whatever the size of the cost is."""
    a, R, U = (
        rng.standard_normal((5, 4)),
        np.triu(rng.standard_normal((4, 4))) + 3.0 * np.eye(4),
        rng.standard_normal(4),
    )
    for size in (1.0, 1e-8, 1e8):
        rows, inverse, g = unit_rows(a, size * R)
        V = g * size * R @ U
        np.testing.assert_allclose(rows @ V, a @ U, **ROUND)
        np.testing.assert_allclose(inverse @ V, U, **ROUND)
        np.testing.assert_allclose(np.linalg.norm(rows, axis=1).max(), 1.0, **ROUND)
    assert unit_rows(np.zeros((0, 4)), R)[2] == 1.0


def test_the_size_of_the_cost_has_no_effect(rng):
    """The naive form, the cost as it is: the solver ends early for a small one, and calls a wrong point the minimum.

    Oracle: the same problem with a cost of size 1.
    """
    naive, ours = [], []
    for _ in range(50):
        R, free = np.triu(rng.standard_normal((6, 6))) + 3.0 * np.eye(6), rng.standard_normal(6)
        low, high = np.full(6, -0.3), np.full(6, 0.3)
        expected = QuadraticProgram(R.T @ R, np.eye(6)).solve(-R.T @ R @ free, low, high).x
        H = 1e-12 * R.T @ R
        x, _, flag, _ = daqp.solve(H, -H @ free, np.eye(6), high, low, np.zeros(6, dtype=np.int32))
        assert flag == 1
        naive.append(x - expected)
        rows, inverse, _ = unit_rows(np.eye(6), 1e-6 * R)
        found = QuadraticProgram(np.eye(6), rows).solve(np.zeros(6), low - free, high - free)
        ours.append(free + inverse @ found.x - expected)
    assert np.abs(ours).max() < 1e-9
    assert np.abs(naive).max() > 1e-2
