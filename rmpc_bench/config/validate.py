"""Stage 4, validate: from the tree of every point to its sections and components.

Every section is validated on its own: an error is added to the problems of the draft, and the next section follows.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.config.claims import ClaimKeys
from rmpc_bench.config.draft import DraftConfig, Inherited, PointTuning
from rmpc_bench.config.input import check_input
from rmpc_bench.config.method_tune import shrink_tuning
from rmpc_bench.config.methods import read_method_section
from rmpc_bench.config.noise import explain_uncertain, read_initial, read_noise, read_uncertainty
from rmpc_bench.config.plant import RANGE_KEYS, read_plant_keys, refuse_sections
from rmpc_bench.config.plugins import check_required
from rmpc_bench.config.sections import SECTIONS, Time, components_of, section_of
from rmpc_bench.config.statistics import read_calibration
from rmpc_bench.config.stop import apply_stop
from rmpc_bench.config.sweep import SweptTree
from rmpc_bench.config.tune import Chosen
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Map

_NOTHING: Chosen = MappingProxyType({})


def validate_sections(
    points: Sequence[SweptTree],
    *,
    runs: int | None,
    smoke: bool,
    access: CodeAccess = NO_ACCESS,
    inherited: Inherited | None = None,
    chosen: Chosen = _NOTHING,
) -> list[DraftConfig]:
    """Return the sections of every point, with the problems that were found in them.

    Figures and claims are the same at all points and are read at the first.  `runs` replaces the number that is given,
    `chosen` are the values of tuning.  A smoke run has the size under ``smoke``.
    """
    drafts: list[DraftConfig] = []
    for point in points:
        values = {name: each for (title, name), each in chosen.items() if title == point.title}
        draft = _sections(point, access, inherited, values, first=not drafts)
        if runs is not None:
            draft.values["runs"] = runs
        apply_stop(draft, fixed=smoke or runs is not None)
        if smoke:
            _shrink(draft, drafts[0].values["time"] if drafts else None)
            shrink_tuning(draft)
        drafts.append(draft)
    return drafts


def _sections(
    point: SweptTree,
    access: CodeAccess,
    inherited: Inherited | None,
    chosen: Mapping[str, Mapping[str, float]],
    *,
    first: bool,
) -> DraftConfig:
    tree = point.tree
    if not first:
        tree = tree.copy()
        for key in ("claims", "figures"):
            tree.pop(key, None)
    draft = DraftConfig(tree, [], point.coordinates, point.title, access, inherited)
    _top_level(draft)
    tune = draft.values["tune"]
    rows = [] if tune is None else [row for row in tune.values if row.at == point.title]
    draft.tuning = PointTuning(rows, {**{row.method: row.values for row in rows}, **chosen})
    check_required(draft)
    read_uncertainty(draft)
    draft.plant = _component(draft, "plant", ignore=("perturb", "set", *RANGE_KEYS))
    read_plant_keys(draft)
    draft.model = _component(draft, "model")
    draft.reference = _component(draft, "reference")
    if "input" in tree:
        draft.input = _component(draft, "input")
        check_input(draft)
    read_noise(draft)
    read_initial(draft)
    read_method_section(draft)
    refuse_sections(draft)
    _refuse_unit(draft)
    draft.metrics = [each and _named(each) for each in components_of(draft, "metrics")]
    read_calibration(draft)
    # The default figure needs runs.
    if "figures" in tree or "runs" in draft.values["evaluate"]:
        draft.figures = components_of(draft, "figures")
    draft.claims = [
        draft.checked(ClaimKeys, ["claims", number]) for number, _ in enumerate(draft.values["claims"] or [])
    ]
    explain_uncertain(draft)
    return draft


def _shrink(draft: DraftConfig, first: Time | None) -> None:
    """Take the size of a smoke run where it is smaller; points with another step keep the duration of the first."""
    size, runs, time = (draft.values[key] for key in ("smoke", "runs", "time"))
    if size is None or runs is None or time is None:
        return
    n_steps = min(time.n_steps, size.steps)
    if first is not None and first.duration is not None:
        n_steps = max(1, round(first.duration / time.step))
    # Windows are given in the unit of the time, so a time in seconds stays one in seconds.
    length = {"duration": n_steps * time.step} if time.duration is not None else {"steps": n_steps}
    draft.values |= {"runs": min(runs, size.runs), "time": Time(step=time.step, unit=time.unit, **length)}
    keys = draft.values["calibration"]
    if keys is not None and keys.from_ is not None:
        draft.values["calibration"] = replace(keys, from_=min(keys.from_, (n_steps - 1) * time.tick))


def _top_level(draft: DraftConfig) -> None:
    for name in draft.tree:
        if name not in SECTIONS:
            draft.note([name], registry.unknown(name, SECTIONS, "key"), key=True)
    for name, (annotation, default, _) in SECTIONS.items():
        if name in draft.tree:
            draft.values[name] = draft.checked(annotation, [name])
        elif default is ...:
            if name != "model" or not _have_own_models(draft.tree.get("methods")):
                draft.note([], f"{name!r} is missing")
            draft.values[name] = None
        else:
            draft.values[name] = default
    evaluate = draft.values["evaluate"]
    draft.values["evaluate"] = [evaluate] if isinstance(evaluate, str) else [*dict.fromkeys(evaluate or ["runs"])]


def _have_own_models(methods: Any) -> bool:
    """Whether every method has a design model of its own, so that no common one is needed."""
    own = [*methods.values()] if isinstance(methods, Map) else []
    return bool(own) and all(isinstance(method, Map) and "model" in method for method in own)


def _component(draft: DraftConfig, name: str, ignore: tuple[str, ...] = ()) -> Component | None:
    tree = section_of(draft, name)
    if name not in draft.tree and tree is not ...:
        tree = Map(tree, mark=draft.tree.mark)
    return draft.component(f"{name}s", tree, [name], ignore=ignore) if isinstance(tree, Map) else None


def _refuse_unit(draft: DraftConfig) -> None:
    """Report a unit of time beside a plant or a design model whose parameters are in seconds."""
    time = draft.values["time"]
    if time is None or time.unit == "s":
        return
    models = [each.model for each in draft.methods.values()]
    named = [("plant", draft.plant), *(("model", each) for each in (draft.model, *models))]
    for role, component in named:
        if component is not None and component.is_built_in and component.kind in registry.IN_SECONDS:
            message = f"the parameters of the {role} `{component.kind}` are in seconds: time.unit must be s"
            draft.note(["time", "unit"], message)
            return


def _named(metric: Component) -> Component:
    """Add the components that a metric is restricted to to its default name."""
    only, keys = metric.parameters.get("only"), metric.parameters
    if not only or "name" in metric.tree or not metric.is_built_in:
        return metric
    words = [re.sub(r"\W", "_", str(each)) for each in only]
    return replace(metric, parameters={**keys, "name": "_".join([keys["name"], *words])})
