"""MPC with limits as constraints: trajectories of the study, exact skipping, statuses, naive forms that fail."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from conftest import random_model

from rmpc_bench.controllers.limits import Limits, SoftLimit, signal_of, soft_rows
from rmpc_bench.controllers.mpc import Scale, design
from rmpc_bench.controllers.mpc_law import MpcState
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.servo import TABLE_1, ServoNoise, continuous
from rmpc_bench.models.servo import design as servo
from rmpc_bench.types import DesignError, Estimate, Estimator, OptimisedStep, Status

PI, LIMIT = np.pi, 25.0 * np.pi
SKIPPED, SOLVED, SOFTENED, INFEASIBLE, NOT_CONVERGED = (float(step) for step in OptimisedStep)
U, DU = (-220.0, 220.0), (-50.0, 50.0)
HALF_TURN = np.full((11, 1), PI / 2)


def torque(linear, signal="shaft_torque", factor=1.0):
    """Limit of the torque of the shaft on the load side, divided by `factor`."""
    return {signal: SoftLimit((-LIMIT / factor, LIMIT / factor), linear)}


def law(model, limits, soft=None, **keys):
    """Return the controller of the study."""
    return design(model, Hp=10, Hu=3, Q=0.1, R=0.1, scale=Scale(u=440.0, y=2.0 * PI), limits=limits, soft=soft, **keys)


def estimate_of(x_hat, **info):
    """Return an estimate of every run."""
    x_hat = np.atleast_2d(np.array(x_hat, dtype=float))
    return Estimate(x_hat, None, None, np.zeros(len(x_hat), dtype=np.int8), info)


def step(controller, x_hat, u_previous, r=HALF_TURN):
    """Return the command for estimates and previous inputs of runs."""
    x_hat = np.atleast_2d(np.array(x_hat, dtype=float))
    before = np.array(u_previous, dtype=float).reshape(len(x_hat), -1)
    return controller.control(0, MpcState(before), np.zeros((len(x_hat), 1)), estimate_of(x_hat), r)[1]


def simulated(model, controller, n=100):
    """Return y, u, the shaft torque and the steps of the model itself under a Kalman filter, without noise."""
    filter_ = kalman(model, n, x0=np.zeros(4), P0=model.Q_w)
    e, c, x = filter_.init(1), controller.init(1), np.zeros((1, 4))
    y, u, z, steps = [0.0], [], [], []
    for k in range(n):
        e, estimate = filter_.correct(k, e, x @ model.C.T)
        c, command = controller.control(k, c, x @ model.C.T, estimate, HALF_TURN)
        x = x @ model.A.T + command.u @ model.B.T
        y.append(x[0, 0])
        u.append(command.u[0, 0])
        z.append((model.extra_signals["shaft_torque"] @ x[0])[0])
        steps.append(command.info.get("qp", [np.nan])[0])
        e = filter_.predict(k, e, command.u)
    return np.array(y), np.array(u), np.array(z), np.array(steps)


TRAJECTORIES = {
    "N1": ({"u": U}, None, [95.51931, 170.46426, 220, 220, 220, 220],
           [0.04710260, 0.25040246, 0.68995634, 0.86725886, 1.62697719], 142.169230),
    "N2": ({"u": U, "enforce": "qp"}, None, [95.51931, 157.35293, 196.34427, 216.58514, 220, 220],
           [0.04563027, 0.23584145, 0.66112874, 0.84911312, 1.62465184], 130.957609),
    "N3": ({"u": U, "du": DU, "enforce": "qp"}, None, [50, 100, 150, 191.12122, 213.81588, 220],
           [0.02599591, 0.15559774, 0.54505207, 0.77312763, 1.60846828], 110.038814),
    "N4": ({"u": U, "enforce": "qp"}, 0.03, [69.51235, 93.21613, 111.46295, 147.53910, 188.46772, 211.97660],
           [0.03087453, 0.14988328, 0.47363759, 0.70430108, 1.59107943], 78.539816),
}  # fmt: skip


@pytest.mark.parametrize("name", [*TRAJECTORIES])
def test_the_trajectories_of_the_study_come_out(servo, name):
    """Oracle: constrained-mpc.md section 9, from another program; all printed digits."""
    limits, linear, inputs, outputs, largest = TRAJECTORIES[name]
    y, u, z, _ = simulated(servo, law(servo, Limits(**limits), None if linear is None else torque(linear)))
    np.testing.assert_allclose(u[:6], inputs, rtol=0, atol=5.1e-6)
    np.testing.assert_allclose(y[[3, 5, 8, 10, 20]], outputs, rtol=0, atol=5.1e-9)
    np.testing.assert_allclose(np.abs(z).max(), largest, rtol=0, atol=5.1e-7)


QPS = {
    "Q1": (np.zeros(4), 0.0, [50.0, 42.13256952, 29.38699029], 0.050688358955),
    "Q2": ([0.3, 1.0, 8.0, 40.0], 150.0, [-21.86066755, 50.0, 41.86066755], 0.042282604922),
}


@pytest.mark.parametrize("name", [*QPS])
def test_the_programs_of_the_study_come_out(servo, name):
    """Oracle: section 9 and, for moves and cost, cvxpy with states and inputs as variables."""
    x_hat, before, moves, cost = QPS[name]
    controller = law(servo, Limits(u=U, du=DU, enforce="qp"), torque(0.03))
    found = controller.program.moves(np.array([[*x_hat, before]]), np.append(HALF_TURN[1:].ravel(), 1.0))
    np.testing.assert_allclose(found.V[0], moves, rtol=0, atol=5.1e-9)
    expected, value, eps = by_cvxpy(servo, x_hat, before, Z=servo.extra_signals["shaft_torque"])
    np.testing.assert_allclose(expected, moves, rtol=0, atol=1e-5)
    np.testing.assert_allclose(value, cost, rtol=1e-7)
    if name == "Q2":
        np.testing.assert_allclose(eps.max(), 76.71987526, rtol=1e-6)


def by_cvxpy(m, x_hat, before, Z, Hp=10, Hu=3):
    """Moves, cost and slacks of the problem with states, inputs and slacks as variables, the model a constraint."""
    x, v, eps = cp.Variable((Hp + 1, m.nx)), cp.Variable(Hu), cp.Variable(Hp, nonneg=True)
    u = [before / 440.0 + cp.sum(v[: j + 1]) for j in range(Hu)]
    u += [u[-1]] * (Hp - Hu)
    size = np.array([1.0, 10.0, 20.0, 200.0])
    A, B, C, z = m.A * size / size[:, None], m.B[:, 0] * 440.0 / size, m.C * size, Z[0] * size / (50.0 * PI)
    cost = sum(0.1 * cp.square((C @ x[j + 1] - PI / 2) / (2.0 * PI)) for j in range(Hp))
    cost = cp.sum(cost) + 0.1 * cp.sum_squares(v) + 0.03 * cp.sum(eps) + 0.5e-3 * cp.sum_squares(eps)
    rules = [x[0] == np.array(x_hat) / size, *(x[j + 1] == A @ x[j] + B * u[j] for j in range(Hp))]
    rules += [cp.abs(v) <= 50.0 / 440.0, *(cp.abs(u[j]) <= 0.5 for j in range(Hu))]
    rules += [cp.abs(z @ x[j + 1]) <= 0.5 + eps[j] for j in range(Hp)]
    tight = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12}
    value = cp.Problem(cp.Minimize(cost), rules).solve(solver=cp.CLARABEL, **tight)
    return v.value * 440.0, value, eps.value * 50.0 * PI


def test_the_penalty_is_exact_above_the_largest_multiplier(servo):
    """Oracle: section 2, 78.53981634 at 0.0208 and 78.584 at 0.0205; a quadratic penalty alone never gets there."""
    limits = Limits(u=U, enforce="qp")
    for linear, largest in ((0.0208, 78.53981634), (0.0205, 78.584)):
        _, _, z, _ = simulated(servo, law(servo, limits, torque(linear)), 40)
        np.testing.assert_allclose(np.abs(z).max(), largest, rtol=0, atol=1e-7 if linear > 0.0207 else 5e-4)
    only = {"shaft_torque": SoftLimit((-LIMIT, LIMIT), 0.0, quadratic=1e3)}
    _, _, z, _ = simulated(servo, law(servo, limits, only), 40)
    assert 78.5405 < np.abs(z).max() < 78.55


def test_both_definitions_of_the_torque(servo):
    """Oracle: J_l th_l'' = shaft_torque - ..; the motor feels rho times less, whose limit must be divided by rho."""
    A, _ = continuous(TABLE_1)
    shaft, motor = (servo.extra_signals[name][0] for name in ("shaft_torque", "motor_torque"))
    twist = np.array([-0.01, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(TABLE_1["J_l"] * (A @ twist)[1], shaft @ twist, rtol=1e-12)
    np.testing.assert_allclose(TABLE_1["J_m"] * (A @ twist)[3], -motor @ twist, rtol=1e-12)
    limits, rho = Limits(u=U, enforce="qp"), TABLE_1["rho"]
    _, u, _, _ = simulated(servo, law(servo, limits, torque(0.03)), 20)
    _, divided, _, _ = simulated(servo, law(servo, limits, torque(0.03, "motor_torque", rho)), 20)
    np.testing.assert_allclose(divided, u, rtol=0, atol=1e-8)
    # The trap: with the same number the limit never acts, and every test passes.
    _, naive, z, _ = simulated(servo, law(servo, limits, torque(0.03, "motor_torque")), 20)
    _, without, _, _ = simulated(servo, law(servo, limits), 20)
    np.testing.assert_array_equal(naive, without)
    assert np.abs(z).max() > 130.0


def estimates(servo, runs=40, seed=1):
    """Return estimates and previous inputs for which limits act in some runs and not in others."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((runs, 4)) * [0.3, 0.3, 0.5, 3.0]
    x[:, 0] += PI / 2
    x[:, 2] += 20.0 * x[:, 0]
    return x, rng.uniform(-40.0, 40.0, (runs, 1))


