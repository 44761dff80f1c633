"""Whether a plant keeps the end of one method as the beginning of the next one."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.global_random import SEED, global_seed
from rmpc_bench.conformance.linear_system import Excitation
from rmpc_bench.conformance.results import require_same
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.simulation.scenario import Scenario, own_draws
from rmpc_bench.types import Array, Estimate, Estimator, Journal, Method, Plant, Reference

REMAINS = "; the plant keeps something of the first method: keep it in the state or in what `draw` or `start` returns"


class NoEstimate(Estimator):
    """An estimator whose estimate is always 0.

    Parameters
    ----------
    nx : number of states
    """

    def __init__(self, nx: int) -> None:
        self.nx = nx

    def init(self, n_runs: int) -> None:
        """There is nothing to remember."""

    def correct(self, k: int, state: None, y: Array) -> tuple[None, Estimate]:
        """Return 0."""
        return None, Estimate(np.zeros((len(y), self.nx)), None, None, np.zeros(len(y), dtype=np.int8), {})

    def predict(self, k: int, state: None, u: Array) -> None:
        """There is nothing to predict."""


class _Zero(Reference):
    """The reference 0."""

    def __init__(self, ny: int) -> None:
        self.ny = ny

    def sample(self, n_samples: int) -> Array:
        """Return zeros."""
        return np.zeros((n_samples, self.ny))


def require_methods_apart(plant: Plant, x0: Float[Array, " nx"], u: Float[Array, "runs steps nu"]) -> None:
    """Simulate two equal methods with the same draws, one after the other.

    Parameters
    ----------
    plant : what is checked
    x0 : initial state
    u : inputs

    Raises
    ------
    AssertionError
        If the trajectories differ.
    """
    n_runs, n_steps = u.shape[:2]
    scenario = Scenario(SEED, {}, {}, x0, (), (), (), _Zero(plant.ny))
    draws = scenario.draw(plant, range(n_runs), n_steps)
    found: list[Any] = []
    for name in ("first", "second"):
        method = Method(name, NoEstimate(plant.nx), Excitation(u))
        start = RunStart(SEED, tuple(range(n_runs)), Journal())
        own = own_draws(scenario, plant, range(n_runs), n_steps, draws)
        with global_seed(0):
            record, _ = simulate(plant, method, own, scenario.reference.sample(n_steps + 1), n_steps, start=start)
        found.append(record.x)
    try:
        require_same("x of the second method", found[1], found[0])
    except AssertionError as error:
        raise AssertionError(f"{error}{REMAINS}") from None
