"""JSON Schema of a configuration, for editors with a YAML language server, and the meaning of every key.

It is made from what validates a configuration: the sections, and the signatures and docstrings of all components that
are known here, installed ones included.  Relations between keys are not in it; `rmpc-bench check` knows them.  A number
may be written as a quantity (``2*pi``, ``5%``), so that its type is number or text and bounds hold for plain numbers.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from functools import cache, partial
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.designs import registered_design
from rmpc_bench.config.claim_keys import ClaimKeys
from rmpc_bench.config.draft import SameLaw
from rmpc_bench.config.methods import Source
from rmpc_bench.config.noise import DISTRIBUTIONS, GROUPS, SCALE
from rmpc_bench.config.sections import SECTIONS
from rmpc_bench.config.tune import Range
from rmpc_bench.config_file.keys import hints, keys_of, model_of
from rmpc_bench.config_file.method_grid import AXES, EXCLUDE, GRID
from rmpc_bench.config_file.tree import SHORT_FORMS
from rmpc_bench.extras import EXTRAS
from rmpc_bench.models.delay import Delay
from rmpc_bench.models.disturbance import Disturbance
from rmpc_bench.schema.annotations import (
    CODE,
    EXPRESSIONS,
    NUMBER,
    PLAIN_MATRIX,
    VECTOR,
    Schema,
    key_meanings,
    mapping_schema,
    record_schema,
    schema_of,
)

PLANT_KEYS: dict[str, Schema] = {
    "perturb": {
        **EXPRESSIONS,
        "description": "parameter -> factor on its nominal value, such as 1 + eps, in the uncertain quantities",
    },
    "set": {**EXPRESSIONS, "description": "parameter -> its value, such as 2 + eps, in the uncertain quantities"},
    "bounds": {
        "type": "object",
        "description": "[low, high] of states, such as {x.0: [0, 1], x.1: [null, 5]}; a run that leaves them is "
        "`out-of-range`; one with names takes these and clips its inputs, {level: [0 m, 0.6 m], pump: [0, 30 ml/s]} "
        "(u acts, u_command is what the controller returns)",
    },
    "diverged": {
        "type": ["number", "string", "array", "object"],
        "description": "size of a state, for all or by name, beyond which a run is `diverged`; "
        "1e6 times the largest of 1, its initial value and the reference if not given",
    },
    "angles": {
        "type": ["array", "object"],
        "description": "states and outputs that are angles, [theta, angle] with period 2 pi, or periods {theta: 360}",
    },
}  # keys of every plant
PLANT_OF: Schema = {"type": "string", "description": "a configuration whose plant is taken; see `plant`"}
MODEL_KEYS: dict[str, Schema] = {
    "from": {"const": "plant", "description": "takes the parameters of the plant, which further keys may change"},
    "disturbance": {
        "anyOf": [{"enum": ["none"]}, record_schema(Disturbance)],
        "default": "none",
        "description": "unknown disturbances, which the estimator estimates as further states and the controller "
        "takes into account",
    },
    "delay": {
        "anyOf": [{"enum": ["same", "none"]}, record_schema(Delay)],
        "description": "delays that estimator and controller know: `same` as in the noise, `none`, or numbers of "
        "samples; `same` for models made from the plant (`from`, `linearise`, `nonlinear`), else `none`",
    },
}  # keys of every model
CONTROLLER_KEYS: dict[str, Schema] = {
    "every": {
        "type": "integer",
        "minimum": 1,
        "default": 1,
        "description": "samples between calls: the input is held, and horizons and increments count calls; for lqr, "
        "control-lqr, lqg, mpc, gpc and pid",
    },
    "preview": {
        "type": "boolean",
        "default": True,
        "description": "whether mpc and gpc know the reference ahead; otherwise they predict with r(k+j) = r(k)",
    },
}  # keys of every controller
INPUT_KEYS: dict[str, Schema] = {
    "only": {
        "type": "array",
        "items": {"type": ["string", "integer"]},
        "minItems": 1,
        "description": "names or positions of the inputs that follow the signal, beside a controller of the others",
    },
    "known": {
        "type": "boolean",
        "default": True,
        "description": "whether estimator and controller know these inputs now; only beside a controller",
    },
}  # keys of every input


def _uncertainty() -> Schema:
    """Return the schema of the laws of the uncertain quantities."""
    laws: list[Schema] = []
    for name, record in (*DISTRIBUTIONS.items(), *GROUPS.items()):
        law = record_schema(record)
        first = (record.__doc__ or "").partition("\n")[0].rstrip(".").replace("``", "`")
        # A matrix may lie in a file.
        of = [key for key in ("cov", "values") if key in law["properties"]] if record in GROUPS.values() else []
        law["properties"] |= {key: {**law["properties"][key], "type": ["array", "object"]} for key in of}
        law["properties"] = {"dist": {"const": name, "description": first}, **law["properties"]}
        laws.append({**law, "required": ["dist", *law.get("required", ())]})
    spread: Schema = {"type": "string", "description": "a range about 0, such as +-10%: uniform"}
    about = "factor on the spread of all quantities about their centres, 1 unless given; no quantity may have this name"
    scale: Schema = {"minimum": 0, **NUMBER, "description": about}
    return {"type": "object", "properties": {SCALE: scale}, "additionalProperties": {"anyOf": [spread, *laws]}}


def _law(kinds: Iterable[str]) -> Schema:
    """Return the schema of a noise law of one of the loadable kinds, which may be a sum of laws."""
    any_law: Schema = {"$ref": "#/definitions/law"}
    keys: dict[str, Schema] = {kind: {"$ref": f"#/definitions/noises.{kind}"} for kind in kinds}
    keys |= {"delayed": {"anyOf": [{**NUMBER, "description": "samples"}, keys["delayed"]]}} if "delayed" in keys else {}
    keys["same"] = record_schema(SameLaw)
    keys["sum"] = {"type": "array", "items": any_law, "minItems": 1}
    keys["file"] = CODE
    one: Schema = {"type": "object", "properties": keys, "minProperties": 1}
    return {"title": "noise law", "anyOf": [{"enum": ["none", "same"]}, one]}


def _noise() -> Schema:
    """Return the schema of the noises of the true system."""
    law: Schema = {"$ref": "#/definitions/law", "title": "noise law"}
    channels: dict[str, Schema] = {
        "process": {**law, "description": "law of w(k)"},
        "measurement": {**law, "description": "law of v(k)"},
        "input": {**law, "description": "laws between the input that a controller returns and u(k), in their order"},
        "cross": {
            "title": "`same`, number or matrix",
            "description": "covariance of w(k) and v(k), both Gaussian; 0 if not given",
        },
    }
    mapping: Schema = {"type": "object", "properties": channels, "additionalProperties": False}
    return {"anyOf": [{"enum": ["none", "same"]}, mapping]}


def _initial() -> Schema:
    """Return the schema of the initial state and of the initial estimate."""
    x: Schema = {"title": "number, list of numbers or noise law", "anyOf": [VECTOR, {"$ref": "#/definitions/law"}]}
    process: Schema = {**PLAIN_MATRIX, "title": "`process` or matrix", "default": "process"}
    keys: dict[str, Schema] = {
        "x": {**x, "default": 0, "description": "true initial state, or its law"},
        "x_hat": {**VECTOR, "default": 0, "description": "initial estimate of all estimators"},
        "P": {**process, "description": "its covariance; `process` is the covariance of the design process noise"},
        "M": {**PLAIN_MATRIX, "default": 0, "description": "shape matrix of its ellipsoid, for estimators with sets"},
    }
    return {"type": "object", "properties": keys, "additionalProperties": False}


def _sweep() -> Schema:
    """Return the schema of a sweep: values of some paths."""
    rows: Schema = {"type": "array", "items": {"type": "object"}}
    lists: Schema = {"type": "object", "additionalProperties": {"type": ["array", "object"]}}
    keys: dict[str, Schema] = {
        "grid": {
            **lists,
            "title": "mapping from paths to lists",
            "description": "every combination of the values; a mapping gives the values names",
        },
        "zip": {
            "title": "mapping from paths to lists, or list of rows",
            "anyOf": [lists, rows],
            "description": "values that change together; a row may have a `name`, and changes only what it names",
        },
        "exclude": {**rows, "title": "list of points", "description": "points that are left out, by some coordinates"},
    }
    return {"type": "object", "properties": keys, "additionalProperties": False}


_DRAFT = "http://json-schema.org/draft-07/schema#"  # the version that YAML language servers read
_EXTRA = {
    "plants": {**PLANT_KEYS, "from": PLANT_OF},
    "models": MODEL_KEYS,
    "controllers": CONTROLLER_KEYS,
    "inputs": INPUT_KEYS,
}


def json_schema() -> Schema:
    """Return the schema of a configuration, as plain data.

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
            "properties": {name: _one_of(f"{name}s", partly=False) for name in ("plant", "reference", "input")},
        },
        "additionalProperties": False,
        "definitions": {**_definitions(), "law": _law(_usable("noises"))},
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


