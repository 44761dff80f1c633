"""From the tree of a YAML to validated sections and parts; every mistake is noted, none stops the reading."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rmpc_bench import registry
from rmpc_bench.experiment import quantities
from rmpc_bench.experiment.parts import Part, read_part
from rmpc_bench.experiment.schema import shown, validate, with_quantities
from rmpc_bench.experiment.sections import SECTIONS, ClaimKeys
from rmpc_bench.experiment.yaml import Items, Map, join, locate, locate_key, merge
from rmpc_bench.simulation import distributions
from rmpc_bench.types import Matrix, NonNegative, Problem

_DISTRIBUTIONS: dict[str, type] = {
    "uniform": distributions.Uniform,
    "normal": distributions.Normal,
    "choice": distributions.Choice,
    "fixed": distributions.Fixed,
}


class Law(NamedTuple):
    """A noise law as configured: a registered kind, or the model's own noise times a scale."""

    part: Part | None
    same: float | None


class Change(NamedTuple):
    """What becomes of a plant parameter: a factor on its nominal value, or a value."""

    expression: quantities.Expression
    relative: bool
    problem_at: tuple[str, int, int]


@dataclass
class MethodParts:
    """The three parts of a method after the defaults have been merged in."""

    label: str
    model: Part | None
    estimator: Part | None
    controller: Part | None


@dataclass
class Sheet:
    """Everything a configuration says; None stands where it says something wrong."""

    tree: Map
    problems: list[Problem]
    values: dict[str, Any] = field(default_factory=dict)
    uncertainty: dict[str, distributions.Distribution] = field(default_factory=dict)
    changes: dict[str, Change] = field(default_factory=dict)
    plant: Part | None = None
    model: Part | None = None
    reference: Part | None = None
    noise: dict[str, Law] = field(default_factory=dict)
    initial: dict[str, Any] = field(default_factory=dict)
    methods: dict[str, MethodParts] = field(default_factory=dict)
    metrics: list[Part | None] = field(default_factory=list)
    figures: list[Part | None] = field(default_factory=list)
    claims: list[ClaimKeys | None] = field(default_factory=list)

    def note(self, path: list[str | int], message: str, *, key: bool = False) -> None:
        """Note a mistake at the value (or the key) of a path."""
        mark = (locate_key if key else locate)(self.tree, path)
        self.problems.append(Problem(*mark, join(path), message))

    def section(self, name: str) -> Any:
        """Part of the tree under a top-level key, or its default."""
        return self.tree[name] if name in self.tree else SECTIONS[name].default


def read(tree: Map) -> Sheet:
    """Read a whole configuration; mistakes are in ``problems`` of what is returned."""
    sheet = Sheet(tree, [])
    _top_level(sheet)
    _uncertainty(sheet)
    _plant(sheet)
    sheet.model = _part(sheet, "models", "model")
    sheet.reference = _part(sheet, "references", "reference")
    _noise(sheet)
    _initial(sheet)
    _methods(sheet)
    sheet.metrics = _named_parts(sheet, "metrics")
    sheet.figures = _named_parts(sheet, "figures")
    _claims(sheet)
    return sheet


def _top_level(sheet: Sheet) -> None:
    for name in sheet.tree:
        if name not in SECTIONS:
            sheet.note([name], registry.unknown(name, SECTIONS, "key"), key=True)
    for name, (annotation, default) in SECTIONS.items():
        if name in sheet.tree:
            sheet.values[name] = _checked(sheet, annotation, [name])
        elif default is ...:
            sheet.note([], f"{name!r} is missing")
            sheet.values[name] = None
        else:
            sheet.values[name] = default


def _checked(sheet: Sheet, annotation: Any, path: list[str | int]) -> Any:
    """Validate the value at a path; a scalar is wrapped so that messages find its place."""
    parent: Any = sheet.tree
    for step in path[:-1]:
        parent = parent[step]
    value, before = parent[path[-1]], len(sheet.problems)
    result = validate(with_quantities(annotation), value, path, sheet.problems)
    if not isinstance(value, Map | Items):
        mark = locate(sheet.tree, path)
        sheet.problems[before:] = [Problem(*mark, join(path), problem.message) for problem in sheet.problems[before:]]
    return result


def _uncertainty(sheet: Sheet) -> None:
    for name, value in (sheet.values["uncertainty"] or {}).items():
        path: list[str | int] = ["uncertainty", name]
        if not re.fullmatch(r"[A-Za-z_]\w*", name):
            sheet.note(path, "a name starts with a letter and goes on with letters, digits and _", key=True)
        law = _distribution(sheet, value, path)
        if law is not None:
            sheet.uncertainty[name] = law


