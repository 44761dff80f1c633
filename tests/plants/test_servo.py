"""The servomechanism against the event-driven reference, a plain twin of its kernel and linear algebra."""

import math
from functools import cache

import numba
import numpy as np
import pytest
from conftest import ROUND, servo_model
from plants.servo_oracle import TABLE_2, closed_loop, flow
from scipy.linalg import expm

from rmpc_bench.controllers import mpc
from rmpc_bench.estimators import kalman, robust_kalman
from rmpc_bench.plants import servo, servo_kernel

NO_NOISE = np.zeros((1, 4))
FRICTIONLESS = {name: 0.0 if name.startswith("alpha") else value for name, value in TABLE_2.items()}


def test_the_kernel_is_compiled_and_the_shape_checks_do_not_wrap_it():
    """Oracle: the import hook of conftest.py covers plants/servo.py and not plants/servo_kernel.py."""
    assert isinstance(servo_kernel.servo_step_kernel, numba.core.registry.CPUDispatcher)
    assert hasattr(servo.design, "__wrapped__")


def drawn(plant, p, runs=1):
    """Dynamics of runs with the same parameters."""
    return plant.draw({name: np.full(runs, p[name]) for name in plant.nominal}, [], 1)


def trajectory(p, voltages, substep=1e-3, x=None):
    """States of the plant, (samples, 5), under voltages held for 0.1 s each."""
    plant = servo.design(0.1, substep=substep)
    delta, x = drawn(plant, p), np.zeros((1, 5)) if x is None else x[None]
    states = [x[0]]
    for k, u in enumerate(voltages):
        x = plant.step(k, delta, x, np.array([[u]]), NO_NOISE).x
        states.append(x[0])
    return np.array(states)


def random_plant(rng):
    """A plant of the Monte Carlo experiment of section 4.3: +-10 %, +-20 %, and +-80 % on the load inertia."""
    eps_min, eps_max, eps_jl = rng.uniform(-0.1, 0.1), rng.uniform(-0.2, 0.2), rng.uniform(-0.8, 0.8)
    factors = dict.fromkeys(("R", "rho", "k_theta"), 1 + eps_min)
    factors |= dict.fromkeys(("J_m", "beta_m", "K_t", "beta_l"), 1 + eps_max) | {"J_l": 1 + eps_jl}
    nominal = servo.design(0.1).nominal
    return {name: value * factors.get(name, 1.0) for name, value in nominal.items()}


@cache
def open_loops():
    """Cases (parameters, voltages, load angles of the reference) over 50 samples; Table 2 first, then random plants."""
    rng, cases = np.random.default_rng(7), []
    for i in range(12):
        p = TABLE_2 if i < 4 else random_plant(rng)
        if i % 2:
            volts = rng.uniform(5, 60) * np.sin(2 * np.pi * np.arange(50) / rng.uniform(15, 60))
        else:
            volts = np.repeat(rng.choice([-1, 0, 1], 10) * rng.uniform(10, 220), 5)
        x, y = np.zeros(5), [0.0]
        for u in volts:
            x = flow(p, x, u, 0.1)
            y.append(x[0])
        cases.append((p, volts, np.array(y)))
    return cases


def worst_error(substep):
    """Largest error of the load angle over all open loops [rad]."""
    return max(np.abs(trajectory(p, volts, substep)[:, 0] - y).max() for p, volts, y in open_loops())


def test_open_loops_follow_the_reference_to_first_order():
    """Oracle: event-driven integration; the error is proportional to the substep.

    Bound 0.35 rad/s times the substep: full-range bang-bang voltages err up to five times the 6.2e-5 rad of the closed
    loops of servo.md 3.7 (600 random loops: at most 3.1e-4 rad at 1 ms).
    """
    errors = {substep: worst_error(substep) for substep in (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)}
    for substep, error in errors.items():
        assert error <= 0.35 * substep
    assert 1.4 < errors[4e-3] / errors[2e-3] < 2.8
    assert 8.0 < errors[4e-3] / errors[2.5e-4] < 32.0  # 16 at first order; sticking sets in at other substeps


