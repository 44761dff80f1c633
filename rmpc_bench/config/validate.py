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
from rmpc_bench.config.claim_keys import ClaimKeys
from rmpc_bench.config.draft import DraftConfig, Inherited
from rmpc_bench.config.input import check_input
from rmpc_bench.config.methods import read_methods
from rmpc_bench.config.noise import UNCERTAIN_MATRIX, read_initial, read_noise, read_uncertainty, uncertain_names
from rmpc_bench.config.plant import RANGE_KEYS, read_changes, read_limits, refuse_sections
from rmpc_bench.config.plugins import check_required
from rmpc_bench.config.sections import SECTIONS, Keys, Time
from rmpc_bench.config.stop import EVERY
from rmpc_bench.config.sweep import SweptTree
from rmpc_bench.config.tune import SMOKE_BUDGET, Chosen
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Map
from rmpc_bench.expressions.quantity import refusing
from rmpc_bench.types.metric import CalibrationKeys

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
        tree = point.tree.copy()
        for key in ("claims", "figures") if drafts else ():
            tree.pop(key, None)
        values = {name: each for (title, name), each in chosen.items() if title == point.title}
        draft = _sections(DraftConfig(tree, point.coordinates, point.title, access, inherited), values)
        draft = _with_stop(draft, runs, fixed=smoke or runs is not None)
        drafts.append(_shrunk(draft, drafts[0].keys.time if drafts else None) if smoke else draft)
    return drafts


def _sections(draft: DraftConfig, chosen: Mapping[str, Mapping[str, float]]) -> DraftConfig:
    """Read all sections of a point; the values of tuning come before those of the file."""
    fixed = f"this value is a fixed number; it stands in `plant.perturb` and `plant.set`, and {UNCERTAIN_MATRIX}"
    names = uncertain_names(draft.tree)
    with refusing({name: f"{name!r} is an uncertain quantity, and {fixed}" for name in names}):
        draft = replace(draft, keys=_top_level(draft))
        rows = [] if draft.keys.tune is None else [row for row in draft.keys.tune.values if row.at == draft.title]
        check_required(draft)
        draft = replace(
            draft,
            chosen={**{row.method: row.values for row in rows}, **chosen},
            uncertainty=read_uncertainty(draft),
            plant=_component(draft, "plant", ignore=("perturb", "set", *RANGE_KEYS)),
            limits=read_limits(draft),
            changes=read_changes(draft),
            model=_component(draft, "model"),
            reference=_component(draft, "reference"),
            input=_component(draft, "input") if "input" in draft.tree else None,
            noise=read_noise(draft),
            initial=read_initial(draft),
        )
        check_input(draft)
        # The default figure needs runs.
        has_figures = "figures" in draft.tree or "runs" in draft.keys.evaluate
        draft = replace(
            draft,
            methods=read_methods(draft),
            metrics=[each and _named(each) for each in draft.components("metrics")],
            figures=draft.components("figures") if has_figures else [],
            claims=[draft.checked(ClaimKeys, ["claims", number]) for number, _ in enumerate(draft.keys.claims or [])],
        )
    refuse_sections(draft)
    _refuse_unit(draft)
    return draft


def _top_level(draft: DraftConfig) -> Keys:
    """Read the top-level keys; `calibration: true` stands for its defaults, and `false` for None."""
    for name in draft.tree:
        if name not in SECTIONS:
            draft.note([name], registry.unknown(name, SECTIONS, "key"), key=True)
    values: dict[str, Any] = {}
    for name, (annotation, default, _) in SECTIONS.items():
        if name in draft.tree:
            values[name] = draft.checked(annotation, [name])
        elif default is not ...:
            values[name] = default
        elif name != "model" or not _have_own_models(draft.tree.get("methods")):
            draft.note([], f"{name!r} is missing")
    evaluate, calibration = values["evaluate"], values["calibration"]
    values["evaluate"] = [evaluate] if isinstance(evaluate, str) else [*dict.fromkeys(evaluate or ["runs"])]
    values["calibration"] = keys = CalibrationKeys() if calibration is True else calibration or None
    if keys is None:
        return Keys(**values)
    levels = ", ".join(f"{100 * level:g}%" for level in keys.levels)
    if keys.verdict not in keys.levels:
        draft.note(["calibration", "verdict"], f"{100 * keys.verdict:g}% is not among levels [{levels}]")
    if len({*map(keys.name, keys.levels)}) < len(keys.levels):
        draft.note(["calibration", "levels"], f"must name each level once (got [{levels}])")
    if "runs" not in values["evaluate"]:
        draft.note(["calibration"], "counts errors of runs, but no runs are evaluated: add `runs` to `evaluate`")
    return Keys(**values)


def _with_stop(draft: DraftConfig, runs: int | None, *, fixed: bool) -> DraftConfig:
    """Take the given number of runs, or the largest one of a rule, with its defaults; none where runs are `fixed`."""
    draft = draft if runs is None else draft.with_keys(runs=runs)
    stop, runs = draft.keys.stop, draft.keys.runs
    if stop is None or runs is None:
        return draft
    if fixed:
        return draft.with_keys(stop=None)
    first = stop.min_runs or runs
    if first > stop.max_runs:
        given = "min_runs" if "min_runs" in draft.tree["stop"] else "runs"
        message = f"must be at least the number of runs at the first look, {given}: {first}"
        draft.note(["stop", "max_runs"], f"{message} (got {stop.max_runs})")
    stop = replace(stop, min_runs=first, every=None if stop.decide else stop.every or EVERY)
    return draft.with_keys(stop=stop, runs=stop.max_runs)


def _shrunk(draft: DraftConfig, first: Time | None) -> DraftConfig:
    """Take the size of a smoke run where it is smaller; points with another step keep the duration of the first."""
    keys = draft.keys
    size, tune = keys.smoke, keys.tune
    if size is None:
        return draft
    if tune is not None:
        budget, tuning_runs = min(tune.budget, SMOKE_BUDGET), min(tune.runs, size.runs)
        draft = draft.with_keys(tune=replace(tune, budget=budget, runs=tuning_runs, regret=False))
    if keys.runs is None or keys.time is None:
        return draft
    time, calibration = keys.time, keys.calibration
    n_steps = min(time.n_steps, size.steps)
    if first is not None and first.duration is not None:
        n_steps = max(1, round(first.duration / time.step))
    # Windows are given in the unit of the time, so a time in seconds stays one in seconds.
    length: dict[str, Any] = {"duration": n_steps * time.step} if time.duration is not None else {"steps": n_steps}
    if calibration is not None and calibration.from_ is not None:
        calibration = replace(calibration, from_=min(calibration.from_, (n_steps - 1) * time.tick))
    time = Time(step=time.step, unit=time.unit, **length)
    return draft.with_keys(runs=min(keys.runs, size.runs), time=time, calibration=calibration)


def _have_own_models(methods: Any) -> bool:
    """Whether every method has a design model of its own, so that no common one is needed."""
    own = [*methods.values()] if isinstance(methods, Map) else []
    return bool(own) and all(isinstance(method, Map) and "model" in method for method in own)


def _component(draft: DraftConfig, name: str, ignore: tuple[str, ...] = ()) -> Component | None:
    tree = draft.section(name)
    if name not in draft.tree and tree is not ...:
        tree = Map(tree, mark=draft.tree.mark)
    return draft.component(f"{name}s", tree, [name], ignore=ignore) if isinstance(tree, Map) else None


def _refuse_unit(draft: DraftConfig) -> None:
    """Report a unit of time beside a plant or a design model whose parameters are in seconds."""
    time = draft.keys.time
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
