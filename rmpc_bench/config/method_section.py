"""The section `methods`: the components of every method, the defaults of all methods merged in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from rmpc_bench import registry
from rmpc_bench.config.draft import DraftConfig, MethodComponents
from rmpc_bench.config.tuned_methods import read_tuned
from rmpc_bench.config_file.component import Component, read_component
from rmpc_bench.config_file.keys import shown
from rmpc_bench.config_file.tree import Map, locate_key, merge, with_kind
from rmpc_bench.received.names import wrong_label, wrong_method
from rmpc_bench.types import Count
from rmpc_bench.types.tuning import AS_PUBLISHED, DEFAULT, TuningProtocol

MAX_METHODS = 5000
KEYS = ("model", "estimator", "controller", "label", "tune", "parameters")


@dataclass(frozen=True)
class TunedKeys:
    """How the values of a method were tuned in another configuration.

    Parameters
    ----------
    budget : number of values that were tried
    runs : number of runs for each value
    """

    budget: Count
    runs: Count


Source: Any = Literal[AS_PUBLISHED, DEFAULT] | TunedKeys
"""What the key `parameters` of a method may say."""


def read_method_section(draft: DraftConfig) -> None:
    """Read all methods of one point, whose design model is read; the draft gets their components and the errors."""
    methods = draft.values["methods"]
    # An experiment without any controller has u = 0.
    controlled = any(isinstance(own, Map) and "controller" in own for own in (methods or {}).values())
    if methods is not None and not methods:
        draft.note(["methods"], "there must be at least one method")
    if len(methods or {}) > MAX_METHODS:
        draft.note(["methods"], f"there must be at most {MAX_METHODS:,} methods (got {len(methods):,})")
        return
    for name, own in (methods or {}).items():
        path: list[str | int] = ["methods", name]
        if wrong_method(name):
            draft.note(path, wrong_method(name), key=True)
        if own is None:
            own = Map(mark=locate_key(draft.tree, path))
        if not isinstance(own, Map):
            draft.note(path, f"must be a mapping (got {shown(own)})")
            continue
        _method(draft, name, own, path, controlled)


def _method(draft: DraftConfig, name: str, own: Map, path: list[str | int], controlled: bool) -> None:
    for key in own:
        if key not in KEYS:
            draft.note([*path, key], registry.unknown(key, KEYS, "key"), key=True)
    label = own.get("label")
    if "label" in own and not isinstance(label, str):
        draft.note([*path, "label"], f"must be text (got {shown(label)})")
    elif "label" in own and (wrong := wrong_label(label)):
        draft.note([*path, "label"], wrong)
    if "parameters" in own:
        draft.sources[name] = _words(draft.checked(Source, [*path, "parameters"]) or DEFAULT)
    read = partial(_components, draft, path, controlled)
    components = read(own)
    draft.methods[name] = components
    if own.get("tune") is not None:
        draft.methods[name] = read_tuned(draft, name, own, read, components)


def _words(source: str | TunedKeys) -> str:
    return source if isinstance(source, str) else TuningProtocol(source.budget, source.runs, "").words


def _components(draft: DraftConfig, path: list[str | int], any_controlled: bool, own: Map) -> MethodComponents:
    named = {key: _component(draft, own, key, path, any_controlled) for key in ("model", "estimator", "controller")}
    controlled = own.get("controller", draft.tree.get("controller")) is not None
    label = own.get("label")
    return MethodComponents(None if label is None else str(label), **named, controlled=controlled)


def _component(draft: DraftConfig, own: Map, key: str, path: list[str | int], controlled: bool) -> Component | None:
    """Merge a component of a method over the default of all methods and validate it."""
    if key not in own and key == "model":
        return draft.model
    default = with_kind(key + "s", draft.tree.get(key))
    tree = with_kind(key + "s", own[key]) if key in own else default
    if tree is None:
        if key != "controller" or controlled:
            draft.note(path, f"{key!r} is missing, here and as a default of all methods")
        return None
    if isinstance(tree, Map) and isinstance(default, Map) and tree is not default:
        tree = merge(default, tree)
    mark = own.value_marks.get(key, own.mark)
    if not isinstance(tree, Map) and key not in own:
        return None
    return read_component(key + "s", tree, [*path, key], draft.problems, mark=mark, access=draft.access)
