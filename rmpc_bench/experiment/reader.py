"""From the tree of a YAML to validated sections and parts; every mistake is noted, none stops the reading."""

from __future__ import annotations

import re
from typing import Any

from rmpc_bench import registry
from rmpc_bench.experiment import quantities
from rmpc_bench.experiment.laws import read_initial, read_noise, read_uncertainty
from rmpc_bench.experiment.parts import Part, read_part
from rmpc_bench.experiment.schema import shown
from rmpc_bench.experiment.sections import SECTIONS, ClaimKeys
from rmpc_bench.experiment.sheet import Change, MethodParts, Sheet
from rmpc_bench.experiment.yaml import Items, Map, join, locate, locate_key, merge
from rmpc_bench.types import Problem


def read(tree: Map) -> Sheet:
    """Read a whole configuration; mistakes are in ``problems`` of what is returned."""
    sheet = Sheet(tree, [])
    _top_level(sheet)
    read_uncertainty(sheet)
    _plant(sheet)
    sheet.model = _part(sheet, "models", "model")
    sheet.reference = _part(sheet, "references", "reference")
    read_noise(sheet)
    read_initial(sheet)
    _methods(sheet)
    sheet.metrics = _named_parts(sheet, "metrics")
    if "figures" in tree or "runs" in sheet.values["evaluate"]:  # without runs there is nothing for the usual boxplot
        sheet.figures = _named_parts(sheet, "figures")
    _claims(sheet)
    return sheet


def _top_level(sheet: Sheet) -> None:
    for name in sheet.tree:
        if name not in SECTIONS:
            sheet.note([name], registry.unknown(name, SECTIONS, "key"), key=True)
    for name, (annotation, default) in SECTIONS.items():
        if name in sheet.tree:
            sheet.values[name] = sheet.checked(annotation, [name])
        elif default is ...:
            sheet.note([], f"{name!r} is missing")
            sheet.values[name] = None
        else:
            sheet.values[name] = default
    evaluate = sheet.values["evaluate"]
    sheet.values["evaluate"] = [evaluate] if isinstance(evaluate, str) else [*dict.fromkeys(evaluate or ["runs"])]


def _part(sheet: Sheet, group: str, name: str, ignore: tuple[str, ...] = ()) -> Part | None:
    tree = sheet.section(name)
    if name not in sheet.tree:
        if tree is ...:
            return None  # noted as missing already
        tree = Map(tree, mark=sheet.tree.mark)
    if not isinstance(tree, Map):
        return None  # noted by its annotation already
    return read_part(group, tree, [name], sheet.problems, mark=locate(sheet.tree, [name]), ignore=ignore)


def _plant(sheet: Sheet) -> None:
    sheet.plant = _part(sheet, "plants", "plant", ignore=("perturb", "set"))
    tree = sheet.tree.get("plant")
    if not isinstance(tree, Map):
        return
    for key, relative in (("perturb", True), ("set", False)):
        entries = tree.get(key, {})
        if not isinstance(entries, dict):
            sheet.note(["plant", key], f"must be a mapping (got {shown(entries)})")
            continue
        for name, text in entries.items():
            path: list[str | int] = ["plant", key, name]
            if name in sheet.changes:
                sheet.note(path, "is already changed by perturb; give one of the two", key=True)
            try:
                expression = quantities.parse(text, sheet.values["uncertainty"] or {})
            except quantities.QuantityError as error:
                sheet.note(path, str(error))
                continue
            sheet.changes[name] = Change(expression, relative, locate_key(sheet.tree, path))
            if not expression.names:
                _probe(sheet, expression, path)


def _probe(sheet: Sheet, expression: quantities.Expression, path: list[str | int]) -> None:
    """Evaluate what is the same in every run, so that it fails now if it fails at all."""
    try:
        expression()
    except quantities.QuantityError as error:
        sheet.note(path, str(error))


