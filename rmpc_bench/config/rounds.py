"""Rounds of tuning: the designs of values that are tried, as configurations of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from rmpc_bench.config.build import build
from rmpc_bench.config.designs import DesignCache
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.experiment_config import ExperimentConfig, WantedSearch
from rmpc_bench.config.identity import SweepPoint
from rmpc_bench.config.own_code import FirstCalls, OwnCode
from rmpc_bench.config.search import as_value, with_values
from rmpc_bench.config.statistics import Statistics
from rmpc_bench.config.sweep import SweptTree
from rmpc_bench.config.validate import validate_sections
from rmpc_bench.config_file.tree import Items, Map, join, locate_key
from rmpc_bench.types import ConfigError

SEPARATOR = "~"  # between the name of a method and the number of a value
MOST_DESIGNS = 1000  # designs that are kept from one round to the next; some are large
_WITHOUT = ("claims", "statistics", "stop", "report", "record", "tune", "evaluate")
"""Sections that the runs of tuning do without."""


class Trial(NamedTuple):
    """A method at one point of the sweep with values to try."""

    search: WantedSearch
    number: int  # position of the values among those of the search
    row: tuple[float, ...] | None  # a value for every parameter; None for the method without tuned values

    @property
    def name(self) -> str:
        """Name of the method in the round."""
        return f"{self.search.method}{SEPARATOR}{self.number}"


class Round(NamedTuple):
    """What a round computes."""

    config: ExperimentConfig  # a configuration of the points that take part, each with the methods that it needs
    # trial -> position of its point in this configuration; those whose design cannot be made are missing
    places: Mapping[Trial, int]


class RoundBuilder:
    """Makes the designs of rounds; those that rounds have in common are made once."""

    def __init__(self, config: ExperimentConfig) -> None:
        assert config.origin is not None and config.tuning is not None
        self._config, self._origin, self._plan = config, config.origin, config.tuning
        self._cache, self._calls = DesignCache(), FirstCalls()

    def build(self, trials: Sequence[Trial], *, tested: bool = False) -> Round:
        """Return the configuration of a round, on the runs of the experiment if tested, else on the tuning runs.

        Raises a ConfigError if something else than the design of a value that is tried is wrong.
        """
        if len(self._cache) > MOST_DESIGNS:
            self._cache = DesignCache()
        numbers = sorted({trial.search.number for trial in trials})
        points, places, own = list[SweepPoint](), dict[Trial, int](), OwnCode(self._origin.access)
        for number in numbers:
            here = [trial for trial in trials if trial.search.number == number]
            point, made = self._point(number, here, own, tested=tested)
            if point is not None:
                places |= dict.fromkeys(made, len(points))
                points.append(point)
        config = replace(
            self._config,
            points=tuple(points),
            statistics=Statistics(primary=self._plan.protocol.metric),
            evaluate=("runs",),
            own=own,
            claims=(),
            figures=(),
            stop=None,
            tuning=None,
            origin=None,
        )
        return Round(config, places)

    def _point(
        self, number: int, trials: Sequence[Trial], own: OwnCode, *, tested: bool
    ) -> tuple[SweepPoint | None, list[Trial]]:
        """Make the designs of one point; a trial whose design cannot be made is left out, and the rest made again."""
        left = [*trials]
        while left:
            draft = self._draft(number, left, tested=tested)
            # The draft has lost the methods that could not be validated.
            [(point, *_)] = build([draft], own, smoke=self._origin.smoke, cache=self._cache, calls=self._calls)
            if point is not None and not draft.problems:
                return point, left
            starts = {trial: f"{join(['methods', trial.name])}." for trial in left}
            lost = {
                trial for trial in left if any(f"{each.path}.".startswith(starts[trial]) for each in draft.problems)
            }
            if not lost:
                raise ConfigError(draft.problems)
            left = [trial for trial in left if trial not in lost]
        return None, []

    def _draft(self, number: int, trials: Sequence[Trial], *, tested: bool) -> DraftConfig:
        """Return the sections of a point with the methods of a round."""
        given = self._origin.points[number]
        seed = given.tree.get("seed", 0) if tested else self._plan.seeds[number]
        runs = self._plan.test_runs if tested else self._plan.protocol.runs
        tree = given.tree.copy()
        for key in _WITHOUT:
            tree.pop(key, None)
        mark = tree.mark
        tree.put("figures", Items(mark=mark), mark, mark)
        tree.put("metrics", Items([self._metric(number, given.tree)], mark=mark), mark, mark)
        tree.put("seed", seed, mark, mark)
        tree.put("methods", self._methods(number, given.tree, trials), mark, mark)
        # All points are read, since a smoke run takes its length from the first of them.
        others = self._origin.points[:1] if self._origin.smoke and number else []
        point = SweptTree(given.coordinates, tree, given.title)
        return validate_sections([*others, point], runs=runs, smoke=self._origin.smoke, access=self._origin.access)[-1]

    def _metric(self, number: int, tree: Map) -> object:
        """Return the metric that tuning minimises as the configuration gives it."""
        names = [metric.name for metric in self._config.points[number].experiment.metrics]
        given = tree.get("metrics", ["mse"])
        entry: object = given[names.index(self._plan.protocol.metric)]
        return entry

    def _methods(self, number: int, tree: Map, trials: Sequence[Trial]) -> Map:
        """Return the methods of a round, and the one that the uncertainty of the plant is chosen against."""
        given, draft = tree["methods"], DraftConfig(tree)
        found = Map(mark=given.mark)
        opponent = self._config.points[number].experiment.plant.opponent
        if opponent is not None:
            found.put(opponent[0], given[opponent[0]], given.mark, given.mark)
        for trial in trials:
            name = trial.search.method
            mark = locate_key(given, [name])
            own = given[name].copy()
            for key in ("label", "tune", "parameters"):
                own.pop(key, None)
            if trial.row is not None:
                pairs = zip(trial.search.parameters, trial.row, strict=True)
                own = with_values(draft, own, {each.path: as_value(each, value) for each, value in pairs}, mark)
            found.put(trial.name, own, mark, mark)
        return found
