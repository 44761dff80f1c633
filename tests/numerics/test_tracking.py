"""The square-root recursion against the stacked system, Riccati recursions and the infinite horizon."""

import numpy as np
import pytest
from conftest import EXACT, random_psd
from controllers.gpc_twin import dense
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from rmpc_bench.numerics.linalg import SMALLEST
from rmpc_bench.numerics.tracking import Problem, RunProblems

SIZES = [(6, 4, 3, 10), (1, 1, 1, 1), (3, 2, 2, 5), (2, 1, 3, 4), (2, 3, 2, 6), (3, 1, 3, 1), (2, 2, 2, 3)]
"""nx, nu, ny, N: the robot, more outputs than states, more inputs than outputs, as many outputs as states."""
LSTSQ = {"rtol": 1e-9, "atol": 1e-11}  # of two factorisations of systems with conditions up to 1e5


def problems(rng, nx, nu, ny, N, runs=7):
    """Random problems, another model and weight for every run."""
    A = rng.standard_normal((runs, nx, nx)) / np.sqrt(nx)
    B, f, C = rng.standard_normal((runs, nx, nu)), rng.standard_normal(nx), rng.standard_normal((ny, nx))
    Q_yw, Q_u = rng.standard_normal((runs, ny, ny)), rng.standard_normal((nu, nu)) + 2.0 * np.eye(nu)
    return A, B, f, C, Q_yw, Q_u, rng.standard_normal((N, ny)), rng.standard_normal((runs, nx))


def tracked(A, B, f, C, Q_yw, Q_u, w, x):
    """First inputs and costs by the recursion."""
    return RunProblems(A, B, f, C, Q_yw, np.linalg.qr(Q_u)[1], w, x).first_inputs()


@pytest.mark.parametrize(("nx", "nu", "ny", "N"), SIZES)
def test_the_recursion_solves_the_stacked_system(nx, nu, ny, N, rng):
    """Oracle: (12), filled entry by entry, by lstsq."""
    A, B, f, C, Q_yw, Q_u, w, x = problems(rng, nx, nu, ny, N)
    u, loss = tracked(A, B, f, C, Q_yw, Q_u, w, x)
    expected = [dense(A[i], B[i], f, C, Q_yw[i], Q_u, w, x[i]) for i in range(len(x))]
    np.testing.assert_allclose(u, [each for each, _ in expected], **LSTSQ)
    np.testing.assert_allclose(loss, [each for _, each in expected], **LSTSQ)


@pytest.mark.parametrize(("nx", "nu", "ny", "N"), SIZES)
def test_gains_are_the_recursion_for_every_state_and_reference(nx, nu, ny, N, rng):
    """Oracle: the compiled recursion, one model and one weight for all rows."""
    A, B, f, C, Q_yw, Q_u, w, x = problems(rng, nx, nu, ny, N)
    u, loss = tracked(A[:1], B[:1], f, C, Q_yw[:1], Q_u, w, x)
    K_x, K_w, u_0, E_x, E_w, e_0 = Problem(A[0], B[0], f, C, Q_yw[0], Q_u, N, N).law()
    np.testing.assert_allclose(K_w @ w.ravel() - x @ K_x.T + u_0, u, **LSTSQ)
    np.testing.assert_allclose(((E_w @ w.ravel() - x @ E_x.T + e_0) ** 2).sum(axis=1), loss, **LSTSQ)


def test_the_recursion_is_riccati_s(rng):
    """Oracle: the tracking recursion with squares, J = x' P x - 2 p' x + c, by hand."""
    A, B, f, C, Q_yw, Q_u, w, x = problems(rng, 4, 2, 3, 8, runs=1)
    A, B, Q_yw, x = A[0], B[0], Q_yw[0], x[0]
    Q, R, P, p, c = Q_yw.T @ Q_yw, Q_u.T @ Q_u, np.zeros((4, 4)), np.zeros(4), 0.0
    for target in w[::-1]:
        P, p, c = P + C.T @ Q @ C, p + C.T @ Q @ target, c + target @ Q @ target
        c += f @ P @ f - 2.0 * p @ f
        p, S = p - P @ f, np.linalg.inv(R + B.T @ P @ B)
        K, ahead = S @ B.T @ P @ A, S @ B.T @ p
        c -= p @ B @ ahead
        p, P = A.T @ (p - P @ B @ ahead), A.T @ P @ (A - B @ K)
    u, loss = tracked(A[None], B[None], f, C, Q_yw[None], Q_u, w, x[None])
    np.testing.assert_allclose(u[0], ahead - K @ x, rtol=1e-8)  # Riccati squares the condition
    np.testing.assert_allclose(loss[0], x @ P @ x - 2.0 * p @ x + c, rtol=1e-8)


