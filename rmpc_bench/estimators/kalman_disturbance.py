"""Kalman filter that also estimates the mean of the process noise.

Model   x(k+1) = A x(k) + B u(k) + f0 + d(k) + w(k),  y(k) = C x(k) + d0 + v(k),  d(k+1) = d(k) + xi(k),
        w ~ N(0, Q_w), v ~ N(0, R_v), xi ~ N(0, drift I), white, independent; d(0) ~ N(0, D0).
        P is the covariance of x_hat - x.  `w_mean` of the estimate is d_hat, in addition to f0.
Source  A baseline for noise with non-zero mean, which ma2025 does not have.
Limit   D0 = 0 and drift = 0 give the Kalman filter.  Where the mean is detectable, which needs as many outputs as
        states, x_hat is that of `kalman` with the key `disturbance: {at: {B_d: 1}, ..}` of the model.  Elsewhere that
        key is refused; here D0 and drift decide how the mean is divided among the states.
Cost    As a gain schedule with twice the number of states.
Fails   Design error if the covariance of the innovation is singular.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, riccati_schedule
from rmpc_bench.models.disturbance import Entry
from rmpc_bench.models.disturbed import DisturbedModel
from rmpc_bench.models.noise_sets import NoiseKind, NoiseSets, stochastic_sets, with_noise_kind
from rmpc_bench.numerics.linalg import as_covariance
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Matrix, Model, NonNegative

EQUATION = r"""x_{k+1} = A x_k + B u_k + f_0 + d_k + w_k, \quad
d_{k+1} = d_k + \xi_k, \quad \xi_k \sim \mathcal{N}(0, q I)"""


@dataclass(frozen=True, eq=False)
class DisturbanceFilter(Estimator):
    """A filter for [x; d] whose estimate is x; the entry `w_mean` of the estimate is d."""

    full: GainScheduleFilter
    sets: NoiseSets

    estimates_mean = True
    bridges_missing = True

    @property
    def expected_failures(self) -> dict[str, str]:
        """P is larger than the error where the process noise has no mean."""
        return {"consistent": "P contains the uncertainty of a mean of the process noise, which is 0 in the check"}

    @property
    def nx(self) -> int:
        """Number of states without the mean."""
        return len(self.full.x0) // 2

    @property
    def P(self) -> Float[Array, "k nx nx"]:
        """Covariance of x_hat - x, axis 0 = k."""
        covariance: Array = _of(self.full.P)[:, : self.nx, : self.nx]
        return covariance

    @property
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """The innovation and its covariance."""
        return self.full.reports

    def init(self, n_runs: int) -> Any:
        """Start every run at ``x0`` with d = 0."""
        return self.full.init(n_runs)

    def correct(self, k: int, state: Any, y: Float[Array, "runs ny"]) -> tuple[Any, Estimate]:
        """Use y(k)."""
        state, full = self.full.correct(k, state, y)
        nx = self.nx
        x_hat, w_mean = (np.ascontiguousarray(part) for part in (full.x_hat[:, :nx], full.x_hat[:, nx:]))
        return state, Estimate(x_hat, _of(full.P)[..., :nx, :nx], None, full.status, {**full.info, "w_mean": w_mean})

    def predict(self, k: int, state: Any, u: Float[Array, "runs nu"]) -> Any:
        """Predict k+1."""
        return self.full.predict(k, state, u)

    def series(self) -> dict[str, Array]:
        """Gains of [x; d] over k, and the covariances of both parts, P and P_d."""
        return {**self.full.series(), "P": self.P, "P_d": _of(self.full.P)[:, self.nx :, self.nx :]}


def _of(P: Array | None) -> Array:
    assert P is not None  # a Riccati recursion has one
    return P


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    M0: Float[Array, "nx nx"] | None = None,
    drift: NonNegative = 0.0,
    D0: Matrix = 1.0,
    noise: NoiseKind = "nominal",
    use_y0: bool = True,
) -> DisturbanceFilter:
    """Time-varying Kalman filter for the state and the mean of the process noise.

    Parameters
    ----------
    model : design model; f0 contains the known part of the mean
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    M0 : (nx, nx) shape matrix of the ellipsoid of a bounded part of x(0) - x0 (default: no bounded part)
    drift : increase per step of the variance of the mean; 0 for a constant one
    D0 : (nx, nx) covariance of the mean at k = 0
    noise : `nominal`: stochastic noises only; `matched` adds the covariance M / (n + 2) of bounded noises
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If D0 is not a covariance, the covariance of the innovation is singular at some step, a covariance exceeds
        1e100, or the noises of the model are correlated.
    """
    nx = len(x0)
    D = as_covariance(D0, nx, "D0")
    if model.n_disturbances:
        message = "estimates a disturbance of every state already; use kalman, or a model without `disturbance`"
        raise DesignError(message)
    design_model, P0 = with_noise_kind(model, P0, M0, noise)
    entry = Entry(np.zeros((model.nu, nx)), np.eye(nx), np.zeros((model.ny, nx)), drift * np.eye(nx), D)
    with_mean = DisturbedModel(design_model, entry)
    start = with_mean.start(x0, P0, np.zeros_like(P0))
    full = riccati_schedule(with_mean, n_steps, start["x0"], start["P0"], use_y0=use_y0)
    return DisturbanceFilter(full, stochastic_sets(design_model))
