"""From a design function or a dataclass to the keys of a configuration: checked by pydantic, refused in own words.

A parameter of `design`, or a field of the dataclass, is a key of the YAML.  Its annotation gives the checks and its
default the default.  Parameters that the bench provides (the model, the number of steps and so on) are no keys;
`PROVIDED` lists them.  Numbers may be written as quantities (``2*pi``, ``5%``).
"""

from __future__ import annotations

import dataclasses
import inspect
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    ValidationError,
    create_model,
)

from rmpc_bench import registry
from rmpc_bench.components.designs import is_built_in, registered_design
from rmpc_bench.components.reference import CodeError
from rmpc_bench.components.user_class import MEANINGS
from rmpc_bench.config_file.tree import Items, Map, Mark, join, locate, locate_key
from rmpc_bench.config_file.user_files import names_files, read_data, read_function, read_function_or_text
from rmpc_bench.expressions import quantity
from rmpc_bench.types import ConfigError, FromCode, FromCodeOrText, FromData, OverTime, Problem, row_by_row

_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True, strict=False, frozen=True, protected_namespaces=())
_NO_KEYS = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
PROVIDED: dict[str, frozenset[str]] = {
    "plants": frozenset({"Ts", "n_steps", "x0", "bounds", "angles", "time_unit"}),
    "models": frozenset({"Ts", "n_steps", "plant", "time_unit"}),
    "estimators": frozenset({"model", "n_steps", "x0", "P0", "M0", "plant", "Ts", "plant_info"}),
    "controllers": frozenset({"model", "n_steps", "estimator", "Ts", "plant_info", "measured"}),
    "references": frozenset({"ny", "Ts"}),
    "inputs": frozenset({"nu", "Ts", "n_steps"}),
    "noises": frozenset({"n", "ny", "Ts", "signal_names", "sampled"}),
    "metrics": frozenset(),
    "figures": frozenset(),
}  # parameters of a design that the bench fills in, by group

PROVIDED_TO_OWN: dict[str, frozenset[str]] = {
    "estimators": frozenset({"limits"}),
    "controllers": frozenset({"limits"}),
}  # the same for components that are not built in; a built-in controller has a key `limits`
PROVIDED_TO_BUILT_IN = frozenset({"measured", "sampled"})
"""Those that the bench fills in for built-in components only; others may have keys of these names."""


def _integer(value: Any) -> Any:
    if isinstance(value, int) and not isinstance(value, bool):
        # A float would lose digits of a long integer.
        return value
    number = quantity.number(value)
    # pydantic reports a number such as 2.5.
    return int(number) if number == int(number) else number


def _system_matrix(value: Any) -> Any:
    """Read the numbers of a matrix; those that depend on the time index k stay functions of it."""
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "fiu":
        if not np.isfinite(value).all():
            raise ValueError("must be finite")
        return value
    if isinstance(value, list):
        return [_system_matrix(entry) for entry in value]
    if value is None:
        return None
    if callable(value):
        return value
    expression = quantity.parse(value, ("k",))
    return expression if expression.names else expression()


_PLAIN = Annotated[Any, BeforeValidator(lambda value: _integer(value) if isinstance(value, str) else value)]
"""A key without an annotation whose default is a number: its value may be written as a quantity."""

_READERS: dict[type, Callable[[Any], Any]] = {
    OverTime: _system_matrix,
    FromCodeOrText: read_function_or_text,
    FromCode: read_function,
    FromData: read_data,
}  # mark of an annotation -> what reads a value


def with_quantities(annotation: Any) -> Any:
    """Let every number inside an annotation be written as a quantity, and choose between the members of a union."""
    if annotation is float:
        return Annotated[float, BeforeValidator(quantity.number)]
    if annotation is int:
        return Annotated[int, BeforeValidator(_integer)]
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        inner, *constraints = arguments
        for constraint in constraints:
            if type(constraint) in _READERS:
                return Annotated[Any, BeforeValidator(_READERS[type(constraint)])]
        return Annotated[(with_quantities(inner), *constraints)]
    if origin in (list, tuple, dict):
        return origin[tuple(argument if argument is ... else with_quantities(argument) for argument in arguments)]
    if origin in (Union, UnionType):
        return _union(arguments)
    is_record = inspect.isclass(annotation) and hasattr(annotation, "__dataclass_fields__")
    return _record(annotation) if is_record else annotation


def _shape(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, dict) or hasattr(value, "__dataclass_fields__"):
        return "a mapping"
    if isinstance(value, list | tuple):
        return "a matrix" if value and isinstance(value[0], list | tuple) else "a list"
    return "a number"


