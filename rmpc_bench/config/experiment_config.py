"""A valid configuration: what `load_config` returns, with the searches of its tuned methods."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.claims.claim import Claim, usual_parameters
from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.identity import ModelFacts, SweepPoint, digest, method_data
from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config.report import ReportKeys
from rmpc_bench.config.search import metric_of_tuning
from rmpc_bench.config.sections import Execution
from rmpc_bench.config.statistics import Statistics
from rmpc_bench.config.stop import StopKeys
from rmpc_bench.config.sweep import METHOD_COMPONENTS, NAME, SweptTree
from rmpc_bench.config.tune import Chosen
from rmpc_bench.config_file.component import Component, without_path
from rmpc_bench.simulation.random_streams import words_of
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Problem
from rmpc_bench.types.metric import CalibrationKeys
from rmpc_bench.types.sweep_points import relevant_paths
from rmpc_bench.types.tuning import NOTHING_TUNED, OTHER_SETTINGS, TunedParameter, TuningProtocol


class Origin(NamedTuple):
    """What a configuration was made from, to try values in it and to load it with those that are chosen."""

    points: Sequence[SweptTree]  # the tree of every point of the sweep, before its validation
    access: CodeAccess
    smoke: bool
    # loads the configuration with chosen values and returns an ExperimentConfig; ConfigError as `load_config`
    load: Callable[[Chosen], Any]


@dataclass(frozen=True, eq=False)
class WantedSearch:
    """The search of one method at one point of the sweep."""

    point: str  # title of the point
    number: int  # position of the point
    method: str  # name of the method
    parameters: tuple[TunedParameter, ...]  # what is tuned
    default: tuple[float | None, ...]  # value of each parameter without tuning; None where it is no number
    key: str  # what identifies the search; equal searches have equal keys
    # path -> chosen value; None where none is known, empty where nothing could be tuned
    values: Mapping[str, float | int] | None
    settings: str  # what identifies the search but for the code: config.resolved.yaml keeps it with the values
    # the same of the search that has found the values; the one of this search where the file has no values
    carried: str


@dataclass(frozen=True, eq=False)
class TuningPlan:
    """All searches of a configuration."""

    protocol: TuningProtocol  # the same for all of them
    regret: bool  # whether all values are also computed on the runs of the experiment
    searches: tuple[WantedSearch, ...]  # every tuned method at every point
    seeds: tuple[int, ...]  # seed of the tuning runs at every point
    folder: str  # identifies the tuning runs, as the hash of an experiment does its runs
    # number of runs of the experiment on which values are compared; the largest one with a stopping rule
    test_runs: int

    @property
    def missing(self) -> tuple[WantedSearch, ...]:
        """Searches without a chosen value."""
        return tuple(each for each in self.searches if each.values is None)

    @property
    def data(self) -> dict[str, Any]:
        """What is tuned and how, as plain data, without what was chosen."""
        ranges = {f"{each.point}/{each.method}": [vars(one) for one in each.parameters] for each in self.searches}
        return {"protocol": vars(self.protocol), "ranges": ranges}

    def words(self, method: str, default: str) -> str:
        """Say where the parameters of a method come from; `default` is said of those that stay in the file."""
        searches = [each for each in self.searches if each.method == method]
        if any(each.carried != each.settings for each in searches):
            return OTHER_SETTINGS
        n_found = sum(each.values is None or bool(each.values) for each in searches)
        if not n_found:
            return f"{default} {NOTHING_TUNED}"
        words = self.protocol.words
        return words if n_found == len(searches) else f"{words[:-1]}, {n_found} of {len(searches)} points)"

    def n_trials(self, methods: Sequence[str] | None = None) -> tuple[int, int]:
        """Return the largest numbers of trials on tuning runs and, for the regret, on the runs of the experiment."""
        wanted = [each for each in self.missing if methods is None or each.method in methods]
        n = len({each.key for each in wanted})
        tested = n * (self.protocol.budget + 1) * self.test_runs if self.regret else 0
        return n * self.protocol.budget * self.protocol.runs, tested


def tuning_seed(seed: int, number: int) -> int:
    """Return the seed of the tuning runs of an experiment by the number of their stream.

    >>> tuning_seed(1, 0) != tuning_seed(1, 1) != 1
    True
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(*words_of("tuning"), number))
    high, low = (int(word) for word in sequence.generate_state(2, np.uint32))
    return (high >> 1) << 32 | low


