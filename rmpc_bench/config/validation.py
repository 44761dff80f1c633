"""Stage 4, validate: from the tree of every point to its sections and components.

Every section is validated on its own: an error is added to the problems of the draft, and the next section follows.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from rmpc_bench import registry
from rmpc_bench.components.code import is_reference
from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.config import plant_range
from rmpc_bench.config.component import Component, read_component
from rmpc_bench.config.draft import DraftConfig, MethodComponents, ParameterChange
from rmpc_bench.config.key_errors import shown
from rmpc_bench.config.noise_section import read_initial, read_noise, read_uncertainty, uncertain_names
from rmpc_bench.config.recorded_data import refuse_sections
from rmpc_bench.config.required_libraries import check_required
from rmpc_bench.config.sections import SECTIONS, ClaimKeys, Time
from rmpc_bench.config.short_forms import with_kind
from rmpc_bench.config.stop_checks import apply_stop
from rmpc_bench.config.sweep import SweptTree
from rmpc_bench.config.tree import Map, locate, locate_key, merge
from rmpc_bench.expressions import quantity


def validate_sections(
    points: Sequence[SweptTree], *, runs: int | None, smoke: bool, access: CodeAccess = NO_ACCESS
) -> list[DraftConfig]:
    """Return the sections of every point, with the problems that were found in them.

    Figures and claims are the same at all points and are read at the first.

    Parameters
    ----------
    points : trees of the points of a sweep
    runs : number of runs instead of the one given
    smoke : whether to reduce runs and steps to the size under ``smoke``
    access : which files of the user may be loaded
    """
    drafts: list[DraftConfig] = []
    for point in points:
        draft = _sections(point, access, first=not drafts)
        if runs is not None:
            draft.values["runs"] = runs
        apply_stop(draft, fixed=smoke or runs is not None)
        if smoke:
            _shrink(draft, drafts[0].values["time"] if drafts else None)
        drafts.append(draft)
    return drafts


def _sections(point: SweptTree, access: CodeAccess, *, first: bool) -> DraftConfig:
    tree = point.tree
    if not first:
        tree = tree.copy()
        for key in ("claims", "figures"):
            tree.pop(key, None)
    draft = DraftConfig(tree, [], point.coordinates, point.title, access)
    _top_level(draft)
    check_required(draft)
    read_uncertainty(draft)
    _plant(draft)
    draft.model = _component(draft, "models", "model")
    draft.reference = _component(draft, "references", "reference")
    _input(draft)
    read_noise(draft)
    read_initial(draft)
    _methods(draft)
    refuse_sections(draft)
    draft.metrics = _named_components(draft, "metrics")
    # The default figure, a boxplot, needs runs.
    if "figures" in tree or "runs" in draft.values["evaluate"]:
        draft.figures = _named_components(draft, "figures")
    _claims(draft)
    return draft


def _shrink(draft: DraftConfig, first: Time | None) -> None:
    """Take the size of a smoke run where it is smaller.

    Parameters
    ----------
    draft : gets the smaller size
    first : time of the first point; points with another step keep its duration
    """
    size, values = draft.values["smoke"], draft.values
    if size is not None and values["runs"] is not None and values["time"] is not None:
        time = values["time"]
        values["runs"] = min(values["runs"], size.runs)
        n_steps = min(time.n_steps, size.steps)
        if first is not None and first.duration is not None:
            n_steps = max(1, round(first.duration / time.step))
        # Windows are given in the unit of the time, so a time in seconds stays one in seconds.
        length = {"duration": n_steps * time.step} if time.duration is not None else {"steps": n_steps}
        values["time"] = type(time)(step=time.step, **length)


def _top_level(draft: DraftConfig) -> None:
    for name in draft.tree:
        if name not in SECTIONS:
            draft.note([name], registry.unknown(name, SECTIONS, "key"), key=True)
    for name, (annotation, default, _) in SECTIONS.items():
        if name in draft.tree:
            draft.values[name] = draft.checked(annotation, [name])
        elif default is ...:
            draft.note([], f"{name!r} is missing")
            draft.values[name] = None
        else:
            draft.values[name] = default
    evaluate = draft.values["evaluate"]
    draft.values["evaluate"] = [evaluate] if isinstance(evaluate, str) else [*dict.fromkeys(evaluate or ["runs"])]


def _component(draft: DraftConfig, group: str, name: str, ignore: tuple[str, ...] = ()) -> Component | None:
    tree = draft.section(name)
    if name not in draft.tree:
        if tree is ...:
            return None
        tree = Map(tree, mark=draft.tree.mark)
    if not isinstance(tree, Map):
        return None
    mark = locate(draft.tree, [name])
    return read_component(group, tree, [name], draft.problems, mark=mark, ignore=ignore, access=draft.access)


def _plant(draft: DraftConfig) -> None:
    draft.plant = _component(draft, "plants", "plant", ignore=("perturb", "set", *plant_range.KEYS))
    tree = draft.tree.get("plant")
    if not isinstance(tree, Map):
        return
    plant_range.read_range(draft)
    for key, relative in (("perturb", True), ("set", False)):
        entries = tree.get(key, {})
        if not isinstance(entries, dict):
            draft.note(["plant", key], f"must be a mapping (got {shown(entries)})")
            continue
        for name, text in entries.items():
            path: list[str | int] = ["plant", key, name]
            if name in draft.parameter_changes:
                draft.note(path, "is already changed by perturb; give one of the two", key=True)
            try:
                if isinstance(text, str) and quantity.spread(text) is not None:
                    message = f"write the range under `uncertainty`, {{eps: {text}}}, and {name}: 1 + eps here"
                    draft.note(path, message)
                    continue
                expression = quantity.parse(text, uncertain_names(draft))
            except quantity.QuantityError as error:
                draft.note(path, str(error))
                continue
            draft.parameter_changes[name] = ParameterChange(expression, relative, locate_key(draft.tree, path))
            if not expression.names:
                _probe(draft, expression, path)


def _probe(draft: DraftConfig, expression: quantity.Expression, path: list[str | int]) -> None:
    """Evaluate an expression that is the same in every run, so that an error shows before any run."""
    try:
        expression()
    except quantity.QuantityError as error:
        draft.note(path, str(error))


def _input(draft: DraftConfig) -> None:
    """Read the input in open loop; an experiment with a controller has none."""
    if "input" not in draft.tree:
        return
    draft.input = _component(draft, "inputs", "input")
    own = draft.values["methods"] or {}
    with_controller = [name for name, method in own.items() if isinstance(method, Map) and "controller" in method]
    if "controller" in draft.tree or with_controller:
        where = "controller" if "controller" in draft.tree else f"methods.{with_controller[0]}.controller"
        draft.note(["input"], f"replaces the controller of all methods; leave out `{where}` or the input", key=True)


def _methods(draft: DraftConfig) -> None:
    methods = draft.values["methods"]
    if methods is not None and not methods:
        draft.note(["methods"], "there must be at least one method")
    for name, own in (methods or {}).items():
        path: list[str | int] = ["methods", name]
        if not name.strip() or re.search(r"[\[\],\n]", name):
            draft.note(
                path, "the name of a method must not be empty or contain brackets, commas or line breaks", key=True
            )
        if own is None:
            own = Map(mark=locate_key(draft.tree, path))
        if not isinstance(own, Map):
            draft.note(path, f"must be a mapping (got {shown(own)})")
            continue
        known = ("model", "estimator", "controller", "label")
        for key in own:
            if key not in known:
                draft.note([*path, key], registry.unknown(key, known, "key"), key=True)
        label = own.get("label")
        if "label" in own and not isinstance(label, str):
            draft.note([*path, "label"], f"must be text (got {shown(label)})")
        named = {key: _method_component(draft, own, key, path) for key in ("model", "estimator", "controller")}
        controlled = own.get("controller", draft.tree.get("controller")) is not None
        draft.methods[name] = MethodComponents(None if label is None else str(label), **named, controlled=controlled)


def _method_component(draft: DraftConfig, own: Map, key: str, path: list[str | int]) -> Component | None:
    """Merge a component of a method over the default of all methods and validate it."""
    if key not in own and key == "model":
        return draft.model
    default = with_kind(key + "s", draft.tree.get(key))
    tree = with_kind(key + "s", own[key]) if key in own else default
    if tree is None:
        others = [other for other in draft.values["methods"].values() if isinstance(other, Map) and key in other]
        # An experiment without any controller has u = 0.
        if key != "controller" or others:
            draft.note(path, f"{key!r} is missing, here and as a default of all methods")
        return None
    if isinstance(tree, Map) and isinstance(default, Map) and tree is not default:
        tree = merge(default, tree)
    mark = own.value_marks.get(key, own.mark)
    if not isinstance(tree, Map) and key not in own:
        return None
    return read_component(key + "s", tree, [*path, key], draft.problems, mark=mark, access=draft.access)


def _named_components(draft: DraftConfig, group: str) -> list[Component | None]:
    """Validate a list whose entries are names or mappings with a `kind`."""
    components: list[Component | None] = []
    entries = draft.section(group)
    if group == "metrics" and isinstance(entries, list) and not entries:
        draft.note([group], "there must be at least one metric")
    for number, entry in enumerate(entries if isinstance(entries, list) else []):
        path: list[str | int] = [group, number]
        mark = locate(draft.tree, path)
        if isinstance(entry, str):
            if registry.is_known(group, entry) or is_reference(entry):
                tree = Map(mark=type(draft.tree.mark)(*mark))
                components.append(
                    read_component(group, tree, path, draft.problems, mark=mark, kind=entry, access=draft.access)
                )
            else:
                noun, way_out = registry.singular(group), f"rmpc-bench list {group}"
                draft.note(path, registry.unknown(entry, registry.names(group), noun, way_out))
        else:
            components.append(read_component(group, entry, path, draft.problems, mark=mark, access=draft.access))
    return components


def _claims(draft: DraftConfig) -> None:
    for number, _ in enumerate(draft.values["claims"] or []):
        draft.claims.append(draft.checked(ClaimKeys, ["claims", number]))