def _distribution(sheet: Sheet, value: Any, path: list[str | int]) -> distributions.Distribution | None:
    if isinstance(value, Map):
        kind = value.get("dist")
        if kind not in _DISTRIBUTIONS:
            sheet.note([*path, "dist"], registry.unknown(str(kind), _DISTRIBUTIONS, "distribution"))
            return None
        own = value.copy()
        del own["dist"]
        law: distributions.Distribution | None = validate(
            with_quantities(_DISTRIBUTIONS[kind]), own, path, sheet.problems
        )
        return law
    try:
        spread = quantities.spread(value) if isinstance(value, str) else None
    except quantities.QuantityError as error:
        sheet.note(path, str(error))
        return None
    if spread is None:
        choices = ", ".join(_DISTRIBUTIONS)
        sheet.note(path, f"expected a spread such as +-10% or {{dist: ..}} with one of {choices} (got {shown(value)})")
        return None
    return distributions.Uniform(-spread, spread)


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


def _noise(sheet: Sheet) -> None:
    noise = sheet.section("noise")
    if not isinstance(noise, Map):
        noise = {"process": noise, "measurement": noise}
        paths: dict[str, list[str | int]] = {name: ["noise"] for name in noise}
    else:
        paths = {name: ["noise", name] for name in noise}
    for name, law in noise.items():
        if name not in ("process", "measurement"):
            sheet.note(paths[name], registry.unknown(name, ("process", "measurement"), "key"), key=True)
        else:
            read_law = _law(sheet, law, paths[name])
            if read_law is not None:
                sheet.noise[name] = read_law


def _law(sheet: Sheet, law: Any, path: list[str | int]) -> Law | None:
    """Read one noise law; None for `none` and for a law that is not one."""
    if law == "none":
        return None
    if law == "same":
        return Law(None, 1.0)
    known = ("none", "same", *registry.names("noises"))
    if not isinstance(law, Map) or len(law) != 1 or next(iter(law)) not in known[1:]:
        named = next(iter(law)) if isinstance(law, Map) and len(law) == 1 else law
        text = named if isinstance(named, str) else shown(law)
        sheet.note(path, registry.unknown(text, known, "noise law", "rmpc-bench list noises"))
        return None
    kind, value = next(iter(law.items()))
    if kind == "same":
        scale = validate(with_quantities(dict[str, NonNegative]), value, [*path, kind], sheet.problems)
        if scale is not None and set(scale) - {"scale"}:
            sheet.note([*path, kind], "the only key is 'scale'")
        return None if scale is None else Law(None, scale.get("scale", 1.0))
    part = read_part("noises", value, [*path, kind], sheet.problems, mark=locate(sheet.tree, path), kind=kind)
    return None if part is None else Law(part, None)


_Vector = float | list[float]
_INITIAL: Mapping[str, Any] = {"x": _Vector, "x_hat": _Vector, "P": Matrix}


def _initial(sheet: Sheet) -> None:
    initial = sheet.values["initial"] or {}
    sheet.initial = {"x": 0.0, "x_hat": 0.0, "P": "process", "law": None}
    for name, value in initial.items():
        path: list[str | int] = ["initial", name]
        if name not in _INITIAL:
            sheet.note(path, registry.unknown(name, _INITIAL, "key"), key=True)
        elif name == "x" and isinstance(value, Map):
            sheet.initial["law"] = _law(sheet, value, path)
        elif name != "P" or value != "process":
            sheet.initial[name] = _checked(sheet, _INITIAL[name], path)


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
        sheet.methods[name] = MethodParts(str(label), **parts)


def _method_part(sheet: Sheet, own: Map, key: str, path: list[str | int]) -> Part | None:
    """Merge a method's part over the default of all methods and validate it."""
    if key not in own and key == "model":
        return sheet.model
    default = sheet.tree.get(key)
    tree = own.get(key, default)
    if tree is None:
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
        sheet.claims.append(_checked(sheet, ClaimKeys, ["claims", number]))


def at_their_origin(sheet: Sheet) -> list[Problem]:
    """Let a mistake in a default speak of the default, and once, not of every method that inherits it."""
    paths: dict[tuple[str, int, int], str] = {}

    def visit(node: Any, path: list[str | int]) -> None:
        children = node.items() if isinstance(node, Map) else enumerate(node) if isinstance(node, Items) else ()
        for step, child in children:
            paths.setdefault(locate(sheet.tree, [*path, step]), join([*path, step]))
            visit(child, [*path, step])

    for default in ("model", "estimator", "controller"):
        if default in sheet.tree:
            paths[locate(sheet.tree, [default])] = default
            visit(sheet.tree[default], [default])
    moved = []
    for problem in sheet.problems:
        inherited = problem.path.startswith("methods.")
        path = paths.get((problem.file, problem.line, problem.column), problem.path) if inherited else problem.path
        moved.append(Problem(problem.file, problem.line, problem.column, path, problem.message))
    return moved
