"""A configuration: what a YAML says, checked whole, with every design made."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rmpc_bench.claims.claim import Claim
from rmpc_bench.config import reader
from rmpc_bench.config.build import build
from rmpc_bench.config.canonical import belief, changes, first_point, measured, resolved, shared
from rmpc_bench.config.claim_checks import read_claims
from rmpc_bench.config.component import Component
from rmpc_bench.config.config_point import ConfigPoint, digest
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.figure_checks import check_evaluation, check_figures, check_recording, layout
from rmpc_bench.config.inheritance import composed, inlined, opened
from rmpc_bench.config.reader import Map
from rmpc_bench.config.schema import shown
from rmpc_bench.config.sections import Execution, Statistics, Time
from rmpc_bench.config.sweep import (
    Point,
    depends,
    method_paths_first,
    points,
    swept_overrides,
    swept_paths,
)
from rmpc_bench.config.sweep_points import Place
from rmpc_bench.config.sweep_section import NAME
from rmpc_bench.config.validation import at_their_origin, read
from rmpc_bench.execution.engines import single_thread
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import ConfigError, Problem


@dataclass(frozen=True, eq=False)
class ExperimentConfig:
    """A valid configuration.

    Parameters
    ----------
    path : the file it was read from
    name, paper, title : as given; ``paper`` may be None
    points : the points of its sweep; one where nothing is swept
    axes : the swept paths, those that change together as one
    statistics, execution : how to compare, how to work
    evaluate : what to compute, `runs` or `moments` or both
    in_samples : whether time counts in samples and not in seconds
    labels : method name -> text for tables and figures
    figures : the parts to draw
    claims : statements to judge
    resolved : the whole configuration with every default filled in; loads to an equal one
    first_point : the same at the first point of its sweep, where `resolved` leaves what is swept as given
    """

    path: Path
    name: str
    paper: str | None
    title: str
    points: tuple[ConfigPoint, ...]
    axes: tuple[tuple[str, ...], ...]
    statistics: Statistics
    execution: Execution
    evaluate: tuple[str, ...]
    in_samples: bool
    labels: Mapping[str, str]
    figures: tuple[Component, ...]
    claims: tuple[Claim, ...]
    resolved: Mapping[str, Any]
    first_point: Mapping[str, Any]

    @property
    def experiment(self) -> Experiment:
        """The experiment, of the first point in a sweep."""
        return self.points[0].experiment

    @property
    def methods(self) -> Mapping[str, Any]:
        """What each method is, at the first point."""
        return self.points[0].methods

    @property
    def paths(self) -> tuple[str, ...]:
        """The swept paths."""
        return tuple(path for axis in self.axes for path in axis)

    @property
    def primary(self) -> str:
        """Name of the metric that the screen and the figures show."""
        return self.statistics.primary or self.experiment.metrics[0].info.name

    @property
    def baseline(self) -> str:
        """Method that all others are compared with."""
        return self.statistics.baseline or self.experiment.methods[0].name

    def n_trials(self, methods: Collection[str] | None = None) -> int:
        """Count the trials of some methods, all unless given; what points of a sweep share counts once."""
        wanted = self.methods if methods is None else methods
        keys = {key for point in self.points for name, key in point.method_keys.items() if name in wanted}
        return len(keys) * self.experiment.n_runs if "runs" in self.evaluate else 0

    @cached_property
    def shared(self) -> Mapping[str, Any]:
        """What all methods share: at the first point, and what is another at the others, by their values."""
        first = self.points[0]
        others = {point.truth: point for point in reversed(self.points) if point.truth != first.truth}
        rows = [(point.coordinates, point.truth) for point in self.points]
        paths = [path for path in depends(rows, method_paths_first(self.axes)) if path != NAME]
        truths = {
            ", ".join(f"{path}={point.coordinates[path]}" for path in paths): changes(first.shared, point.shared)
            for point in others.values()
        }
        return {**first.shared, "sweep": truths} if others else first.shared

    @property
    def hash(self) -> str:
        """Hash of the truths that the methods meet, in any order; it identifies a directory."""
        return digest(sorted({point.truth for point in self.points}))

    @property
    def full_hash(self) -> str:
        """Hash of everything that determines a trial, methods included."""
        return digest({point.title: [point.truth, point.methods] for point in self.points})


def load_config(
    path: str | Path, *, overrides: Sequence[str] = (), runs: int | None = None, smoke: bool = False
) -> ExperimentConfig:
    """Read, check and build a configuration.

    Parameters
    ----------
    path : the YAML
    overrides : texts PATH=VALUE, each replacing one value
    runs : number of runs instead of the file's
    smoke : the small size under ``smoke`` instead of the full one

    Raises
    ------
    ConfigError
        With everything that is wrong, each with its place.
    """
    tree = reader.load(path)
    if not isinstance(tree, Map):
        raise ConfigError([Problem(str(path), 1, 1, "", f"must be a mapping (got {shown(tree)})")])
    tree = _overridden(tree, overrides, Path(path))
    places, problems = points(tree)
    if not problems:
        problems += swept_overrides(tree, {path: mark for path, _, mark in map(reader.parse_override, overrides)})
    drafts, experiments = _built(places, runs=runs, smoke=smoke)
    found = tuple(
        ConfigPoint(
            place.coordinates,
            place.title,
            experiment,
            shared(draft, experiment),
            _beliefs(draft),
            measured(draft, experiment),
        )
        for place, draft, experiment in zip(places, drafts, experiments, strict=True)
        if experiment is not None
    )
    there = [] if problems else _places(places, found)
    # What was overridden is looked at for information; that claims and figures reach beyond its end is no mistake.
    lenient = smoke or bool(overrides)
    seen = layout([point.experiment for point in found], len(places), smoke=lenient) if found else None
    claims = read_claims(drafts[0], _metric_names(drafts[0]), there, seen)
    for draft, experiment in zip(drafts, experiments, strict=True):
        if experiment is not None:
            check_evaluation(draft, experiment)
    _statistics(drafts[0])
    check_recording(drafts[0], experiments)
    check_figures(drafts[0], _metric_names(drafts[0]), there, seen if there else None)
    _columns(drafts[0], swept_paths(tree) if there else ())
    problems += [problem for draft in drafts for problem in at_their_origin(draft)]
    if problems or len(found) < len(places):
        raise ConfigError(problems)
    return _config(Path(path), tree, drafts[0], found, claims, smoke=smoke)


def _built(
    places: Sequence[Point], *, runs: int | None, smoke: bool
) -> tuple[list[DraftConfig], list[Experiment | None]]:
    """Read and build every point; what is said once for all of them is read with the first."""
    drafts: list[DraftConfig] = []
    experiments: list[Experiment | None] = []
    made: dict[str, Any] = {}
    with single_thread():
        for place in places:
            tree = composed(place.tree)
            draft = read(tree if not drafts else _without(tree, "claims", "figures"))
            if runs is not None:
                draft.values["runs"] = runs
            if smoke:
                _shrink(draft, drafts[0].values["time"] if drafts else None)
            drafts.append(draft)
            experiments.append(build(draft, made, smoke=smoke))
    return drafts, experiments


def _config(
    path: Path, tree: Map, draft: DraftConfig, found: tuple[ConfigPoint, ...], claims: tuple[Claim, ...], *, smoke: bool
) -> ExperimentConfig:
    values, oracles = draft.values, found[0].experiment.oracles
    return ExperimentConfig(
        path=path,
        name=values["name"],
        paper=values["paper"],
        title=values["title"],
        points=found,
        axes=swept_paths(tree),
        statistics=values["statistics"],
        execution=values["execution"],
        evaluate=tuple(values["evaluate"]),
        in_samples=values["time"].duration is None and values["time"].step == 1.0,
        labels={name: parts.label + (" (oracle)" if name in oracles else "") for name, parts in draft.methods.items()},
        figures=tuple(part for part in draft.figures if part is not None),
        claims=claims,
        resolved=resolved(draft, found[0].experiment, tree, smoke=smoke),
        first_point=first_point(draft, found[0].experiment, smoke=smoke),
    )


def _beliefs(draft: DraftConfig) -> dict[str, Any]:
    return {name: belief(draft, parts) for name, parts in draft.methods.items()}


def _without(tree: Map, *keys: str) -> Map:
    """Leave out what is said once for all points."""
    tree = tree.copy()
    for key in keys:
        tree.pop(key, None)
    return tree


def _places(places: Sequence[Point], found: Sequence[ConfigPoint]) -> list[Place]:
    """Points as claims name them; with what they share where all of them could be built."""
    if len(found) < len(places):
        return [Place(place.coordinates) for place in places]
    return [Place(point.coordinates, point.method_keys) for point in found]


def _columns(draft: DraftConfig, axes: Sequence[Sequence[str]]) -> None:
    """Refuse metrics that are called like a column of the sweep."""
    for number, part in enumerate(draft.metrics):
        name = part.parameters.get("name") if part is not None else None
        if name in [path for axis in axes for path in axis]:
            draft.note(["metrics", number], f"{name!r} is a column of the sweep already; choose another name")


def _overridden(tree: Map, overrides: Sequence[str], path: Path) -> Map:
    """Replace single values and read files; what is wrong with any value is raised together.

    Files are read when it is known which ones, so that the other values can be laid over what comes from them.
    """
    problems: list[Problem] = []
    naming = [text for text in overrides if re.match(r"(plant|plant\.from|sweep.*?)\s*=", text.strip())]
    others = [text for text in overrides if text not in naming]
    for texts in (naming, others):
        for text in texts:
            try:
                where, value, mark = reader.parse_override(text)
                tree = reader.assign(opened(tree, where), where, value, mark)
            except ConfigError as error:
                problems += error.problems
        if problems and texts is others:
            raise ConfigError(problems)
        tree = tree if problems else inlined(tree, path)
    return tree


def _shrink(draft: DraftConfig, first: Time | None) -> None:
    """Take the size of a smoke run where it is smaller; points with other steps keep the duration of the first one."""
    size, values = draft.values["smoke"], draft.values
    if size is not None and values["runs"] is not None and values["time"] is not None:
        time = values["time"]
        values["runs"] = min(values["runs"], size.runs)
        n_steps = min(time.n_steps, size.steps)
        if first is not None and first.duration is not None:
            n_steps = max(1, round(first.duration / time.step))
        # The unit of windows must survive, so a time in seconds stays one in seconds.
        length = {"duration": n_steps * time.step} if time.duration is not None else {"steps": n_steps}
        values["time"] = type(time)(step=time.step, **length)


def _statistics(draft: DraftConfig) -> None:
    given, names = draft.tree.get("statistics"), _metric_names(draft)
    if not isinstance(given, Map):
        return
    if isinstance(given.get("primary"), str) and given["primary"] not in names:
        draft.note(["statistics", "primary"], unknown(given["primary"], names, "metric of this configuration"))
    if isinstance(given.get("baseline"), str) and draft.methods and given["baseline"] not in draft.methods:
        draft.note(["statistics", "baseline"], unknown(given["baseline"], draft.methods, "method"))


def _metric_names(draft: DraftConfig) -> list[str]:
    return [part.parameters["name"] for part in draft.metrics if part is not None and "name" in part.parameters]
