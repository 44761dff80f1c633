"""Time and memory that an experiment takes, estimated before any run."""

from __future__ import annotations

import math

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.engines.blocks import (
    STEP_OF_A_BLOCK,
    estimated_seconds,
    megabytes_of_a_run,
    usual_length,
)

START = 2.0
"""Starting and reporting [s]."""


def seconds(config: ExperimentConfig) -> float:
    """Estimate the computing time [s]; trials that points of a sweep share count once."""
    seen, total = set[str](), 0.0
    for point in config.points if "runs" in config.evaluate else ():
        experiment = point.experiment
        for name, key in point.method_keys.items():
            if key not in seen:
                n_blocks = math.ceil(experiment.n_runs / usual_length(experiment, name, config.execution.fixed_block))
                total += STEP_OF_A_BLOCK * experiment.n_steps * n_blocks
                total += estimated_seconds(experiment, name) * experiment.n_runs
            seen.add(key)
    return math.ceil(START + (total + _tuning_seconds(config)) / config.execution.workers)


def _tuning_seconds(config: ExperimentConfig) -> float:
    """Estimate the computing time of what is to be tuned on one process [s]."""
    if config.tuning is None:
        return 0.0
    total, seen, protocol = 0.0, set[str](), config.tuning.protocol
    n_tested = (protocol.budget + 1) * config.tuning.test_runs if config.tuning.regret else 0
    for search in config.tuning.missing:
        if search.key not in seen:
            experiment = config.points[search.number].experiment
            n_runs = protocol.budget * protocol.runs + n_tested
            n_blocks = n_runs / usual_length(experiment, search.method, config.execution.fixed_block) + protocol.budget
            total += STEP_OF_A_BLOCK * experiment.n_steps * n_blocks
            total += estimated_seconds(experiment, search.method) * n_runs
        seen.add(search.key)
    return total


def megabytes(config: ExperimentConfig) -> float:
    """Estimate the memory of a process [MB]: twice the trajectories x, x_hat, w, v, y and u of a block."""
    experiment, fixed = config.experiment, config.execution.fixed_block
    longest = max(usual_length(experiment, method.name, fixed) for method in experiment.methods)
    return math.ceil(longest * megabytes_of_a_run(experiment))
