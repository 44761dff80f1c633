"""Components with memory: recorded values do not change later, and equal methods have equal results."""

from typing import NamedTuple

import numpy as np
import pytest
from simulation.test_closed_loop import RUNS, STEPS, toy_draws
from simulation.toy import Delta, Halfway, Proportional, Walk

from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.choice import serial
from rmpc_bench.engines.tasks import Task
from rmpc_bench.metrics.consistency import Nees
from rmpc_bench.metrics.tracking import Mse
from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Draws, Experiment, Scenario, own_draws
from rmpc_bench.types import Method, Motion


class Buffers:
    """Arrays that are filled again at every call; keeps one array per name."""

    def __init__(self):
        self.arrays = {}

    def refill(self, name, value):
        """Write a value into the array of this name and return the array."""
        if name not in self.arrays:
            self.arrays[name] = np.empty_like(value)
        self.arrays[name][...] = value
        return self.arrays[name]


class Reporting(Halfway):
    """The toy's estimator with P, M and an entry of info for every run, which change with k."""

    reports = {"trust": ()}

    def __init__(self, shared=False):
        self.shared = shared

    def correct(self, k, state, y):
        """Report matrices that grow with k and with the run."""
        state, estimate = super().correct(k, state, y)
        growth = np.array([[1.0 + k]]) if self.shared else (1.0 + k + np.arange(len(y))).reshape(-1, 1, 1)
        return state, estimate._replace(P=0.1 * growth, M=2.0 * growth, info={"trust": y[:, 0] + k})


class RefillingEstimator(Reporting):
    """The same estimates in arrays that are used again at the next sample."""

    def __init__(self, shared=False):
        super().__init__(shared)
        self.buffers = Buffers()

    def correct(self, k, state, y):
        """Return the same arrays at every k."""
        state, estimate = super().correct(k, state, y)
        refill = self.buffers.refill
        info = {"trust": refill("trust", estimate.info["trust"])}
        arrays = {name: refill(name, getattr(estimate, name)) for name in ("x_hat", "P", "M")}
        return state, estimate._replace(**arrays, info=info)


class Waiting(Proportional):
    """The toy's controller, which acts on the estimate of the sample before and keeps that array in its state."""

    reports = {"ahead": ()}

    def init(self, n_runs):
        """Start with an estimate of 0."""
        return np.zeros((n_runs, 1))

    def control(self, k, state, y, estimate, r):
        """Act on the old estimate."""
        _, command = super().control(k, None, y, estimate._replace(x_hat=state), r)
        return estimate.x_hat, command._replace(info={"ahead": command.u[:, 0] + k})


class RefillingController(Waiting):
    """The same inputs in an array that is used again."""

    def __init__(self):
        super().__init__()
        self.buffers = Buffers()

    def control(self, k, state, y, estimate, r):
        """Return the same arrays at every k."""
        state, command = super().control(k, state, y, estimate, r)
        refill = self.buffers.refill
        return state, command._replace(u=refill("u", command.u), info={"ahead": refill("ahead", command.info["ahead"])})


class RefillingPlant(Walk):
    """The same states and outputs in arrays that are used again; it also writes into its arguments."""

    def __init__(self):
        super().__init__()
        self.buffers = Buffers()

    def step(self, k, delta, x, u, w):
        """Return the same array at every k."""
        moved = self.buffers.refill("x", super().step(k, delta, x, u, w).x)
        x[...], u[...] = np.nan, np.nan
        return Motion(moved, delta.status)

    def output(self, k, delta, x, v):
        """Return the same array at every call, with and without noise."""
        return self.buffers.refill("y", super().output(k, delta, x, v))


PLAIN = (Walk, Reporting, Waiting)


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("refilling", [(RefillingPlant, *PLAIN[1:]), (Walk, RefillingEstimator, Waiting),
                                       (Walk, Reporting, RefillingController),
                                       (RefillingPlant, RefillingEstimator, RefillingController)])  # fmt: skip
def test_every_recorded_field_is_a_copy(refilling, shared, rng):
    """Oracle: the same components with new arrays at every k, bit for bit."""
    draws, r, records = toy_draws(rng, [0.9, 0.8, 0.7, 0.9, 0.6]), rng.standard_normal((STEPS + 2, 1)), []
    for plant, estimator, controller in (PLAIN, refilling):
        method = Method("M", estimator(shared), controller())
        kept = {"with_P": True, "with_M": True, "info": ("trust", "ahead")}
        records.append(simulate(plant(), method, draws, r, STEPS, **kept)[0])
    ours, theirs = records
    for name in ("x", "y", "x_hat", "u", "r", "P", "M"):
        np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name), err_msg=name)
    for name in ("trust", "ahead"):
        np.testing.assert_array_equal(theirs.info[name], ours.info[name], err_msg=name)
    assert len(np.unique(ours.P)) > STEPS  # an overwritten P would be the same at every k
    np.testing.assert_array_equal(Nees().evaluate(theirs), Nees().evaluate(ours))