def _methods(sheet: Sheet) -> None:
    methods = sheet.values["methods"]
    if methods is not None and not methods:
        sheet.note(["methods"], "there must be at least one method")
    for name, own in (methods or {}).items():
        path: list[str | int] = ["methods", name]
        if not name.strip() or re.search(r"[\[\],\n]", name):
            sheet.note(path, "a method's name must not be empty or contain brackets, commas or line ends", key=True)
        if own is None:
            own = Map(mark=locate_key(sheet.tree, path))
        if not isinstance(own, Map):
            sheet.note(path, f"must be a mapping (got {shown(own)})")
            continue
        known = ("model", "estimator", "controller", "label")
        for key in own:
            if key not in known:
                sheet.note([*path, key], registry.unknown(key, known, "key"), key=True)
        label = own.get("label", name)
        if not isinstance(label, str):
            sheet.note([*path, "label"], f"must be text (got {shown(label)})")
        parts = {key: _method_part(sheet, own, key, path) for key in ("model", "estimator", "controller")}
        controlled = own.get("controller", sheet.tree.get("controller")) is not None
        sheet.methods[name] = MethodParts(str(label), **parts, controlled=controlled)


def _method_part(sheet: Sheet, own: Map, key: str, path: list[str | int]) -> Part | None:
    """Merge a method's part over the default of all methods and validate it."""
    if key not in own and key == "model":
        return sheet.model
    default = sheet.tree.get(key)
    tree = own.get(key, default)
    if tree is None:
        others = [other for other in sheet.values["methods"].values() if isinstance(other, Map) and key in other]
        if key != "controller" or others:  # without any controller the plant is left alone
            sheet.note(path, f"{key!r} is missing, here and as a default of all methods")
        return None
    if isinstance(tree, Map) and isinstance(default, Map) and tree is not default:
        tree = merge(default, tree)
    mark = own.value_marks.get(key, own.mark)
    if not isinstance(tree, Map) and key not in own:
        return None  # noted by its annotation already
    return read_part(key + "s", tree, [*path, key], sheet.problems, mark=mark)


def _named_parts(sheet: Sheet, group: str) -> list[Part | None]:
    """Read a list whose entries are names or mappings with a `kind`."""
    parts: list[Part | None] = []
    entries = sheet.section(group)
    if group == "metrics" and isinstance(entries, list) and not entries:
        sheet.note([group], "there must be at least one metric")
    for number, entry in enumerate(entries if isinstance(entries, list) else []):
        path: list[str | int] = [group, number]
        mark = locate(sheet.tree, path)
        if isinstance(entry, str):
            if entry in registry.names(group):
                tree = Map(mark=type(sheet.tree.mark)(*mark))
                parts.append(read_part(group, tree, path, sheet.problems, mark=mark, kind=entry))
            else:
                noun, way_out = registry.singular(group), f"rmpc-bench list {group}"
                sheet.note(path, registry.unknown(entry, registry.names(group), noun, way_out))
        else:
            parts.append(read_part(group, entry, path, sheet.problems, mark=mark))
    return parts


def _claims(sheet: Sheet) -> None:
    for number, _ in enumerate(sheet.values["claims"] or []):
        sheet.claims.append(sheet.checked(ClaimKeys, ["claims", number]))


def at_their_origin(sheet: Sheet) -> list[Problem]:
    """Let a mistake in a default speak of the default, and once, not of every method that inherits it.

    One in the plant speaks of the plant, not of the model that comes from it.
    """
    paths: dict[tuple[str, int, int], list[str]] = {}

    def visit(path: list[str | int], node: Any) -> None:
        for mark in (locate(sheet.tree, path), locate_key(sheet.tree, path)):
            paths.setdefault(mark, []).append(join(path))
        children = node.items() if isinstance(node, Map) else enumerate(node) if isinstance(node, Items) else ()
        for step, child in children:
            visit([*path, step], child)

    for default in ("model", "estimator", "controller"):
        if default in sheet.tree:
            visit([default], sheet.tree[default])
    of_plant = {_without_path(problem) for problem in sheet.problems if problem.path.startswith("plant.")}
    return [
        _moved(problem, paths)
        for problem in sheet.problems
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
