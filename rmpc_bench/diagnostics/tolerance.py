"""Tolerance c of the robust filter from the exact divergence between plant and design model (zenere2018).

Model   z(k) = [x(k+1); y(k)] given the past outputs Y(k-1).  f: density of z under the design model and its Kalman
        filter.  f~: density under the plant without friction and limits, with its true parameters and the Kalman filter
        for them, in the states of the design model, E x(k+1).  Both use the same data and the same law
        u(k) = a(k) + J y(k), a(k) known; both have the design noise, scaled by s: covariances s^2 Q_w and s^2 R_v, and
        s^2 P0 at the start.  Both densities are normal; a tilde marks the plant's quantities,
            m~ = [E ((A~ + B~ J C~) x_pred~ + B~ a); C~ x_pred~],
            K~ = M~ P~ M~' + diag(E Q_w~ E', 0) + N~ R_v N~',  M~ = [E (A~ + B~ J C~); C~],  N~ = [E B~ J; I],
        and m, K are those of the design model, with E = I.  Averaged over the data of the plant, the divergence is
            covariance part  +  mismatch / s^2  +  noise,
        where the last two are the mean part: of the mean of dm, which depends on the reference, and of its covariance.
Method  The innovations of the Kalman filter for the plant are white with covariance C~ P~ C~' + R_v, so the mean and
        covariance of [x_pred~, x_pred, x_pred of the method, u(k-1)] follow a linear recursion: no sampling.
Source  zenere2018, (10), (28)-(30) and the paragraph on the choice of c in Section 3.1; the recursion is ours.
Limit   a plant equal to the model gives 0 in every part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.diagnostics.stability import LinearPair, LoopGains
from rmpc_bench.numerics.divergence import covariance_part, mean_part
from rmpc_bench.numerics.riccati import filter_step
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.types import Array, LinearPlant, Model


class Divergence(NamedTuple):
    """The divergence at every k = 0..N-1, for every plant."""

    covariance: Float[Array, "runs steps"]
    mismatch: Float[Array, "runs steps"]  # mean part without noise, times s^2
    noise: Float[Array, "runs steps"]  # contribution of the noise to the mean part; it does not depend on s


class _Side(NamedTuple):
    """Plant, or (with E = I) design model, and its Kalman filter over k."""

    plant: LinearPlant
    E_Q_E: Float[Array, "runs nx nx"]
    R_v: Float[Array, "ny ny"]
    P: Float[Array, "runs steps n n"]
    K: Float[Array, "runs steps n ny"]


def divergence_over_time(
    plants: LinearPlant,
    model: Model,
    pair: LinearPair,
    x0: Float[Array, " n"],
    P0: Float[Array, "nx nx"],
    r: Float[Array, "known ny"],
    n_steps: int,
    Q_true: Float[Array, "runs n n"] | None = None,
) -> Divergence:
    """Divergence of stacked linear plants from the design model of the filters while a pair controls them.

    x0 is the mean of the plant's state, P0 the covariance of the model's state at the start.  The model's filter has
    the initial estimate of the pair's filter.  `Q_true` has the covariances of the plants' process noise, by default
    that of the model on its states.  A LinAlgError says that a covariance of the model's z, or of an innovation, is
    singular.
    """
    lift = np.linalg.pinv(plants.E)
    true = _side(
        plants, lift @ model.Q_w @ lift.mT if Q_true is None else Q_true, model.R_v, lift @ P0 @ lift.mT, n_steps
    )
    linear = LinearPlant(model.A[None], model.B[None], model.C[None], np.eye(len(model.A))[None])
    nominal = _side(linear, model.Q_w[None], model.R_v, P0[None], n_steps)

    n_runs, n_ahead = len(plants.A), pair.law.K_r.shape[1] // len(model.C)
    # A filter that estimates disturbances has them as its last states.
    own = pair.schedule.x0
    start = [x0, own[: len(model.A)], own, np.zeros(len(pair.law.K_u))]
    mean = np.tile(np.concatenate(start)[:, None], (n_runs, 1, 1))
    spread = np.zeros((n_runs, mean.shape[1], mean.shape[1]))
    parts = Divergence(*np.empty((3, n_runs, n_steps)))
    for k in range(n_steps):
        gains, ahead = pair.at(k), pair.law.K_r @ r[k + 1 : k + 1 + n_ahead].reshape(-1, 1)
        D, d, T, t, G = _period(true, nominal, gains, ahead, k)
        K, dm = _covariance(nominal, gains.J, k), D @ mean + d
        parts.covariance[:, k] = covariance_part(_covariance(true, gains.J, k), K)
        parts.mismatch[:, k] = mean_part(dm @ dm.mT, K)
        parts.noise[:, k] = mean_part(D @ spread @ D.mT, K)
        S = plants.C @ true.P[:, k] @ plants.C.mT + model.R_v
        mean, spread = T @ mean + t, T @ spread @ T.mT + G @ S @ G.mT
    return parts


def _side(plant: LinearPlant, Q: Array, R_v: Array, P0: Array, n_steps: int) -> _Side:
    """Covariances before the measurement and gains of the prediction, for every run and k."""
    roots, K = [root_of(P0)], []
    for _ in range(n_steps):
        steps = [filter_step(A, C, q, R_v, F) for A, C, q, F in zip(plant.A, plant.C, Q, roots[-1], strict=True)]
        K.append(np.stack([step.K for step in steps]))
        roots.append(np.stack([step.root_next for step in steps]))
    P = covariance_of(np.stack(roots[:-1], axis=1))
    return _Side(plant, plant.E @ Q @ plant.E.mT, R_v, P, np.stack(K, axis=1))


def _covariance(side: _Side, J: Array, k: int) -> Float[Array, "runs nz nz"]:
    """Covariance of z given the past, (30)."""
    A, B, C, E, _ = side.plant
    M = np.concatenate([E @ (A + B @ J @ C), C], axis=1)
    reach = E @ B @ J
    N = np.concatenate([reach, np.broadcast_to(np.eye(len(side.R_v)), (len(A), *side.R_v.shape))], axis=1)
    K: Array = M @ side.P[:, k] @ M.mT + N @ side.R_v @ N.mT
    nx = E.shape[1]
    K[:, :nx, :nx] += side.E_Q_E
    return K


def _period(true: _Side, nominal: _Side, g: LoopGains, ahead: Float[Array, "nu 1"], k: int) -> tuple[Array, ...]:
    """Matrices of one period for q = [x_pred~, x_pred, x_pred of the method, u(k-1)] and the plant's innovation i."""
    # dm = D q + d and q(k+1) = T q + t + G i, with y = C~ x_pred~ + i.
    (A, B, C, E, _), (A0, B0, C0, *_) = true.plant, nominal.plant
    n_runs, n, nx, n_hat, nu = len(A), A.shape[1], A0.shape[1], len(g.F), B.shape[2]
    X, X0, X_hat, U = np.split(np.eye(n + nx + n_hat + nu), np.cumsum([n, nx, n_hat]))

    def reached(u: Array, *free: Array) -> Array:
        """Rows of q(k+1): effect of an input plus the given terms without input."""
        rows = [B @ u, B0 @ u, g.B @ u, u]
        return np.concatenate([row + other for row, other in zip(rows, free, strict=True)], axis=1)

    y, y0 = C @ X, C0 @ X0
    past = g.from_x_pred @ X_hat + g.from_u @ U  # a(k) without the reference
    u, u0 = past + g.J @ y, past + g.J @ y0  # mean of u(k) given the past outputs, for plant and model
    e = y - y0
    K, K0 = true.K[:, k], nominal.K[:, k]
    D = np.concatenate([E @ (A @ X + B @ u) - (A0 @ X0 + B0 @ u0), e], axis=1)
    d = np.concatenate([(E @ B - B0) @ ahead, np.zeros((n_runs, y.shape[1], 1))], axis=1)
    T = reached(u, A @ X, A0 @ X0 + K0 @ e, g.F @ X_hat + g.K @ (y - g.C @ X_hat), 0.0 * u)
    nothing = np.zeros(1)
    t = reached(np.broadcast_to(ahead, (n_runs, nu, 1)), nothing, nothing, nothing, nothing)
    G = reached(np.broadcast_to(g.J, (n_runs, *g.J.shape)), K, K0, g.K, nothing)
    return D, d, T, t, G
