"""A linear Gaussian system whose best estimator is known, for checks of what a component may know.

The shipped system has an input that matters and fast modes: an estimate that is one sample late or early, or uses the
wrong input, has a large error.  The input is random, so that it does not depend on the component.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.designs import estimator
from rmpc_bench.conformance.global_random import SEED, global_seed
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import mv, psd_sqrt
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.draws import Draws
from rmpc_bench.simulation.run_start import RunStart
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
    Signals,
)

N_RUNS, N_STEPS = 40, 150
INPUT = 2.0
"""Standard deviation of the random input, in units of the smallest input that moves the state by its process noise."""


class LinearGaussian(Plant):
    """x(k+1) = A x + B u + f0 + w, y = C x + d0 + v, with one largest size of all inputs."""

    def __init__(self, model: LinearModel, Ts: float = 1.0, largest: float = np.inf) -> None:
        self.model, self._Ts = model, Ts
        inputs = tuple(f"u.{i}" for i in range(model.nu))
        bounds = dict.fromkeys(inputs, (-largest, largest))
        self._signals = None if np.isinf(largest) else Signals((), inputs, (), bounds=bounds)

    @property
    def signals(self) -> Signals | None:
        """The inputs with their bounds, where they have some."""
        return self._signals

    @property
    def Ts(self) -> float:
        """Sampling time [s]."""
        return self._Ts

    @property
    def nx(self) -> int:
        """Number of states."""
        return self.model.nx

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return self.model.nu

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return self.model.ny

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
    """A given input.

    Parameters
    ----------
    u : (runs, steps, nu)
    """

    preview = 0

    def __init__(self, u: Float[Array, "runs steps nu"]) -> None:
        self.u = u

    def init(self, n_runs: int) -> None:
        """There is nothing to remember."""

    def control(self, k: int, state: None, y: Array, estimate: Estimate, r: Array) -> tuple[None, Command]:
        """Return u(k)."""
        return None, Command(self.u[:, k], np.zeros(len(y), dtype=np.int8), {})


class Recorded(NamedTuple):
    """Measurements and inputs of some runs, and the true states that belong to them."""

    y: Float[Array, "runs samples ny"]
    u: Float[Array, "runs steps nu"]
    x: Float[Array, "runs samples nx"]


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """A linear Gaussian system with the random inputs of its runs.

    Parameters
    ----------
    model : matrices and noises, exactly those of the true system
    x0, P0 : (nx,), (nx, nx) mean and covariance of x(0)
    n_runs, n_steps : size
    seed : of the generator
    Ts : sampling time [s]
    largest : largest size of an input that acts
    """

    model: LinearModel
    x0: Float[Array, " nx"]
    P0: Float[Array, "nx nx"]
    n_runs: int = N_RUNS
    n_steps: int = N_STEPS
    seed: int = 15
    Ts: float = 1.0
    largest: float = np.inf

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
        """Return the random inputs; without noise every run starts at x0.

        Parameters
        ----------
        noise : whether x(0) is random and there are noises
        """
        model, rng = self.model, np.random.default_rng(self.seed + 1)
        roots = psd_sqrt(self.P0), psd_sqrt(model.Q_w), psd_sqrt(model.R_v)
        shapes = (self.n_runs, model.nx), *((self.n_runs, self.n_steps + 1, n) for n in (model.nx, model.ny))
        x0, w, v = (
            (1.0 if noise else 0.0) * np.einsum("ij,...j->...i", root, rng.standard_normal(shape))
            for root, shape in zip(roots, shapes, strict=True)
        )
        return Draws(None, self.x0 + x0, w, v)

    def simulated(self, design: Estimator, *, noise: bool = True) -> tuple[Any, Array]:
        """Simulate the runs with an estimator in the loop; its record and the statuses.

        Parameters
        ----------
        design : the estimator
        noise : as in `draws`
        """
        method, r = Method("checked", design, Excitation(self.u)), np.zeros((self.n_steps + 1, self.model.ny))
        start = RunStart(SEED, tuple(range(self.n_runs)), Journal())
        with global_seed(0):
            return simulate(self.plant, method, self.draws(noise=noise), r, self.n_steps, with_P=True, start=start)

    def recorded(self, *, noise: bool = True) -> Recorded:
        """Return the data of the runs, which do not depend on any estimator.

        Parameters
        ----------
        noise : as in `draws`
        """
        record, _ = self.simulated(self.kalman, noise=noise)
        v = self.draws(noise=noise).v
        y = [self.plant.output(k, None, record.x[:, k], v[:, k]) for k in range(self.n_steps + 1)]
        return Recorded(np.stack(y, axis=1), record.u, record.x)

    @cached_property
    def kalman(self) -> Estimator:
        """The best estimator."""
        return estimator("kalman", self.model, n_steps=self.n_steps, x0=self.x0, P0=self.P0)
