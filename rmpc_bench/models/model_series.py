"""A design model over k as arrays, with the input and the root of its process noise.

Model   x(k+1) = A_k x(k) + B_k u(k) + f0_k + G_k w(k),  y(k) = C_k x(k) + d0_k + v(k);  w without its mean, with the
        covariance W_k = W_root W_root'.
Noise   An `UncertainModel` has G = Bw and its own w; any other model has G = I, and w has a coordinate for every state.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.uncertain_linear import DesignSystem, UncertainModel, design_systems
from rmpc_bench.numerics.intervals import Interval, Pairs, interval_of
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.window_posterior import WindowBounds, WindowStages, range_root
from rmpc_bench.types import Array, DesignError, Model


class ModelSeries(NamedTuple):
    """The design model over k; axis 0 has length 1 if nothing varies."""

    A: Float[Array, "k nx nx"]
    B: Float[Array, "k nx nu"]
    C: Float[Array, "k ny nx"]
    f0: Float[Array, "k nx"]
    d0: Float[Array, "k ny"]
    Q_w: Float[Array, "k nx nx"]
    R_v: Float[Array, "k ny ny"]
    G: Float[Array, "k nx nw"]  # input of the process noise
    W_root: Float[Array, "k nw nr"]  # root of its covariance

    def between(self, name: str, first: int, stop: int) -> Array:
        """Return a matrix at the samples first..stop-1."""
        series: Array = getattr(self, name)
        if len(series) > 1:
            return series[first:stop]
        return np.broadcast_to(series[0], (stop - first, *series.shape[1:]))

    def stages(self, first: int, last: int) -> WindowStages:
        """Return the matrices of the window first..last."""
        A, G, W_root = (self.between(name, first, last) for name in ("A", "G", "W_root"))
        C, R_v = (self.between(name, first, last + 1) for name in ("C", "R_v"))
        return WindowStages(A, W_root, G @ W_root, C, R_v)

    def filtered(
        self,
        first: int,
        x: Float[Array, "runs nx"],
        c: Float[Array, "runs moves nx"],
        y: Float[Array, "runs points ny"],
        L: Float[Array, "points nx ny"],
    ) -> tuple[Float[Array, "runs points nx"], Float[Array, "runs points ny"]]:
        """Return predictions and innovations of a filter with the gains L that starts with x at a sample.

        Between the samples x(j+1) = A_j x(j) + c_j; the innovation of a missing y is 0.
        """
        A, C = self.between("A", first, first + len(L) - 1), self.between("C", first, first + len(L))
        states, innovations = [x], []
        for j in range(len(L)):
            e = y[:, j] - mv(C[j], states[-1])
            innovations.append(np.where(np.isnan(y[:, j]), 0.0, e))
            if j < c.shape[1]:
                states.append(mv(A[j], states[-1] + mv(L[j], innovations[-1])) + c[:, j])
        return np.stack(states, axis=1), np.stack(innovations, axis=1)

    def filter_map(self, L: Float[Array, "points nx ny"]) -> Float[Array, "answers data"]:
        """Return `filtered` of a constant model as a matrix: [x; c; y] -> [predictions; innovations]."""
        points, nx, ny = L.shape
        data = np.eye(nx * points + ny * points)
        x, c, y = data[:, :nx], data[:, nx : nx * points], data[:, nx * points :]
        found = self.filtered(0, x, c.reshape(len(data), -1, nx), y.reshape(len(data), -1, ny), L)
        return np.ascontiguousarray(np.hstack([each.reshape(len(data), -1) for each in found]).T)


def model_series(model: Model, n_steps: int, *, in_states: bool) -> ModelSeries:
    """Return the design model at k = 0..N; the noise of an `UncertainModel` is in coordinates of x if `in_states`."""
    systems = design_systems(model, n_steps)
    systems = systems[:1] if all(each is systems[0] for each in systems) else systems
    now = [each.nominal for each in systems]
    names = ("A", "B", "C", "f0", "d0", "Q_w", "R_v")
    given = {name: np.array([getattr(each, name) for each in now]) for name in names}
    if in_states:
        inputs, covs = [np.eye(each.nx) for each in now], [each.Q_w for each in now]
    else:
        inputs, covs = [each.m.Bw for each in systems], [each.W for each in systems]
    roots = [range_root(each) for each in covs]
    rank = max(each.shape[1] for each in roots)
    padded = [np.pad(each, ((0, 0), (0, rank - each.shape[1]))) for each in roots]
    return ModelSeries(**given, G=np.array(inputs), W_root=np.array(padded))


# Bounds of the noises and the states of a design model, for the windows of a moving-horizon estimator.


def window_bounds(
    model: Model, series: ModelSeries, n_steps: int, *, w: Pairs | None, v: Pairs | None, x: Pairs | None
) -> WindowBounds:
    """Return bounds of w, v and x; means are included in the given bounds of the noises, not in those returned."""
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
