"""The manual of a component: its texts, and type, limits, unit, default and meaning of its keys.

`rmpc-bench describe` shows it on the screen, and docs/components is made from it.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import is_dataclass
from typing import Any, NamedTuple, get_args

from rmpc_bench.config_file.component import SHARED_KEYS, plain_data
from rmpc_bench.config_file.keys import hints, keys_of
from rmpc_bench.schema.annotations import Schema, key_meanings, mapping_schema, record_schema
from rmpc_bench.schema.json_schema import CONTROLLER_KEYS, INPUT_KEYS, MODEL_KEYS, PLANT_KEYS
from rmpc_bench.types.sweep_points import value_text

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
_SYMBOLS = r"(?:m|mm|cm|ml|s|ms|kg|N|Nm|V|A|W|H|J|Ohm|Pa|Hz|K|rad|deg|in|pt|samples|runs|bytes|dB|1|u|y)"
_IS_UNIT = re.compile(rf"{_SYMBOLS}(?:\^-?\d+)?(?:[ /]{_SYMBOLS}(?:\^-?\d+)?)*")


def type_words(schema: Schema) -> str:
    """Return the values that a schema allows, with their limits.

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
        words = [type_words(each) for each in items]
        if len(words) == 2 and len({*words}) == 1 and " or " not in words[0]:
            return f"pair of {_many(words[0])}"
        return f"list of {len(items)}: {', '.join(words)}"
    return f"list of {_many(type_words(items))}" if items else "list"


def _many(words: str) -> str:
    """Plural of a type, where it is regular."""
    for one, many in (
        ("number", "numbers"),
        ("text", "texts"),
        ("list of", "lists of"),
        ("pair of", "pairs of"),
        ("mapping", "mappings"),
    ):
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

    >>> unit_of("sampling time [s]"), unit_of("viscous friction [N m s/rad]"), unit_of("limits [low, high]")
    ('s', 'N m s/rad', '')
    >>> unit_of("pressure [Pa]"), unit_of("bandwidth [Hz]"), unit_of("losses [W/K]"), unit_of("gain [L]")
    ('Pa', 'Hz', 'W/K', '')
    """
    return next((found for found in _UNIT.findall(meaning) if _IS_UNIT.fullmatch(found)), "")


_SECTION = re.compile(r"^(\w+)\n-{3,}\n", re.MULTILINE)  # heading of a section of a numpydoc docstring


_NUMERIC = {"number", "numbers", "matrix"}


class KeyEntry(NamedTuple):
    """One key of a component or of a section of a configuration."""

    name: str
    kind: str  # type and limits, in words
    default: str | None  # as a configuration would write it; None for a required key
    unit: str
    meaning: str
    keys: tuple[KeyEntry, ...] = ()  # keys of the mapping that is its value


class Manual(NamedTuple):
    """Texts and keys of a component."""

    group: str
    kind: str
    module: str  # docstring of its module: model, source, limit, cost, and when it fails
    text: str  # docstring of the component, up to its sections
    keys: tuple[KeyEntry, ...]
    examples: str


def manual_of(group: str, kind: str, design: Any) -> Manual:
    """Return the manual of a component; the kind may be the file and name of a component of a user."""
    module = inspect.getmodule(inspect.unwrap(design))
    # A class without a docstring of its own inherits that of the base class, which says nothing about it.
    doc = inspect.getdoc(design) or "" if design.__doc__ else ""
    text, *sections = _SECTION.split(doc)
    titled = dict(zip(sections[::2], sections[1::2], strict=True))
    return Manual(
        group=group,
        kind=kind,
        module=inspect.getdoc(module) or "",
        text=text.rstrip(),
        keys=_keys(group, kind, design),
        examples=titled.get("Examples", "").strip(),
    )


def _keys(group: str, kind: str, design: Any) -> tuple[KeyEntry, ...]:
    fields = keys_of(group, kind, design).model_fields
    parameters = inspect.signature(design).parameters
    annotations = hints(design, {name: parameters[name].annotation for name in fields})
    optional = [name for name, field in fields.items() if not field.is_required()]
    properties = mapping_schema(annotations, optional, {}, key_meanings(design))["properties"]
    return tuple(
        entry(
            field.alias or name,
            properties[name.rstrip("_")],
            None if field.is_required() else default_text(field.default),
            keys_of_schema(properties[name.rstrip("_")]) or keys_of_records(annotations[name]),
        )
        for name, field in fields.items()
    )


def shared_keys(group: str) -> tuple[KeyEntry, ...]:
    """Return the keys that every component of a group has, beside its own."""
    models = {name: MODEL_KEYS[name] for name in SHARED_KEYS["models"]}
    shared = {"plants": PLANT_KEYS, "models": models, "controllers": CONTROLLER_KEYS, "inputs": INPUT_KEYS}
    return keys_of_schema({"properties": shared[group]}) if group in shared else ()


def entry(name: str, schema: Schema, default: str | None, keys: tuple[KeyEntry, ...] = ()) -> KeyEntry:
    """Return the entry of a key; its default is as a configuration would write it, None for a required key."""
    meaning, kind = schema.get("description", ""), type_words(schema)
    unit = unit_of(meaning) if _NUMERIC & {*kind.split()} else ""
    return KeyEntry(name, kind, default, unit, meaning, keys)


def keys_of_schema(schema: Schema) -> tuple[KeyEntry, ...]:
    """Return the keys of the mapping, or of the mappings in a list, that a schema describes."""
    inner = [schema, *schema.get("anyOf", ()), schema.get("items", {})]
    entries = [
        entry(
            name,
            each,
            None if name in mapping.get("required", ()) else default_text(each.get("default")),
            keys_of_schema(each),
        )
        for mapping in inner
        if isinstance(mapping, dict)
        for name, each in mapping.get("properties", {}).items()
    ]
    # Kinds of one mapping, such as those of `tuning`, may share a key.
    return tuple(dict.fromkeys(entries))


def keys_of_records(annotation: Any) -> tuple[KeyEntry, ...]:
    """Return the keys of the dataclasses inside an annotation."""
    records = [each for each in _inside(annotation) if inspect.isclass(each) and is_dataclass(each)]
    return tuple(key for each in records for key in keys_of_schema(record_schema(each)))


def _inside(annotation: Any) -> Iterable[Any]:
    """An annotation and all those inside it."""
    return [annotation, *(each for inner in get_args(annotation) for each in _inside(inner))]


def default_text(value: Any) -> str:
    """Show a default as a configuration would write it; empty where a missing key has no value.

    >>> default_text(None), default_text((1.0, 3.0)), default_text("quartiles"), default_text(True)
    ('', '[1, 3]', 'quartiles', 'true')
    """
    return "" if value is None else value_text(plain_data(value))
