"""Error control by halving: jumps, stiff and unstable equations, blocks, and the filters that use the same rule."""

import numpy as np
import pytest
from plants.test_ode import drawn, moved
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from rmpc_bench.estimators import extended_kalman, unscented_kalman
from rmpc_bench.models.flow import flow_of
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.numerics.integration import Tolerance, halve, rk4, sample_times
from rmpc_bench.plants.ode import design
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import Journal, RunInfo, SolverError, Status

NOISE = DesignNoise(1e-4, 1e-2)


def simulated(plant, x0, u, w):
    """States (samples, nx, runs) and statuses with given inputs (samples, runs) and process noise."""
    n, runs = u.shape
    x, delta, every = np.tile(np.array(x0, dtype=float), (runs, 1)), drawn(plant, runs), []
    status = np.zeros(runs, dtype=int)
    for k in range(n):
        found = plant.step(k, delta, x, u[k][:, None][:, : plant.nu], w[k].T)
        x, status = found.x, np.maximum(status, found.status)
        every.append(x.T)
    return np.array(every), status


def one_state(rhs, Ts, n, **keys):
    """Return a plant of one state without inputs."""
    return design(Ts, n, ode=rhs, **{"states": ["a"], "x0": 0.0, **keys})


def final(plant, n, x0=0.0):
    """Last state of one run without noise, and its status."""
    x, status = simulated(plant, [x0], np.zeros((n, 1)), np.zeros((n, 1, 1)))
    return x[-1, 0, 0], status[0]


@pytest.mark.parametrize(("Ts", "jump"), [(0.25, 7.5), (0.1, 0.3), (1 / 3, 1.0), (0.05, 2.35)])
@pytest.mark.parametrize("solver", [Solver(), Solver(substeps=1), Solver(substeps=3)])
def test_a_jump_on_a_sample_is_exact(Ts, jump, solver):
    """Oracle: the integral of a step, which is the time of the jump; three steps have three times the rounding."""
    n = round(10 / Ts)
    plant = one_state(lambda t, x, u, p: [np.where(t < jump, 1.0, 0.0) + 0.0 * x[0]], Ts, n, solver=solver)
    assert final(plant, n) == (pytest.approx(jump, rel=0, abs=5e-15 * (solver.substeps or 1)), Status.OK)
    assert not any("jump" in each for each in plant.remarks)


@pytest.mark.parametrize(("first", "last"), [(7.26, 7.33), (7.4, 99.0), (7.49, 99.0)])
def test_a_state_at_rest_may_begin_to_move_within_a_sample(first, last):
    """Oracle: the length of the interval; before it the state has no size, and its error cannot be judged by one."""
    plant = one_state(lambda t, x, u, p: [1.0 if first < t < last else 0.0], 0.25, 40)
    x, status = final(plant, 40)
    assert status == Status.OK and x == pytest.approx(min(last, 10.0) - first, abs=2 * 0.25 / 512)


def test_a_jump_within_a_sample_is_found_to_a_part_of_512_and_noted():
    """Oracle: the closed form of x' = 1 - x / 2 until 7.4 and -x / 2 from then on."""
    plant = one_state(lambda t, x, u, p: [np.where(t < 7.4, 1.0, 0.0) - 0.5 * x[0]], 0.25, 40)
    exact = 2 * (1 - np.exp(-0.5 * 7.4)) * np.exp(-0.5 * (10 - 7.4))
    assert final(plant, 40)[0] == pytest.approx(exact, rel=0, abs=3e-5)
    way = "choose a sampling time for which it falls on a sample, or accept an error of up to 1/512 of a sample"
    remark = f"a jumps or has a kink inside sample 29; {way}"
    assert remark in plant.remarks
    journal = Journal()
    delta = plant.start(
        drawn(plant, 3), np.ones((3, 1)), RunInfo((0, 1, 2), (), np.array([True, True, False]), journal)
    )
    for k in (28, 29, 30):
        plant.step(k, delta, np.ones((3, 1)), np.zeros((3, 0)), np.zeros((3, 1)))
    assert journal.warnings == {remark: 2}


@pytest.mark.parametrize("rate", [1e2, 1e3, 1e4, 1.3e4, 2e4, 1e5, 1e7])
def test_a_stiff_equation_is_right_or_has_not_converged(rate):
    """Oracle: the closed form of x' = -rate (x - cos t) on its slow solution."""

    def slow(t):
        return (rate**2 * np.cos(t) + rate * np.sin(t)) / (rate**2 + 1)

    def rhs(t, x, u, p):
        return [-rate * (x[0] - np.cos(t))]

    plant = one_state(rhs, 0.1, 8, solver=Solver(substeps=1))
    plant = type(plant)(0.1, plant.ode, plant.stepping._replace(solver=Solver(), substeps=0, scale=np.ones(1)))
    for start in (slow(0.0), 0.0):
        x, status = final(plant, 3, start)
        assert status == Status.NOT_CONVERGED or x == pytest.approx(slow(0.3), rel=0, abs=1e-5 * 0.3)
    assert status == Status.OK if rate < 1e4 else True