def test_skipping_changes_nothing(servo):
    """Oracle: every program solved, 1e-9 V; a skipped run has the bits of the clipped law."""
    x, before = estimates(servo, 300)
    limits = Limits(u=U, du=DU, enforce="qp")
    controller = law(servo, limits, torque(0.03))
    skipping = step(controller, x, before)
    every = step(replace(controller, program=replace(controller.program, skips=False)), x, before)
    skipped = skipping.info["qp"] == SKIPPED
    assert 30 < skipped.sum() < 270 and not (every.info["qp"] == SKIPPED).any()
    np.testing.assert_allclose(skipping.u, every.u, rtol=0, atol=1e-9)
    clipped = step(law(servo, Limits(u=U, du=DU)), x, before)
    np.testing.assert_array_equal(skipping.u[skipped], clipped.u[skipped])


def test_the_first_input_alone_does_not_tell_whether_a_limit_acts(servo):
    """Trap: in N2 u(1) of the linear law, 170.46 V, is within its limits, and the minimum under them is 157.35 V."""
    x = servo.B[:, 0] * 95.51931
    free = step(law(servo, None), x, 95.51931).u[0, 0]
    found = step(law(servo, Limits(u=U, enforce="qp")), x, 95.51931)
    assert free < 220.0 and found.info["qp"][0] == SOLVED and found.u[0, 0] < free - 10.0


