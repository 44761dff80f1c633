"""What identifies trials: the plain data that are hashed, and the hashes under which results are stored.

All methods share the plant, the noise, the uncertainty, the true initial state, the reference, the time and the seed.
A method is identified by its model, estimator and controller and by where its estimator starts.
Runs, labels, figures, claims, statistics and execution are not hashed: they may change without a new computation.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

import rmpc_bench
from rmpc_bench.config.draft import DraftConfig, MethodComponents, NoiseTerm
from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config_file.component import Component, Writer, as_given, plain_data, without_path
from rmpc_bench.noise.distributions import Distribution, UncertainLaw
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import DesignError
from rmpc_bench.types.errors import unknown


def code_version() -> dict[str, Any]:
    """Return what identifies the code that computes trials; rows of any other code are computed again."""
    return {"numerics": rmpc_bench.NUMERICS}


def digest(data: Any) -> str:
    """Return the SHA-256 of plain data, written as JSON with sorted keys."""
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def key_of_trials(definition: str, code: Mapping[str, Any]) -> str:
    """Return the hash under which the trials of a method are stored."""
    return digest({"definition": definition, "code": code})


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """A configuration at one point of its sweep; without a sweep there is one point."""

    coordinates: Mapping[str, str]  # swept path -> text of its value; empty where nothing is swept
    title: str  # the point in words
    experiment: Experiment  # all designs, ready to run
    shared: Mapping[str, Any]  # what all methods share, as plain data (identity.py)
    methods: Mapping[str, Any]  # method name -> what identifies the method, as plain data
    metrics: Mapping[str, Any]  # metric name -> what identifies the metric, as plain data
    # method name -> what identifies the code that is not built in, as plain data; nothing where there is none
    own_code: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    # method name -> names of the installed modules that this code imports
    modules: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    draft: DraftConfig | None = None  # the validated sections that all of this was made from

    @cached_property
    def experiment_hash(self) -> str:
        """Hash of what all methods share."""
        return digest(self.shared)

    @cached_property
    def definitions(self) -> dict[str, str]:
        """Hashes of what the configuration determines of the trials, by method: all but the code."""
        return {
            name: digest({"experiment": self.experiment_hash, "method": data}) for name, data in self.methods.items()
        }

    @cached_property
    def code(self) -> dict[str, dict[str, Any]]:
        """What identifies the code that computes the trials, by method."""
        here = code_version()
        return {name: {**here, **self.own_code.get(name, {})} for name in self.methods}

    @cached_property
    def method_keys(self) -> dict[str, str]:
        """Hashes under which trials are stored, by method: definition and code; points with equal ones share trials."""
        return {name: key_of_trials(key, self.code[name]) for name, key in self.definitions.items()}

    @cached_property
    def metric_keys(self) -> dict[str, str]:
        """Hashes under which metrics are stored, by metric; the name itself is not hashed."""
        return {name: digest({**data, "name": None}) for name, data in self.metrics.items()}

    @cached_property
    def uncertainty_key(self) -> str:
        """Hash under which the values of the uncertain quantities are stored; the code that draws them is in it."""
        law = self.shared["plant"].get("uncertainty")
        # The plant itself draws these values, once per run; a key of a user's plant may be anything, such as a number.
        own = {"plant": law} if isinstance(law, Mapping) and law.get("per") == "run" else {}
        # Random bursts of the noise are uncertain quantities too; they begin and end on samples.
        if self.experiment.scenario.burst_names:
            own |= {"noise": self.shared["noise"], "step": self.shared["time"]["step"]}
        # A plant or a noise from a file draws values itself.
        own |= {"files": self.shared["code"]} if "code" in self.shared else {}
        return digest({key: self.shared[key] for key in ("seed", "uncertainty")} | own | {"code": code_version()})


def chosen_point(points: Sequence[SweepPoint], at: Mapping[str, str]) -> SweepPoint:
    """Return the first point of a sweep with given values."""
    for path in at:
        if path not in points[0].coordinates:
            raise DesignError(unknown(path, points[0].coordinates, "path of the sweep"), "at")
    found = [point for point in points if all(point.coordinates[path] == value for path, value in at.items())]
    if not found:
        titles = "; ".join(point.title for point in points[:5])
        raise DesignError(f"there is no such point of the sweep; the first ones are {titles}", "at")
    return found[0]


ADDED_LATER: Mapping[tuple[str, str], Any] = {
    ("controllers", "every"): 1,
    ("controllers", "preview"): True,
    ("estimators", "form"): "filter",
    ("estimators/lmmse", "form"): "predictor",
    ("estimators", "noise"): "nominal",
    ("estimators", "use_y0"): True,
    ("metrics", "of"): "output",
    ("models", "D"): None,
    ("models", "scale"): None,
}
"""Keys of a group, or of one kind, that were added after trials had been stored.  Their defaults are left out of the
hash, so earlier trials stay valid."""
RENAMED: Mapping[str, Mapping[str, str]] = {
    "metrics": {"only": "components"}
}  # group -> key -> its name in the hash, under which trials were stored before it was renamed


class ModelFacts(NamedTuple):
    """Properties of a design model."""

    where: str  # ``model``, or ``methods.NAME.model`` for the model of one method
    facts: tuple[tuple[str, str], ...]  # label and text
    remarks: tuple[str, ...]


class Built(NamedTuple):
    """What could be made of a draft."""

    point: SweepPoint | None  # None where a design cannot be made
    calibration: tuple[Component, ...] = ()  # metrics of the key `calibration`, once the number of states is known
    facts: tuple[ModelFacts, ...] = ()  # of the design models at the first point


def sweep_point(
    draft: DraftConfig, experiment: Experiment, calibration: Sequence[Component], own: OwnCode
) -> SweepPoint:
    """Return a point of the sweep with the data that identify its trials; `own` gets its files of the user."""
    return SweepPoint(
        draft.coordinates,
        draft.title,
        experiment,
        _shared(draft, experiment, own),
        {name: _method(draft, experiment, name) for name in draft.methods},
        _metrics([*draft.metrics, *calibration], experiment, own),
        {name: own.identity(components.named) for name, components in draft.methods.items()},
        _modules(draft, own),
        draft,
    )


def _modules(draft: DraftConfig, own: OwnCode) -> dict[str, tuple[str, ...]]:
    """Return method -> names of the installed modules that compute its trials, besides those of the bench."""
    common = own.modules([draft.plant, draft.reference, draft.input, *draft.laws, *draft.metrics])
    return {name: tuple(sorted(common | own.modules(each.named.values()))) for name, each in draft.methods.items()}


def _shared(draft: DraftConfig, experiment: Experiment, own: OwnCode) -> dict[str, Any]:
    """What all methods share."""
    time = draft.time
    common = {
        "seed": draft.keys.seed,
        "time": {"step": time.step, "steps": time.n_steps},
        "uncertainty": uncertainty_data(draft),
        "plant": plant_data(draft, canonical=True),
        "noise": noise_data(draft, experiment, without_path),
        "x": {"mean": experiment.scenario.x0.tolist(), "law": sum_data(draft.initial.laws, without_path)},
        "reference": draft.reference.resolved(without_path) if draft.reference else None,
    }
    roles = {"plant": draft.plant, "reference": draft.reference, "input": draft.input}
    if draft.input is not None:
        common["input"] = draft.input.resolved(without_path)
    plant = experiment.plant
    if plant.opponent is not None:
        opponent = draft.methods[plant.opponent[0]]
        common["against"] = method_data(draft, opponent, without_path)
        roles |= {f"against.{role}": component for role, component in opponent.named.items()}
    sums = draft.noise.channels.items()
    terms = {f"noise.{channel}.{i}": term for channel, sum_ in sums for i, term in enumerate(sum_)}
    terms |= {f"initial.{i}": term for i, term in enumerate(draft.initial.laws)}
    # A density is sampled with the plant's equations at the operating point of the design model.
    densities = [term.law.parameters.get("density") for term in terms.values() if term.law is not None]
    needs_model = any(term.same is not None for term in terms.values()) or any(each is not None for each in densities)
    if draft.model is not None and needs_model:
        # The noise of the plant does not depend on the disturbances of the design model.
        common["model"] = _without_later(draft.model, draft.model.without_shared().resolved(without_path))
        roles["model"] = draft.model
    # An edit of an estimator in the file of the plant is no other experiment.
    code = own.identity({**roles, **{role: term.law for role, term in terms.items()}}, whole=False)
    return {**common, "code": code} if code else common


def _metrics(components: Sequence[Component | None], experiment: Experiment, own: OwnCode) -> dict[str, Any]:
    """What identifies every metric, by its name; a window is given in samples, whatever the unit of time."""
    table = {}
    for metric, component in zip(experiment.metrics, components, strict=True):
        keys = set_keys(component, without_path) if component is not None else {}
        renamed = RENAMED["metrics"] if component is not None and component.is_built_in else {}
        keys = {renamed.get(name, name): value for name, value in keys.items()}
        keys = {name: value for name, value in keys.items() if name not in ("from", "to", "at", "label")}
        code = own.identity({"metric": component}, whole=False)
        keys |= {"code": code} if code else {}
        table[metric.name] = {**keys, "window": list(metric.window(experiment.metric_layout))}
    return table


def _method(draft: DraftConfig, experiment: Experiment, name: str) -> dict[str, Any]:
    """What identifies a method; equal methods share trials, unless a component gives other numbers every time."""
    data, method = method_data(draft, draft.methods[name], without_path), experiment.method(name)
    designs = (experiment.plant, method.estimator, method.controller)
    return data if all(design.deterministic for design in designs) else {**data, "method": name}


def method_data(draft: DraftConfig, components: MethodComponents, write: Writer = as_given) -> dict[str, Any]:
    """What identifies a method: its components, and where its estimator starts."""
    resolved = {name: set_keys(each, write) for name, each in components.named.items() if each is not None}
    nominal = nominal_plant(draft, components.model, write)
    return {**resolved, **({} if nominal is None else {"nominal_plant": nominal}), **start_data(draft)}


def nominal_plant(draft: DraftConfig, model: Component | None, write: Writer = as_given) -> dict[str, Any] | None:
    """Return the keys of the plant that determine a model made from it; None for a model that is not made from it.

    `perturb` and `set` are not among them: such a model has the nominal parameters.
    """
    if model is None or draft.plant is None or not model.takes("plant"):
        return None
    return set_keys(draft.plant, write) | draft.limits.data


def set_keys(component: Component, write: Writer = as_given) -> dict[str, Any]:
    """Return the keys of a component that are set, those of ADDED_LATER only where they differ from their default."""
    keys = _without_later(component, component.resolved(write))
    return {name: value for name, value in keys.items() if value is not None}


def _without_later(component: Component, keys: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out the keys of ADDED_LATER that have their default."""
    groups = (component.group, f"{component.group}/{component.kind}")
    later = {name: value for group in groups for (at, name), value in ADDED_LATER.items() if at == group}
    return {name: value for name, value in keys.items() if name not in later or later[name] != value}


