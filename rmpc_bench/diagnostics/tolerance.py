"""The tolerance c that an exact description of the plant suggests: zenere2018's way to choose it, computed exactly.

Model   z(k) = [x(k+1); y(k)] given the past outputs Y(k-1).  What is believed, f: the model and its Kalman filter.
        What is true, f~: the plant without friction and limits, with its own parameters and its own Kalman filter, seen
        in the model's states, E x(k+1).  Both see the same data and the same law u(k) = a(k) + J y(k), a(k) known; both
        have the model's noise, scaled by s: covariances s^2 Q_w and s^2 R_v, and s^2 P0 at the start.
        Both densities are normal; with a tilde on what is the plant's,
            m~ = [E ((A~ + B~ J C~) x_pred~ + B~ a); C~ x_pred~],
            K~ = M~ P~ M~' + diag(E Q_w~ E', 0) + N~ R_v N~',  M~ = [E (A~ + B~ J C~); C~],  N~ = [E B~ J; I],
        and m, K are the same of the model, with E = I.  Their divergence averages, over the data of the plant, to
            covariance part  +  mismatch / s^2  +  noise,
        the last two being the mean part: of the mean of dm, which the reference drives, and of its spread.
Method  the data are driven by the innovations of the plant's own filter, white with covariance C~ P~ C~' + R_v; so mean
        and covariance of [x_pred~, x_pred, x_pred of the method, u(k-1)] follow a linear recursion: no sampling.
Source  zenere2018, (10), (28)-(30) and the paragraph on the choice of c in Section 3.1; the recursion is ours.
Limit   a plant equal to the model gives 0 in every part.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from rmpc_bench.diagnostics.stability import LinearPair, LoopGains
from rmpc_bench.numerics.gaussian_divergence import covariance_part, mean_part
from rmpc_bench.numerics.riccati import filter_step
from rmpc_bench.types import Array, LinearPlant


@runtime_checkable
class DesignModel(Protocol):
    """A time-invariant linear model with its noise."""

    A: Array
    B: Array
    C: Array
    Q_w: Array
    R_v: Array


class Divergence(NamedTuple):
    """The divergence at every k = 0..N-1, for every plant."""

    covariance: Float[Array, "runs steps"]
    mismatch: Float[Array, "runs steps"]
    """Mean part without noise, times s^2."""
    noise: Float[Array, "runs steps"]
    """What the noise adds to the mean part, whatever its scale."""


class _Side(NamedTuple):
    """One description of z, the plant's or (with E = I) the model's, and its Kalman filter over k."""

    truth: LinearPlant
    E_Q_E: Float[Array, "runs nx nx"]
    R_v: Float[Array, "ny ny"]
    P: Float[Array, "runs steps n n"]
    K: Float[Array, "runs steps n ny"]


def divergence_over_time(
    truths: LinearPlant,
    model: DesignModel,
    pair: LinearPair,
    x0: Float[Array, " n"],
    P0: Float[Array, "nx nx"],
    r: Float[Array, "known ny"],
    n_steps: int,
    Q_true: Float[Array, "runs n n"] | None = None,
) -> Divergence:
    """Divergence of the plants from the model while a pair controls them.

    Parameters
    ----------
    truths : the plants, stacked: axis 0 of every matrix is the run
    model : what is believed
    pair : the pair whose law and whose data are looked at; the model's filter starts where its filter does
    x0 : (n,) mean of the plant's state at the start
    P0 : (nx, nx) covariance of the model's state at the start
    r : reference from k = 0 on
    n_steps : number of control periods N
    Q_true : covariances of the plants' process noise; if not given, the model's on the states it knows

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance of the model's z, or of an innovation, is singular.
    """
    lift = np.linalg.pinv(truths.E)
    true = _side(
        truths, lift @ model.Q_w @ lift.mT if Q_true is None else Q_true, model.R_v, lift @ P0 @ lift.mT, n_steps
    )
    nominal = LinearPlant(model.A[None], model.B[None], model.C[None], np.eye(len(model.A))[None])
    believed = _side(nominal, model.Q_w[None], model.R_v, P0[None], n_steps)

    n_runs, n_ahead = len(truths.A), pair.law.K_r.shape[1] // len(model.C)
    start = [x0, pair.schedule.x0, pair.schedule.x0, np.zeros(len(pair.law.K_u))]
    mean = np.tile(np.concatenate(start)[:, None], (n_runs, 1, 1))
    spread = np.zeros((n_runs, mean.shape[1], mean.shape[1]))
    parts = Divergence(*np.empty((3, n_runs, n_steps)))
    for k in range(n_steps):
        gains, ahead = pair.at(k), pair.law.K_r @ r[k + 1 : k + 1 + n_ahead].reshape(-1, 1)
        D, d, T, t, G = _period(true, believed, gains, ahead, k)
        K, dm = _covariance(believed, gains.J, k), D @ mean + d
        parts.covariance[:, k] = covariance_part(_covariance(true, gains.J, k), K)
        parts.mismatch[:, k] = mean_part(dm @ dm.mT, K)
        parts.noise[:, k] = mean_part(D @ spread @ D.mT, K)
        S = truths.C @ true.P[:, k] @ truths.C.mT + model.R_v
        mean, spread = T @ mean + t, T @ spread @ T.mT + G @ S @ G.mT
    return parts


def _side(truth: LinearPlant, Q: Array, R_v: Array, P0: Array, n_steps: int) -> _Side:
    """Covariances before the measurement and gains of the prediction, for every run and k."""
    P, K = [P0], []
    for _ in range(n_steps):
        steps = [filter_step(A, C, q, R_v, V) for A, C, q, V in zip(truth.A, truth.C, Q, P[-1], strict=True)]
        K.append(np.stack([step.K for step in steps]))
        P.append(np.stack([step.P_next for step in steps]))
    return _Side(truth, truth.E @ Q @ truth.E.mT, R_v, np.stack(P[:-1], axis=1), np.stack(K, axis=1))


def _covariance(side: _Side, J: Array, k: int) -> Float[Array, "runs nz nz"]:
    """Covariance of z given the past, (30)."""
    A, B, C, E = side.truth
    M = np.concatenate([E @ (A + B @ J @ C), C], axis=1)
    reach = E @ B @ J
    N = np.concatenate([reach, np.broadcast_to(np.eye(len(side.R_v)), (len(A), *side.R_v.shape))], axis=1)
    K: Array = M @ side.P[:, k] @ M.mT + N @ side.R_v @ N.mT
    nx = E.shape[1]
    K[:, :nx, :nx] += side.E_Q_E
    return K


def _period(true: _Side, believed: _Side, g: LoopGains, ahead: Float[Array, "nu 1"], k: int) -> tuple[Array, ...]:
    """Matrices of one period for q = [x_pred~, x_pred, x_pred of the method, u(k-1)] and the plant's innovation i.

    dm = D q + d and q(k+1) = T q + t + G i, with y = C~ x_pred~ + i.
    """
    (A, B, C, E), (A0, B0, C0, _) = true.truth, believed.truth
    n_runs, n, nx, n_hat, nu = len(A), A.shape[1], A0.shape[1], len(g.F), B.shape[2]
    X, X0, X_hat, U = np.split(np.eye(n + nx + n_hat + nu), np.cumsum([n, nx, n_hat]))

    def reached(u: Array, *free: Array) -> Array:
        """Rows of what an input does to q, beside what happens without it."""
        rows = [B @ u, B0 @ u, g.B @ u, u]
        return np.concatenate([row + other for row, other in zip(rows, free, strict=True)], axis=1)

    y, y0 = C @ X, C0 @ X0
    past = g.from_x_pred @ X_hat + g.from_u @ U  # a(k), but for what the reference adds
    u, u0 = past + g.J @ y, past + g.J @ y0  # what either side expects of u(k) before y(k) is known
    e = y - y0
    K, K0 = true.K[:, k], believed.K[:, k]
    D = np.concatenate([E @ (A @ X + B @ u) - (A0 @ X0 + B0 @ u0), e], axis=1)
    d = np.concatenate([(E @ B - B0) @ ahead, np.zeros((n_runs, y.shape[1], 1))], axis=1)
    T = reached(u, A @ X, A0 @ X0 + K0 @ e, g.F @ X_hat + g.K @ (y - g.C @ X_hat), 0.0 * u)
    nothing = np.zeros(1)
    t = reached(np.broadcast_to(ahead, (n_runs, nu, 1)), nothing, nothing, nothing, nothing)
    G = reached(np.broadcast_to(g.J, (n_runs, *g.J.shape)), K, K0, g.K, nothing)
    return D, d, T, t, G
