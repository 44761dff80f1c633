"""From validated parts to an Experiment: every design is made here, once, before any run.

What a design refuses is noted at the place of the parameter to blame; the other designs are made all the same, so that
a user sees every mistake at once.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from rmpc_bench.config.build_noise import NoiseLaws
from rmpc_bench.config.component import Component
from rmpc_bench.config.draft import DraftConfig, MethodComponents
from rmpc_bench.expressions.quantity import Expression, QuantityError
from rmpc_bench.metrics.tracking import Units
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.adversary import worst_sequence
from rmpc_bench.simulation.moments import exact_laws
from rmpc_bench.simulation.recording import has_bursts, with_bursts
from rmpc_bench.simulation.reference import Reference
from rmpc_bench.simulation.rest import Rest
from rmpc_bench.simulation.scenario import (
    Experiment,
    Recording,
    Scenario,
    initial_covariance,
    initial_state,
)
from rmpc_bench.types import (
    Array,
    DesignError,
    HasOpponent,
    HasWorkspace,
    Method,
    Metric,
    Plant,
    Problem,
    Regulates,
)


@dataclass(frozen=True)
class Changed:
    """A plant parameter as a function of the named uncertain values of a run."""

    expression: Expression
    factor: float

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value of the parameter; NaN where the arithmetic has none, which the plant takes for out of range."""
        try:
            return self.factor * self.expression(values)
        except QuantityError:
            return math.nan