def test_a_run_that_cannot_be_integrated_says_where():
    """Oracle: the time at which 1 / (1 - t) is infinite, and the state an interval before."""
    plant, journal = one_state(lambda x, u, p: [x[0] ** 2], 0.3, 3, x0=0.1), Journal()
    delta = plant.start(drawn(plant, 2), np.ones((2, 1)), RunInfo((4, 5), (), np.ones(2, dtype=bool), journal))
    found = plant.step(3, delta, np.array([[1.0], [5.0]]), np.zeros((2, 0)), np.zeros((2, 1)))
    assert found.status.tolist() == [Status.OK, Status.NOT_CONVERGED]
    assert found.x[0, 0] == pytest.approx(1 / 0.7, rel=1e-6)
    message = journal.failures[5].message
    assert message.startswith("the error of rk4 is too large at t = 1.09") and "solver: {method: LSODA}" in message
    t, x = (float(message.partition(mark)[2].partition(end)[0]) for mark, end in ((" t = ", " s"), ("a = ", ",")))
    # t - 0.9 is exact up to the six digits, which 1 / (0.2 - t) makes worse.
    assert 1 / x == pytest.approx(0.2 - (t - 0.9), abs=1e-5)


@pytest.mark.parametrize(("points", "named"), [(1, 9.0), (2, 1.0)])
def test_a_model_that_cannot_be_integrated_names_the_state(points, named):
    """Oracle: 1 / x of x' = x^2 stays positive over the sample, or not; of points the first one is named."""
    dynamics = nonlinear(0.3, one_state(lambda x, u, p: [x[0] ** 2], 0.3, 3, x0=0.1), noise=NOISE).dynamics
    x, u = np.array([[1.0], [9.0], [5.0], [1.0]]), np.zeros((4, 0))
    with pytest.raises(SolverError, match=rf"integrated at x = \[{named}\], u = \[\]: .* `substeps` of the model"):
        dynamics.advance(0, x, u, 0.3, 0, points)


def test_an_unstable_equation_is_right_although_its_trial_runs_explode():
    """Oracle: the closed form; the range in the trial runs, exp(40), would allow any error."""
    plant = one_state(lambda x, u, p: [x[0] + u[0]], 1.0, 40, inputs=["f"], x0=0.3)
    x = moved(plant, np.array([[0.7]]), np.array([[-0.5]])).x[0, 0]
    assert x == pytest.approx(0.2 * np.e + 0.5, rel=3e-4)
    # Nothing moves in the trial runs: the tolerance is relative to the change.
    still = one_state(lambda x, u, p: [-np.sin(x[0])], 1.0, 40)
    exact = solve_ivp(lambda t, x: -np.sin(x), (0, 1), [1e-3], rtol=1e-12, atol=1e-18).y[0, -1]
    assert moved(still, np.array([[1e-3]]), np.zeros((1, 0))).x[0, 0] == pytest.approx(exact, rel=1e-6)


def cstr(t, x, u, p):
    """A stirred tank in minutes (Bequette): concentration and temperature."""
    r = 7.2e10 * np.exp(-8750 / x[1]) * x[0]
    return [1 - x[0] - r, 350 - x[1] + 5e4 / 239 * r + 5e4 / 23900 * (u[0] - x[1])]


def tanks(x, u, p):
    """Two tanks."""
    q1, q2 = 7.1e-6 * np.sqrt(19.62 * x[0]), 5.7e-6 * np.sqrt(19.62 * x[1])
    return [(1e-6 * u[0] - q1) / 2.8e-3, (q1 - q2) / 2.8e-3]


def pendulum(x, u, p):
    """A pendulum from its upright position."""
    return [x[1], 9.81 * np.sin(x[0]) - 0.2 * x[1] + u[0]]


def van_der_pol(x, u, p):
    """A relaxation oscillator."""
    return [x[1], 20 * (1 - x[0] ** 2) * x[1] - x[0] + u[0]]


