"""The game recursion against the semidefinite program that it replaces, in every way to write it that we know."""

import numpy as np
import pytest
from conftest import ROUND, SOLVER, random_psd
from controllers import minimax_oracles as oracles
from numerics import game_twin as twin
from scipy.optimize import minimize_scalar

from rmpc_bench.controllers.state_feedback import game_of
from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.lq_game import plan, smallest_multiplier, solve
from rmpc_bench.numerics.lq_windows import Stages, window_law

X = [(60.0, -45.0), (3.0, -2.0), (0.2, 0.1), (0.0, 0.0)]
M_W = np.array([[5.0, 2.0], [2.0, 5.0]])
M = np.array([[28.0, -9.0], [-9.0, 12.0]])
"""About as large as the mixed estimator's; its own is used in tests/controllers."""
DENSE = {"rtol": 1e-11, "atol": 1e-11}
"""A big linear system with a condition of about 1e5, solved to the last digits."""


def solved(stages, M, M_w, x):
    """Solution and all its controls."""
    problem = game_of(stages, psd_sqrt(np.asarray(M_w)))
    found = solve(problem, psd_sqrt(M[None])[0], np.array(x, dtype=float))
    return found, plan(problem, np.linalg.solve(stages.R, stages.B.mT), found)


def paper(N, k=20):
    """The paper's system with its sets of w."""
    return oracles.paper_stages(k, N), np.broadcast_to(M_W, (N, 2, 2))


def random_case(seed, N=6):
    """One of the random systems that vary: n = 2, 3, 4 and r = 1, 2."""
    rng = np.random.default_rng(seed)
    n, r = 2 + seed % 3, 1 + seed % 2
    stages = oracles.random_stages(rng, n, r, N)
    return stages, *oracles.random_sets(rng, n, N), 3.0 * rng.standard_normal(n)


@pytest.mark.parametrize("x", X)
@pytest.mark.parametrize("N", [1, 5, 10, 20])
@pytest.mark.long
def test_it_equals_the_dense_form_on_the_papers_system(N, x):
    """Oracle: (38)-(56) as big matrices with two multipliers; rho and every control."""
    stages, M_w = paper(N)
    ours, U = solved(stages, M, M_w, x)
    rho, expected = oracles.dense(stages, M, M_w, np.array(x))
    np.testing.assert_allclose(ours.rho, rho, **DENSE)
    np.testing.assert_allclose(U, expected, rtol=0.0, atol=1e-9)  # what is asked for; found are 1e-12


@pytest.mark.parametrize("seed", range(20))
def test_it_equals_the_dense_form_on_random_systems_that_vary(seed):
    """Oracle: as above, for n = 2, 3, 4 and r = 1, 2."""
    stages, M, M_w, x = random_case(seed)
    ours, U = solved(stages, M, M_w, x)
    rho, expected = oracles.dense(stages, M, M_w, x)
    np.testing.assert_allclose(ours.rho, rho, **DENSE)
    np.testing.assert_allclose(U, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())  # what is asked for


@pytest.mark.parametrize("kind", ["as it is", "unstable", "uneven", "other sizes"])
@pytest.mark.parametrize("seed", [*range(6), *(pytest.param(i, marks=pytest.mark.slow) for i in range(6, 30))])
def test_it_equals_the_dense_form_on_many_small_systems(kind, seed):
    """Oracle: as above, for n = 1..5 and a few stages, and states from far inside the set of e to far outside."""
    rng = np.random.default_rng((seed, len(kind)))
    n, N = int(rng.integers(1, 6)), int(rng.choice([1, 2, 4, 8]))
    stages, (M, M_w) = oracles.random_stages(rng, n, 1, N), oracles.random_sets(rng, n, N)
    if kind == "unstable":
        stages = stages._replace(A=1.6 * stages.A)
    elif kind == "uneven":
        stages = stages._replace(A=stages.A * np.exp(1.5 * rng.standard_normal((N, 1, 1))))
    elif kind == "other sizes":
        M, M_w = M * 10.0 ** rng.uniform(-3.0, 3.0), M_w * 10.0 ** rng.uniform(-3.0, 3.0)
    for size in (0.0, 0.1, 1.0, 10.0):
        x = size * np.sqrt(M.trace()) * rng.standard_normal(n)
        ours, U = solved(stages, M, M_w, x)
        rho, expected = oracles.dense(stages, M, M_w, x)
        np.testing.assert_allclose(ours.rho, rho, rtol=1e-9)  # the dense form beside its pole
        np.testing.assert_allclose(U, expected, rtol=0.0, atol=1e-6 * np.abs(expected).max() + 1e-12)  # likewise


