"""Tuning on the command line: before the runs of an experiment, and in words."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rmpc_bench.cli.run_request import Request
    from rmpc_bench.config.experiment_config import ExperimentConfig


def tuned_config(
    request: Request, config: ExperimentConfig, directory: Path, n_runs: int | None = None
) -> ExperimentConfig:
    """Return a configuration with tuned values; those that are not known are found first.

    `n_runs` is the number of runs that a stopping rule has made; before them the regret is left for later.
    """
    if config.tuning is None:
        return config
    from rmpc_bench.execution.progress import choose
    from rmpc_bench.execution.tuning.tune import tuned

    return tuned(
        config,
        directory,
        shard=request.shard,
        only=request.only or None,
        means=request.means,
        progress=choose(request.how_progress),
        n_runs=n_runs,
    )


def tuning_line(config: ExperimentConfig, only: Collection[str] | None = None) -> list[str]:
    """Return what is still to be tuned of the methods that are computed, as one line; no line where nothing is."""
    if config.tuning is None:
        return []
    protocol = config.tuning.protocol
    names = dict.fromkeys(each.method for each in config.tuning.missing if only is None or each.method in only)
    if not names:
        return []
    tuning, tested = config.tuning.n_trials(list(names))
    points = f"{len(config.points)} points x " if config.paths else ""
    methods = f"{len(names)} method{'s' if len(names) > 1 else ''}"
    size = f"{points}{methods} x {protocol.budget} values x {protocol.runs} runs"
    return [f"at most {tuning:,} trials ({size})" + (f", and {tested:,} for the regret" if tested else "")]
