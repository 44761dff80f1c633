"""Stopping rules: how many runs an experiment computes follows from its results (section `stop`).

A rule looks at the trials when runs 0 to n-1 of all methods are stored, and at these runs only.  Its decisions are
therefore the same for any workers, engine, blocks and interruptions.  Every look is stored before the runs of the next
one are computed, so that the same command continues where it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import replace

from rmpc_bench.analysis.levels import next_width_look
from rmpc_bench.claims.claim import Finding
from rmpc_bench.claims.verdict import judge
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.stop import EVERY
from rmpc_bench.engines.tasks import Task
from rmpc_bench.execution.missing import pending
from rmpc_bench.results.record import StoredExperiment, note_looks, planned_looks, read_experiment, stop_of
from rmpc_bench.results.tables import StoredTables
from rmpc_bench.store.store import Store

NAMED = 3
"""Open claims and comparisons that are named."""


class Stopping:
    """Decides at every look whether runs follow, and which; `say` gets a line per look.

    The open store has the record that reports read.  No look takes place while other methods than these have missing
    runs.
    """

    def __init__(
        self, config: ExperimentConfig, store: Store, methods: Collection[str], say: Callable[[str], None]
    ) -> None:
        found = stop_of(config, store)
        if config.stop is None or found is None:
            raise ValueError("the configuration has no section `stop`")
        self._config, self._store, self._methods = config, store, methods
        self._keys, self.stop, self._left, self._say = config.stop, found, 0, say

    @property
    def n_runs(self) -> int:
        """Number of runs that are wanted now."""
        return self.stop.looks.wanted

    def tasks(self) -> list[Task]:
        """Return the missing tasks up to the next look; takes every look whose runs are there."""
        every_method = [method.name for method in self._config.experiment.methods]
        while True:
            found = self._missing(self._methods)
            self._left = sum(len(task.runs) for task in found)
            if found or self.stop.is_over or self._missing(every_method):
                return found
            self._look()

    def _missing(self, methods: Collection[str]) -> list[Task]:
        return pending(self._config, self._store, methods, range(self.n_runs))

    def after(self, n_trials: int) -> list[Task]:
        """Count trials that were stored since the last call, and return the tasks that follow from them."""
        self._left -= n_trials
        return self.tasks() if self._left <= 0 else []

    def _look(self) -> None:
        """Evaluate the rule on the runs that are there, and store the outcome."""
        looks, experiment = self.stop.looks, read_experiment(self._store)
        if self._keys.resolve is None:
            opened, n_runs = self._open_claims(experiment), self.n_runs
            following = next((n for n in planned_looks(self._keys) if n > n_runs), n_runs)
        else:
            opened, following = self._too_wide(experiment, self._keys.resolve)
        runs = (*looks.runs, self.n_runs)
        wanted = following if opened else self.n_runs
        looks = replace(looks, runs=runs, wanted=wanted, is_met=not opened, open=_first(opened))
        note_looks(self._store, looks)
        self.stop = replace(self.stop, looks=looks)
        self._say(self.stop.text)

    def kinds(self) -> list[Task]:
        """Return a task of every method at every point, as any of them may follow."""
        return [Task(name, 0, 1, number) for number in range(len(self._config.points)) for name in self._methods]

    def _open_claims(self, experiment: StoredExperiment) -> list[str]:
        """Name the claims that are inconclusive."""
        trials = StoredTables(experiment, self._store).trials().common
        verdicts = [judge(claim, trials) for claim in experiment.claims if claim.is_testable]
        return [f"inconclusive: {each.claim.says}" for each in verdicts if each.finding is Finding.INCONCLUSIVE]

    def _too_wide(self, experiment: StoredExperiment, resolve: float) -> tuple[list[str], int]:
        """Name the comparisons that are not resolved, the worst first, and find the runs of the next look."""
        # Only a rule about widths needs this module, which compares all methods.
        from rmpc_bench.analysis.resolution import half_widths

        # Earlier published verdicts widen the intervals of a report, not those of the rule.
        table = replace(StoredTables(_of_primary(experiment), self._store).trials().common, look=1)
        table = replace(table, points=tuple(replace(point, look=1) for point in table.points))
        wide = sorted((each for each in half_widths(table) if each.value > resolve), key=lambda each: -each.value)
        texts = [
            f"{' at '.join(filter(None, (each.method, each.point)))} "
            + (
                f"is known to {100 * each.value:.2g} %"
                if math.isfinite(each.value)
                else each.reason or "has no interval"
            )
            for each in wide
        ]
        every = self._keys.every or EVERY
        n = next_width_look(self.n_runs, wide[0].value, resolve, every, self._keys.max_runs) if wide else self.n_runs
        return texts, n


def _of_primary(experiment: StoredExperiment) -> StoredExperiment:
    """Leave out what a comparison of the primary metric does not read, which may be large."""
    points = []
    for point in experiment.points:
        methods = {
            name: replace(method, signals=(), shapes={}, series_key=f"no series of {name}", series={}, moments=None)
            for name, method in point.methods.items()
        }
        primary = tuple(info for info in point.metrics if info.name == experiment.primary)
        keys = {info.name: point.metric_keys[info.name] for info in primary}
        points.append(
            replace(point, metrics=primary, metric_keys=keys, methods=methods, n_recorded=0, has_ensemble=False)
        )
    return replace(experiment, points=tuple(points))


def _first(texts: list[str]) -> tuple[str, ...]:
    more = len(texts) - NAMED
    return (*texts[:NAMED], *([f"{more} more"] if more > 0 else []))