def tuning_plan(drafts: Sequence[DraftConfig], points: Sequence[SweepPoint]) -> TuningPlan | None:
    """Return what there is to tune in a valid configuration; None where no method is tuned."""
    tune = drafts[0].keys.tune
    if tune is None or not drafts[0].searches:
        return None
    protocol = tune.protocol(metric_of_tuning(drafts[0]))
    seeds = [tuning_seed(draft.keys.seed or 0, protocol.seed) for draft in drafts]
    shared = [digest({**point.shared, "seed": seed}) for point, seed in zip(points, seeds, strict=True)]
    # Where a method has several rows at a point, which is an error, the first one counts.
    rows = {(row.at, row.method): row.key for row in reversed(tune.values)}
    searches = [
        _wanted(draft, point, number, name, protocol, shared[number], rows.get((draft.title, name)))
        for number, (draft, point) in enumerate(zip(drafts, points, strict=True))
        for name in draft.searches
    ]
    folder, test_runs = digest(sorted(set(shared))), points[0].experiment.n_runs
    return TuningPlan(protocol, tune.regret, tuple(searches), tuple(seeds), folder, test_runs)


def _wanted(
    draft: DraftConfig,
    point: SweepPoint,
    number: int,
    name: str,
    protocol: TuningProtocol,
    shared: str,
    carried: str | None,
) -> WantedSearch:
    """Return the search of a method; `carried` identifies the one whose values the file has."""
    search = draft.searches[name]
    data = {
        "experiment": shared,
        "method": method_data(draft, search.lowest, without_path),
        "ranges": [vars(each) for each in search.parameters],
        # The number of the stream is in the seed.
        "protocol": {each: value for each, value in vars(protocol).items() if each not in ("metric", "seed")},
        "metric": point.metric_keys[protocol.metric],
    }
    key, settings = digest({**data, "code": point.code[name]}), digest(data)[:16]
    found = (search.parameters, search.default, key, search.values, settings, settings if carried is None else carried)
    return WantedSearch(draft.title, number, name, *found)


def parameter_words(draft: DraftConfig, plan: TuningPlan | None) -> dict[str, str]:
    """Say for every method where its parameters come from."""
    usual = usual_parameters(draft.keys.paper)
    words = {name: each.source or usual for name, each in draft.methods.items()}
    return words if plan is None else words | {name: plan.words(name, words[name]) for name in draft.searches}