def uncertainty_data(draft: DraftConfig, *, canonical: bool = True) -> dict[str, Any]:
    """Return the distributions of the uncertain quantities; where `canonical`, their scale is applied to them."""
    laws, scale = draft.uncertainty.scaled if canonical else draft.uncertainty.laws, draft.uncertainty.scale
    data = {name: law_data(law) for name, law in laws.items()}
    return data if canonical or scale == 1 else {**data, "scale": scale}


def law_data(law: UncertainLaw) -> dict[str, Any]:
    """Return the keys of a law as plain data."""
    return {"dist": type(law).__name__.lower().removesuffix("group"), **plain_data(law)}


def independent_laws(experiment: Experiment) -> dict[str, dict[str, Any]]:
    """Return the keys of the laws of the uncertain quantities that are drawn alone, of the file and of the plant."""
    found = {**experiment.plant.laws(), **experiment.scenario.uncertainty}
    return {str(name): law_data(law) for name, law in found.items() if isinstance(law, Distribution)}


def plant_data(draft: DraftConfig, *, canonical: bool = False) -> dict[str, Any]:
    """Return the plant with ``perturb`` and ``set``; where `canonical`, without paths, blanks and parentheses."""
    assert draft.plant is not None
    plant = set_keys(draft.plant, without_path if canonical else as_given)
    for key, relative in (("perturb", True), ("set", False)):
        expressions = {
            name: change.expression.canonical if canonical else change.expression.text
            for name, change in draft.changes.items()
            if change.relative == relative
        }
        if expressions:
            plant[key] = expressions
    return plant | draft.limits.data


