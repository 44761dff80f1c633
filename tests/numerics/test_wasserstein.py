"""The least favourable covariance in a Wasserstein ball: a semidefinite program, closed forms and feasible points."""

import cvxpy as cp
import numpy as np
import pytest
from conftest import ROUND, SOLVER, random_psd

from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.wasserstein import (
    joint_factor,
    least_favourable,
    mean_square,
    minimax_gain,
    step_length,
    worst_for_gain,
)

EXAMPLE = np.array([[1.0, 1.0], [1.0, 1.1]])
"""Nominal covariance of [x; y] of the example of the paper."""


def best_gain(S, nx):
    """S_xy S_yy^-1."""
    return S[:nx, nx:] @ np.linalg.inv(S[nx:, nx:])


def distance(S, Sigma):
    """Wasserstein distance of two Gaussian densities with equal means."""
    root = psd_sqrt(Sigma)
    return np.sqrt(max(0.0, np.trace(S + Sigma - 2.0 * psd_sqrt(root @ S @ root))))


def by_semidefinite_program(Sigma, nx, radius):
    """Value of the saddle point: Schur complements for the error and for the distance."""
    n = len(Sigma)
    S, Q = cp.Variable((n, n), PSD=True), cp.Variable((nx, nx), symmetric=True)
    Z = cp.Variable((n, n))
    schur = cp.bmat([[S[:nx, :nx] - Q, S[:nx, nx:]], [S[nx:, :nx], S[nx:, nx:]]])
    couple = cp.bmat([[Sigma, Z], [Z.T, S]])
    limits = [schur >> 0, couple >> 0, cp.trace(S) + np.trace(Sigma) - 2.0 * cp.trace(Z) <= radius**2]
    problem = cp.Problem(cp.Maximize(cp.trace(Q)), limits)
    problem.solve(solver=cp.CLARABEL)
    return problem.value


def test_the_example_of_the_paper():
    """Oracle: S read from the figure of the public code with three decimals, 1.595, 0.818, 1.000, and the slope."""
    found = least_favourable(np.linalg.cholesky(EXAMPLE), 0.5, np.array([[1.0 / 1.1]]))
    np.testing.assert_allclose(found.S[[0, 0, 1], [0, 1, 1]], [1.595, 0.818, 1.000], rtol=0, atol=6e-4)  # fitted
    np.testing.assert_allclose(found.L, 0.8181, rtol=0, atol=6e-5)  # four decimals
    assert found.gap <= 1e-10


def test_a_full_step_cycles_on_the_example():
    """Oracle: the reference study, whose full steps end at an objective of 0.493 in place of 0.926."""
    G, L = np.linalg.cholesky(EXAMPLE), np.array([[1.0 / 1.1]])
    for _ in range(200):
        S = worst_for_gain(G, 0.5, L)
        L = best_gain(S, 1)
    np.testing.assert_allclose(mean_square(S, L), 0.493, rtol=0, atol=6e-4)
    assert abs(least_favourable(G, 0.5, L).P[0, 0] - 0.926) < 6e-4


@pytest.mark.parametrize(("nx", "ny", "radius"), [(1, 1, 0.5), (2, 1, 0.2), (3, 2, 0.4), (2, 1, 3.0)])
def test_the_value_is_that_of_a_semidefinite_program(nx, ny, radius, rng):
    """Oracle: cvxpy, also with a radius above the root of the trace, where the quasi-Newton method is used."""
    Sigma = random_psd(rng, nx + ny)
    found = least_favourable(np.linalg.cholesky(Sigma), radius, best_gain(Sigma, nx))
    np.testing.assert_allclose(np.trace(found.P), by_semidefinite_program(Sigma, nx, radius), **SOLVER)
    assert found.gap <= 1e-9


