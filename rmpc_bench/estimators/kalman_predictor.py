"""One-step Kalman predictor on the nominal model, with correlated noises.

Model   x(k+1) = A x(k) + B u(k) + f0 + w~(k),  y(k) = C x(k) + d0 + v~(k),  w~ and v~ white with covariances Q_w and
        R_v and cross-covariance E w~ v~' = S_wv.  Uncertainty is ignored: P is the covariance of x_pred - x under the
        nominal model.
Source  Anderson and Moore, Optimal Filtering (1979); the classic predictor of souto2011, section 5.
Limit   Without correlation the predictor form of `kalman`.
Missing A run with gaps has its own gains and P from then on, also with `gain: steady`.
Cost    As every gain schedule.
Fails   Design error: R and S_wv do not form a joint covariance; with `gain: steady` the model varies or the algebraic
        Riccati equation has no stabilising solution.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.bridging import Gains, RunByRun, with_outputs
from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, refuse_overflow, schedule_of
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import as_covariance, symmetrise
from rmpc_bench.numerics.riccati import predictor_step
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.types import Array, DesignError, Matrix, Model

EQUATION = r"""\hat x_{k+1|k} = A \hat x_{k|k-1} + B u_k + K_k (y_k - C \hat x_{k|k-1}), \quad
K_k = (A P_{k|k-1} C^\top + S_{wv}) (C P_{k|k-1} C^\top + R_v)^{-1}"""


# The pencil gives an eigenvalue on the unit circle with an error of about the square root of the rounding unit.
STABLE = 1.0 - 1e-7


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
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    R : (ny, ny) covariance of the measurement noise v~ in the design (default: that of the model)
    gain : `steady` uses the gain and P of the algebraic Riccati equation at every k

    Raises
    ------
    DesignError
        If R is not admissible, or there is no steady gain.
    """
    models = [model.at(k) for k in range(n_steps + 1)]
    given = None if R is None else _given(R, models)
    own = RunByRun(partial(_of_one_run, models, given))
    if gain == "steady":
        K, P = _steady(models, given)
        S, root = _innovation(models[0], given, root_of(P))[None], root_of(P)[None]
        return schedule_of(models, x0, [K] * len(models), [P] * len(models), S=S, root=root, recursion=own)
    gains, roots = [], [root_of(P0)]
    last, M, J = None, np.zeros(()), np.zeros(())
    for now in models:
        if now is not last:
            last, (M, J) = now, _joint(now, given)
        step = predictor_step(M, J, roots[-1])
        gains.append(step.K)
        roots.append(step.root_next)
    P_pred = covariance_of(np.array(roots))
    refuse_overflow(P_pred)
    S = np.array([_innovation(now, given, root) for now, root in zip(models, roots[:-1], strict=True)])
    return schedule_of(models, x0, gains, P_pred[:-1], S=S, root=np.array(roots[:-1]), recursion=own)


def _of_one_run(models: list[LinearModel], R: Array | None, k: int, root: Array, there: Array) -> Gains:
    """Return the gains of a run in which measurements are missing."""
    step = predictor_step(*with_outputs(*_joint(models[k], R), there), root)
    return Gains(step.K, step.K, step.root_next, covariance_of(root), _innovation(models[k], R, root))


def _innovation(now: LinearModel, R: Array | None, root: Array) -> Float[Array, "ny ny"]:
    """Return the covariance of the innovation."""
    return covariance_of(now.C @ root) + (now.R_v if R is None else R)


def _given(R: Matrix, models: list[LinearModel]) -> Float[Array, "ny ny"]:
    """Expand R; raise a DesignError if it is not consistent with the cross-covariance."""
    given = as_covariance(R, models[0].ny, "R")
    for now in dict.fromkeys(now for now in models if now.S_wv.any()):
        _, J = _joint(now, given)
        try:
            as_covariance(symmetrise(J), len(J))
        except ValueError:
            message = "is not consistent with the cross-covariance S_wv of the model"
            raise DesignError(message, "R") from None
    return given


def _joint(now: LinearModel, R: Array | None) -> tuple[Array, Array]:
    """Return [A; C] and the covariance of [w~; v~]."""
    J = np.block([[now.Q_w, now.S_wv], [now.S_wv.T, now.R_v if R is None else R]])
    return np.vstack([now.A, now.C]), J


def _steady(models: list[LinearModel], R: Array | None) -> tuple[Array, Array]:
    """Return gain and covariance of the stabilising solution."""
    from scipy.linalg import solve_discrete_are

    M, J = _joint(models[0], R)
    if any(now is not models[0] and not all(map(np.array_equal, (M, J), _joint(now, R))) for now in models):
        raise DesignError("a model that varies has no steady gain; use time-varying", "gain")
    nx = models[0].nx
    try:
        P = symmetrise(solve_discrete_are(M[:nx].T, M[nx:].T, J[:nx, :nx], J[nx:, nx:], s=J[:nx, nx:]))
    except (np.linalg.LinAlgError, ValueError):
        raise _no_steady_gain("") from None
    K = predictor_step(M, J, root_of(P)).K
    radius = float(np.abs(np.linalg.eigvals(M[:nx] - K.dot(M[nx:]))).max())
    if not radius < STABLE:
        raise _no_steady_gain(f": the spectral radius of A - K C is {radius:.9g}")
    return K, P


def _no_steady_gain(why: str) -> DesignError:
    return DesignError(f"the Riccati equation has no stabilising solution{why}; use time-varying or a larger R", "gain")
