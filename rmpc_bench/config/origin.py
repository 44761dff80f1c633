"""Reports an error in an inherited value once, where the value is written."""

from __future__ import annotations

from typing import Any

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.tree import Items, Map, join, locate, locate_key
from rmpc_bench.types import Problem


def problems_at_origin(draft: DraftConfig) -> list[Problem]:
    """Return the problems of a checked draft, each at the path where its value is written.

    An error in a default is reported once, at the default, not for every method that inherits it.  An error in the
    plant is reported at the plant, not at the model that comes from it.
    """
    paths: dict[tuple[str, int, int], list[str]] = {}

    def visit(path: list[str | int], node: Any) -> None:
        for mark in (locate(draft.tree, path), locate_key(draft.tree, path)):
            paths.setdefault(mark, []).append(join(path))
        children = node.items() if isinstance(node, Map) else enumerate(node) if isinstance(node, Items) else ()
        for step, child in children:
            visit([*path, step], child)

    for default in ("model", "estimator", "controller"):
        if default in draft.tree:
            visit([default], draft.tree[default])
    of_plant = {_without_path(problem) for problem in draft.problems if problem.path.startswith("plant.")}
    return [
        _moved(problem, paths)
        for problem in draft.problems
        if problem.path.startswith("plant.") or _without_path(problem) not in of_plant
    ]


def _without_path(problem: Problem) -> tuple[str, int, int, str]:
    return problem.file, problem.line, problem.column, problem.message


def _moved(problem: Problem, paths: dict[tuple[str, int, int], list[str]]) -> Problem:
    here = paths.get((problem.file, problem.line, problem.column), [])
    if not problem.path.startswith("methods.") or not here:
        return problem
    # A block mapping has the same place as its first key; the last step of the path distinguishes the two.
    last = problem.path.split(".")[-1]
    path = next((path for path in here if path.split(".")[-1] == last), here[0])
    return Problem(problem.file, problem.line, problem.column, path, problem.message)