class _Builder:
    """Builds what can be built from a draft and notes what cannot."""

    def __init__(self, draft: DraftConfig, made: dict[str, Any], *, smoke: bool) -> None:
        self.draft, self.made, self.smoke = draft, made, smoke
        self.time = draft.values["time"]
        self.n_steps: int = self.time.n_steps

    def once(self, what: Any, make: Callable[[], Any]) -> Any:
        """Make something that is described by plain data, unless another point of the sweep has it already."""
        key = json.dumps(what, sort_keys=True)
        if self.made.get(key) is None:
            self.made[key] = make()
        return self.made[key]

    def plant(self) -> Plant | None:
        """Build the plant and check the names of what is changed in it."""
        part = self.draft.plant
        if part is None:
            return None
        size = {"Ts": self.time.step, "n_steps": self.n_steps}
        plant: Plant | None = self.once(
            ["plant", size, part.resolved()], lambda: part.build(self.draft.problems, **size)
        )
        if plant is not None:
            for name, change in self.draft.changes.items():
                if name not in plant.nominal:
                    message = unknown(name, plant.nominal, f"parameter of {part.kind}")
                    key = "perturb" if change.relative else "set"
                    self.draft.problems.append(Problem(*change.problem_at, f"plant.{key}.{name}", message))
        return plant

    def model(self, part: Component | None) -> Any:
        """Build a model; methods that believe the same share one."""
        if part is None:
            return None
        size = {"Ts": self.time.step, "n_steps": self.n_steps}
        return self.once(["model", size, part.resolved()], lambda: part.build(self.draft.problems, **size))

    def start(self, model: Any) -> dict[str, Array] | None:
        """Return x0, P0 and M0 of the estimators, for the size of a model."""
        given, P = self.draft.initial, self.draft.initial["P"]
        if any(given[key] is None for key in ("x_hat", "P", "M")):
            return None
        x0 = self.sized("x_hat", initial_state, given["x_hat"], model.nx)
        P0 = model.Q_w if isinstance(P, str) else self.sized("P", initial_covariance, P, model.nx)
        M0 = self.sized("M", initial_covariance, given["M"], model.nx)
        return None if x0 is None or P0 is None or M0 is None else {"x0": x0, "P0": P0, "M0": M0}

    def sized(self, key: str, expand: Callable[[Any, int], Array], value: Any, n: int) -> Array | None:
        """Expand a short form under `initial`; a size that does not fit is noted there."""
        try:
            return expand(value, n)
        except DesignError as error:
            self.draft.note(["initial", key], str(error))
            return None

    def method(self, name: str, parts: MethodComponents, plant: Plant | None) -> Method | None:
        """Build one estimator-controller pair; points of a sweep that agree on it share it."""
        named = {"model": parts.model, "estimator": parts.estimator, "controller": parts.controller}
        described = {key: part.resolved() for key, part in named.items() if part is not None}
        key = ["method", name, self._size(), described, self._told(parts)]
        made = self.once(key, lambda: self._method(name, parts, plant))
        return cast("Method | None", made)

    def _method(self, name: str, parts: MethodComponents, plant: Plant | None) -> Method | None:
        problems, model = self.draft.problems, self.model(parts.model)
        if model is None:
            return None
        start = self.start(model)
        estimator = None
        if parts.estimator is not None and start is not None:
            provided = {"model": model, "n_steps": self.n_steps, **start, "plant": plant}
            estimator = self.estimator(parts, provided)
        if parts.controller is None and parts.controlled:
            return None  # what is wrong with the controller has been noted
        if parts.controller is None:
            controller: Any = Rest(model.nu)
        elif estimator is None and parts.controller.asks("estimator"):
            return None  # what is wrong with the estimator has been noted
        else:
            provided = {"model": model, "n_steps": self.n_steps, "estimator": estimator}
            controller = parts.controller.build(problems, **provided)
        return None if estimator is None or controller is None else Method(name, estimator, controller)

    def estimator(self, parts: MethodComponents, provided: Mapping[str, Any]) -> Any:
        """Build an estimator; methods and points of a sweep that believe the same share one."""
        part, model = parts.estimator, parts.model
        assert part is not None and model is not None
        if part.asks("plant") and provided["plant"] is None:
            return None  # what is wrong with the plant has been noted
        key = ["estimator", self._size(), model.resolved(), part.resolved(), self._told(parts)]
        return self.once(key, lambda: part.build(self.draft.problems, **provided))

    def _told(self, parts: MethodComponents) -> Any:
        """What an estimator is told of the truth, as plain data."""
        part, plant = parts.estimator, self.draft.plant
        return plant.resolved() if part is not None and plant is not None and part.asks("plant") else None

    def opposed(self, plant: Plant, methods: Sequence[Method | None], scenario: Scenario) -> Plant | None:
        """Let the adversary of a plant that has one choose its sequence, against the method it names."""
        if not isinstance(plant, HasOpponent) or plant.opponent is None:
            return plant
        name, radius = plant.opponent
        path: list[str | int] = ["plant", "uncertainty", "against"]
        if name not in self.draft.methods:
            self.draft.note(path, unknown(name, self.draft.methods, "method"))
            return None
        method = next((method for method in methods if method is not None and method.name == name), None)
        if method is None:
            return None  # what is wrong with it has been noted
        laws = exact_laws(plant, method, scenario)
        if isinstance(laws, str):
            self.draft.note(path, f"{name}: {laws}")
            return None
        parts = self.draft.methods[name]
        described = [part.resolved() for part in (parts.model, parts.estimator) if part is not None]
        resolved = self.draft.plant.resolved() if self.draft.plant is not None else None
        key = ["opposed", self._size(), resolved, described, [each.tolist() for each in laws]]
        truth, schedule = cast("HasOpponent", plant), cast("Any", method.estimator)
        try:
            made = self.once(
                key, lambda: truth.against(worst_sequence(cast("Any", truth), schedule, laws, self.n_steps, radius))
            )
        except DesignError as error:
            self.draft.note(path, f"{name}: {error}")
            return None
        return cast("Plant", made)

    def _size(self) -> list[Any]:
        """What all designs depend on beside their own keys."""
        return [self.time.step, self.n_steps, *(self.draft.initial[key] for key in ("x_hat", "P", "M"))]

    def scenario(self, plant: Plant, reference: Reference) -> Scenario | None:
        """Gather what befalls every run."""
        draft = self.draft
        x = draft.initial["x"]
        x0 = None if x is None else self.sized("x", initial_state, x, plant.nx)
        laws = NoiseLaws(draft, lambda: self.model(draft.model))
        x0_noise = laws.terms(draft.initial["laws"], plant.nx, "initial")
        process = laws.terms(draft.noise.get("process", ()), plant.nw, "process")
        measurement = laws.terms(draft.noise.get("measurement", ()), plant.nv, "measurement")
        if x0 is None or draft.values["seed"] is None or not set(draft.changes) <= set(plant.nominal):
            return None
        scenario = Scenario(
            seed=draft.values["seed"],
            uncertainty=draft.uncertainty,
            parameters={
                name: Changed(change.expression, plant.nominal[name] if change.relative else 1.0)
                for name, change in draft.changes.items()
            },
            x0=x0,
            x0_noise=x0_noise,
            process=process,
            measurement=measurement,
            reference=reference,
        )
        laws.refuse_names(scenario)
        return laws.correlated(plant, scenario)

    def metrics(self, plant: Plant, methods: tuple[Method, ...], scenario: Scenario | None) -> tuple[Metric, ...]:
        """Build the metrics; two of the same name are refused."""
        noted = any(problem.path.startswith("noise") for problem in self.draft.problems)
        bursts = None if scenario is None or noted else has_bursts(scenario)
        units = Units(self.n_steps, self.time.tick, plant.y_unit, plant.u_unit, self.smoke, plant, methods, bursts)
        made = [part.build(self.draft.problems, units=units) for part in self.draft.metrics if part is not None]
        names: set[str] = set()
        for number, metric in enumerate(made):
            if metric is None:
                continue
            name = metric.info.name
            if name in names:
                self.draft.note(["metrics", number], f"{name!r} is given twice; give one a `name`")
            elif name in ("method", "run", "status", "n_failed"):
                self.draft.note(
                    ["metrics", number], f"{name!r} has a meaning in tables and claims already; choose another name"
                )
            elif not re.fullmatch(r"[A-Za-z_]\w*", name):
                self.draft.note(["metrics", number], f"{name!r} is no name: letters, digits and _ (claims use it)")
            names.add(name)
        return tuple(metric for metric in made if metric is not None)

    def refuse_reference(self, reference: Reference, methods: Sequence[Method | None]) -> None:
        """Refuse a reference that a controller would not look at."""
        deaf = [each.name for each in methods if each is not None and isinstance(each.controller, Regulates)]
        if deaf and reference.sample(self.n_steps + 1).any():
            names = ", ".join(map(repr, deaf))
            self.draft.note(["reference"], f"the controller of {names} drives the state to 0 and follows none")

    def refuse_unreachable(self, reference: Reference, plant: Plant, scenario: Scenario | None) -> None:
        """Refuse a reference that leaves the workspace of the plant, and a state that begins outside."""
        if not isinstance(plant, HasWorkspace):
            return
        reason = plant.unreachable(reference.sample(self.n_steps + 1))
        if reason is not None:
            self.draft.note(["reference"], reason)
        reason = plant.unreachable(scenario.x0[None, : plant.ny]) if scenario is not None else None
        if reason is not None:
            self.draft.note(["initial", "x"], reason)

    def recording(self, scenario: Scenario) -> Recording:
        """What to keep of which runs."""
        keys, n_runs = self.draft.values["record"], self.draft.values["runs"]
        first = {"none": 0, "all": n_runs}.get(keys.runs, keys.runs)
        ensemble = not {"moments", "ensemble"}.isdisjoint(self.draft.values["evaluate"])
        asked = Recording(tuple(dict.fromkeys(keys.signals)), min(int(first), n_runs), ensemble)
        return with_bursts(asked, bursts=has_bursts(scenario))