# rhs, Ts, samples, x(0), bounds of u, steps of the reference, largest measured error relative to the range
TABLE = {
    "tanks": (tanks, 3.0, 100, [0.065, 0.1], (8, 30), 64, 5e-9),
    "cstr": (cstr, 0.05, 100, [0.5, 350.0], (290, 310), 512, 2e-5),
    "ignition": (cstr, 0.05, 100, [0.5, 350.0], (280, 370), 512, 5e-5),
    "pendulum": (pendulum, 0.1, 100, [0.5, 0.0], (-3, 3), 512, 3e-4),
    "van der pol": (van_der_pol, 0.1, 200, [2.0, 0.0], (-1, 1), 512, 4e-5),
}


@pytest.mark.parametrize("name", ["tanks", *(pytest.param(each, marks=pytest.mark.slow) for each in [*TABLE][1:])])
def test_the_error_over_the_horizon(name):
    """Oracle: 64 or 512 equal steps per sample; five times the measured error."""
    rhs, Ts, n, x0, (low, high), steps, largest = TABLE[name]
    runs, rng = 50, np.random.default_rng(0)
    u = np.repeat(rng.uniform(low, high, (n // 10, runs)), 10, 0)
    noise = 1e-4 if name == "tanks" else 1e-3
    w = rng.standard_normal((n, 2, runs)) * noise * np.abs(np.array(x0))[:, None]
    plant = design(Ts, n, ode=rhs, states=2, inputs=["f"], x0=x0, bounds={"f": (low, high)})
    found, status = simulated(plant, x0, u, w)
    assert not status.any()
    x, exact = np.tile(np.array(x0)[:, None], runs), []
    timed = rhs if rhs is cstr else lambda t, *given: rhs(*given)
    for k in range(n):
        slope = lambda t, z, k=k: np.array(timed(t, z, u[k][None], None))  # noqa: E731
        x = rk4(slope, sample_times(k, steps, Ts), x, Ts / steps).x + w[k]
        exact.append(x)
    error = np.abs(found - exact) / np.ptp(np.array(exact), axis=(0, 2))[:, None]
    assert error.max() < 5 * largest
    # The median of a run and sample.
    assert np.median(error.max(axis=1)) < 1e-5


@pytest.mark.parametrize("rhs", [pendulum, lambda x, u, p: [float(each) for each in pendulum(x, u, p)]])
def test_a_run_has_the_same_bits_in_every_block(rng, rhs):
    """Oracle: the block of 50; the runs need one to a hundred steps."""
    plant = design(0.1, 10, ode=rhs, states=2, inputs=1, x0=[0.5, 0.0])
    x = rng.standard_normal((50, 2)) * np.logspace(-2, 1.5, 50)[:, None]
    u = rng.standard_normal((50, 1))
    whole = moved(plant, x, u).x
    for n in (1, 3, 8, 13):
        for first in (0, 17, 50 - n):
            part = slice(first, first + n)
            np.testing.assert_array_equal(moved(plant, x[part], u[part]).x, whole[part])


def fast_and_slow(rate):
    """A fast state that follows the input, and a slow one that follows it; with its matrix."""
    plant = design(0.1, 10, ode=lambda x, u, p: [rate * (u[0] - x[0]), x[0] - x[1]], states=2, inputs=1, x0=[0.0, 0.0])
    return plant, np.array([[-rate, 0.0], [1.0, -1.0]])


def test_points_of_a_run_use_the_same_intervals():
    """Oracle: all alike, each is itself alone; two of different runs do not touch each other."""
    plant = design(0.3, 10, ode=van_der_pol, states=2, inputs=1, x0=[2.0, 0.0])
    flow = flow_of(nonlinear(0.3, plant, noise=NOISE))
    x = np.array([[[2.0, 0.0], [1.2, 5.0]], [[0.1, 1.0], [0.1, 1.0]], [[1.2, 5.0], [1.2, 5.0]]])
    u = np.zeros((3, 1))
    together = flow.advance_points(0, x, u)
    alone = flow.advance(0, x.reshape(6, 2), np.zeros((6, 1))).reshape(3, 2, 2)
    np.testing.assert_array_equal(together[1:], alone[1:])
    # The second point needs shorter intervals than the first.
    assert (together[0, 0] != alone[0, 0]).any()
    np.testing.assert_array_equal(flow.advance_points(0, x[:1], u[:1]), together[:1])


@pytest.mark.parametrize(
    ("rate", "numba"), [(1.0, False), (30.0, False), (100.0, False), (500.0, False), (100.0, True)]
)
def test_a_fast_state_at_rest_does_not_spoil_the_differences(rate, numba):
    """Oracle: the matrix exponential; the first point has no error, whatever the step."""
    plant, A = fast_and_slow(rate)
    model = nonlinear(0.1, plant, noise=NOISE, numba=numba)
    for x in ([0.0, 0.0], [1.0, 0.5]):
        np.testing.assert_allclose(model.F(x, x[:1]), expm(0.1 * A), atol=2e-5)
    points = np.array([[[0.0, 0.0], [3.0, 0.0], [0.0, -2.0]]])
    moved = flow_of(model).advance_points(0, points, np.zeros((1, 1)))
    np.testing.assert_allclose(moved, points @ expm(0.1 * A).T, atol=1e-4)


@pytest.mark.parametrize(
    ("variance", "right", "numba"), [(9.0, 0.9001, False), (4.0, 0.8001, False), (9.0, 0.9001, True)]
)
@pytest.mark.long
def test_points_far_from_the_estimate_decide_too(variance, right, numba):
    """Oracle: x / sqrt(1 + 2 Ts x^2) of the sigma points +-sqrt(P), for x' = -x^3."""
    plant = design(0.5, 10, ode=lambda x, u, p: [u[0] - x[0] ** 3], states=1, inputs=1, x0=[0.0])
    model = nonlinear(0.5, plant, noise=DesignNoise(1e-4, 1.0), numba=numba)
    estimator = unscented_kalman.design(
        model, 2, x0=np.zeros(1), P0=np.array([[variance]]), use_y0=False, alpha=1.0, kappa=0.0
    )
    state, _ = estimator.correct(0, estimator.init(1), np.zeros((1, 1)))
    _, estimate = estimator.correct(1, estimator.predict(0, state, np.zeros((1, 1))), np.full((1, 1), np.nan))
    assert estimate.P.item() == pytest.approx(right, abs=1e-4)


@pytest.mark.parametrize("numba", [False, True])
@pytest.mark.long
def test_the_jacobian_of_a_model_is_smooth(numba):
    """Oracle: the variational equation at a tight tolerance; own intervals would err by 1e-6 over the step."""
    keys = {"ode": lambda x, u, p: [x[1], 20 * (1 - x[0] ** 2) * x[1] - x[0] + u[0]], "states": 2, "inputs": 1}
    plant = design(0.1, 10, x0=[2.0, 0.0], **keys)
    model, x = nonlinear(0.1, plant, noise=NOISE, numba=numba), np.array([1.1, 2.0])

    def both(t, z):
        J = np.array([[0, 1], [-40 * z[0] * z[1] - 1, 20 * (1 - z[0] ** 2)]])
        return [*van_der_pol(z[:2], [0.0], None), *(J @ z[2:].reshape(2, 2)).ravel()]

    exact = solve_ivp(both, (0, 0.1), [*x, 1, 0, 0, 1], "DOP853", rtol=1e-12, atol=1e-13).y[2:, -1].reshape(2, 2)
    np.testing.assert_allclose(model.F(x, [0.0]), exact, rtol=2e-5, atol=1e-5)
    np.testing.assert_allclose(model.f(x, [0.0]), nonlinear(0.1, plant, noise=NOISE).f(x, [0.0]), rtol=1e-12)


def test_a_filter_is_that_of_many_substeps(rng):
    """Oracle: the extended filter with 100 substeps."""
    plant = design(0.1, 5, ode=van_der_pol, states=2, inputs=1, x0=[2.0, 0.0])
    y, found = rng.standard_normal((5, 3, 2)), []
    for keys in ({}, {"substeps": 100}):
        estimator = extended_kalman.design(nonlinear(0.1, plant, noise=NOISE, **keys), 5, x0=np.ones(2), P0=np.eye(2))
        state = estimator.init(3)
        for k in range(5):
            state, estimate = estimator.correct(k, state, [2.0, 0.0] + 0.01 * y[k])
            state = estimator.predict(k, state, np.zeros((3, 1)))
        found.append(np.concatenate([estimate.x_hat, estimate.P.reshape(3, 4)], axis=1))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-4, atol=1e-6)


def test_the_intervals_of_a_bisection():
    """Oracle: the times at which the slope is asked, which lie strictly within the sample."""
    asked = []

    def slope(t, x):
        asked.append(t)
        return np.where(t < 0.3, 1.0, 0.0) * np.ones_like(x)

    end = halve(lambda runs: slope, 2, 0.1, np.zeros((1, 1)), Tolerance(1e-7, np.ones(1)))
    assert (min(asked), max(asked)) == ((2 + 1e-9) * 0.1, (3 - 1e-9) * 0.1)
    # The end of sample 2 is 0.30000000000000004.
    assert end.x[0, 0] == pytest.approx(0.1, abs=5e-16) and end.steps.tolist() == [3]
