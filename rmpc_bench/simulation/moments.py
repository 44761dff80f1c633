"""Exact mean and covariance over all runs of a linear plant and a filter with given gains: no run is simulated.

Model   [x(k+1); y(k)] = (M + sum of H F G) [x; n],  n = [w; v] white with mean n_bar and covariance U, the F white with
        mean F_bar and independent diagonal entries of one variance;
        x_pred(k+1) = F_k x_pred + f_k + K_k e,  x_hat = x_pred + L_k e,  e = y - C_k x_pred - d_k.  A known input u,
        the same in all runs, adds B u to x(k+1) and B_k u to x_pred(k+1), which moves the means.
Method  mean and covariance of (x, x_pred) follow a closed recursion: M is replaced by its mean, and every F adds
        H diag(variance (G E[q q'] G')_ii) H' to the covariance of [x(k+1); y], q = [x; n].
Limit   without uncertainty and with the filter's own model the covariance of x - x_hat is the filter's P.
Cost    about 50 us a step at two states, whatever the number of runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import at_sample
from rmpc_bench.simulation.open_loop import OpenLoop, Rest
from rmpc_bench.simulation.scenario import Scenario
from rmpc_bench.types import Array, GainSchedule, Method, Period, Plant


class Laws(NamedTuple):
    """First and second moments of what is random beside the uncertainty."""

    x: Float[Array, " nx"]  # mean of the true initial state
    X: Float[Array, "nx nx"]  # its covariance
    n: Float[Array, " nn"]  # mean of [w; v]
    U: Float[Array, "nn nn"]  # its covariance
    u: Float[Array, "steps nu"] | None = None  # known input; None where there is none


SEVERAL = range(8)
"""Runs whose inputs are compared, since an input of a user's file may be random."""


def exact_laws(plant: Plant, method: Method, scenario: Scenario) -> Laws | str:
    """Gather the laws that exact moments need, or return the reason why there are none.

    They need a filter with given gains, and no input or one that is the same in all runs.
    """
    if not plant.has_period:
        return "the plant is not linear"
    if plant.period(0) is None:
        return "the uncertainty is drawn per run, so it is not white"
    if method.estimator.gain_schedule is None:
        return "the gains of the estimator depend on the run"
    if plant.feedthrough or method.estimator.fed is not None:
        return "y(k) depends on u(k)"
    if method.period is not None:
        return "innovations of angles are wrapped"
    if not isinstance(method.controller, Rest | OpenLoop):
        return "there is a controller"
    u = None if isinstance(method.controller, Rest) else _known_input(method.controller, plant)
    if isinstance(u, str):
        return u
    if method.delay.input:
        return "the design model has a delay of the input"
    if any(method.delay.measurement or ()):
        return "the design model has late measurements"
    start, noises = scenario.initial_law(), scenario.noise_laws(plant.nw, plant.nv)
    laws = (*scenario.process, *scenario.measurement)
    if any(law.alters_output for law in laws):
        return "a law alters the measurements, and does not add to them"
    if scenario.input:
        return "a law acts on the input"
    if not all(law.is_white for law in laws):
        return "a law of noise is correlated over time, so it is not white"
    if start is None or noises is None:
        return f"the moments of a law of {'the initial state' if start is None else 'noise'} are not known"
    return Laws(*start, *noises, u)


def _known_input(law: OpenLoop, plant: Plant) -> Float[Array, "steps nu"] | str:
    """Return the input of all runs within the bounds of the plant; the reason where there is none."""
    of_runs = law.signal.sample(SEVERAL, law.n_steps) if law.signal.n_runs is None else None
    if of_runs is None or (of_runs != of_runs[:1]).any():
        return "every run has an input of its own"
    applied: Array = plant.applied_inputs(of_runs[0])
    return applied


class Moments(NamedTuple):
    """Mean and covariance of z = (x, x_hat) at k = 0..N."""

    mean: Float[Array, "samples nz"]
    cov: Float[Array, "samples nz nz"]


class Joint(NamedTuple):
    """The closed loop of plant and filter over one period, on (x, x_pred): what noise and F add to it."""

    A: Float[Array, "nz nz"]  # what becomes of (x, x_pred)
    B: Float[Array, "nz nn"]  # how n enters
    T: Float[Array, "nz no"]  # how [x(k+1); y(k)] enters
    c: Float[Array, " nz"]


def exact_moments(plant: Plant, schedule: GainSchedule, laws: Laws, n_steps: int, n_disturbances: int = 0) -> Moments:
    """Compute the moments of the state of a linear plant with white uncertainty, and of its estimate.

    The last `n_disturbances` states of the filter are left out.
    """
    nx, n_hat = len(laws.x), len(schedule.x0)
    mean = np.concatenate([laws.x, schedule.x0])
    cov = np.zeros((nx + n_hat, nx + n_hat))
    cov[:nx, :nx] = laws.X
    means, covs = [], []
    corrects = schedule.L.any()
    with np.errstate(over="ignore", invalid="ignore"):  # of an error that grows beyond all bounds
        for k in range(n_steps + 1):
            period = plant.period(k)
            assert period is not None  # or there would be no `exact_laws`
            reached = mean_matrix(period)
            added = spread(period, mean[:nx], cov[:nx, :nx], laws)
            if corrects:
                reported = _reported(reached, schedule, k, nx)
                means.append(_mean(reported, mean, laws.n))
                covs.append(moved(reported, cov, laws.U, added))
            else:
                means.append(mean)
                covs.append(cov)
            joint = predicted(reached, schedule, k, nx)
            mean, cov = _mean(joint, mean, laws.n), moved(joint, cov, laws.U, added)
            if laws.u is not None and k < n_steps:
                mean = mean + np.concatenate([period.B, at_sample(schedule.B, k)]).dot(laws.u[k])
    n = nx + n_hat - n_disturbances
    return Moments(np.array(means)[:, :n], np.array(covs)[:, :n, :n])


