"""progress.json: how far a computation is, for `rmpc-bench status` on any machine that sees the directory.

The trial store is locked while it is written, so this file has all that `status` reads.  It is replaced every few
seconds, also while no block finishes.  A file that has not changed for long therefore shows that its process has ended
or cannot write.
"""

from __future__ import annotations

import json
import math
import os
import platform
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Collection, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
from jaxtyping import Int8

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.engines.tasks import Done, Task
from rmpc_bench.execution.shards import Shard
from rmpc_bench.received.plain_files import PROGRESS, DamagedError, json_of
from rmpc_bench.replaced_file import replace_text
from rmpc_bench.results.running import RunningMean, mean_of
from rmpc_bench.store.store import Store
from rmpc_bench.types import STATUS_WORDS, Array, Status

FILE = "progress.json"
EVERY = 2.0
"""Time between two writings of the file [s]."""
RUNNING, FINISHED, INTERRUPTED = "running", "finished", "interrupted"


class Column(NamedTuple):
    """The primary metric of a method at one point of the sweep."""

    point: int
    title: str  # the point in words
    method: str
    key: str  # hash under which the trials are stored
    metric: str | None  # hash under which the values are stored; None where the point has no such metric
    position: int = 0  # position of the metric among those of the point


class Extent(NamedTuple):
    """What the file says of an experiment."""

    name: str
    experiment: str  # the experiment hash
    n_runs: int
    methods: tuple[str, ...]  # methods that are computed
    primary: str
    columns: tuple[Column, ...]  # of the methods that are computed; trials that points of a sweep share occur once
    n_trials: int  # number of trials of all methods


def extent_of(config: ExperimentConfig, methods: Collection[str]) -> Extent:
    """Return what the file says of a configuration."""
    columns: dict[str, Column] = {}
    for number, point in enumerate(config.points if "runs" in config.evaluate else ()):
        names = [metric.name for metric in point.experiment.metrics]
        position = names.index(config.primary) if config.primary in names else 0
        metric = point.metric_keys.get(config.primary)
        for name, key in point.method_keys.items():
            if name in methods:
                columns.setdefault(key, Column(number, point.title, name, key, metric, position))
    names = [name for name in config.methods if name in methods]
    given = (config.name, config.hash, config.experiment.n_runs, tuple(names), config.primary)
    return Extent(*given, tuple(columns.values()), config.n_trials())


