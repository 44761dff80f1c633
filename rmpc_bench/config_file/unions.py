"""Unions of annotations: the form of a value selects one member, so that errors concern that member only."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from types import NoneType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag, create_model

from rmpc_bench import registry
from rmpc_bench.types import FromCode, FromData

BOOLEAN = "true or false"


def _shape(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, dict) or hasattr(value, "__dataclass_fields__"):
        return "a mapping"
    if isinstance(value, list | tuple):
        return "a matrix" if value and isinstance(value[0], list | tuple) else "a list"
    return "a number"


def union(members: Sequence[Any], checked: Callable[[Any], Any]) -> Any:
    """Choose the member by the shape of the value, of several dataclasses by their field `kind`.

    It allows one word in each.  `checked` turns an annotation into one that pydantic validates.
    """
    tagged = _by_shape(members, checked)
    if [*tagged] == ["a mapping"]:
        return tagged["a mapping"]
    words = [word for member in members if get_origin(member) is Literal for word in get_args(member)]

    def choose(value: Any) -> str:
        if isinstance(value, str) and value in words:
            return "a word"
        if isinstance(value, bool) and BOOLEAN in tagged:
            return BOOLEAN
        if isinstance(value, str) and ("text" in tagged or "a number" not in tagged):
            return "text" if "text" in tagged else "a word"
        shape = _shape(value)
        return "a list" if shape == "a matrix" and "a matrix" not in tagged else shape

    return _chosen(tagged, choose, " or ".join(tag for tag in tagged if tag != "nothing"))


def _by_shape(members: Sequence[Any], checked: Callable[[Any], Any]) -> dict[str, Any]:
    """Return the annotation for every shape of a value."""
    kinds = [member for member in members if inspect.isclass(member) and hasattr(member, "__dataclass_fields__")]
    tagged: dict[str, Any] = {}
    for member in members:
        core = get_args(member)[0] if get_origin(member) is Annotated else member
        if any(isinstance(mark, FromCode | FromData) for mark in get_args(member)):
            tagged["text"] = checked(member)
            continue
        if get_origin(core) is Literal:
            tagged["a word"] = member
        elif core is NoneType:
            tagged["nothing"] = member
        elif get_origin(core) in (list, tuple):
            inner = get_args(core)[0]
            tagged["a matrix" if get_origin(inner) in (list, tuple) else "a list"] = checked(member)
        elif core is bool:
            tagged[BOOLEAN] = member
        elif core in (float, int):
            tagged["a number"] = checked(member)
        elif core is str:
            tagged["text"] = member
        else:
            tagged["a mapping"] = _by_kind(kinds, checked) if len(kinds) > 1 else checked(member)
    return tagged


def _by_kind(members: Sequence[type], checked: Callable[[Any], Any]) -> Any:
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
    return _chosen({f"kind {kind}": checked(kinds[kind]) for kind in kinds} | {"no kind": nothing}, choose, "a mapping")


def _chosen(tagged: dict[str, Any], choose: Callable[[Any], str | None], expected: str) -> Any:
    """Return a union whose member is selected by a function of the value."""
    choices: Any = Union.__getitem__(tuple(Annotated[member, Tag(tag)] for tag, member in tagged.items()))
    return Annotated[
        choices,
        Discriminator(choose, custom_error_type="shape", custom_error_message=f"expected {expected}"),
    ]
