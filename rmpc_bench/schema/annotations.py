"""Schemas of annotations, and the meaning of every documented key: what json_schema.py is made from."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Len, Lt
from pydantic.fields import FieldInfo

from rmpc_bench.config_file.keys import own_first
from rmpc_bench.types import FromCode, FromCodeOrText, FromData, OverTime


def key_meanings(design: Any) -> dict[str, str]:
    """Return the meaning of every documented parameter; a class has those of its base classes too."""
    documented = reversed(design.__mro__) if inspect.isclass(design) else (design,)
    return {key: text for each in documented for key, text in meanings_in(inspect.getdoc(each) or "").items()}


def meanings_in(doc: str) -> dict[str, str]:
    r"""Return the meaning of every parameter in a numpydoc section.

    >>> meanings_in("Parameters\n----------\nc : radius of the ball\nHp, Hu : horizons\n    [samples]")
    {'c': 'radius of the ball', 'Hp': 'horizons [samples]', 'Hu': 'horizons [samples]'}
    """
    meanings: dict[str, str] = {}
    names: list[str] = []
    for line in doc.split("\n"):
        head, colon, text = line.partition(" : ")
        if colon and not line.startswith(" "):
            names = head.split(", ")
            meanings |= dict.fromkeys(names, text)
        elif names and line.startswith("    "):
            meanings |= {name: f"{meanings[name]} {line.strip()}" for name in names}
        elif not line.strip():
            names = []
    return meanings


Schema = dict[str, Any]

CODE: Schema = {
    "title": "PATH.py:NAME",
    "type": "string",
    "pattern": r"^.+\.py:[A-Za-z_]\w*$",
    "description": "A name in a Python file, PATH.py:NAME; the path is relative to this file.",
}
DATA_FILES: Schema = {
    "title": "data files",
    "type": ["string", "array"],
    "description": "Data files: a path or a pattern, relative to this file.",
}
MATRIX: Schema = {
    "title": "matrix",
    "type": ["number", "string", "array", "object", "null"],
    "description": "A number (times the identity), a list (the diagonal), rows of numbers, or {file: .., name: ..}.",
}


def schema_of(annotation: Any) -> Schema:
    """Return the schema of the values that an annotation allows.

    >>> schema_of(Annotated[float, Gt(0)])
    {'type': ['number', 'string'], 'exclusiveMinimum': 0}
    >>> schema_of(Literal["filter", "predictor"] | None)
    {'anyOf': [{'enum': ['filter', 'predictor']}, {'type': 'null'}]}
    """
    if annotation in _SIMPLE:
        return dict(_SIMPLE[annotation])
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _annotated(*arguments)
    if origin in (Union, UnionType):
        return {"anyOf": [schema_of(member) for member in arguments]}
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin in _CONTAINERS:
        return _CONTAINERS[origin](arguments)
    if inspect.isclass(annotation) and dataclasses.is_dataclass(annotation):
        return record_schema(annotation)
    return {}


def _annotated(inner: Any, *constraints: Any) -> Schema:
    schema = schema_of(inner)
    for constraint in constraints:
        if type(constraint) in _MARKED:
            return dict(_MARKED[type(constraint)])
        schema |= _limits(constraint)
    return schema


def _limits(constraint: Any) -> Schema:
    """Keywords of one constraint; a constraint that JSON Schema cannot express gives none."""
    if isinstance(constraint, Len):
        longest = {} if constraint.max_length is None else {"maxItems": constraint.max_length}
        return {"minItems": constraint.min_length, "minLength": constraint.min_length, **longest}
    if isinstance(constraint, FieldInfo):
        patterns = [each.pattern for each in constraint.metadata if getattr(each, "pattern", None)]
        return {"pattern": patterns[0]} if patterns else {}
    words = (
        (Gt, "exclusiveMinimum", "gt"),
        (Ge, "minimum", "ge"),
        (Lt, "exclusiveMaximum", "lt"),
        (Le, "maximum", "le"),
    )
    return {word: getattr(constraint, name) for kind, word, name in words if isinstance(constraint, kind)}


def record_schema(kind: type) -> Schema:
    """Return the schema of a mapping with the fields of a dataclass as keys."""
    found = get_type_hints(kind, include_extras=True)
    found = {name: found[name] for name in own_first(kind, found)}
    defaults: dict[str, Any] = {}
    for field in dataclasses.fields(kind):
        if field.default is not dataclasses.MISSING:
            defaults[field.name] = field.default
        elif field.default_factory is not dataclasses.MISSING:
            defaults[field.name] = field.default_factory()
    return mapping_schema(found, [*defaults], defaults, key_meanings(kind))


def mapping_schema(
    annotations: Mapping[str, Any], optional: Sequence[str], defaults: Mapping[str, Any], meanings: Mapping[str, str]
) -> Schema:
    """Return the schema of a mapping with fixed keys; a trailing ``_`` of a name is not a part of the key.

    `optional` has the names that need not be given, `defaults` those defaults that are plain data.
    """
    properties: dict[str, Schema] = {}
    for name, annotation in annotations.items():
        schema = schema_of(annotation)
        if meanings.get(name):
            schema["description"] = meanings[name]
        if name in defaults and isinstance(defaults[name], str | int | float | list | NoneType):
            schema["default"] = defaults[name]
        properties[name.rstrip("_")] = schema
    required = [name.rstrip("_") for name in annotations if name not in optional]
    made: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    return made | ({"required": required} if required else {})


def _list(arguments: tuple[Any, ...]) -> Schema:
    return {"type": "array", "items": schema_of(arguments[0])}


def _tuple(arguments: tuple[Any, ...]) -> Schema:
    if arguments[-1] is ...:
        return _list(arguments)
    n = len(arguments)
    return {"type": "array", "items": [schema_of(each) for each in arguments], "minItems": n, "maxItems": n}


_SIMPLE: Mapping[Any, Schema] = {
    float: {"type": ["number", "string"]},
    int: {"type": ["integer", "string"]},
    str: {"type": "string"},
    bool: {"type": "boolean"},
    NoneType: {"type": "null"},
    None: {"type": "null"},
}
_CONTAINERS: Mapping[Any, Callable[[tuple[Any, ...]], Schema]] = {
    list: _list,
    tuple: _tuple,
    dict: lambda arguments: {"type": "object", "additionalProperties": schema_of(arguments[1])},
}
_MARKED: Mapping[type, Schema] = {
    FromCodeOrText: {"type": "string"},
    FromCode: CODE,
    FromData: DATA_FILES,
    OverTime: MATRIX,
}


NUMBER: Schema = {"type": ["number", "string"]}
EXPRESSIONS: Schema = {
    "title": "mapping from names to numbers or expressions",
    "type": "object",
    "additionalProperties": NUMBER,
}
VECTOR: Schema = {"title": "number or list of numbers", "type": ["number", "string", "array"]}
PLAIN_MATRIX: Schema = {"title": "matrix", "type": ["number", "string", "array"]}