def _one_of(group: str, *, partly: bool) -> Schema:
    """Schema of a component; if `partly`, required keys may stand elsewhere, as in the default of methods."""
    choices: list[Schema] = [_choice(group, kind, partly=partly) for kind in _usable(group)]
    file: Schema = {"type": "object", "properties": {"file": CODE}, "required": ["file"]}
    source: list[Schema] = [{"type": "object", "required": ["from"]}] if group in _EXTRA else []
    return {"anyOf": [*choices, *source, file]}


def _choice(group: str, kind: str, *, partly: bool) -> Schema:
    reference = {"$ref": f"#/definitions/{group}.{kind}"}
    if partly:
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
    return {"type": "array", "items": {"anyOf": [names, _one_of(group, partly=False)]}}


def _methods() -> Schema:
    keys: dict[str, Schema] = {
        name: {**_one_of(f"{name}s", partly=True), "description": f"{name} of this method; merged with the default"}
        for name in ("model", "estimator", "controller")
    }
    keys["label"] = {"type": "string", "description": "text for tables and figures; {KEY} is the value of a key"}
    about = "path inside the method, such as estimator.radius -> its range [low, high], or a mapping with further keys"
    keys["tune"] = {"type": "object", "additionalProperties": schema_of(Range), "description": about}
    about = "where the parameters of a method come from that is not tuned here: `as published` for those of a paper, "
    about += "`default`, or {budget: 9, runs: 50} for values that another configuration has tuned"
    keys["parameters"] = {**schema_of(Source), "description": about}
    method: Schema = {"type": ["object", "null"], "properties": keys, "additionalProperties": False}
    closed: Schema = {"type": "object", "additionalProperties": False}
    entries = {axis: {"type": "object", "additionalProperties": _entry(f"{axis}s")} for axis in AXES}
    about = "every entry of an axis with every other one, as methods whose names are joined by +"
    grid: dict[str, Schema] = {GRID: {**closed, "properties": entries, "description": about}}
    point = {**closed, "properties": dict.fromkeys(AXES, {"type": "string"}), "minProperties": 1}
    about = "methods of the grid that are left out, by some of their entries"
    grid[EXCLUDE] = {"type": "array", "items": point, "description": about}
    return {"type": "object", "properties": grid, "additionalProperties": method}


