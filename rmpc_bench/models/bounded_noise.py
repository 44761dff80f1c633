"""Bounds of the noises and the states of a design model, for the windows of a moving-horizon estimator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.design_noise import DesignSystem, design_systems
from rmpc_bench.models.model_series import ModelSeries
from rmpc_bench.models.uncertain_linear import UncertainModel
from rmpc_bench.numerics.intervals import Interval, Pairs, interval_of
from rmpc_bench.numerics.window_bounds import WindowBounds
from rmpc_bench.types import Array, DesignError, Model


def window_bounds(
    model: Model, series: ModelSeries, n_steps: int, *, w: Pairs | None, v: Pairs | None, x: Pairs | None
) -> WindowBounds:
    """Return bounds of process noise, measurement noise and state, those of the noises without their means.

    Parameters
    ----------
    model : design model
    series : the same over k, with the coordinates of the process noise that `w` bounds
    n_steps : number of control periods N
    w, v, x : bounds of the noises, means included, and of the state

    Raises
    ------
    DesignError
        If bounds do not fit, or no noise satisfies them.
    """
    nw, ny, nx = series.W_root.shape[1], *series.C.shape[1:]
    w_mean, v_mean = np.zeros(nw), model.v_law[0]
    if w is not None:
        w_mean = model.w_law[0]
    if isinstance(model, UncertainModel):
        v_mean = series.d0[0]
        if v is not None and np.ptp(series.d0, axis=0).any():
            raise DesignError(
                "the mean of the measurement noise depends on k; only noise of a constant mean is bounded", "v"
            )
        if w is not None:
            _refuse_other_noise(design_systems(model, n_steps))
    return WindowBounds(
        _checked(interval_of(w, nw, "w"), w_mean, np.abs(series.W_root).max(axis=2, initial=0.0), "w"),
        interval_of(x, nx, "x"),
        _checked(interval_of(v, ny, "v"), v_mean, series.R_v.diagonal(axis1=1, axis2=2), "v"),
    )


def _refuse_other_noise(systems: Sequence[DesignSystem]) -> None:
    """Refuse process noise that is not Bw w alone."""
    for each in systems:
        if (each.m.Bv.dot(each.V).dot(each.m.Bv.T) != 0.0).any():
            raise DesignError(
                "the process noise of this model also has the part Bv v; only noise Bw w can be bounded", "w"
            )


def _checked(interval: Interval, mean: Float[Array, " n"], spread: Float[Array, "k n"], key: str) -> Interval:
    """Return bounds of a noise without its mean; refuse those that a coordinate without spread violates."""
    for i in np.flatnonzero(~spread.any(axis=0)):
        if not interval.low[i] <= mean[i] <= interval.high[i]:
            ends = f"[{interval.low[i]:g}, {interval.high[i]:g}]"
            text = f"coordinate {i} of the noise is always {mean[i]:g} in the design model, outside its bounds {ends}"
            raise DesignError(text, key)
    return interval.shifted(-mean)
