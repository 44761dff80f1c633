"""Time and memory that an experiment takes, estimated before any run."""

from __future__ import annotations

import math

from rmpc_bench.config.experiment_config import ExperimentConfig

START = 2.0
"""Starting and reporting [s]."""
STEP_OF_A_BLOCK, STEP_OF_A_RUN = 5e-5, 2.5e-6
"""Time of a step, per block and per run [s], to which slow designs add their `cost_per_step`."""
MEGABYTES_PER_NUMBER = 8e-6


def seconds(config: ExperimentConfig) -> float:
    """Estimate the computing time [s]; trials that points of a sweep share count once.

    Parameters
    ----------
    config : from `load_config`
    """
    seen, total = set[str](), 0.0
    for point in config.points if "runs" in config.evaluate else ():
        experiment = point.experiment
        n_blocks = math.ceil(experiment.n_runs / config.execution.block)
        for name, key in point.method_keys.items():
            if key not in seen:
                method = experiment.method(name)
                designs = (experiment.plant, method.estimator, method.controller)
                per_run = STEP_OF_A_RUN + sum(design.cost_per_step for design in designs)
                total += experiment.n_steps * (STEP_OF_A_BLOCK * n_blocks + per_run * experiment.n_runs)
            seen.add(key)
    return math.ceil(START + total / config.execution.workers)


def megabytes(config: ExperimentConfig) -> float:
    """Estimate the memory of a process [MB]: twice the trajectories x, x_hat, w, v, y and u of a block.

    Parameters
    ----------
    config : from `load_config`
    """
    plant = config.experiment.plant
    width = 2 * plant.nx + plant.nw + plant.nv + plant.ny + plant.nu
    numbers = 2 * config.execution.block * config.experiment.n_steps * width
    return math.ceil(MEGABYTES_PER_NUMBER * numbers)
