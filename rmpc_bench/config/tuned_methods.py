"""The key `tune` of a method: its ranges, checked at their ends, and the values that were chosen."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rmpc_bench.config.draft import DraftConfig, MethodComponents, TunedMethod
from rmpc_bench.config.sweep_section import METHOD_COMPONENTS
from rmpc_bench.config.tune_section import Range, parameter_of
from rmpc_bench.config_file.component import plain_data
from rmpc_bench.config_file.keys import shown, validate
from rmpc_bench.config_file.tree import Map, Mark, assign, locate, locate_key, merge, split, with_kind
from rmpc_bench.registry import unknown
from rmpc_bench.types import ConfigError, Problem
from rmpc_bench.types.tuning import TunedParameter

Reader = Callable[[Map], MethodComponents]
"""Validates the components of a method; the errors are added to the problems of the draft."""
DIGITS = 12
"""Significant digits of the sum of an offset and a number of the range."""


def with_values(draft: DraftConfig, own: Map, values: Mapping[str, float], mark: Mark) -> Map:
    """Return a method with other values by path; what it inherits there from the draft is laid below first.

    Raises a ConfigError if a path leads through something that is neither a mapping nor a list.
    """
    for root in dict.fromkeys(split(path, mark)[0] for path in values):
        default, given = (with_kind(f"{root}s", tree.get(root)) for tree in (draft.tree, own))
        laid = merge(default, given) if isinstance(default, Map) and isinstance(given, Map) else given or default
        if isinstance(laid, Map):
            own = assign(own, root, laid, locate(own, [root]) if root in own else mark, own.mark)
    for path, value in values.items():
        own = assign(own, path, value, mark)
    return own


def read_tuned(draft: DraftConfig, name: str, own: Map, read: Reader, components: MethodComponents) -> MethodComponents:
    """Read the key `tune` of a method as configured; the draft gets its ranges, and the errors.

    Return the components with the values that were chosen; those without them where none were.
    """
    path: list[str | int] = ["methods", name, "tune"]
    tree = own["tune"]
    if not isinstance(tree, Map) or not tree:
        got = "an empty mapping" if tree == {} else shown(tree)
        draft.note(path, f"must be a mapping such as {{estimator.radius: [0.01, 10]}} (got {got})")
        return components
    before = len(draft.problems)
    parameters = [found for key in tree if (found := _parameter(draft, tree, key, path)) is not None]
    if len(draft.problems) > before or not _is_valid(components):
        return components
    lowest = _checked_at(draft, own, read, parameters, path, [each.ends[0] for each in parameters])
    if lowest is None:
        return components
    # What is wrong at both ends is reported once.
    for row in ([each.ends[1] for each in parameters], [_inside(each) for each in parameters]):
        if _checked_at(draft, own, read, parameters, path, row) is None:
            return components
    chosen = draft.chosen.get(name)
    mark = locate_key(draft.tree, path)
    values = None
    if chosen is not None and {*chosen} in ({each.path for each in parameters}, set()):
        values = {each.path: as_value(each, chosen[each.path]) for each in parameters if chosen}
    default = tuple(_number_at(components, each.path) for each in parameters)
    draft.tuned[name] = TunedMethod(tuple(parameters), default, lowest, values)
    if not values:
        return components
    draft.defaults[name] = components
    return read(with_values(draft, own, values, mark))


def as_value(parameter: TunedParameter, number: float) -> float | int:
    """Return a value of a parameter as a configuration writes it."""
    return int(number) if parameter.integer and number % 1 == 0 else float(f"{number:.{DIGITS}g}")


def nearest_value(parameter: TunedParameter, number: float) -> float | int:
    """Return the value of a range that is nearest to a number, as a configuration writes it."""
    low, high = parameter.ends
    inside = max(low, min(number, high))
    return as_value(parameter, round(inside) if parameter.integer else inside)


def _parameter(draft: DraftConfig, tree: Map, key: str, path: list[str | int]) -> TunedParameter | None:
    """Read the range of one path; None where it has an error."""
    place = [*path, key]
    try:
        steps = split(key, locate_key(tree, [key]))
    except ConfigError as error:
        draft.problems += error.problems
        return None
    if steps[0] not in METHOD_COMPONENTS or len(steps) < 2:
        known = unknown(steps[0], METHOD_COMPONENTS, "component of a method")
        draft.note(place, known if len(steps) > 1 else "name a parameter, such as estimator.radius", key=True)
        return None
    given = validate(Range, tree[key], place, draft.problems, mark=locate(tree, [key]))
    try:
        return None if given is None else parameter_of(key, given)
    except ValueError as error:
        draft.note(place, str(error))
        return None


def _inside(parameter: TunedParameter) -> float:
    """Return a value inside of a range, no whole number unless only such are tried: a key that counts refuses it."""
    low, high = parameter.ends
    middle = low + (high - low) / 2
    if parameter.integer:
        return math.floor(middle)
    return middle if middle % 1 else low + (high - low) / math.sqrt(8)


def _checked_at(
    draft: DraftConfig,
    own: Map,
    read: Reader,
    parameters: Sequence[TunedParameter],
    path: list[str | int],
    row: Sequence[float],
) -> MethodComponents | None:
    """Validate a method at a value of every range; what is refused there is an error of the range."""
    mark = Mark(*locate(draft.tree, path))
    values = {each.path: as_value(each, value) for each, value in zip(parameters, row, strict=True)}
    before = len(draft.problems)
    found: MethodComponents | None = None
    try:
        found = read(with_values(draft, own, values, mark))
    except ConfigError as error:
        draft.problems += error.problems
    refused, draft.problems[before:] = draft.problems[before:], []
    for problem in refused:
        parameter = _to_blame(problem, parameters)
        number = values[parameter.path]
        counts = number % 1 and "whole number" in problem.message
        hint = "; `integer: true` in its range tries only such" if counts else ""
        draft.note([*path, parameter.path], f"{parameter.path} = {number:.12g}: {problem.message}{hint}")
    return None if refused else found


def _to_blame(problem: Problem, parameters: Sequence[TunedParameter]) -> TunedParameter:
    """Return the parameter whose path a problem is about, or one in the same component; else the first one."""
    steps = problem.path.split(".")
    same = [each for each in parameters if each.path.split(".") == steps[-each.path.count(".") - 1 :]]
    beside = [each for each in parameters if each.path.split(".")[0] in steps]
    return [*same, *beside, *parameters][0]


def _is_valid(components: MethodComponents) -> bool:
    given = [components.model, components.estimator] + [components.controller] * components.controlled
    return all(component is not None for component in given)


def _number_at(components: MethodComponents, path: str) -> float | None:
    """Return the value of a path with all defaults; None where it is no number."""
    root, *steps = split(path, Mark("", 1, 1))
    component = components.named[root]
    node: Any = None if component is None else {**component.parameters, **component.shared}
    for step in steps:
        node = plain_data(node)
        node = node.get(step) if isinstance(node, dict) else _entry(node, step)
    node = plain_data(node)
    return float(node) if isinstance(node, int | float) and not isinstance(node, bool) else None


def _entry(node: Any, step: str) -> Any:
    return node[int(step)] if isinstance(node, list) and step.isdigit() and int(step) < len(node) else None
