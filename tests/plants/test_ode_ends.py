"""How a run of a differential equation ends: bounds before numbers, events, integrators that give up."""

import math

import numpy as np
import pytest
from plants.test_ode import BOUNDS, TS, drawn, moved, one_state, tanks, two_tanks

from rmpc_bench.numerics.integration import MAX_CALLS
from rmpc_bench.plants.ode import design
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.simulation.scenario import Draws
from rmpc_bench.types import DesignError, Estimate, Estimator, Journal, Method, RunInfo, Status

METHODS = ["rk4", "LSODA", "RK45", "DOP853", "Radau", "BDF"]
STEPS = 30


class Nothing(Estimator):
    """An estimator that returns 0."""

    def init(self, n_runs):
        """Keep nothing."""

    def correct(self, k, state, y):
        """Return 0."""
        n_runs = len(y)
        return state, Estimate(np.zeros((n_runs, 2)), None, None, np.zeros(n_runs, dtype=np.int8), {})

    def predict(self, k, state, u):
        """Keep nothing."""
        return state


def emptied(plant, levels):
    """Record, statuses and journal of tanks without inflow."""
    n, journal = len(levels), Journal()
    draws = Draws(drawn(plant, n), np.array(levels), np.zeros((n, STEPS + 1, 2)), np.zeros((n, STEPS + 1, 1)))
    start = RunStart(1, tuple(range(10, 10 + n)), journal)
    method = Method("M", Nothing(), Rest(1))
    record, status = simulate(plant, method, draws, np.zeros((STEPS + 1, 1)), STEPS, start=start)
    return record, status, journal


def by_math(x, u, p):
    """The tanks with the functions of one number, which raise where a level is negative."""
    q1, q2 = p.a1 * math.sqrt(2 * tanks.G * x[0]), p.a2 * math.sqrt(2 * tanks.G * x[1])
    return [(p.k * 1e-6 * u[0] - q1) / tanks.S1, (q1 - q2) / tanks.S2]


@pytest.mark.parametrize("rhs", [tanks.rhs, by_math], ids=["block", "run by run"])
@pytest.mark.parametrize("method", METHODS)
def test_a_tank_that_runs_empty_is_out_of_range_where_it_stood(rhs, method):
    """Oracle: the time in which a level drains, from its closed form sqrt(h) = sqrt(h0) - a sqrt(g / 2) t / S."""
    plant = two_tanks(ode=rhs, solver=Solver(method))
    low = BOUNDS["h1"][0]
    record, status, journal = emptied(plant, [[0.06, 0.3], [0.59, 0.3], [0.01, 0.01]])
    assert status.tolist() == [Status.OUT_OF_RANGE, Status.OK, Status.OUT_OF_RANGE]
    assert np.isfinite(record.x).all() and (record.x >= low).all()
    rate = tanks.PARAMETERS["a1"] * math.sqrt(tanks.G / 2) / tanks.S1
    for run, level in ((10, 0.06), (12, 0.01)):
        empty = (math.sqrt(level) - math.sqrt(low)) / rate
        failure = journal.failures[run]
        k = failure.k
        assert k * 5.0 <= empty <= (k + 1) * 5.0 + 1e-9
        np.testing.assert_array_equal(record.x[run - 10, k:], np.tile(record.x[run - 10, k], (STEPS + 1 - k, 1)))
        found = float(failure.message.removeprefix("h1 left its bounds [0.0001, 0.6] m at ").removesuffix(" s"))
        # One step of the integrator later, at most.
        assert empty - 1e-3 <= found <= (k + 1) * 5.0
        assert (failure.component, failure.status) == ("plant", Status.OUT_OF_RANGE)
    assert sorted(journal.failures) == [10, 12]


def test_without_bounds_the_same_run_diverges():
    """Oracle: the root of a negative level, which is not a number."""
    free = two_tanks(bounds={"h1": (-1.0, 1.0)}, solver=Solver(substeps=8))
    assert emptied(free, [[0.01, 0.01]])[1].tolist() == [Status.DIVERGED]


def test_process_noise_may_push_a_state_out():
    """Oracle: the level plus the noise; the failure is noted at the sample it reaches."""
    plant, journal = two_tanks(), Journal()
    runs = RunInfo((4, 7), (), np.ones(2, dtype=bool), journal)
    x = np.array([tanks.steady_state(8.0, tanks.PARAMETERS)] * 2)
    delta = plant.start(drawn(plant, 2), x, runs)
    found = plant.step(3, delta, x, np.full((2, 1), 8.0), np.array([[0.0, 0.0], [0.0, 1.0]]))
    assert found.status.tolist() == [Status.OK, Status.OUT_OF_RANGE]
    assert journal.failures[7].message == "h2 left its bounds [0.0001, 0.6] m at 20 s"
    assert [*journal.failures] == [7]


def test_a_run_that_starts_outside_is_noted():
    """Oracle: the initial level, and a parameter that is no number."""
    plant, journal = two_tanks(), Journal()
    runs = RunInfo((4, 7), (), np.ones(2, dtype=bool), journal)
    x, a1 = np.array([[0.1, 0.9], [0.1, 0.1]]), np.array([7.1e-6, np.nan])
    plant.start(drawn(plant, 2, a1=a1), x, runs)
    assert journal.failures[4].message == "h2 starts outside its bounds [0.0001, 0.6] m"
    assert journal.failures[7].message == "a parameter is not a finite number"