def mean_matrix(period: Period) -> Float[Array, "no nq"]:
    """M with every F at its mean."""
    M = period.M
    for channel in period.channels:
        if channel.mean.any():
            M = M + channel.H.dot(channel.mean).dot(channel.G)
    return M


def spread(period: Period, x: Array, X: Array, laws: Laws) -> Float[Array, "no no"]:
    """Covariance that the F add to [x(k+1); y(k)] by not being at their mean."""
    nx, no = len(x), len(period.M)
    total = np.zeros((no, no))
    for channel in period.channels:
        if channel.variance:
            G_x, G_n = channel.G[:, :nx], channel.G[:, nx:]
            seen = (G_x.dot(X) * G_x).sum(axis=1) + (G_n.dot(laws.U) * G_n).sum(axis=1)
            power = seen + (G_x.dot(x) + G_n.dot(laws.n)) ** 2  # diagonal of G E[q q'] G'
            n = min(channel.mean.shape)
            total += (channel.H[:, :n] * (channel.variance * power[:n])).dot(channel.H[:, :n].T)
    return total


def predicted(M: Float[Array, "no nq"], schedule: GainSchedule, k: int, nx: int) -> Joint:
    """How (x, x_pred) comes to k + 1."""
    F, K = at_sample(schedule.F, k), at_sample(schedule.K, k)
    return _joint(M, K, F - K.dot(at_sample(schedule.C, k)), constant(schedule, "f", k), schedule, k, nx)


def _reported(M: Float[Array, "no nq"], schedule: GainSchedule, k: int, nx: int) -> Joint:
    """How (x, x_pred) becomes (x, x_hat) at k."""
    L = at_sample(schedule.L, k)
    stays = np.eye(len(L)) - L.dot(at_sample(schedule.C, k))
    joint = _joint(M, L, stays, 0.0, schedule, k, nx)
    A, B, T = joint.A.copy(), joint.B.copy(), joint.T.copy()
    A[:nx] = np.eye(nx, len(A))
    B[:nx] = T[:nx] = 0.0
    return Joint(A, B, T, joint.c)


def _joint(M: Array, gain: Array, kept: Array, f: Array | float, schedule: GainSchedule, k: int, nx: int) -> Joint:
    n_hat, ny = gain.shape
    T = np.zeros((nx + n_hat, nx + ny))
    T[:nx, :nx] = np.eye(nx)
    T[nx:, nx:] = gain
    passed = T.dot(M)
    A = np.zeros((nx + n_hat, nx + n_hat))
    A[:, :nx] = passed[:, :nx]
    A[nx:, nx:] = kept
    c = np.zeros(nx + n_hat)
    c[nx:] = f - gain.dot(constant(schedule, "d", k))
    return Joint(A, passed[:, nx:], T, c)


def _mean(joint: Joint, mean: Array, n: Array) -> Array:
    moved_mean: Array = joint.A.dot(mean) + joint.B.dot(n) + joint.c
    return moved_mean


def moved(joint: Joint, cov: Array, U: Array, added: Array) -> Array:
    """Covariance of (x, x_pred) after a period."""
    cov = joint.A.dot(cov).dot(joint.A.T) + joint.B.dot(U).dot(joint.B.T) + joint.T.dot(added).dot(joint.T.T)
    symmetric: Array = 0.5 * (cov + cov.T)
    return symmetric


def constant(schedule: GainSchedule, name: Literal["f", "d"], k: int) -> Array:
    """Constant part ``f`` or ``d`` of a filter at k; zero where it has none."""
    values, size = (schedule.f, len(schedule.x0)) if name == "f" else (schedule.d, schedule.C.shape[1])
    return np.zeros(size) if values is None else at_sample(values, k)


def signals(moments: Moments, nx: int) -> Mapping[str, Array]:
    """Series of an experiment: mean and covariance of x, x_hat and, where both have the same states, e = x - x_hat."""
    mean, cov = moments
    found = {"x": (mean[:, :nx], cov[:, :nx, :nx]), "x_hat": (mean[:, nx:], cov[:, nx:, nx:])}
    if mean.shape[1] == 2 * nx:
        E = np.hstack([np.eye(nx), -np.eye(nx)])
        found["e"] = mean[:, :nx] - mean[:, nx:], E @ cov @ E.T
    return {f"{what}({name})": parts[i] for name, parts in found.items() for i, what in enumerate(("mean", "cov"))}