def noise_data(draft: DraftConfig, experiment: Experiment, write: Writer = as_given) -> Any:
    """Return the noise of the plant as plain data."""
    channels = ("process", "measurement", *(["input"] if draft.noise.of("input") else []))
    noise: dict[str, Any] = {channel: sum_data(draft.noise.of(channel), write) for channel in channels}
    if experiment.scenario.cross is not None:
        noise["cross"] = draft.noise.cross
    return noise


def sum_data(terms: tuple[NoiseTerm, ...], write: Writer = as_given) -> Any:
    """Return the terms of a noise as a configuration writes them; a sum of one term is that term."""
    laws = [_term_data(term, write) for term in terms]
    return {"sum": laws} if len(laws) > 1 else laws[0] if laws else "none"


def _term_data(term: NoiseTerm, write: Writer) -> Any:
    if term.law is None:
        return {"same": {} if term.same is None else term.same.data}
    keys = term.law.resolved(write)
    if term.law.code is not None:
        return {name: value for name, value in keys.items() if value is not None}
    return {keys.pop("kind"): {name: value for name, value in keys.items() if value is not None}}


def start_data(draft: DraftConfig) -> dict[str, Any]:
    """Where the estimators start; the set M is left out where it is 0, so that earlier trials stay valid."""
    start = draft.initial.start
    return start if np.any(start["M"]) else {key: start[key] for key in ("x_hat", "P")}