class Following:
    """Writes progress.json every few seconds; the context manager is the time in which trials are computed.

    Of `total` trials so many are `done`, those of earlier sessions included.  `stage` is what is computed before the
    trials of the experiment, in words.
    """

    end = FINISHED
    """State in the last file, where nothing was interrupted."""

    def __init__(
        self,
        directory: Path,
        extent: Extent,
        runs: range,
        shard: Shard | None,
        *,
        total: int,
        done: int,
        stage: str = "",
    ) -> None:
        self._path, self._extent, self._runs = directory / FILE, extent, runs
        self.total, self.done = total, done
        self._before, self._start = done, time.monotonic()
        self._constant = {
            "name": extent.name,
            "experiment": extent.experiment,
            "shard": None if shard is None else shard.name,
            **({"stage": stage} if stage else {}),
            "runs": [runs.start, runs.stop],
            "n_runs": extent.n_runs,
            "all_trials": extent.n_trials,
            "methods": list(extent.methods),
            "host": platform.node(),
            "pid": os.getpid(),
            "started": _now(),
        }
        self._lock, self._end = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)

    def __enter__(self) -> Self:
        """Write the file for the first time."""
        self._write(RUNNING)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Write the end and its reason."""
        self._end.set()
        self._thread.join()
        self._write(self.end if kind is None else INTERRUPTED, "" if kind is None else kind.__name__)

    def results(self) -> dict[str, Any]:
        """Return what the trials say so far, which is nothing where they are not those of the experiment."""
        return {"failed": {}, "metric": self._extent.primary, "means": []}

    def _follow(self) -> None:
        while not self._end.wait(EVERY):
            self._write(RUNNING)

    def _write(self, state: str, why: str = "") -> None:
        with self._lock:
            data = self._data(state, why)
        write(self._path, data)

    def _data(self, state: str, why: str) -> dict[str, Any]:
        seconds = time.monotonic() - self._start
        rate = (self.done - self._before) / max(seconds, 1e-9)
        left = self.total - self.done
        return {
            **self._constant,
            "state": state,
            "why": why,
            "updated": _now(),
            "every": EVERY,
            "total": self.total,
            "done": self.done,
            "seconds": round(seconds, 3),
            "rate": float(f"{rate:.4g}"),
            "left_seconds": float(f"{left / rate:.4g}") if rate > 0.0 and state == RUNNING else None,
            **self.results(),
        }


class ProgressFile(Following):
    """Writes progress.json of the trials of an experiment: those in the store, and `n_left` that are to be computed.

    Stored runs of `tasks` are computed again and count then.
    """

    def __init__(
        self,
        directory: Path,
        extent: Extent,
        runs: range,
        store: Store,
        *,
        n_left: int,
        tasks: Sequence[Task] = (),
        shard: Shard | None = None,
    ) -> None:
        total = len(extent.columns) * len(runs)
        super().__init__(directory, extent, runs, shard, total=total, done=total - n_left)
        self._store, self._failed, self._means = store, Counter[str](), dict[tuple[int, str], RunningMean]()
        self._columns = {(column.point, column.method): column for column in extent.columns}
        self._tasks = tasks

    def is_up_to_date(self) -> bool:
        """Whether the file of an earlier session says that all trials are stored, as they are."""
        try:
            data = read(self._path.parent) or {}
        except DamagedError:
            return False
        return data.get("state") == FINISHED and data.get("done") == data.get("total") == self.total == self.done

    def _count_stored(self, counted: range, tasks: Sequence[Task]) -> None:
        """Count what earlier sessions have stored of some runs, but for those of tasks."""
        own = defaultdict[tuple[int, str], list[range]](list)
        for task in tasks:
            own[task.point, task.method].append(task.runs)
        for column in self._extent.columns:
            runs, status = self._store.statuses(column.key, counted.stop)
            again = np.concatenate([np.empty(0, dtype=int), *own.get((column.point, column.method), ())])
            inside = (runs >= counted.start) & ~np.isin(runs, again)
            if column.metric is not None and np.any(inside):
                values = self._store.values(column.key, column.metric, runs[inside])
                self._add(column, status[inside], values)

    def _add(self, column: Column, status: Int8[Array, " runs"], values: Array) -> None:
        codes, counts = np.unique(status, return_counts=True)
        words = {STATUS_WORDS[int(code)]: int(n) for code, n in zip(codes, counts, strict=True) if code != Status.OK}
        self._failed.update(words)
        before = self._means.get((column.point, column.method), RunningMean())
        self._means[column.point, column.method] = before.joined(mean_of(values))

    def __enter__(self) -> Self:
        """Count what is stored, and write the file for the first time."""
        self._count_stored(self._runs, self._tasks)
        return super().__enter__()

    def note(self, done: Done) -> None:
        """Count a finished task."""
        task, block = done.task, done.block
        column = self._columns[task.point, task.method]
        with self._lock:
            self.done += len(task.runs)
            if column.metric is not None:
                self._add(column, block.status, block.metrics[column.position])

    def extend(self, tasks: Sequence[Task], n_runs: int) -> None:
        """Add the runs up to ``n_runs``; those of all methods are stored but for those of ``tasks``."""
        with self._lock:
            left = self.total - self.done + sum(len(task.runs) for task in tasks)
            self._count_stored(range(self._runs.stop, n_runs), tasks)
            self._runs = range(self._runs.start, n_runs)
            self.total = len(self._extent.columns) * len(self._runs)
            self.done = self.total - left
            self._constant["runs"] = [self._runs.start, n_runs]

    def results(self) -> dict[str, Any]:
        """Return the failed trials, and the means of the primary metric."""
        return {
            "failed": dict(sorted(self._failed.items())),
            "metric": self._extent.primary,
            "means": [
                {"point": column.title, "method": column.method}
                | {name: finite(value) for name, value in self._means[place]._asdict().items()}
                for place, column in self._columns.items()
                if place in self._means
            ],
        }


def finite(value: float) -> float | None:
    """Return a number; None for one that is too large, for which JSON has no word."""
    return value if math.isfinite(value) else None


def write(path: Path, data: dict[str, Any]) -> None:
    """Replace the file; a computation goes on where it cannot be written."""
    try:
        replace_text(path, json.dumps(data, indent=1, allow_nan=False) + "\n")
    except (OSError, ValueError):
        # Nothing but `status` reads the file; a full disk is reported by the trial store.
        pass


def read(directory: Path) -> dict[str, Any] | None:
    """Return the content of progress.json; None where there is no such file."""
    found: dict[str, Any] | None = json_of(directory / FILE, PROGRESS, "`rmpc-bench run` writes it again")
    return found


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
