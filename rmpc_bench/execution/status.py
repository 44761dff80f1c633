"""How far an experiment is, from the files progress.json of a directory and its shards.

The trial stores are not read: they are locked while they are written.
"""

from __future__ import annotations

import math
import os
import platform
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote
from typing import Any

from rmpc_bench.analysis.shown_numbers import plain, short
from rmpc_bench.execution.progress_file import FILE, FINISHED, RUNNING, finite, read
from rmpc_bench.execution.shards import Shard, shards_in
from rmpc_bench.received.store import MissingError
from rmpc_bench.results.running import RunningMean

KILLED, STALE, INCOMPLETE, ABSENT = "killed", "stale", "incomplete", "absent"
"""States that follow from more than the file: its process has ended without a last file; the file is old; the process
has ended before all trials were stored; the shard has no file."""
STALE_AFTER = 30.0
"""Age from which on a file is stale, at least ten times the time between two files [s]."""
MOST_ROWS = 12
"""Means that are printed."""


@dataclass(frozen=True)
class ShardStatus:
    """State of a shard, or of an experiment without shards: what one process computes or has computed."""

    name: str  # of the shard; empty for an experiment without shards
    state: str  # running, finished, interrupted, or one of the states above
    runs: tuple[int, int] | None  # first run and end of the runs; None where there is no file
    total: int  # total, done: trials, and those that are stored
    done: int
    failed: Mapping[str, int]  # status -> failed trials
    host: str = ""  # host, pid: process that writes or wrote
    pid: int = 0
    age_seconds: float = 0.0  # time since the last file [s]
    rate: float = 0.0  # finished trials per second in the last session
    left_seconds: float | None = None  # time until the end at this rate [s]; None where it is not known
    why: str = ""  # name of the exception that has ended the session
    stage: str = ""  # the tuning whose trials are counted, in words; empty where they are those of the experiment


@dataclass(frozen=True)
class ExperimentStatus:
    """How far an experiment is."""

    name: str  # of the experiment
    directory: Path  # of the results
    shards: tuple[ShardStatus, ...]  # the shards; one without a name if the experiment is not divided
    metric: str  # the primary metric
    means: tuple[tuple[str, str, RunningMean], ...]  # (point of the sweep in words, method, mean so far)
    # total, done: trials of all shards, and those that are stored; of a shard that tunes first, those of its tuning
    total: int
    done: int

    @property
    def failed(self) -> dict[str, int]:
        """Status -> failed trials, the most frequent first."""
        counts = sum((Counter(dict(shard.failed)) for shard in self.shards), Counter[str]())
        return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))

    @property
    def rate(self) -> float:
        """Trials per second of all processes that run."""
        return sum(shard.rate for shard in self.shards if shard.state == RUNNING)

    @property
    def left_seconds(self) -> float | None:
        """Time until the last running process ends [s]; None where none runs or one has finished no trial yet."""
        times = [shard.left_seconds for shard in self.shards if shard.state == RUNNING]
        return None if not times or None in times else max(time for time in times if time is not None)

    @property
    def not_computed(self) -> int:
        """Number of missing trials that no process computes at present."""
        return sum(shard.total - shard.done for shard in self.shards if shard.state != RUNNING)

    def to_json(self) -> dict[str, Any]:
        """Return everything as plain data."""
        means = [
            {"point": point, "method": method, "n": mean.n, "n_other": mean.n_other}
            | {"mean": finite(mean.mean if mean.n else math.nan), "se": finite(mean.se)}
            for point, method, mean in self.means
        ]
        return {
            "name": self.name,
            "directory": str(self.directory),
            "total": self.total,
            "done": self.done,
            "failed": self.failed,
            "rate": self.rate,
            "left_seconds": self.left_seconds,
            "not_computed": self.not_computed,
            "metric": self.metric,
            "means": means,
            "shards": [
                {**vars(shard), "failed": dict(shard.failed), "runs": shard.runs and list(shard.runs)}
                for shard in self.shards
            ],
        }

    def __str__(self) -> str:
        return "\n".join([_head(self), *_shard_lines(self.shards), *_mean_lines(self), *_next_lines(self)])


