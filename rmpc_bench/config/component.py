"""A component of a configuration (a plant, a model, an estimator and so on) with its position in the file."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rmpc_bench import registry
from rmpc_bench.config.schema import model_of, shown, validate
from rmpc_bench.config.tree import Map, Mark, join, locate
from rmpc_bench.expressions.quantity import Expression
from rmpc_bench.types import DesignError, Issue, Problem


@dataclass(frozen=True, eq=False)
class Component:
    """A validated component, ready to be built.

    Parameters
    ----------
    group, kind : where the registry finds its design function
    parameters : keywords of the design function
    tree : the mapping it was read from, with its marks
    path : where it stands in the configuration
    """

    group: str
    kind: str
    parameters: Mapping[str, Any]
    tree: Map
    path: tuple[str | int, ...]

    def build(self, problems: list[Problem], **provided: Any) -> Any:
        """Call the design function.

        Parameters
        ----------
        problems : gets a DesignError, as a problem at the parameter to blame
        provided : what the bench provides; the design function receives those that are its parameters

        Returns
        -------
        The design, or None where there is a problem.
        """
        design = registry.get(self.group, self.kind)
        taken = inspect.signature(design).parameters
        given = {name: value for name, value in provided.items() if name in taken}
        try:
            # An overflow is refused by the design function or shows as a failed run.
            with np.errstate(all="ignore"):
                return registry.checked(self.group, self.kind, design(**given, **self.parameters), provided)
        except DesignError as error:
            problems.append(self.problem(str(error), error.parameter))
        except (np.linalg.LinAlgError, ArithmeticError, MemoryError) as error:
            problems.append(self.problem(f"cannot be computed from these numbers ({error})"))
        return None

    def check(self, issues: Callable[[], Iterable[Issue]]) -> list[Problem]:
        """Call what finds issues of the built component and return them as problems at the keys to blame."""
        try:
            with np.errstate(all="ignore"):
                return [self.problem(issue.message, issue.key) for issue in issues()]
        except (np.linalg.LinAlgError, ArithmeticError, MemoryError) as error:
            return [self.problem(f"cannot be computed from these numbers ({error})")]

    def takes(self, name: str) -> bool:
        """Whether the design function has a parameter of this name."""
        return name in inspect.signature(registry.get(self.group, self.kind)).parameters

    def problem(self, message: str, parameter: str = "") -> Problem:
        """Return a problem of this component, at the parameter to blame."""
        steps = parameter.split(".") if parameter else []
        return Problem(*locate(self.tree, steps), join([*self.path, *steps]), message)

    def resolved(self) -> dict[str, Any]:
        """Return the component as plain data with every default filled in."""
        return {"kind": self.kind, **{name.rstrip("_"): plain_data(value) for name, value in self.parameters.items()}}


def plain_data(value: Any) -> Any:
    """Return dataclasses, tuples and expressions as plain YAML data; keys that are not set are left out."""
    if isinstance(value, Expression):
        return "".join(value.text.split())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {name.rstrip("_"): plain_data(item) for name, item in fields.items() if item is not None}
    if isinstance(value, Mapping):
        return {name: plain_data(item) for name, item in value.items() if item is not None}
    return [plain_data(item) for item in value] if isinstance(value, list | tuple) else value


def read_component(
    group: str,
    tree: Any,
    path: Sequence[str | int],
    problems: list[Problem],
    *,
    mark: tuple[str, int, int],
    kind: str | None = None,
    ignore: Sequence[str] = (),
) -> Component | None:
    """Validate a component against the signature of its design function.

    Parameters
    ----------
    group : group of the registry
    tree : keys of the component, as the configuration gives them
    path : where it stands
    problems : gets the errors
    mark : place to show when the tree has none of its own
    kind : kind of the component where there is no key `kind`
    ignore : keys validated elsewhere

    Returns
    -------
    The component, or None where there is an error.
    """
    if not isinstance(tree, Map):
        problems.append(Problem(*mark, join(path), f"must be a mapping (got {shown(tree)})"))
        return None
    kind = kind or _kind(group, tree, path, problems)
    if kind is None:
        return None
    own = tree.copy()
    for key in ("kind", *ignore):
        own.pop(key, None)
    checked = validate(model_of(group, kind), own, path, problems)
    if checked is None:
        return None
    parameters = {name: getattr(checked, name) for name in type(checked).model_fields}
    return Component(group, kind, parameters, tree, tuple(path))


def build_component(group: str, data: Mapping[str, Any] | None, **provided: Any) -> Any:
    """Build a component from plain data; None where there are none or they are invalid.

    Parameters
    ----------
    group : group of the registry
    data : ``kind`` and keys
    provided : what the bench provides
    """
    if data is None:
        return None
    mark = Mark("", 1, 1)
    component = read_component(group, Map(data, mark=mark), [], [], mark=mark)
    return None if component is None else component.build([], **provided)


def _kind(group: str, tree: Map, path: Sequence[str | int], problems: list[Problem]) -> str | None:
    noun = registry.singular(group)
    if "kind" not in tree:
        known = ", ".join(registry.names(group))
        problems.append(Problem(*tree.mark, join(path), f"'kind' is missing; known kinds of {noun}: {known}"))
        return None
    kind = tree["kind"]
    if not isinstance(kind, str) or kind not in registry.names(group):
        message = registry.unknown(str(kind), registry.names(group), noun, f"rmpc-bench list {group}")
        problems.append(Problem(*locate(tree, ["kind"]), join([*path, "kind"]), message))
        return None
    return kind