def build(draft: DraftConfig, made: dict[str, Any] | None = None, *, smoke: bool = False) -> Experiment | None:
    """Make every design; None when something is missing, with the reasons in ``draft.problems``.

    Parameters
    ----------
    draft : what the configuration says
    made : designs of other points of the same sweep, to share; gets the new ones
    smoke : cut windows of metrics to a run that is too short for them
    """
    if draft.values["time"] is None:
        return None
    builder = _Builder(draft, {} if made is None else made, smoke=smoke)
    plant = builder.plant()
    methods = [builder.method(name, parts, plant) for name, parts in draft.methods.items()]
    if plant is None or draft.reference is None:
        return None
    reference = draft.reference.build(draft.problems, ny=plant.ny, Ts=plant.Ts)
    scenario = builder.scenario(plant, reference) if reference is not None else None
    metrics = builder.metrics(plant, tuple(method for method in methods if method is not None), scenario)
    if reference is None:
        return None
    builder.refuse_reference(reference, methods)
    builder.refuse_unreachable(reference, plant, scenario)
    opposed = builder.opposed(plant, methods, scenario) if scenario is not None else None
    if scenario is None or opposed is None or draft.problems or any(method is None for method in methods):
        return None
    pairs = tuple(method for method in methods if method is not None)
    recording = builder.recording(scenario)
    return Experiment(opposed, pairs, scenario, metrics, draft.values["runs"], builder.n_steps, recording)