@pytest.mark.parametrize("N", [5, *(pytest.param(N, marks=pytest.mark.slow) for N in (10, 20))])
@pytest.mark.parametrize("x", X)
def test_it_equals_the_semidefinite_program(N, x):
    """Oracle: (57) by cvxpy and Clarabel; its controls are less exact, as the cost is flat in them."""
    stages, M_w = paper(N)
    ours, U = solved(stages, M, M_w, x)
    rho, expected = oracles.semidefinite(stages, M, M_w, np.array(x))
    np.testing.assert_allclose(ours.rho, rho, **SOLVER)
    np.testing.assert_allclose(U, expected, rtol=0.0, atol=5e-3)  # of a solver that stops at 1e-8 of the cost


@pytest.mark.parametrize("seed", [*range(6), *(pytest.param(i, marks=pytest.mark.slow) for i in range(6, 20))])
def test_it_equals_the_semidefinite_program_on_random_systems(seed):
    """Oracle: (57) by cvxpy and Clarabel."""
    stages, M, M_w, x = random_case(seed, N=3)
    ours, _ = solved(stages, M, M_w, x)
    rho, _ = oracles.semidefinite(stages, M, M_w, x)
    np.testing.assert_allclose(ours.rho, rho, **SOLVER)


@pytest.mark.parametrize("seed", range(4))
def test_the_kernel_equals_its_plain_twin(seed):
    """Oracle: the recursion by inverses and searches instead of derivatives."""
    stages, M, M_w, x = random_case(seed)
    ours, _ = solved(stages, M, M_w, x)
    rho, tau_1, tau_2 = twin.solve(stages, M, M_w, x)
    np.testing.assert_allclose(ours.rho, rho, rtol=1e-10)  # a search to 1e-9 of its argument
    np.testing.assert_allclose([ours.tau_1, ours.tau[0]], [tau_1, tau_2], rtol=1e-4)  # where the cost is flat
    problem = game_of(stages, psd_sqrt(M_w))
    np.testing.assert_allclose(smallest_multiplier(problem), twin.smallest_multiplier(stages, M_w), rtol=1e-9)


def test_a_thousand_stages():
    """Oracle: the plain recursion at the price that was found, and at its neighbours, where the bound is higher."""
    stages, M_w = paper(1000)
    x = np.array([3.0, -2.0])
    ours, _ = solved(stages, M, M_w, x)
    price = ours.tau[0]
    rho = [twin.bound(stages, M, M_w, x, price * factor)[0] for factor in (0.9999, 1.0, 1.0001)]
    np.testing.assert_allclose(ours.rho, rho[1], rtol=1e-9)  # the twin's pencil of the edge
    assert rho[1] < min(rho[0], rho[2])


