"""JSON Schemas of the sections with a grammar of their own: uncertainty, noise, initial state, sweep, shared keys."""

from __future__ import annotations

from collections.abc import Iterable

from rmpc_bench.config.noise_section import DISTRIBUTIONS, SCALE
from rmpc_bench.config.same_law import SameLaw
from rmpc_bench.models.disturbance import Disturbance
from rmpc_bench.schema.annotation_schema import CODE, Schema, record_schema

NUMBER: Schema = {"type": ["number", "string"]}
_EXPRESSIONS: Schema = {
    "title": "mapping from names to numbers or expressions",
    "type": "object",
    "additionalProperties": NUMBER,
}
_VECTOR: Schema = {"title": "number or list of numbers", "type": ["number", "string", "array"]}
_MATRIX: Schema = {"title": "matrix", "type": ["number", "string", "array"]}

PLANT_KEYS: dict[str, Schema] = {
    "perturb": {
        **_EXPRESSIONS,
        "description": "parameter -> factor on its nominal value, such as 1 + eps, in the uncertain quantities",
    },
    "set": {
        **_EXPRESSIONS,
        "description": "parameter -> its value, such as 2 + eps, in the uncertain quantities",
    },
    "bounds": {
        "type": "object",
        "description": "[low, high] of states, such as {x.0: [0, 1], x.1: [null, 5]}; a run that leaves them is "
        "`out-of-range`; a plant with names takes these, and limits its inputs, so that u is what acts and u_command "
        "what the controller returns: {level: [0 m, 0.6 m], pump: [0, 30 ml/s]}",
    },
    "diverged": {
        "type": ["number", "string", "array", "object"],
        "description": "magnitude of a state, one number, one per state or by name, beyond which a run is `diverged`; "
        "1e6 times the largest of 1, its initial value and the reference if not given",
    },
}
"""Keys of every plant."""
PLANT_OF: Schema = {"type": "string", "description": "a configuration whose plant is taken; see `plant`"}
MODEL_KEYS: dict[str, Schema] = {
    "from": {"const": "plant", "description": "takes the parameters of the plant, which further keys may change"},
    "disturbance": {
        "anyOf": [{"enum": ["none"]}, record_schema(Disturbance)],
        "default": "none",
        "description": "unknown disturbances, which the estimator estimates as further states and the controller "
        "takes into account",
    },
}
"""Keys of every model."""


def uncertainty() -> Schema:
    """Return the schema of the laws of the uncertain quantities."""
    laws: list[Schema] = []
    for name, record in DISTRIBUTIONS.items():
        law = record_schema(record)
        first = (record.__doc__ or "").partition("\n")[0].rstrip(".").replace("``", "`")
        law["properties"] = {"dist": {"const": name, "description": first}, **law["properties"]}
        laws.append({**law, "required": ["dist", *law.get("required", ())]})
    spread: Schema = {"type": "string", "description": "a range about 0, such as +-10%: uniform"}
    about = "factor on the spread of all quantities about their centres, 1 unless given; no quantity may have this name"
    scale: Schema = {"minimum": 0, **NUMBER, "description": about}
    return {"type": "object", "properties": {SCALE: scale}, "additionalProperties": {"anyOf": [spread, *laws]}}


def law(kinds: Iterable[str]) -> Schema:
    """Return the schema of a noise law of one of the loadable kinds, which may be a sum of laws."""
    any_law: Schema = {"$ref": "#/definitions/law"}
    keys: dict[str, Schema] = {kind: {"$ref": f"#/definitions/noises.{kind}"} for kind in kinds}
    keys["same"] = record_schema(SameLaw)
    keys["sum"] = {"type": "array", "items": any_law, "minItems": 1}
    keys["file"] = CODE
    one: Schema = {"type": "object", "properties": keys, "minProperties": 1}
    return {"title": "noise law", "anyOf": [{"enum": ["none", "same"]}, one]}


def noise() -> Schema:
    """Return the schema of the noises of the true system."""
    law: Schema = {"$ref": "#/definitions/law", "title": "noise law"}
    channels: dict[str, Schema] = {
        "process": {**law, "description": "law of w(k)"},
        "measurement": {**law, "description": "law of v(k)"},
        "cross": {
            "title": "`same`, number or matrix",
            "description": "covariance of w(k) and v(k), both Gaussian; 0 if not given",
        },
    }
    mapping: Schema = {"type": "object", "properties": channels, "additionalProperties": False}
    return {"anyOf": [{"enum": ["none", "same"]}, mapping]}


def initial() -> Schema:
    """Return the schema of the initial state and of the initial estimate."""
    x: Schema = {"title": "number, list of numbers or noise law", "anyOf": [_VECTOR, {"$ref": "#/definitions/law"}]}
    process: Schema = {**_MATRIX, "title": "`process` or matrix", "default": "process"}
    keys: dict[str, Schema] = {
        "x": {**x, "default": 0, "description": "true initial state, or its law"},
        "x_hat": {**_VECTOR, "default": 0, "description": "initial estimate of all estimators"},
        "P": {**process, "description": "its covariance; `process` is the covariance of the design process noise"},
        "M": {
            **_MATRIX,
            "default": 0,
            "description": "shape matrix of its ellipsoid, for estimators with sets",
        },
    }
    return {"type": "object", "properties": keys, "additionalProperties": False}


def sweep() -> Schema:
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