def test_limits_that_do_not_act_leave_the_linear_law(servo):
    """Oracle: the closed form, 1e-9 V, also where every program is solved."""
    x, before = estimates(servo)
    wide = law(servo, Limits(u=(-1e6, 1e6), du=(-1e6, 1e6), enforce="qp"), {"x.2": SoftLimit((-1e6, 1e6), 1.0)})
    free = step(law(servo, None), x, before).u
    skipping = step(wide, x, before)
    np.testing.assert_array_equal(skipping.u, free)
    assert (skipping.info["qp"] == SKIPPED).all()
    every = step(replace(wide, program=replace(wide.program, skips=False)), x, before)
    np.testing.assert_allclose(every.u, free, rtol=0, atol=1e-9)
    assert (every.info["qp"] == SOLVED).all()


def test_a_run_has_the_same_bytes_in_any_block(servo):
    """Oracle: blocks of one, in another order; the naive product x @ M.T depends on the number of rows."""
    x, before = estimates(servo, 60)
    controller = law(servo, Limits(u=U, du=DU, enforce="qp"), torque(0.03))
    whole, order = step(controller, x, before).u, np.random.default_rng(2).permutation(60)
    np.testing.assert_array_equal(step(controller, x[order], before[order]).u, whole[order])
    for i in range(0, 60, 3):
        np.testing.assert_array_equal(step(controller, x[i], before[i]).u[0], whole[i])
    wide = np.asfortranarray(np.repeat(x, 2, axis=0))[::2]
    np.testing.assert_array_equal(step(controller, wide, before).u, whole)


