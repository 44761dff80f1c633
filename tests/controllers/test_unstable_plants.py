"""Predictive control of unstable plants over long horizons, against programs in 400 digits."""

import mpmath as mp
import numpy as np
import pytest
import quadprog
from conftest import random_model
from controllers.exact_programs import DIGITS, boxed_minimum, cost_of

from rmpc_bench.controllers import gpc, lqg, mpc, pid, tube_mpc
from rmpc_bench.controllers.gpc_law import GpcState
from rmpc_bench.controllers.limits import Limits, SoftLimit
from rmpc_bench.controllers.mpc_law import MpcState
from rmpc_bench.controllers.prediction import frozen
from rmpc_bench.controllers.tube_mpc import TubeState
from rmpc_bench.estimators import kalman
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError, Estimate, OptimisedStep

LIMIT = 0.8
HARD = Limits(u=(-LIMIT, LIMIT), enforce="qp")
UNSTABLE = np.array([[1.5, 0.1], [0.0, 0.9]])


def model_of(A, B, C):
    """A model with small noise."""
    return LinearModel(np.array(A), np.array(B), np.array(C), 0.01 * np.eye(len(A)), 0.01 * np.eye(len(C)))


def estimate_of(x):
    """The estimate of every run."""
    return Estimate(x, None, None, np.zeros(len(x), dtype=np.int8), {})


def random_case(rng, horizons):
    """A plant of spectral radius 0.5 to 2 with 1 to 4 states, a weight, a horizon, and three states with inputs."""
    nx = int(rng.integers(1, 5))
    A = rng.standard_normal((nx, nx))
    A *= rng.uniform(0.5, 2.0) / np.abs(np.linalg.eigvals(A)).max()
    model = model_of(A, rng.standard_normal((nx, 1)), rng.standard_normal((1, nx)))
    x = rng.standard_normal((3, nx)) * 10.0 ** rng.uniform(-1.0, 0.5, (3, 1))
    return model, 10.0 ** rng.uniform(-3.0, 1.0), int(rng.choice(horizons)), x, rng.uniform(-LIMIT, LIMIT, (3, 1))


def exact(model, R, Hp, Hu, x, before=None):
    """Inputs of the program with reference 1, in exact arithmetic."""
    with mp.workdps(DIGITS):
        return boxed_minimum(*cost_of(model.A, model.B, model.C, [[1]], [[R]], x, [1.0], Hp, Hu, before), -LIMIT, LIMIT)


def mpc_step(controller, x, before):
    """The command of mpc for reference 1."""
    r = np.ones((controller.preview, 1))
    return controller.control(0, MpcState(before), np.zeros((len(x), 1)), estimate_of(x), r)[1]


