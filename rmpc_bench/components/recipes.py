"""How a design was made, so that a worker process makes it again instead of receiving it."""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from rmpc_bench.components.code import CodeReference, DataReference
from rmpc_bench.components.designs import loaded_design
from rmpc_bench.components.loading import load
from rmpc_bench.components.untouched import untouched


@dataclass(frozen=True, eq=False)
class Recipe:
    """The call that makes a design."""

    group: str
    design: Callable[..., Any] | None
    """The design function; not used for a component from a file."""
    code: CodeReference | None
    """Where a component from a file stands; None for others."""
    provided: Mapping[str, Any]
    """What the bench gives to the design function."""
    parameters: Mapping[str, Any]
    """Its other keywords, with references in place of what stands in files of the user."""

    def make(self) -> Any:
        """Call the design function."""
        design = self.design if self.code is None else loaded_design(self.group, self.code)
        assert design is not None
        files = [*self._files()]
        if not files and str(getattr(design, "__module__", "")).startswith("rmpc_bench."):
            return design(**self.provided, **loaded(self.parameters))
        with untouched(files[0] if files else ""):
            return design(**self.provided, **loaded(self.parameters))

    def _files(self) -> Iterator[str]:
        """Yield the Python files whose code the call may run."""
        yield from (str(each.path) for each in inside([self.code, self.parameters]) if isinstance(each, CodeReference))
        for recipe in map(recipe_of, self.provided.values()):
            if recipe is not None:
                yield from recipe._files()

    def without_design(self) -> Recipe:
        """Return the recipe of a component from a file without the loaded function."""
        return dataclasses.replace(self, design=None)

    def remember(self, made: Any) -> None:
        """Note that a design was made in this way."""
        number = id(made)
        try:
            # The identity of an object may be used again after its end.
            kept: Any = weakref.ref(made, lambda _: _recipes.pop(number, None))
        except TypeError:
            kept = made
        _recipes[number] = kept, self


_recipes: dict[int, tuple[Any, Recipe]] = {}
"""Identity of a design -> a reference to it, and how it was made."""


def recipe_of(made: Any) -> Recipe | None:
    """Return how an object was made; None for anything but a remembered design."""
    entry = _recipes.get(id(made))
    return None if entry is None else entry[1]


def loaded(value: Any) -> Any:
    """Return a validated value with objects in place of references, and paths in place of data files."""
    if isinstance(value, CodeReference):
        return load(value)
    if isinstance(value, DataReference):
        return value.paths
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return type(value)(loaded(each) for each in value)
    if isinstance(value, Mapping):
        return {key: loaded(each) for key, each in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and any(inside(value)):
        return dataclasses.replace(
            value, **{field.name: loaded(getattr(value, field.name)) for field in dataclasses.fields(value)}
        )
    return value


def inside(value: Any) -> Iterator[CodeReference | DataReference]:
    """Yield the references to files inside a validated value."""
    if isinstance(value, CodeReference | DataReference):
        yield value
    elif isinstance(value, list | tuple):
        for each in value:
            yield from inside(each)
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from inside(each)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from inside(getattr(value, field.name))