def test_an_estimate_that_is_not_a_number_harms_no_other_run(servo):
    """Oracle: the block without it; the naive test `any(row > high)` calls such a run free of limits."""
    x, before = estimates(servo, 20)
    controller = law(servo, Limits(u=U, du=DU, enforce="qp"), torque(0.03))
    expected = step(controller, x, before).u
    x[3, 1] = np.nan
    command = step(controller, x, before)
    others = np.arange(20) != 3
    np.testing.assert_array_equal(command.u[others], expected[others])
    assert command.info["qp"][3] == NOT_CONVERGED and command.step_status[3] == Status.NOT_CONVERGED
    assert not (np.array([np.nan]) > 1.0).any()


FALLBACKS = {"clip": 220.0, "hold": 230.0, "stop": 220.0}


@pytest.mark.parametrize("fallback", [None, *FALLBACKS])
def test_a_step_without_a_solution_applies_the_fallback(servo, fallback):
    """Oracle: section 7: u(k-1) = 230 with |du| <= 5 has no moves within 220 V; only `stop` ends the run."""
    controller = law(servo, Limits(u=U, du=(-5.0, 5.0), enforce="qp", fallback=fallback))
    command = step(controller, np.zeros((2, 4)), [[230.0], [0.0]])
    assert command.info["qp"].tolist() == [INFEASIBLE, SOLVED]
    np.testing.assert_allclose(command.u[:, 0], [FALLBACKS[fallback or "clip"], 5.0], rtol=0, atol=1e-9)
    if fallback == "stop":
        assert command.status.tolist() == [Status.INFEASIBLE, Status.OK] and command.step_status is None
    else:
        assert not command.status.any() and command.step_status.tolist() == [Status.INFEASIBLE, Status.OK]


def test_a_solver_out_of_iterations_has_not_converged(servo):
    """Oracle: the flag -4 of the solver, which one iteration produces."""
    controller = law(servo, Limits(u=U, du=DU, enforce="qp"))
    controller = replace(controller, program=replace(controller.program, iteration_limit=1))
    command = step(controller, [[-1.0, 0.0, -20.0, 0.0]], [0.0])
    assert command.info["qp"].tolist() == [NOT_CONVERGED] and command.step_status.tolist() == [Status.NOT_CONVERGED]
    # The clipped increment of the linear law.
    np.testing.assert_array_equal(command.u, [[50.0]])


def test_clip_cuts_the_increment_first_then_the_input(servo):
    """Oracle: by hand; the other order would give 220 in the first case, and 230 + 50 is cut to 220 in the second."""
    x = np.tile([-1e3, 0.0, 0.0, 0.0], (3, 1))
    command = step(law(servo, Limits(u=U, du=(-50.0, 30.0))), x, [[0.0], [210.0], [-220.0]])
    np.testing.assert_array_equal(command.u, [[30.0], [220.0], [-190.0]])
    assert command.info == {} and not command.status.any()


class EstimatesMean(Estimator):
    """An estimator that declares an estimate of the mean of the process noise."""

    estimates_mean = True


