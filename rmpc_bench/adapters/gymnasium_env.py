"""A configuration as an environment of Gymnasium, for training with other tools."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench.extras import library

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig


def env(
    config: ExperimentConfig | str | Path,
    method: str | None = None,
    *,
    cost: Mapping[str, Any] | None = None,
    preview: int = 1,
    limits: tuple[Any, Any] | None = None,
    at: Mapping[str, str] | None = None,
) -> Any:
    """Return a `gymnasium.Env` with plant, noise, reference and uncertainty of an experiment.

    The observation is the measurement y(k), or with `method` the estimate x_hat(k), then the reference r(k), ..,
    r(k + preview - 1) and the previous input u(k-1), which is 0 at k = 0.  The action is the input u(k).

    ``reset(options={"run": i})`` starts run i of the experiment with the random numbers that it has there.  Any other
    `reset` starts a run that the experiment does not have: its index is at least the number of runs, and comes from the
    seed of `reset`.

    Parameters
    ----------
    config : a configuration, or its file
    method : name of the method whose estimator is used; None to observe y
    cost : weights of the cost (y - r)' Q (y - r) + u' R_u u + du' R_du du of a sample, with the output y without
        measurement noise and the change du of the input, and the number `failure`, which is added where the run fails;
        ``{"Q": 1}`` unless given.  The reward is minus this cost.
    preview : number of samples of the reference, r(k) included
    limits : lower and upper limits of the action; those of the plant unless given
    at : path of the sweep -> value, for one of its points; the first point unless given

    Raises
    ------
    DesignError
        If there is no such method, point or weight, or recorded runs are the plant.

    Examples
    --------
    >>> import numpy as np
    >>> made = env("configs/quickstart.yaml")
    >>> observation, info = made.reset(options={"run": 3})
    >>> observation, reward, terminated, truncated, info = made.step(np.zeros(1))
    >>> info["run"], terminated, truncated
    (3, False, False)
    """
    from rmpc_bench.adapters.episode_env import EpisodeCost, chosen, environment_class

    experiment, estimator = chosen(config, method, at or {})
    costs = EpisodeCost.of(cost or {"Q": 1.0}, experiment.plant.ny, experiment.plant.nu)
    space = library("gymnasium", "spaces").Box
    made = environment_class(library("gymnasium").Env)
    return made(experiment, estimator, costs, preview, limits, space)