def test_a_long_horizon_is_the_infinite_one(rng):
    """Oracle: solve_discrete_are; of an unstable system, whose powers overflow a stacked one."""
    A = np.array([[1.3, 0.4, 0.0], [0.0, 0.9, 0.5], [0.1, 0.0, 1.1]])
    B, C, Q_yw, Q_u = rng.standard_normal((3, 2)), rng.standard_normal((2, 3)), np.diag([2.0, 0.5]), np.diag([0.3, 3.0])
    P = solve_discrete_are(A, B, C.T @ Q_yw.T @ Q_yw @ C, Q_u.T @ Q_u)
    K = np.linalg.solve(Q_u.T @ Q_u + B.T @ P @ B, B.T @ P @ A)
    x = rng.standard_normal((5, 3))
    u, loss = tracked(A[None], B[None], np.zeros(3), C, Q_yw[None], Q_u, np.zeros((3000, 2)), x)
    np.testing.assert_allclose(u, -x @ K.T, rtol=1e-10)  # of the Riccati solver
    past = P - C.T @ Q_yw.T @ Q_yw @ C  # the output at k itself is not weighed
    np.testing.assert_allclose(loss, np.einsum("ri,ij,rj->r", x, past, x), rtol=1e-10)


def test_conditions_are_not_squared():
    """Oracle: exact arithmetic by hand; a root of 1e-9 has the square 1e-18, which vanishes beside 1.

    One state, B = [1, 1], Q_yw = 1, Q_u = 1e-9 (1 0; 0 2): u_i is proportional to 1 / q_i^2, and both reach w.
    """
    u, _ = tracked(
        np.zeros((1, 1, 1)), np.ones((1, 1, 2)), np.zeros(1), np.eye(1), np.eye(1)[None], 1e-9 * np.diag([1.0, 2.0]),
        np.ones((1, 1)), np.zeros((1, 1)),
    )  # fmt: skip
    np.testing.assert_allclose(u, [[0.8, 0.2]], rtol=1e-6)  # 1e-16 over the condition 1e-9


@pytest.mark.parametrize("N", [1, 4])
def test_inputs_that_the_cost_does_not_determine_are_none(N, rng):
    """Oracle: by construction; three inputs, two outputs, and no weight of the inputs."""
    A, B, f, C, Q_yw, _, w, x = problems(rng, 4, 3, 2, N)
    u, _ = tracked(A, B, f, C, Q_yw, np.zeros((3, 3)), w, x)
    assert np.isnan(u).all()
    with pytest.raises(ValueError, match="does not determine"):
        Problem(A[0], B[0], f, C, Q_yw[0], np.zeros((3, 3)), N, N).law()


def test_no_weight_of_the_inputs_where_outputs_determine_them(rng):
    """Oracle: y(1) = w(1) exactly, hence no loss."""
    A, B, f, C, Q_yw, _, w, x = problems(rng, 4, 2, 2, 1)
    u, loss = tracked(A, B, f, C, Q_yw, np.zeros((2, 2)), w, x)
    y = np.einsum("ij,rj->ri", C, np.einsum("rij,rj->ri", A, x) + np.einsum("rij,rj->ri", B, u) + f)
    np.testing.assert_allclose(y, np.tile(w, (7, 1)), rtol=1e-9)  # conditions of C B
    np.testing.assert_allclose(loss, 0.0, atol=1e-20)
    law = Problem(A[0], B[0], f, C, Q_yw[0], np.zeros((2, 2)), 1, 1).law()
    np.testing.assert_allclose(law.K_w @ w[0] - law.K_x @ x[0] + law.u_0, u[0], **LSTSQ)


def test_both_codes_mean_the_same_by_nothing():
    """Oracle: the two constants; the compiled file imports nothing."""
    from rmpc_bench.numerics import tracking_kernel

    assert tracking_kernel.SMALLEST == SMALLEST


@pytest.mark.parametrize("where", ["A", "B", "Q_yw", "x"])
def test_a_row_with_nan_is_alone(where, rng):
    """Oracle: the other rows one by one, bit for bit."""
    given_ = dict(zip(("A", "B", "f", "C", "Q_yw", "Q_u", "w", "x"), problems(rng, 3, 2, 2, 4), strict=True))
    given_[where][3].flat[0] = np.nan
    u, loss = tracked(**given_)
    assert np.isnan(u[3]).all() and np.isnan(loss[3])
    for i in (0, 2, 4, 6):
        one = {name: given_[name][i : i + 1] for name in ("A", "B", "Q_yw", "x")}
        alone = tracked(**(given_ | one))
        np.testing.assert_array_equal(alone[0][0], u[i])
        assert alone[1][0] == loss[i] and np.isfinite(u[i]).all()