@pytest.mark.parametrize("means", [False, True])
def test_several_inputs_with_constant_parts_and_bounds_of_their_own(means, rng):
    """Oracle: cvxpy on the simulated model, with f0, d0, an estimated mean, and a soft limit of an output."""
    m = random_model(rng, 3, 2, 2)
    m = LinearModel(m.A, m.B, m.C, m.Q_w, m.R_v, f0=rng.standard_normal(3), d0=rng.standard_normal(2))
    u, du, Hp, Hu = [(-0.3, 0.2), (-0.1, 0.5)], [(-0.2, 0.2), (-0.05, 0.1)], 5, 3
    soft = {"y.1": SoftLimit((-0.4, 0.3), 0.02, scale=0.5, quadratic=0.1, steps=2)}
    limits = Limits(u=u, du=du, enforce="qp")
    controller = design(
        m, EstimatesMean() if means else Estimator(), Hp=Hp, Hu=Hu, Q=1.0, R=0.1, limits=limits, soft=soft
    )
    x_hat, mean = rng.standard_normal((4, 3)), 0.3 * rng.standard_normal((4, 3))
    before, r = np.tile([0.1, 0.2], (4, 1)), rng.standard_normal((Hp + 1, 2))
    command = controller.control(0, MpcState(before), np.zeros((4, 2)), estimate_of(x_hat, w_mean=mean), r)[1]
    assert (command.info["qp"] >= SOLVED).all() and (command.info["qp"] <= SOFTENED).all()
    for i in range(4):
        v, eps, x, now = cp.Variable((Hu, 2)), cp.Variable(2, nonneg=True), x_hat[i], before[i]
        cost, rules = 0.1 * cp.sum_squares(v) + 0.02 * cp.sum(eps) + 0.05 * cp.sum_squares(eps), []
        for j in range(Hp):
            now = now + v[j] if j < Hu else now
            x = m.A @ x + m.B @ now + m.f0 + (mean[i] if means else 0.0)
            y = m.C @ x + m.d0
            cost = cost + cp.sum_squares(y - r[j + 1])
            rules += [y[1] <= 0.3 + 0.5 * eps[j], y[1] >= -0.4 - 0.5 * eps[j]] if j < 2 else []
            if j < Hu:
                rules += [now[n] >= u[n][0] for n in range(2)] + [now[n] <= u[n][1] for n in range(2)]
                rules += [v[j, n] >= du[n][0] for n in range(2)] + [v[j, n] <= du[n][1] for n in range(2)]
        cp.Problem(cp.Minimize(cost), rules).solve(solver=cp.CLARABEL)
        np.testing.assert_allclose(command.u[i], before[i] + v.value[0], rtol=0, atol=2e-6)


def test_signals_by_place_name_and_rows(servo):
    """Oracle: unit rows, C, and rows as given."""
    np.testing.assert_array_equal(signal_of("x.2", servo).Z, [[0.0, 0.0, 1.0, 0.0]])
    np.testing.assert_array_equal(signal_of("y.0", servo).Z, servo.C)
    row = servo.extra_signals["shaft_torque"]
    np.testing.assert_array_equal(signal_of("shaft_torque", servo).Z, row)
    given = soft_rows({"twist": SoftLimit((-1.0, 1.0), 1.0, of=row[0].tolist())}, servo, 10)["twist"]
    np.testing.assert_array_equal(given.signal.Z, row)
    assert given.steps == 10 and given.scale.tolist() == [2.0]


ONE = SoftLimit((-1.0, 1.0), 1.0)


@pytest.mark.parametrize(
    ("keys", "parameter", "message"),
    [
        ({"limits": Limits(u=U, enforce="qp"), "law": "printed"}, "limits.enforce", "law: increment"),
        ({"limits": Limits(u=U), "soft": {"x.0": ONE}}, "soft", "enforce: qp"),
        ({"soft": {"x.0": ONE}}, "soft", "enforce: qp"),
        ({"limits": Limits(enforce="qp")}, "limits", "no limit to enforce"),
        ({"limits": Limits(u=[U, U])}, "limits.u", "2 pairs"),
        ({"limits": Limits(u=U, du=(1.0, 1.0))}, "limits.du", "below"),
        ({"soft": {"shaft_torqe": ONE}, "limits": Limits(enforce="qp")}, "soft.shaft_torqe", "'shaft_torque'"),
        ({"soft": {"x.7": ONE}, "limits": Limits(enforce="qp")}, 'soft."x.7"', "0 to 3"),
        ({"soft": {"z": replace(ONE, of=[1.0])}, "limits": Limits(enforce="qp")}, "soft.z.of", "states"),
        ({"soft": {"z": replace(ONE, steps=11)}, "limits": Limits(enforce="qp")}, "soft.z", "known"),
        ({"soft": {"x.0": replace(ONE, steps=11)}, "limits": Limits(enforce="qp")}, 'soft."x.0".steps', "at most"),
        (
            {"soft": {"x.0": SoftLimit((-np.inf, 1.0), 1.0)}, "limits": Limits(enforce="qp")},
            'soft."x.0"',
            "no `scale`",
        ),
    ],
)
def test_keys_that_do_not_fit_are_refused_at_their_place(servo, keys, parameter, message):
    """Oracle: the parameter leads to the line of the YAML, the message names the way out."""
    with pytest.raises(DesignError, match=message) as caught:
        law(servo, keys.pop("limits", None), **keys)
    assert caught.value.parameter == parameter


