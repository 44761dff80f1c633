"""Plants written for one run: a memory, own random numbers, failures."""

import numpy as np
import pytest
from components.one_run import MODEL, N, TwoStates, designed, experiment, kalman, simulated
from conftest import EXACT

from rmpc_bench.components.single_run import single_run
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.types import Method, OutOfRange, Status


@single_run
class Simulator:
    """The two states in an object that keeps them, as a simulator does."""

    nx, nu, ny = 2, 1, 1
    y_unit = "m"
    nominal = {"gain": 1.0}

    def start(self, p, x0):
        """Keep the state."""
        self.x, self.gain = x0, p.gain

    def step(self, u, w):
        """Move; in place, so that the same array is returned at every sample."""
        self.x[:] = self.gain * (MODEL.A @ self.x) + MODEL.B @ u + w
        return self.x

    def output(self, x):
        """Measure the first state."""
        return x[:1]


def test_a_plant_of_one_run():
    """Oracle: the batch plant, bit for bit up to the order of sums of two terms."""
    made = experiment(plant=designed("plants", Simulator))
    mine, theirs = simulated(made), simulated(experiment())
    assert not mine[0].any()
    for name in ("x", "y", "u", "x_hat"):
        np.testing.assert_allclose(mine[2][name], theirs[2][name], rtol=1e-12, atol=1e-13)  # matmul against einsum
    assert (made.plant.nw, made.plant.nv, made.plant.y_unit, made.plant.nominal) == (2, 1, "m", {"gain": 1.0})


@single_run
class Wandering(Simulator):
    """A plant with its own random numbers and a memory of all inputs."""

    def start(self, p, x0, rng):
        """Keep the generator."""
        super().start(p, x0)
        self.rng, self.total = rng, 0.0

    def step(self, u, w, k):
        """Add what was drawn, and the mean of all inputs so far."""
        self.total += u[0]
        return super().step(u, w) + 0.1 * self.rng.standard_normal(2) + 0.01 * self.total / (k + 1)


def test_memory_and_random_numbers_belong_to_the_run():
    """Oracle: the same bits in any block."""
    made = experiment(plant=designed("plants", Wandering), n_runs=7)
    whole = simulated(made)[2]["x"]
    for block in (1, 3):
        np.testing.assert_array_equal(simulated(made, block)[2]["x"], whole)


def test_memory_belongs_to_the_method():
    """Oracle: two equal methods of a block have equal runs; with one object for both the second begins at the end."""
    made = experiment(plant=designed("plants", Wandering))
    draws = made.scenario.draw(made.plant, range(6), N)
    first, second = (
        simulate_block(made, Method(name, kalman(), made.methods[0].controller), range(6), draws) for name in "ab"
    )
    np.testing.assert_array_equal(first.traces["x"], second.traces["x"])


@single_run
class Quiet(Simulator):
    """A plant without process noise, which adds the measurement noise itself."""

    def step(self, u):
        """Move."""
        return super().step(u, 0.0)

    def output(self, x, v):
        """Measure with twice the noise."""
        return x[:1] + 2.0 * v


def test_a_plant_that_asks_for_no_process_noise_has_none():
    """Oracle: nw = 0; the true output is the one without v."""
    made = experiment(plant=designed("plants", Quiet))
    assert made.plant.nw == 0
    traces = simulated(made)[2]
    np.testing.assert_allclose(traces["y"][..., 0], traces["x"][..., 0], **EXACT)
    np.testing.assert_allclose(traces["x"][:, 1], traces["x"][:, 0] @ MODEL.A.T, rtol=1e-12, atol=1e-14)  # matmul


def changed(**methods):
    """Make a plant with other methods."""
    return designed("plants", single_run(type("Mine", (Simulator,), methods)))


def _raising(k, at):
    if k == at:
        raise RuntimeError("the engine stalled")


FAILURES = {
    "step": ({"step": lambda self, u, w, k: _raising(k, 4) or self.x}, 4, "RuntimeError: the engine stalled"),
    "output": ({"output": lambda self, x, k: _raising(k, 4) or x[:1]}, 4, "RuntimeError: the engine stalled"),
    "last output": ({"output": lambda self, x, k: _raising(k, N) or x[:1]}, N, "RuntimeError: the engine stalled"),
    "start": ({"start": lambda self, x0: _raising(0, 0)}, None, "RuntimeError: the engine stalled"),
    "shape": ({"output": lambda self, x: x}, 0, "output returned 2 numbers; the plant has 1 output (k = 0)"),
    "nan": ({"step": lambda self, u, w: np.full(2, np.nan)}, 0, "step returned x with NaN or inf (k = 0)"),
    "nan of y": ({"output": lambda self, x: [np.nan]}, 0, "output returned y with NaN or inf (k = 0)"),
}


@pytest.mark.parametrize("name", FAILURES)
def test_a_failure_of_the_plant_is_a_crash_of_its_run(name):
    """Oracle: status, sample and sentence; the state keeps its last value."""
    methods, k, message = FAILURES[name]
    status, _, traces, (journal,) = simulated(experiment(plant=changed(**methods), n_runs=2))
    assert status.tolist() == [Status.CRASHED] * 2
    failure = journal.failures[1]
    assert (failure.component, failure.k, failure.message) == ("plant", k, message)
    assert failure.values["p"] == {"gain": 1.0}
    assert np.isfinite(traces["x"]).all()


def _empty():
    raise OutOfRange("the tank is empty")


def test_a_plant_says_that_it_has_left_its_range():
    """Oracle: status, sample and sentence; it is no crash, and there is no trace of the user's code."""
    plant = changed(step=lambda self, u, w, k: _empty() if k == 3 else self.x)
    status, _, traces, (journal,) = simulated(experiment(plant=plant, n_runs=2))
    assert status.tolist() == [Status.OUT_OF_RANGE] * 2
    failure = journal.failures[1]
    assert (failure.component, failure.k, failure.message, failure.trace) == ("plant", 3, "the tank is empty", "")
    np.testing.assert_array_equal(traces["x"][:, 4], traces["x"][:, 3])


def test_a_plant_has_no_key_for_held_steps():
    """Oracle: the keys of its design function."""
    import inspect

    from rmpc_bench.components.single_run import design_function

    assert list(inspect.signature(design_function("plants", Simulator)).parameters) == ["Ts", "n_steps"]


def test_p_has_the_parameters_of_the_run():
    """Oracle: the value of every run, by name and as an attribute."""
    seen = {}

    def start(self, p, x0, run):
        self.x, self.gain = x0, p["gain"]
        seen[run] = p.gain

    plant = changed(start=start)
    delta = plant.draw({"gain": np.array([0.5, 0.7])}, [], N)
    plant.start(delta, np.zeros((2, 2)), None)
    assert seen == {0: 0.5, 1: 0.7}
    assert plant.nx == TwoStates().nx
