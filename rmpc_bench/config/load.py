"""Loading a configuration: the seven stages from a YAML file to an ExperimentConfig, and its resolved form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from numbers import Integral
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.config.build import build
from rmpc_bench.config.check import Checked, check
from rmpc_bench.config.draft import DraftConfig, Inherited
from rmpc_bench.config.experiment_config import ExperimentConfig, Origin, with_tuning
from rmpc_bench.config.identity import (
    Built,
    method_data,
    noise_data,
    plant_data,
    set_keys,
    start_data,
    sum_data,
    uncertainty_data,
)
from rmpc_bench.config.left_out import fitting_metrics, fitting_sweep, problems_at_origin, with_findings
from rmpc_bench.config.own_code import OwnCode, as_of_configuration, check_copies
from rmpc_bench.config.plugins import load_plugins, reported_once
from rmpc_bench.config.search import check_tuning
from rmpc_bench.config.sections import MAX_RUNS, SECTIONS, Time
from rmpc_bench.config.sweep import NAME, Sweep, columns, expand
from rmpc_bench.config.tune import Chosen
from rmpc_bench.config.validate import validate_sections
from rmpc_bench.config_file.component import plain_data
from rmpc_bench.config_file.extends import GivenConfig, read, texts_of
from rmpc_bench.config_file.inherit import SECTIONS_OF_A_PLANT, has_source, inherit, lay_over_source
from rmpc_bench.config_file.known_files import located
from rmpc_bench.config_file.mapping import canonical_text, plain_mapping
from rmpc_bench.config_file.matrix_files import with_matrices
from rmpc_bench.config_file.tree import Items, Map, locate, plain, split
from rmpc_bench.config_file.yaml import one_line
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import ConfigError, Problem
from rmpc_bench.types.errors import MAPPING, check_arguments

_AS_GIVEN = ("name", "paper", "title", "calibration", "statistics", "execution", "stop", "report")
"""Sections that a configuration has as they were validated."""


def canonicalise(
    path: Path,
    sweep: Sweep,
    checked: Checked,
    built: Sequence[Built],
    own: OwnCode,
    *,
    smoke: bool,
    overrides: tuple[str, ...] = (),
    added: Mapping[str, str] = MappingProxyType({}),
) -> ExperimentConfig:
    """Return a configuration without errors in its final form, from its points with all designs made.

    `own` has the files of the user that the points use, and gets those of plugins and figures.  Overrides and added
    methods are those of the command line.
    """
    draft, points = checked.draft, tuple(each.point for each in built if each.point is not None)
    keys, experiment = draft.keys, points[0].experiment
    first_point = _first_point(draft, experiment, smoke=smoke)
    _add_files(sweep.tree, draft, own)
    return ExperimentConfig(
        path=path,
        overrides=overrides,
        added=added,
        left_out=tuple(draft.left_out),
        warnings=(*draft.warnings, *own.warnings),
        own=own,
        model_facts=built[0].facts,
        points=points,
        axes=sweep.axes,
        **{key: getattr(keys, key) for key in _AS_GIVEN},
        evaluate=tuple(keys.evaluate),
        in_samples=draft.time.duration is None and draft.time.step == 1.0,
        labels={
            name: label + " (oracle)" * (name in experiment.oracles and "oracle" not in label)
            for name, label in checked.labels.items()
        },
        figures=tuple(figure for figure in draft.figures if figure is not None),
        claims=checked.claims,
        resolved=_with_sweep(first_point, sweep, own),
        first_point=first_point,
    )


def _add_files(tree: Map, draft: DraftConfig, own: OwnCode) -> None:
    """Add the files whose code computes no trial, but which are needed to load the configuration."""
    for number, text in enumerate(tree.get("plugins") or ()):
        reference = own.access.file(text, locate(tree, ["plugins", number]).file)
        own.read(reference.file, reference.path)
    for figure in draft.figures:
        own.identity({"figure": figure})


def _with_sweep(first_point: dict[str, Any], sweep: Sweep, own: OwnCode) -> dict[str, Any]:
    """Add the sweep; sections that it changes are left as given, since a swept path must still lead somewhere."""
    tree = sweep.tree
    if "sweep" not in tree:
        return first_point
    changed: tuple[str, ...] = ("model", "estimator", "controller", "methods")
    roots = {split(path, tree.mark)[0] for axis in sweep.axes for path in axis}
    if has_source(tree) and roots & {*changed, "plant"}:
        changed = (*changed, "plant", *SECTIONS_OF_A_PLANT)
    resolved = {**first_point, **_sections_kept_by_rows(tree, first_point, own, changed)}
    if roots & set(changed):
        resolved = {key: value for key, value in resolved.items() if key not in changed}
        resolved |= {key: as_of_configuration(tree, key, own) for key in changed if key in tree}
    return {**resolved, "sweep": as_of_configuration(tree, "sweep", own)}


def _sections_kept_by_rows(
    tree: Map, first_point: dict[str, Any], own: OwnCode, changed: Sequence[str]
) -> dict[str, Any]:
    """Return sections as given in which a row of a zip leaves a value of the file as it is."""
    # At the first point such a section may have the value of the first row.
    rows = (tree["sweep"] or {}).get("zip")
    rows = rows if isinstance(rows, Items) else ()
    kept = {path for path in columns(rows) if path != NAME and any(path not in row for row in rows)}
    # The file of the plant may bring the section.
    tree = lay_over_source(tree) if has_source(tree) else tree
    found: dict[str, Any] = {}
    for root in sorted({split(path, tree.mark)[0] for path in kept} - set(changed)):
        given = as_of_configuration(tree, root, own) if root in tree else SECTIONS[root].default
        # The length of a smoke run is not the one given.
        found[root] = {**first_point["time"], "step": given.get("step", Time.step)} if root == "time" else given
    return found


def _first_point(draft: DraftConfig, experiment: Experiment, *, smoke: bool) -> dict[str, Any]:
    """Return the configuration at the first point of its sweep, with every default filled in."""
    keys, time = draft.keys, draft.time
    length = {"duration": time.duration} if time.duration is not None else {"steps": time.steps}
    given = ("version", "name", "paper", "title", "summary", "seed", "runs")
    head = {key: value for key in given if (value := getattr(keys, key)) is not None}
    if keys.stop is not None:
        # A rule has taken its largest number of runs for that of the experiment.
        head |= {"runs": keys.stop.first_look, "stop": plain_data(keys.stop)}
    return {
        **head,
        "time": {"step": time.step, **length, **({} if time.unit == "s" else {"unit": time.unit})},
        "uncertainty": uncertainty_data(draft, canonical=False),
        "plant": plant_data(draft),
        **({"model": set_keys(draft.model)} if draft.model else {}),
        "noise": noise_data(draft, experiment),
        "initial": {**_true_start(draft, experiment), **start_data(draft)},
        "reference": draft.reference.resolved() if draft.reference else {},
        **({"input": draft.input.resolved()} if draft.input else {}),
        "methods": _methods(draft),
        **_tune(draft),
        "metrics": _metrics(draft, experiment, smoke=smoke),
        # A key that an earlier version did not have is left out unless it is used.
        **({"calibration": plain_data(keys.calibration)} if keys.calibration is not None else {}),
        "statistics": {k: v for k, v in plain_data(keys.statistics).items() if (k, v) != ("adjust", "auto")},
        "evaluate": keys.evaluate,
        "record": plain_data(keys.record),
        "report": plain_data(keys.report),
        "figures": [set_keys(figure) for figure in draft.figures if figure is not None],
        "claims": [plain_data(each) for each in draft.claims if each is not None],
        **{key: value for key in ("plugins", "requires") if (value := getattr(keys, key))},
        "execution": plain_data(keys.execution),
        "smoke": plain_data(keys.smoke),
    }


def _methods(draft: DraftConfig) -> dict[str, Any]:
    """Return the methods with the defaults of all of them merged in."""
    methods = {}
    for name, components in draft.methods.items():
        # The values that tuning has chosen stand under `tune`.
        data = method_data(draft, components if components.search is None else components.search.untuned)
        named: dict[str, Any] = {key: data[key] for key in ("model", "estimator", "controller") if key in data}
        own = (draft.keys.methods or {})[name] or {}  # nothing where its components are all defaults
        named |= {key: plain(own[key]) for key in ("tune", "parameters") if key in own}
        # A template stays one, so that an override of the resolved configuration changes the label too.
        methods[name] = named if components.label is None else {"label": components.label, **named}
    return methods


def _tune(draft: DraftConfig) -> dict[str, Any]:
    """Return the section `tune` without the values that were chosen; where it says so, nothing is tuned."""
    tune = draft.keys.tune
    if tune is None:
        return {"tune": None} if draft.searches else {}
    return {"tune": plain_data(replace(tune, values=[]))}


def _true_start(draft: DraftConfig, experiment: Experiment) -> dict[str, Any]:
    """Return the true initial state; some plants have their own."""
    if experiment.plant.has_own_start:
        return {}
    return {"x": sum_data(draft.initial.laws) if draft.initial.laws else draft.initial.x}


def _metrics(draft: DraftConfig, experiment: Experiment, *, smoke: bool) -> list[dict[str, Any]]:
    """Return the keys of the metrics; windows that a smoke run has cut are given as cut."""
    entries = []
    for metric, component in zip(experiment.metrics, draft.metrics, strict=False):
        keys = set_keys(component) if component is not None else {}
        if smoke:
            first, last = (sample * experiment.tick for sample in metric.window(experiment.metric_layout))
            cut = {"from": first, "to": last, "at": last}
            keys |= {
                name: value for name, value in cut.items() if component is not None and name in component.resolved()
            }
        entries.append(keys)
    return entries


def load_config(
    path: str | Path | Mapping[str, Any],
    *,
    overrides: str | Sequence[str] | Mapping[str, Any] = (),
    runs: int | None = None,
    smoke: bool = False,
    allow_code: str | Path | Sequence[str | Path] = (),
    add_methods: str | Sequence[str] = (),
    lenient: bool = False,
) -> ExperimentConfig:
    """Read, check and build a configuration.

    A stage processes what is valid and collects the errors of the rest, so that all errors are shown at once.

    Parameters
    ----------
    path : the YAML file, the name of an installed configuration such as ``quickstart``, or a mapping with the same
        keys, in which classes may stand for kinds; file names in it are relative to the current directory
    overrides : texts PATH=VALUE, each replacing one value, or a mapping of paths to values; a text alone is one
    runs : number of runs instead of the one in the file
    smoke : whether to take the small size under ``smoke`` instead of the full one
    allow_code : Python files, or directories of such, that may be loaded besides those in the directory of the
        configuration and below
    add_methods : texts ``NAME: {estimator: {..}}``, methods that are added to those of the file
    lenient : whether figures and claims may reach beyond the end of a run, as they may in a smoke run

    Raises
    ------
    ConfigError
        If anything is wrong: all errors, sorted, each with its place, in a mapping the path of its key.

    Examples
    --------
    >>> config = load_config("quickstart", runs=4, overrides={"time.duration": 10})
    >>> config.experiment.n_steps, config.baseline
    (100, 'S-MPC')
    """
    if runs is not None:
        if isinstance(runs, bool) or not isinstance(runs, Integral) or not 1 <= runs <= MAX_RUNS:
            message = f"must be a whole number from 1 to {MAX_RUNS} (got {runs!r})"
            raise ConfigError([Problem(f"runs={runs!r}", 1, 1, "runs", message)])
        runs = int(runs)
    check_arguments(load_config, locals())
    added, changes = [add_methods] if isinstance(add_methods, str) else add_methods, _texts(overrides)
    allow_code = [allow_code] if isinstance(allow_code, str | Path) else allow_code
    size = Size(runs, smoke, lenient=lenient or smoke or bool(overrides))
    place, text = (Path.cwd() / MAPPING, canonical_text(path)) if isinstance(path, Mapping) else (located(path), None)
    source = read(place, changes, added, text)
    check_copies(source.path.parent)
    access = CodeAccess.of(source.path, allow_code, is_file=source.content is None)
    inherited = Inherited(source.path, is_changed=bool(changes) or runs is not None)
    tree, left_out = fitting_sweep(with_matrices(inherit(source), source.path), inherited)
    load_plugins(tree, access)
    try:
        return _validated(source, tree, access, size, inherited, left_out, {})
    except ConfigError as error:
        tree, lines = fitting_metrics(tree, error.problems, inherited)
        if not lines:
            raise
    return _validated(source, tree, access, size, inherited, [*left_out, *lines], {})


def _texts(overrides: str | Sequence[str] | Mapping[str, Any]) -> Sequence[str]:
    if isinstance(overrides, Mapping):
        return [f"{path}={one_line(value)}" for path, value in plain_mapping(overrides).items()]
    return [overrides] if isinstance(overrides, str) else overrides


class Size(NamedTuple):
    """What the options of the command line say about the size of the experiment."""

    runs: int | None
    smoke: bool
    lenient: bool  # whether figures and claims may reach beyond the end of a run: they are written for the full size


def _validated(
    source: GivenConfig,
    tree: Map,
    access: CodeAccess,
    size: Size,
    inherited: Inherited,
    left_out: Sequence[str],
    chosen: Chosen,
) -> ExperimentConfig:
    """Take a tree through the stages from its sweep on, with the values that tuning has chosen; raises all errors."""
    sweep = expand(tree, source.overrides, access)
    drafts = validate_sections(
        sweep.points, runs=size.runs, smoke=size.smoke, access=access, inherited=inherited, chosen=chosen
    )
    drafts[0].left_out.extend(left_out)
    drafts[0] = with_findings(source.path, drafts[0])
    own = OwnCode(access)
    built = build(drafts, own, smoke=size.smoke)
    checked = check(sweep, drafts, built, lenient=size.lenient)
    drafts[0], points = checked.draft, [each.point for each in built]
    check_tuning(drafts, points)
    problems = [*sweep.problems, *own.problems]
    problems += [problem for draft in drafts for problem in problems_at_origin(draft, source.tree)]
    if problems or None in points:
        raise ConfigError(reported_once(problems))
    options, added = source.options(size.runs, smoke=size.smoke), texts_of(source.added)
    config = canonicalise(source.path, sweep, checked, built, own, smoke=size.smoke, overrides=options, added=added)
    config = replace(config, path=access.start / source.path, content=source.content)
    again = partial(_validated, source, tree, access, size, inherited, left_out)
    return with_tuning(config, drafts, Origin(sweep.points, access, size.smoke, again))
