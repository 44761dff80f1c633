"""What the section `tune` needs of the other sections."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from rmpc_bench.config.draft import DraftConfig, TunedMethod
from rmpc_bench.config.left_out import Inherited
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.config.tune_section import SMOKE_BUDGET, ValueRow
from rmpc_bench.config.tuned_methods import as_value, nearest_value
from rmpc_bench.config_file.tree import Map, join, locate, locate_key, split
from rmpc_bench.registry import unknown
from rmpc_bench.types import Problem
from rmpc_bench.types.tuning import MOST_PARAMETERS

BEST_AT = {"zero": 0, "one": 1}
"""Direction of a metric that has its best value inside of its range -> this value."""


def shrink_tuning(draft: DraftConfig) -> None:
    """Take the size of a smoke run for the tuning, without the regret."""
    tune, size = draft.values["tune"], draft.values["smoke"]
    if tune is not None and size is not None:
        budget, runs = min(tune.budget, SMOKE_BUDGET), min(tune.runs, size.runs)
        draft.values["tune"] = replace(tune, budget=budget, runs=runs, regret=False)


def metric_of_tuning(draft: DraftConfig) -> str:
    """Return the name of the metric that tuning minimises: the one of the section, or the primary one."""
    tune, statistics = draft.values["tune"], draft.values["statistics"]
    primary = None if statistics is None else statistics.primary
    return str((tune and tune.metric) or primary or (draft.metric_names or [""])[0])


def check_tuning(drafts: Sequence[DraftConfig], points: Sequence[SweepPoint | None], inherited: Inherited) -> None:
    """Refuse ranges without a section, what cannot be tuned and values of nothing; warn of a section without a method.

    The first draft gets errors and warnings.  A design that could not be made is None.
    """
    first = drafts[0]
    names = [name for name, own in (first.values["methods"] or {}).items() if isinstance(own, Map) and own.get("tune")]
    if first.values["tune"] is None:
        # `tune: null` says that nothing is tuned; a section with an error has been reported.
        for name in names if "tune" not in first.tree else ():
            message = "needs the section `tune` at the top, such as `tune: {budget: 16, runs: 40}`, or `tune: {}`"
            first.note(["methods", name, "tune"], f"{message}; `tune: null` tunes nothing", key=True)
        return
    _check_values(drafts, names, inherited)
    if not names:
        # The command line may add such a method, also an earlier one.
        message = "no method has the key `tune`, such as `tune: {estimator.radius: [0.01, 10]}`; nothing is tuned"
        first.warnings.append(Problem(*locate_key(first.tree, ["tune"]), "tune", message))
        return
    _check_search(first, names)
    _check_sweep(first)
    if "runs" not in first.values["evaluate"]:
        first.note(["tune"], "nothing is computed run by run here; evaluate: [runs, ...]", key=True)
    if points[0] is not None:
        _check_metric(first, points[0])
        _check_plant(first, points[0], names)


def _check_values(drafts: Sequence[DraftConfig], names: Sequence[str], inherited: Inherited) -> None:
    """Refuse values that nothing tunes; inherited ones of a method or point that is not here are left out."""
    first, points, seen = drafts[0], {draft.title: draft for draft in drafts}, set[tuple[str, str]]()
    for number, row in enumerate(first.values["tune"].values):
        place: list[str | int] = ["tune", "values", number]
        found = {} if row.at in points else {"at": _wrong_point(row.at, points)}
        found |= {} if row.method in names else {"method": unknown(row.method, names, "method with the key `tune`")}
        if (row.at, row.method) in seen:
            first.note(place, f"{row.method} has values above already; leave out one of the two")
        for key, message in found.items():
            if inherited(locate(first.tree, place)):
                first.left_out.append(f"{join(place)}: {message}")
            else:
                first.note([*place, key] if key == "method" or row.at else place, message)
        seen.add((row.at, row.method))
        tuned = None if found else points[row.at].tuned.get(row.method)
        for path, message in [] if tuned is None else _wrong_values(row, tuned):
            first.note([*place, "values", *path], f"{message}; `-s tune.values=[]` searches again")


def _wrong_point(at: str, points: Collection[str]) -> str:
    if "" in points:
        return "this configuration has no sweep; leave out `at`"
    return unknown(at, points, "point of the sweep") if at else f"name its point, such as `at: {next(iter(points))}`"


def _wrong_values(row: ValueRow, tuned: TunedMethod) -> Iterator[tuple[list[str], str]]:
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


def _check_search(draft: DraftConfig, names: Sequence[str]) -> None:
    for name in names:
        n = len(draft.tuned[name].parameters) if name in draft.tuned else 0
        if n > MOST_PARAMETERS:
            message = f"has {n} parameters; at most {MOST_PARAMETERS} are chosen together, so leave some out"
            draft.note(["methods", name, "tune"], message, key=True)
    tune = draft.values["tune"]
    for name in names if tune is not None and tune.search == "grid-golden" else ():
        if name in draft.tuned and len(draft.tuned[name].parameters) > 1:
            message = "`search: grid-golden` takes one parameter; nelder-mead, quasi-random and auto take more"
            draft.note(["methods", name, "tune"], message, key=True)


def _check_sweep(draft: DraftConfig) -> None:
    """Refuse a parameter that is both swept and tuned."""
    swept = [split(path, draft.tree.mark) for path in draft.coordinates]
    for name, tuned in draft.tuned.items():
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
