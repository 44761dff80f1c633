"""What a configuration says, section by section, with None where it says something wrong."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rmpc_bench.config.component import Component
from rmpc_bench.config.reader import Map, join, locate, locate_key
from rmpc_bench.config.schema import validate
from rmpc_bench.config.sections import SECTIONS, ClaimKeys
from rmpc_bench.expressions import quantity
from rmpc_bench.noise import distributions
from rmpc_bench.types import Problem


class Law(NamedTuple):
    """A noise law as configured: a registered kind, or the model's own noise times a scale."""

    part: Component | None
    same: float | None


class Change(NamedTuple):
    """What becomes of a plant parameter: a factor on its nominal value, or a value."""

    expression: quantity.Expression
    relative: bool
    problem_at: tuple[str, int, int]


@dataclass
class MethodComponents:
    """The three parts of a method after the defaults have been merged in."""

    label: str
    model: Component | None
    estimator: Component | None
    controller: Component | None
    controlled: bool = False
    """Whether there is to be a controller, with or without mistakes."""


@dataclass
class DraftConfig:
    """Everything a configuration says; None stands where it says something wrong."""

    tree: Map
    problems: list[Problem]
    values: dict[str, Any] = field(default_factory=dict)
    uncertainty: dict[str, distributions.Distribution] = field(default_factory=dict)
    changes: dict[str, Change] = field(default_factory=dict)
    plant: Component | None = None
    model: Component | None = None
    reference: Component | None = None
    noise: dict[str, tuple[Law, ...]] = field(default_factory=dict)
    """Channel -> the terms of its noise."""
    cross: Any = None
    """Cross-covariance of process and measurement noise: numbers, or `same` as the model's."""
    initial: dict[str, Any] = field(default_factory=dict)
    methods: dict[str, MethodComponents] = field(default_factory=dict)
    metrics: list[Component | None] = field(default_factory=list)
    figures: list[Component | None] = field(default_factory=list)
    claims: list[ClaimKeys | None] = field(default_factory=list)

    def note(self, path: list[str | int], message: str, *, key: bool = False) -> None:
        """Note a mistake at the value (or the key) of a path."""
        mark = (locate_key if key else locate)(self.tree, path)
        self.problems.append(Problem(*mark, join(path), message))

    def section(self, name: str) -> Any:
        """Component of the tree under a top-level key, or its default."""
        return self.tree[name] if name in self.tree else SECTIONS[name].default

    def checked(self, annotation: Any, path: list[str | int]) -> Any:
        """Validate the value at a path."""
        parent: Any = self.tree
        for step in path[:-1]:
            parent = parent[step]
        mark = locate(self.tree, path)
        return validate(annotation, parent[path[-1]], path, self.problems, mark=mark)
