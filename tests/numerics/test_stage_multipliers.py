"""One price per stage against the semidefinite program with N + 1 multipliers, and where one price would do."""

import numpy as np
import pytest
from conftest import ROUND, SOLVER
from controllers import minimax_oracles as oracles

from rmpc_bench.controllers.state_feedback import game_of
from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.lq_game import plan, solve
from rmpc_bench.numerics.stage_multipliers import GAP, make_form, search, solve_stages


def case(kind, seed, N=4):
    """A random system that varies, n = 2, 3, 4 and r = 1, 2, with something special."""
    rng = np.random.default_rng(seed)
    n, r = 2 + seed % 3, 1 + seed % 2
    stages, (M, M_w) = oracles.random_stages(rng, n, r, N), oracles.random_sets(rng, n, N)
    x, v = 3.0 * rng.standard_normal(n), rng.standard_normal((N + 1, n, 1))
    if kind == "the first state does not matter":
        stages = stages._replace(A=np.concatenate([np.zeros((1, n, n)), stages.A[1:]]))
    elif kind == "no error of the state":
        M = 0.0 * M
    elif kind == "a stage without noise":
        M_w = np.where(np.arange(N)[:, None, None] == seed % N, 0.0, M_w)
    elif kind == "noise in one direction":
        M_w = v[1:] @ v[1:].mT
    elif kind == "an error in one direction":
        M = v[0] @ v[0].T
    elif kind == "a large state":
        x = x * 10.0 ** (1 + seed % 5)
    elif kind == "a small error":
        M = M * 10.0 ** (-2 - seed % 8)
    elif kind == "little noise":
        M_w = M_w * 10.0 ** (-2 - seed % 8)
    elif kind == "x = 0":
        x = 0.0 * x
    elif kind == "sizes that differ":
        M_w = M_w * 10.0 ** rng.uniform(-6.0, 6.0, (N, 1, 1))
    elif kind == "weights in one direction":
        stages = stages._replace(Q=v[1:] @ v[1:].mT)
    return stages, M, M_w, x


SPECIAL = [
    "nothing",
    "the first state does not matter",
    "no error of the state",
    "a stage without noise",
    "noise in one direction",
    "an error in one direction",
    "a large state",
    "a small error",
    "little noise",
    "x = 0",
    "sizes that differ",
    "weights in one direction",
]


def game(stages, M, M_w):
    """Problem and root of M."""
    return game_of(stages, psd_sqrt(np.asarray(M_w))), psd_sqrt(M[None])[0]


def semidefinite(stages, M, M_w, x):
    """Least bound with one multiplier for every set, by cvxpy and Clarabel: (57) in noises of unit size.

    In these no set is inverted, so that it may be flat.  States and radii are divided by a number to bring the bound
    near 1, where the solver's absolute tolerance means something.
    """
    import cvxpy

    unit = 1.0 / np.sqrt(solve_stages(*game(stages, M, M_w), x).rho)
    big, N, n = oracles.matrices(stages), len(M_w), len(x)
    R = np.zeros_like(big.C)
    for number, root in enumerate(psd_sqrt(np.array([M, *M_w]))):
        R[number * n : (number + 1) * n, number * n : (number + 1) * n] = unit * root
    h = unit * R.T @ (big.c - big.D.T @ np.linalg.solve(big.B, big.b)) @ x
    F = np.linalg.cholesky(np.linalg.inv(big.B)).T @ big.D @ R
    y, rho, tau = cvxpy.Variable((len(big.B), 1)), cvxpy.Variable((1, 1)), cvxpy.Variable(N + 1, nonneg=True)
    G = F.T @ F - R.T @ big.C @ R + cvxpy.diag(np.repeat(np.eye(N + 1), n, axis=0) @ tau)
    matrix = cvxpy.bmat([[np.eye(len(big.B)), y, F], [y.T, rho - cvxpy.sum(tau), -h[None]], [F.T, -h[:, None], G]])
    program = cvxpy.Problem(cvxpy.Minimize(rho[0, 0]), [0.5 * (matrix + matrix.T) >> 0])
    program.solve(solver=cvxpy.CLARABEL)
    return float(rho.value[0, 0]) / unit**2


@pytest.mark.parametrize("seed", [*range(2), *(pytest.param(i, marks=pytest.mark.slow) for i in range(2, 30))])
@pytest.mark.parametrize("kind", SPECIAL)
def test_it_equals_the_semidefinite_program(kind, seed):
    """Oracle: (57) with a multiplier for every ellipsoid, by cvxpy and Clarabel; never above the product's bound."""
    stages, M, M_w, x = case(kind, seed, N=2 + seed % 3)
    problem, root = game(stages, M, M_w)
    ours = solve_stages(problem, root, x)
    np.testing.assert_allclose(ours.rho, semidefinite(stages, M, M_w, x), **SOLVER)
    assert ours.rho <= solve(problem._replace(G=np.sqrt(len(M_w)) * problem.G), root, x).rho


