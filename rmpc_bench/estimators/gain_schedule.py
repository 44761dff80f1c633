"""The filter shared by every estimator whose gains do not depend on the data.

Model   x_pred(k+1) = F_k x_pred(k) + B_k u(k) + f_k + K_k e(k),  x_hat(k) = x_pred(k) + L_k e(k),
        e(k) = y(k) - C_k x_pred(k) - d_k;  K_k = F_k L_k for a filter, L_k = 0 for a one-step predictor.
Cost    five small matrix-vector products per run and step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel, Model
from rmpc_bench.numerics.kl_ball import LARGEST, Inflation
from rmpc_bench.numerics.linalg import at_sample, mv
from rmpc_bench.numerics.riccati import error_radius, filter_step
from rmpc_bench.types import Array, DesignError, Estimate, Status

OK = np.int8(Status.OK)

Form: TypeAlias = Literal["filter", "predictor"]


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
    f, d : (1 or samples, nx), (1 or samples, ny) constant parts, None where they are zero
    remarks : what a user should know of this design; `rmpc-bench check` shows it
    """

    x0: Float[Array, " nx"]
    F: Float[Array, "kF nx nx"]
    B: Float[Array, "kB nx nu"]
    C: Float[Array, "kC ny nx"]
    K: Float[Array, "kK nx ny"]
    L: Float[Array, "kL nx ny"]
    P: Float[Array, "kP nx nx"]
    extra: Mapping[str, Array] = field(default_factory=dict)
    f: Float[Array, "kf nx"] | None = None
    d: Float[Array, "kd ny"] | None = None
    remarks: tuple[str, ...] = ()

    def init(self, n_runs: int) -> FilterState:
        """Start every run at ``x0``."""
        return FilterState(np.tile(self.x0, (n_runs, 1)), np.zeros((n_runs, self.C.shape[1])))

    def correct(self, k: int, state: FilterState, y: Float[Array, "runs ny"]) -> tuple[FilterState, Estimate]:
        """Use y(k): x_hat = x_pred + L e."""
        e = y - mv(at_sample(self.C, k), state.x_pred)
        if self.d is not None:
            e = e - at_sample(self.d, k)
        x_hat = state.x_pred + mv(at_sample(self.L, k), e) if self._corrects else state.x_pred
        return FilterState(state.x_pred, e), Estimate(x_hat, at_sample(self.P, k), None, np.full(len(y), OK), {"e": e})

    def predict(self, k: int, state: FilterState, u: Float[Array, "runs nu"]) -> FilterState:
        """Go to k+1: x_pred+ = F x_pred + B u + K e."""
        x_pred = mv(at_sample(self.F, k), state.x_pred)
        if self._is_driven:
            x_pred = x_pred + mv(at_sample(self.B, k), u)
        x_pred = x_pred + mv(at_sample(self.K, k), state.e)
        if self.f is not None:
            x_pred = x_pred + at_sample(self.f, k)
        return FilterState(x_pred, state.e)

    @cached_property
    def _corrects(self) -> bool:
        """Whether x_hat(k) uses y(k) at any k."""
        return bool(self.L.any())

    @cached_property
    def _is_driven(self) -> bool:
        """Whether the input matters to the model at any k."""
        return bool(self.B.any())

    def series(self) -> dict[str, Array]:
        """Gains and covariances over k, and rho, the spectral radius of F - K C, made here because few need it."""
        return {"K": self.K, "L": self.L, "P": self.P, "rho": error_radius(self.F, self.K, self.C), **self.extra}


def over_time(matrices: Sequence[Array]) -> Array:
    """Stack the matrices of all k, once where all are the same one."""
    return np.array(matrices[:1] if all(matrix is matrices[0] for matrix in matrices) else matrices)


def constant_part(vectors: Sequence[Array]) -> Array | None:
    """Stack the constant parts of all k; None where they are zero."""
    stacked = over_time(vectors)
    return stacked if stacked.any() else None


def predictor_schedule(
    models: Sequence[LinearModel],
    x0: Float[Array, " nx"],
    K: Sequence[Array],
    P: Sequence[Array],
    *,
    F: Sequence[Array] | None = None,
    extra: Mapping[str, Array] | None = None,
    remarks: tuple[str, ...] = (),
) -> GainScheduleFilter:
    """Make a one-step predictor: x_hat(k) = x_pred(k) does not use y(k).

    Parameters
    ----------
    models : the nominal model at k = 0..N, for B, C and the constant parts
    x0 : (nx,) prediction before the first measurement
    K, P : gains and covariances of x_pred - x at k = 0..N
    F : transition matrices, those of the models unless given
    extra, remarks : as in `GainScheduleFilter`
    """
    nx, ny = models[0].nx, models[0].ny
    return GainScheduleFilter(
        x0=x0,
        F=over_time([model.A for model in models] if F is None else F),
        B=over_time([model.B for model in models]),
        C=over_time([model.C for model in models]),
        K=over_time(K),
        L=np.zeros((1, nx, ny)),
        P=over_time(P),
        extra=extra or {},
        f=constant_part([model.f0 for model in models]),
        d=constant_part([model.d0 for model in models]),
        remarks=remarks,
    )


def riccati_schedule(
    model: Model,
    n_steps: int,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    inflate: Callable[[int, Array], Inflation],
    form: Form = "filter",
) -> GainScheduleFilter:
    """Run a Riccati recursion whose prediction covariance is replaced by ``inflate(k, P_pred)`` before it is used.

    Parameters
    ----------
    model : what the filter believes
    n_steps : N; gains are made for the samples k = 0..N
    x0 : (nx,) mean of the prediction of x(0)
    P0 : (nx, nx) its covariance
    inflate : maps (k, P_pred) to the covariance V to use and the multiplier theta that led to it
    form : `filter` uses y(k) for x_hat(k), `predictor` does not: its P is V

    Raises
    ------
    DesignError
        If the innovation covariance is singular at some step, a covariance grows beyond 1e100, or the model's noises
        are correlated.
    """
    models = [model.at(k) for k in range(n_steps + 1)]
    if any(each.S_wv.any() for each in models):
        raise DesignError("this filter needs process and measurement noise without correlation; use kalman-predictor")
    P_pred, V, P, K, L, theta = [P0], [], [], [], [], []
    for k, now in enumerate(models):
        try:
            inflation = inflate(k, P_pred[-1])
            step = filter_step(now.A, now.C, now.Q_w, now.R_v, inflation.V)
        except np.linalg.LinAlgError:
            refuse_overflow(P_pred)
            raise DesignError(
                f"the covariance of the innovation is singular at k = {k}: give the model measurement noise"
            ) from None
        V.append(inflation.V)
        theta.append(inflation.theta)
        P.append(step.P)
        L.append(step.L)
        K.append(step.K)
        P_pred.append(step.P_next)
    refuse_overflow(P_pred)
    extra = {"P_pred": np.array(P_pred[:-1]), "V": np.array(V), "theta": np.array(theta)}
    predictor = predictor_schedule(models, x0, K, V, extra=extra)
    return predictor if form == "predictor" else replace(predictor, L=np.array(L), P=np.array(P))


def refuse_overflow(P_pred: Sequence[Array]) -> None:
    """Insist on covariances that are numbers, and not so large that their gains are none."""
    fits = (np.abs(np.array(P_pred)) < LARGEST).all(axis=(1, 2))  # false for nan
    if not fits.all():
        raise DesignError(
            f"the covariance of the prediction grows beyond {LARGEST:g} at k = {np.flatnonzero(~fits)[0]}: the "
            "measurements do not bound the error; choose less uncertainty or fewer steps"
        )
