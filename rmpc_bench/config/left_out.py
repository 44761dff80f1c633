"""What is inherited and does not fit is left out and named, and an error in an inherited value is reported once.

A claim about a method that was overridden away, or a figure of a metric that is not computed, is no mistake of the
user.  What the override or the extending file itself says is checked as ever.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rmpc_bench.claims.claim import FINDINGS, Claim
from rmpc_bench.config.draft import DraftConfig, Inherited
from rmpc_bench.config_file.method_grid import GRID
from rmpc_bench.config_file.tree import Items, Map, Problems, join, locate, locate_key, split
from rmpc_bench.config_file.yaml import load
from rmpc_bench.received.plain_files import text_of
from rmpc_bench.types import ConfigError, Problem

SWEPT_PATHS = "paths of the sweep into methods that do not exist here"
"""Beginning of the line that names paths which are left out of a sweep."""
_LISTS = (("report", "order"), ("report", "metrics"), ("statistics", "requirement"))
"""Settings that are lists of names, or of texts with names."""


def leave_out(
    draft: DraftConfig, claims: tuple[Claim, ...], problems: Problems
) -> tuple[DraftConfig, tuple[Claim, ...]]:
    """Return a checked draft and its claims without claims, figures and names that are inherited and do not fit.

    The draft gets a line for each of these.  Its other problems are added to the given ones, which are its own then.
    There is one claim for each of the draft that is valid in itself; claims with an error that is reported stay.
    """
    found: dict[str, dict[int, Problem]] = {"claims": {}, "figures": {}}
    settings = list[Problem]()
    for problem in draft.problems:
        steps, (section, number) = problem.path.split("."), _entry(problem)
        if number is not None and section in found and draft.is_inherited([section, number]):
            found[section].setdefault(number, problem)
        elif tuple(steps[:2]) in _LISTS and draft.is_inherited(steps):
            settings.append(problem)
        else:
            problems.append(problem)
    draft = _without_entries(draft, settings)
    draft.left_out.extend(_lines(draft, **found))
    numbers = [number for number, keys in enumerate(draft.claims) if keys is not None]
    claims = tuple(claim for number, claim in zip(numbers, claims, strict=True) if number not in found["claims"])
    kept = [None if number in found["claims"] else keys for number, keys in enumerate(draft.claims)]
    figures = [None if number in found["figures"] else each for number, each in enumerate(draft.figures)]
    return replace(draft, claims=kept, figures=figures, problems=problems), claims


def _entry(problem: Problem) -> tuple[str, int | None]:
    """Return the section that a problem is about, and the position of the entry of its list."""
    section, *steps = problem.path.split(".")
    return section, int(steps[0]) if steps and steps[0].isdigit() else None


def _without_entries(draft: DraftConfig, problems: list[Problem]) -> DraftConfig:
    """Return a draft without entries of the lists under `report` and of the requirements."""
    gone: dict[tuple[str, str], set[str]] = {}
    for problem in problems:
        section, key, *rest = problem.path.split(".")
        given = draft.tree[section][key]
        gone.setdefault((section, key), set()).add(given[int(rest[0])] if rest else given)
        draft.left_out.append(f"{problem.path}: {problem.message}")
    for (section, key), names in gone.items():
        values = getattr(draft.keys, section)
        if values is None:
            # Another key of the section is invalid, which is an error.
            continue
        given = getattr(values, key)
        kept = [name for name in ([given] if isinstance(given, str) else given) if name not in names]
        # Without any entry of its own, a list under `report` shows everything.
        changed = replace(values, **{key: kept or None if section == "report" else kept})
        draft = draft.with_keys(**{section: changed})
    return draft


def _lines(draft: DraftConfig, claims: Mapping[int, Problem], figures: Mapping[int, Problem]) -> list[str]:
    """Say which figures and how many claims are left out, with the reason."""
    lines = [f"figure {_kind(draft, number)}: {problem.message}" for number, problem in figures.items()]
    if claims:
        first, *others = claims.values()
        line = f"{len(claims)} of {len(draft.tree['claims'])} claims ({first.path}: {first.message}"
        lines.append(line + (f"; {len(others)} more)" if others else ")"))
    return lines


def _kind(draft: DraftConfig, number: int) -> str:
    figures = draft.tree.get("figures")
    given = figures[number] if isinstance(figures, Items) else draft.section("figures")[number]
    return str(given.get("kind", given.get("file", "?"))) if isinstance(given, Map) else str(given)


def fitting_metrics(tree: Map, problems: Sequence[Problem], inherited: Inherited) -> tuple[Map, list[str]]:
    """Leave out inherited metrics that cannot be computed, unless none would be left; also return a line for each."""
    given = tree.get("metrics")
    if not isinstance(given, Items):
        return tree, []
    found: dict[int, Problem] = {}
    for problem in problems:
        section, number = _entry(problem)
        if section == "metrics" and number is not None and inherited(locate(given, [number])):
            found.setdefault(number, problem)
    kept = [number for number in range(len(given)) if number not in found]
    if not found or not kept:
        return tree, []
    result = tree.copy()
    marks = [locate(given, [number]) for number in kept]
    result["metrics"] = Items([given[number] for number in kept], mark=given.mark, value_marks=marks)
    return result, [f"metric {problem.path}: {problem.message}" for problem in found.values()]


def fitting_sweep(tree: Map, inherited: Inherited) -> tuple[Map, list[str]]:
    """Leave out inherited swept paths into methods that are gone; they change nothing else.  Also return a line."""
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
            kept[key] = given.like(fitting(row) for row in given)
        elif given is not None:
            kept[key] = fitting(given)
    return (result, [f"{SWEPT_PATHS}: {', '.join(gone)}"]) if gone else (tree, [])


def with_findings(path: Path, draft: DraftConfig) -> DraftConfig:
    """Return a draft in which claims with an `id` have the findings that other configurations record for the same `id`.

    A claim that has the key `elsewhere`, as in config.resolved.yaml, keeps it: the results of an experiment do not need
    the other files.  A claim whose `id` is given twice is a problem of the draft.
    """
    seen: dict[str, int] = {}
    open_ids = set()
    for number, keys in enumerate(draft.claims):
        if keys is None or keys.id is None:
            continue
        if keys.id in seen:
            message = f"is that of claim {seen[keys.id] + 1}, too; a statement has one claim"
            draft.note(["claims", number, "id"], message)
        seen.setdefault(keys.id, number)
        if keys.elsewhere is None:
            open_ids.add(keys.id)
    paper, claims = draft.keys.paper, [*draft.claims]
    found = _findings(path, paper, open_ids) if open_ids and paper else {}
    for number, keys in enumerate(claims):
        if keys is not None and keys.id in open_ids:
            elsewhere = {name: each[keys.id] for name, each in found.items() if keys.id in each}
            claims[number] = replace(keys, elsewhere=elsewhere)
    return replace(draft, claims=claims)


def _findings(path: Path, paper: str, ids: set[str]) -> dict[str, dict[str, str]]:
    """Read configuration -> id -> recorded finding from the other files of the folder."""
    found = {}
    for other in sorted(path.parent.glob("*.yaml")):
        if other.resolve() == path.resolve():
            continue
        try:
            text = text_of(other)
            # Reading YAML takes ten times as long as looking for a name in its text.
            tree = load(other) if any(name in text for name in ids) else None
        except (OSError, UnicodeDecodeError, ConfigError):
            # The file has its own errors, which `check` reports for it.
            continue
        if isinstance(tree, Map) and tree.get("paper") == paper:
            found[str(tree.get("name", other.stem))] = _recorded(tree.get("claims"), ids)
    return found


def _recorded(claims: Any, ids: set[str]) -> dict[str, str]:
    entries: Sequence[Any] = claims if isinstance(claims, list) else ()
    named = [entry for entry in entries if isinstance(entry, Map) and entry.get("id") in ids]
    return {entry["id"]: entry["finding"] for entry in named if entry.get("finding") in FINDINGS}


def problems_at_origin(draft: DraftConfig, given: Map) -> list[Problem]:
    """Return the problems of a checked draft, each at the path where its value is written; `given` has the grid.

    An error in a default, or in an entry of a grid, is reported once, there, not for every method that has it.  An
    error in the plant is reported at the plant, not at the model that comes from it.
    """
    paths: dict[tuple[str, int, int], list[str]] = {}

    def visit(tree: Map, path: list[str | int], node: Any) -> None:
        for mark in (locate(tree, path), locate_key(tree, path)):
            paths.setdefault(mark, []).append(join(path))
        children = node.items() if isinstance(node, Map) else enumerate(node) if isinstance(node, Items) else ()
        for step, child in children:
            visit(tree, [*path, step], child)

    for default in ("model", "estimator", "controller"):
        if default in draft.tree:
            visit(draft.tree, [default], draft.tree[default])
    methods = given.get("methods")
    if isinstance(methods, Map) and GRID in methods:
        visit(given, ["methods", GRID], methods[GRID])
    of_plant = {replace(problem, path="") for problem in draft.problems if problem.path.startswith("plant.")}
    return [
        _moved(problem, paths)
        for problem in draft.problems
        if problem.path.startswith("plant.") or replace(problem, path="") not in of_plant
    ]


def _moved(problem: Problem, paths: dict[tuple[str, int, int], list[str]]) -> Problem:
    here = paths.get((problem.file, problem.line, problem.column), [])
    if not problem.path.startswith("methods.") or not here:
        return problem
    # A block mapping has the same place as its first key; the last step of the path distinguishes the two.
    last = problem.path.split(".")[-1]
    path = next((path for path in here if path.split(".")[-1] == last), here[0])
    return replace(problem, path=path)