@settings(max_examples=30)
@given(st.integers(-40, 40), st.integers(0, 2**32 - 1))
def test_scaling_both_weights_changes_nothing(exponent, seed):
    """Oracle: powers of two are exact; the cost has their square."""
    A, B, f, C, Q_yw, Q_u, w, x = problems(np.random.default_rng(seed), 3, 2, 2, 4, runs=2)
    scale = 2.0**exponent
    u, loss = tracked(A, B, f, C, Q_yw, Q_u, w, x)
    scaled = tracked(A, B, f, C, scale * Q_yw, scale * Q_u, w, x)
    np.testing.assert_allclose(scaled[0], u, **EXACT)
    np.testing.assert_allclose(scaled[1], scale**2 * loss, **EXACT)


def test_no_other_input_costs_less(rng):
    """Oracle: the cost of a simulation with the plan from stage to stage, and of plans beside it."""
    A, B, f, C, Q_yw, Q_u, w, x = problems(rng, 3, 2, 2, 5, runs=1)

    def cost(plan):
        z, total = x[0], 0.0
        for u, target in zip(plan, w, strict=True):
            z = A[0] @ z + B[0] @ u + f
            total += np.sum((Q_yw[0] @ (C @ z - target)) ** 2) + np.sum((Q_u @ u) ** 2)
        return total

    plan, z = [], x
    for j in range(5):
        plan.append(tracked(A, B, f, C, Q_yw, Q_u, w[j:], z)[0][0])
        z = (A[0] @ z[0] + B[0] @ plan[-1] + f)[None]
    plan, least = np.array(plan), tracked(A, B, f, C, Q_yw, Q_u, w, x)[1][0]
    np.testing.assert_allclose(cost(plan), least, rtol=1e-10)
    assert all(cost(plan + 1e-3 * rng.standard_normal(plan.shape)) > least for _ in range(20))


def test_weights_of_all_kinds(rng):
    """Oracle: (12) by lstsq; indefinite, singular and full roots."""
    A, B, f, C, _, _, w, x = problems(rng, 3, 2, 2, 6, runs=1)
    for Q_yw in (np.array([[0.5, 4.0], [4.0, 0.5]]), np.diag([1.0, 0.0]), random_psd(rng, 2)):
        for Q_u in (random_psd(rng, 2), np.array([[1.0, 2.0], [0.0, 1e-3]])):
            u, _ = tracked(A, B, f, C, Q_yw[None], Q_u, w, x)
            np.testing.assert_allclose(u[0], dense(A[0], B[0], f, C, Q_yw, Q_u, w, x[0])[0], rtol=1e-8)


@pytest.mark.parametrize(("nx", "nu", "ny", "N"), SIZES)
def test_paths_have_the_first_inputs_and_costs_of_the_recursion_to_the_bit(nx, nu, ny, N, rng):
    """Oracle: `track`, whose arithmetic they repeat."""
    A, B, f, C, Q_yw, Q_u, w, x = problems(rng, nx, nu, ny, N)
    R_u = np.linalg.qr(Q_u)[1]
    u, loss = RunProblems(A, B, f, C, Q_yw, R_u, w, x).first_inputs()
    path = RunProblems(A, B, f, C, Q_yw, R_u, w, x).paths()
    np.testing.assert_array_equal(path.U[:, 0], u)
    np.testing.assert_array_equal(path.loss, loss)


@pytest.mark.parametrize(("nx", "nu", "ny", "N"), SIZES)
def test_the_later_inputs_of_a_path_are_the_first_ones_of_shorter_problems(nx, nu, ny, N, rng):
    """Oracle: `first_inputs` from the state that the inputs before lead to, with the rest of the horizon."""
    A, B, f, C, Q_yw, Q_u, w, x = problems(rng, nx, nu, ny, N)
    R_u = np.linalg.qr(Q_u)[1]
    path = RunProblems(A, B, f, C, Q_yw, R_u, w, x).paths()
    for j in range(N):
        u, _ = RunProblems(A, B, f, C, Q_yw, R_u, w[j:], x).first_inputs()
        np.testing.assert_allclose(path.U[:, j], u, **LSTSQ)
        x = np.einsum("rij,rj->ri", A, x) + np.einsum("rij,rj->ri", B, path.U[:, j]) + f
        np.testing.assert_allclose(path.X[:, j], x, **LSTSQ)


def test_a_path_of_a_cost_that_does_not_determine_the_inputs_is_nan(rng):
    """Oracle: two equal inputs without a cost."""
    A, B, R_u = np.ones((1, 1, 1)), np.ones((1, 1, 2)), np.zeros((2, 2))
    path = RunProblems(A, B, np.zeros(1), np.ones((1, 1)), A, R_u, np.ones((3, 1)), np.ones((2, 1))).paths()
    assert np.isnan(path.U).all() and np.isnan(path.X).all()
