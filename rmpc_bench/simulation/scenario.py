"""What befalls a run: uncertain parameters, initial state, noise and reference, each from its own random stream.

The stream of a quantity depends on (seed, run, name) only: never on the method, the block, the worker or the number
of runs, so that every method meets the same plants and the same noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_covariance, as_vector
from rmpc_bench.simulation.distributions import Distribution
from rmpc_bench.simulation.noise import Noise
from rmpc_bench.simulation.reference import Reference
from rmpc_bench.types import Array, DesignError, Matrix, Method, Metric, Plant


class Draws(NamedTuple):
    """Everything that is random or given from outside, for a block of runs."""

    delta: Any
    x0: Float[Array, "runs nx"]
    w: Float[Array, "runs steps nw"]
    v: Float[Array, "runs samples nv"]


def stream(seed: int, run: int, name: str) -> np.random.Generator:
    """Random generator of one run and one quantity.

    Parameters
    ----------
    seed : seed of the experiment
    run : index of the run, from 0
    name : name of the quantity, such as ``uncertainty/eps_min`` or ``v/0``
    """
    words = np.frombuffer(sha256(name.encode()).digest()[:8], dtype="<u4")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(run, *map(int, words)))))


def initial_state(value: float | list[float], n: int) -> Float[Array, " n"]:
    """Expand a number (in every coordinate) or one per coordinate.

    Raises
    ------
    DesignError
        If the length does not fit.
    """
    try:
        return as_vector(value, n)
    except ValueError as error:
        raise DesignError(str(error)) from None


def initial_covariance(value: Matrix, n: int) -> Float[Array, "n n"]:
    """Expand a number (times the identity), a diagonal or a matrix.

    Raises
    ------
    DesignError
        If the size does not fit, or the result is not a covariance.
    """
    try:
        return as_covariance(value, n)
    except ValueError as error:
        raise DesignError(str(error)) from None


@dataclass(frozen=True, eq=False)
class Scenario:
    """The random and the given parts of an experiment, the same for every method.

    Parameters
    ----------
    seed : seed of all streams
    uncertainty : law of every named quantity
    parameters : plant parameters that depend on them, each a function of the named values of a run
    x0 : mean of the true initial state (nx,)
    x0_noise : law of its deviation from the mean, or None
    process, measurement : the terms of w and v; their sum acts
    reference : what the output is meant to follow
    """

    seed: int
    uncertainty: Mapping[str, Distribution]
    parameters: Mapping[str, Callable[[Mapping[str, float]], float]]
    x0: Float[Array, " nx"]
    x0_noise: Noise | None
    process: tuple[Noise, ...]
    measurement: tuple[Noise, ...]
    reference: Reference

    def named_values(self, run: int) -> dict[str, float]:
        """Draw the named uncertain quantities of one run."""
        return {
            name: law.quantile(stream(self.seed, run, f"uncertainty/{name}").random())
            for name, law in self.uncertainty.items()
        }

    def draw(self, plant: Plant, runs: range, n_steps: int) -> Draws:
        """Draw a block of runs.

        Parameters
        ----------
        plant : receives the parameters and may draw more
        runs : indices of the runs
        n_steps : number of control periods N
        """
        drawn = [self.named_values(run) for run in runs]
        parameters = {
            name: np.array([self.parameters[name](values) if name in self.parameters else nominal for values in drawn])
            for name, nominal in plant.nominal.items()
        }
        return Draws(
            delta=plant.draw(parameters, [stream(self.seed, run, "delta") for run in runs], n_steps),
            x0=np.array([self._initial_state(run) for run in runs]),
            w=self._sum(self.process, "w", runs, n_steps, plant.nw),
            v=self._sum(self.measurement, "v", runs, n_steps + 1, plant.nv),
        )

    def _initial_state(self, run: int) -> Float[Array, " nx"]:
        return self.x0 if self.x0_noise is None else self.x0 + self.x0_noise.draw(stream(self.seed, run, "x0"), 1)[0]

    def _sum(
        self, terms: tuple[Noise, ...], name: str, runs: range, n_samples: int, n: int
    ) -> Float[Array, "runs samples n"]:
        total = np.zeros((len(runs), n_samples, n))
        for row, run in enumerate(runs):
            for number, term in enumerate(terms):
                total[row] += term.draw(stream(self.seed, run, f"{name}/{number}"), n_samples)
        return total


class Recording(NamedTuple):
    """The trajectories to keep."""

    signals: tuple[str, ...] = ()
    """Of `Record`: ``y``, ``u``, ``x``, ``x_hat``."""
    n_runs: int = 0
    """Of how many runs, from the first one on."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Everything a worker needs: picklable, made once.

    Parameters
    ----------
    plant : the truth
    methods : the pairs to compare
    scenario : what befalls every run
    metrics : the numbers to keep of every run
    n_runs, n_steps : size of the experiment; samples are k = 0..n_steps
    recording : the trajectories to keep
    """

    plant: Plant
    methods: tuple[Method, ...]
    scenario: Scenario
    metrics: tuple[Metric, ...]
    n_runs: int
    n_steps: int
    recording: Recording = Recording()

    def method(self, name: str) -> Method:
        """Look a method up by its name."""
        return next(method for method in self.methods if method.name == name)
