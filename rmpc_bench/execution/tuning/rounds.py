"""The trials of values that tuning tries: computed as those of an experiment, in a store of their own, and counted."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from jaxtyping import Float

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.rounds import Round, RoundBuilder, Trial
from rmpc_bench.engines.choice import ComputeOptions, choose_engine
from rmpc_bench.execution.missing import pending, stored_blocks
from rmpc_bench.execution.progress import Progress
from rmpc_bench.execution.progress_file import RUNNING, Following, extent_of
from rmpc_bench.execution.separation import separated, warm_up_tasks
from rmpc_bench.execution.shards import Shard
from rmpc_bench.results.other_code import check_versions, note_versions, stored_methods
from rmpc_bench.results.tuning import FOLDER
from rmpc_bench.store.store import Store
from rmpc_bench.types import Array, Status


class TuningProgress(Following, Progress):
    """Counts trials in progress.json and on a display; the context manager is the time of the tuning."""

    # The trials of the experiment follow, whose file takes its place.
    end = RUNNING

    def __init__(
        self, directory: Path, config: ExperimentConfig, shard: Shard | None, display: Progress, title: str, total: int
    ) -> None:
        n_runs = config.experiment.n_runs
        runs = range(n_runs) if shard is None else shard.runs(n_runs)
        extent = extent_of(config, config.methods)
        super().__init__(directory, extent, runs, shard, total=total, done=0, stage=title)
        self._display, self._title = display, title

    def __enter__(self) -> Self:
        """Begin with the display and the file."""
        self._display.start(self._title, self.total, 0)
        return super().__enter__()

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """End the display, and write the file for the last time."""
        self._display.stop()
        super().__exit__(kind, value, traceback)

    def advance(self, n: int) -> None:
        """Count ``n`` more trials as stored."""
        with self._lock:
            self.done += n
        self._display.advance(n)

    def found(self, n: int) -> None:
        """Count ``n`` trials as stored that an earlier session has computed."""
        with self._lock:
            self.done += n
            self._before += n
        self._display.found(n)

    def extend(self, n: int) -> None:
        """Add ``n`` trials to those that are to be computed."""
        with self._lock:
            self.total += n
        self._display.extend(n)

    def say(self, text: str) -> None:
        """Show a line."""
        self._display.say(text)


MOST_TRIALS = 500
"""Values that are computed together: their designs are in memory, and every worker process has a copy."""
DIGITS = 6
"""Significant digits of a metric: the objectives, and so the choice, do not depend on the last bits of a CPU."""


class Rounds:
    """Computes the trials of values, or reads those that are stored below the directory of the results."""

    def __init__(self, config: ExperimentConfig, directory: Path, how: ComputeOptions, progress: Progress) -> None:
        assert config.tuning is not None
        self._config, self._plan, self._how, self._progress = config, config.tuning, how, progress
        self.directory, self._builder = directory, RoundBuilder(config)
        self.seconds: dict[str, float] = {}
        """Key of a search -> computing time of its trials in this process [s]."""

    def values(self, trials: Sequence[Trial], *, tested: bool = False) -> dict[Trial, Float[Array, " runs"]]:
        """Return the metric of every run, with six digits; NaN where a run has failed.

        A value whose design cannot be made loses all runs.
        """
        found: dict[Trial, Array] = {}
        ordered = sorted(trials, key=lambda trial: trial.search.number)
        n_runs = self._plan.test_runs if tested else self._plan.protocol.runs
        for part in (ordered[first : first + MOST_TRIALS] for first in range(0, len(ordered), MOST_TRIALS)):
            made = self._builder.build(part, tested=tested)
            lost = [trial for trial in part if trial not in made.places]
            self._progress.found(len(lost) * n_runs)
            found |= {trial: np.full(n_runs, np.nan) for trial in lost}
            if made.places:
                found |= self._computed(made, n_runs, tested=tested)
        return found

    def _computed(self, made: Round, n_runs: int, *, tested: bool) -> dict[Trial, Array]:
        started, config = time.monotonic(), made.config
        folder = self._config.hash if tested else self._plan.folder
        seed = {} if tested else {"seed": self._plan.seeds[0]}
        with Store(self.directory / FOLDER / folder[:12]) as store:
            store.claim(folder, {**self._config.shared, **seed})
            names = list(dict.fromkeys(trial.name for trial in made.places))
            check_versions(config, store, names, accept=self._how.accept_versions)
            self._compute(config, store, names, len(made.places) * n_runs)
            store.flush()
            found = {trial: self._read(config, store, trial, point, n_runs) for trial, point in made.places.items()}
        share = (time.monotonic() - started) / len(made.places)
        for trial in made.places:
            self.seconds[trial.search.key] = self.seconds.get(trial.search.key, 0.0) + share
        return found

    def _compute(self, config: ExperimentConfig, store: Store, names: Sequence[str], n_trials: int) -> None:
        """Compute and store what is missing."""
        progress = self._progress
        tasks = pending(config, store, names)
        progress.found(n_trials - sum(len(task.runs) for task in tasks))
        if not tasks:
            return
        store.register(stored_methods(config, names))
        note_versions(config, store, names)
        config, _ = separated(config, names, progress)
        engine = choose_engine(config, tasks, self._how, store.directory, progress.say)
        warm_up_tasks([point.experiment for point in config.points], tasks, progress)
        with closing(stored_blocks(config, store, tasks, engine)) as results:
            for _, done in results:
                progress.advance(len(done.task.runs))

    def _read(self, config: ExperimentConfig, store: Store, trial: Trial, number: int, n_runs: int) -> Array:
        point, metric = config.points[number], self._plan.protocol.metric
        key = point.method_keys[trial.name]
        runs, status = store.statuses(key, n_runs)
        values = np.full(n_runs, np.nan)
        values[runs] = store.values(key, point.metric_keys[metric], runs)
        values[runs[status != Status.OK]] = np.nan
        return rounded(np.where(np.isfinite(values), values, np.nan))


def rounded(values: Float[Array, " runs"]) -> Float[Array, " runs"]:
    """Return values with six significant digits; NaN stays."""
    return np.array([float(f"{value:.{DIGITS}g}") for value in values])
