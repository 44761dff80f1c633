"""A valid configuration: what `load_config` returns."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from rmpc_bench.claims.claim import Claim
from rmpc_bench.config.draft import ModelFacts
from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config.report_section import ReportKeys
from rmpc_bench.config.sections import Execution
from rmpc_bench.config.statistics_section import Statistics
from rmpc_bench.config.stop_section import StopKeys
from rmpc_bench.config.sweep_point import SweepPoint, digest
from rmpc_bench.config.sweep_section import METHOD_COMPONENTS, NAME
from rmpc_bench.config.tuning_plan import Origin, TuningPlan
from rmpc_bench.config_file.component import Component
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Problem
from rmpc_bench.types.sweep_points import relevant_paths


@dataclass(frozen=True, eq=False)
class ExperimentConfig:
    """A valid configuration.

    Parameters
    ----------
    path : file of the configuration
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
        """The average that verdicts rest on where both are asked for: ``mean`` if the claims name it, else geometric.

        A claim names the mean by ``mean(metric[...])`` and the geometric mean by ``ratio(metric[...])``.
        """
        checks = " ".join(check for claim in self.claims for check in claim.check).replace(" ", "")
        names_mean, names_ratio = (f"{function}({self.primary}[" in checks for function in ("mean", "ratio"))
        return "mean" if names_mean and not names_ratio else "geometric"

    def n_trials(self, methods: Collection[str] | None = None, n_runs: int | None = None) -> int:
        """Count the trials; those that points of the sweep share count once.

        Parameters
        ----------
        methods : names of the methods to count; None for all
        n_runs : number of runs; that of the experiment unless given
        """
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
