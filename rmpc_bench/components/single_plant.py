"""Plants written for one run: an object per run and method, which may keep a memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.single_design import SingleDesign
from rmpc_bench.components.user_class import UserClass, user_class
from rmpc_bench.components.user_runs import UserRuns, finite_rows, numbers
from rmpc_bench.types import Array, Motion, Plant, RunInfo, Signals
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
        objects, signals = _started(delta), {"x": x, "u": u, "w": w, "p": list(delta.p)}
        new = _answers(objects, "step", k, signals, x, "state", "x")
        return Motion(new, objects.failed.copy())

    def output(
        self, k: int, delta: RunPlants, x: Float[Array, "runs nx"], v: Float[Array, "runs nv"]
    ) -> Float[Array, "runs ny"]:
        """Call `output` of every run that has not failed; a failure is reported to the simulation."""
        objects, signals = _started(delta), {"x": x, "v": v, "p": list(delta.p)}
        y = _answers(objects, "output", k, signals, np.zeros((len(x), self.ny)), "output", "y", phase="output")
        objects.report()
        return y if self._asks_v else y + v


def _started(delta: RunPlants) -> UserRuns:
    if delta.objects is None:
        raise RuntimeError("call start before the first step of a plant written for one run")
    return delta.objects


def _answers(
    objects: UserRuns,
    method: str,
    k: int,
    signals: Mapping[str, Any],
    before: Array,
    noun: str,
    symbol: str,
    **options: Any,
) -> Array:
    """Call a method of every run and return its numbers; a run that fails keeps those before."""
    values, shape = before.copy(), before.shape[1:]

    def keep(row: int, answer: Any) -> None:
        values[row] = numbers(answer, noun, shape, "the plant")

    objects.call(method, k, signals, keep, **options)
    if not np.isfinite(values).all():
        wrong = ~finite_rows(values)
        values[wrong] = before[wrong]
        objects.refuse(wrong, f"{method} returned {symbol} with NaN or inf", k, signals)
    return values


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