@pytest.mark.parametrize("Hp", [20, 30, 60, 120])
def test_the_program_that_was_called_solved_and_is_wrong(Hp):
    """Oracle: all 27 active sets in 400 digits; the input was -0.61638 at Hp 30."""
    model, x, before = model_of(UNSTABLE, [[1.0], [0.1]], [[1.0, 0.0]]), np.array([[1.43013, -0.155130]]), [[-0.500686]]
    command = mpc_step(mpc.design(model, Hp=Hp, Hu=3, Q=1.0, R=0.1, limits=HARD), x, np.array(before))
    np.testing.assert_allclose(command.u[0], exact(model, 0.1, Hp, 3, x[0], before)[:1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(command.u[0, 0], -LIMIT, rtol=1e-15)
    assert command.info["qp"][0] == OptimisedStep.SOLVED


@pytest.mark.parametrize("count", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_inputs_of_mpc_are_the_exact_ones(count):
    """Oracle: all active sets, in 400 digits; no program counts as failed."""
    rng, kinds = np.random.default_rng(34), set()
    for _ in range(count):
        model, R, Hp, x, before = random_case(rng, [5, 20, 60, 120])
        Hu = int(rng.integers(1, 5))
        command = mpc_step(mpc.design(model, Hp=Hp, Hu=Hu, Q=1.0, R=R, limits=HARD), x, before)
        expected = [exact(model, R, Hp, Hu, *each)[0] for each in zip(x, before, strict=True)]
        np.testing.assert_allclose(command.u[:, 0], expected, rtol=0, atol=1e-9)
        kinds |= set(command.info["qp"])
    assert kinds == {OptimisedStep.SKIPPED, OptimisedStep.SOLVED}


@pytest.mark.parametrize("count", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_inputs_of_gpc_are_the_exact_ones(count):
    """Oracle: as above; the program of every run has the inputs of the constant one, over long horizons too."""
    rng = np.random.default_rng(35)
    for number in range(count):
        model, R, Np, x, before = random_case(rng, [1, 2, 4] if number % 3 else [20, 40])
        controller = gpc.design(model, 3, Np=Np, Q_yw=1.0, Q_u=float(np.sqrt(R)), limits=HARD)
        r = np.ones((Np + 1, 1))
        command = controller.control(0, GpcState(x, before), np.zeros((3, 1)), estimate_of(x), r)[1]
        assert not any(OptimisedStep(int(each)).failed for each in command.info["qp"])
        if Np <= 4:
            expected = [exact(model, R, Np, Np, each)[0] for each in x]
            np.testing.assert_allclose(command.u[:, 0], expected, rtol=0, atol=1e-9)
        now = frozen(model)
        now, limited = now._replace(A=now.A[None], B=now.B[None]), controller.limits.horizon.at(0)
        one_by_one, _ = controller.limits.varying(now, (np.eye(1)[None], controller.R_u), limited, x, before, r[1:])
        np.testing.assert_allclose(one_by_one.u, command.u, rtol=0, atol=1e-8)


@pytest.mark.parametrize("count", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_inputs_of_tube_mpc_are_those_of_another_solver(count):
    """Oracle: quadprog; both agree on which problems have no point."""
    rng, kinds = np.random.default_rng(36), set()
    for _ in range(count):
        model, _, N, x, before = random_case(rng, [3, 10, 30])
        model = LinearModel(model.A, model.B, np.eye(model.nx), 1e-4 * np.eye(model.nx), np.zeros((model.nx,) * 2))
        kind = str(rng.choice(["growing", "none"]))
        W = None if kind == "none" else 0.005
        try:
            made = tube_mpc.design(model, Q_x=1.0, R_u=0.1, horizon=N, limits={"u": (-1.0, 1.0)}, W=W, tightening=kind)
        except DesignError:
            continue
        no_y, r = np.zeros((3, model.nx)), np.zeros((1, model.nx))
        command = made.control(0, TubeState(before), no_y, estimate_of(x), r)[1]
        rows, n = made.plan.rows, made.plan.rows.A.shape[1]
        for i, code in enumerate(command.info["qp"]):
            b, scale = rows.E @ x[i], np.abs(rows.A).max(axis=1).clip(1e-300)
            G, h = np.vstack([rows.A, -rows.A]), np.concatenate([rows.low - b, b - rows.high])
            kept, scale = np.isfinite(h), np.tile(scale, 2)
            G, h = (G / scale[:, None])[kept].T, (h / scale)[kept]
            kinds.add(OptimisedStep(int(code)))
            try:
                V = quadprog.solve_qp(np.eye(n), np.zeros(n), G, h)[0]
            except ValueError:
                assert OptimisedStep(int(code)).failed
                continue
            expected = made.plan.feedback.K @ x[i] + made.first @ V
            np.testing.assert_allclose(command.u[i], np.clip(expected, -1.0, 1.0), rtol=0, atol=1e-8)
    assert OptimisedStep.SOLVED in kinds


@pytest.mark.parametrize(("Hp", "expected"), [(60, -12.3128009), (80, -12.781105)])
def test_the_first_input_over_a_long_horizon(Hp, expected):
    """Oracle: 120 digits, from faults of an earlier version, which refused Hp 90."""
    controller = mpc.design(model_of(UNSTABLE, [[0.0], [0.1]], [[1.0, 0.0]]), Hp=Hp, Hu=3, Q=1.0, R=0.1)
    found = mpc_step(controller, np.array([[0.3, 0.2]]), np.zeros((1, 1))).u[0, 0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=5.1e-7)


def exact_gain(A, B, C, Q, R, Hp, Hu):
    """Gain of [x; u(k-1)] of the first increment, by the Riccati recursion of the increments."""
    (nx, nu), n = B.shape, len(A) + B.shape[1]
    augmented = np.block([[A, B], [np.zeros((nu, nx)), np.eye(nu)]])
    with mp.workdps(DIGITS):
        F, G, weight = (mp.matrix(each.tolist()) for each in (augmented, np.vstack([B, np.eye(nu)]), R))
        seen = mp.matrix(np.pad(C, ((0, 0), (0, nu))).tolist())
        W, P, K = seen.T * mp.matrix(Q.tolist()) * seen, mp.zeros(n), None
        for j in range(Hp, 0, -1):
            P = P + W
            if j <= Hu:
                K = mp.inverse(weight + G.T * P * G) * (G.T * P * F)
            P = F.T * P * (F - G * K if j <= Hu else F)
        return np.array(K.tolist(), dtype=float)


def test_gains_of_mpc_over_long_horizons(rng):
    """Oracle: 400 digits; several inputs and outputs, spectral radius up to 2."""
    for _ in range(10):
        nx, nu, ny = (int(each) for each in rng.integers(1, (5, 3, 3)))
        A = rng.standard_normal((nx, nx))
        A *= rng.uniform(0.5, 2.0) / np.abs(np.linalg.eigvals(A)).max()
        model, R = model_of(A, rng.standard_normal((nx, nu)), rng.standard_normal((ny, nx))), 0.1 * np.eye(nu)
        Hu = int(rng.integers(1, 5))
        made = mpc.design(model, Hp=120, Hu=Hu, Q=1.0, R=0.1)
        expected = exact_gain(model.A, model.B, model.C, np.eye(ny), R, 120, Hu)
        found = np.hstack([made.K_x, made.K_u])
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_messages_name_the_cause(rng):
    """A soft limit that the input cannot hold, moves that the cost does not determine, and inputs without effect."""
    model = model_of(UNSTABLE, [[1.0], [0.1]], [[1.0, 0.0]])
    keys = {"Hp": 120, "Hu": 3, "Q": 1.0}
    with pytest.raises(DesignError, match="at most [0-9]+ steps"):
        mpc.design(model, **keys, R=0.1, limits=HARD, soft={"x.0": SoftLimit((-1.0, 1.0), 0.1)})
    with pytest.raises(DesignError, match=r"R is singular.*choose R > 0"):
        mpc.design(random_model(rng, 2, 2, 1), Hp=5, Hu=3, Q=1.0, R=0.0)
    late = model_of(np.eye(4, k=1), np.eye(4)[:, 3:], np.eye(4)[:1])
    (text,) = mpc.design(late, Hp=3, Hu=1, Q=1.0, R=0.1).remarks
    assert "no effect within Hp = 3" in text and not mpc.design(late, Hp=4, Hu=1, Q=1.0, R=0.1).remarks
    assert "within Np = 3" in gpc.design(late, 2, Np=3, Q_yw=1.0, Q_u=0.1).remarks[0]
    still = model_of(0.5 * np.eye(2), np.zeros((2, 1)), [[1.0, 0.0]])
    for design in (lambda: mpc.design(still, **keys, R=0.1), lambda: gpc.design(still, 2, Np=5, Q_yw=1.0, Q_u=0.1)):
        with pytest.raises(DesignError, match="B of the design model is zero"):
            design()


def test_laws_with_constant_terms_have_gains(rng):
    """The linear law of mpc, lqg and pid is there with an operating point, and says that it is affine."""
    model = random_model(rng, 2, 1, 1)
    assert not mpc.design(model, Hp=5, Hu=2, Q=1.0, R=0.1).linear_law().affine
    moved = LinearModel(model.A, model.B, model.C, model.Q_w, model.R_v, f0=np.ones(2))
    assert mpc.design(moved, Hp=5, Hu=2, Q=1.0, R=0.1).linear_law().affine
    filter_ = kalman.design(moved, 3, x0=np.zeros(2), P0=np.eye(2))
    assert lqg.design(moved, 0.1, filter_, Q_x=1.0, Q_i=0.0, R_u=1.0).linear_law().affine
    assert pid.design(model, 0.1, Kp=1.0).linear_law().affine is False


@pytest.mark.parametrize("linear", [1e2, 1e5, 1e6, 1e7, 1e8])
def test_large_weights_of_slacks_are_solved(linear):
    """Oracle: the limit of a weight without end, where the least violation decides: u = 1, by an interior-point method
    in 700 bits.
    """
    model = model_of([[0.9, -0.1], [0.8, 0.1]], [[-0.3], [1.0]], [[1.0, 0.0]])
    soft = {"s": SoftLimit((-0.3, 0.3), linear, 1.0, of=[[-0.2, -1.3]])}
    law = mpc.design(model, Hp=8, Hu=3, Q=1.0, R=0.1, limits=Limits(u=(-1.0, 1.0), enforce="qp"), soft=soft)
    _, command = law.control(
        0, MpcState(np.zeros((1, 1))), np.zeros((1, 1)), estimate_of(np.array([[1.9, 0.7]])), np.ones((9, 1))
    )
    assert command.info["qp"][0] == OptimisedStep.SOFTENED
    np.testing.assert_allclose(command.u[0], [1.0], atol=1e-6)


@pytest.mark.parametrize("x", [[1.0, 0.2], [5.0, 1.0]])
@pytest.mark.parametrize("gap", [1e-2, 3e-6, 1e-7])
def test_soft_limits_in_small_units_are_never_infeasible(gap, x):
    """Oracle: an input within its limits is a point of the program; u = -1 by an interior-point method in 700 bits."""
    model = model_of([[1.2, 0.1], [0.0, 0.9]], [[1.0], [0.1]], [[1.0, 0.0]])
    soft = {"x.0": SoftLimit((0.2, 0.2 + gap), 1.0, None)}
    law = mpc.design(model, Hp=5, Hu=3, Q=1.0, R=0.1, limits=Limits(u=(-1.0, 1.0), enforce="qp"), soft=soft)
    _, command = law.control(
        0, MpcState(np.zeros((1, 1))), np.zeros((1, 1)), estimate_of(np.array([x])), np.ones((6, 1))
    )
    assert command.info["qp"][0] == OptimisedStep.SOFTENED
    np.testing.assert_allclose(command.u[0], [-1.0], atol=1e-6)
