"""`rmpc-bench run` without a report: a shard, or --no-report."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rmpc_bench.cli import exits
from rmpc_bench.cli.tuning import tuned_config
from rmpc_bench.execution import progress_file
from rmpc_bench.execution.progress import choose
from rmpc_bench.execution.runner import compute
from rmpc_bench.results.results import load_experiment

if TYPE_CHECKING:
    from rmpc_bench.cli.run_request import Request
    from rmpc_bench.config.experiment_config import ExperimentConfig


def run_trials(request: Request, config: ExperimentConfig, directory: Path, started: float) -> int:
    """Compute the trials of a shard or of all runs, and say in one line what is stored; return the exit code.

    Failed runs of a shard count when the shards are joined.  `started` is a time of the monotonic clock [s].
    """
    config = tuned_config(request, config, directory)
    compute(
        config,
        directory,
        means=request.means,
        only=request.only or None,
        progress=choose(request.how_progress),
        shard=request.shard,
        missing=request.missing,
    )
    stop = None if config.stop is None else load_experiment(directory).stop
    if stop is not None:
        tuned_config(request, config, directory, stop.looks.wanted)
    place = request.place(directory)
    data = progress_file.read(place) or {}
    failed = data.get("failed", {})
    what = "trials" if request.shard is None else f"shard {request.shard.name}"
    texts = [f"{config.name}   {what} done in {time.monotonic() - started:.1f} s"]
    if data:
        first, end = data["runs"]
        runs = f"runs {first} to {end - 1}" if end > first else "no runs: there are more shards than runs"
        words = "".join(f", {word} {n}" for word, n in failed.items())
        texts.append(f"{runs}, {data['done']} of {data['total']} trials, {sum(failed.values())} failed{words}")
    click.echo("   ".join([*texts, str(place)]))
    if request.shard is not None:
        request.note(f"when all shards are finished: rmpc-bench merge {shlex.quote(str(directory))}")
    if request.shard is None and sum(failed.values()) > config.execution.max_failures:
        return exits.TOO_MANY_FAILURES
    return exits.STOP_UNMET if stop is not None and stop.is_unmet else 0