@dataclass(frozen=True, eq=False, repr=False)
class ExperimentConfig:
    """A valid configuration.

    Parameters
    ----------
    path : file of the configuration, absolute
    name, paper, title : as given; ``paper`` may be None
    points : points of the sweep; one where nothing is swept
    axes : swept paths; the paths of a zip, which change together, are one axis
    statistics, execution : settings of the comparison and of the computation
    stop : rule that ends the experiment before its largest number of runs, which is then that of `experiment`
    evaluate : what to compute: ``runs``, ``ensemble``, ``moments``
    in_samples : whether time is counted in samples instead of seconds
    labels : method name -> text for tables and figures
    figures : figures to draw
    claims : statements to check
    resolved : the whole configuration with every default filled in; it loads to an equal configuration
    first_point : the same at the first point of the sweep, where ``resolved`` leaves swept components as given
    overrides : what changes the experiment against its file, as options of the command line, such as ``--smoke``
    added : method that the command line adds -> its text
    left_out : claims, figures and settings that are inherited and do not fit, in words
    warnings : what is valid but probably not meant, each with its place
    model_facts : properties of the design models at the first point of the sweep
    own : the files of the user that the configuration uses
    report : what tables and figures show, and how figures are written
    parameters : method -> where its parameters come from, such as ``default`` or ``tuned (budget 16, 40 runs)``
    tuning : what there is to tune, and the values that are known; None without the section `tune`
    origin : what the configuration was made from; None where nothing is tuned
    content : text of a configuration that was given as a mapping; None where `path` is its file
    calibration : how reported covariances are compared with the errors; None where they are not
    """

    path: Path
    name: str
    paper: str | None
    title: str
    points: tuple[SweepPoint, ...]
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
    overrides: tuple[str, ...] = ()
    added: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    warnings: tuple[Problem, ...] = ()
    model_facts: tuple[ModelFacts, ...] = ()
    own: OwnCode = field(default_factory=OwnCode)
    report: ReportKeys = field(default_factory=ReportKeys)
    stop: StopKeys | None = None
    parameters: Mapping[str, str] = field(default_factory=dict)
    tuning: TuningPlan | None = None
    origin: Origin | None = None
    content: str | None = None
    calibration: CalibrationKeys | None = None

    def __repr__(self) -> str:
        n, runs = len(self.points), self.experiment.n_runs
        return f"<ExperimentConfig {self.name!r}: {len(self.methods)} methods, {runs} runs, {n} point{'s' * (n > 1)}>"

    @property
    def experiment(self) -> Experiment:
        """The experiment; in a sweep, that of the first point."""
        return self.points[0].experiment

    @property
    def methods(self) -> Mapping[str, Any]:
        """Plain data of every method, at the first point."""
        return self.points[0].methods

    @property
    def paths(self) -> tuple[str, ...]:
        """The swept paths."""
        return tuple(path for axis in self.axes for path in axis)

    @property
    def primary(self) -> str:
        """Name of the metric that the screen and the figures show."""
        return self.statistics.primary or self.experiment.metrics[0].name

    @property
    def baseline(self) -> str:
        """Name of the method that all others are compared with."""
        return self.statistics.baseline or self.experiment.methods[0].name

    @property
    def headline(self) -> str:
        """The average that verdicts rest on where both are asked for."""
        return headline_of(self.claims, self.primary)

    def n_trials(self, methods: Collection[str] | None = None, n_runs: int | None = None) -> int:
        """Count the trials; those that points of the sweep share count once."""
        wanted = self.methods if methods is None else methods
        keys = {key for point in self.points for name, key in point.method_keys.items() if name in wanted}
        return len(keys) * (self.experiment.n_runs if n_runs is None else n_runs) if "runs" in self.evaluate else 0

    @cached_property
    def shared(self) -> Mapping[str, Any]:
        """What all methods share at the first point, and under ``sweep`` what differs from it at the others."""
        first = self.points[0]
        others = {point.experiment_hash: point for point in reversed(self.points)}
        others.pop(first.experiment_hash)
        rows = [(point.coordinates, point.experiment_hash) for point in self.points]
        paths = [path for path in relevant_paths(rows, _method_axes_first(self.axes)) if path != NAME]
        differing = {
            ", ".join(f"{path}={point.coordinates[path]}" for path in paths): changes(first.shared, point.shared)
            for point in others.values()
        }
        return {**first.shared, "sweep": differing} if others else first.shared

    @property
    def hash(self) -> str:
        """Hash of what all methods share, over all points in any order; it identifies a results directory."""
        return digest(sorted({point.experiment_hash for point in self.points}))

    @property
    def full_hash(self) -> str:
        """Hash of everything that determines a trial, methods included."""
        # Without own code nothing is added, so that directories of overrides keep their names.
        own = {point.title: point.own_code for point in self.points if any(point.own_code.values())}
        methods = {point.title: [point.experiment_hash, point.methods] for point in self.points}
        given = [methods, own] if own else methods
        return digest(given if self.tuning is None else [given, self.tuning.data])


def with_tuning(config: ExperimentConfig, drafts: Sequence[DraftConfig], origin: Origin) -> ExperimentConfig:
    """Return a configuration that knows its searches; the values that are known are added to its resolved form."""
    plan = tuning_plan(drafts, config.points)
    config = replace(config, parameters=parameter_words(drafts[0], plan))
    if plan is None:
        return config
    rows = [
        {
            **({"at": each.point} if each.point else {}),
            "method": each.method,
            "values": dict(each.values),
            "key": each.carried,
        }
        for each in plan.searches
        if each.values is not None
    ]
    resolved, first = (
        {**tree, "tune": {**tree["tune"], "values": rows}} for tree in (config.resolved, config.first_point)
    )
    return replace(config, tuning=plan, origin=origin, resolved=resolved, first_point=first)


def changes(before: Any, after: Any) -> Any:
    """Return the entries of plain data that differ in a second tree; an entry that is missing there is None."""
    if not (isinstance(before, dict) and isinstance(after, dict)):
        return after
    keys = [*before, *(key for key in after if key not in before)]
    return {key: changes(before.get(key), after.get(key)) for key in keys if before.get(key) != after.get(key)}


def _method_axes_first(axes: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """Order the axes so that `relevant_paths` drops paths into methods before paths into the plant."""
    roots = {path: path.split(".")[0] for axis in axes for path in axis}
    of_methods = (*METHOD_COMPONENTS, "methods", NAME)
    return sorted(axes, key=lambda axis: not all(roots[path] in of_methods for path in axis))


def headline_of(claims: Sequence[Claim], primary: str) -> str:
    """Return the average that verdicts rest on where both are asked for: ``mean`` if claims name it, else geometric.

    A claim names the mean by ``mean(metric[...])`` and the geometric mean by ``ratio(metric[...])``.
    """
    checks = " ".join(check for claim in claims for check in claim.check).replace(" ", "")
    names_mean, names_ratio = (f"{function}({primary}[" in checks for function in ("mean", "ratio"))
    return "mean" if names_mean and not names_ratio else "geometric"