def _union(members: Sequence[Any]) -> Any:
    """Choose the member by the shape of the value, of several dataclasses by their field `kind`."""
    # So errors concern that member only. One word is allowed in each.
    tagged = _by_shape(members)
    if [*tagged] == ["a mapping"]:
        return tagged["a mapping"]
    words = [word for member in members if get_origin(member) is Literal for word in get_args(member)]

    def choose(value: Any) -> str:
        if isinstance(value, str) and value in words:
            return "a word"
        if isinstance(value, bool) and "true or false" in tagged:
            return "true or false"
        if isinstance(value, str) and ("text" in tagged or "a number" not in tagged):
            return "text" if "text" in tagged else "a word"
        shape = _shape(value)
        return "a list" if shape == "a matrix" and "a matrix" not in tagged else shape

    said = {"a word": " or ".join(map(repr, words)) if len(words) < 3 else "a word"}
    return _chosen(tagged, choose, " or ".join(said.get(tag, tag) for tag in tagged if tag != "nothing"))


def _by_shape(members: Sequence[Any]) -> dict[str, Any]:
    """Return the annotation for every shape of a value."""
    kinds = [member for member in members if inspect.isclass(member) and hasattr(member, "__dataclass_fields__")]
    tagged: dict[str, Any] = {}
    for member in members:
        core = get_args(member)[0] if get_origin(member) is Annotated else member
        if any(isinstance(mark, FromCode | FromData) for mark in get_args(member)):
            tagged["text"] = with_quantities(member)
            continue
        if get_origin(core) is Literal:
            tagged["a word"] = member
        elif core is NoneType:
            tagged["nothing"] = member
        elif get_origin(core) in (list, tuple):
            inner = get_args(core)[0]
            tagged["a matrix" if get_origin(inner) in (list, tuple) else "a list"] = with_quantities(member)
        elif core is bool:
            tagged["true or false"] = member
        elif core in (float, int):
            tagged["a number"] = with_quantities(member)
        elif core is str:
            tagged["text"] = member
        else:
            tagged["a mapping"] = _by_kind(kinds) if len(kinds) > 1 else with_quantities(member)
    return tagged


def _by_kind(members: Sequence[type]) -> Any:
    """Choose between dataclasses by the key `kind`, each of which allows one word for it."""
    kinds = {get_args(get_type_hints(member)["kind"])[0]: member for member in members}

    def refuse(kind: Any) -> None:
        known = f"known kinds: {', '.join(kinds)}"
        raise ValueError(f"'kind' is missing; {known}" if kind is None else registry.unknown(str(kind), kinds, "kind"))

    def choose(value: Any) -> str | None:
        if not isinstance(value, dict):
            return None
        kind = value.get("kind")
        return f"kind {kind}" if isinstance(kind, str) and kind in kinds else "no kind"

    wrong: Any = (Annotated[Any, BeforeValidator(refuse)], Field(None, validate_default=True))
    nothing: Any = create_model("NoKind", __config__=ConfigDict(extra="allow"), kind=wrong)
    tagged = {f"kind {kind}": with_quantities(member) for kind, member in kinds.items()}
    return _chosen({**tagged, "no kind": nothing}, choose, "a mapping")


def _chosen(tagged: dict[str, Any], choose: Callable[[Any], str | None], expected: str) -> Any:
    """Return a union whose member is selected by a function of the value."""
    choices: Any = Union.__getitem__(tuple(Annotated[member, Tag(tag)] for tag, member in tagged.items()))
    return Annotated[
        choices, Discriminator(choose, custom_error_type="shape", custom_error_message=f"expected {expected}")
    ]


@cache
def _record(kind: type) -> Any:
    """Validate a mapping with the fields of a dataclass as keys, and make the dataclass."""
    model = create_model(kind.__name__, __config__=_CONFIG, **_fields(kind, frozenset()))

    def make(value: BaseModel) -> Any:
        return kind(**{name: getattr(value, name) for name in type(value).model_fields})

    return Annotated[model, AfterValidator(make)]


def _fields(function: Callable[..., Any], provided: frozenset[str]) -> dict[str, Any]:
    parameters = inspect.signature(function).parameters.items()
    keys = {name: key for name, key in parameters if name not in provided and key.kind not in _NO_KEYS}
    if inspect.isclass(function):
        keys = {name: keys[name] for name in own_first(function, keys)}
    annotated = {name: key.annotation for name, key in keys.items() if key.annotation is not key.empty}
    found = hints(function, annotated)
    fields: dict[str, Any] = {}
    for name, parameter in keys.items():
        default = ... if parameter.default is parameter.empty else parameter.default
        unannotated = _PLAIN if isinstance(default, int | float) and not isinstance(default, bool) else Any
        alias = name.rstrip("_")
        field = Field(default, alias=alias) if alias != name else Field(default)
        fields[name] = (with_quantities(found.get(name, unannotated)), field)
    return fields


