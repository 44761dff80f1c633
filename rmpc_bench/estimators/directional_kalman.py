"""Kalman filter with additional process noise in the directions in which the uncertainty acts.

Model   x(k+1) = A x(k) + B u(k) + w(k), y(k) = C x(k) + v(k), w ~ N(0, Q_w + q H H'), v ~ N(0, R_v), white,
        independent.  The columns of H are the directions, those of H_A with an uncertain-linear model: for a white F
        and a state of constant second moment H_A F G_x x is white noise with a covariance in the range of H_A, and q
        replaces its size.
Source  Jazwinski, Stochastic Processes and Filtering Theory (1970); the direction H_A as in sayed2001 and souto2011.
Limit   q = 0 gives the Kalman filter.
        A missing measurement (NaN) is left out of the correction.
Cost    As every gain schedule.
Fails   Design error if the model declares no uncertainty of A and no direction is given, or if C P_pred C' + R_v is
        singular.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter, riccati_schedule
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.uncertain_linear import UncertainModel
from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.types import Array, DesignError, Model, NonNegative

EQUATION = r"""L_k = P_{k|k-1} C^\top (C P_{k|k-1} C^\top + R_v)^{-1}, \quad
P_{k+1|k} = A P_{k|k} A^\top + Q_w + q H_A H_A^\top"""
Direction: TypeAlias = Literal["uncertainty"] | float | list[float] | list[list[float]]


@dataclass(frozen=True, eq=False)
class DirectionalModel(Model):
    """A model whose process noise has the covariance Q_w + q H H'."""

    model: Model  # design model
    q: float  # factor of H H'
    columns: Float[Array, "nx r"] | None  # directions H; None takes H_A of an uncertain model at every k

    @property
    def varies(self) -> bool:
        """Whether a matrix depends on k."""
        return self.model.varies

    def at(self, k: int) -> LinearModel:
        """Return the model at k."""
        return self._at(k) if self.varies else self._always

    @cached_property
    def _always(self) -> LinearModel:
        return self._at(0)

    def _at(self, k: int) -> LinearModel:
        now: LinearModel = self.model.at(k)
        H = self.columns
        if H is None:
            assert isinstance(self.model, UncertainModel)
            H = self.model.system.at(k).H_A
        Q_w = now.Q_w + self.q * symmetrise(H @ H.T)
        return LinearModel(now.A, now.B, now.C, Q_w, now.R_v, S_wv=now.S_wv, f0=now.f0, d0=now.d0)


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    q: NonNegative,
    direction: Direction = "uncertainty",
    form: Form = "filter",
    use_y0: bool = True,
) -> GainScheduleFilter:
    """Kalman filter whose Q_w gets q H H' in the directions H of the uncertainty.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    q : factor of H H' in the covariance of the process noise
    direction : `uncertainty` takes H_A of an uncertain-linear model as H; a list of nx numbers is one column of H, a
        matrix (nx, r) is H; rows of estimated disturbances may be left out
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If the direction is missing or has another number of rows than the state, or an innovation covariance is
        singular.
    """
    wider = DirectionalModel(model, q, _columns(model, direction))
    return riccati_schedule(wider, n_steps, x0, P0, form=form, use_y0=use_y0)


def _columns(model: Model, direction: Direction) -> Float[Array, "nx r"] | None:
    """Return H; None where it is H_A of the model, which may vary with k."""
    if direction == "uncertainty":
        if not isinstance(model, UncertainModel) or not model.system.over_time.H_A.any():
            raise DesignError(
                "the design model has no uncertainty of A (H_A); give the columns of H, such as [0, 1]", "direction"
            )
        return None
    try:
        given = np.array(direction, dtype=float)
    except ValueError:
        raise DesignError("must be a list of numbers, or a list of rows of the same length", "direction") from None
    n = model.nx - model.n_disturbances
    H = given * np.eye(n) if given.ndim == 0 else given.reshape(len(given), -1)
    if len(H) == n:
        H = np.pad(H, ((0, model.nx - n), (0, 0)))
    if len(H) != model.nx:
        raise DesignError(f"has {len(H)} rows; the model has {model.nx} states", "direction")
    return H
