"""One environment with `reset` and `step`, as Gymnasium has them, for one run of a plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, OutOfRange
from rmpc_bench.types.ode import Parameters


@dataclass(frozen=True)
class Access:
    """How the environments of a plant are made, moved and read.

    Parameters
    ----------
    make : returns a new environment for the parameters of a run
    action : from an input u to an action of the environment
    read : from the innermost environment to its state; None where the state is the observation
    write : sets the state of the innermost environment; None where it cannot be set
    measure : from the state, the parameters and the observation to the output; None where outputs are states
    measures_observation : whether an output is an entry of the observation
    starts_at_x0 : whether x(0) is that of the configuration; otherwise it is the one of `reset`
    ends : whether a run ends where the environment ends an episode
    """

    make: Callable[[Parameters], Any]
    action: Callable[[Array], Any]
    read: Callable[[Any], Any] | None
    write: Callable[[Any, Array], None] | None
    measure: Callable[[Array, Parameters, Array], Any] | None = None
    measures_observation: bool = False
    starts_at_x0: bool = False
    ends: bool = True

    def state(self, inner: Any, observation: Any) -> Float[Array, " nx"]:
        """Return a copy of the state in double precision."""
        state: Array = np.array(observation if self.read is None else self.read(inner), dtype=float)
        return state if state.ndim == 1 else state.ravel()


class EnvironmentRun:
    """The environment of one run and method."""

    def __init__(self, access: Access) -> None:
        self.access = access

    def start(self, p: Parameters, x0: Float[Array, " nx"], rng: np.random.Generator) -> None:
        """Make the environment; the seed of its random numbers is the first number of this run's generator."""
        access = self.access
        self.env = access.make(p)
        self.inner = self.env.unwrapped
        observation, _ = self.env.reset(seed=int(rng.integers(2**31)))
        if access.starts_at_x0:
            assert access.write is not None
            access.write(self.inner, x0)
        self.observation = observation
        self.x = access.state(self.inner, observation)

    def step(self, u: Float[Array, " nu"], w: Float[Array, " nw"]) -> Float[Array, " nx"]:
        """Apply an action and add the process noise to the state."""
        access = self.access
        self.observation, _, terminated, truncated, _ = self.env.step(access.action(u))
        if (terminated or truncated) and access.ends:
            raise OutOfRange(f"the environment has {'terminated' if terminated else 'truncated'} the episode")
        x = access.state(self.inner, self.observation)
        if w.size:
            assert access.write is not None
            x += w
            access.write(self.inner, x.copy())
        return x

    def output(self, x: Float[Array, " nx"], p: Parameters) -> Any:
        """Return the output without measurement noise; called where it is more than entries of the state."""
        assert self.access.measure is not None
        return self.access.measure(x, p, self.observation)