def read_status(directory: str | Path, *, now: datetime | None = None) -> ExperimentStatus:
    """Read how far an experiment is; any machine that sees the directory may do so.

    Where both the directory and its shards have files, the newest file decides which of them are shown; of several
    divisions into shards, which compute the same runs, only the newest one is.
    """
    place, now = Path(directory), now or datetime.now(UTC)
    whole = read(place)
    found = {shard: data for shard, path in shards_in(place, FILE).items() if (data := read(path)) is not None}
    if whole is None and not found:
        raise MissingError(f"{place}: there is no {FILE}; `rmpc-bench run` writes it while it computes")
    newest = max(found, key=lambda shard: _updated(found[shard]), default=None)
    if newest is None or (whole is not None and _updated(whole) >= _updated(found[newest])):
        assert whole is not None
        return _status(place, whole, [_shard_status("", whole, now)], [whole])
    every = [Shard(number, newest.total) for number in range(1, newest.total + 1)]
    files = {shard: found[shard] for shard in every if shard in found}
    shards = [
        _shard_status(shard.name, files[shard], now) if shard in files else _absent(shard, found[newest])
        for shard in every
    ]
    return _status(place, found[newest], shards, files.values())


def _status(
    directory: Path, first: Mapping[str, Any], shards: Sequence[ShardStatus], files: Iterable[Mapping[str, Any]]
) -> ExperimentStatus:
    means: dict[tuple[str, str], RunningMean] = {}
    for each in (each for data in files for each in data.get("means", [])):
        mean = RunningMean(each["n"], _float(each["mean"]), _float(each["m2"]), each["n_other"])
        key = each["point"], each["method"]
        means[key] = means.get(key, RunningMean()).joined(mean)
    return ExperimentStatus(
        name=first["name"],
        directory=directory,
        shards=tuple(shards),
        metric=first["metric"],
        means=tuple((*key, mean) for key, mean in means.items()),
        total=sum(shard.total for shard in shards),
        done=sum(shard.done for shard in shards),
    )


def _absent(shard: Shard, newest: Mapping[str, Any]) -> ShardStatus:
    """Return the status of a shard without a file, as far as that of another shard of the division tells it."""
    n_runs, n_here = newest["n_runs"], newest["runs"][1] - newest["runs"][0]
    tunes = newest.get("stage", "")
    n_columns = newest["all_trials"] // n_runs if tunes else newest["total"] // max(n_here, 1)
    runs = shard.runs(n_runs)
    return ShardStatus(shard.name, ABSENT, (runs.start, runs.stop), n_columns * len(runs), 0, {})


def _shard_status(name: str, data: Mapping[str, Any], now: datetime) -> ShardStatus:
    age = max((now - _updated(data)).total_seconds(), 0.0)
    state = _state(data, age)
    return ShardStatus(
        name=name,
        state=state,
        runs=(data["runs"][0], data["runs"][1]),
        **{key: data[key] for key in ("total", "done", "failed", "host", "pid", "rate", "why")},
        age_seconds=age,
        left_seconds=data["left_seconds"] if state == RUNNING else None,
        stage=data.get("stage", ""),
    )


def _state(data: Mapping[str, Any], age: float) -> str:
    """Return the state of a writer; it may have died without a last file."""
    if data["state"] == RUNNING:
        # A process of the same number on another machine says nothing.
        if data["host"] == platform.node() and age > data["every"] and not _is_alive(data["pid"]):
            return KILLED
        return STALE if age > max(STALE_AFTER, 10.0 * data["every"]) else RUNNING
    if data["state"] == FINISHED and data["done"] < data["total"]:
        return INCOMPLETE
    return str(data["state"])


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def _updated(data: Mapping[str, Any]) -> datetime:
    return datetime.fromisoformat(data["updated"])


