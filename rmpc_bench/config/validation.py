"""From the tree of a YAML to validated sections and parts; every mistake is noted, none stops the reading."""

from __future__ import annotations

import re
from typing import Any

from rmpc_bench import registry
from rmpc_bench.config.component import Component, read_component
from rmpc_bench.config.draft import Change, DraftConfig, MethodComponents
from rmpc_bench.config.noise_section import read_initial, read_noise, read_uncertainty
from rmpc_bench.config.reader import Items, Map, join, locate, locate_key, merge
from rmpc_bench.config.schema import shown
from rmpc_bench.config.sections import SECTIONS, ClaimKeys
from rmpc_bench.expressions import quantity
from rmpc_bench.types import Problem


def read(tree: Map) -> DraftConfig:
    """Read a whole configuration; mistakes are in ``problems`` of what is returned."""
    draft = DraftConfig(tree, [])
    _top_level(draft)
    read_uncertainty(draft)
    _plant(draft)
    draft.model = _part(draft, "models", "model")
    draft.reference = _part(draft, "references", "reference")
    read_noise(draft)
    read_initial(draft)
    _methods(draft)
    draft.metrics = _named_parts(draft, "metrics")
    if "figures" in tree or "runs" in draft.values["evaluate"]:  # without runs there is nothing for the usual boxplot
        draft.figures = _named_parts(draft, "figures")
    _claims(draft)
    return draft


def _top_level(draft: DraftConfig) -> None:
    for name in draft.tree:
        if name not in SECTIONS:
            draft.note([name], registry.unknown(name, SECTIONS, "key"), key=True)
    for name, (annotation, default) in SECTIONS.items():
        if name in draft.tree:
            draft.values[name] = draft.checked(annotation, [name])
        elif default is ...:
            draft.note([], f"{name!r} is missing")
            draft.values[name] = None
        else:
            draft.values[name] = default
    evaluate = draft.values["evaluate"]
    draft.values["evaluate"] = [evaluate] if isinstance(evaluate, str) else [*dict.fromkeys(evaluate or ["runs"])]


def _part(draft: DraftConfig, group: str, name: str, ignore: tuple[str, ...] = ()) -> Component | None:
    tree = draft.section(name)
    if name not in draft.tree:
        if tree is ...:
            return None  # noted as missing already
        tree = Map(tree, mark=draft.tree.mark)
    if not isinstance(tree, Map):
        return None  # noted by its annotation already
    return read_component(group, tree, [name], draft.problems, mark=locate(draft.tree, [name]), ignore=ignore)


def _plant(draft: DraftConfig) -> None:
    draft.plant = _part(draft, "plants", "plant", ignore=("perturb", "set"))
    tree = draft.tree.get("plant")
    if not isinstance(tree, Map):
        return
    for key, relative in (("perturb", True), ("set", False)):
        entries = tree.get(key, {})
        if not isinstance(entries, dict):
            draft.note(["plant", key], f"must be a mapping (got {shown(entries)})")
            continue
        for name, text in entries.items():
            path: list[str | int] = ["plant", key, name]
            if name in draft.changes:
                draft.note(path, "is already changed by perturb; give one of the two", key=True)
            try:
                expression = quantity.parse(text, draft.values["uncertainty"] or {})
            except quantity.QuantityError as error:
                draft.note(path, str(error))
                continue
            draft.changes[name] = Change(expression, relative, locate_key(draft.tree, path))
            if not expression.names:
                _probe(draft, expression, path)


def _probe(draft: DraftConfig, expression: quantity.Expression, path: list[str | int]) -> None:
    """Evaluate what is the same in every run, so that it fails now if it fails at all."""
    try:
        expression()
    except quantity.QuantityError as error:
        draft.note(path, str(error))


def _methods(draft: DraftConfig) -> None:
    methods = draft.values["methods"]
    if methods is not None and not methods:
        draft.note(["methods"], "there must be at least one method")
    for name, own in (methods or {}).items():
        path: list[str | int] = ["methods", name]
        if not name.strip() or re.search(r"[\[\],\n]", name):
            draft.note(path, "a method's name must not be empty or contain brackets, commas or line ends", key=True)
        if own is None:
            own = Map(mark=locate_key(draft.tree, path))
        if not isinstance(own, Map):
            draft.note(path, f"must be a mapping (got {shown(own)})")
            continue
        known = ("model", "estimator", "controller", "label")
        for key in own:
            if key not in known:
                draft.note([*path, key], registry.unknown(key, known, "key"), key=True)
        label = own.get("label", name)
        if not isinstance(label, str):
            draft.note([*path, "label"], f"must be text (got {shown(label)})")
        parts = {key: _method_part(draft, own, key, path) for key in ("model", "estimator", "controller")}
        controlled = own.get("controller", draft.tree.get("controller")) is not None
        draft.methods[name] = MethodComponents(str(label), **parts, controlled=controlled)


def _method_part(draft: DraftConfig, own: Map, key: str, path: list[str | int]) -> Component | None:
    """Merge a method's part over the default of all methods and validate it."""
    if key not in own and key == "model":
        return draft.model
    default = draft.tree.get(key)
    tree = own.get(key, default)
    if tree is None:
        others = [other for other in draft.values["methods"].values() if isinstance(other, Map) and key in other]
        if key != "controller" or others:  # without any controller the plant is left alone
            draft.note(path, f"{key!r} is missing, here and as a default of all methods")
        return None
    if isinstance(tree, Map) and isinstance(default, Map) and tree is not default:
        tree = merge(default, tree)
    mark = own.value_marks.get(key, own.mark)
    if not isinstance(tree, Map) and key not in own:
        return None  # noted by its annotation already
    return read_component(key + "s", tree, [*path, key], draft.problems, mark=mark)


def _named_parts(draft: DraftConfig, group: str) -> list[Component | None]:
    """Read a list whose entries are names or mappings with a `kind`."""
    parts: list[Component | None] = []
    entries = draft.section(group)
    if group == "metrics" and isinstance(entries, list) and not entries:
        draft.note([group], "there must be at least one metric")
    for number, entry in enumerate(entries if isinstance(entries, list) else []):
        path: list[str | int] = [group, number]
        mark = locate(draft.tree, path)
        if isinstance(entry, str):
            if entry in registry.names(group):
                tree = Map(mark=type(draft.tree.mark)(*mark))
                parts.append(read_component(group, tree, path, draft.problems, mark=mark, kind=entry))
            else:
                noun, way_out = registry.singular(group), f"rmpc-bench list {group}"
                draft.note(path, registry.unknown(entry, registry.names(group), noun, way_out))
        else:
            parts.append(read_component(group, entry, path, draft.problems, mark=mark))
    return parts


def _claims(draft: DraftConfig) -> None:
    for number, _ in enumerate(draft.values["claims"] or []):
        draft.claims.append(draft.checked(ClaimKeys, ["claims", number]))


def at_their_origin(draft: DraftConfig) -> list[Problem]:
    """Let a mistake in a default speak of the default, and once, not of every method that inherits it.

    One in the plant speaks of the plant, not of the model that comes from it.
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
    # A block mapping begins where its first key does: the last step tells which of the two is meant.
    last = problem.path.split(".")[-1]
    path = next((path for path in here if path.split(".")[-1] == last), here[0])
    return Problem(problem.file, problem.line, problem.column, path, problem.message)
