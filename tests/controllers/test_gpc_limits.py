"""Limits of gpc: problems solved by Clarabel, multipliers, all active sets, the exact skip, statuses and blocks."""

import itertools
import pickle
from dataclasses import replace

import numpy as np
import pytest
from controllers.gpc_limit_cases import HARD, KEYS, KINDS, NP, SOFT, models, step
from controllers.gpc_program_twin import Problem, by_clarabel, cost_of, kkt_residual, predicted
from controllers.gpc_twin import Swing, Varying, estimate_of

from rmpc_bench.controllers.gpc import design
from rmpc_bench.controllers.gpc_limits import moved_inputs
from rmpc_bench.controllers.limits import Limits, SoftLimit
from rmpc_bench.controllers.noise_tuning import LpNoise
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.state_dependent import Pair, StateDependentModel
from rmpc_bench.numerics.tracking import RunProblems
from rmpc_bench.types import OptimisedStep


def problem_of(model, k, x, before, r, limits, limit):
    """The problem of one run; the soft limit is one of the second state."""
    if isinstance(model, StateDependentModel):
        (A,), (B,) = model.at_state(x[None])
        C, f, d = model.C, np.zeros(3), np.zeros(2)
    else:
        m = model.at(k)
        A, B, C, f, d = m.A, m.B, m.C, m.f0, m.d0
    u = np.array(limits.u).T if np.ndim(limits.u) == 2 else limits.u
    Z, scale = np.eye(3)[1:2], np.array([limit.scale])
    return Problem(A, B, f, C, np.diag(KEYS["Q_yw"]), np.diag(KEYS["Q_u"]), r[1:] - d, x, before, tuple(u), limits.du,
                   Z, np.zeros(1), limit.limits, scale, limit.linear, limit.quadratic, limit.steps)  # fmt: skip


def whole(controller, p, k):
    """All inputs of the program of one run, by the functions that `control` uses."""
    limits = controller.limits
    if controller.gains is not None:
        own, shared = np.concatenate([p.x, p.before])[None], np.append(p.w.ravel(), 1.0)
        return limits.program.moves(own, shared).V[0].reshape(NP, 2)
    limited = limits.horizon.at(k)
    path = RunProblems(p.A[None], p.B[None], p.f, p.C, p.Q_yw[None], controller.R_u, p.w, p.x[None]).paths()
    values = limited.values(path, p.before[None])[0]
    moved, _ = moved_inputs(p.A, p.B, path.laws[0], limited, values)
    return path.U[0] + moved.reshape(NP, 2)