def _entry(group: str) -> Schema:
    """Schema of an entry of a grid: the keys of a component beside a label and ranges for tuning."""
    about = "path inside the component, such as radius -> its range [low, high], or a mapping with further keys"
    tune: Schema = {"type": "object", "additionalProperties": schema_of(Range), "description": about}
    own: dict[str, Schema] = {"label": {"type": "string", "description": "labels are joined by +"}, "tune": tune}
    kinds = [_definitions()[f"{group}.{kind}"] for kind in _usable(group)]
    closed = [{**kind, "properties": {**kind["properties"], **own}} for kind in kinds]
    return {"anyOf": [*closed, *_one_of(group, partly=True)["anyOf"][len(closed) :]]}


_COMPONENTS = ("plant", "model", "reference", "input", "estimator", "controller")
_SPECIAL: dict[str, Any] = {
    **{name: partial(_one_of, f"{name}s", partly=True) for name in _COMPONENTS},
    "methods": _methods,
    "metrics": partial(_list_of, "metrics"),
    "figures": partial(_list_of, "figures"),
    "uncertainty": _uncertainty,
    "noise": _noise,
    "initial": _initial,
    "sweep": _sweep,
    "claims": lambda: {"type": "array", "items": schema_of(ClaimKeys)},
    "requires": lambda: {"type": "array", "items": {"enum": [*EXTRAS]}},
}
