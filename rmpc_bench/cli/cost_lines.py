"""Measured time and memory of an experiment, for `rmpc-bench check --deep` and `--shards`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rmpc_bench.cli.own_code import imported
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.execution.pilot import PilotError, measure, runs_of_shard

RESERVE = 1.5
"""Ratio of the time limit of a shard to its estimated time, before a minute is added."""
MINUTE = 60.0


def measured_lines(path: Path, config: ExperimentConfig, allow_code: Sequence[Path], shards: int | None) -> list[str]:
    """Measure an experiment and return the lines on time, memory and shards.

    Parameters
    ----------
    path, config : the configuration
    allow_code : Python files that may be loaded besides
    shards : number of shards; None for none
    """
    try:
        found = measure(path, allow_code, imported)
    except PilotError as error:
        return [f"  measured      nothing: the first runs could not be computed ({error})"]
    workers = config.execution.workers
    parts = f"{found.start:.1f} s start, {found.n_runs * found.per_run:.1f} s runs, {found.report:.1f} s report"
    lines = [
        f"  measured      about {_time(found.total)} of CPU time, from {found.n_pilot} runs: {parts}",
        f"                about {_time(found.elapsed(workers))} on {workers} processes with a core each",
        f"                about {found.megabytes:.0f} MB of memory in the process that writes the report",
    ]
    if shards is not None:
        each = found.of_shard(shards)
        limit = MINUTE * math.ceil((RESERVE * each + MINUTE) / MINUTE)
        lines += [
            f"  shards        {shards}, each of at most {runs_of_shard(found.n_runs, shards)} runs: "
            f"about {_time(each)} of CPU time on one process",
            f"                time limit for a batch script: {clock(limit)} ({RESERVE:g} times this, and a minute)",
        ]
    return lines


def _time(seconds: float) -> str:
    """Write a time with two digits."""
    if seconds < 2 * MINUTE:
        return f"{seconds:.2g} s" if seconds < 100 else f"{seconds:.0f} s"
    minutes = seconds / MINUTE
    return f"{minutes:.0f} min" if minutes < 2 * MINUTE else f"{minutes / MINUTE:.1f} h"


def clock(seconds: float) -> str:
    """Write a time as a batch scheduler takes it.

    Examples
    --------
    >>> clock(5400), clock(360_000)
    ('01:30:00', '100:00:00')
    """
    minutes = round(seconds / MINUTE)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:00"
