"""The loop with uncertain plants: oracle estimators, measurements, recorded covariances, and no input."""

from typing import NamedTuple

import numpy as np
import pytest
from plants.uncertain_twin import NAMES, SIZES, random_given, walk
from simulation.toy import Halfway, Walk

from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.plants.uncertain_linear import Uncertainty, design
from rmpc_bench.simulation.closed_loop import simulate, simulate_block
from rmpc_bench.simulation.ensemble import joined
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Draws, Experiment, Recording, Scenario
from rmpc_bench.types import Command, Controller, Estimate, Estimator, Method, Status

RUNS, STEPS = 4, 6


class Memory(NamedTuple):
    """The last measurement."""

    y: np.ndarray


class Spy(Estimator):
    """An estimator that keeps its arguments; its covariance is shared, per run, missing or missing at times."""

    def __init__(self, nx, ny, kind="none"):
        self.nx, self.ny, self.kind, self.seen, self.inputs, self.disclosed = nx, ny, kind, [], [], []

    def init(self, n_runs, *disclosed):
        """Keep what is disclosed."""
        self.disclosed.append(disclosed)
        return Memory(np.zeros((n_runs, self.ny)))

    def correct(self, k, state, y):
        """Keep the measurement."""
        self.seen.append(y)
        P = {"shared": k * np.eye(self.nx), "run": (k + np.arange(len(y)))[:, None, None] * np.eye(self.nx)}
        P["sometimes"] = None if k == 2 else P["shared"]
        status = np.zeros(len(y), dtype=np.int8)
        return Memory(y), Estimate(np.zeros((len(y), self.nx)), P.get(self.kind), None, status, {})

    def predict(self, k, state, u):
        """Keep the input."""
        self.inputs.append(u)
        return state


class Oracle(Spy):
    """A spy that is an oracle estimator."""

    knows_uncertainty = True


class Uninformed(Spy):
    """A spy that declares that it is no oracle estimator."""

    knows_uncertainty = False


class Shaker(Controller):
    """A controller that shakes the plant by a known input."""

    preview = 0

    def __init__(self, u):
        self.u = u

    def init(self, n_runs):
        """Nothing to remember."""

    def control(self, k, state, y, estimate, r):
        """Return the input of k."""
        assert r.shape[0] == 0
        return None, Command(self.u[:, k], np.zeros(len(y), dtype=np.int8), {})


def world(rng, number=2, law=None):
    """A random plant and the random inputs of some runs."""
    given = random_given(rng, SIZES[number], STEPS)
    plant = design(0.1, STEPS, **given, uncertainty=law or Uncertainty())
    delta = plant.draw({}, [np.random.default_rng((2, run)) for run in range(RUNS)], STEPS)
    shapes = ((RUNS, plant.nx), (RUNS, STEPS + 1, plant.nw), (RUNS, STEPS + 1, plant.nv))
    return given, plant, Draws(delta, *(rng.standard_normal(shape) for shape in shapes))


@pytest.mark.parametrize("number", range(4))
def test_the_estimator_gets_noisy_outputs_and_the_record_has_true_ones(number, rng):
    """Oracle: (24), (25) in plain loops; the recorded y is (C + H_C F_x G_x) x."""
    given, plant, draws = world(rng, number)
    u = rng.standard_normal((RUNS, STEPS + 1, plant.nu))
    spy = Spy(plant.nx, plant.ny)
    record, status = simulate(plant, Method("m", spy, Shaker(u)), draws, np.zeros((STEPS + 1, plant.ny)), STEPS)
    assert not status.any() and record.P is None
    seen = np.stack(spy.seen, axis=1)
    for i in range(RUNS):
        F = {c: getattr(draws.delta, f"F_{c}")[i] for c in NAMES}
        x, y = walk(given, F, draws.x0[i], u[i], draws.w[i], draws.v[i])
        np.testing.assert_allclose(record.x[i], x[:-1], rtol=1e-11, atol=1e-11)  # sums of a few numbers, 6 steps
        np.testing.assert_allclose(seen[i], y, rtol=1e-11, atol=1e-11)
        for k in range(STEPS + 1):
            _, silent = walk({name: M[k : k + 1] for name, M in given.items()}, {c: F[c][k:] for c in NAMES},
                             x[k], u[i, :1], 0 * draws.w[i, :1], 0 * draws.v[i, :1])  # fmt: skip
            np.testing.assert_allclose(record.y[i, k], silent[0], rtol=1e-11, atol=1e-11)
    np.testing.assert_array_equal(record.u, u[:, :STEPS])
    np.testing.assert_array_equal(np.stack(spy.inputs, axis=1), u[:, :STEPS])


def test_only_an_oracle_estimator_gets_the_uncertainty(rng):
    """Oracle: the arguments of `init`; the value of `knows_uncertainty` counts, not its presence."""
    _, plant, draws = world(rng)
    for kind, expected in ((Spy, ()), (Uninformed, ()), (Oracle, (draws.delta,))):
        spy = kind(plant.nx, plant.ny)
        simulate(plant, Method("m", spy, Rest(plant.nu)), draws, np.zeros((STEPS + 1, plant.ny)), STEPS)
        assert len(spy.disclosed) == 1 and len(spy.disclosed[0]) == len(expected)
        assert all(a is b for a, b in zip(spy.disclosed[0], expected, strict=True))


