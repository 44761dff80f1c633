"""A configuration while it is validated and built: its sections, None where one has an error, and the noise `same`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Gt
from jaxtyping import Float

from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.config_file.component import Component, read_component
from rmpc_bench.config_file.keys import validate
from rmpc_bench.config_file.tree import OPTIONS, Map, Mark, locate, problem_at
from rmpc_bench.expressions import quantity
from rmpc_bench.noise import distributions
from rmpc_bench.noise.bursts import Share
from rmpc_bench.noise.gaussian import gaussian, outliers, student_t
from rmpc_bench.types import Array, Noise, NonNegative, Problem
from rmpc_bench.types.tuning import TunedParameter, ValueRow


@dataclass(frozen=True)
class SameOutliers:
    """Outliers of the noise.

    Parameters
    ----------
    probability : probability that a sample is an outlier, in all coordinates together
    factor : factor on the deviation of an outlier from the mean
    """

    probability: Share
    factor: NonNegative


@dataclass(frozen=True)
class SameLaw:
    """The noise of the design model, with departures from it that every system has in the same measure.

    Parameters
    ----------
    scale : factor on the standard deviation
    bias : shift of the mean, in standard deviations of every coordinate
    outliers : a sample is an outlier with some probability; the covariance of the others is that of the model
    dof : degrees of freedom of Student's t with the covariance of the model; normal unless given
    """

    scale: NonNegative = 1.0
    bias: float = 0.0
    outliers: SameOutliers | None = None
    dof: Annotated[float, Gt(2)] | None = None

    def __post_init__(self) -> None:
        """Refuse two heavy-tailed laws at once."""
        if self.outliers is not None and self.dof is not None:
            raise ValueError("give outliers or dof")

    @property
    def data(self) -> dict[str, Any]:
        """Its keys; what has no effect is left out, so that earlier trials stay valid, but for the scale."""
        given = {"bias": self.bias or None, "outliers": self.outliers and asdict(self.outliers), "dof": self.dof}
        return {"scale": self.scale, **{key: value for key, value in given.items() if value is not None}}

    def noise(self, mean: Float[Array, " n"], cov: Float[Array, "n n"]) -> Noise:
        """Build the stochastic part from mean (n,) and cov (n, n) of the noise of the design model.

        The normal numbers of a run are the same with every key.
        """
        n, shifted = len(mean), mean + self.bias * self.scale * np.sqrt(np.diag(cov))
        centre = shifted.tolist()
        if self.outliers is not None:
            return outliers(n, **vars(self.outliers), cov=cov, mean=centre, scale=self.scale)
        if self.dof is not None:
            matrix = (self.dof - 2) / self.dof * self.scale**2 * cov
            return student_t(n, dof=self.dof, scale_matrix=matrix, mean=centre)
        return gaussian(n, mean=centre, cov=cov, scale=self.scale)


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

    label: str | None  # template of the label; None if it is made of what differs between the methods
    model: Component | None
    estimator: Component | None
    controller: Component | None
    controlled: bool = False  # whether a controller is given, valid or not

    @property
    def named(self) -> dict[str, Component | None]:
        """The components by their keys."""
        return {"model": self.model, "estimator": self.estimator, "controller": self.controller}

    @property
    def is_valid(self) -> bool:
        """Whether no component has an error; a method without a controller needs none."""
        return all(each is not None for key, each in self.named.items() if key != "controller" or self.controlled)


class TunedMethod(NamedTuple):
    """What tuning chooses of a method."""

    parameters: tuple[TunedParameter, ...]
    default: tuple[float | None, ...]  # value of each parameter without tuning; None where it is no number
    # the method at the lower end of all ranges: what identifies it does not depend on the values of the file
    lowest: MethodComponents
    values: Mapping[str, float | int] | None  # path -> value that was chosen; None where none was yet
    untuned: MethodComponents  # the method without these values


@dataclass
class PointTuning:
    """Tuning at one point of the sweep: values that are known, and the methods that have ranges."""

    rows: Sequence[ValueRow] = ()  # known values that the file has
    # method -> path -> known value, of the file or of a search
    chosen: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    methods: dict[str, TunedMethod] = field(default_factory=dict)


class ModelFacts(NamedTuple):
    """Properties of a design model."""

    where: str  # ``model``, or ``methods.NAME.model`` for the model of one method
    facts: tuple[tuple[str, str], ...]  # label and text
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class Inherited:
    """Which parts of a configuration are inherited: by an overridden one from its file, or from an extended file."""

    path: Path
    is_changed: bool  # whether options of the command line change the file

    def __call__(self, mark: Mark) -> bool:
        """Whether the value at a place is inherited."""
        if mark.file.startswith(OPTIONS):
            return False
        return self.is_changed or mark.file != str(self.path)


@dataclass
class DraftConfig:
    """The sections of a configuration at one point of its sweep, and the errors found so far."""

    tree: Map
    problems: list[Problem]
    coordinates: Mapping[str, str] = field(default_factory=dict)  # swept path -> text of its value
    title: str = ""  # the point in words
    access: CodeAccess = NO_ACCESS  # which files of the user may be loaded
    inherited: Inherited | None = None  # what is inherited; nothing where it is None
    values: dict[str, Any] = field(default_factory=dict)
    # laws of the uncertain quantities as given
    laws: dict[str, distributions.UncertainLaw] = field(default_factory=dict)
    scale: float = 1.0  # factor on the spread of all of them
    parameter_changes: dict[str, ParameterChange] = field(default_factory=dict)
    plant: Component | None = None
    # limits of the true state, the keys `bounds` and `diverged` of the plant
    plant_range: dict[str, Any] = field(default_factory=dict)
    # name under `bounds` -> units that stand behind its numbers
    bound_units: dict[str, set[str]] = field(default_factory=dict)
    # units that stand behind the numbers of the initial state; empty where there is none
    start_units: list[str] = field(default_factory=list)
    model: Component | None = None
    reference: Component | None = None
    input: Component | None = None  # input in open loop; None where there is a controller, or u = 0
    noise: dict[str, tuple[NoiseTerm, ...]] = field(default_factory=dict)  # channel -> the terms of its noise
    # cross-covariance of process and measurement noise: numbers, or ``same`` as that of the design model
    cross: Any = None
    initial: dict[str, Any] = field(default_factory=dict)
    methods: dict[str, MethodComponents] = field(default_factory=dict)
    tuning: PointTuning = field(default_factory=PointTuning)
    # method -> where its parameters come from, as its key `parameters` says
    sources: dict[str, str] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=dict)  # method -> its label with the values of the parameters
    warnings: list[Problem] = field(default_factory=list)  # what is valid but probably not meant
    left_out: list[str] = field(default_factory=list)  # what is inherited and does not fit, in words
    model_facts: tuple[ModelFacts, ...] = ()  # properties of the design models, once they are built
    metrics: list[Component | None] = field(default_factory=list)
    # metrics that the key `calibration` adds to them, once the number of states is known
    calibrated: list[Component] = field(default_factory=list)
    figures: list[Component | None] = field(default_factory=list)
    claims: list[Any] = field(default_factory=list)  # the keys of every claim (ClaimKeys); None where it has an error

    @property
    def uncertainty(self) -> dict[str, distributions.UncertainLaw]:
        """Laws of the uncertain quantities with the scale applied."""
        return {name: law.scaled(self.scale) for name, law in self.laws.items()}

    @property
    def metric_names(self) -> list[str]:
        """Names of the valid metrics, as columns and claims use them."""
        valid = [component for component in (*self.metrics, *self.calibrated) if component is not None]
        return [component.parameters["name"] for component in valid if "name" in component.parameters]

    def given(self, name: str) -> Mapping[str, Any]:
        """Return a method as the configuration gives it; nothing where its components are all defaults."""
        found = self.values["methods"][name]
        return found if isinstance(found, Mapping) else {}

    @property
    def with_controller(self) -> list[str]:
        """Names of the methods that have a controller of their own."""
        own = self.values["methods"] or {}
        return [name for name, method in own.items() if isinstance(method, Map) and "controller" in method]

    def is_inherited(self, path: Sequence[str | int]) -> bool:
        """Whether the value at a path is inherited: where it does not fit, it is left out instead of refused."""
        return self.inherited is not None and self.inherited(locate(self.tree, path))

    def note(self, path: list[str | int], message: str, *, key: bool = False) -> None:
        """Add a problem at the value (or the key) of a path."""
        self.problems.append(problem_at(self.tree, path, message, key=key))

    def checked(self, annotation: Any, path: list[str | int]) -> Any:
        """Validate the value at a path; None where it is wrong."""
        parent: Any = self.tree
        for step in path[:-1]:
            parent = parent[step]
        mark = locate(self.tree, path)
        return validate(annotation, parent[path[-1]], path, self.problems, mark=mark)

    def component(
        self,
        group: str,
        tree: Any,
        path: Sequence[str | int],
        *,
        mark: tuple[str, int, int] | None = None,
        kind: str | None = None,
        ignore: Sequence[str] = (),
    ) -> Component | None:
        """Validate a component, by default with the place of its path; see `read_component`."""
        mark = locate(self.tree, path) if mark is None else mark
        return read_component(group, tree, path, self.problems, mark=mark, kind=kind, ignore=ignore, access=self.access)
