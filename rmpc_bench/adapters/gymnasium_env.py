"""A configuration as an environment of Gymnasium, for training with other tools."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.identity import chosen_point
from rmpc_bench.config.load import load_config
from rmpc_bench.extras import library
from rmpc_bench.numerics.linalg import as_covariance
from rmpc_bench.simulation.episode import Episode, Sample
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Array, DesignError, Method, PlantInfo, Status
from rmpc_bench.types.errors import unknown

LARGEST_RUN = 2**31
"""Training runs have indices below it."""
WEIGHTS = ("Q", "R_u", "R_du", "failure")


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
    r(k + preview - 1) and the previous input u(k-1), which is 0 at k = 0.  The action is the input u(k).  In place of a
    missing measurement the last one is observed, before the first one the reference.

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
    limits : lower and upper limits of the action; those of the plant unless given.  An action beyond them, or beyond
        the bounds of the plant, is clipped: cost, estimator and observation have the input that acts
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
    experiment, pair = chosen(config, method, at or {})
    costs = EpisodeCost.of(cost or {"Q": 1.0}, experiment.plant.ny, experiment.plant.nu)
    space = library("gymnasium", "spaces").Box
    made = environment_class(library("gymnasium").Env)
    return made(experiment, pair, costs, preview, limits, space)


@dataclass(frozen=True)
class EpisodeCost:
    """Weights of the cost of a sample, and the cost of a failed run."""

    Q: Float[Array, "ny ny"]
    R_u: Float[Array, "nu nu"]
    R_du: Float[Array, "nu nu"]
    failure: float

    @classmethod
    def of(cls, given: Mapping[str, Any], ny: int, nu: int) -> EpisodeCost:
        """Expand numbers and diagonals."""
        for name in given:
            if name not in WEIGHTS:
                raise DesignError(unknown(name, WEIGHTS, "weight"), "cost")
        Q, R_u, R_du = (
            as_covariance(given.get(name, 0.0), n, "cost") for name, n in zip(WEIGHTS[:3], (ny, nu, nu), strict=True)
        )
        return cls(Q, R_u, R_du, float(given.get("failure", 0.0)))

    def __call__(self, sample: Sample, u: Array, u_previous: Array) -> float:
        """Return the cost of sample k with the input u(k)."""
        e, du = sample.y_true - sample.r[0], u - u_previous
        return float(e @ self.Q @ e + u @ self.R_u @ u + du @ self.R_du @ du)


def chosen(
    config: ExperimentConfig | str | Path, method: str | None, at: Mapping[str, str]
) -> tuple[Experiment, Method | None]:
    """Return the experiment of a point of a configuration, and the method of a name."""
    config = config if isinstance(config, ExperimentConfig) else load_config(config)
    experiment = chosen_point(config.points, at).experiment
    if method is not None and method not in config.methods:
        raise DesignError(unknown(method, config.methods, "method"), "method")
    if experiment.plant.recorded is not None:
        raise DesignError("the plant replays recorded runs: no action can change them", "plant")
    for design in (experiment.plant, *(each.estimator for each in experiment.methods)):
        design.warm_up()
    return experiment, None if method is None else experiment.method(method)


class Episodes:
    """The plant of an experiment; see `rmpc_bench.adapters.gymnasium.env`."""

    np_random: np.random.Generator
    u: Array
    y: Array

    metadata: Mapping[str, Any] = {"render_modes": []}
    render_mode = None

    def __init__(
        self, experiment: Experiment, method: Method | None, cost: EpisodeCost, preview: int, limits: Any, Box: Any
    ) -> None:
        self.experiment, self.method, self.cost, self.preview = experiment, method, cost, preview
        nu = experiment.plant.nu
        low, high = PlantInfo.of(experiment.plant).limits.u if limits is None else limits
        self.low, self.high = (np.broadcast_to(np.asarray(each, dtype=float), (nu,)) for each in (low, high))
        self.action_space = Box(self.low, self.high, (nu,), np.float64)
        n = len(self._start(experiment.n_runs))
        self.observation_space = Box(-np.inf, np.inf, (n,), np.float64)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start a run; see the class."""
        super().reset(seed=seed)  # type: ignore[misc]
        run = (options or {}).get("run")
        if run is None:
            run = int(self.np_random.integers(self.experiment.n_runs, LARGEST_RUN))
        return self._start(int(run)), self._info()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Apply u(k); the reward is that of sample k."""
        u = np.clip(np.asarray(action, dtype=float).reshape(self.low.shape), self.low, self.high)
        before, u_previous = self.episode.sample, self.u
        sample, self.u = self.episode.step(u), self.episode.u
        cost = self.cost(before, self.u, u_previous)
        failed = sample.status != Status.OK
        cost += self.cost.failure if failed else 0.0
        return self._seen(), -cost, failed, not failed and self.episode.is_over, self._info()

    def _start(self, run: int) -> Array:
        self.episode = Episode(self.experiment, run, self.method, preview=self.preview)
        self.u, self.y = np.zeros(self.experiment.plant.nu), self.episode.sample.r[0].copy()
        return self._seen()

    def _seen(self) -> Array:
        sample = self.episode.sample
        self.y = np.where(np.isnan(sample.y), self.y, sample.y)
        first = self.y if sample.x_hat is None else sample.x_hat
        return np.concatenate([first, sample.r.ravel(), self.u])

    def _info(self) -> dict[str, Any]:
        """Return the index of the run and what is not to be observed: the true state and output."""
        sample, run = self.episode.sample, self.episode.run
        return {
            "run": run,
            "in_experiment": run < self.experiment.n_runs,
            "k": sample.k,
            "status": sample.status.word,
            "message": sample.message,
            "x": sample.x,
            "y_true": sample.y_true,
        }


@cache
def environment_class(base: type) -> type:
    """Return the class of the environments, derived from `gymnasium.Env`."""
    return type("ExperimentEnv", (Episodes, base), {"__doc__": Episodes.__doc__})
