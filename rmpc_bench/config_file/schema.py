"""From a design function or a dataclass to the keys of a configuration, validated by pydantic.

A parameter of `design`, or a field of the dataclass, is a key of the YAML.  Its annotation gives the checks and its
default the default.  Parameters that the bench provides (the model, the number of steps and so on) are no keys;
`PROVIDED` lists them.  Numbers may be written as quantities (``2*pi``, ``5%``).
"""

from __future__ import annotations

import dataclasses
import inspect
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    create_model,
)

from rmpc_bench.components.designs import is_built_in, registered_design
from rmpc_bench.config_file.key_errors import BUILT_IN_KEYS, key_problem
from rmpc_bench.config_file.tree import Mark
from rmpc_bench.config_file.unions import union
from rmpc_bench.config_file.user_files import names_files, read_data, read_function, read_function_or_text
from rmpc_bench.expressions import quantity
from rmpc_bench.types import FromCode, FromCodeOrText, FromData, OverTime, Problem

PROVIDED: dict[str, frozenset[str]] = {
    "plants": frozenset({"Ts", "n_steps", "x0", "bounds"}),
    "models": frozenset({"Ts", "n_steps", "plant"}),
    "estimators": frozenset({"model", "n_steps", "x0", "P0", "M0", "plant", "Ts", "plant_info"}),
    "controllers": frozenset({"model", "n_steps", "estimator", "Ts", "plant_info"}),
    "references": frozenset({"ny", "Ts"}),
    "inputs": frozenset({"nu", "Ts", "n_steps"}),
    "noises": frozenset({"n", "ny", "Ts"}),
    "metrics": frozenset(),
    "figures": frozenset(),
}
"""Parameters of a design that the bench fills in, by group."""

PROVIDED_TO_OWN: dict[str, frozenset[str]] = {
    "estimators": frozenset({"limits"}),
    "controllers": frozenset({"limits"}),
}
"""The same for components that are not built in; a built-in controller has a key `limits`."""


def _number(value: Any) -> float:
    return quantity.number(value)


def _integer(value: Any) -> Any:
    if isinstance(value, int) and not isinstance(value, bool):
        # A float would lose digits of a long integer.
        return value
    number = quantity.number(value)
    # pydantic reports a number such as 2.5.
    return int(number) if number == int(number) else number


def _system_matrix(value: Any) -> Any:
    """Read the numbers of a matrix; those that depend on the time index k stay functions of it."""
    if isinstance(value, list):
        return [_system_matrix(entry) for entry in value]
    if value is None:
        return None
    expression = quantity.parse(value, ("k",))
    return expression if expression.names else expression()


def _number_or_integer(value: Any) -> Any:
    """Read a number that is written as text; a whole number stays one, and anything else is left as it is."""
    return _integer(value) if isinstance(value, str) else value


_PLAIN = Annotated[Any, BeforeValidator(_number_or_integer)]
"""A key without an annotation whose default is a number: its value may be written as a quantity."""


_READERS: dict[type, Callable[[Any], Any]] = {
    OverTime: _system_matrix,
    # Before the mark from which it is derived.
    FromCodeOrText: read_function_or_text,
    FromCode: read_function,
    FromData: read_data,
}
"""Mark of an annotation -> what reads a value."""


def with_quantities(annotation: Any) -> Any:
    """Let every number inside an annotation be written as a quantity, and choose between the members of a union."""
    if annotation is float:
        return Annotated[float, BeforeValidator(_number)]
    if annotation is int:
        return Annotated[int, BeforeValidator(_integer)]
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        inner, *constraints = arguments
        for mark, read in _READERS.items():
            if any(isinstance(constraint, mark) for constraint in constraints):
                return Annotated[Any, BeforeValidator(read)]
        return Annotated[(with_quantities(inner), *constraints)]
    if origin in (list, tuple, dict):
        return origin[tuple(argument if argument is ... else with_quantities(argument) for argument in arguments)]
    if origin in (Union, UnionType):
        return union(arguments, with_quantities)
    if inspect.isclass(annotation) and hasattr(annotation, "__dataclass_fields__"):
        return _record(annotation)
    return annotation


def _record(kind: type) -> Any:
    """Validate a mapping with the fields of a dataclass as keys, and make the dataclass."""
    model = create_model(kind.__name__, __config__=_CONFIG, **_fields(kind, frozenset()))

    def make(value: BaseModel) -> Any:
        return kind(**{name: getattr(value, name) for name in type(value).model_fields})

    return Annotated[model, AfterValidator(make)]


_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True, strict=False, frozen=True, protected_namespaces=())


_NO_KEYS = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def _fields(function: Callable[..., Any], provided: frozenset[str]) -> dict[str, Any]:
    parameters = inspect.signature(function).parameters.items()
    keys = {name: key for name, key in parameters if name not in provided and key.kind not in _NO_KEYS}
    if inspect.isclass(function):  # its own keys come before the inherited ones
        own = inspect.get_annotations(function)
        keys = {name: key for name, key in keys.items() if name in own} | keys
    annotated = {name: key.annotation for name, key in keys.items() if key.annotation is not key.empty}
    found = hints(function, annotated)
    fields: dict[str, Any] = {}
    for name, parameter in keys.items():
        default = ... if parameter.default is inspect.Parameter.empty else parameter.default
        alias = name.rstrip("_")
        field = Field(default, alias=alias) if alias != name else Field(default)
        fields[name] = (with_quantities(found.get(name, _PLAIN if _is_number(parameter) else Any)), field)
    return fields


def _is_number(parameter: inspect.Parameter) -> bool:
    """Whether a parameter without an annotation has a number as default."""
    return isinstance(parameter.default, int | float) and not isinstance(parameter.default, bool)


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
    fields = _fields(design, provided | PROVIDED_TO_OWN.get(group, frozenset()))
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
    problems: list[Problem],
    *,
    mark: Mark | None = None,
    further: Sequence[str] = (),
) -> Any:
    """Validate a tree against a pydantic model or any annotation; None where there is an error.

    Inside an annotation numbers may be written as quantities.  A scalar has no place of its own and takes `mark`.
    Further keys, validated elsewhere, and the path are for the messages.
    """
    kind, adapter = _adapter(kind)
    try:
        return adapter.validate_python(tree)
    except ValidationError as error:
        problems += [key_problem(entry, tree, path, kind, mark, further) for entry in error.errors()]
        return None


_ADAPTERS: dict[int, tuple[Any, Any, TypeAdapter[Any]]] = {}
"""Validators of annotations, since a sweep uses the same ones many times.  Some annotations cannot be hashed, so that
the key is their id; they are kept so that no other object gets the same id."""


def _adapter(kind: Any) -> tuple[Any, TypeAdapter[Any]]:
    """Return an annotation with quantities, and its adapter."""
    if id(kind) not in _ADAPTERS:
        checked = with_quantities(kind)
        _ADAPTERS[id(kind)] = kind, checked, TypeAdapter(checked)
    return _ADAPTERS[id(kind)][1:]