@pytest.mark.parametrize("c", [None, 0.1])
def test_the_closed_loop_of_simulation_2_follows_the_reference(c):
    """Oracle: event-driven integration of sim 2 under the same voltages; the bounds of servo.md 3.7."""
    model = servo_model()
    start = {"x0": np.zeros(4), "P0": model.Q_w}
    filter_ = kalman.design(model, 200, **start) if c is None else robust_kalman.design(model, 200, c=c, **start)
    scale, limits = mpc.Scale(u=440.0, y=2 * np.pi), mpc.Limits(u=(-220.0, 220.0))
    law = mpc.design(model, Hp=10, Hu=3, Q=0.1, R=0.1, scale=scale, limits=limits)
    memory, r = {}, np.full((11, 1), np.pi / 2)

    def controller(k, y):
        if k == 0:
            memory.update(e=filter_.init(1), c=law.init(1))
        state, estimate = filter_.correct(k, memory["e"], np.array([[y]]))
        memory["c"], command = law.control(k, memory["c"], np.array([[y]]), estimate, r)
        memory["e"] = filter_.predict(k, state, command.u)
        return float(command.u[0, 0])

    y_reference, _ = closed_loop(TABLE_2, controller, 200)
    for substep, bound in ((2e-3, 1.0e-4), (1e-3, 6.2e-5), (1e-4, 6.6e-6)):
        plant = servo.design(0.1, substep=substep)
        delta, x, y = drawn(plant, TABLE_2), np.zeros((1, 5)), [0.0]
        for k in range(200):
            x = plant.step(k, delta, x, np.array([[controller(k, y[-1])]]), NO_NOISE).x
            y.append(x[0, 0])
        assert np.abs(np.array(y) - y_reference).max() <= bound


@pytest.mark.parametrize("share", [-1.0 + 1e-9, -0.5, 0.0, 0.3, 1.0 - 1e-9])
def test_below_breakaway_nothing_moves_at_all(share):
    """Oracle: Filippov; a motor torque below alpha_m0 + alpha_m1 at rest is held, exactly and for ever."""
    volts = share * (TABLE_2["alpha_m0"] + TABLE_2["alpha_m1"]) / TABLE_2["K_t"] * TABLE_2["R"]
    start = np.array([0.3, 0.0, 0.3 * TABLE_2["rho"], 0.0, 0.0])
    states = trajectory(TABLE_2, np.full(100, volts), x=start)
    np.testing.assert_array_equal(states[:, :4], np.tile(start[:4], (101, 1)))


def test_above_breakaway_the_motor_moves():
    """Oracle: as above, on the other side of the threshold."""
    volts = 1.01 * (TABLE_2["alpha_m0"] + TABLE_2["alpha_m1"]) / TABLE_2["K_t"] * TABLE_2["R"]
    assert trajectory(TABLE_2, np.full(100, volts))[-1, 2] > 0.0


def test_while_stuck_velocities_are_zero_and_positions_stand():
    """Oracle: between two samples at which a body rests under a weak torque, its angle has the same bits."""
    volts = np.concatenate([np.full(10, 60.0), np.zeros(40)])
    states = trajectory(TABLE_2, volts)
    for angle, speed in ((0, 1), (2, 3)):
        rests = states[:, speed] == 0.0
        assert rests[1:].any() and not rests[1:].all()
        both = rests[30:-1] & rests[31:]
        assert both.any()
        np.testing.assert_array_equal(states[30:-1, angle][both], states[31:, angle][both])


def test_runge_kutta_of_the_sign_equation_creeps_where_the_kernel_sticks():
    """Oracle: servo.md 3.7; RK4 on the raw sgn equation drifts under a torque that friction holds."""
    p, A, B, x = TABLE_2, *servo.with_current(TABLE_2), np.zeros(5)
    volts = 0.9 * (p["alpha_m0"] + p["alpha_m1"]) / p["K_t"] * p["R"]

    def slope(x):
        peak_l = p["alpha_l0"] + p["alpha_l1"] * math.exp(-p["alpha_l2"] * abs(x[1]))
        peak_m = p["alpha_m0"] + p["alpha_m1"] * math.exp(-p["alpha_m2"] * abs(x[3]))
        return A @ x + B @ np.array([volts, peak_l * np.sign(x[1]), peak_m * np.sign(x[3])])

    h = 1e-2
    for _ in range(500):
        s1 = slope(x)
        s2 = slope(x + h / 2 * s1)
        s3 = slope(x + h / 2 * s2)
        x = x + h / 6 * (s1 + 2 * s2 + 2 * s3 + slope(x + h * s3))
    assert abs(x[2]) > 1e-3  # a load would follow at 1/20 of it
    np.testing.assert_array_equal(trajectory(p, np.full(50, volts), substep=h)[:, :4], np.zeros((51, 4)))


