"""JSON Schema of a configuration, for editors with a YAML language server.

It is made from what validates a configuration: the sections, and the signatures and docstrings of all components that
are known here, installed ones included.  Relations between keys are not in it; `rmpc-bench check` knows them.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from functools import cache
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.designs import registered_design
from rmpc_bench.config.method_section import Source
from rmpc_bench.config.sections import SECTIONS, ClaimKeys
from rmpc_bench.config.tune_section import Range
from rmpc_bench.config_file.schema import hints, keys_of, model_of
from rmpc_bench.config_file.short_forms import SHORT_FORMS
from rmpc_bench.extras import EXTRAS
from rmpc_bench.schema import section_schemas
from rmpc_bench.schema.annotation_schema import CODE, Schema, mapping_schema, schema_of
from rmpc_bench.schema.key_meanings import key_meanings
from rmpc_bench.schema.section_schemas import MODEL_KEYS, PLANT_KEYS, PLANT_OF

_DRAFT = "http://json-schema.org/draft-07/schema#"  # the version that YAML language servers read
_EXTRA = {"plants": {**PLANT_KEYS, "from": PLANT_OF}, "models": MODEL_KEYS}


def json_schema() -> Schema:
    """Return the schema of a configuration, as plain data.

    Examples
    --------
    >>> json_schema()["properties"]["seed"]["default"]
    0
    """
    properties: dict[str, Schema] = {}
    for name, (annotation, default, meaning) in SECTIONS.items():
        schema = _SPECIAL[name]() if name in _SPECIAL else schema_of(annotation)
        properties[name] = {**schema, "description": meaning}
        if isinstance(default, str | int):
            properties[name]["default"] = default
    return {
        "$schema": _DRAFT,
        "title": "Configuration of rmpc-bench",
        "type": "object",
        "properties": properties,
        # A file that extends another one may leave out whatever it inherits.
        "if": {"required": ["extends"]},
        "then": {"required": ["name"]},
        "else": {
            # The model may come with the plant of another file.
            "required": [name for name, section in SECTIONS.items() if section.default is ... and name != "model"],
            "properties": {name: _one_of(f"{name}s", partial=False) for name in ("plant", "reference", "input")},
        },
        "additionalProperties": False,
        "definitions": {**_definitions(), "law": section_schemas.law(_usable("noises"))},
    }


@cache
def _definitions() -> dict[str, Schema]:
    """Schemas of all components; a broken one of an installed package is left out."""
    found = {}
    for group in registry.BUILT_IN:
        for kind in registry.names(group):
            try:
                found[f"{group}.{kind}"] = _component(group, kind)
            except Exception:  # noqa: BLE001 - whatever the import of another package raises
                continue
    return found


def _component(group: str, kind: str) -> Schema:
    """Schema of the keys of one component; which of them are required is said where it is used."""
    design = registered_design(group, kind)
    fields = keys_of(group, kind, design).model_fields
    parameters = inspect.signature(design).parameters
    annotations = hints(design, {name: parameters[name].annotation for name in fields})
    defaults = {name: field.default for name, field in fields.items() if not field.is_required()}
    schema = mapping_schema(annotations, [*fields], defaults, key_meanings(design))
    first = (inspect.getdoc(design) or "").partition("\n")[0]
    own = {} if group == "noises" else {"kind": {"const": kind, "description": first}}
    schema["properties"] = {**own, **schema["properties"], **_EXTRA.get(group, {})}
    return schema


def _one_of(group: str, *, partial: bool) -> Schema:
    """Schema of a component of a group; if partial, required keys may stand elsewhere, as in the default of methods."""
    choices: list[Schema] = [_choice(group, kind, partial=partial) for kind in _usable(group)]
    file: Schema = {"type": "object", "properties": {"file": CODE}, "required": ["file"]}
    source: list[Schema] = [{"type": "object", "required": ["from"]}] if group in _EXTRA else []
    return {"anyOf": [*choices, *source, file]}


def _choice(group: str, kind: str, *, partial: bool) -> Schema:
    reference = {"$ref": f"#/definitions/{group}.{kind}"}
    if partial:
        return reference
    fields = model_of(group, kind).model_fields
    required = [field.alias or name for name, field in fields.items() if field.is_required()]
    # A key that is a short form of the kind, such as `ode`, stands in its place.
    forms = [] if kind in SHORT_FORMS.get(group, ()) else ["kind"]
    return {"allOf": [reference], "required": [*forms, *required]}


def _usable(group: str) -> Iterable[str]:
    defined = _definitions()
    return [kind for kind in registry.names(group) if f"{group}.{kind}" in defined]


def _list_of(group: str) -> Schema:
    """Schema of a list whose entries are names or mappings."""
    names: Schema = {"enum": [*_usable(group)]}
    return {"type": "array", "items": {"anyOf": [names, _one_of(group, partial=False)]}}


def _methods() -> Schema:
    keys: dict[str, Schema] = {
        name: {**_one_of(f"{name}s", partial=True), "description": f"{name} of this method; merged with the default"}
        for name in ("model", "estimator", "controller")
    }
    keys["label"] = {"type": "string", "description": "text for tables and figures; {KEY} is the value of a key"}
    about = "path inside the method, such as estimator.radius -> its range [low, high], or a mapping with further keys"
    keys["tune"] = {"type": "object", "additionalProperties": schema_of(Range), "description": about}
    about = "where the parameters of a method come from that is not tuned here: `as published` for those of a paper, "
    about += "`default`, or {budget: 9, runs: 50} for values that another configuration has tuned"
    keys["parameters"] = {**schema_of(Source), "description": about}
    method: Schema = {"type": ["object", "null"], "properties": keys, "additionalProperties": False}
    return {"type": "object", "additionalProperties": method}


_SPECIAL: dict[str, Any] = {
    "plant": lambda: _one_of("plants", partial=True),
    "model": lambda: _one_of("models", partial=True),
    "reference": lambda: _one_of("references", partial=True),
    "input": lambda: _one_of("inputs", partial=True),
    "estimator": lambda: _one_of("estimators", partial=True),
    "controller": lambda: _one_of("controllers", partial=True),
    "methods": _methods,
    "metrics": lambda: _list_of("metrics"),
    "figures": lambda: _list_of("figures"),
    "uncertainty": section_schemas.uncertainty,
    "noise": section_schemas.noise,
    "initial": section_schemas.initial,
    "sweep": section_schemas.sweep,
    "claims": lambda: {"type": "array", "items": schema_of(ClaimKeys)},
    "requires": lambda: {"type": "array", "items": {"enum": [*EXTRAS]}},
}
