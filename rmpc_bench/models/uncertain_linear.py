"""Uncertain linear design model: nominal matrices, bounds of the uncertainty, noises.

Model   The system of uncertain_system.py with white noises: w has mean wbar and covariance W, v has mean vbar and
        covariance V, and the cross-covariance is E (w - wbar)(v - vbar)' = S.
        Methods without uncertainty use the nominal model x(k+1) = A x + B u + f0 + w~, y = C x + d0 + v~, with
        f0 = Bw wbar + Bv vbar, d0 = Dw wbar + Dv vbar and the covariances of w~ = Bw w + Bv v and v~ = Dw w + Dv v.
Source  souto2011, (8), (9), (20), (21).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import SAME_SCALE, NoiseScale
from rmpc_bench.models.uncertain_system import (
    SIZES,
    Matrices,
    OfSystem,
    UncertainSystem,
    takes_matrices,
    uncertain_system,
)
from rmpc_bench.numerics.intervals import Interval, Pairs, interval_of
from rmpc_bench.numerics.linalg import as_covariance, as_vector, is_possible, mv, symmetrise
from rmpc_bench.numerics.window_posterior import WindowBounds, WindowStages, range_root
from rmpc_bench.types import Array, DesignError, Matrix, Model, SystemMatrix, does_not_fit

EQUATION = r"""x_{k+1} = (A + H_A F_x G_x) x_k + B u_k + (B_w + H_{Bw} F_w G_w) w_k + (B_v + H_{Bv} F_v G_v) v_k, \quad
y_k = (C + H_C F_x G_x) x_k + D u_k + (D_w + H_{Dw} F_w G_w) w_k + (D_v + H_{Dv} F_v G_v) v_k"""


@dataclass(frozen=True, eq=False)
class UncertainModel(OfSystem, Model):
    """An uncertain linear system with the means and covariances of its noises."""

    system: UncertainSystem
    W: Float[Array, "nw nw"]
    V: Float[Array, "nv nv"]
    S: Float[Array, "nw nv"]
    wbar: Float[Array, " nw"]
    vbar: Float[Array, " nv"]

    varies = property(lambda self: self.system.varies)
    feedthrough = property(lambda self: "D" in self.system.active)
    w_law = property(lambda self: (self.wbar, self.W))
    v_law = property(lambda self: (self.vbar, self.V))

    @property
    def noise(self) -> tuple[Float[Array, " nn"], Float[Array, "nn nn"]]:
        """Mean and covariance of [w; v]."""
        joint = np.block([[self.W, self.S], [self.S.T, self.V]])
        return np.concatenate([self.wbar, self.vbar]), joint

    def at(self, k: int) -> LinearModel:
        """Return the nominal model at k."""
        return self._nominal_at(self.system.at(k)) if self.varies else self._always

    @cached_property
    def _always(self) -> LinearModel:
        return self._nominal_at(self.system.at(0))

    def _nominal_at(self, m: Matrices) -> LinearModel:
        mean, joint = self.noise
        B, D = np.hstack([m.Bw, m.Bv]), np.hstack([m.Dw, m.Dv])
        Q_w, R_v = symmetrise(B @ joint @ B.T), symmetrise(D @ joint @ D.T)
        return LinearModel(m.A, m.B, m.C, Q_w, R_v, S_wv=B @ joint @ D.T, f0=B @ mean, d0=D @ mean, D=m.D)


@takes_matrices
def design(
    n_steps: int,
    *,
    W: Matrix = 0.0,
    V: Matrix = 0.0,
    S: float | list[list[float]] = 0.0,
    wbar: float | list[float] = 0.0,
    vbar: float | list[float] = 0.0,
    scale: NoiseScale | None = None,
    **matrices: SystemMatrix,
) -> UncertainModel:
    """Uncertain linear model; `from: plant` uses the plant's matrices where none are given.

    A missing matrix is zero.  A list is a diagonal for A, W and V only.  Entries may depend on k.

    Parameters
    ----------
    n_steps : number of control periods N
    matrices : the matrices of the system
    W : (nw, nw) covariance of w
    V : (nv, nv) covariance of v
    S : (nw, nv) cross-covariance of w and v
    wbar : (nw,) mean of w
    vbar : (nv,) mean of v
    scale : factors on the standard deviations of w (`process`) and v (`measurement`), such as {measurement: 0.1}

    Raises
    ------
    DesignError
        If the sizes are inconsistent, or W, V and S do not form a joint covariance.
    """
    system = uncertain_system(n_steps, matrices)
    nw, nv = system.size("nw"), system.size("nv")
    cov_w, cov_v = as_covariance(W, nw, "W"), as_covariance(V, nv, "V")
    mean_w, mean_v = as_vector(wbar, nw, "wbar"), as_vector(vbar, nv, "vbar")
    cross, factor = _cross(S, cov_w, cov_v), scale or SAME_SCALE
    cov_w, cov_v = factor.process**2 * cov_w, factor.measurement**2 * cov_v
    return UncertainModel(system, cov_w, cov_v, factor.process * factor.measurement * cross, mean_w, mean_v)


def _cross(S: float | list[list[float]], W: Array, V: Array) -> Float[Array, "nw nv"]:
    """Expand a cross-covariance and check that the joint covariance is positive semidefinite."""
    shape = (len(W), len(V))
    try:
        given = np.array(S, dtype=float)
    except ValueError:
        raise DesignError("must be a list of rows of the same length", "S") from None
    cross = np.zeros(shape) if given.ndim == 0 and not given.any() else np.atleast_2d(given)
    if cross.shape != shape:
        raise DesignError(does_not_fit(cross.shape, shape), "S")
    if not is_possible(cross, W, V):
        raise DesignError("the joint covariance [W S; S' V] is not positive semidefinite", "S")
    return cross


# Design models of any kind in one form: the matrices and noises of an uncertain linear system at one k.
#
# Model   An `UncertainModel` is used as it is.  Any other model is written as a system without uncertainty,
#         x(k+1) = A x + B u + f0 + w, y = C x + d0 + v: Bw = I, Dv = I, Bv = 0, Dw = 0, H = 0, G = 0.


class DesignSystem(NamedTuple):
    """A design model at one k, written as an uncertain system with its noises."""

    nominal: LinearModel  # the nominal model, with the constant parts f0 and d0
    m: Matrices
    W: Float[Array, "nw nw"]
    V: Float[Array, "nv nv"]
    S: Float[Array, "nw nv"]
    wbar: Float[Array, " nw"]  # mean of w; zero for a model without uncertainty, whose f0 and d0 contain the means
    vbar: Float[Array, " nv"]


def design_systems(model: Model, n_steps: int, scale: float = 1.0) -> list[DesignSystem]:
    """Return the design model at k = 0..N, one shared object as long as nothing varies."""
    found: list[DesignSystem] = []
    if isinstance(model, UncertainModel):
        system = model.system.scaled(scale)
        noises = (model.W, model.V, model.S, model.wbar, model.vbar)
        for k in range(n_steps + 1 if system.varies else 1):
            found.append(DesignSystem(model.at(k), system.at(k), *noises))
        return found if system.varies else found * (n_steps + 1)
    for k in range(n_steps + 1):
        now = model.at(k)
        found.append(found[-1] if found and found[-1].nominal is now else _without_uncertainty(now))
    return found


def _without_uncertainty(now: LinearModel) -> DesignSystem:
    nx, ny = now.nx, now.ny
    sizes = {name: 1 for pair in SIZES.values() for name in pair} | {"nx": nx, "nu": now.nu, "ny": ny}
    sizes |= {"nw": nx, "nv": ny}
    zero = {name: np.zeros((sizes[rows], sizes[columns])) for name, (rows, columns) in SIZES.items()}
    m = Matrices(**{**zero, "A": now.A, "B": now.B, "C": now.C, "D": now.D, "Bw": np.eye(nx), "Dv": np.eye(ny)})
    return DesignSystem(now, m, now.Q_w, now.R_v, now.S_wv, np.zeros(nx), np.zeros(ny))


# A design model over k as arrays, with the input and the root of its process noise.
#
# Model   x(k+1) = A_k x(k) + B_k u(k) + f0_k + G_k w(k),  y(k) = C_k x(k) + d0_k + v(k);  w without its mean, with the
#         covariance W_k = W_root W_root'.
# Noise   An `UncertainModel` has G = Bw and its own w; any other model has G = I, and w has a coordinate per state.


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
