"""How far a tuning is: on the screen, and in progress.json for `rmpc-bench status`."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.execution.progress import Progress
from rmpc_bench.execution.progress_file import RUNNING, Following
from rmpc_bench.execution.running_comparison import RunningComparison
from rmpc_bench.execution.shards import Shard


class TuningProgress(Following):
    """Counts trials in progress.json and on a display; the context manager is the time of the tuning.

    Parameters
    ----------
    directory : where the file is
    config : the experiment
    shard : the shard that is tuned for; None for all runs
    display : of the same trials
    title : what is tuned, in words
    total : number of trials
    """

    # The trials of the experiment follow, whose file takes its place.
    end = RUNNING

    def __init__(
        self, directory: Path, config: ExperimentConfig, shard: Shard | None, display: Progress, title: str, total: int
    ) -> None:
        n_runs = config.experiment.n_runs
        runs = range(n_runs) if shard is None else shard.runs(n_runs)
        constant = {
            "name": config.name,
            "experiment": config.hash,
            "shard": None if shard is None else shard.name,
            "stage": title,
            "runs": [runs.start, runs.stop],
            "n_runs": n_runs,
            "all_trials": config.n_trials(),
            "methods": list(config.methods),
        }
        super().__init__(directory, constant, total, 0)
        self._display, self._title, self._metric = display, title, config.primary

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

    def results(self) -> dict[str, Any]:
        """Return nothing that a trial says: the trials are not those of the experiment."""
        return {"failed": {}, "metric": self._metric, "means": []}

    def start(self, title: str, total: int, done: int, running: RunningComparison | None = None) -> None:
        """Begin; the context manager has done so."""

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

    def stop(self) -> None:
        """End; the context manager does so."""
