"""Messages about keys and values that do not fit, from the errors of pydantic."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from difflib import get_close_matches
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag

from rmpc_bench import registry
from rmpc_bench.components.code import CodeError
from rmpc_bench.components.words import MEANINGS
from rmpc_bench.config_file.tree import Items, Map, Mark, join, locate, locate_key
from rmpc_bench.types import Problem, row_by_row

BUILT_IN_KEYS = "rmpc_bench.built_in_keys"
"""Module that the keys of a built-in component say they come from; a user cannot change their names."""


def key_problem(
    entry: Any, tree: Any, path: Sequence[str | int], kind: Any, mark: Mark | None, further: Sequence[str] = ()
) -> Problem:
    """Return an entry of `ValidationError.errors` as a problem at the value or key to blame.

    `kind` is a pydantic model or an annotation.  A scalar has no place of its own and takes `mark`.  Further keys are
    validated elsewhere.
    """
    steps, node = [], tree
    error = entry.get("ctx", {}).get("error")
    if isinstance(error, CodeError) and error.place is not None:
        return Problem(*error.place, "", str(error))
    # The paths of pydantic contain the members of unions, too.
    for step in entry["loc"]:
        if isinstance(node, dict) and step in node or isinstance(node, list) and step in range(len(node)):
            steps.append(step)
            node = node[step]
    if entry["type"] == "extra_forbidden":
        mark = locate_key(tree, steps)
    elif entry["type"] == "missing" and isinstance(tree, Map | Items):
        mark = locate(tree, steps)
        what = f"{entry['loc'][-1]!r} is missing" if isinstance(entry["loc"][-1], str) else "has too few entries"
        return Problem(*mark, join([*path, *steps]), f"{what}{_meant(entry['loc'][-1], kind)}")
    elif isinstance(tree, Map | Items):
        mark = locate(tree, steps)
    return Problem(*(mark or Mark("", 1, 1)), join([*path, *steps]), _message(entry, kind, steps, further))


def _meant(name: str | int, kind: Any) -> str:
    """Say which value that the bench gives by name has nearly this name: an argument may be misspelt in the code."""
    if isinstance(name, int) or name in MEANINGS or getattr(kind, "__module__", "") == BUILT_IN_KEYS:
        return ""
    close = get_close_matches(name, MEANINGS, 1, 0.75)
    return f"; if it is an argument in your code, did you mean {close[0]!r}, which the bench gives?" if close else ""


_WORDS: dict[str, str] = {
    "greater_than": "must be > {gt}",
    "greater_than_equal": "must be >= {ge}",
    "less_than": "must be < {lt}",
    "less_than_equal": "must be <= {le}",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "string_type": "must be text",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "must have 1 to 100 letters, digits, '_', '-' or '.', the first a letter or digit",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "dict_type": "must be a mapping",
    "model_type": "must be a mapping",
    "model_attributes_type": "must be a mapping",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "too_long": "has too many entries",
    "too_short": "has too few entries",
    "shape": "{message}",
    "literal_error": "must be {expected}",
    "value_error": "{error}",
}


def _message(entry: Any, kind: Any, steps: Sequence[str | int], further: Sequence[str]) -> str:
    context = {**entry.get("ctx", {}), "message": entry["msg"]}
    if entry["type"] == "extra_forbidden":
        known = [*_keys_at(kind, entry["loc"][:-1]), *(further if len(steps) == 1 else ())]
        return registry.unknown(str(steps[-1]), known, "key")
    text = _WORDS.get(entry["type"], entry["msg"]).format(**context)
    if entry["type"] == "shape" and _is_flat(entry["input"]) and text.endswith("a matrix"):
        return f"{text} (got {shown(entry['input'])}); {row_by_row(entry['input'])}"
    if entry["type"] == "value_error" and _is_flat(entry["input"]) and steps:
        if isinstance(steps[-1], int):
            return f"must be one number, not a list (got {entry['input']})"
        return f"must be one value (got {entry['input']}); several values are compared by `sweep`"
    return text if entry["type"] == "value_error" else f"{text} (got {shown(entry['input'])})"


def _is_flat(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and not any(isinstance(entry, list | dict) for entry in value)


def shown(value: Any) -> str:
    """Return the text of a value in a message."""
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    return "nothing" if value is None else repr(value)


def _keys_at(kind: Any, steps: Sequence[str | int]) -> list[str]:
    """Return the keys of a model at a path of pydantic, which contains the tags of unions."""
    if get_origin(kind) is Annotated:
        return _keys_at(get_args(kind)[0], steps)
    if get_origin(kind) in (Union, UnionType):
        tagged = {mark.tag: member for member in get_args(kind) for mark in get_args(member) if isinstance(mark, Tag)}
        return _keys_at(tagged[str(steps[0])], steps[1:])
    if get_origin(kind) in (list, tuple) and steps:
        entries = get_args(kind)
        each = len(entries) == 1 or entries[1] is ...
        return _keys_at(entries[0] if each else entries[int(steps[0])], steps[1:])
    if get_origin(kind) is dict and steps:
        return _keys_at(get_args(kind)[1], steps[1:])
    if not (inspect.isclass(kind) and issubclass(kind, BaseModel)):
        return []
    fields = {field.alias or name: field.annotation for name, field in kind.model_fields.items()}
    return _keys_at(fields.get(str(steps[0])), steps[1:]) if steps else list(fields)
