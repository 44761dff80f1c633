"""Stage 6, check: the claims, the figures and the references between sections, before any run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rmpc_bench.claims.claim import Claim
from rmpc_bench.config.claim_checks import read_claims
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.evaluation_checks import check_evaluation, check_recording
from rmpc_bench.config.figure_checks import check_figures
from rmpc_bench.config.labels import labels_of
from rmpc_bench.config.left_out import SWEPT_PATHS, Inherited, drop_statistics, leave_out
from rmpc_bench.config.requirements import check_requirements
from rmpc_bench.config.result_layout import layout_of
from rmpc_bench.config.statistics_section import Statistics
from rmpc_bench.config.stop_checks import check_stop
from rmpc_bench.config.sweep import Sweep
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.config.sweep_section import METHOD_COMPONENTS, NAME
from rmpc_bench.config.tune_checks import BEST_AT
from rmpc_bench.config_file.inherit import PATH
from rmpc_bench.config_file.tree import Map, join, locate, locate_key, split
from rmpc_bench.registry import unknown
from rmpc_bench.types import MetricInfo, Problem

_Row = tuple[str, ...]
_NAMED = 3
"""Keys that the message on a path without effect names."""


def check(
    sweep: Sweep,
    drafts: Sequence[DraftConfig],
    points: Sequence[SweepPoint | None],
    inherited: Inherited,
    *,
    lenient: bool,
) -> tuple[Claim, ...]:
    """Check what the sections say of each other; the errors are added to the problems of the drafts.

    Figures and claims are those of the first draft, and a claim with an error is of no use.  An inherited claim, figure
    or setting of the comparison is left out where it does not fit.  If lenient, figures and claims may reach beyond the
    end of a run, as in a smoke run.
    """
    first = drafts[0]
    layout = layout_of(drafts, points, is_valid=not sweep.problems, lenient=lenient)
    drop_statistics(first, inherited)
    before = len(first.problems)
    claims = read_claims(first, layout)
    check_figures(first, layout)
    _check_report(first)
    check_requirements(first)
    check_stop(first)
    claims = leave_out(first, claims, before, inherited)
    for draft, point in zip(drafts, points, strict=True):
        if point is not None:
            check_evaluation(draft, point.experiment)
    first.labels = labels_of(drafts, inherited)
    # Points of a sweep repeat most warnings.
    first.warnings = sorted({warning for draft in drafts for warning in draft.warnings})
    _check_statistics(first, inherited)
    _check_ranks(first, points[0])
    _check_lost(first, points[0])
    check_recording(first, [None if point is None else point.experiment for point in points])
    _check_columns(first, sweep)
    built = [point for point in points if point is not None]
    # What a shorter list of methods leaves of a sweep may be alike; the line that names its paths says so.
    shortened = any(line.startswith(SWEPT_PATHS) for line in first.left_out)
    if len(built) == len(points) and not sweep.problems and not shortened:
        sweep.problems.extend(_axes_without_effect(sweep, built))
    return claims


def _check_columns(draft: DraftConfig, sweep: Sweep) -> None:
    """Refuse metrics with the name of a column of the sweep."""
    swept = [path for axis in sweep.axes for path in axis]
    for number, component in enumerate(draft.metrics):
        name = component.parameters.get("name") if component is not None else None
        if name in swept:
            draft.note(["metrics", number], f"{name!r} is a column of the sweep already; choose another name")


def _check_statistics(draft: DraftConfig, inherited: Inherited) -> None:
    """Refuse a primary metric, a baseline or a metric with a margin that does not exist; inherited ones are dropped."""
    given, names = draft.tree.get("statistics"), draft.metric_names
    if not isinstance(given, Map):
        return

    def gone(*steps: str) -> bool:
        return inherited(locate(given, steps))

    if isinstance(given.get("primary"), str) and given["primary"] not in names and not gone("primary"):
        draft.note(["statistics", "primary"], unknown(given["primary"], names, "metric of this configuration"))
    baseline = given.get("baseline")
    if isinstance(baseline, str) and draft.methods and baseline not in draft.methods and not gone("baseline"):
        draft.note(["statistics", "baseline"], unknown(baseline, draft.methods, "method"))
    margins = given.get("relevant")
    for name in margins if isinstance(margins, Map) else ():
        if name not in names and not gone("relevant", name):
            draft.note(["statistics", "relevant", name], unknown(name, names, "metric of this configuration"))


def _check_ranks(draft: DraftConfig, point: SweepPoint | None) -> None:
    """Refuse ranks by a metric whose ratios have no mean."""
    statistics = draft.values["statistics"]
    if statistics is None or not statistics.ranks or point is None:
        return
    info = _primary(statistics, point)
    if info is not None and (info.may_not_occur or info.direction == "zero"):
        why = "may not occur in a run" if info.may_not_occur else "is best at 0, so that ratios mean nothing"
        draft.note(["statistics", "ranks"], f"{info.name} {why}; choose another metric with statistics.primary")


def _check_lost(draft: DraftConfig, point: SweepPoint | None) -> None:
    """Refuse lost runs of a metric of which less is not better."""
    statistics = draft.values["statistics"]
    if statistics is None or statistics.lost is None or point is None:
        return
    info = _primary(statistics, point)
    if info is not None and info.direction != "lower":
        why = "a larger one is better" if info.direction == "higher" else f"it is best at {BEST_AT[info.direction]}"
        message = f"a run is lost where {info.name} is large, but {why}; choose another metric with statistics.primary"
        draft.note(["statistics", "lost"], message)


def _primary(statistics: Statistics, point: SweepPoint) -> MetricInfo | None:
    infos = point.experiment.metric_infos
    return next((each for each in infos if each.name == (statistics.primary or infos[0].name)), None)


def _check_report(draft: DraftConfig) -> None:
    """Refuse a method or a metric under `report` that does not exist."""
    given = draft.tree.get("report")
    if not isinstance(given, Map):
        return
    for key, known, noun in [
        ("order", draft.methods, "method"),
        ("metrics", draft.metric_names, "metric of this configuration"),
    ]:
        for number, name in enumerate(given[key] if isinstance(given.get(key), list) else ()):
            if isinstance(name, str) and known and name not in known:
                draft.note(["report", key, number], unknown(name, known, noun))


def _axes_without_effect(sweep: Sweep, points: Sequence[SweepPoint]) -> Iterator[Problem]:
    """Refuse axes with two values whose points are alike wherever both occur, with the reason where it is known.

    Alike means that every method has the same key, which identifies its trials: such a path would label equal runs.  A
    path may have an effect at some values of the other paths only.  Of a zip the rows are compared, not each path.
    """
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