@pytest.mark.parametrize("rounds", [4, pytest.param(40, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", KINDS)
def test_programs_have_the_minimum_of_clarabel_and_its_multipliers(name, rounds, rng):
    """Oracle: cvxpy with states and slacks as variables; the conditions of the minimum, from the equations alone."""
    found = []
    for _ in range(rounds):
        model = models(rng)[name]
        controller = design(model, 3, **KEYS, limits=HARD, soft=SOFT)
        x, before = 0.5 * rng.standard_normal((5, 3)), rng.uniform(-0.5, 0.5, (5, 2))
        r, k = rng.standard_normal((NP + 1, 2)), int(rng.integers(3))
        command = step(controller, x, r, before, k)
        for i, code in enumerate(command.info["qp"]):
            p = problem_of(model, k, x[i], before[i], r, HARD, SOFT["x.1"])
            U, cost = by_clarabel(p)
            ours = whole(controller, p, k)
            np.testing.assert_allclose(command.u[i], ours[0], rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(cost_of(p, ours), cost, rtol=1e-6)
            violated, residual = kkt_residual(p, ours)
            assert violated < 1e-9 and residual < 1e-8
            found.append(OptimisedStep(int(code)))
            assert (found[-1] is OptimisedStep.SOFTENED) == bool(
                np.any(np.abs(predicted(p, ours)[0][:4, 1] - 0.05) > 0.35 + 1e-8)
            )
    assert {OptimisedStep.SOLVED, OptimisedStep.SOFTENED} <= set(found)


def closed_loop(controller, model, x0, runs=6, steps=14, level=1.0):
    """Commands of runs whose plant is the model at k = 0, with a reference that changes its sign and known states."""
    rng = np.random.default_rng(7)
    r = level * np.sign(np.sin(0.7 * np.arange(steps + NP + 1)))[:, None] * [1.0, -0.5]
    x, state, found = x0[:runs], controller.init(runs), []
    for k in range(steps):
        if isinstance(model, StateDependentModel):
            (A, B), f = model.at_state(x), 0.0
        else:
            m = model.at(min(k, 2))
            A, B, f = m.A[None], m.B[None], m.f0
        y = x @ np.eye(3, 2) + 0.01 * rng.standard_normal((len(x0), 2))[:runs]
        state, command = controller.control(k, state, y, estimate_of(x), r[k : k + controller.preview])
        found.append(command)
        x = np.einsum("rij,rj->ri", np.broadcast_to(A, (runs, 3, 3)), x) + f
        x = x + np.einsum("rij,rj->ri", np.broadcast_to(B, (runs, 3, 2)), command.u)
    return found


class Endless(Varying):
    """Models that repeat their last one."""

    def at(self, k):
        """The model at k."""
        return self.models[min(k, 2)]


TUNINGS = {"constant": {}, "tuned": {"tuning": LpNoise(Ne2=4, kp=1e-4, bounds=(0.5, 3.0))}}
CASES = [(name, tuning) for name in KINDS for tuning in TUNINGS]


def case(name, tuning, rng):
    """A model and keys of the law."""
    model = models(rng)[name]
    model = Endless(model.models) if name == "varying" else model
    return model, {**KEYS, **TUNINGS[tuning]}


@pytest.mark.parametrize(("name", "tuning"), CASES)
def test_limits_that_never_act_leave_every_bit(name, tuning, rng):
    """Oracle: the law without limits, over a loop; clipping, and a program in every step, too."""
    model, keys = case(name, tuning, rng)
    wide, x0 = {"u": (-1e3, 1e3), "du": (-1e3, 1e3)}, rng.standard_normal((6, 3))
    soft = {"y.0": SoftLimit(limits=(-1e3, 1e3), linear=1.0)}
    expected = closed_loop(design(model, 14, **keys), model, x0)
    clipped = closed_loop(design(model, 14, **keys, limits=Limits(**wide)), model, x0)
    controller = design(model, 14, **keys, limits=Limits(**wide, enforce="qp"), soft=soft)
    ours, solved = closed_loop(controller, model, x0), closed_loop(every_program(controller), model, x0)
    for k, command in enumerate(expected):
        np.testing.assert_array_equal(clipped[k].u, command.u)
        np.testing.assert_array_equal(ours[k].u, command.u)
        np.testing.assert_allclose(solved[k].u, command.u, rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(ours[k].info["loss"], command.info["loss"])
        assert set(ours[k].info["qp"]) == {OptimisedStep.SKIPPED} and set(solved[k].info["qp"]) == {
            OptimisedStep.SOLVED
        }


def every_program(controller):
    """The same controller without a skip."""
    limits = controller.limits
    program = limits.program and replace(limits.program, skips=False)
    return replace(controller, limits=replace(limits, program=program, skips=False))


@pytest.mark.parametrize(("name", "tuning"), CASES)
def test_skipped_programs_would_not_have_changed_the_input(name, tuning, rng):
    """Oracle: every program solved, from the same states; some are skipped and some are not."""
    model, keys = case(name, tuning, rng)
    controller = design(model, 14, **keys, limits=Limits(u=(-1.0, 1.2), du=(-1.1, 1.3), enforce="qp"), soft=SOFT)
    every, seen = every_program(controller), []
    x0 = 0.5 * rng.standard_normal((6, 3))
    state, r = controller.init(6), 0.5 * np.ones((40, 2))
    for k in range(14):
        x_hat, y = x0 * 0.5**k, x0[:, :2]
        ahead = r[k : k + NP + 1] * (1.0 if k % 5 < 2 else 0.0)
        _, theirs = every.control(k, state, y, estimate_of(x_hat), ahead)
        state, ours = controller.control(k, state, y, estimate_of(x_hat), ahead)
        np.testing.assert_allclose(ours.u, theirs.u, rtol=0.0, atol=1e-9)
        assert (theirs.info["qp"] != OptimisedStep.SKIPPED).all()
        seen += ours.info["qp"].tolist()
    assert 0.0 < np.mean(np.array(seen) == OptimisedStep.SKIPPED) < 1.0


def test_to_test_the_first_input_only_is_wrong(rng):
    """The naive skip: a double integrator brakes before its input reaches the limit of the increment.

    Oracle: Clarabel; the first input without limits is within its limits, and yet not that of the minimum.
    """
    m = LinearModel([[1.0, 1.0], [0.0, 1.0]], [[0.5], [1.0]], [[1.0, 0.0]], 1.0, 1.0)
    keys = {"Np": 8, "Q_yw": 1.0, "Q_u": 0.5}
    limits = Limits(u=(-0.1, 0.5), enforce="qp")
    x_hat, r, before = np.array([[0.0, 0.3]]), np.full((9, 1), 0.9), np.zeros((1, 1))
    naive = step(design(m, **keys), x_hat, r, before).u
    ours = step(design(m, **keys, limits=limits), x_hat, r, before)
    p = Problem(m.A, m.B, np.zeros(2), m.C, np.eye(1), 0.5 * np.eye(1), r[1:], x_hat[0], before[0], limits.u,
                (-1e3, 1e3), np.zeros((1, 2)), np.zeros(1), (-1.0, 1.0), np.ones(1), 1.0, 1.0, 1)  # fmt: skip
    U, _ = by_clarabel(p)
    assert -0.1 <= naive[0, 0] <= 0.5
    np.testing.assert_allclose(ours.u[0], U[0], rtol=0.0, atol=1e-6)
    assert abs(ours.u[0, 0] - naive[0, 0]) > 1e-2


@pytest.mark.parametrize("state_dependent", [False, True])
def test_tiny_programs_by_all_active_sets(state_dependent, rng):
    """Oracle: the best feasible solution of the equations of every active set, for two inputs and seven limits."""
    C, Q_u, limits = np.array([[1.0, 0.0]]), 0.4, Limits(u=(-0.3, 0.5), du=(-0.4, 0.35), enforce="qp")
    swing = Swing()
    for _ in range(40):
        x, before, w = rng.standard_normal(2), rng.uniform(-0.3, 0.5, 1), 3.0 * rng.standard_normal((2, 1))
        (A,), (B,) = swing.at_state(x[None])
        B = 10.0 * B
        model = _Scaled(swing) if state_dependent else LinearModel(A, B, C, np.eye(2), 1.0)
        controller = design(model, Np=2, Q_yw=1.0, Q_u=Q_u, limits=limits)
        r = np.vstack([np.zeros((1, 1)), w])
        u = step(controller, x[None], r, before[None]).u[0, 0]
        Theta = np.array([[(C @ B).item(), 0.0], [(C @ A @ B).item(), (C @ B).item()]])
        free = np.array([(C @ A @ x).item(), (C @ A @ A @ x).item()])
        H, h = Theta.T @ Theta + Q_u**2 * np.eye(2), Theta.T @ (w[:, 0] - free)
        rows = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [-1.0, 1.0]])
        low = np.array([-0.3, -0.3, before[0] - 0.4, -0.4])
        high = np.array([0.5, 0.5, before[0] + 0.35, 0.35])
        np.testing.assert_allclose(u, best_of_all(H, h, rows, low, high)[0], rtol=0.0, atol=1e-9)


class _Scaled(StateDependentModel):
    """The pendulum with ten times the torque."""

    nx, nu, ny, largest = 2, 1, 1, 20.0
    C, Q_w, R_v = np.array([[1.0, 0.0]]), np.eye(2), np.eye(1)

    def __init__(self, swing):
        self.swing = swing

    def at_state(self, x):
        """Multiply B."""
        A, B = self.swing.at_state(x)
        return Pair(A, 10.0 * B)


def best_of_all(H, h, rows, low, high):
    """Minimum of 1/2 U'HU - h'U by trying every active set."""
    sides = [(row, bound) for row, a, b in zip(rows, low, high, strict=True) for bound in (a, b)]
    best, least = None, np.inf
    for size in range(3):
        for active in itertools.combinations(sides, size):
            matrix = np.array([row for row, _ in active]).reshape(size, 2)
            if np.linalg.matrix_rank(matrix) < size:
                continue
            stack = np.block([[H, matrix.T], [matrix, np.zeros((size, size))]])
            U = np.linalg.solve(stack, np.concatenate([h, [bound for _, bound in active]]))[:2]
            fits = (rows @ U >= low - 1e-12).all() and (rows @ U <= high + 1e-12).all()
            if fits and 0.5 * U @ H @ U - h @ U < least:
                best, least = U, 0.5 * U @ H @ U - h @ U
    return best


@pytest.mark.parametrize(("name", "tuning"), CASES)
def test_a_run_has_the_same_bytes_in_any_block_and_in_any_order(name, tuning, rng):
    """Oracle: runs one by one, in another block, in reverse and after pickling, bit for bit."""
    model, keys = case(name, tuning, rng)
    controller = design(model, 14, **keys, limits=HARD, soft=SOFT)
    x_hat, before, y = 0.3 * rng.standard_normal((7, 3)), rng.uniform(-0.5, 0.5, (7, 2)), np.zeros((7, 2))
    r = 0.1 * np.ones((NP + 1, 2))

    def command(rows, law=controller):
        state = law.init(len(rows))._replace(x_previous=x_hat[rows], u_previous=before[rows])
        return law.control(0, state, y[rows], estimate_of(x_hat[rows]), r)[1]

    whole_block = command(np.arange(7))
    assert len(set(whole_block.info["qp"])) > 1
    for rows in (np.arange(7)[::-1], np.array([3, 1]), *np.arange(7)[:, None]):
        np.testing.assert_array_equal(command(rows).u, whole_block.u[rows])
    np.testing.assert_array_equal(command(np.arange(7), pickle.loads(pickle.dumps(controller))).u, whole_block.u)
