"""Stage 6, check: what the sections say of each other; what is inherited and does not fit is left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from rmpc_bench.claims.claim import Claim
from rmpc_bench.config.claims import check_figures, layout_of, read_claims
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.identity import Built, SweepPoint, independent_laws
from rmpc_bench.config.left_out import SWEPT_PATHS, leave_out
from rmpc_bench.config.methods import with_labels
from rmpc_bench.config.statistics import BEST_AT, Statistics, read_requirement
from rmpc_bench.config.sweep import METHOD_COMPONENTS, NAME, Sweep
from rmpc_bench.config.warnings import swept_noise
from rmpc_bench.config_file.inherit import PATH
from rmpc_bench.config_file.tree import Map, Problems, join, locate_key, split
from rmpc_bench.expressions.tokens import ExpressionError
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.moments import exact_laws
from rmpc_bench.simulation.recording import BURSTS, COVARIANCE, SIGNALS, has_bursts
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import MetricInfo, Problem, ResultLayout
from rmpc_bench.types.errors import nearest
from rmpc_bench.types.metric import AdjustKeys

_METRIC = "metric of this configuration"
_Row = tuple[str, ...]
_NAMED = 3  # keys that the message on a path without effect names


class Quantities(NamedTuple):
    """Metrics and random quantities that the section `statistics` may name."""

    metrics: Sequence[MetricInfo]
    names: Sequence[str]  # of the uncertain quantities
    laws: Mapping[str, Mapping[str, Any]]  # quantity that is drawn alone -> the keys of its law
    of_bursts: Sequence[str] = ()  # names of the quantities of random bursts

    @classmethod
    def of(cls, experiment: Experiment) -> Quantities:
        """Return those of an experiment."""
        scenario = experiment.scenario
        return cls(experiment.metric_infos, scenario.quantities, independent_laws(experiment), scenario.burst_names)


class Checked(NamedTuple):
    """A configuration whose sections fit each other, but for the errors that were found."""

    draft: DraftConfig  # that of the first point, without what is inherited and does not fit
    claims: tuple[Claim, ...]
    labels: dict[str, str]  # method -> its label with the values of the parameters


def check(sweep: Sweep, drafts: Sequence[DraftConfig], built: Sequence[Built], *, lenient: bool) -> Checked:
    """Check what the sections say of each other; the errors are added to the problems of the drafts.

    Figures and claims are those of the first draft, and a claim with an error is of no use.  An inherited claim, figure
    or setting of the comparison is left out where it does not fit.  If lenient, figures and claims may reach beyond the
    end of a run, as in a smoke run.
    """
    first, points = drafts[0], [each.point for each in built]
    layout = layout_of(drafts, built, is_valid=not sweep.problems, lenient=lenient)
    # What is wrong with something inherited is no error.
    checked = replace(first, problems=Problems())
    claims = read_claims(checked, layout)
    check_figures(checked, layout)
    check_report(checked, layout)
    checked = check_statistics(checked, layout, None if points[0] is None else Quantities.of(points[0].experiment))
    _check_stop(checked)
    draft, claims = leave_out(checked, claims, first.problems)
    for each, point in zip(drafts, points, strict=True):
        if point is not None:
            _check_evaluation(each, point.experiment)
    draft, labels = with_labels([draft, *drafts[1:]])
    # Points of a sweep repeat most warnings.
    found = {warning for each in drafts for warning in each.warnings}
    draft = replace(draft, warnings=sorted(found.union(swept_noise(sweep.axes, first))))
    _check_recording(first, points)
    _check_columns(first, sweep)
    made = [point for point in points if point is not None]
    # What a shorter list of methods leaves of a sweep may be alike; the line that names its paths says so.
    shortened = any(line.startswith(SWEPT_PATHS) for line in draft.left_out)
    if len(made) == len(points) and not sweep.problems and not shortened:
        sweep.problems.extend(_axes_without_effect(sweep, made))
    return Checked(draft, claims, labels)


def check_report(draft: DraftConfig, layout: ResultLayout) -> None:
    """Refuse a method or a metric under `report` that does not exist."""
    given = draft.tree.get("report")
    if not isinstance(given, Map):
        return
    for key, known, noun in (("order", layout.methods, "method"), ("metrics", layout.metrics, _METRIC)):
        for number, name in enumerate(given[key] if isinstance(given.get(key), list) else ()):
            if isinstance(name, str) and known and name not in known:
                draft.note(["report", key, number], unknown(name, known, noun))


def check_statistics(draft: DraftConfig, layout: ResultLayout, quantities: Quantities | None) -> DraftConfig:
    """Check the section of the first draft; return it with the defaults of inherited names that do not exist.

    Its names are read from the tree, whether or not its values are valid.  The quantities are None where they are not
    known.
    """
    given = draft.tree.get("statistics")
    if isinstance(given, Map):
        draft = _with_known_names(draft, given, layout)
    statistics = draft.keys.statistics
    if statistics is None:
        return draft
    for place, text in enumerate(statistics.requirements):
        try:
            read_requirement(text, layout.metrics)
        except ExpressionError as error:
            path: list[str | int] = ["statistics", "requirement"]
            path += [] if isinstance(statistics.requirement, str) else [place]
            draft.note(path, f"column {error.column} of {text!r}: {error.message}")
    _check_two_way(draft, statistics)
    if quantities is None:
        return draft
    _check_metric(draft, statistics, quantities.metrics)
    return _with_known_quantities(draft, statistics, quantities)


def _with_known_names(draft: DraftConfig, given: Map, layout: ResultLayout) -> DraftConfig:
    """Refuse a primary metric, a baseline and margins that do not exist; of inherited ones the defaults are used."""
    dropped = dict[str, Any]()
    for key, known, noun in (("primary", layout.metrics, _METRIC), ("baseline", layout.methods, "method")):
        name = given.get(key)
        if not isinstance(name, str) or name in known:
            continue
        if not draft.is_inherited(["statistics", key]):
            if known or key == "primary":
                draft.note(["statistics", key], unknown(name, known, noun))
        elif known:
            dropped[key] = None
            draft.left_out.append(f"statistics.{key}: {name} does not exist here; it is {known[0]} instead")
    margins, gone = given.get("relevant"), list[str]()
    for name in margins if isinstance(margins, Map) else ():
        if name not in layout.metrics:
            if draft.is_inherited(["statistics", "relevant", name]):
                gone.append(name)
                draft.left_out.append(f"statistics.relevant.{name}: there is no such metric here")
            else:
                draft.note(["statistics", "relevant", name], unknown(name, layout.metrics, _METRIC))
    statistics = draft.keys.statistics
    if statistics is None:
        return draft
    if gone:
        dropped["relevant"] = {name: value for name, value in statistics.margins.items() if name not in gone}
    return draft.with_keys(statistics=replace(statistics, **dropped))


def _check_two_way(draft: DraftConfig, statistics: Statistics) -> None:
    two_way = statistics.two_way or {}
    if statistics.two_way is not None and len(two_way) != 2:
        draft.note(["statistics", "two_way"], f"must name two axes (got {len(two_way)})")
    for part, (axis, entries) in zip((0, 2), two_way.items(), strict=False):
        known = dict.fromkeys(name.partition("+")[part] for name in draft.keys.methods or {} if "+" in name)
        for place, name in enumerate(entries):
            at: list[str | int] = ["statistics", "two_way", axis, place]
            if name not in known and not draft.is_inherited(at):
                draft.note(at, unknown(name, known, f"{axis} in the names of methods"))


def _check_metric(draft: DraftConfig, statistics: Statistics, infos: Sequence[MetricInfo]) -> None:
    """Refuse ranks and lost runs by a metric that does not fit."""
    info = next((each for each in infos if each.name == (statistics.primary or infos[0].name)), None)
    if info is None:
        return
    if statistics.ranks and (info.may_not_occur or info.direction == "zero"):
        why = "may not occur in a run" if info.may_not_occur else "is best at 0, so that ratios mean nothing"
        draft.note(["statistics", "ranks"], f"{info.name} {why}; choose another metric with statistics.primary")
    if statistics.lost is not None and info.direction != "lower":
        why = "a larger one is better" if info.direction == "higher" else f"it is best at {BEST_AT[info.direction]}"
        message = f"a run is lost where {info.name} is large, but {why}"
        draft.note(["statistics", "lost"], f"{message}; choose another metric with statistics.primary")


def _with_known_quantities(draft: DraftConfig, statistics: Statistics, quantities: Quantities) -> DraftConfig:
    """Refuse quantities that averages cannot be adjusted for; inherited ones that do not exist are left out."""
    adjust, path = statistics.adjust, list[str | int](["statistics", "adjust"])
    path += ["for"] if isinstance(adjust, AdjustKeys) else []
    names = adjust.for_ if isinstance(adjust, AdjustKeys) else [] if isinstance(adjust, str) else adjust
    laws, gone = quantities.laws, list[str]()
    known = dict.fromkeys([*quantities.names, *laws])
    if names == [] and not isinstance(adjust, str):
        draft.note(path, "must name at least one quantity; `none` adjusts for nothing")
    for place, name in enumerate(names or ()):
        dist = laws.get(name, {}).get("dist", "")
        if name in (names or ())[:place]:
            draft.note([*path, place], f"names {name!r} twice; name each once")
        elif dist in ("uniform", "choice", "normal", "fixed"):
            continue
        elif name in known or name in quantities.of_bursts:
            no_law = "has no independent law that is known"
            why = f"has a {dist} law, for which there are no polynomials" if dist else no_law
            draft.note([*path, place], f"{name} {why}")
        elif draft.is_inherited([*path, place]):
            gone.append(name)
            draft.left_out.append(f"statistics.adjust: {name} does not exist here")
        else:
            near = nearest(name, [*known])
            others = f"known: {', '.join(known)}" if known else "give its law in `uncertainty`"
            hint = f"did you mean {near!r}?" if near else others
            draft.note([*path, place], f"{name!r} is not an uncertain quantity; {hint}")
    if not gone:
        return draft
    kept = [name for name in names or () if name not in gone]
    changed = replace(adjust, for_=kept) if isinstance(adjust, AdjustKeys) else kept
    return draft.with_keys(statistics=replace(statistics, adjust=changed))


def _check_stop(draft: DraftConfig) -> None:
    """Refuse a rule that has nothing to decide on."""
    stop = draft.keys.stop
    if stop is not None and "runs" not in draft.keys.evaluate:
        draft.note(["stop"], "nothing is computed run by run here; evaluate: [runs, ...]", key=True)
    if stop is not None and stop.decide and not any(claim is None or claim.check for claim in draft.claims):
        draft.note(["stop", "decide"], "this configuration has no claim with a check")


def _check_evaluation(draft: DraftConfig, experiment: Experiment) -> None:
    """Add an error for every method without exact moments if no runs are evaluated: nothing would be computed."""
    wanted = draft.keys.evaluate
    if "runs" in wanted:
        return
    if "moments" not in wanted:
        draft.note(["evaluate"], "an ensemble is one of runs: evaluate: [runs, ensemble]")
        return
    for method in experiment.methods:
        laws = exact_laws(experiment.plant, method, experiment.scenario)
        if isinstance(laws, str):
            draft.note(["evaluate"], f"{method.name} has no exact moments: {laws}; evaluate: [runs, moments]")


def _check_recording(draft: DraftConfig, points: Sequence[SweepPoint | None]) -> None:
    """Add an error to the first draft for every signal to record that does not exist at any point of the sweep."""
    found = [point.experiment for point in points if point is not None]
    if len(found) < len(points) or draft.keys.record is None:
        return
    there = [*SIGNALS, COVARIANCE]
    there += [name for experiment in found for method in experiment.methods for name in method.reports]
    there += [name for experiment in found for name in experiment.plant.extra_signals]
    there += [BURSTS for experiment in found if has_bursts(experiment.scenario)]
    for number, name in enumerate(draft.keys.record.signals):
        if name not in there:
            draft.note(["record", "signals", number], unknown(name, dict.fromkeys(there), "signal"))


def _check_columns(draft: DraftConfig, sweep: Sweep) -> None:
    """Refuse metrics with the name of a column of the sweep."""
    swept = [path for axis in sweep.axes for path in axis]
    for number, component in enumerate(draft.metrics):
        name = component.parameters.get("name") if component is not None else None
        if name in swept:
            draft.note(["metrics", number], f"{name!r} is a column of the sweep already; choose another name")


def _axes_without_effect(sweep: Sweep, points: Sequence[SweepPoint]) -> Iterator[Problem]:
    """Refuse axes with two values whose points are alike wherever both occur, with the reason where it is known."""
    # Alike means that every method has the same key, which identifies its trials: such a path would label equal runs. A
    # path may have an effect at some values of the other paths only. Of a zip the rows are compared, not each path.
    for axis in sweep.axes:
        alike = _alike(points, axis)
        if alike is None:
            continue
        is_grid = len(axis) == 1 and axis[0] in (sweep.tree["sweep"].get("grid") or {})
        place = ["sweep", "grid", axis[0]] if is_grid else ["sweep", "zip"]
        first, second = (", ".join(row) for row in alike)
        reasons = dict.fromkeys(filter(None, (_reason(sweep.tree, path) for path in axis if path != NAME)))
        why = "; ".join(reasons) or "nothing that is computed depends on it"
        message = f"has no effect: {first} and {second} give the same runs of every method; {why}"
        yield Problem(*locate_key(sweep.tree, place), join(place), message)


def _alike(points: Sequence[SweepPoint], axis: Sequence[str]) -> tuple[_Row, _Row] | None:
    """Return two values of an axis that no value of the other paths tells apart; None if there are none."""
    groups: dict[_Row, dict[_Row, tuple[tuple[str, str], ...]]] = {}
    for point in points:
        rest = tuple(text for path, text in point.coordinates.items() if path not in axis)
        row = tuple(point.coordinates[path] for path in axis)
        groups.setdefault(rest, {})[row] = tuple(point.method_keys.items())
    for group in groups.values():
        seen: dict[tuple[tuple[str, str], ...], _Row] = {}
        for row, keys in group.items():
            other = seen.setdefault(keys, row)
            both = (each for each in groups.values() if other in each and row in each)
            if other != row and all(each[other] == each[row] for each in both):
                return other, row
    return None


def _reason(tree: Map, path: str) -> str:
    """Say what replaces a swept value in a configuration; empty where it is not known."""
    root = split(path, tree.mark)[0]
    if path == PATH:
        plant = tree.get("plant")
        own = [f"plant.{key}" for key in plant if key != "from"] if isinstance(plant, Map) else []
        more = f" and {len(own) - _NAMED} more" if len(own) > _NAMED else ""
        return f"{', '.join(own[:_NAMED])}{more} of this configuration replace it" if own else ""
    methods = tree.get("methods")
    given = [*methods.values()] if isinstance(methods, Map) else []
    if root in METHOD_COMPONENTS and given and all(isinstance(own, Map) and root in own for own in given):
        return f"every method has its own `{root}`"
    return ""