def _float(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _head(status: ExperimentStatus) -> str:
    share = f" ({100.0 * status.done / status.total:.0f} %)" if status.total else ""
    texts = [f"{status.done} of {status.total} trials{share}", _failed_text(status.failed)]
    if status.rate:
        texts.append(f"{status.rate:.3g} trials/s")
    if status.left_seconds is not None:
        texts.append(f"{time_text(status.left_seconds)} left")
    if status.not_computed:
        texts.append(f"{status.not_computed} missing trials that no process computes")
    return f"{status.name}   {', '.join(texts)}   {status.directory}"


def _failed_text(failed: Mapping[str, int]) -> str:
    words = ", ".join(f"{word} {n}" for word, n in failed.items())
    return f"{sum(failed.values())} failed" + (f" ({words})" if words else "")


def time_text(seconds: float) -> str:
    """Write a time with its largest unit.

    Examples
    --------
    >>> time_text(42.0), time_text(600.0), time_text(9000.0), time_text(200000.0)
    ('42 s', '10 min', '2.5 h', '2.3 d')
    """
    for limit, size, unit, digits in ((120.0, 1.0, "s", 0), (7200.0, 60.0, "min", 0), (172800.0, 3600.0, "h", 1)):
        if seconds < limit:
            return f"{seconds / size:.{digits}f} {unit}"
    return f"{seconds / 86400.0:.1f} d"


def _shard_lines(shards: Sequence[ShardStatus]) -> list[str]:
    rows = [("", "runs", "trials", "failed", "")] + [
        (
            shard.name,
            "-" if shard.runs is None or shard.runs[0] == shard.runs[1] else f"{shard.runs[0]} to {shard.runs[1] - 1}",
            f"{shard.done} of {shard.total}",
            str(sum(shard.failed.values())),
            _state_text(shard) + (f"; {shard.stage}" if shard.stage else ""),
        )
        for shard in shards
    ]
    return ["", *_table(rows)]


def _state_text(shard: ShardStatus) -> str:
    process = f"{shard.host}, process {shard.pid}"
    ago = f"{time_text(shard.age_seconds)} ago"
    return {
        RUNNING: f"running on {process}"
        + ("" if shard.left_seconds is None else f", {time_text(shard.left_seconds)} left"),
        KILLED: f"killed: {process} has ended early, last file {ago}",
        STALE: f"stale: no new file from {process} for {time_text(shard.age_seconds)}",
        ABSENT: "no file: not started, or lost",
        INCOMPLETE: f"incomplete, {ago}",
        FINISHED: f"finished {ago}",
    }.get(shard.state, f"{shard.state} ({shard.why}), {ago}")


def _next_lines(status: ExperimentStatus) -> list[str]:
    """Say which command continues, where something is missing and not only waits for other jobs."""
    states, run = {shard.state for shard in status.shards}, "`rmpc-bench run CONFIG"
    output = f"-o {quote(str(status.directory))}"
    if not any(shard.name for shard in status.shards):
        return [] if states <= {RUNNING, FINISHED} else ["", "the same `rmpc-bench run` command continues"]
    if states == {FINISHED}:
        return ["", f"`rmpc-bench merge {quote(str(status.directory))}` joins the shards"]
    if states <= {RUNNING, FINISHED} or (RUNNING in states and states <= {RUNNING, FINISHED, ABSENT}):
        return []
    return [
        "",
        f"{run} --shard I/N {output}` continues a shard, {run} --missing {output}` computes all that is missing",
    ]


def _mean_lines(status: ExperimentStatus) -> list[str]:
    """Show the means so far; of a large sweep those that are least certain."""
    known = [(point, method, mean) for point, method, mean in status.means if mean.n]
    shown = known
    if len(known) > MOST_ROWS:
        shown = sorted(known, key=lambda each: -_relative(each[2]))[:MOST_ROWS]
    if not shown:
        return []
    rows = [(status.metric, "mean so far", "standard error", "trials")] + [
        (
            f"{method}   {point}".strip(),
            plain(short(mean.mean, 4)),
            f"{100.0 * _relative(mean):.2g} %" if math.isfinite(_relative(mean)) else "-",
            str(mean.n) + (f" (and {mean.n_other} without a value)" if mean.n_other else ""),
        )
        for point, method, mean in shown
    ]
    more = [f"the {MOST_ROWS} of {len(known)} means with the largest standard error; --json shows all"]
    return ["", *_table(rows), *(more if len(known) > MOST_ROWS else [])]


def _relative(mean: RunningMean) -> float:
    """Return the standard error as a share of the mean; inf where there is none."""
    return mean.se / abs(mean.mean) if mean.n > 1 and mean.mean else math.inf


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "    " + "   ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