def test_a_controller_that_changes_its_reference_does_not_change_the_record(rng):
    """Oracle: the reference as it was given."""

    class Greedy(Proportional):
        def control(self, k, state, y, estimate, r):
            result = super().control(k, state, y, estimate, r)
            r[0] = 99.0
            return result

    r = rng.standard_normal((STEPS + 2, 1))
    given = r.copy()
    record, _ = simulate(Walk(), Method("M", Halfway(), Greedy()), toy_draws(rng, [0.9] * RUNS), r, STEPS)
    np.testing.assert_array_equal(record.r, given[: STEPS + 1])


class Memory(NamedTuple):
    """A record with memory: the parameter and the number of steps so far."""

    a: np.ndarray
    steps: np.ndarray
    status: np.ndarray


class Tiring(Walk):
    """A plant that writes into its record: its parameter decreases with the number of steps."""

    def draw(self, parameters, rngs, n_steps):
        """Add a counter."""
        a, status = super().draw(parameters, rngs, n_steps)
        return Memory(a, np.zeros(len(a)), status)

    def step(self, k, delta, x, u, w):
        """Count the step."""
        delta.steps[...] += 1.0
        return super().step(k, Delta(delta.a / delta.steps, delta.status), x, u, w)


class Simulator:
    """An object with memory that cannot be copied."""

    def __init__(self, memory):
        self.memory = memory

    def __deepcopy__(self, memo):
        raise RuntimeError("this simulator cannot be copied")


class Outside(Tiring):
    """The same plant with its memory in an object."""

    def draw(self, parameters, rngs, n_steps):
        """Start a simulator."""
        return {"simulators": [Simulator(super().draw(parameters, rngs, n_steps))]}

    def step(self, k, delta, x, u, w):
        """Use the simulator."""
        return super().step(k, delta["simulators"][0].memory, x, u, w)


class Greedy(Walk):
    """A plant that writes into all its arguments."""

    def step(self, k, delta, x, u, w):
        """Move, then overwrite."""
        motion = super().step(k, delta, x, u, w)
        w[...], delta.a[...] = 7.0, 0.5 * delta.a
        return motion


def scenario():
    """Noise, an uncertain parameter's nominal value and a random initial state."""
    noise = (gaussian(1, std=0.1),)
    return Scenario(seed=3, uncertainty={}, parameters={}, x0=np.ones(1), x0_noise=noise, process=noise,
                    measurement=noise, reference=constant(1, value=2.0))  # fmt: skip


@pytest.mark.parametrize("plant", [Tiring, Outside, Greedy])
def test_equal_methods_of_a_plant_with_memory_have_equal_results(plant):
    """Oracle: two methods with the same components; in one block they had 6.78 and 7.83 on a pendulum."""
    methods = tuple(Method(name, Halfway(), Proportional()) for name in ("first", "second", "third"))
    experiment = Experiment(plant(), methods, scenario(), (Mse(),), n_runs=4, n_steps=20)
    done = list(serial([experiment], TaskQueue([Task(name, 0, 4) for name in ("first", "second", "third")])))
    first, second, third = (each.block.metrics for each in done)
    assert len(np.unique(first)) == 4
    np.testing.assert_array_equal(second, first)
    np.testing.assert_array_equal(third, first)


def test_read_only_arrays_are_shared_and_all_others_are_copied():
    """Oracle: memory; an array broadcast to all runs cannot be written into."""
    fixed = np.broadcast_to(np.ones(3), (4, 3))
    given = ({"a": np.zeros(2), "n": 3}, [np.ones(2), "text", None], fixed)
    draws = Draws(given, np.zeros((4, 2)), *(np.zeros((4, 5, 2)) for _ in range(2)))
    own = own_draws(scenario(), Walk(), range(4), 5, draws)
    assert own.delta[2] is fixed
    pairs = [(own.delta[0]["a"], given[0]["a"]), (own.delta[1][0], given[1][0]), (own.x0, draws.x0), (own.w, draws.w)]
    for ours, theirs in [*pairs, (own.v, draws.v)]:
        np.testing.assert_array_equal(ours, theirs)
        assert not np.shares_memory(ours, theirs)