@pytest.mark.parametrize("N", [2, 7, *(pytest.param(N, marks=pytest.mark.slow) for N in (10, 20, 100))])
@pytest.mark.parametrize("kind", SPECIAL)
def test_its_lower_bound_meets_it(kind, N):
    """Oracle: weak duality; and the first control is that of the recursion with these prices."""
    for seed in range(3):
        stages, M, M_w, x = case(kind, seed, N)
        problem, root = game(stages, M, M_w)
        form = make_form(problem, root, x)
        kept = np.repeat((form.T**2).sum(axis=0).reshape(N + 1, -1).sum(axis=1) > 0.0, len(x))
        found = search(form.T[:, kept], form.F[:, kept], form.f, len(x))
        assert (1.0 - GAP) * found.rho <= found.low <= (1.0 + 1e-12) * found.rho  # rounding
        ours, feedback = solve_stages(problem, root, x), np.linalg.solve(stages.R, stages.B.mT)
        np.testing.assert_allclose(ours.rho, found.rho, rtol=GAP)
        size = np.abs(feedback[0]) @ np.abs(ours.first)
        u = plan(problem, feedback, ours)[0]
        np.testing.assert_allclose(
            -feedback[0] @ ours.first, u, rtol=0.0, atol=1e-8 * size.max() + 1e-300
        )  # 4 n digits


@pytest.mark.parametrize("seed", range(12))
def test_of_one_stage_it_is_the_game_with_one_price(seed):
    """Oracle: the scalar problem and the semidefinite program."""
    stages, M, M_w, x = case("nothing", seed, N=1)
    problem, root = game(stages, M, M_w)
    ours, one = solve_stages(problem, root, x), solve(problem, root, x)
    for found, expected in zip(ours, one, strict=True):
        np.testing.assert_array_equal(found, expected)
    if seed < 4:
        np.testing.assert_allclose(ours.rho, semidefinite(stages, M, M_w, x), **SOLVER)


def test_with_noise_at_one_stage_it_is_the_game_with_one_price():
    """Oracle: the scalar problem with the same noise; the other stages have next to no price."""
    stages, M, M_w, x = case("nothing", 4)
    M_w = np.where(np.arange(4)[:, None, None] == 2, M_w, 0.0)
    problem, root = game(stages, M, M_w)
    ours, one = solve_stages(problem, root, x), solve(problem, root, x)
    np.testing.assert_allclose(ours.rho, one.rho, rtol=2.0 * GAP)
    np.testing.assert_allclose(ours.tau[2], one.tau[2], rtol=1e-3)  # where the bound is flat
    np.testing.assert_allclose(ours.first, one.first, rtol=1e-3)  # likewise
    assert (np.delete(ours.tau, 2) <= 1e-15 * ours.rho).all()


def test_without_noise_only_the_error_has_a_price():
    """Oracle: the game with one price, which is exact there; and nothing at all costs nothing."""
    stages, M, M_w, x = case("nothing", 0)
    problem, root = game(stages, M, 0.0 * M_w)
    np.testing.assert_array_equal(solve_stages(problem, root, x).rho, solve(problem, root, x).rho)
    assert solve_stages(problem, 0.0 * root, x).rho == 0.0


@pytest.mark.parametrize("scale", [1e-60, 1e-3, 7.0, 1e60])
def test_scaling(scale):
    """Oracle: cost is quadratic: states and radii times a number, the bound times its square."""
    stages, M, M_w, x = case("nothing", 1)
    one = solve_stages(*game(stages, M, M_w), x)
    other = solve_stages(*game(stages, scale**2 * M, scale**2 * M_w), scale * x)
    np.testing.assert_allclose(other.rho, scale**2 * one.rho, rtol=2.0 * GAP)
    np.testing.assert_allclose(other.first, scale * one.first, rtol=1e-6)  # a search to 1e-9 of the bound


@pytest.mark.parametrize("seed", range(4))
def test_equal_prices_are_the_product_set(seed):
    """Oracle: the recursion of the game with N M_w at N times the price; its worst error, its first control."""
    stages, M, M_w, x = case("nothing", seed)
    problem, root = game(stages, M, M_w)
    product = solve(problem._replace(G=2.0 * problem.G), root, x)
    T, F, f = make_form(problem, root, x)
    D = np.diag(np.repeat([product.tau_1, *product.tau / 4.0], len(x)))
    eta = np.linalg.solve(D - T.T @ F, T.T @ f)
    np.testing.assert_allclose(product.tau_1 + product.tau[0] + f @ T @ eta, product.rho, **ROUND)
    np.testing.assert_allclose(x + root @ eta[: len(x)], product.x_w, rtol=1e-9)  # another way to round
    edge = np.linalg.eigvalsh(D - T.T @ T)[0]
    assert abs(edge) <= 1e-12 * product.rho or edge > 0.0
