"""Type, limits and unit of a key in words, from its JSON Schema and its meaning; for `describe` and the reference."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from rmpc_bench.schema.annotation_schema import Schema

ANY = "any value"
_TYPES: Mapping[str, str] = {
    "integer": "whole number",
    "number": "number",
    "string": "text",
    "boolean": "true or false",
    "array": "list",
    "object": "mapping",
}
_MATRIX = ("number", "list of numbers", "list of lists of numbers")
"""A number (times the identity), a list (the diagonal) or rows."""
_LIMITS = (("exclusiveMinimum", ">"), ("minimum", ">="), ("exclusiveMaximum", "<"), ("maximum", "<="))
_UNIT = re.compile(r"\[([^\[\]]+)\]")
_SYMBOLS = r"(?:m|mm|cm|ml|s|ms|kg|N|Nm|V|A|H|J|Ohm|rad|deg|in|pt|samples|runs|bytes|dB|1|u|y)"
_IS_UNIT = re.compile(rf"{_SYMBOLS}(?:\^-?\d+)?(?:[ /]{_SYMBOLS}(?:\^-?\d+)?)*")


def type_words(schema: Schema) -> str:
    """Return the values that a schema allows, with their limits.

    Examples
    --------
    >>> type_words({"type": ["number", "string"], "exclusiveMinimum": 0})
    'number > 0'
    >>> type_words({"anyOf": [{"enum": ["none", "all"]}, {"type": "null"}]})
    '`none` or `all`'
    """
    if "title" in schema:
        return str(schema["title"])
    if "$ref" in schema or "allOf" in schema:
        return "component"
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return _joined([f"`{value}`" for value in schema["enum"] if value is not None])
    if "anyOf" in schema:
        words = list(dict.fromkeys(type_words(each) for each in schema["anyOf"] if each.get("type") != "null"))
        return _joined(
            ["matrix", *(each for each in words if each not in _MATRIX)] if {*_MATRIX} <= {*words} else words
        )
    return _of_type(schema)


def _of_type(schema: Schema) -> str:
    given = schema.get("type", [])
    names = [given] if isinstance(given, str) else list(given)
    if {"number", "integer"} & {*names} and "string" in names:
        # A number may be written as a quantity, which is a text.
        names.remove("string")
    if names == ["array"]:
        return _list_words(schema)
    if names == ["object"] and schema.get("additionalProperties"):
        return f"mapping from names to {_many(type_words(schema['additionalProperties']))}"
    words = _joined([_TYPES[name] for name in names if name != "null"]) or ANY
    limits = [f"{sign} {_shown(schema[key])}" for key, sign in _LIMITS if key in schema]
    return " ".join([words, " and ".join(limits)]).strip()


def _list_words(schema: Schema) -> str:
    items = schema.get("items")
    if isinstance(items, list):
        return f"list of {len(items)}: {', '.join(type_words(each) for each in items)}"
    return f"list of {_many(type_words(items))}" if items else "list"


def _many(words: str) -> str:
    """Plural of a type, where it is regular."""
    for one, many in (("number", "numbers"), ("text", "texts"), ("list of", "lists of"), ("mapping", "mappings")):
        if words.startswith(one):
            return words.replace(one, many, 1)
        if words.startswith(f"whole {one}"):
            return words.replace(f"whole {one}", f"whole {many}", 1)
    return words


def _joined(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}" if len(words) > 1 else "".join(words)


def _shown(limit: Any) -> str:
    return f"{limit:g}" if isinstance(limit, float) else f"{limit:,}" if limit < 2**53 else str(limit)


def unit_of(meaning: str) -> str:
    """Return the unit that stands in brackets in a meaning; empty without one.

    Examples
    --------
    >>> unit_of("sampling time [s]"), unit_of("viscous friction [N m s/rad]"), unit_of("limits [low, high]")
    ('s', 'N m s/rad', '')
    """
    return next((found for found in _UNIT.findall(meaning) if _IS_UNIT.fullmatch(found)), "")
