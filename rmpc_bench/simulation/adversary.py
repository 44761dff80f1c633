"""An adversary of a filter: a sequence of F that maximises the error covariance at the last step (greedy search).

Model   the loop of moments.py.  The F(k) are chosen within F' F <= I so that the trace of the covariance of x - x_pred
        at k = N is large.  The choice depends on the gains and the covariances but not on a run, so that all runs
        and all methods have the same sequence.
Method  sweeps backward in time.  With the others fixed, the trace is a convex quadratic function of one F(k): what
        enters at k counts with the weight L(k+1), where L(N) picks the error and L(k) = A' L(k+1) A.
        It is largest at an extreme: for a scalar F at -1 or 1, whichever fits the sign of the linear part (1 where it
        has none), for a matrix at a partial isometry, found by climbing.  Each F(k) is chosen greedily so, the last one
        first; the sweeps end when the trace grows no more, and the best of four starts counts.  The worst case may be
        worse: the trace has local maxima.
Cost    four times some five sweeps of 0.1 ms a step at two states.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from rmpc_bench.simulation.moments import Joint, Laws, moved, predicted
from rmpc_bench.types import Array, DesignError, GainSchedule, Period, Plant

_MOST_SWEEPS, _MOST_CLIMBS = 20, 100
_GAIN = 1e-9  # relative growth of the trace below which a sweep was the last one


def worst_sequence(
    plant: Plant, schedule: GainSchedule, laws: Laws, n_steps: int, radius: float = 1.0, n_disturbances: int = 0
) -> tuple[Array, ...]:
    """Choose F of a linear plant for k = 0..N, as (samples, r, s) of every channel; F(N) plays no part.

    The law of the plant's F is not used, and no norm exceeds the radius.  The last `n_disturbances` states of the
    filter are no part of the error.  A DesignError says that it estimates another number of states than the plant
    has.
    """
    (nx, n_hat), periods = (len(laws.x), len(schedule.x0) - n_disturbances), []
    if n_hat != nx:
        raise DesignError(f"the filter has {n_hat} states, the plant {nx}: the error x - x_hat is undefined")
    for k in range(n_steps + 1):
        period = plant.period(k)
        assert period is not None  # a greedy law is white: it is the same for every run
        periods.append(_scaled(period, radius))
    found = [_climbed(periods, signs, schedule, laws) for signs in _starts(n_steps)]
    _, chosen = max(found, key=lambda each: each[0])
    return tuple(radius * np.array(channel) for channel in zip(*chosen, strict=True))


def _starts(n_steps: int) -> list[Array]:
    """Signs of F(k) to start from: always 1, always -1, alternating, alternating in pairs."""
    k = np.arange(n_steps + 1)
    return [np.ones(len(k)), -np.ones(len(k)), (-1.0) ** k, (-1.0) ** (k // 2)]


def _climbed(
    periods: Sequence[Period], signs: Array, schedule: GainSchedule, laws: Laws
) -> tuple[float, list[list[Array]]]:
    """Sweep until the trace grows no more; return it and the F of all k."""
    nx, n_steps, best = len(laws.x), len(periods) - 1, 0.0
    error = np.hstack([np.eye(nx), -np.eye(nx), np.zeros((nx, len(schedule.x0) - nx))])
    chosen = [
        [sign * np.eye(*channel.mean.shape) for channel in period.channels]
        for sign, period in zip(signs, periods, strict=True)
    ]
    with np.errstate(over="ignore", invalid="ignore"):  # of an error that grows beyond all bounds
        for _ in range(_MOST_SWEEPS):
            covs = _forward(periods, chosen, schedule, laws)
            reached = float(np.trace(error @ covs[-1] @ error.T))
            if not best * (1.0 + _GAIN) < reached < np.inf:
                break
            best, weight = reached, error.T @ error
            for k in reversed(range(n_steps)):
                chosen[k] = _choice(periods[k], chosen[k], schedule, k, weight, covs[k], laws.U)
                A = predicted(_with(periods[k], chosen[k]), schedule, k, nx).A
                weight = A.T @ weight @ A
    return best, chosen


def _scaled(period: Period, radius: float) -> Period:
    """Let an F of norm 1 stand for one of norm radius."""
    return period._replace(channels=tuple(channel._replace(H=radius * channel.H) for channel in period.channels))


def _forward(
    periods: Sequence[Period], chosen: Sequence[Sequence[Array]], schedule: GainSchedule, laws: Laws
) -> list[Array]:
    """Covariances of (x, x_pred) at k = 0..N."""
    nx = len(laws.x)
    cov = np.zeros((nx + len(schedule.x0),) * 2)
    cov[:nx, :nx] = laws.X
    covs = [cov]
    for k, period in enumerate(periods[:-1]):
        joint = predicted(_with(period, chosen[k]), schedule, k, nx)
        covs.append(moved(joint, covs[-1], laws.U, np.zeros((len(period.M),) * 2)))
    return covs


def _with(period: Period, Fs: Sequence[Array], without: int = -1) -> Array:
    """Return M + H F G of all channels but one."""
    M = period.M
    for number, (channel, F) in enumerate(zip(period.channels, Fs, strict=True)):
        if number != without:
            M = M + channel.H.dot(F).dot(channel.G)
    return M


def _choice(
    period: Period, Fs: Sequence[Array], schedule: GainSchedule, k: int, weight: Array, cov: Array, U: Array
) -> list[Array]:
    """Choose the F of all channels at k, one after the other."""
    found, nx = list(Fs), period.B.shape[0]
    for number, channel in enumerate(period.channels):
        if channel.H.any() and channel.G.any():
            joint = predicted(_with(period, found, number), schedule, k, nx)
            N, G_x, G_n = joint.T @ channel.H, channel.G[:, :nx], channel.G[:, nx:]
            # S G' with S the covariance of (x, x_pred, n); x_pred enters through its correlation with x.
            seen = np.vstack([cov[:, :nx] @ G_x.T, U @ G_n.T])
            power = G_x @ cov[:nx, :nx] @ G_x.T + G_n @ U @ G_n.T
            found[number] = _climb(N.T @ weight @ N, N.T @ weight @ _rows(joint) @ seen, power)
    return found


def _rows(joint: Joint) -> Array:
    return np.hstack([joint.A, joint.B])


def _climb(
    curvature: Float[Array, "r r"], linear: Float[Array, "r s"], power: Float[Array, "s s"]
) -> Float[Array, "r s"]:
    """Maximise tr(F' curvature F power) + 2 tr(F' linear) over F' F <= I."""
    F = _isometry(linear)
    for _ in range(_MOST_CLIMBS if linear.size > 1 else 0):
        better = _isometry(linear + curvature @ F @ power)  # the gradient: a convex function is above its tangent
        if np.array_equal(better, F):
            break
        F = better
    return F


def _isometry(M: Float[Array, "r s"]) -> Float[Array, "r s"]:
    """Return the F with F' F <= I for which tr F' M is largest; for M = 0 that with ones on its diagonal."""
    # So it is for an M that has left the range of numbers.
    if M.size == 1:
        return np.where(M < 0.0, -1.0, 1.0)
    if not M.any() or not np.isfinite(M).all():
        return np.eye(*M.shape)
    left, _, right = np.linalg.svd(M, full_matrices=False)
    F: Array = left @ right
    return F