def own_first(kind: type, names: Iterable[str]) -> list[str]:
    """Return keys of a class in their order: its own ones come before the inherited ones."""
    own = inspect.get_annotations(kind)
    return sorted(names, key=lambda name: name not in own)


def hints(function: Callable[..., Any], annotations: dict[str, Any]) -> dict[str, Any]:
    """Evaluate the annotations of keys only: what is provided may be annotated with names imported for mypy alone."""
    annotations = {name: Any if text is inspect.Parameter.empty else text for name, text in annotations.items()}
    if dataclasses.is_dataclass(function):  # fields may be inherited: each is evaluated in the module of its own class
        found = get_type_hints(function, include_extras=True)
        return {name: found.get(name, Any) for name in annotations}
    inner = inspect.unwrap(function)
    inner = inner.__init__ if inspect.isclass(inner) else inner
    scope = vars(sys.modules[inner.__module__]) if hasattr(inner, "__module__") else {}
    return get_type_hints(type("Keys", (), {"__annotations__": annotations}), scope, include_extras=True)


def model_of(group: str, kind: str) -> type[BaseModel]:
    """Return the pydantic model of the keys of a registered component."""
    return keys_of(group, kind, registered_design(group, kind))


@cache
def keys_of(group: str, kind: str, design: Callable[..., Any]) -> type[BaseModel]:
    """Return the pydantic model of the keys of a design function or class."""
    provided = PROVIDED[group]
    if is_built_in(group, kind):
        return create_model(kind, __config__=_CONFIG, __module__=BUILT_IN_KEYS, **_fields(design, provided))
    fields = _fields(design, (provided - PROVIDED_TO_BUILT_IN) | PROVIDED_TO_OWN.get(group, frozenset()))
    with warnings.catch_warnings():
        # pydantic warns of a key with the name of one of its methods, such as `copy`, which is no mistake here.
        warnings.simplefilter("ignore", UserWarning)
        return create_model(kind, __config__=_CONFIG, **fields)


@cache
def keys_with_files(group: str, kind: str, design: Callable[..., Any]) -> frozenset[str]:
    """Return the keys of a design function whose values name files; see `keys_of`."""
    names = keys_of(group, kind, design).model_fields
    parameters = inspect.signature(design).parameters
    found = hints(design, {name: parameters[name].annotation for name in names})
    return frozenset(name.rstrip("_") for name, annotation in found.items() if names_files(annotation))


def validate(
    kind: Any,
    tree: Any,
    path: Sequence[str | int],
    *,
    mark: Mark | None = None,
    further: Sequence[str] = (),
) -> Any:
    """Validate a tree against a pydantic model or any annotation; a ConfigError has all that is wrong.

    Inside an annotation numbers may be written as quantities.  A scalar has no place of its own and takes `mark`.
    Further keys, validated elsewhere, and the path are for the messages.
    """
    kind, adapter = _adapter(kind)
    try:
        return adapter.validate_python(tree)
    except ValidationError as error:
        raise ConfigError([_key_problem(entry, tree, path, kind, mark, further) for entry in error.errors()]) from None


_ADAPTERS: dict[int, tuple[Any, Any, TypeAdapter[Any]]] = {}
"""Validators of annotations, since a sweep uses the same ones many times.  Some annotations cannot be hashed, so that
the key is their id; they are kept so that no other object gets the same id."""


def _adapter(kind: Any) -> tuple[Any, TypeAdapter[Any]]:
    """Return an annotation with quantities, and its adapter."""
    if id(kind) not in _ADAPTERS:
        checked = with_quantities(kind)
        _ADAPTERS[id(kind)] = kind, checked, TypeAdapter(checked)
    return _ADAPTERS[id(kind)][1:]


BUILT_IN_KEYS = "rmpc_bench.built_in_keys"
"""Module that the keys of a built-in component say they come from; a user cannot change their names."""


def _key_problem(
    entry: Any, tree: Any, path: Sequence[str | int], kind: Any, mark: Mark | None, further: Sequence[str]
) -> Problem:
    """Return an entry of `ValidationError.errors` as a problem at the value or key to blame."""
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
    is_own = inspect.isclass(kind) and issubclass(kind, BaseModel) and kind.__module__ != BUILT_IN_KEYS
    if isinstance(name, int) or name in MEANINGS or not is_own:
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
