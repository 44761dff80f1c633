"""The plant that consists of environments, one per run and method: its steps and its signals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.components.single_plant import ObjectPlant, RunPlants
from rmpc_bench.extras import library
from rmpc_bench.types import Array, DesignError, Motion, OutOfRange, Parameters, RunInfo, Signals

NO_LIMIT = -1
"""Value of `max_episode_steps` with which Gymnasium adds no time limit."""


def nearest(u: Float[Array, "runs 1"], values: Float[Array, " actions"]) -> Int[Array, " runs"]:
    """Return the index of the value that is nearest to every input, the first of two equally near ones."""
    found: Int[Array, " runs"] = np.abs(values - u).argmin(axis=1)
    return found


@dataclass(frozen=True, eq=False)
class Actions:
    """How inputs become actions: by a function of the user, as entries of a box, or as the nearest discrete action."""

    low: Float[Array, " nu"]
    high: Float[Array, " nu"]
    function: Callable[[Array], Any] | None = None
    shape: tuple[int, ...] = ()  # of a box
    dtype: Any = float  # of a box
    values: Float[Array, " actions"] | None = None  # inputs of the discrete actions
    first: int = 0  # number of the first discrete action

    @property
    def is_box(self) -> bool:
        """Whether the input is the action."""
        return self.function is None and self.values is None

    def __call__(self, u: Float[Array, " nu"]) -> Any:
        """Return the action of an input."""
        if self.function is not None:
            return self.function(u)
        if self.values is None:
            same = self.dtype is float and u.shape == self.shape
            return u if same else u.reshape(self.shape).astype(self.dtype, copy=False)
        if np.isnan(u[0]):
            raise ValueError("the input is not a number")
        return self.first + int(nearest(u[None], self.values)[0])


def actions_of(space: Any, action: Any, nu: int | None) -> Actions:
    """Return how inputs become the actions of a space, as the key `action` says."""
    spaces = library("gymnasium", "spaces")
    if callable(action):
        if nu is None:
            raise DesignError("name the inputs, or give their number: `action` is a function", "inputs")
        return Actions(np.full(nu, -np.inf), np.full(nu, np.inf), action)
    if isinstance(space, spaces.Box):
        if action is not None:
            raise DesignError("the actions are a box: u is the action; leave the key out", "action")
        return Actions(space.low.astype(float).ravel(), space.high.astype(float).ravel(), shape=space.shape)
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
    return Actions(values.min()[None], values.max()[None], values=values, first=int(space.start))


@dataclass(frozen=True, eq=False)
class Access:
    """How the environments of a plant are made, moved and read; it can be sent to a worker process."""

    env: Any  # ID, or what makes an environment
    options: Mapping[str, Any]  # keywords of its class
    state: Any  # attribute, with dots inside an inner object, or function that is the state; None: the observation
    set_state: Callable[[Any, Array], None] | None  # sets the state where that is no attribute
    ends: bool  # whether a run ends where the environment ends an episode
    writes: bool  # whether the state can be set
    keywords: Sequence[str] = ()  # parameters that are keywords of its class; the others are attributes
    change: Callable[..., Any] | None = None  # sets the parameters, in place of attributes
    action: Actions | None = None  # from an input u to an action
    # output(x, p), or an index per output with whether it is one of the state or of the observation; None where the
    # outputs are states
    output: Any = None
    starts_at_x0: bool = False  # whether x(0) is that of the configuration; otherwise it is the one of `reset`

    def make(self, p: Parameters) -> Any:
        """Make an environment without time limit and without the checks of Gymnasium at every call."""
        keywords = {**self.options, **{name: p[name] for name in self.keywords}}
        if isinstance(self.env, str):
            make = library("gymnasium").make
            found = make(self.env, max_episode_steps=NO_LIMIT, disable_env_checker=True, **keywords)
            # A wrapper of the registration may change actions and observations; without one the calls go to the
            # environment.
            found = found if found.spec.additional_wrappers else found.unwrapped
        else:
            found = self.env(**keywords)
        if self.change is not None:
            self.change(found.unwrapped, p)
            return found
        for name in p:
            if name not in self.keywords:
                setattr(found.unwrapped, name, p[name])
        return found

    def read(self, inner: Any, observation: Any) -> Float[Array, " nx"]:
        """Return a copy of the state in double precision."""
        read = attrgetter(self.state) if isinstance(self.state, str) else self.state
        state: Array = np.array(observation if read is None else read(inner), dtype=float)
        return state if state.ndim == 1 else state.ravel()

    def write(self, inner: Any, x: Array) -> None:
        """Set the state of an environment."""
        if self.set_state is not None:
            self.set_state(inner, x)
            return
        owner, _, name = self.state.rpartition(".")
        target = attrgetter(owner)(inner) if owner else inner
        setattr(target, name, x.reshape(np.shape(getattr(target, name))))

    def measure(self, x: Array, p: Parameters, observation: Any) -> Any:
        """Return an output that is more than entries of the state."""
        if callable(self.output):
            return self.output(x, p)
        seen = np.asarray(observation, dtype=float).ravel()
        return np.array([x[i] if of_state else seen[i] for of_state, i in self.output])


class EnvironmentRun:
    """The environment of one run and method."""

    def __init__(self, access: Access) -> None:
        self.access = access

    def start(self, p: Parameters, x0: Float[Array, " nx"], rng: np.random.Generator) -> None:
        """Make the environment; the seed of its random numbers is the first number of this run's generator."""
        access = self.access
        self.env = access.make(p)
        self.inner = self.env.unwrapped
        self.observation, _ = self.env.reset(seed=int(rng.integers(2**31)))
        if access.starts_at_x0:
            access.write(self.inner, x0)
        self.x = access.read(self.inner, self.observation)

    def step(self, u: Float[Array, " nu"], w: Float[Array, " nw"]) -> Float[Array, " nx"]:
        """Apply an action and add the process noise to the state."""
        access = self.access
        assert access.action is not None
        self.observation, _, terminated, truncated, _ = self.env.step(access.action(u))
        if (terminated or truncated) and access.ends:
            raise OutOfRange(f"the environment has {'terminated' if terminated else 'truncated'} the episode")
        x = access.read(self.inner, self.observation)
        if w.size:
            x += w
            access.write(self.inner, x.copy())
        return x

    def output(self, x: Float[Array, " nx"], p: Parameters) -> Any:
        """Return the output without measurement noise; called where it is more than entries of the state."""
        return self.access.measure(x, p, self.observation)


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
        disturbed = access.writes and (access.output is None or callable(access.output))
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
