"""The plant that consists of environments, one per run and method: its steps and its signals."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.components.single_plant import Access, EnvironmentRun, ObjectPlant, RunPlants
from rmpc_bench.extras import library
from rmpc_bench.types import Array, DesignError, Motion, Parameters, RunInfo, Signals

NO_LIMIT = -1
"""Value of `max_episode_steps` with which Gymnasium adds no time limit."""


# From the keys of a configuration to the functions that make, move and read an environment.
#
# All of them can be sent to a worker process.


def made(env: Any, options: Mapping[str, Any], given: Mapping[str, float]) -> Any:
    """Make an environment without time limit and without the checks of Gymnasium at every call."""
    keywords = {**options, **given}
    if not isinstance(env, str):
        return env(**keywords)
    found = library("gymnasium").make(env, max_episode_steps=NO_LIMIT, disable_env_checker=True, **keywords)
    # A wrapper of the registration may change actions and observations; without one the calls go to the environment.
    return found if found.spec.additional_wrappers else found.unwrapped


def with_parameters(
    p: Parameters, *, env: Any, options: Mapping[str, Any], keywords: Sequence[str], change: Callable[..., Any] | None
) -> Any:
    """Make the environment of a run; parameters that are no keywords are attributes, unless `change` sets them."""
    found = made(env, options, {name: p[name] for name in keywords})
    if change is not None:
        change(found.unwrapped, p)
    else:
        for name in p:
            if name not in keywords:
                setattr(found.unwrapped, name, p[name])
    return found


def keywords_of(inner: Any, names: Sequence[str]) -> tuple[str, ...]:
    """Return the parameters that are keywords of the class of an environment."""
    taken = inspect.signature(type(inner).__init__).parameters
    return tuple(name for name in names if name in taken)


def as_it_is(u: Float[Array, " nu"], *, shape: tuple[int, ...], dtype: Any) -> Array:
    """Return an input as an action of a box."""
    return u if dtype is float and u.shape == shape else u.reshape(shape).astype(dtype, copy=False)


def nearest(u: Float[Array, "runs 1"], values: Float[Array, " actions"]) -> Int[Array, " runs"]:
    """Return the index of the value that is nearest to every input, the first of two equally near ones."""
    found: Int[Array, " runs"] = np.abs(values - u).argmin(axis=1)
    return found


def discrete(u: Float[Array, " nu"], *, values: Float[Array, " actions"], first: int) -> int:
    """Return the discrete action whose value is nearest to the input."""
    if np.isnan(u[0]):
        raise ValueError("the input is not a number")
    return first + int(nearest(u[None], values)[0])


class Actions(NamedTuple):
    """How inputs become actions."""

    of_input: Callable[..., Any]
    low: Float[Array, " nu"]
    high: Float[Array, " nu"]
    values: Float[Array, " actions"] | None = None  # inputs of the discrete actions; None for other actions


def actions_of(space: Any, action: Any, nu: int | None) -> Actions:
    """Return the function from u to an action, the limits of u and the values of discrete actions."""
    spaces = library("gymnasium", "spaces")
    if callable(action):
        if nu is None:
            raise DesignError("name the inputs, or give their number: `action` is a function", "inputs")
        return Actions(action, np.full(nu, -np.inf), np.full(nu, np.inf))
    if isinstance(space, spaces.Box):
        if action is not None:
            raise DesignError("the actions are a box: u is the action; leave the key out", "action")
        as_action = partial(as_it_is, shape=space.shape, dtype=float)
        return Actions(as_action, space.low.astype(float).ravel(), space.high.astype(float).ravel())
    if not isinstance(space, spaces.Discrete):
        text = f"the actions are a {type(space).__name__}; give a function of a file that maps u to an action"
        raise DesignError(text, "action")
    n = int(space.n)
    if action is None:
        text = f"the environment has {n} discrete actions; give the value of u for each of them, [u_0, u_1, ..]"
        raise DesignError(text, "action")
    if len(action) != n:
        raise DesignError(f"has {len(action)} values; the environment has {n} actions", "action")
    values = np.array(action, dtype=float)
    of_input = partial(discrete, values=values, first=int(space.start))
    return Actions(of_input, values.min()[None], values.max()[None], values)


def assign(inner: Any, x: Array, *, path: str) -> None:
    """Assign a state to an attribute, with dots inside an inner object."""
    owner, _, name = path.rpartition(".")
    target = attrgetter(owner)(inner) if owner else inner
    setattr(target, name, x.reshape(np.shape(getattr(target, name))))


def observed(x: Array, p: Parameters, observation: Any, *, entries: Sequence[tuple[bool, int]]) -> Array:
    """Return entries; each is an index with whether it is one of the state or of the observation."""
    seen = np.asarray(observation, dtype=float).ravel()
    return np.array([x[i] if of_state else seen[i] for of_state, i in entries])


def computed(x: Array, p: Parameters, observation: Any, *, output: Callable[..., Any]) -> Any:
    """Return what the user's function output(x, p) returns."""
    return output(x, p)


@dataclass(frozen=True, eq=False)
class DiscreteInput(Signals):
    """Signals of an environment with discrete actions: the nearest value acts, the first of two equally near ones."""

    values: Float[Array, " actions"] = field(kw_only=True)

    def limited_inputs(self, u: Float[Array, "runs 1"], runs: RunInfo | None = None) -> Float[Array, "runs 1"]:
        """Return the nearest values; inputs beyond the bounds are counted."""
        limited = super().limited_inputs(u, runs)
        chosen = self.values[nearest(limited, self.values)][:, None]
        return np.where(np.isnan(limited), limited, chosen)


class EnvironmentPlant(ObjectPlant):
    """A plant of environments, made by `rmpc_bench.adapters.gymnasium.design`.

    `measured` has the indices of the states that are the outputs; it is None where `access` measures them.
    """

    def __init__(
        self,
        access: Access,
        signals: Signals,
        measured: list[int] | None,
        nominal: Mapping[str, float],
        Ts: float,
        n_steps: int,
    ) -> None:
        # A disturbed state and an observation of the undisturbed one would contradict each other.
        disturbed = access.write is not None and access.read is not None and not access.measures_observation
        given = {"access": access, "Ts": Ts, "n_steps": n_steps}
        nw = signals.nx if disturbed else 0
        super().__init__(EnvironmentRun, given, signals, nominal, nw=nw, has_own_start=not access.starts_at_x0)
        self.access, self.measured, self.repeats = access, measured, True

    @property
    def deterministic(self) -> bool:
        """Whether equal seeds and actions gave equal states when the plant was designed."""
        return self.repeats

    def step(self, k: int, delta: RunPlants, x: Array, u: Array, w: Array) -> Motion:
        """Move every environment; without noise its state is not written."""
        return super().step(k, delta, x, u, w if w.any() else w[:, :0])

    def output(self, k: int, delta: RunPlants, x: Array, v: Array) -> Float[Array, "runs ny"]:
        """Measure; entries of the state are taken for all runs at once."""
        y: Array = x[:, self.measured] + v if self.measured is not None else super().output(k, delta, x, v)
        return y