@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (2, 1), (3, 2)])
def test_no_covariance_in_the_ball_and_no_gain_is_better(nx, ny, rng):
    """Oracle: random points; S is on the sphere, has the value tr P, and its gain is the best one."""
    radius = 0.3
    for _ in range(5):
        Sigma = random_psd(rng, nx + ny)
        found = least_favourable(np.linalg.cholesky(Sigma), radius, np.zeros((nx, ny)))
        value = np.trace(found.P)
        np.testing.assert_allclose(distance(found.S, Sigma), radius, rtol=1e-5)  # the gap is 1e-10, the root of it 1e-5
        np.testing.assert_allclose(mean_square(found.S, best_gain(found.S, nx)), value, rtol=1e-9)  # the gap
        for _ in range(20):
            other = worst_for_gain(np.linalg.cholesky(Sigma), radius, rng.standard_normal((nx, ny)))
            np.testing.assert_allclose(distance(other, Sigma), radius, rtol=1e-6)  # roots of matrices
            assert mean_square(other, best_gain(other, nx)) <= value * (1 + 1e-9)
            gain = found.L + 0.1 * rng.standard_normal((nx, ny))
            assert mean_square(worst_for_gain(np.linalg.cholesky(Sigma), radius, gain), gain) >= value * (1 - 1e-9)


@pytest.mark.parametrize("radius", [0.1, 1.0, 30.0])
def test_an_output_without_information_has_a_closed_form(radius, rng):
    """Oracle: tr P = ((tr P_pred)^1/2 + radius)^2 if y does not depend on x."""
    P_pred = random_psd(rng, 3)
    G = joint_factor(np.zeros((2, 3)), np.linalg.cholesky(P_pred), np.linalg.cholesky(random_psd(rng, 2)))
    found = least_favourable(G, radius, np.zeros((3, 2)))
    np.testing.assert_allclose(np.trace(found.P), (np.sqrt(np.trace(P_pred)) + radius) ** 2, rtol=1e-9)  # the gap
    np.testing.assert_allclose(found.L, 0.0, atol=1e-12)


def test_a_state_without_nominal_error_gets_the_whole_radius():
    """Oracle: the closed form with P_pred = 0; the error has no direction, so that all states share it."""
    G = joint_factor(np.array([[1.0, -1.0]]), np.zeros((2, 2)), np.eye(1))
    found = least_favourable(G, 0.5, np.zeros((2, 1)))
    np.testing.assert_allclose(np.trace(worst_for_gain(G, 0.5, np.zeros((2, 1)))[:2, :2]), 0.25, **ROUND)
    np.testing.assert_allclose(np.trace(found.P), by_semidefinite_program(G @ G.T, 2, 0.5), rtol=1e-5)  # singular


def test_scaling_leaves_the_gain(rng):
    """Oracle: (c Sigma, c^1/2 rho) has the same gain."""
    for _ in range(5):
        G = np.linalg.cholesky(random_psd(rng, 4))
        L = best_gain(G @ G.T, 3)
        one, other = least_favourable(G, 0.3, L), least_favourable(2.0 * G, 0.6, L)
        np.testing.assert_allclose(other.L, one.L, rtol=1e-14)  # a power of two scales without rounding
        other = least_favourable(np.sqrt(7.0) * G, 0.3 * np.sqrt(7.0), L)
        np.testing.assert_allclose(other.L, one.L, rtol=1e-8, atol=1e-8)  # rounding in the quasi-Newton method


def test_the_step_maximises_the_objective(rng):
    """Oracle: the objective on a grid of 1001 points."""
    for ny in (1, 2):
        for _ in range(10):
            S, new = random_psd(rng, 3 + ny), random_psd(rng, 3 + ny)
            t = step_length(psd_sqrt(S), psd_sqrt(new), 3)
            values = [_value(S + s * (new - S)) for s in np.linspace(0.0, 1.0, 1001)]
            assert _value(S + t * (new - S)) >= max(values) - 1e-12


def _value(S):
    return mean_square(S, best_gain(S, 3))


def test_the_quasi_newton_method_finds_the_same_saddle_point(rng):
    """Oracle: Frank-Wolfe, at a radius where both converge."""
    for _ in range(5):
        G = np.linalg.cholesky(random_psd(rng, 3))
        found = least_favourable(G, 0.2, best_gain(G @ G.T, 2), 1e-14)
        L = minimax_gain(G, 0.2, best_gain(G @ G.T, 2))
        np.testing.assert_allclose(mean_square(worst_for_gain(G, 0.2, L), L), np.trace(found.P), rtol=1e-11)  # gaps