def test_inputs_are_limited_and_counted():
    """Oracle: np.clip; runs that have failed are not counted, and are limited all the same."""
    plant, journal = two_tanks(), Journal()
    runs = RunInfo((0, 1, 2, 3), (), np.array([True, True, True, False]), journal)
    u = np.array([[50.0], [-3.0], [8.0], [99.0]])
    for _ in range(2):
        np.testing.assert_array_equal(plant.applied_inputs(u, runs), np.clip(u, 0.0, 30.0))
    # A run that has failed keeps its state.
    x = np.full((4, 2), 0.1)
    found = plant.step(0, plant.start(drawn(plant, 4), x, runs), x, np.clip(u, 0.0, 30.0), np.zeros((4, 2)))
    np.testing.assert_array_equal(found.x, [*moved(plant, x, np.clip(u, 0.0, 30.0)).x[:3], x[3]])
    assert journal.warnings == {"input pump limited to [0, 30] ml/s": 4}


def test_runs_that_have_failed_are_not_called_any_more():
    """Oracle: the calls that are counted, run by run."""
    calls = []

    def counted(x, u, p):
        calls.append(u[0])
        return [u[0] if x[0] > -9 else 0.0]

    plant = one_state(counted, solver=Solver(substeps=1))
    runs = RunInfo((0, 1), (), np.array([True, False]), Journal())
    x = np.zeros((2, 1))
    delta = plant.start(drawn(plant, 2), x, runs)
    calls.clear()
    plant.step(0, delta, x, np.array([[1.0], [2.0]]), x)
    assert calls == [1.0] * 4


def falling(x, u, p):
    """Height and velocity of a ball."""
    return [x[1], -9.81]


def floor(x, u, p):
    """Height above the floor."""
    return x[0]


floor.direction = -1
floor.reset = lambda x, u, p: [0.0, -0.8 * x[1]]


def ball(events, **keys):
    """Return a ball that falls."""
    given = {"states": ["height", "speed"], "x0": [1.0, 0.0], "solver": Solver("RK45"), **keys}
    return design(TS, 20, ode=falling, events=events, **given)


def test_an_event_replaces_the_state():
    """Oracle: the closed form of a ball that loses a fifth of its speed at each impact."""
    plant, x = ball(floor), np.array([[1.0, 0.0]])
    found = []
    for k in range(15):
        x = moved(plant, x, np.zeros((1, 0)), k).x
        found.append(x[0])
    impact, speed = math.sqrt(2 / 9.81), math.sqrt(2 * 9.81)
    starts, speeds = [impact], [0.8 * speed]
    while starts[-1] < 1.6:
        starts.append(starts[-1] + 2 * speeds[-1] / 9.81)
        speeds.append(0.8 * speeds[-1])
    for k, (height, _) in enumerate(found):
        t = (k + 1) * TS
        n = sum(start <= t for start in starts)
        exact = 1 - 9.81 * t**2 / 2
        if n:
            past = t - starts[n - 1]
            exact = speeds[n - 1] * past - 9.81 * past**2 / 2
        # Times of impact to the tolerance of the root, times the speed.
        assert height == pytest.approx(exact, abs=1e-7)


def test_an_event_ends_the_run_with_a_word():
    """Oracle: the time of the fall; its direction counts."""

    def low(t, x, u, p):
        return x[0] - 0.5

    low.word = "below half"
    plant, journal = ball([low, floor]), Journal()
    runs = RunInfo((5,), (), np.ones(1, dtype=bool), journal)
    x = np.array([[1.0, 0.0]])
    delta = plant.start(drawn(plant, 1), x, runs)
    for k in range(5):
        motion = plant.step(k, delta, x, np.zeros((1, 0)), np.zeros((1, 2)))
        if motion.status[0]:
            break
        x = motion.x
    assert (k, motion.status[0]) == (3, Status.OUT_OF_RANGE)
    assert journal.failures[5].message == f"below half at {math.sqrt(1 / 9.81):.6g} s"
    low.direction = 1
    upwards = ball([low, floor])
    assert moved(upwards, np.array([[0.6, -3.0]]), np.zeros((1, 0))).status.tolist() == [Status.OK]


def test_events_that_accumulate_end_the_run():
    """Oracle: infinitely many impacts within a sample; the sum of their times is finite."""
    found = moved(ball(floor), np.array([[0.0, 0.05]]), np.zeros((1, 0)))
    assert found.status.tolist() == [Status.TOO_MANY_EVENTS]


def test_events_need_an_integrator_that_finds_them():
    """Oracle: rk4 has equal steps."""
    with pytest.raises(DesignError, match="need a method of solve_ivp") as caught:
        ball(floor, solver=Solver())
    assert caught.value.parameter == "events"


@pytest.mark.parametrize("method", METHODS[1:])
def test_a_solution_that_explodes_ends(method):
    """Oracle: x' = x^2 is infinite at t = 1 / x0; some integrators would never return."""
    plant = design(
        3.0, 2, ode=lambda x, u, p: [x[0] ** 2 + 0 * math.cos(x[0])], states=1, x0=0.01, solver=Solver(method)
    )
    found = moved(plant, np.array([[1.0], [0.1]]), np.zeros((2, 0)))
    # LSODA returns something that is not a number, with which a run is `diverged`.
    assert found.status[0] == Status.NOT_CONVERGED or (method == "LSODA" and np.isnan(found.x[0, 0]))
    assert found.status[1] == Status.OK
    assert found.x[1, 0] == pytest.approx(0.1 / (1 - 0.3), rel=1e-6)
    assert MAX_CALLS == 50_000


def test_an_exception_of_the_user_is_passed_on():
    """Oracle: the exception; those of the integrator are statuses."""

    def raising(x, u, p):
        if x[0] > 0.9:
            raise KeyError("mine")
        return [1.0]

    for method in METHODS:
        with pytest.raises(KeyError, match="mine"):
            moved(one_state(raising, solver=Solver(method), x0=0.0),
                  np.array([[0.85]]), np.zeros((1, 1)))  # fmt: skip
