"""Runs side by side against the simulation step by step, bit for bit: failures, sizes and special numbers."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from loaded_configs import loaded
from simulation.test_linear_loop import STEPS, Given, assert_same_bits, compared, random_filter, random_plant

from rmpc_bench.controllers.mpc_law import Mpc
from rmpc_bench.controllers.state_feedback import Lqr
from rmpc_bench.estimators.gain_schedule import GainScheduleFilter
from rmpc_bench.metrics.estimation import EstimationMse
from rmpc_bench.metrics.tracking import Mse
from rmpc_bench.models.uncertain_system import uncertain_system
from rmpc_bench.plants import servo
from rmpc_bench.plants.uncertain_linear import UncertainLinear, Uncertainty
from rmpc_bench.simulation import closed_loop
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.simulation.linear_loop import applies, compiled_loop
from rmpc_bench.simulation.open_loop import OpenLoop, Rest
from rmpc_bench.simulation.scenario import Draws
from rmpc_bench.simulation.state_range import LARGEST, StateRange
from rmpc_bench.types import Command, CompiledLaw, Controller, DesignError, Method, Metric, OperatingPoint, Status

LANES = 32
COUNTS = (1, LANES - 1, LANES, LANES + 1, 2 * LANES + 1)
ROWS = (0, LANES - 1, LANES)
OK, DIVERGED, OUT_OF_RANGE = Status.OK, Status.DIVERGED, Status.OUT_OF_RANGE


def draws_of(rng, plant, runs, noise=0.1):
    """Random inputs of the runs."""
    delta = plant.draw({}, [np.random.default_rng(int(rng.integers(1e9))) for _ in range(runs)], STEPS)
    w, v = (noise * rng.standard_normal((runs, STEPS + 1, n)) for n in (plant.nw, plant.nv))
    return Draws(delta, rng.standard_normal((runs, plant.nx)), w, v)


def scalar_loop(law=None, L=0.5):
    """A stable plant with one state, F = 0 on one channel, and a filter that corrects."""
    one = np.ones((1, 1, 1))
    given = {"A": 0.5 * one, "B": one, "C": one, "Bw": one, "Dv": one, "H_A": 0.1 * one, "G_x": one}
    plant = UncertainLinear(uncertain_system(STEPS, given), Uncertainty("uniform", per="step"), 0.1)
    filter_ = GainScheduleFilter(np.zeros(1), 0.5 * one, one, one, 0.2 * one, L * one, one)
    return plant, Method("any", filter_, law or Rest(1))


@pytest.mark.parametrize("runs", COUNTS)
def test_numbers_of_runs(runs):
    """Fewer runs than lanes, as many, and a rest; some of them fail."""
    rng = np.random.default_rng(1)
    plant = random_plant(rng, 3, 2, 2)
    law = Mpc(rng.standard_normal((2, 3)), 0.1 * np.eye(2), rng.standard_normal((2, 4)), -0.4, 0.3, preview=3)
    method = Method("any", random_filter(rng, 3, 2, 2, STEPS + 1), law)
    r = rng.standard_normal((STEPS + 3, 2))
    status = compared(plant, method, draws_of(rng, plant, runs), r, STEPS, StateRange(largest=np.full(3, 2.0)))
    assert runs == 1 or {OK, DIVERGED} == set(status.tolist())


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize("at", ["start", "first", "middle", "last"])
def test_failures_of_one_run(at, row):
    """An initial state, the first, a later and the last measurement; the other runs go on as before."""
    rng = np.random.default_rng(5)
    plant, method = scalar_loop()
    draws = draws_of(rng, plant, LANES + 1)
    if at == "start":
        draws.x0[row] = np.nan
    else:
        draws.v[row, {"first": 0, "middle": 5, "last": STEPS}[at]] = 1e9
    status = compared(plant, method, draws, np.zeros((STEPS + 1, 1)), STEPS)
    assert status[row] == DIVERGED and (np.delete(status, row) == OK).all()


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize("k", [0, 4, STEPS - 1])
@pytest.mark.parametrize(
    ("value", "end"), [(LARGEST, DIVERGED), (np.nan, DIVERGED), (1e3, OUT_OF_RANGE), (1e7, DIVERGED)]
)
def test_failures_by_an_input(value, end, k, row):
    """An input of 1e100 ends the run by itself, a smaller one by the state that follows."""
    inputs = np.zeros((LANES + 1, STEPS, 1))
    inputs[row, k] = value
    plant, method = scalar_loop(OpenLoop(Given(inputs), STEPS))
    bounds = (-100.0, 100.0) if end == OUT_OF_RANGE else (-1e9, 1e9)
    state_range = StateRange(*(np.array([each]) for each in bounds))
    draws = draws_of(np.random.default_rng(1), plant, LANES + 1)
    status = compared(plant, method, draws, np.zeros((STEPS + 1, 1)), STEPS, state_range)
    assert status[row] == end and (np.delete(status, row) == OK).all()


def test_a_failed_run_stays_failed_and_its_estimates_go_on():
    """All runs of the first block fail at different samples, and by both reasons."""
    plant, method = scalar_loop(L=0.0)
    draws = draws_of(np.random.default_rng(3), plant, LANES + 1)
    for row in range(LANES):
        draws.w[row, row % STEPS] = 30.0 if row % 2 else 1e9
    state_range = StateRange(np.array([-20.0]), np.array([1e8]), np.array([25.0]))
    status = compared(plant, method, draws, np.zeros((STEPS + 1, 1)), STEPS, state_range)
    assert {DIVERGED, OUT_OF_RANGE} == set(status[:LANES].tolist()) and status[LANES] == OK


@pytest.mark.parametrize("make", [servo.design, servo.design_linear])
def test_reported_failures(make):
    """A plant that reports a failure at every step of some runs, in the middle and as the last one of a block."""
    rng, plant, runs = np.random.default_rng(4), make(0.1), LANES + 1
    parameters = {name: np.full(runs, value) * rng.uniform(0.8, 1.2, runs) for name, value in plant.nominal.items()}
    bad = [3, LANES - 1, LANES]
    parameters["J_l"][bad] = -1.0
    w, v = (0.01 * rng.standard_normal((runs, STEPS + 1, n)) for n in (plant.nw, plant.nv))
    draws = Draws(plant.draw(parameters, [], STEPS), 0.1 * rng.standard_normal((runs, plant.nx)), w, v)
    method = Method("any", random_filter(rng, 4, 1, 1, STEPS + 1), Rest(1))
    status = compared(plant, method, draws, np.zeros((STEPS + 1, 1)), STEPS)
    assert (status[bad] == OUT_OF_RANGE).all() and (np.delete(status, bad) == OK).all()


@pytest.mark.parametrize("nx", range(1, 18))
def test_numbers_of_states(nx):
    """Sums of one to seventeen products; from eight on they are added in another order."""
    rng = np.random.default_rng(nx)
    plant = random_plant(rng, nx, 2, 2)
    law = Lqr(0.1 * rng.standard_normal((1, 2, nx)), None, np.zeros((1, 2)))
    method = Method("any", random_filter(rng, nx, 2, 2, STEPS + 1), law)
    compared(plant, method, draws_of(rng, plant, 5), np.zeros((STEPS + 1, 2)), STEPS)


@pytest.mark.parametrize("noise", [0.0, -0.0])
@pytest.mark.parametrize("make", ["scalar", "servo"])
def test_zeros_keep_their_sign(make, noise):
    """States, inputs and noises of +0 and -0: noise that is +0 everywhere is not read, and is added all the same."""
    inputs = np.where(np.arange(STEPS) % 2, 0.0, -0.0)[None, :, None] * np.ones((3, 1, 1))
    plant, method = scalar_loop(OpenLoop(Given(inputs), STEPS))
    draws = draws_of(np.random.default_rng(0), plant, 3)
    if make == "servo":
        plant = servo.design_linear(0.1)
        parameters = {name: np.full(3, value) for name, value in plant.nominal.items()}
        draws = Draws(plant.draw(parameters, [], STEPS), np.zeros((3, 4)), *np.zeros((2, 3, STEPS + 1, 4)))
        draws = draws._replace(v=draws.v[:, :, :1])
    draws = draws._replace(x0=np.where(draws.x0 > 0.0, 0.0, -0.0), w=noise * abs(draws.w), v=noise * abs(draws.v))
    compared(plant, method, draws, np.zeros((STEPS + 1, 1)), STEPS)


@pytest.mark.parametrize("name", ["x0", "w", "v"])
def test_what_is_not_a_number_stays_in_its_run(name):
    """NaN in a state, a process noise and a measurement."""
    plant, method = scalar_loop()
    draws = draws_of(np.random.default_rng(2), plant, LANES + 1)
    getattr(draws, name)[LANES - 1] = np.nan
    status = compared(plant, method, draws, np.zeros((STEPS + 1, 1)), STEPS)
    assert status[LANES - 1] == DIVERGED and (np.delete(status, LANES - 1) == OK).all()


@dataclass(frozen=True, eq=False)
class OwnReference(Controller):
    """u(k) = u(k-1) - K_u u(k-1) + given(k) - K_x x_hat(k), limited, with a term of its own for every run."""

    given: np.ndarray
    K_x: np.ndarray
    preview = 0
    has_compiled_form = True

    def compiled_form(self, r, n_steps, runs):
        """Return the same law as arrays."""
        return CompiledLaw(self.given, self.K_x, np.full((1, 1), 0.25), low=-0.4, high=0.5)

    def init(self, n_runs):
        """Start from zero."""
        return np.zeros((n_runs, 1))

    def control(self, k, state, y, estimate, r):
        """Return the input, which is the next state."""
        u = ((state - 0.25 * state) + self.given[:, k]) - self.K_x[k] * estimate.x_hat
        u = np.clip(u, -0.4, 0.5)
        return u, Command(u, np.zeros(len(u), np.int8), {})

    def applied(self, k, state, u):
        """Keep the input."""
        return u


def test_own_reference_of_every_run():
    """A term of the law that differs from run to run, with gains over time."""
    rng = np.random.default_rng(8)
    law = OwnReference(rng.standard_normal((LANES + 1, STEPS, 1)), rng.standard_normal((STEPS, 1, 1)))
    plant, method = scalar_loop(law)
    compared(plant, method, draws_of(rng, plant, LANES + 1), np.zeros((STEPS + 1, 1)), STEPS)


@pytest.mark.parametrize("samples", [1, STEPS + 1])
@pytest.mark.parametrize("has_point", [False, True])
def test_operating_point_and_gains_over_time(has_point, samples):
    """A law around an operating point, with constant gains and with gains over time."""
    rng = np.random.default_rng(9)
    plant = random_plant(rng, 4, 2, 3)
    point = OperatingPoint(*(rng.standard_normal(n) for n in (4, 2, 3))) if has_point else None
    law = Lqr(0.2 * rng.standard_normal((samples, 2, 4)), None, rng.standard_normal((samples, 2)), point=point)
    method = Method("any", random_filter(rng, 4, 2, 3, STEPS + 1), law)
    compared(plant, method, draws_of(rng, plant, LANES + 1), np.zeros((STEPS + 1, 3)), STEPS)


def test_signals_that_nobody_reads_have_no_rows():
    """The others are the same."""
    plant, method = scalar_loop()
    draws, r = draws_of(np.random.default_rng(0), plant, LANES + 1), np.zeros((STEPS + 1, 1))
    whole, status = compiled_loop(plant, method, draws, r, STEPS)
    part, other = compiled_loop(plant, method, draws, r, STEPS, needed=("u",))
    assert_same_bits(status, other)
    assert_same_bits(part.y, whole.y)
    assert_same_bits(part.u, whole.u)
    assert part.x.shape == part.x_hat.shape == (0, STEPS + 1, 1)


@dataclass(frozen=True, kw_only=True)
class Own(Metric):
    """The largest product of all signals; a metric of a user, which does not say what it reads."""

    name: str = "own"

    def evaluate(self, record):
        """Multiply."""
        return (record.y[:, :-1, 0] * record.x[:, :-1, 0] * record.x_hat[:, :-1, 0] * record.u[:, :, 0]).max(axis=1)


@dataclass(frozen=True, kw_only=True)
class Modest(Own):
    """The same, which says that it reads less."""

    reads = ("y", "x")


@dataclass(frozen=True, kw_only=True)
class Effort(Mse):
    """A metric of a user, derived from a built-in one that reads y alone."""

    name: str = "effort"

    def evaluate(self, record):
        """Add the inputs and the states of a changed record."""
        return (
            super().evaluate(record)
            + np.abs(record.u).sum(axis=(1, 2))
            + record._replace(y=record.x).y.sum(axis=(1, 2))
        )


@dataclass(frozen=True, kw_only=True)
class Hidden(Effort):
    """The same, which says that it reads less, and takes the rest from a changed record."""

    reads = ("y", "u")

    def evaluate(self, record):
        """Take a signal that is not there."""
        return record._replace(y=2.0 * record.y).x[:, 0, 0]


def experiment_with(*metrics):
    """Linear servomechanism with other metrics, without records."""
    experiment = loaded("zenere2018/sim1").experiment
    return replace(experiment, metrics=metrics, recording=experiment.recording._replace(n_runs=0, ensemble=False))


@pytest.mark.parametrize("metrics", [(Mse(),), (Own(),), (Mse(), EstimationMse()), (Effort(),)])
def test_metrics_are_the_same_either_way(metrics, monkeypatch):
    """With and without signals that nobody reads, and of the simulation step by step."""
    experiment = experiment_with(*metrics)
    method = next(each for each in experiment.methods if applies(experiment, each))
    fast = simulate_block(experiment, method, range(LANES + 1))
    monkeypatch.setattr(closed_loop, "applies", lambda experiment, method: False)
    assert_same_bits(fast.metrics, simulate_block(experiment, method, range(LANES + 1)).metrics)


@pytest.mark.parametrize("is_compiled", [True, False])
@pytest.mark.parametrize(("metric", "signal"), [(Modest(), "x_hat"), (Hidden(name="own"), "x")])
def test_a_metric_that_reads_more_than_it_says(metric, signal, is_compiled, monkeypatch):
    """The error names the metric and the signal."""
    experiment = experiment_with(metric)
    monkeypatch.setattr(closed_loop, "applies", lambda experiment, method: is_compiled)
    with pytest.raises(DesignError, match=f"metric 'own' reads {signal}, which its `reads` does not contain"):
        simulate_block(experiment, experiment.methods[0], range(2))