def test_only_the_plain_clipped_law_is_compiled(servo):
    """Oracle: the compiled simulation knows one pair of limits and no increment."""
    assert law(servo, Limits(u=U)).has_compiled_form
    assert not law(servo, Limits(u=U, du=DU)).has_compiled_form
    assert not law(servo, Limits(u=U, enforce="qp")).has_compiled_form
    assert law(servo, Limits(u=U, enforce="qp")).optimises and not law(servo, Limits(u=U)).optimises


@pytest.mark.parametrize(
    ("keys", "key", "message"),
    [
        ({"limits": Limits()}, "limits", "no limit to enforce"),
        ({"limits": Limits(u=(-1.0, 1.0), fallback="hold")}, "limits.fallback", "no effect with `enforce: clip`"),
    ],
)
def test_limits_without_an_effect_are_refused(keys, key, message):
    """Oracle: the key to blame."""
    model = LinearModel([[1.0]], [[1.0]], [[1.0]], 1.0, 1.0)
    with pytest.raises(DesignError, match=message) as caught:
        design(model, Hp=2, Hu=1, Q=1.0, R=1.0, **keys)
    assert caught.value.parameter == key


def test_a_soft_limit_may_have_one_bound():
    """Oracle: the same with a bound that is never reached."""
    model = LinearModel([[0.9]], [[1.0]], [[1.0]], 1.0, 1.0)
    u = []
    for low in (None, -1e6):
        soft = {"y.0": SoftLimit(limits=(low, 0.5), linear=10.0, scale=1.0)}
        law = design(model, Hp=3, Hu=2, Q=1.0, R=0.1, limits=Limits(u=(None, 2.0), enforce="qp"), soft=soft)
        r, x_hat = np.full((4, 1), 1.0), np.zeros((1, 1))
        u.append(law.control(0, law.init(1), x_hat, Estimate(x_hat), r)[1].u.item())
    assert u[0] == u[1] and abs(u[0] - 0.5) < 1e-9


@pytest.mark.parametrize("size", [1e-12, 1e9])
def test_the_size_of_the_weights_does_not_matter(size):
    """Oracle: weights of size 1 give the same inputs, with a soft limit whose penalty has the same factor."""
    model = servo(0.1, noise=ServoNoise(1.0, 1.0))
    found = []
    for factor in (1.0, size):
        soft = {"shaft_torque": SoftLimit((-25 * np.pi, 25 * np.pi), linear=0.03 * factor, quadratic=1e-3 * factor)}
        weights = {"Q": 0.1 * factor, "R": 0.1 * factor, "scale": Scale(440.0, 2 * np.pi)}
        law = design(
            model, Hp=10, Hu=3, limits=Limits((-220.0, 220.0), du=(-50.0, 50.0), enforce="qp"), soft=soft, **weights
        )
        x_hat, before = np.array([[0.3, 1.0, 8.0, 40.0], [0.0] * 4]), np.array([[150.0], [0.0]])
        command = law.control(0, MpcState(before), x_hat[:, :1], Estimate(x_hat), np.full((11, 1), np.pi / 2))[1]
        assert set(command.info["qp"]) <= {OptimisedStep.SOLVED, OptimisedStep.SOFTENED}
        found.append(command.u)
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9)
