"""A linear Gaussian system whose best estimator is known, for checks of what a component may know.

The shipped system has an input that matters and fast modes: an estimate that is one sample late or early, or uses the
wrong input, has a large error.  The input is random, so that it does not depend on the component.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.config_file.factories import estimator
from rmpc_bench.conformance.outcome import SEED, Outcome, RunsExample, global_seed
from rmpc_bench.conformance.results import require
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import mv, psd_sqrt
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.simulation.scenario import Draws
from rmpc_bench.types import (
    Array,
    Command,
    Controller,
    Estimate,
    Estimator,
    Journal,
    Method,
    Motion,
    Plant,
    Record,
    Signals,
    Statuses,
    as_estimate,
)

N_RUNS, N_STEPS = 40, 150
INPUT = 2.0
"""Standard deviation of the random input, in units of the smallest input that moves the state by its process noise."""


class LinearGaussian(Plant):
    """x(k+1) = A x + B u + f0 + w, y = C x + d0 + v, with one largest size of all inputs."""

    nx: int
    nu: int
    ny: int
    Ts: float
    signals: Signals | None

    def __init__(self, model: LinearModel, Ts: float = 1.0, largest: float = np.inf) -> None:
        self.model, self.Ts = model, Ts
        self.nx, self.nu, self.ny = model.nx, model.nu, model.ny
        inputs = tuple(f"u.{i}" for i in range(model.nu))
        bounds = dict.fromkeys(inputs, (-largest, largest))
        self.signals = None if np.isinf(largest) else Signals((), inputs, (), bounds=bounds)

    def draw(self, parameters: Mapping[str, Array], rngs: Sequence[np.random.Generator], n_steps: int) -> None:
        """There is nothing uncertain."""

    def step(self, k: int, delta: None, x: Array, u: Array, w: Array) -> Motion:
        """Move to x(k+1)."""
        model = self.model
        return Motion(mv(model.A, x) + mv(model.B, u) + model.f0 + w, np.zeros(len(x), dtype=np.int8))

    def output(self, k: int, delta: None, x: Array, v: Array) -> Array:
        """Measure y(k)."""
        return mv(self.model.C, x) + self.model.d0 + v


class Excitation(Controller):
    """A given input."""

    preview = 0

    def __init__(self, u: Float[Array, "runs steps nu"]) -> None:
        self.u = u

    def init(self, n_runs: int) -> None:
        """There is nothing to remember."""

    def control(self, k: int, state: None, y: Array, estimate: Estimate, r: Array) -> tuple[None, Command]:
        """Return u(k)."""
        return None, Command(self.u[:, k], np.zeros(len(y), dtype=np.int8), {})


class GivenEstimates(Estimator):
    """Estimates that a function returns for k and y(k)."""

    def __init__(self, estimate: Callable[[int, Array], Estimate]) -> None:
        self.estimate = estimate

    def init(self, n_runs: int) -> None:
        """There is nothing to remember."""

    def correct(self, k: int, state: None, y: Array) -> tuple[None, Estimate]:
        """Return the estimate of k."""
        return None, self.estimate(k, y)

    def predict(self, k: int, state: None, u: Array) -> None:
        """There is nothing to predict."""


def simulated(
    plant: Plant, method: Method, draws: Draws, r: Array, n_steps: int, **options: Any
) -> tuple[Record, Statuses]:
    """Simulate the runs 0, 1, .. of some draws, with the global random generators seeded."""
    start = RunStart(SEED, tuple(range(len(draws.x0))), Journal())
    with global_seed(0):
        return simulate(plant, method, draws, r, n_steps, start=start, **options)


class Recorded(NamedTuple):
    """Measurements and inputs of some runs, and the true states that belong to them."""

    y: Float[Array, "runs samples ny"]
    u: Float[Array, "runs steps nu"]
    x: Float[Array, "runs samples nx"]


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """A linear Gaussian system with the random inputs of its runs."""

    model: LinearModel  # matrices and noises, exactly those of the true system
    x0: Float[Array, " nx"]  # x0, P0: mean and covariance of x(0)
    P0: Float[Array, "nx nx"]
    n_runs: int = N_RUNS  # n_runs, n_steps: size
    n_steps: int = N_STEPS
    seed: int = 15  # of the generator
    Ts: float = 1.0  # sampling time [s]
    largest: float = np.inf  # largest size of an input that acts

    @classmethod
    def shipped(cls) -> LinearSystem:
        """Return the system of the kit: two states, one input, one output."""
        A, B, C = [[0.7, 0.4], [-0.4, 0.3]], [[1.0], [0.5]], [[1.0, 0.0]]
        return cls.of(LinearModel(A, B, C, np.diag([0.2, 0.1]), [[0.1]]))

    @classmethod
    def of(cls, model: LinearModel, Ts: float = 1.0) -> LinearSystem:
        """Return the system that a linear model describes, with x(0) of the size of its process noise."""
        P0 = model.Q_w + 1e-3 * np.trace(model.Q_w) / model.nx * np.eye(model.nx)
        return cls(model, np.full(model.nx, 0.5) * np.sqrt(np.diag(P0)), P0, Ts=Ts)

    @cached_property
    def plant(self) -> LinearGaussian:
        """The true system."""
        return LinearGaussian(self.model, self.Ts, self.largest)

    @cached_property
    def u(self) -> Float[Array, "runs steps nu"]:
        """Random inputs; each moves the state by about twice its process noise."""
        model, rng = self.model, np.random.default_rng(self.seed)
        reach = np.linalg.norm(model.B, axis=0)
        size = np.sqrt(np.trace(model.Q_w)) / np.where(reach > 0.0, reach, 1.0)
        u: Array = INPUT * size * rng.standard_normal((self.n_runs, self.n_steps, model.nu))
        return u

    def draws(self, *, noise: bool = True) -> Draws:
        """Return the random inputs; without noise every run starts at x0."""
        model, rng = self.model, np.random.default_rng(self.seed + 1)
        roots = psd_sqrt(self.P0), psd_sqrt(model.Q_w), psd_sqrt(model.R_v)
        shapes = (self.n_runs, model.nx), *((self.n_runs, self.n_steps + 1, n) for n in (model.nx, model.ny))
        x0, w, v = (
            (1.0 if noise else 0.0) * np.einsum("ij,...j->...i", root, rng.standard_normal(shape))
            for root, shape in zip(roots, shapes, strict=True)
        )
        return Draws(None, self.x0 + x0, w, v)

    def simulated(self, design: Estimator, *, noise: bool = True) -> Record:
        """Return the trajectories of the runs with an estimator in the loop."""
        method, r = Method("checked", design, Excitation(self.u)), np.zeros((self.n_steps + 1, self.model.ny))
        return simulated(self.plant, method, self.draws(noise=noise), r, self.n_steps, with_P=True)[0]

    def recorded(self, *, noise: bool = True) -> Recorded:
        """Return the data of the runs, which do not depend on any estimator."""
        record = self.simulated(self.kalman, noise=noise)
        v = self.draws(noise=noise).v
        y = [self.plant.output(k, None, record.x[:, k], v[:, k]) for k in range(self.n_steps + 1)]
        return Recorded(np.stack(y, axis=1), record.u, record.x)

    @cached_property
    def kalman(self) -> Estimator:
        """The best estimator."""
        return estimator("kalman", self.model, n_steps=self.n_steps, x0=self.x0, P0=self.P0)


@dataclass(frozen=True, eq=False)
class EstimatorExample(RunsExample):
    """Measurements and inputs that an estimator is checked with."""

    # measurements of at least six runs and four samples; the design must know as many samples
    y: Float[Array, "runs samples ny"]
    u: Float[Array, "runs samples nu"]
    # for an oracle estimator: the plant's record of uncertain parameters for the runs of the given indices
    delta: Callable[[Sequence[int]], Any] | None = None
    nx: int | None = None  # length of an estimate; not checked where it is not known
    noun: ClassVar[str] = "x_hat"

    @classmethod
    def random(
        cls, nu: int, ny: int, *, n_runs: int = 9, n_steps: int = 12, seed: int = 11, delta: Any = None
    ) -> EstimatorExample:
        """Draw standard normal measurements of n_steps + 1 samples, and inputs; `delta` as above."""
        rng = np.random.default_rng(seed)
        y, u = (rng.standard_normal((n_runs, n_steps + 1, n)) for n in (ny, nu))
        return cls(y, u, delta)

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.y)

    def start(self, component: Estimator, outcome: Outcome) -> Any:
        """State of some runs before the first measurement."""
        drawn = None
        if component.knows_uncertainty:
            require(self.delta is not None, "the estimator knows the uncertain parameters; give the example `delta`")
            drawn = self.delta(outcome.rows) if self.delta is not None else None
        return outcome.start.estimator(component, len(outcome.rows), drawn, outcome.shared)

    def call(self, component: Estimator, outcome: Outcome) -> None:
        """Filter some runs."""
        state = self.start(component, outcome)
        for k in outcome.samples(self.y.shape[1]):
            outcome.add_status(outcome.shared.failed)
            state, returned = component.correct(k, state, np.ascontiguousarray(self.y[outcome.rows, k]))
            estimate = as_estimate(returned)
            # What the estimator may write into again is copied.
            P = None if estimate.P is None else np.array(estimate.P)
            estimate = estimate._replace(x_hat=np.array(estimate.x_hat), P=P)
            outcome.states.append(state)
            outcome.returned.append(estimate)
            outcome.numbers.append(estimate.x_hat)
            outcome.add_status(estimate.status)
            if k < self.u.shape[1]:
                state = component.predict(k, state, np.ascontiguousarray(self.u[outcome.rows, k]))
                outcome.states.append(state)

    def x_hat(
        self, estimator: Estimator, rows: Sequence[int] | None = None, y: Array | None = None
    ) -> Float[Array, "runs samples nx"]:
        """Estimates of some runs over time, for other measurements where they are given."""
        example = self if y is None else self.changed(y=y)
        return example.evaluate(estimator, rows).values
