"""What is searched of a method: its ranges under the key `tune`, chosen values, and what a search needs of the rest."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rmpc_bench.config.draft import AlreadyNoted, DraftConfig, MethodComponents, Search, metric_names
from rmpc_bench.config.identity import SweepPoint
from rmpc_bench.config.statistics import BEST_AT
from rmpc_bench.config.sweep import METHOD_COMPONENTS
from rmpc_bench.config.tune import Range, TuneKeys, parameter_of
from rmpc_bench.config_file.component import Component, plain_data
from rmpc_bench.config_file.keys import shown, validate
from rmpc_bench.config_file.tree import (
    Map,
    Mark,
    Problems,
    assign,
    error_at,
    join,
    locate,
    locate_key,
    merge,
    problem_at,
    split,
    with_kind,
)
from rmpc_bench.registry import unknown
from rmpc_bench.types import Problem
from rmpc_bench.types.tuning import MOST_PARAMETERS, TunedParameter, ValueRow

DIGITS = 12  # significant digits of the sum of an offset and a number of the range


def with_values(draft: DraftConfig, own: Map, values: Mapping[str, float], mark: Mark) -> Map:
    """Return a method with other values by path, over what it inherits there; a ConfigError for a path into a text."""
    for root in dict.fromkeys(split(path, mark)[0] for path in values):
        default, given = (with_kind(f"{root}s", tree.get(root)) for tree in (draft.tree, own))
        laid = merge(default, given) if isinstance(default, Map) and isinstance(given, Map) else given or default
        if isinstance(laid, Map):
            own = assign(own, root, laid, locate(own, [root]) if root in own else mark, own.mark)
    for path, value in values.items():
        own = assign(own, path, value, mark)
    return own


def read_components(draft: DraftConfig, name: str, own: Map) -> MethodComponents:
    """Read the components of a method as it is given, or with the values of a search."""
    model, estimator, controller = (_component(draft, name, own, key) for key in METHOD_COMPONENTS)
    controlled = own.get("controller", draft.tree.get("controller")) is not None
    label = own.get("label")
    return MethodComponents(None if label is None else str(label), model, estimator, controller, controlled)


def _component(draft: DraftConfig, name: str, own: Map, key: str) -> Component | None:
    """Merge a component of a method over the default of all methods and validate it."""
    if key not in own and key == "model":
        return draft.model
    path: list[str | int] = ["methods", name]
    default = with_kind(f"{key}s", draft.tree.get(key))
    tree = with_kind(f"{key}s", own[key]) if key in own else default
    if tree is None:
        # An experiment without any controller has u = 0.
        if key != "controller" or draft.keys.with_controller:
            draft.note(path, f"{key!r} is missing, here and as a default of all methods")
        return None
    if isinstance(tree, Map) and isinstance(default, Map) and tree is not default:
        tree = merge(default, tree)
    if not isinstance(tree, Map) and key not in own:
        return None
    return draft.component(f"{key}s", tree, [*path, key], mark=own.places(key)[1])


def with_search(draft: DraftConfig, name: str, own: Map, components: MethodComponents) -> MethodComponents:
    """Read the key `tune` of a method; return its components with what is searched and the values that were chosen."""
    search = draft.problems.tried(_search, draft, name, own, components)
    if search is None:
        return components
    mark = locate_key(draft.tree, ["methods", name, "tune"])
    found = read_components(draft, name, with_values(draft, own, search.values, mark)) if search.values else components
    return replace(found, search=search)


def _search(draft: DraftConfig, name: str, own: Map, components: MethodComponents) -> Search:
    """Read the ranges of a method, and validate it at their ends; a ConfigError has what is wrong."""
    path: list[str | int] = ["methods", name, "tune"]
    tree = own["tune"]
    if not isinstance(tree, Map) or not tree:
        got = "an empty mapping" if tree == {} else shown(tree)
        raise error_at(draft.tree, path, f"must be a mapping such as {{estimator.radius: [0.01, 10]}} (got {got})")
    problems = Problems()
    found = [problems.tried(_parameter, draft.tree, tree, key, path) for key in tree]
    problems.stop()
    if not components.is_valid:
        raise AlreadyNoted
    parameters = [each for each in found if each is not None]
    lowest = _checked_at(draft, name, own, parameters, [each.ends[0] for each in parameters])
    # What is wrong at both ends is reported once.
    _checked_at(draft, name, own, parameters, [each.ends[1] for each in parameters])
    _checked_at(draft, name, own, parameters, [_inside(each) for each in parameters])
    chosen, values = draft.chosen.get(name), None
    if chosen is not None and {*chosen} in ({each.path for each in parameters}, set()):
        values = {each.path: as_value(each, chosen[each.path]) for each in parameters if chosen}
    default = tuple(_number_at(components, each.path) for each in parameters)
    return Search(tuple(parameters), default, lowest, values, components)


def as_value(parameter: TunedParameter, number: float) -> float | int:
    """Return a value of a parameter as a configuration writes it."""
    return int(number) if parameter.integer and number % 1 == 0 else float(f"{number:.{DIGITS}g}")


def nearest_value(parameter: TunedParameter, number: float) -> float | int:
    """Return the value of a range that is nearest to a number, as a configuration writes it."""
    low, high = parameter.ends
    inside = max(low, min(number, high))
    return as_value(parameter, round(inside) if parameter.integer else inside)


def _parameter(whole: Map, tree: Map, key: str, path: list[str | int]) -> TunedParameter:
    """Read the range of one path."""
    place = [*path, key]
    steps = split(key, locate_key(tree, [key]))
    if steps[0] not in METHOD_COMPONENTS or len(steps) < 2:
        message = "name a parameter, such as estimator.radius"
        message = unknown(steps[0], METHOD_COMPONENTS, "component of a method") if len(steps) > 1 else message
        raise error_at(whole, place, message, key=True)
    given = validate(Range, tree[key], place, mark=locate(tree, [key]))
    try:
        return parameter_of(key, given)
    except ValueError as error:
        raise error_at(whole, place, str(error)) from None


def _inside(parameter: TunedParameter) -> float:
    """Return a value inside of a range, no whole number unless only such are tried: a key that counts refuses it."""
    low, high = parameter.ends
    middle = low + (high - low) / 2
    if parameter.integer:
        return math.floor(middle)
    return middle if middle % 1 else low + (high - low) / math.sqrt(8)


def _checked_at(
    draft: DraftConfig, name: str, own: Map, parameters: Sequence[TunedParameter], row: Sequence[float]
) -> MethodComponents:
    """Validate a method at a value of every range; what is refused there is an error of the range."""
    path: list[str | int] = ["methods", name, "tune"]
    values = {each.path: as_value(each, value) for each, value in zip(parameters, row, strict=True)}
    there = replace(draft, problems=Problems())
    given = there.problems.tried(with_values, draft, own, values, locate(draft.tree, path))
    found = None if given is None else read_components(there, name, given)
    problems = Problems()
    for problem in there.problems:
        parameter = _to_blame(problem, parameters)
        number = values[parameter.path]
        counts = number % 1 and "whole number" in problem.message
        hint = "; `integer: true` in its range tries only such" if counts else ""
        message = f"{parameter.path} = {number:.12g}: {problem.message}{hint}"
        problems.append(problem_at(draft.tree, [*path, parameter.path], message))
    problems.stop()
    assert found is not None
    return found


def _to_blame(problem: Problem, parameters: Sequence[TunedParameter]) -> TunedParameter:
    """Return the parameter whose path a problem is about, or one in the same component; else the first one."""
    steps = problem.path.split(".")
    same = [each for each in parameters if each.path.split(".") == steps[-each.path.count(".") - 1 :]]
    beside = [each for each in parameters if each.path.split(".")[0] in steps]
    return [*same, *beside, *parameters][0]


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


def metric_of_tuning(draft: DraftConfig) -> str:
    """Return the name of the metric that tuning minimises: the one of the section, or the primary one."""
    tune, statistics = draft.keys.tune, draft.keys.statistics
    primary = None if statistics is None else statistics.primary
    return str((tune and tune.metric) or primary or [*metric_names(draft.metrics), ""][0])


def check_tuning(drafts: Sequence[DraftConfig], points: Sequence[SweepPoint | None]) -> None:
    """Refuse ranges without a section, what cannot be tuned and values of nothing; warn of a section without a method.

    The first draft gets errors and warnings.  A design that could not be made is None.
    """
    first = drafts[0]
    names = [name for name, own in (first.keys.methods or {}).items() if isinstance(own, Map) and own.get("tune")]
    tune = first.keys.tune
    if tune is None:
        # `tune: null` says that nothing is tuned; a section with an error has been reported.
        for name in names if "tune" not in first.tree else ():
            message = "needs the section `tune` at the top, such as `tune: {budget: 16, runs: 40}`, or `tune: {}`"
            first.note(["methods", name, "tune"], f"{message}; `tune: null` tunes nothing", key=True)
        return
    _check_values(drafts, tune, names)
    if not names:
        # The command line may add such a method, also an earlier one.
        message = "no method has the key `tune`, such as `tune: {estimator.radius: [0.01, 10]}`; nothing is tuned"
        first.warnings.append(Problem(*locate_key(first.tree, ["tune"]), "tune", message))
        return
    _check_search(first, tune, names)
    _check_sweep(first)
    if "runs" not in first.keys.evaluate:
        first.note(["tune"], "nothing is computed run by run here; evaluate: [runs, ...]", key=True)
    if points[0] is not None:
        _check_metric(first, points[0])
        _check_plant(first, points[0], names)


def _check_values(drafts: Sequence[DraftConfig], tune: TuneKeys, names: Sequence[str]) -> None:
    """Refuse values that nothing tunes; inherited ones of a method or point that is not here are left out."""
    first, points, seen = drafts[0], {draft.title: draft for draft in drafts}, set[tuple[str, str]]()
    for number, row in enumerate(tune.values):
        place: list[str | int] = ["tune", "values", number]
        found = {} if row.at in points else {"at": _wrong_point(row.at, points)}
        found |= {} if row.method in names else {"method": unknown(row.method, names, "method with the key `tune`")}
        if (row.at, row.method) in seen:
            first.note(place, f"{row.method} has values above already; leave out one of the two")
        for key, message in found.items():
            if first.is_inherited(place):
                first.left_out.append(f"{join(place)}: {message}")
            else:
                first.note([*place, key] if key == "method" or row.at else place, message)
        seen.add((row.at, row.method))
        tuned = None if found else points[row.at].searches.get(row.method)
        for path, message in [] if tuned is None else _wrong_values(row, tuned):
            first.note([*place, "values", *path], f"{message}; `-s tune.values=[]` searches again")


def _wrong_point(at: str, points: Collection[str]) -> str:
    if "" in points:
        return "this configuration has no sweep; leave out `at`"
    return unknown(at, points, "point of the sweep") if at else f"name its point, such as `at: {next(iter(points))}`"


def _wrong_values(row: ValueRow, tuned: Search) -> Iterator[tuple[list[str], str]]:
    """Yield the path below `values` and what is wrong there."""
    parameters = {each.path: each for each in tuned.parameters}
    for path, value in row.values.items():
        if path not in parameters:
            yield [path], unknown(path, parameters, f"tuned parameter of {row.method}")
        elif (nearest := nearest_value(parameters[path], value)) != as_value(parameters[path], value):
            yield [path], f"{value:g} is not in the range of {row.method}; the nearest value is {nearest:.12g}"
    if row.values and {*row.values} < {*parameters}:
        missing = ", ".join(path for path in parameters if path not in row.values)
        yield [], f"{missing} is missing, which is tuned too"


def _check_search(draft: DraftConfig, tune: TuneKeys, names: Sequence[str]) -> None:
    tuned = draft.searches
    for name in names:
        n = len(tuned[name].parameters) if name in tuned else 0
        if n > MOST_PARAMETERS:
            message = f"has {n} parameters; at most {MOST_PARAMETERS} are chosen together, so leave some out"
            draft.note(["methods", name, "tune"], message, key=True)
    for name in names if tune.search == "grid-golden" else ():
        if name in tuned and len(tuned[name].parameters) > 1:
            message = "`search: grid-golden` takes one parameter; nelder-mead, quasi-random and auto take more"
            draft.note(["methods", name, "tune"], message, key=True)


def _check_sweep(draft: DraftConfig) -> None:
    """Refuse a parameter that is both swept and tuned."""
    swept = [split(path, draft.tree.mark) for path in draft.coordinates]
    for name, tuned in draft.searches.items():
        for parameter in tuned.parameters:
            steps = ["methods", name, *split(parameter.path, draft.tree.mark)]
            if any(path[: len(steps)] == steps for path in swept):
                message = "is swept, so tuning has nothing to choose; leave out one of the two"
                draft.note(["methods", name, "tune", parameter.path], message, key=True)


def _check_metric(draft: DraftConfig, point: SweepPoint) -> None:
    name, infos = metric_of_tuning(draft), {info.name: info for info in point.experiment.metric_infos}
    if name not in infos:
        draft.note(["tune", "metric"], unknown(name, infos, "metric of this configuration"))
    elif infos[name].direction == "higher":
        draft.note(["tune", "metric"], f"tuning minimises its metric, and a larger {name} is better; choose another")
    elif infos[name].direction in BEST_AT:
        best = BEST_AT[infos[name].direction]
        draft.note(["tune", "metric"], f"tuning minimises its metric, and {name} is best at {best}; choose another")


def _check_plant(draft: DraftConfig, point: SweepPoint, names: Sequence[str]) -> None:
    plant = point.experiment.plant
    if plant.recorded is not None:
        message = "a recorded plant has the same runs for tuning and for the experiment; give the values themselves"
        draft.note(["tune"], message, key=True)
    if plant.opponent is not None and plant.opponent[0] in names:
        message = "the uncertainty of the plant is chosen against this method; remove its key tune"
        draft.note(["methods", plant.opponent[0], "tune"], message, key=True)
