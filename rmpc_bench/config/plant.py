"""The keys of every plant that are no parameters of its design: `bounds`, `diverged`, `perturb` and `set`.

A plant may have names for its states and inputs, as one with a differential equation has.  Its inputs may then have
bounds, too: they are limited to them.  With recorded data (the plant `data`, the input `file`) there is no controller,
since the recorded input is replayed; the data contain their noise and their initial state.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Len, Lt
from jaxtyping import Float
from pydantic import BeforeValidator

from rmpc_bench.config.draft import DraftConfig, ParameterChange, PlantLimits
from rmpc_bench.config.noise import uncertain_names
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.keys import shown
from rmpc_bench.config_file.tree import Map, error_at, locate_key
from rmpc_bench.expressions import quantity
from rmpc_bench.expressions.quantity import Expression, QuantityError
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.scenario import Experiment, RunParameter
from rmpc_bench.simulation.state_range import LARGEST, StateRange
from rmpc_bench.types import Array, Method, Metric, Model, Plant, Positive
from rmpc_bench.types.angles import places


@dataclass(frozen=True)
class UncertainParameter(RunParameter):
    """A plant parameter as a function of the named uncertain values of a run."""

    expression: Expression
    factor: float

    def __call__(self, values: Mapping[str, float]) -> float:
        """Return the parameter; NaN where the arithmetic fails, which makes the run `out-of-range`."""
        try:
            return self.factor * self.expression(values)
        except QuantityError:
            return math.nan

    def of_runs(self, columns: Mapping[str, Array], n_runs: int) -> Float[Array, " runs"]:
        """Return the parameters of many runs; run by run where the arithmetic of a run fails."""
        values = self.expression.of_columns(columns, n_runs)
        return super().of_runs(columns, n_runs) if values is None else self.factor * values


DATA = "data"  # kind of a plant that replays recorded runs


def refuse_sections(draft: DraftConfig) -> None:
    """Report the sections that have no meaning beside recorded data."""
    if draft.plant is None or draft.plant.kind != DATA or not draft.plant.is_built_in:
        return
    places: list[list[str | int]] = [["controller"]] if draft.tree.get("controller") is not None else []
    places += [["methods", name, "controller"] for name in draft.keys.with_controller]
    for path in places:
        draft.note(path, "the recorded input is replayed, so that no controller can act; leave it out", key=True)
    if "input" in draft.tree:
        draft.note(["input"], "the input is the recorded one, `plant.columns.u`; leave `input` out", key=True)
    if any(draft.noise.channels.values()):
        draft.note(["noise"], "recorded data contain their noise; leave the section out", key=True)
    if "x" in (draft.keys.initial or {}):
        draft.note(["initial", "x"], "the true initial state is recorded, or not known; leave `x` out", key=True)


def refuse_runs(draft: DraftConfig, n_files: int | None, key: str) -> None:
    """Report more runs than the files under a key have; None stands for any number of runs."""
    runs = draft.keys.runs
    if n_files is None or runs is None or runs <= n_files:
        return
    message = f"there are {runs} runs, and `{key}` names {n_files} file{'s' * (n_files != 1)}: file i is run i"
    if not any(each.message == message for each in draft.problems):
        draft.note(["runs"], message)


def refuse_other_sizes(draft: DraftConfig, name: str, model: Model, plant: Plant) -> bool:
    """Report a design model with other inputs or outputs than the recorded ones; return whether there is an error."""
    # A missing B is one input without effect, which need not be recorded.
    silent = not plant.nu and isinstance(model, Model) and not model.varies and not model.at(0).B.any()
    n_inputs = 0 if silent else model.nu
    wrong = [
        f"{has} {noun} and the recorded data have {recorded}"
        for noun, has, recorded in (("inputs", n_inputs, plant.nu), ("outputs", model.ny, plant.ny))
        if has != recorded
    ]
    if wrong:
        draft.note(["plant"], f"the design model of {name!r} has {', and '.join(wrong)}; see `plant.columns`")
    return bool(wrong)


def metric_problem(component: Component, metric: Metric, plant: Plant) -> str:
    """Say why a metric cannot be computed from recorded data; empty where it can."""
    if plant.recorded is None or plant.nx or metric.of_innovation or not component.is_built_in:
        return ""
    message = "needs a state or a closed loop, and the recorded data have no state (`plant.columns.x`)"
    return f"{message}; without it there are nis, innovation_mse and whiteness"


def gap_warnings(draft: DraftConfig, experiment: Experiment) -> Iterator[tuple[list[str | int], str]]:
    """Find estimators that do not bridge the missing measurements of the data."""
    recorded = experiment.plant.recorded
    without = [each.name for each in experiment.methods if not each.estimator.bridges_missing]
    if recorded is not None and recorded.gaps and without:
        message = f"measurements are missing ({recorded.gaps}), and the estimator of {', '.join(map(repr, without))}"
        yield ["plant"], f"{message} does not bridge them: these runs diverge there"


RANGE_KEYS = ("bounds", "diverged", "angles")  # keys of a plant that are no parameters of its design


Entry = Annotated[Any, BeforeValidator(lambda given: None if given is None else quantity.with_unit(given))]
Bounds: Any = dict[str, Annotated[list[Entry], Len(2, 2)]]
Limit = Annotated[float, Gt(0), Lt(LARGEST)]
Limits: Any = Limit | list[Limit] | dict[str, Limit]
Angles: Any = list[str] | dict[str, Positive]


def read_limits(draft: DraftConfig) -> PlantLimits:
    """Validate the limits of the state as far as the plant need not be known."""
    tree = draft.tree.get("plant")
    if not isinstance(tree, Map):
        return PlantLimits()
    bounds, diverged, angles = (
        draft.checked(annotation, ["plant", key]) if key in tree else None
        for key, annotation in zip(RANGE_KEYS, (Bounds, Limits, Angles), strict=True)
    )
    if isinstance(angles, list):
        if len({*angles}) < len(angles):
            draft.note(["plant", "angles"], f"must name each signal once (got {', '.join(angles)})")
        angles = dict.fromkeys(angles, 2.0 * np.pi)
    if not bounds:
        return PlantLimits(bounds, diverged, angles)
    pairs = {name: [None if each is None else each[0] for each in pair] for name, pair in bounds.items()}
    units = {name: {each[1] for each in pair if each} - {""} for name, pair in bounds.items()}
    return PlantLimits(pairs, diverged, angles, units)


def read_changes(draft: DraftConfig) -> dict[str, ParameterChange]:
    """Read the parameters of the plant that `perturb` and `set` change."""
    found: dict[str, ParameterChange] = {}
    tree = draft.tree.get("plant")
    for key in ("perturb", "set"):
        entries = tree.get(key, {}) if isinstance(tree, Map) else {}
        if not isinstance(entries, dict):
            draft.note(["plant", key], f"must be a mapping (got {shown(entries)})")
            continue
        for name, text in entries.items():
            path = ["plant", key, name]
            if name in found:
                draft.note(path, "is already changed by perturb; give one of the two", key=True)
            change = draft.problems.tried(_change, draft.tree, path, text)
            if change is not None:
                found[name] = change
    return found


def _change(tree: Map, path: list[str], text: Any) -> ParameterChange:
    _, key, name = path
    try:
        if isinstance(text, str) and quantity.spread(text) is not None:
            message = f"write the range under `uncertainty`, {{eps: {text}}}, and {name}: 1 + eps here"
            raise error_at(tree, path, message)
        expression = quantity.parse(text, uncertain_names(tree))
        if not expression.names:
            # It is the same in every run: an error shows before any of them.
            expression()
        return ParameterChange(expression, key == "perturb", locate_key(tree, path))
    except quantity.QuantityError as error:
        raise error_at(tree, path, str(error)) from None


def given_bounds(draft: DraftConfig) -> dict[str, tuple[float, float]]:
    """Return the bounds by their names, with infinity where there is none; those with an error are left out."""
    bounds = draft.limits.bounds or {}
    pairs = {name: _pair(*given) for name, given in bounds.items()}
    return {name: pair for name, pair in pairs.items() if pair[0] < pair[1]}


def mean_start(draft: DraftConfig) -> Any:
    """Mean of the initial state as plain data, as far as its laws say it; None where it has an error."""
    x = draft.initial.x
    try:
        for term in draft.initial.laws:
            keys = {} if term.law is None else term.law.parameters
            x = np.add(x, keys.get("mean", keys.get("center", 0.0)))
        return np.asarray(x, dtype=float).tolist()
    except (TypeError, ValueError):
        return None


def refuse_start(draft: DraftConfig, plant: Plant) -> None:
    """Report an initial state beside a plant that has its own, but not that of recorded runs; see `recorded_data`."""
    if plant.has_own_start and plant.recorded is None and "x" in (draft.keys.initial or {}):
        way_out = "leave `x` out, or let the plant start from it (`plant.start: initial`)"
        draft.note(["initial", "x"], f"the true initial state is the plant's own; {way_out}", key=True)


AT_POINT = 1e-6  # relative difference up to which a reference is the output of an operating point


def refuse_reference(draft: DraftConfig, r: Float[Array, "samples ny"], methods: Sequence[Method]) -> None:
    """Refuse a reference other than 0, or than the output of the operating point, for a regulator."""
    wrong: dict[str, list[str]] = {}
    for each in methods:
        if not each.controller.regulates:
            continue
        y = each.controller.regulates_to
        if y is None and r.any():
            wrong.setdefault("the state to 0", []).append(each.name)
        elif y is not None and not np.allclose(r, y, rtol=AT_POINT, atol=AT_POINT * float(np.abs(y).max())):
            numbers = ", ".join(f"{value:.9g}" for value in y)
            wrong.setdefault(f"to the operating point, y = {numbers},", []).append(each.name)
    for where, names in wrong.items():
        message = f"the controller of {', '.join(map(repr, names))} regulates {where} and follows no reference"
        draft.note(["reference"], message)


def refuse_unreachable(draft: DraftConfig, r: Float[Array, "samples ny"], plant: Plant, x0: Array | None) -> None:
    """Refuse a reference or an initial state outside the workspace of the plant."""
    reason = plant.unreachable(r)
    if reason is not None:
        draft.note(["reference"], reason)
    reason = None if x0 is None else plant.unreachable(x0[None, : plant.ny])
    if reason is not None:
        draft.note(["initial", "x"], reason)


def angles_of(draft: DraftConfig, plant: Plant) -> dict[str, float]:
    """Return the periods of the angles of a plant by the places of their components; unknown names are noted."""
    found, known = dict[str, float](), dict[str, list[str]]()
    for place in (*places("x", plant.nx), *places("y", plant.ny)):
        for name in {place, plant.names.get(place, place)}:
            known.setdefault(name, []).append(place)
    for name, period in (draft.limits.angles or {}).items():
        if name not in known:
            draft.note(["plant", "angles"], unknown(name, known, "state or output of this plant"))
        if not found.keys().isdisjoint(known.get(name, ())):
            draft.note(["plant", "angles"], f"names {name!r} twice")
        found |= dict.fromkeys(known.get(name, ()), period)
    return found


def build_range(draft: DraftConfig, plant: Plant, x0: Array | None) -> StateRange:
    """Expand the validated keys to the states of a plant; errors are added to the problems of the draft.

    `x0` is the true initial state without its deviation, None where it has an error.
    """
    bounds, found = draft.limits.bounds or {}, len(draft.problems)
    inputs = () if plant.signals is None else (*plant.signals.inputs, *(f"u.{i}" for i in range(plant.nu)))
    low, high = np.full(plant.nx, -np.inf), np.full(plant.nx, np.inf)
    for i, (name, unit) in enumerate(zip(state_names(plant), draft.initial.units, strict=False)):
        for message in _wrong_units(plant, name, {unit} - {""}):
            draft.note(["initial", "x", i], message)
    for name, pair in bounds.items():
        lower, upper = _pair(*pair)
        if not lower < upper:
            message = f"the lower bound {lower:g} must be below the upper bound {upper:g}"
            draft.note(["plant", "bounds", name], message)
        if name in inputs:
            _check_unit(draft, plant, name)
            continue
        states = _states(draft, plant, "bounds", name)
        if states is not None:
            _check_unit(draft, plant, name)
            low[states], high[states] = lower, upper
    largest = _largest(draft, plant)
    # An invalid section has an error of its own, and 0 in its place.
    x0 = None if draft.keys.initial is None else x0
    if x0 is not None and not plant.has_own_start and x0.shape == low.shape and len(draft.problems) == found:
        _check_start(draft, plant, x0, StateRange(low, high, largest))
    scale = 1.0 if plant.recorded is None else plant.recorded.scale
    return StateRange(low, high, largest, scale) if bounds else StateRange(largest=largest, least_scale=scale)


def _pair(lower: float | None, upper: float | None) -> tuple[float, float]:
    return -np.inf if lower is None else lower, np.inf if upper is None else upper


def _largest(draft: DraftConfig, plant: Plant) -> Array | None:
    """Return the magnitudes beyond which a run has diverged: NaN for a state without one, None without any."""
    diverged = draft.limits.diverged
    if isinstance(diverged, Mapping):
        largest = np.full(plant.nx, np.nan)
        for name, value in diverged.items():
            states = _states(draft, plant, "diverged", name)
            if states is not None:
                largest[states] = value
        return largest
    if isinstance(diverged, list) and len(diverged) != plant.nx:
        message = f"has {len(diverged)} entries; give one number, or one for each of the {plant.nx} states"
        draft.note(["plant", "diverged"], message)
        return None
    return None if diverged is None else np.broadcast_to(np.array(diverged, dtype=float), (plant.nx,)).copy()


def state_names(plant: Plant) -> tuple[str, ...]:
    """Names of the states; ``x.0``, ``x.1`` and so on where a plant has none."""
    return plant.signals.states if plant.signals is not None else tuple(f"x.{i}" for i in range(plant.nx))


def _states(draft: DraftConfig, plant: Plant, key: str, name: str) -> slice | None:
    """Return the states that a name stands for: its own, `x` for all, `x.i` for one, counted from 0."""
    names = state_names(plant)
    if name == "x":
        return slice(None)
    if name in names:
        return slice(names.index(name), names.index(name) + 1)
    number = int(name[2:]) if re.fullmatch(r"x\.\d{1,6}", name) else plant.nx
    if number < plant.nx:
        return slice(number, number + 1)
    if plant.signals is not None:
        known = (*names, *(plant.signals.inputs if key == "bounds" else ()))
        noun = "state or input of this plant" if key == "bounds" else "state of this plant"
        draft.note(["plant", key, name], unknown(name, known, noun), key=True)
        return None
    known_names = "x.0" if plant.nx == 1 else f"x.0 to x.{plant.nx - 1}"
    message = f"{name!r} is not a state of this plant; its states are {known_names}, and x stands for all of them"
    draft.note(["plant", key, name], message, key=True)
    return None


def _check_unit(draft: DraftConfig, plant: Plant, name: str) -> None:
    """Report a unit other than that of the state or the input."""
    for message in _wrong_units(plant, name, draft.limits.units.get(name, set())):
        draft.note(["plant", "bounds", name], message)


def _wrong_units(plant: Plant, name: str, given: set[str]) -> Iterator[str]:
    places = plant.signals.places() if plant.signals is not None else {}
    own = next((place for place, each in places.items() if each == name and place[0] in "xu"), name)
    unit = plant.units.get(own, plant.u_unit if own.startswith("u") else "")
    for each in sorted(given - {unit}):
        known = f"is in {unit}" if unit else "has no unit"
        yield f"{name} {known} (got {each}); units are compared by name, and numbers are not converted"


def _check_start(draft: DraftConfig, plant: Plant, x0: Array, limits: StateRange) -> None:
    """Report an initial state with which every run fails at once."""
    low, high, largest, _ = limits
    assert low is not None and high is not None
    path: list[str | int] = ["initial", "x"] if "x" in (draft.keys.initial or {}) else ["plant"]
    names = state_names(plant)
    for i in np.flatnonzero((x0 < low) | (x0 > high)):
        draft.note(path, f"{names[i]} starts at {x0[i]:g}, outside its plant.bounds [{low[i]:g}, {high[i]:g}]")
    with np.errstate(invalid="ignore"):
        beyond = np.flatnonzero(np.abs(x0) > (np.inf if largest is None else largest))
    for i in beyond:
        draft.note(path, f"{names[i]} starts at {x0[i]:g}, beyond plant.diverged = {np.asarray(largest)[i]:g}")
