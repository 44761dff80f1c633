"""Plants written for one run: an object or an environment per run and method, which may keep a memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.single_design import SingleDesign
from rmpc_bench.components.user_class import UserClass, user_class
from rmpc_bench.components.user_runs import UserRuns, finite_rows, numbers
from rmpc_bench.types import Array, Motion, OutOfRange, Plant, RunInfo, Signals
from rmpc_bench.types.ode import Parameters


class RunPlants(NamedTuple):
    """Record of the plants of a block: the drawn parameters, and from `start` on the user's objects."""

    parameters: Mapping[str, Array]  # (runs,) values by name
    objects: UserRuns | None = None
    p: tuple[Parameters, ...] = ()  # the parameters of every run


class SingleRunPlant(SingleDesign, Plant):
    """The plants of a class of the user, one object per run and method."""

    role = "plant"

    def __init__(self, user: UserClass, given: Mapping[str, Any]) -> None:
        super().__init__(user, given)
        sizes: dict[str, Any] = {"Ts": float(given["Ts"])}
        for name in ("nx", "nu", "ny", "nw", "nv", "nominal", "units", "y_unit", "u_unit"):
            value = self.keys.get(name, user.constant(name, None))
            if value is not None:
                sizes[name] = value
        if user.constant("nw", None) is None and "w" not in user.arguments["step"].names:
            # A step that does not ask for the process noise has none.
            sizes["nw"] = 0
        # Sizes and units are attributes of the instance in place of the defaults of the base class.
        self.__dict__.update(sizes)
        self._asks_v = "v" in user.arguments["output"].names

    def draw(
        self, parameters: Mapping[str, Float[Array, " runs"]], rngs: Sequence[np.random.Generator], n_steps: int
    ) -> RunPlants:
        """Keep the parameters; the objects are made in `start`."""
        return RunPlants(dict(parameters))

    def start(self, delta: RunPlants, x0: Float[Array, "runs nx"], runs: RunInfo | None) -> RunPlants:
        """Make the objects of one method."""
        n_runs = len(x0)
        names = list(delta.parameters)
        p = tuple(Parameters({name: float(delta.parameters[name][row]) for name in names}) for row in range(n_runs))
        objects = self.user_runs(n_runs, runs, {"p": list(p), "x0": x0})
        objects.report()
        return RunPlants(delta.parameters, objects, p)

    def step(
        self,
        k: int,
        delta: RunPlants,
        x: Float[Array, "runs nx"],
        u: Float[Array, "runs nu"],
        w: Float[Array, "runs nw"],
    ) -> Motion:
        """Call `step` of every run that has not failed."""
        objects = _started(delta)
        new, shape = x.copy(), (self.nx,)

        def keep(row: int, answer: Any) -> None:
            new[row] = numbers(answer, "state", shape, "the plant")

        signals = {"x": x, "u": u, "w": w, "p": list(delta.p)}
        objects.call("step", k, signals, keep)
        self._refuse("step returned x", new, x, k, objects, signals)
        return Motion(new, objects.failed.copy())

    def output(
        self, k: int, delta: RunPlants, x: Float[Array, "runs nx"], v: Float[Array, "runs nv"]
    ) -> Float[Array, "runs ny"]:
        """Call `output` of every run that has not failed; a failure is reported to the simulation."""
        objects = _started(delta)
        y, shape = np.zeros((len(x), self.ny)), (self.ny,)

        def keep(row: int, answer: Any) -> None:
            y[row] = numbers(answer, "output", shape, "the plant")

        signals = {"x": x, "v": v, "p": list(delta.p)}
        objects.call("output", k, signals, keep, phase="output")
        self._refuse("output returned y", y, np.zeros_like(y), k, objects, signals)
        objects.report()
        return y if self._asks_v else y + v

    def _refuse(
        self, what: str, values: Array, instead: Array, k: int, objects: UserRuns, signals: Mapping[str, Any]
    ) -> None:
        """Fail the runs with numbers that are not finite."""
        if not np.isfinite(values).all():
            wrong = ~finite_rows(values)
            values[wrong] = instead[wrong]
            objects.refuse(wrong, f"{what} with NaN or inf", k, signals)


def _started(delta: RunPlants) -> UserRuns:
    if delta.objects is None:
        raise RuntimeError("call start before the first step of a plant written for one run")
    return delta.objects


@dataclass(frozen=True)
class Access:
    """How the environments of a plant are made, moved and read."""

    make: Callable[[Parameters], Any]  # returns a new environment for the parameters of a run
    action: Callable[[Array], Any]  # from an input u to an action of the environment
    # from the innermost environment to its state; None where the state is the observation
    read: Callable[[Any], Any] | None
    # sets the state of the innermost environment; None where it cannot be set
    write: Callable[[Any, Array], None] | None
    # from the state, the parameters and the observation to the output; None where outputs are states
    measure: Callable[[Array, Parameters, Array], Any] | None = None
    measures_observation: bool = False  # whether an output is an entry of the observation
    starts_at_x0: bool = False  # whether x(0) is that of the configuration; otherwise it is the one of `reset`
    ends: bool = True  # whether a run ends where the environment ends an episode

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


class ObjectPlant(SingleRunPlant):
    """A plant whose objects have their own state, which their attribute `x` shows after the start.

    The class `run` of the objects has `start`, `step` and `output`; it is called with `given`, `Ts` and `n_steps`.
    `has_own_start` says whether x(0) is that of the objects.
    """

    def __init__(
        self,
        run: type,
        given: Mapping[str, Any],
        signals: Signals,
        nominal: Mapping[str, float],
        *,
        nw: int,
        has_own_start: bool,
    ) -> None:
        super().__init__(user_class("plants", run), given)
        self.described: tuple[tuple[str, str], ...] = ()
        # These are attributes of the instance in place of the defaults of the base class.
        self.__dict__ |= {
            "signals": signals,
            "nominal": dict(nominal),
            "nx": signals.nx,
            "nu": signals.nu,
            "ny": signals.ny,
            "nv": signals.ny,
            "nw": nw,
            "has_own_start": has_own_start,
            "names": signals.component_names(),
            "units": signals.component_units(),
        }

    def facts(self) -> list[tuple[str, str]]:
        """What the objects are and how they are used."""
        return list(self.described)

    def first_state(self, delta: RunPlants, x0: Float[Array, "runs nx"]) -> Float[Array, "runs nx"]:
        """Return x(0) of the objects."""
        made = [] if delta.objects is None else delta.objects.made
        first = [getattr(each, "x", x0[row]) for row, each in enumerate(made)]
        return np.array(first).reshape(x0.shape) if first else x0