def twin_friction(free, W, F):
    """Friction torques with end velocities free - W tau: all nine modes tried, the complementary one returned.

    The kernel finds them by Gauss-Seidel sweeps; this solves every mode and keeps the one that violates least.
    """
    best, tau_best = math.inf, np.zeros(2)
    for mode in np.ndindex(3, 3):
        tau = np.array([-F[0], -F[1]]) * (np.array(mode) == 0) + F * (np.array(mode) == 2)
        stuck = [i for i in (0, 1) if mode[i] == 1]
        if stuck:
            others = free - W @ tau
            tau[stuck] = np.linalg.solve(W[np.ix_(stuck, stuck)], others[stuck])
        w = free - W @ tau
        miss = max(0.0, *(abs(tau[i]) - F[i] for i in stuck), 0.0) if stuck else 0.0
        for i in (0, 1):
            if mode[i] != 1:
                miss = max(miss, -w[i] * (1 if mode[i] == 2 else -1) / W[i, i])
        if miss < best:
            best, tau_best, w_best = miss, tau, np.where([m == 1 for m in mode], 0.0, w)
    return tau_best, w_best


def twin_step(x, u, E, G, alpha, n_substeps):
    """Slow plain twin of the kernel for one run: impulse of dry friction implicit in the end velocity."""
    W = -G[np.ix_([1, 3], [1, 2])]
    for _ in range(n_substeps):
        F = np.array([alpha[i] + alpha[i + 1] * math.exp(-alpha[i + 2] * abs(x[s])) for i, s in ((0, 1), (3, 3))])
        free = E @ x + G[:, 0] * u
        tau, w = twin_friction(free[[1, 3]], W, F)
        end = free + G[:, 1:] @ tau
        for body, (angle, speed) in enumerate(((0, 1), (2, 3))):
            end[speed] = w[body]
            if w[body] == 0.0 and x[speed] == 0.0:
                end[angle] = x[angle]  # at rest all the time
        x = end
    return x


def test_the_kernel_equals_its_plain_twin(rng):
    """Oracle: the twin above, on random plants and states, at rest too; ROUND over 20 substeps."""
    plant, runs = servo.design(0.1, substep=5e-3), 60
    parameters = [random_plant(rng) for _ in range(runs)]
    delta = plant.draw({name: np.array([p[name] for p in parameters]) for name in plant.nominal}, [], 1)
    x = rng.standard_normal((runs, 5)) * [1.0, 0.5, 20.0, 5.0, 1.0]
    x[::3, 1], x[::2, 3] = 0.0, 0.0
    x[::4, 2] = x[::4, 0] * 20.0  # untwisted shaft: may stick
    x[::6, 4] = 0.0
    u = rng.uniform(-60.0, 60.0, (runs, 1)) * (rng.random((runs, 1)) < 0.7)
    ours = plant.step(0, delta, x, u, np.zeros((runs, 4))).x
    twins = [twin_step(x[i], u[i, 0], delta.E[i], delta.G[i], delta.alpha[i], 20) for i in range(runs)]
    np.testing.assert_allclose(ours, twins, atol=1e-12, **ROUND)
    assert 0 < (ours[:, 1] == 0.0).sum() < runs and 0 < (ours[:, 3] == 0.0).sum() < runs


def test_without_friction_the_plant_is_the_matrix_exponential():
    """Oracle: scipy.linalg.expm of the equations of section 4.1 over the whole sample."""
    p, x = FRICTIONLESS, np.array([0.1, -0.5, 3.0, 2.0, 0.4])
    k, rho = p["k_theta"], p["rho"]
    A = np.zeros((6, 6))
    A[0, 1] = A[2, 3] = 1.0
    A[1, :3] = np.array([-k, -p["beta_l"], k / rho]) / p["J_l"]
    A[3, [0, 2, 3, 4]] = np.array([k / rho, -k / rho**2, -p["beta_m"], p["K_t"]]) / p["J_m"]
    A[4, [3, 4, 5]] = np.array([-p["K_t"], -p["R"], 1.0]) / p["L"]
    ours = trajectory(p, [25.0], x=x)[1]
    np.testing.assert_allclose(ours, (expm(A * 0.1) @ np.append(x, 25.0))[:5], atol=1e-11)


def test_without_friction_and_inductance_the_plant_is_the_linear_one(rng):
    """Oracle: L -> 0; the difference to servo-linear is proportional to L."""
    volts, linear = rng.uniform(-100.0, 100.0, 20), servo.design_linear(0.1)
    delta, x = drawn(linear, FRICTIONLESS), np.zeros((1, 4))
    expected = [x[0]]
    for k, u in enumerate(volts):
        x = linear.step(k, delta, x, np.array([[u]]), NO_NOISE).x
        expected.append(x[0])
    off = [np.abs(trajectory(FRICTIONLESS | {"L": L}, volts)[:, :4] - expected).max() for L in (1e-4, 1e-5, 1e-6)]
    assert off[2] < 1e-4
    np.testing.assert_allclose([off[0] / off[1], off[1] / off[2]], 10.0, rtol=0.05)
