"""A configuration while it is validated and built: its sections, None where one has an error, and the noise `same`.

No stage changes a section: it returns a draft with others.  Only what is found on the way (problems, warnings, what is
left out) is collected, in lists that a draft and those made of it share.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Gt
from jaxtyping import Float

from rmpc_bench import registry
from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.components.reference import is_reference
from rmpc_bench.config.claim_keys import ClaimKeys
from rmpc_bench.config.sections import SECTIONS, Keys, Time
from rmpc_bench.config_file.component import Component, read_component
from rmpc_bench.config_file.keys import validate
from rmpc_bench.config_file.tree import OPTIONS, Map, Mark, Problems, locate, problem_at
from rmpc_bench.expressions import quantity
from rmpc_bench.noise import distributions
from rmpc_bench.noise.bursts import Share
from rmpc_bench.noise.gaussian import gaussian, outliers, student_t
from rmpc_bench.types import Array, ConfigError, Noise, NonNegative, Problem
from rmpc_bench.types.tuning import TunedParameter


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


@dataclass(frozen=True)
class NoiseSection:
    """The section `noise`."""

    channels: Mapping[str, tuple[NoiseTerm, ...]] = field(default_factory=dict)  # channel -> the terms of its noise
    cross: Any = None  # cross-covariance of process and measurement noise: numbers, or ``same`` as that of the model

    def of(self, channel: str) -> tuple[NoiseTerm, ...]:
        """Return the terms of the noise of a channel."""
        return self.channels.get(channel, ())


@dataclass(frozen=True)
class Initial:
    """The section `initial`: the true initial state, and where the estimators start; None where one is wrong."""

    x: Any = 0.0
    x_hat: Any = 0.0
    P: Any = "process"
    M: Any = 0.0
    laws: tuple[NoiseTerm, ...] = ()  # deviation of the true initial state from `x`
    units: tuple[str, ...] = ()  # units that stand behind the numbers of `x`

    @property
    def start(self) -> dict[str, Any]:
        """Where the estimators start, by the keys."""
        return {"x_hat": self.x_hat, "P": self.P, "M": self.M}


@dataclass(frozen=True)
class Uncertainty:
    """The section `uncertainty`."""

    laws: Mapping[str, distributions.UncertainLaw] = field(default_factory=dict)  # as given
    scale: float = 1.0  # factor on the spread of all of them

    @property
    def scaled(self) -> dict[str, distributions.UncertainLaw]:
        """The laws with the scale applied."""
        return {name: law.scaled(self.scale) for name, law in self.laws.items()}


class ParameterChange(NamedTuple):
    """An entry of ``perturb`` (a factor on the nominal value of a plant parameter) or ``set`` (its value)."""

    expression: quantity.Expression
    relative: bool
    mark: Mark


@dataclass(frozen=True)
class PlantLimits:
    """The keys `bounds`, `diverged` and `angles` of a plant; None where one is wrong or not given."""

    bounds: Mapping[str, list[float | None]] | None = None
    diverged: Any = None
    angles: Mapping[str, float] | None = None
    units: Mapping[str, set[str]] = field(default_factory=dict)  # name under `bounds` -> units behind its numbers

    @property
    def data(self) -> dict[str, Any]:
        """The keys that are given."""
        given = {"bounds": self.bounds, "diverged": self.diverged, "angles": self.angles}
        return {key: value for key, value in given.items() if value is not None}


@dataclass(frozen=True)
class MethodComponents:
    """The components of a method, the defaults of all methods merged in."""

    label: str | None = None  # template of the label; None if it is made of what differs between the methods
    model: Component | None = None
    estimator: Component | None = None
    controller: Component | None = None
    controlled: bool = False  # whether a controller is given, valid or not
    source: str | None = None  # where its parameters come from, as its key `parameters` says
    search: Search | None = None  # what its key `tune` leaves to a search; None where it has none that is valid

    @property
    def named(self) -> dict[str, Component | None]:
        """The components by their keys."""
        return {"model": self.model, "estimator": self.estimator, "controller": self.controller}

    @property
    def is_valid(self) -> bool:
        """Whether no component has an error; a method without a controller needs none."""
        return all(each is not None for key, each in self.named.items() if key != "controller" or self.controlled)


class Search(NamedTuple):
    """What a search chooses of a method."""

    parameters: tuple[TunedParameter, ...]
    default: tuple[float | None, ...]  # value of each parameter without tuning; None where it is no number
    # the method at the lower end of all ranges: what identifies it does not depend on the values of the file
    lowest: MethodComponents
    values: Mapping[str, float | int] | None  # path -> value that was chosen; None where none was yet
    untuned: MethodComponents  # the method without these values


class AlreadyNoted(ConfigError):
    """What needs something invalid, whose error is noted already; it adds no other."""

    def __init__(self, problems: Sequence[Problem] = ()) -> None:
        super().__init__(problems)


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


@dataclass(frozen=True, eq=False)
class DraftConfig:
    """The sections of a configuration at one point of its sweep, and what was found in them."""

    tree: Map
    coordinates: Mapping[str, str] = field(default_factory=dict)  # swept path -> text of its value
    title: str = ""  # the point in words
    access: CodeAccess = NO_ACCESS  # which files of the user may be loaded
    inherited: Inherited | None = None  # what is inherited; nothing where it is None
    keys: Keys = Keys()
    chosen: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # method -> path -> value that was chosen
    uncertainty: Uncertainty = Uncertainty()
    plant: Component | None = None
    limits: PlantLimits = PlantLimits()
    changes: Mapping[str, ParameterChange] = field(default_factory=dict)  # parameter of the plant -> its change
    model: Component | None = None
    reference: Component | None = None
    input: Component | None = None  # input in open loop; None where there is a controller, or u = 0
    noise: NoiseSection = NoiseSection()
    initial: Initial = Initial()
    methods: Mapping[str, MethodComponents] = field(default_factory=dict)
    metrics: Sequence[Component | None] = ()
    figures: Sequence[Component | None] = ()
    claims: Sequence[ClaimKeys | None] = ()  # None where one has an error
    problems: Problems = field(default_factory=Problems)
    warnings: list[Problem] = field(default_factory=list)  # what is valid but probably not meant
    left_out: list[str] = field(default_factory=list)  # what is inherited and does not fit, in words

    @property
    def time(self) -> Time:
        """The section `time` of a draft in which it is valid."""
        assert self.keys.time is not None
        return self.keys.time

    @cached_property
    def searches(self) -> dict[str, Search]:
        """What is searched, by the names of the methods."""
        return {name: each.search for name, each in self.methods.items() if each.search is not None}

    @property
    def laws(self) -> list[Component | None]:
        """The laws of the noise and of the initial state; None for that of the design model."""
        return [term.law for terms in (*self.noise.channels.values(), self.initial.laws) for term in terms]

    def with_keys(self, **changed: Any) -> DraftConfig:
        """Return a draft with other values of top-level keys."""
        return replace(self, keys=replace(self.keys, **changed))

    def section(self, name: str) -> Any:
        """Return the tree under a top-level key, or the default of the key; the figure of a sweep is another one."""
        if name == "figures" and name not in self.tree and self.coordinates:
            return ["sweep"]
        return self.tree[name] if name in self.tree else SECTIONS[name].default

    def is_inherited(self, path: Sequence[str | int]) -> bool:
        """Whether the value at a path is inherited: where it does not fit, it is left out instead of refused."""
        return self.inherited is not None and self.inherited(locate(self.tree, path))

    def note(self, path: Sequence[str | int], message: str, *, key: bool = False) -> None:
        """Add a problem at the value (or the key) of a path."""
        self.problems.append(problem_at(self.tree, path, message, key=key))

    def checked(self, annotation: Any, path: Sequence[str | int]) -> Any:
        """Validate the value at a path; None where it is wrong."""
        value: Any = self.tree
        for step in path:
            value = value[step]
        return self.problems.tried(validate, annotation, value, path, mark=locate(self.tree, path))

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
        """Validate a component, by default with the place of its path; None where it has an error."""
        mark = locate(self.tree, path) if mark is None else mark
        named: dict[str, Any] = {"mark": mark, "kind": kind, "ignore": ignore, "access": self.access}
        return self.problems.tried(read_component, group, tree, path, **named)

    def components(self, group: str) -> list[Component | None]:
        """Validate a list whose entries are names or mappings with a `kind`."""
        found: list[Component | None] = []
        entries = self.section(group)
        if group == "metrics" and isinstance(entries, list) and not entries:
            self.note([group], "there must be at least one metric")
        for number, entry in enumerate(entries if isinstance(entries, list) else []):
            path: list[str | int] = [group, number]
            if not isinstance(entry, str):
                found.append(self.component(group, entry, path))
            elif registry.is_known(group, entry) or is_reference(entry):
                found.append(self.component(group, Map(mark=locate(self.tree, path)), path, kind=entry))
            else:
                self.note(path, registry.unknown_kind(entry, group))
                found.append(None)
        return found


def metric_names(metrics: Iterable[Component | None]) -> list[str]:
    """Return the names of the valid metrics, as columns and claims use them."""
    return [each.parameters["name"] for each in metrics if each is not None and "name" in each.parameters]