@pytest.mark.parametrize("kind", ["shared", "run", "none", "sometimes"])
def test_covariances_are_kept_where_every_k_has_one(kind, rng):
    """Oracle: (samples, nx, nx) shared, (runs, samples, nx, nx) per run; None if one is missing or none asked for."""
    _, plant, draws = world(rng)
    method, r = Method("m", Spy(plant.nx, plant.ny, kind), Rest(plant.nu)), np.zeros((STEPS + 1, plant.ny))
    assert simulate(plant, method, draws, r, STEPS)[0].P is None
    P = simulate(plant, method, draws, r, STEPS, with_P=True)[0].P
    k = np.arange(STEPS + 1.0)
    if kind == "shared":
        np.testing.assert_array_equal(P, k[:, None, None] * np.eye(plant.nx))
    elif kind == "run":
        np.testing.assert_array_equal(P, (np.arange(RUNS)[:, None] + k)[..., None, None] * np.eye(plant.nx))
    else:
        assert P is None
    assert P is None or P.flags.c_contiguous


def test_rest_applies_no_input(rng):
    """Oracle: the base class; u = 0 whatever is measured, also where the plant has several inputs."""
    law = Rest(2)
    assert isinstance(law, Controller) and law.preview == 0 and law.init(3) is None
    estimate = Estimate(np.ones((3, 1)), None, None, np.zeros(3, dtype=np.int8), {})
    state, command = law.control(0, None, np.full((3, 1), np.nan), estimate, np.zeros((0, 1)))
    np.testing.assert_array_equal(command.u, np.zeros((3, 2)))
    np.testing.assert_array_equal(command.status, np.full(3, Status.OK, dtype=np.int8))
    assert state is None and not command.info
    given, plant, draws = world(rng)
    spy = Spy(plant.nx, plant.ny)
    record, _ = simulate(plant, Method("m", spy, Rest(plant.nu)), draws, np.zeros((STEPS + 1, plant.ny)), STEPS)
    np.testing.assert_array_equal(record.u, np.zeros((RUNS, STEPS, plant.nu)))
    without = design(0.1, STEPS, **{**given, "B": None})
    other, _ = simulate(without, Method("m", spy, Rest(1)), draws, np.zeros((STEPS + 1, plant.ny)), STEPS)
    np.testing.assert_array_equal(record.x, other.x)


def test_a_plant_that_does_not_mix_is_simulated_as_before(rng):
    """Oracle: the toy plant, whose noises are added as they are."""
    delta = Walk().draw({"a": np.full(3, 0.5)}, [], 2)
    draws = Draws(delta, np.ones((3, 1)), rng.standard_normal((3, 4, 1)), rng.standard_normal((3, 4, 1)))
    spy = Spy(1, 1)
    record, _ = simulate(Walk(), Method("m", spy, Rest(1)), draws, np.zeros((4, 1)), 3)
    np.testing.assert_array_equal(np.stack(spy.seen, axis=1), record.x + draws.v)
    np.testing.assert_array_equal(record.x[:, 1], 0.5 * record.x[:, 0] + draws.w[:, 0])


def experiment(plant, method, **recording):
    """Runs of a plant with noise."""
    noises = {"process": (gaussian(plant.nw, std=0.5),), "measurement": (gaussian(plant.nv, std=0.5),)}
    start = {"x0": np.zeros(plant.nx), "x0_noise": (gaussian(plant.nx, std=1.0),)}
    some = Scenario(seed=9, uncertainty={}, parameters={}, reference=constant(plant.ny, value=0.0), **start, **noises)
    return Experiment(plant, (method,), some, (), 120, STEPS, Recording(**recording))


@pytest.mark.parametrize("per", ["step", "run"])
def test_the_ensemble_of_a_simulation_is_that_of_its_trajectories(per, rng):
    """Oracle: numpy mean and cov of the recorded runs; blocks of any size see the same runs, bit for bit."""
    plant = design(0.1, STEPS, **random_given(rng, SIZES[3]), uncertainty=Uncertainty(per=per))
    method = Method("m", Spy(plant.nx, plant.ny), Rest(plant.nu))
    some = experiment(plant, method, signals=("x", "y"), n_runs=120, ensemble=True)
    whole = simulate_block(some, method, range(120))
    blocks = [simulate_block(some, method, runs) for runs in (range(1), range(1, 30), range(30, 75), range(75, 120))]
    for name in ("x", "y"):
        together = np.concatenate([block.traces[name] for block in blocks])
        np.testing.assert_array_equal(together, whole.traces[name])
    n, mean, cov = joined([group for block in blocks for group in block.ensemble])
    x = whole.traces["x"]
    assert n == 120
    np.testing.assert_allclose(mean[:, : plant.nx], x.mean(axis=0), atol=1e-13)
    np.testing.assert_allclose(cov[STEPS, : plant.nx, : plant.nx], np.cov(x[:, STEPS].T), rtol=1e-11)
    assert not simulate_block(experiment(plant, method), method, range(120)).ensemble


def test_oracles_are_named(rng):
    """Oracle: the methods whose estimator knows the uncertainty."""
    _, plant, _ = world(rng)
    kinds = (Spy, Uninformed, Oracle)
    methods = [Method(kind.__name__, kind(plant.nx, plant.ny), Rest(plant.nu)) for kind in kinds]
    changed = vars(experiment(plant, methods[0])) | {"methods": (*methods, Method("toy", Halfway(), Rest(1)))}
    assert Experiment(**changed).oracles == {"Oracle"}
