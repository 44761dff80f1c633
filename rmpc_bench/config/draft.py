"""A configuration while it is validated and built: its sections, with None where a section has an error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.config.same_law import SameLaw
from rmpc_bench.config.sections import SECTIONS, ClaimKeys
from rmpc_bench.config.tune_section import ValueRow
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.keys import validate
from rmpc_bench.config_file.tree import Map, Mark, join, locate, locate_key
from rmpc_bench.expressions import quantity
from rmpc_bench.noise import distributions
from rmpc_bench.types import Problem
from rmpc_bench.types.tuning import TunedParameter


class NoiseTerm(NamedTuple):
    """One term of a noise: a law of a registered kind, or the noise of the design model with a departure from it."""

    law: Component | None
    same: SameLaw | None


class ParameterChange(NamedTuple):
    """An entry of ``perturb`` (a factor on the nominal value of a plant parameter) or ``set`` (its value)."""

    expression: quantity.Expression
    relative: bool
    mark: Mark


@dataclass
class MethodComponents:
    """The components of a method, the defaults of all methods merged in."""

    label: str | None
    """Template of the label; None if it is made of what differs between the methods."""
    model: Component | None
    estimator: Component | None
    controller: Component | None
    controlled: bool = False
    """Whether a controller is given, valid or not."""

    @property
    def named(self) -> dict[str, Component | None]:
        """The components by their keys."""
        return {"model": self.model, "estimator": self.estimator, "controller": self.controller}


class TunedMethod(NamedTuple):
    """What tuning chooses of a method."""

    parameters: tuple[TunedParameter, ...]
    default: tuple[float | None, ...]
    """Value of each parameter without tuning; None where it is no number."""
    lowest: MethodComponents
    """The method at the lower end of all ranges: what identifies it does not depend on the values of the file."""
    values: Mapping[str, float | int] | None
    """Path -> value that was chosen; None where none was yet."""


class ModelFacts(NamedTuple):
    """Properties of a design model."""

    where: str
    """``model``, or ``methods.NAME.model`` for the model of one method."""
    facts: tuple[tuple[str, str], ...]
    """Label and text."""
    remarks: tuple[str, ...]


@dataclass
class DraftConfig:
    """The sections of a configuration at one point of its sweep.

    Parameters
    ----------
    tree : the configuration
    problems : the errors found so far
    coordinates : swept path -> text of its value
    title : the point in words
    """

    tree: Map
    problems: list[Problem]
    coordinates: Mapping[str, str] = field(default_factory=dict)
    title: str = ""
    access: CodeAccess = NO_ACCESS
    """Which files of the user may be loaded."""
    values: dict[str, Any] = field(default_factory=dict)
    laws: dict[str, distributions.Distribution] = field(default_factory=dict)
    """Laws of the uncertain quantities as given."""
    scale: float = 1.0
    """Factor on the spread of all of them."""
    parameter_changes: dict[str, ParameterChange] = field(default_factory=dict)
    plant: Component | None = None
    plant_range: dict[str, Any] = field(default_factory=dict)
    """Limits of the true state, the keys `bounds` and `diverged` of the plant."""
    bound_units: dict[str, set[str]] = field(default_factory=dict)
    """Name under `bounds` -> units that stand behind its numbers."""
    start_units: list[str] = field(default_factory=list)
    """Units that stand behind the numbers of the initial state; empty where there is none."""
    model: Component | None = None
    reference: Component | None = None
    input: Component | None = None
    """Input in open loop; None where there is a controller, or u = 0."""
    noise: dict[str, tuple[NoiseTerm, ...]] = field(default_factory=dict)
    """Channel -> the terms of its noise."""
    cross: Any = None
    """Cross-covariance of process and measurement noise: numbers, or ``same`` as that of the design model."""
    initial: dict[str, Any] = field(default_factory=dict)
    methods: dict[str, MethodComponents] = field(default_factory=dict)
    rows: Sequence[ValueRow] = ()
    """Values of this point that the file has."""
    chosen: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Method -> path -> value that tuning has chosen at this point."""
    tuned: dict[str, TunedMethod] = field(default_factory=dict)
    defaults: dict[str, MethodComponents] = field(default_factory=dict)
    """Tuned method with values that were chosen -> its components without them."""
    sources: dict[str, str] = field(default_factory=dict)
    """Method -> where its parameters come from, as its key `parameters` says."""
    labels: dict[str, str] = field(default_factory=dict)
    """Method -> its label with the values of the parameters."""
    warnings: list[Problem] = field(default_factory=list)
    """What is valid but probably not meant."""
    left_out: list[str] = field(default_factory=list)
    """What is inherited and does not fit, in words."""
    model_facts: tuple[ModelFacts, ...] = ()
    """Properties of the design models, once they are built."""
    metrics: list[Component | None] = field(default_factory=list)
    figures: list[Component | None] = field(default_factory=list)
    claims: list[ClaimKeys | None] = field(default_factory=list)

    @property
    def uncertainty(self) -> dict[str, distributions.Distribution]:
        """Laws of the uncertain quantities with the scale applied."""
        return {name: law.scaled(self.scale) for name, law in self.laws.items()}

    @property
    def metric_names(self) -> list[str]:
        """Names of the valid metrics, as columns and claims use them."""
        valid = [component for component in self.metrics if component is not None]
        return [component.parameters["name"] for component in valid if "name" in component.parameters]

    def given(self, name: str) -> Mapping[str, Any]:
        """Return a method as the configuration gives it; nothing where its components are all defaults."""
        found = self.values["methods"][name]
        return found if isinstance(found, Mapping) else {}

    def note(self, path: list[str | int], message: str, *, key: bool = False) -> None:
        """Add a problem at the value (or the key) of a path."""
        mark = (locate_key if key else locate)(self.tree, path)
        self.problems.append(Problem(*mark, join(path), message))

    def section(self, name: str) -> Any:
        """Return the tree under a top-level key, or the default of the key; the figure of a sweep is another one."""
        if name == "figures" and name not in self.tree and self.coordinates:
            return ["sweep"]
        return self.tree[name] if name in self.tree else SECTIONS[name].default

    def checked(self, annotation: Any, path: list[str | int]) -> Any:
        """Validate the value at a path; None where it is wrong."""
        parent: Any = self.tree
        for step in path[:-1]:
            parent = parent[step]
        mark = locate(self.tree, path)
        return validate(annotation, parent[path[-1]], path, self.problems, mark=mark)
