"""The compiled simulation of a period against the simulation step by step, which is its oracle: bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
from loaded_configs import loaded

from rmpc_bench.controllers.mpc_law import Mpc
from rmpc_bench.controllers.state_feedback import GameGain, Lqr
from rmpc_bench.estimators.bridging import RiccatiRecursion
from rmpc_bench.estimators.gain_schedule import GainScheduleFilter
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.uncertain_system import uncertain_system
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.plants import servo
from rmpc_bench.plants.uncertain_linear import UncertainLinear, Uncertainty
from rmpc_bench.simulation import closed_loop
from rmpc_bench.simulation.closed_loop import simulate, simulate_block
from rmpc_bench.simulation.linear_loop import adds_like_einsum, applies, compiled_loop, compiled_products
from rmpc_bench.simulation.open_loop import OpenLoop, Rest
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.simulation.scenario import Draws
from rmpc_bench.simulation.state_range import StateRange
from rmpc_bench.types import InputSignal, Journal, Method, OperatingPoint, Status, Watch

RUNS, STEPS = 6, 12
SIGNALS = ("x", "y", "x_hat", "u", "r", "P", "M", "bursts")


def assert_same_bits(one, other):
    """Both are missing, or have the same shape, type and bytes."""
    assert (one is None) == (other is None)
    if one is not None:
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
        np.testing.assert_array_equal(one, other)
        assert (np.signbit(one) == np.signbit(other))[~np.isnan(one)].all() if one.dtype == float else True


def compared(plant, method, draws, r, n_steps, state_range=None):
    """Simulate both ways; return the statuses after everything was found equal."""
    options = {"with_P": True, "with_M": True, "info": {"e", "S"}, "state_range": state_range or StateRange()}
    runs = tuple(range(len(draws.x0)))
    start = RunStart(0, runs, Journal())
    plain, plain_status = simulate(plant, method, draws, r, n_steps, start=start, **options)
    record, status = compiled_loop(plant, method, draws, r, n_steps, start=start, **options)
    for name in SIGNALS:
        assert_same_bits(getattr(record, name), getattr(plain, name))
    assert set(record.info) == set(plain.info)
    for name in plain.info:
        assert_same_bits(record.info[name], plain.info[name])
    assert_same_bits(status, plain_status)
    return status


def random_filter(rng, nx, nu, ny, samples, **options):
    """Gains of an arbitrary filter: some matrices vary with k, some are constant, some are missing."""

    def matrices(*shape):
        return 0.4 * rng.standard_normal((samples if rng.random() < 0.5 else 1, *shape))

    return GainScheduleFilter(
        x0=rng.standard_normal(nx),
        F=matrices(nx, nx) / np.sqrt(nx),
        B=np.zeros((1, nx, nu)) if rng.random() < 0.2 else matrices(nx, nu),
        C=matrices(ny, nx),
        K=matrices(nx, ny),
        L=np.zeros((1, nx, ny)) if rng.random() < 0.3 else matrices(nx, ny),
        P=None if rng.random() < 0.3 else matrices(nx, nx),
        M=None if rng.random() < 0.5 else matrices(nx, nx),
        f=None if rng.random() < 0.5 else matrices(nx),
        d=None if rng.random() < 0.5 else matrices(ny),
        S=None if rng.random() < 0.5 else matrices(ny, ny),
        **options,
    )


def random_law(rng, nx, nu, ny):
    """A control law of any of the forms."""
    K_x = 0.3 * rng.standard_normal((STEPS, nu, nx))
    form = rng.integers(5)
    if form == 0:
        return Rest(nu)
    if form == 1:
        low, high = (-0.4, 0.3) if rng.random() < 0.7 else (-np.inf, np.inf)
        Hp = int(rng.integers(1, 5))
        K_u, K_r = 0.2 * rng.standard_normal((nu, nu)), rng.standard_normal((nu, Hp * ny))
        u_0, u_op = (None, None) if rng.random() < 0.5 else rng.standard_normal((2, nu))
        return Mpc(K_x[0], K_u, K_r, low, high, preview=Hp + 1, u_0=u_0, u_op=u_op)
    if form == 2:
        point = None if rng.random() < 0.5 else OperatingPoint(*(rng.standard_normal(n) for n in (nx, nu, ny)))
        return Lqr(K_x, None, rng.standard_normal((STEPS, nu)), point=point)
    if form == 3:
        # Gains as the search for the multipliers would leave them.
        law = object.__new__(GameGain)
        law.__dict__.update(L=K_x, point=None)
        return law
    return OpenLoop(Given(rng.standard_normal((RUNS, STEPS, nu))), STEPS)


class Given(InputSignal):
    """An input that differs from run to run."""

    def __init__(self, values):
        self.values = values

    def sample(self, runs, n_samples):
        """Return the values of the runs."""
        return self.values[list(runs), :n_samples]


def random_plant(rng, nx, nu, ny):
    """An uncertain linear plant: constant or varying matrices, F of any size, scalar or missing."""
    r, s = rng.integers(1, 4, 2)
    samples = STEPS + 1 if rng.random() < 0.5 else 1
    shapes = {"A": (nx, nx), "B": (nx, nu), "C": (ny, nx)}
    if rng.random() < 0.7:
        shapes |= {"H_A": (nx, r), "H_C": (ny, r), "G_x": (s, nx)}
    given = {
        name: rng.standard_normal((samples if rng.random() < 0.7 else 1, *shape)) / np.sqrt(nx)
        for name, shape in shapes.items()
    }
    if rng.random() < 0.2:
        given["B"] = np.zeros((1, nx, nu))
    system = uncertain_system(STEPS, given | {"Bw": np.eye(nx)[None], "Dv": np.eye(ny)[None]})
    return UncertainLinear(system, Uncertainty("uniform", per="step" if rng.random() < 0.5 else "run"), 0.1)


def random_draws(rng, plant):
    """Random inputs of the runs."""
    delta = plant.draw({}, [np.random.default_rng(int(rng.integers(1e9))) for _ in range(RUNS)], STEPS)
    noises = (0.1 * rng.standard_normal((RUNS, STEPS + 1, n)) for n in (plant.nw, plant.nv))
    return Draws(delta, rng.standard_normal((RUNS, plant.nx)), *noises)


@pytest.mark.parametrize("seed", range(40))
def test_random_systems(seed):
    """Sizes up to eleven, all forms of filters, laws and plants; limits that some runs exceed."""
    rng = np.random.default_rng(seed)
    nx, nu, ny, nh = (int(n) for n in rng.integers(1, (12, 4, 4, 12)))
    plant = random_plant(rng, nx, nu, ny)
    nh = nx if rng.random() < 0.5 else nh
    filter_ = random_filter(rng, nh, nu, ny, STEPS + 1)
    law = random_law(rng, nh, nu, ny)
    r = rng.standard_normal((STEPS + 1 + law.preview, ny))
    limits = StateRange(largest=np.full(nx, rng.uniform(2.0, 20.0)))
    if rng.random() < 0.5:
        limits = limits._replace(low=np.full(nx, -3.0), high=np.full(nx, 3.0))
    compared(plant, Method("any", filter_, law), random_draws(rng, plant), r, STEPS, limits)


def test_the_random_systems_have_failed_runs():
    """The comparison of statuses is not one of zeros."""
    rng = np.random.default_rng(1)
    plant = random_plant(rng, 3, 1, 1)
    filter_ = random_filter(rng, 3, 1, 1, STEPS + 1)
    draws = random_draws(rng, plant)
    r = np.zeros((STEPS + 1, 1))
    tight = StateRange(largest=np.full(3, 2.0))
    status = compared(plant, Method("any", filter_, Rest(1)), draws, r, STEPS, tight)
    assert {Status.OK, Status.DIVERGED} & set(status.tolist()) == set(status.tolist())
    assert (status == Status.DIVERGED).any()
    narrow = StateRange(low=np.full(3, -1.5), high=np.full(3, 1.5))
    assert (compared(plant, Method("any", filter_, Rest(1)), draws, r, STEPS, narrow) == Status.OUT_OF_RANGE).any()


@pytest.mark.parametrize(
    "name",
    [
        "zenere2018/fig7",
        "zenere2018/sim1",
        "benchmarks/xie1994",
        "benchmarks/simon-motor",
        "benchmarks/wkf2018",
        "benchmarks/ma2025",
        "souto2011/comparison",
    ],
)
def test_configurations(name):
    """All methods to which the compiled simulation applies, on five runs."""
    experiment = loaded(name).experiment
    plant, n_steps = experiment.plant, experiment.n_steps
    draws = experiment.scenario.draw(plant, range(5), n_steps)
    methods = [method for method in experiment.methods if applies(experiment, method)]
    assert methods
    for method in methods:
        r = experiment.scenario.reference.sample(n_steps + 1 + method.controller.preview)
        compared(plant, method, draws, r, n_steps, experiment.state_range)


@pytest.mark.parametrize("make", [servo.design, servo.design_linear])
def test_servomechanisms_with_runs_out_of_range(make):
    """Oracle: a parameter that is not admissible fails its own run at the first step."""
    rng, plant = np.random.default_rng(4), make(0.1)
    parameters = {name: np.full(RUNS, value) * rng.uniform(0.5, 1.5, RUNS) for name, value in plant.nominal.items()}
    parameters["J_l"][2] = -1.0
    noises = (0.01 * rng.standard_normal((RUNS, STEPS + 1, n)) for n in (plant.nw, plant.nv))
    draws = Draws(plant.draw(parameters, [], STEPS), 0.1 * rng.standard_normal((RUNS, plant.nx)), *noises)
    filter_ = random_filter(rng, 4, 1, 1, STEPS + 1)
    law = Mpc(rng.standard_normal((1, 4)), np.full((1, 1), 0.1), rng.standard_normal((1, 2)), -50.0, 50.0, preview=3)
    r = rng.standard_normal((STEPS + 1 + law.preview, 1))
    status = compared(plant, Method("any", filter_, law), draws, r, STEPS)
    assert status[2] == Status.OUT_OF_RANGE and (np.delete(status, 2) == Status.OK).any()


def test_bridging_filters_as_long_as_nothing_is_missing():
    """A missing measurement changes the gains of its run: then the simulation goes step by step."""
    rng = np.random.default_rng(2)
    plant = random_plant(rng, 3, 1, 2)
    model = LinearModel(np.eye(3), np.ones((3, 1)), np.ones((2, 3)), np.eye(3), np.eye(2))
    options = {"root": np.eye(3)[None], "recursion": RiccatiRecursion([model])}
    filter_ = random_filter(rng, 3, 1, 2, STEPS + 1, **options)
    draws, r = random_draws(rng, plant), np.zeros((STEPS + 1, 2))
    method = Method("any", filter_, Rest(1))
    compared(plant, method, draws, r, STEPS)
    draws.v[1, 3, 0] = np.nan
    assert compiled_loop(plant, method, draws, r, STEPS) is None


@pytest.mark.parametrize("m", [1, 2, 3, 7, 8, 9, 16, 23])
def test_products_add_like_einsum(m):
    """Bit for bit, in all orders of magnitude; the sum of nothing but negative zeros is +0."""
    rng = np.random.default_rng(m)
    A = rng.standard_normal((4, m)) * 10.0 ** rng.integers(-8, 8, (4, m))
    x = rng.standard_normal((9, m)) * 10.0 ** rng.integers(-8, 8, (9, m))
    x[0] = -0.0
    assert_same_bits(compiled_products(A, x), mv(A, x))
    own = rng.permuted(np.tile(A, (9, 1, 1)), axis=0)
    assert_same_bits(compiled_products(own, x), mv(own, x))


def test_block_of_an_experiment_is_the_same_either_way(monkeypatch):
    """Metrics, statuses, records and ensembles of `simulate_block`, with and without the compiled simulation."""
    experiment = loaded("benchmarks/simon-motor").experiment
    method = experiment.methods[0]
    assert applies(experiment, method)
    fast = simulate_block(experiment, method, range(60))
    monkeypatch.setattr(closed_loop, "applies", lambda experiment, method: False)
    plain = simulate_block(experiment, method, range(60))
    assert_same_bits(fast.metrics, plain.metrics)
    assert_same_bits(fast.status, plain.status)
    assert fast.traces.keys() == plain.traces.keys()
    for name in plain.traces:
        assert_same_bits(fast.traces[name], plain.traces[name])
    for one, other in zip(fast.ensemble, plain.ensemble, strict=True):
        assert tuple(one[:3]) == tuple(other[:3])
        assert_same_bits(one.mean, other.mean)
        assert_same_bits(one.second, other.second)


def test_a_limit_of_time_goes_step_by_step(monkeypatch):
    """The watch of a process with limits sees every step."""

    class Limited(Watch):
        has_limits = True
        steps = 0

        def step(self, k):
            self.steps += 1

    experiment = loaded("benchmarks/simon-motor").experiment
    watch = Limited()
    simulate_block(experiment, experiment.methods[0], range(2), watch=watch)
    assert watch.steps == experiment.n_steps + 1


def test_components_of_a_user_are_simulated_step_by_step():
    """A subclass of a built-in filter may change its arithmetic."""

    class Own(GainScheduleFilter):
        pass

    experiment = loaded("benchmarks/simon-motor").experiment
    method = experiment.methods[1]
    assert adds_like_einsum() and applies(experiment, method)
    given = {name: getattr(method.estimator, name) for name in ("x0", "F", "B", "C", "K", "L", "P")}
    assert not applies(experiment, method._replace(estimator=Own(**given)))


def test_small_experiments_do_not_load_the_compiler(monkeypatch):
    """Without numba in the process a few runs are simulated step by step."""
    from rmpc_bench.simulation import linear_loop

    experiment = replace(loaded("benchmarks/simon-motor").experiment, n_runs=2)
    monkeypatch.setattr(linear_loop.sys, "modules", {})
    assert not linear_loop.applies(experiment, experiment.methods[0])
    assert linear_loop.applies(replace(experiment, n_runs=10**6), experiment.methods[0])
