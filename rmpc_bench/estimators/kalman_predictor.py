"""One-step Kalman predictor on the nominal model, with correlated noises.

Model   x(k+1) = A x(k) + B u(k) + f0 + w~(k),  y(k) = C x(k) + d0 + v~(k),  w~ and v~ white with covariances Q_w and
        R_v and cross-covariance E w~ v~' = S_wv; an uncertain model is taken at its nominal part.
        P is the covariance of x_pred - x as this model has it: with uncertainty it is no bound of anything.
Source  Anderson and Moore, Optimal Filtering (1979); the classic predictor of souto2011, section 5.
Limit   without correlation the predictor form of `kalman`.
Cost    as every gain schedule.
Fails   design error where R is not the covariance of a v~ with this S_wv, and with `gain: steady` where the model
        varies or the algebraic Riccati equation has no stabilising solution.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, predictor_schedule, refuse_overflow
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import as_covariance, symmetrise
from rmpc_bench.numerics.riccati import predictor_step
from rmpc_bench.types import Array, DesignError, Matrix, Model

_STABLE = 1.0 - 1e-7  # an eigenvalue on the unit circle comes out of the pencil right to the root of a rounding


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    R: Matrix | None = None,
    gain: Literal["time-varying", "steady"] = "time-varying",
) -> GainScheduleFilter:
    """One-step Kalman predictor.

    Parameters
    ----------
    model : nominal model, or an uncertain one, whose uncertainty is ignored
    n_steps : number of control periods N; gains are made for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) its covariance
    R : (ny, ny) covariance that the predictor takes for that of the measurement noise v~, the model's unless given
    gain : `steady` takes the gain and P of the algebraic Riccati equation at every k

    Raises
    ------
    DesignError
        If R does not fit, or there is no steady gain.
    """
    models = [model.at(k) for k in range(n_steps + 1)]
    given = None if R is None else _given(R, models)
    if gain == "steady":
        K, P = _steady(models, given)
        return predictor_schedule(models, x0, [K] * len(models), [P] * len(models))
    gains, P_pred = [], [P0]
    last, M, J = None, np.zeros(()), np.zeros(())
    for now in models:
        if now is not last:
            last, (M, J) = now, _joint(now, given)
        step = predictor_step(M, J, P_pred[-1])
        gains.append(step.K)
        P_pred.append(step.P_next)
    refuse_overflow(P_pred)
    return predictor_schedule(models, x0, gains, P_pred[:-1])


def _given(R: Matrix, models: list[LinearModel]) -> Float[Array, "ny ny"]:
    """Expand R and insist on noises that have it."""
    try:
        given = as_covariance(R, models[0].ny)
    except ValueError as error:
        raise DesignError(str(error), "R") from None
    for now in dict.fromkeys(now for now in models if now.S_wv.any()):
        _, J = _joint(now, given)
        try:
            as_covariance(symmetrise(J), len(J))
        except ValueError:
            raise DesignError("no v~ with this covariance has the model's cross-covariance with w~", "R") from None
    return given


def _joint(now: LinearModel, R: Array | None) -> tuple[Array, Array]:
    """A over C, and the covariance of w~ over v~."""
    J = np.block([[now.Q_w, now.S_wv], [now.S_wv.T, now.R_v if R is None else R]])
    return np.vstack([now.A, now.C]), J


def _steady(models: list[LinearModel], R: Array | None) -> tuple[Array, Array]:
    """Gain and covariance of the stabilising solution."""
    from scipy.linalg import solve_discrete_are

    M, J = _joint(models[0], R)
    if any(now is not models[0] and not all(map(np.array_equal, (M, J), _joint(now, R))) for now in models):
        raise DesignError("a model that varies has no steady gain; use time-varying", "gain")
    nx = models[0].nx
    try:
        P = symmetrise(solve_discrete_are(M[:nx].T, M[nx:].T, J[:nx, :nx], J[nx:, nx:], s=J[:nx, nx:]))
    except (np.linalg.LinAlgError, ValueError):
        raise _no_steady_gain("") from None
    K = predictor_step(M, J, P).K
    radius = float(np.abs(np.linalg.eigvals(M[:nx] - K.dot(M[nx:]))).max())
    if not radius < _STABLE:
        raise _no_steady_gain(f": the spectral radius of A - K C is {radius:.9g}")
    return K, P


def _no_steady_gain(why: str) -> DesignError:
    return DesignError(f"the Riccati equation has no stabilising solution{why}; use time-varying or a larger R", "gain")
