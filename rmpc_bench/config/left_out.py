"""What an overridden or an extending configuration inherits although it does not fit there: it is left out and named.

They belong to the configuration as its file states it: a claim about a method that was overridden away, or a figure of
a metric that is not computed, is no mistake of the user.  It is left out and named.  What the override or the extending
file itself says is checked as ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rmpc_bench.claims.claim import Claim
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.tree import OPTIONS, Items, Map, Mark, locate, split
from rmpc_bench.types import Problem

SWEPT_PATHS = "paths of the sweep into methods that do not exist here"
"""Beginning of the line that names paths which are left out of a sweep."""
_LISTS = (("report", "order"), ("report", "metrics"), ("statistics", "requirement"))
"""Settings that are lists of names, or of texts with names."""


@dataclass(frozen=True)
class Inherited:
    """Which parts of a configuration are inherited: by an overridden one from its file, or from an extended file.

    Parameters
    ----------
    path : the file
    is_changed : whether options of the command line change the file
    """

    path: Path
    is_changed: bool

    def __call__(self, mark: Mark) -> bool:
        """Whether the value at a place is inherited."""
        if mark.file.startswith(OPTIONS):
            return False
        return self.is_changed or mark.file != str(self.path)


def leave_out(draft: DraftConfig, claims: tuple[Claim, ...], before: int, inherited: Inherited) -> tuple[Claim, ...]:
    """Leave out inherited claims and figures that do not fit; the draft gets a line for each kind.

    It is that of the first point, and its claims and figures have been checked.  There is one claim for each of the
    draft that is valid in itself.  `before` is the number of problems before that check.  Claims with an error that is
    reported stay.
    """
    found: dict[tuple[str, int], Problem] = {}
    kept, settings = draft.problems[:before], list[Problem]()
    for problem in draft.problems[before:]:
        entry = _entry(draft, problem, inherited)
        if entry is not None:
            found.setdefault(entry, problem)
        elif _is_setting(draft, problem, inherited):
            settings.append(problem)
        else:
            kept.append(problem)
    draft.problems = kept
    _drop_entries(draft, settings)
    numbers = [number for number, keys in enumerate(draft.claims) if keys is not None]
    for section, number in found:
        (draft.claims if section == "claims" else draft.figures)[number] = None
    draft.left_out += _lines(draft, found)
    fitting = zip(numbers, claims, strict=True)
    return tuple(claim for number, claim in fitting if ("claims", number) not in found)


def _entry(draft: DraftConfig, problem: Problem, inherited: Inherited) -> tuple[str, int] | None:
    """Return the inherited claim or figure that a problem is about."""
    if not problem.path:
        return None
    section, *steps = split(problem.path, Mark(problem.file, problem.line, problem.column))
    if section not in ("claims", "figures") or not steps or not steps[0].isdigit():
        return None
    number = int(steps[0])
    return (section, number) if inherited(locate(draft.tree, [section, number])) else None


def _is_setting(draft: DraftConfig, problem: Problem, inherited: Inherited) -> bool:
    """Whether a problem is about an entry of an inherited list of methods, metrics or requirements."""
    steps = problem.path.split(".")
    return tuple(steps[:2]) in _LISTS and inherited(locate(draft.tree, steps))


def _drop_entries(draft: DraftConfig, problems: list[Problem]) -> None:
    """Drop entries of the lists under `report` and of the requirements."""
    gone: dict[tuple[str, str], set[str]] = {}
    for problem in problems:
        section, key, *rest = problem.path.split(".")
        given = draft.tree[section][key]
        gone.setdefault((section, key), set()).add(given[int(rest[0])] if rest else given)
        draft.left_out.append(f"{problem.path}: {problem.message}")
    for (section, key), names in gone.items():
        values = draft.values[section]
        given = getattr(values, key)
        kept = [name for name in ([given] if isinstance(given, str) else given) if name not in names]
        # Without any entry of its own, a list under `report` shows everything.
        draft.values[section] = replace(values, **{key: kept or None if section == "report" else kept})


def _lines(draft: DraftConfig, found: dict[tuple[str, int], Problem]) -> list[str]:
    """Say which figures and how many claims are left out, with the reason."""
    lines = [
        f"figure {_kind(draft, number)}: {problem.message}"
        for (section, number), problem in found.items()
        if section == "figures"
    ]
    of_claims = [problem for (section, _), problem in found.items() if section == "claims"]
    if of_claims:
        first = of_claims[0]
        n_all = len(draft.tree["claims"])
        line = f"{len(of_claims)} of {n_all} claims ({first.path}: {first.message}"
        lines.append(line + (f"; {len(of_claims) - 1} more)" if len(of_claims) > 1 else ")"))
    return lines


def _kind(draft: DraftConfig, number: int) -> str:
    figures = draft.tree.get("figures")
    given = figures[number] if isinstance(figures, Items) else draft.section("figures")[number]
    return str(given.get("kind", given.get("file", "?"))) if isinstance(given, Map) else str(given)


def fitting_metrics(tree: Map, problems: Sequence[Problem], inherited: Inherited) -> tuple[Map, list[str]]:
    """Leave out inherited metrics that cannot be computed, such as one of a window behind the end of a shorter run.

    Also return a line for each; none where no metric would be left.
    """
    given = tree.get("metrics")
    if not isinstance(given, Items):
        return tree, []
    found: dict[int, Problem] = {}
    for problem in problems:
        section, *steps = problem.path.split(".")
        if section == "metrics" and steps and steps[0].isdigit() and inherited(locate(given, [steps[0]])):
            found.setdefault(int(steps[0]), problem)
    kept = [number for number in range(len(given)) if number not in found]
    if not found or not kept:
        return tree, []
    result = tree.copy()
    marks = [locate(given, [number]) for number in kept]
    result["metrics"] = Items([given[number] for number in kept], mark=given.mark, value_marks=marks)
    return result, [f"metric {problem.path}: {problem.message}" for problem in found.values()]


def fitting_sweep(tree: Map, inherited: Inherited) -> tuple[Map, list[str]]:
    """Leave out inherited paths of the sweep into methods that do not exist any more; they change nothing else.

    Also return a line for all these paths.
    """
    sweep, methods = tree.get("sweep"), tree.get("methods")
    if not isinstance(sweep, Map) or not isinstance(methods, Map):
        return tree, []
    gone: dict[str, None] = {}

    def fitting(section: Any) -> Any:
        if not isinstance(section, Map):
            return section
        result = section.copy()
        for path in section:
            steps = path.split(".")
            if steps[0] == "methods" and len(steps) > 2 and inherited(locate(section, [path])):
                if split(path, section.mark)[1] not in methods:
                    del result[path]
                    gone[path] = None
        return result

    result, kept = tree.copy(), sweep.copy()
    result["sweep"] = kept
    for key in ("grid", "zip"):
        given = sweep.get(key)
        if isinstance(given, Items):
            marks = [locate(given, [number]) for number in range(len(given))]
            kept[key] = Items([fitting(row) for row in given], mark=given.mark, value_marks=marks)
        elif given is not None:
            kept[key] = fitting(given)
    return (result, [f"{SWEPT_PATHS}: {', '.join(gone)}"]) if gone else (tree, [])


def drop_statistics(draft: DraftConfig, inherited: Inherited) -> None:
    """Use the defaults for an inherited primary metric, baseline or margin that does not exist any more."""
    given, statistics = draft.tree.get("statistics"), draft.values["statistics"]
    if not isinstance(given, Map) or statistics is None:
        return
    known = {"primary": draft.metric_names, "baseline": [*draft.methods]}
    for key, names in known.items():
        value = getattr(statistics, key)
        if value is not None and names and value not in names and inherited(locate(given, [key])):
            statistics = replace(statistics, **{key: None})
            draft.left_out.append(f"statistics.{key}: {value} does not exist here; it is {names[0]} instead")
    if isinstance(statistics.relevant, dict):
        margins = given["relevant"]
        gone = [name for name in margins if name not in draft.metric_names and inherited(locate(margins, [name]))]
        rest = {name: value for name, value in statistics.relevant.items() if name not in gone}
        statistics = replace(statistics, relevant=rest)
        draft.left_out += [f"statistics.relevant.{name}: there is no such metric here" for name in gone]
    draft.values["statistics"] = statistics
