"""Predictors and updaters of Stone Soup as estimators of single runs.

The time of sample k is a fixed date plus k Ts, rounded to microseconds as Stone Soup's times are.  A sum of rounded
steps would drift by 1 ms in 3000 samples of 1/30 s.  x_hat(0) uses y(0) without a prediction.  u(k-1) is the
`control_input` of the predictor.  Particles and ensembles draw from the generator of the run.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from rmpc_bench.components.designs import class_around
from rmpc_bench.components.user_runs import drawing_from
from rmpc_bench.extras import library

EPOCH = datetime(2000, 1, 1)
"""Time of y(0)."""


def stonesoup_estimator(function: Callable[..., Any] | None = None, /, **declared: Any) -> Any:
    """Make a single-run estimator of a function that returns a predictor and an updater.

    Parameters
    ----------
    function : takes standard names and keys; it returns (predictor, updater), or (predictor, updater, prior) where the
        prior is not GaussianState(x0, P0), such as a ParticleState
    declared : attributes of the class, such as ``deviation=True``
    """
    return class_around(StonesoupEstimator, function, **declared)


class StonesoupEstimator:
    """Runs an updater with y(0), then a predictor with u(k-1) and the updater with y(k)."""

    returns = "a predictor and an updater, or these and a prior"

    @staticmethod
    def fits(made: Any) -> bool:
        """Whether a function has returned a predictor and an updater."""
        pair = isinstance(made, tuple) and len(made) in (2, 3)
        return pair and hasattr(made[0], "predict") and hasattr(made[1], "update")

    def __init__(self, made: Any, model: Any, Ts: float, x0: Any, P0: Any, rng: np.random.Generator) -> None:
        if abs(timedelta(seconds=Ts).total_seconds() - Ts) > 1e-3 * Ts:
            raise ValueError(f"Stone Soup counts in microseconds, which are too long for Ts = {Ts:g} s")
        predictor, updater, *prior = made
        _connect_input(predictor, updater, model)
        self._predict, self._update = predictor.predict, updater.update
        if prior:  # particles and ensembles draw random numbers
            self._predict, self._update = drawing_from(rng, self._predict), drawing_from(rng, self._update)
        states = library("stonesoup", "types.state")
        self._input, self._last = states.State, prior[0] if prior else states.GaussianState(x0, P0)
        self._last.timestamp, self._Ts = EPOCH, Ts
        self._inputs: list[Any] = []
        self._detection = library("stonesoup", "types.detection").Detection
        self._hypothesis = library("stonesoup", "types.hypothesis").SingleHypothesis

    def update(self, y: Any, u_previous: Any, k: int) -> Any:
        """Return x_hat(k) and P."""
        now = EPOCH + timedelta(seconds=k * self._Ts)
        if u_previous is not None:
            self._inputs.append((now, self._input(u_previous, timestamp=now)))
        while self._inputs:  # one that has failed is made with the next one
            time, u = self._inputs[0]
            self._last = self._predict(self._last, timestamp=time, control_input=u)
            del self._inputs[0]
        self._last = self._update(self._hypothesis(self._last, self._detection(y, timestamp=now)))
        # It holds the prediction, which holds the estimate before: the whole past of the run.
        self._last.hypothesis = None
        return np.asarray(self._last.mean).ravel(), self._last.covar


def _connect_input(predictor: Any, updater: Any, model: Any) -> None:
    """Refuse models of Stone Soup that ignore a part of the design model; a user's own models may have it."""
    moves, measures = (
        type(each).__module__.startswith("stonesoup.")
        for each in (predictor.transition_model, updater.measurement_model)
    )
    if (moves and np.any(getattr(model, "f0", 0))) or (measures and np.any(getattr(model, "d0", 0))):
        raise ValueError("the models ignore f0 and d0 of the design model: write @stonesoup_estimator(deviation=True)")
    control = getattr(predictor, "control_model", None)
    if np.any(getattr(control, "control_matrix", control is not None)):
        return
    if np.any(getattr(model, "B", 0)) and (moves or control is None):
        raise ValueError("the predictor ignores the input: give it control_model=LinearControlModel(model.B)")
    if control is not None:
        # The predictor has made one of zeros for two inputs, whatever the number of inputs is.
        control.control_matrix, control.control_noise = np.zeros((model.nx, model.nu)), np.zeros((model.nu, model.nu))
