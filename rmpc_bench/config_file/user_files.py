"""Values of a configuration that name files: functions in Python files of the user, and data files.

A key has such a value by its annotation, `UserFunction` or `DataFiles`.  Its text is relative to the file it stands in.
Therefore the texts of these keys are given their place before they are validated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_type_hints

from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.components.reference import CodeError, CodeReference, DataReference, is_reference
from rmpc_bench.config_file.tree import Items, Map, locate
from rmpc_bench.types import FromCode, FromData


class PlacedText(str):
    """A text with the place it stands in and what may be loaded from there."""

    access: CodeAccess
    written_in: str

    @classmethod
    def of(cls, text: str, access: CodeAccess, written_in: str) -> PlacedText:
        """Return a text with its place."""
        made = cls(text)
        made.access, made.written_in = access, written_in
        return made


def read_function(value: Any) -> Any:
    """Read the value of a key annotated as `UserFunction`: the reference, after loading it once."""
    if not isinstance(value, str):
        # A program may pass the function itself.
        if callable(value) or isinstance(value, CodeReference):
            return value
        raise CodeError("must name a function of a Python file, PATH.py:NAME")
    if not isinstance(value, PlacedText):
        raise CodeError(f"{value}: there is no configuration file whose directory it is relative to")
    reference = value.access.reference(str(value), value.written_in)
    value.access.load(reference)
    return reference


def read_function_or_text(value: Any) -> Any:
    """Read the value of a key annotated as `UserFunctionOrText`: a text without the form of a reference stays one."""
    return str(value) if isinstance(value, str) and not is_reference(str(value)) else read_function(value)


def read_data(value: Any) -> Any:
    """Read the value of a key annotated as `DataFiles`."""
    if isinstance(value, DataReference):
        return value
    paths = [value] if isinstance(value, Path) else value
    if isinstance(paths, list | tuple) and paths and all(isinstance(each, Path) for each in paths):
        # A program may give the files themselves.
        return DataReference(", ".join(map(str, paths)), tuple(each.resolve() for each in paths))
    if not isinstance(value, str):
        raise CodeError("must be the name of a file, or a pattern such as 'runs/*.csv'")
    if not isinstance(value, PlacedText):
        raise CodeError(f"{value}: there is no configuration file whose directory it is relative to")
    return value.access.data(str(value), value.written_in)


def placed(tree: Map, keys: Collection[str], access: CodeAccess) -> Map:
    """Return a component in which the texts that name files have their place."""
    return tree.like(
        {key: _placed(each, tree.places(key)[1].file, access) if key in keys else each for key, each in tree.items()}
    )


def _placed(value: Any, written_in: str, access: CodeAccess) -> Any:
    if isinstance(value, str):
        return PlacedText.of(value, access, written_in)
    if isinstance(value, Map):
        return value.like({key: _placed(each, value.places(key)[1].file, access) for key, each in value.items()})
    if isinstance(value, Items):
        return value.like(_placed(each, locate(value, [number]).file, access) for number, each in enumerate(value))
    return value


def names_files(annotation: Any) -> bool:
    """Whether values of an annotation, or values inside them, name files."""
    if isinstance(annotation, FromCode | FromData):
        return True
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        return _field_names_files(annotation)
    return any(map(names_files, get_args(annotation)))


@cache
def _field_names_files(kind: type) -> bool:
    return any(map(names_files, get_type_hints(kind, include_extras=True).values()))


SECTIONS_WITH_CODE = (
    *("plant", "model", "noise", "initial", "reference", "estimator", "controller", "methods"),
    *("sweep", "metrics", "figures"),
)  # top-level keys in which components stand

_TEXTS = ("label", "title", "name")  # keys whose values are texts for people


def named_in(tree: Map, access: CodeAccess) -> list[CodeReference]:
    """Return everything in Python files that the components of a configuration name, in order."""
    found: dict[CodeReference, None] = {}
    for text, written_in in _texts({key: tree[key] for key in SECTIONS_WITH_CODE if key in tree}, tree.mark.file):
        reference = access.reference(text, written_in)
        try:
            access.check(reference)
        except CodeError:
            # Reported later, at its place.
            continue
        found[reference] = None
    return list(found)


def _texts(node: Any, written_in: str) -> Iterator[tuple[str, str]]:
    """Yield every text that has the form of a reference, with the file it stands in."""
    steps: Sequence[Any] = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    for step in steps:
        file = locate(node, [step]).file if isinstance(node, Map | Items) else written_in
        if step not in _TEXTS and is_reference(node[step]):
            yield node[step], file
        yield from _texts(node[step], file)