@pytest.mark.parametrize("x", [0.0, 0.3, 5.0])
def test_one_stage_of_one_state(x):
    """Oracle: the worst case of q (a (x + e) + b u + w)^2 + r u^2 by hand, |e| and |w| at their bounds."""
    a, b, q, r, m, m_w = 1.2, 0.7, 2.0, 0.5, 0.4, 0.3
    stages = Stages(*(np.array([[[value]]]) for value in (a, b, q, r)))
    ours, U = solved(stages, np.array([[m]]), np.array([[[m_w]]]), [x])
    reach = a * np.sqrt(m) + np.sqrt(m_w)
    found = minimize_scalar(
        lambda u: q * (abs(a * x + b * u) + reach) ** 2 + r * u**2, bracket=(-a * x / b, 0.0), tol=1e-12
    )
    S = q * a**2 * r / (r + q * b**2)
    np.testing.assert_allclose(ours.rho + S * x**2, found.fun, **SOLVER)
    np.testing.assert_allclose(U[0, 0], found.x, rtol=1e-4, atol=1e-4)  # at a kink the search stops early


@pytest.mark.parametrize("factor", [1e3, 1e6])
def test_a_large_state_does_not_cancel(factor):
    """Oracle: the dense form; x' S x is up to 1e9 times the bound."""
    stages, M_w = paper(10)
    x = factor * np.array([1.0, -1.0])
    ours, _ = solved(stages, M, M_w, x)
    rho, _ = oracles.dense(stages, M, M_w, x)
    np.testing.assert_allclose(ours.rho, rho, rtol=1e-9)  # the dense form loses digits itself


def test_a_large_state_has_its_optimum_off_the_edge():
    """Oracle: the dense form; there tau_1 exceeds its least value, and the worst error stays on its ellipsoid."""
    stages, M_w = paper(5)
    x = np.array([1e5, -1e5])
    ours, U = solved(stages, M, M_w, x)
    e = ours.x_w - x
    np.testing.assert_allclose(e @ np.linalg.solve(M, e), 1.0, rtol=1e-9)  # of numbers with 1e5 before them
    rho, expected = oracles.dense(stages, M, M_w, x)
    np.testing.assert_allclose(ours.rho, rho, **DENSE)
    np.testing.assert_allclose(U, expected, rtol=1e-9)  # what is asked for
    edge = twin.recursion(stages, M_w, ours.tau[0], alone=True)
    assert ours.tau_1 > 1.5 * np.linalg.eigvals(M @ edge).real.max()


def test_noise_that_nothing_reaches():
    """Oracle: by hand.  Where A_0 = 0 the first error does not matter, and the price is the least there is."""
    stages, M_w = paper(4)
    stages = stages._replace(A=np.concatenate([np.zeros((1, 2, 2)), stages.A[1:]]))
    ours, U = solved(stages, M, M_w, (3.0, -2.0))
    np.testing.assert_allclose(ours.rho, twin.smallest_multiplier(stages, M_w), **ROUND)
    np.testing.assert_array_equal(U[0], 0.0)


def test_without_any_noise_it_is_linear_quadratic_control():
    """Oracle: the Riccati law; nothing to pay for."""
    stages, M_w = paper(10)
    x = np.array([3.0, -2.0])
    ours, U = solved(stages, 0.0 * M, 0.0 * M_w, x)
    law = window_law(stages, 10, np.zeros((10, 2, 1)))
    assert ours.rho == 0.0
    np.testing.assert_allclose(U[0], -law.K[0] @ x, **ROUND)


@pytest.mark.parametrize("flat", ["M", "M_w"])
def test_flat_sets(flat):
    """Oracle: sets that are almost flat, in the dense form, which needs inverses; the bound is continuous."""
    stages, M_w = paper(5)
    small = np.diag([1.0, 1e-9])
    sets = {"M": M, "M_w": M_w} | {flat: small if flat == "M" else np.broadcast_to(small, (5, 2, 2))}
    rho, _ = oracles.dense(stages, **sets, x=np.array([3.0, -2.0]))
    sets[flat] = np.where(np.abs(sets[flat]) < 1e-3, 0.0, sets[flat])
    ours, _ = solved(stages, **sets, x=(3.0, -2.0))
    np.testing.assert_allclose(ours.rho, rho, rtol=1e-4)  # the square root of what was left


