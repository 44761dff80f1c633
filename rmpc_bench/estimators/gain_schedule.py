"""The filter shared by every estimator whose gains do not depend on the data.

Model   x_pred(k+1) = F_k x_pred(k) + B_k u(k) + K_k e(k),  x_hat(k) = x_pred(k) + L_k e(k),
        e(k) = y(k) - C_k x_pred(k);  K_k = F_k L_k for a filter, L_k = 0 for a one-step predictor.
Cost    five small matrix-vector products per run and step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.kl_ball import LARGEST, Inflation
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.riccati import error_radius, filter_step
from rmpc_bench.types import Array, DesignError, Estimate, Status

OK = np.int8(Status.OK)


class FilterState(NamedTuple):
    """What the next step needs."""

    x_pred: Float[Array, "runs nx"]
    e: Float[Array, "runs ny"]
    """Innovation of the last correction."""


@dataclass(frozen=True, eq=False)
class GainScheduleFilter:
    """A linear filter with precomputed gains; axis 0 of every array is k, a constant one has length 1.

    Parameters
    ----------
    x0 : (nx,) prediction before the first measurement
    F, B, C : (1 or samples, ...) model matrices
    K, L : (1 or samples, nx, ny) gains of the prediction and of the correction
    P : (1 or samples, nx, nx) covariance of x_hat - x
    extra : further series of the design, axis 0 = k
    """

    x0: Float[Array, " nx"]
    F: Float[Array, "kF nx nx"]
    B: Float[Array, "kB nx nu"]
    C: Float[Array, "kC ny nx"]
    K: Float[Array, "kK nx ny"]
    L: Float[Array, "kL nx ny"]
    P: Float[Array, "kP nx nx"]
    extra: Mapping[str, Array] = field(default_factory=dict)

    def init(self, n_runs: int) -> FilterState:
        """Start every run at ``x0``."""
        return FilterState(np.tile(self.x0, (n_runs, 1)), np.zeros((n_runs, self.C.shape[1])))

    def correct(self, k: int, state: FilterState, y: Float[Array, "runs ny"]) -> tuple[FilterState, Estimate]:
        """Use y(k): x_hat = x_pred + L e."""
        e = y - mv(_at(self.C, k), state.x_pred)
        x_hat = state.x_pred + mv(_at(self.L, k), e)
        return FilterState(state.x_pred, e), Estimate(x_hat, _at(self.P, k), None, np.full(len(y), OK), {"e": e})

    def predict(self, k: int, state: FilterState, u: Float[Array, "runs nu"]) -> FilterState:
        """Go to k+1: x_pred+ = F x_pred + B u + K e."""
        x_pred = mv(_at(self.F, k), state.x_pred) + mv(_at(self.B, k), u) + mv(_at(self.K, k), state.e)
        return FilterState(x_pred, state.e)

    def series(self) -> dict[str, Array]:
        """Gains and covariances over k, and rho, the spectral radius of F - K C, made here because few need it."""
        return {"K": self.K, "L": self.L, "P": self.P, "rho": error_radius(self.F, self.K, self.C), **self.extra}


def _at(A: Array, k: int) -> Array:
    """Entry k of a schedule; a constant one has length 1."""
    entry: Array = A[k] if len(A) > 1 else A[0]
    return entry


def riccati_schedule(
    model: LinearModel,
    n_steps: int,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    inflate: Callable[[int, Array], Inflation],
) -> GainScheduleFilter:
    """Run a Riccati recursion whose prediction covariance is replaced by ``inflate(k, P_pred)`` before it is used.

    Parameters
    ----------
    model : what the filter believes
    n_steps : N; gains are made for the samples k = 0..N
    x0 : (nx,) mean of the prediction of x(0)
    P0 : (nx, nx) its covariance
    inflate : maps (k, P_pred) to the covariance V to use and the multiplier theta that led to it

    Raises
    ------
    DesignError
        If the innovation covariance is singular at some step, or a covariance grows beyond 1e100.
    """
    P_pred, V, P, K, L, theta = [P0], [], [], [], [], []
    for k in range(n_steps + 1):
        try:
            inflation = inflate(k, P_pred[-1])
            step = filter_step(model.A, model.C, model.Q_w, model.R_v, inflation.V)
        except np.linalg.LinAlgError:
            _refuse_overflow(P_pred)
            raise DesignError(
                f"the covariance of the innovation is singular at k = {k}: give the model measurement noise"
            ) from None
        V.append(inflation.V)
        theta.append(inflation.theta)
        P.append(step.P)
        L.append(step.L)
        K.append(step.K)
        P_pred.append(step.P_next)
    _refuse_overflow(P_pred)
    extra = {"P_pred": np.array(P_pred[:-1]), "V": np.array(V), "theta": np.array(theta)}
    return GainScheduleFilter(
        x0, model.A[None], model.B[None], model.C[None], np.array(K), np.array(L), np.array(P), extra
    )


def _refuse_overflow(P_pred: list[Array]) -> None:
    """Insist on covariances that are numbers, and not so large that their gains are none."""
    fits = (np.abs(np.array(P_pred)) < LARGEST).all(axis=(1, 2))  # false for nan
    if not fits.all():
        raise DesignError(
            f"the covariance of the prediction grows beyond {LARGEST:g} at k = {np.flatnonzero(~fits)[0]}: the "
            "measurements do not bound the error; choose less uncertainty or fewer steps"
        )