def test_no_error_of_the_state():
    """Oracle: the dense form for an M that is almost 0."""
    stages, M_w = paper(5)
    ours, _ = solved(stages, 0.0 * M, M_w, (3.0, -2.0))
    rho, _ = oracles.dense(stages, 1e-10 * np.eye(2), M_w, np.array([3.0, -2.0]))
    np.testing.assert_allclose(ours.rho, rho, rtol=1e-4)  # the square root of what was left


@pytest.mark.parametrize("scale", [1e-3, 7.0, 1e4])
def test_scaling(scale):
    """Oracle: cost is quadratic: states and radii times a number, the bound times its square."""
    stages, M, M_w, x = random_case(1)
    one, U = solved(stages, M, M_w, x)
    other, U_other = solved(stages, scale**2 * M, scale**2 * M_w, scale * x)
    np.testing.assert_allclose(other.rho, scale**2 * one.rho, rtol=1e-11)  # s is found to 1e-12
    np.testing.assert_allclose(U_other, scale * U, rtol=1e-9, atol=1e-9 * scale)  # likewise, first order


def test_coordinates_do_not_matter():
    """Oracle: another basis of the state gives the same bound and the same controls."""
    stages, M, M_w, x = random_case(4)
    T = np.linalg.qr(np.random.default_rng(0).standard_normal((len(x), len(x))))[0] * 3.0
    back = np.linalg.inv(T)
    turned = Stages(T @ stages.A @ back, T @ stages.B, back.T @ stages.Q @ back, stages.R)
    one, U = solved(stages, M, M_w, x)
    other, U_other = solved(turned, T @ M @ T.T, T @ M_w @ T.T, T @ x)
    np.testing.assert_allclose(other.rho, one.rho, rtol=1e-11)  # s is found to 1e-12
    np.testing.assert_allclose(U_other, U, rtol=1e-9, atol=1e-9)  # likewise, first order


def test_the_price_of_a_singular_map_is_its_norm():
    """Oracle: the largest eigenvalue of the dense map from all noise to the cost."""
    rng = np.random.default_rng(3)
    stages = oracles.random_stages(rng, 3, 1, 7)
    M_w = np.array([random_psd(rng, 3, rank=1 + t % 3) for t in range(7)])
    G = psd_sqrt(M_w)
    big = oracles.matrices(stages).C[3:, 3:]
    wide = np.zeros((21, 21))
    for t in range(7):
        wide[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] = G[t]
    expected = np.linalg.eigvalsh(wide @ big @ wide)[-1]
    np.testing.assert_allclose(smallest_multiplier(game_of(stages, G)), expected, **ROUND)


@pytest.mark.parametrize("scale", [1e-4, 1e-8, 1e-12, 1e-20])
def test_a_small_error_of_the_state(scale):
    """Oracle: the dense form, down to where it has digits; below, the bound without an error.

    The price is then so close to its least value that neighbouring s give the same one.
    """
    stages, M_w = paper(20)
    for x in ((3.0, -2.0), (60.0, -45.0), (0.0, 0.0)):
        ours, U = solved(stages, scale * M, M_w, x)
        without, V = solved(stages, 0.0 * M, M_w, x)
        assert np.isfinite(U).all()
        if scale >= 1e-4:
            rho, expected = oracles.dense(stages, scale * M, M_w, np.array(x))
            np.testing.assert_allclose(ours.rho, rho, rtol=1e-9)  # the dense form has a pole nearby
            np.testing.assert_allclose(U, expected, rtol=0.0, atol=1e-7)  # likewise
        else:
            np.testing.assert_allclose(ours.rho, without.rho, rtol=1e2 * np.sqrt(scale))  # reach of the error
            np.testing.assert_allclose(U, V, rtol=0.0, atol=1e2 * np.sqrt(scale) + 1e-9)  # likewise
