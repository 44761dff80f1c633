"""Estimation errors x_hat - x with the reported covariance P, and their normalised squares e' P^-1 e.

If P is the covariance of a Gaussian error e of n components with mean 0, e' P^-1 e has a chi-square distribution with n
degrees of freedom, and the sum over N independent runs one with N n (Bar-Shalom, Li, Kirubarajan: Estimation with
Applications to Tracking and Navigation, 2001, Section 5.4).  A singular P has as many degrees of freedom as its rank.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.analysis.traces import COVARIANCE
from rmpc_bench.numerics.error_size import (
    OUTSIDE,
    RANK,
    ROUNDING,
    NormalisedSquares,
    correlations,
    normalised_squares,
)
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials


MEAN, SCATTER = "mean(e)", "cov(e)"
"""Series of the ensemble; the error is x - x_hat there."""
INNOVATION, INNOVATION_COVARIANCE = "e", "S"
"""Recorded signals of methods that report them."""


class ErrorRuns(NamedTuple):
    """Errors of the recorded runs that finished."""

    runs: Array
    """(runs,) indices."""
    e: Array
    """(runs, samples, n)"""
    P: Array | None
    """(samples, n, n) reported covariances, or (runs, samples, n, n) where every run has its own; None where there are
    none."""
    size: Array
    """(runs, 1, n) size of the numbers whose difference is e."""
    n_failed: int
    """Recorded runs that failed, which are left out."""

    def squares(self) -> tuple[Array, Array]:
        """Return the normalised squares of all runs and their degrees of freedom, (runs, samples)."""
        assert self.P is not None, "asked of methods with a covariance only"
        found = normalised_squares(self.e, self.P, self.size)
        return found.values, found.freedom

    def variances(self) -> Array:
        """Return the reported variances of every run, (runs, samples, n)."""
        assert self.P is not None, "asked of methods with a covariance only"
        return np.broadcast_to(np.diagonal(self.P, axis1=-2, axis2=-1), self.e.shape)


class ErrorMoments(NamedTuple):
    """Mean and covariance of the errors over the runs of an ensemble."""

    mean: Array  # (samples, n) of x_hat - x
    cov: Array  # (samples, n, n)
    n: int  # number of runs; 0 where they are exact

    @property
    def std(self) -> Array:
        """(samples, n) standard deviations."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.cov, axis1=1, axis2=2), 0.0)))

    def squares(self, P: Array) -> NormalisedSquares:
        """Return the average of the normalised squares over the runs, (samples,); the expected one of exact moments."""
        second = self.cov * ((self.n - 1) / self.n if self.n else 1.0)
        return average_of_moments(self.mean, second, P)


def recorded_errors(point: Trials, method: str) -> ErrorRuns | None:
    """Read the errors of the recorded runs; None where x or x_hat is not recorded, or they have other lengths."""
    traces = point.traces.get(method)
    if traces is None or not {"x", "x_hat"} <= set(traces.signals):
        return None
    x, x_hat = traces.signals["x"], traces.signals["x_hat"]
    if x.shape != x_hat.shape:
        return None
    rows, n_failed = _finished(point, method, traces.runs)
    own = traces.signals.get(COVARIANCE)
    P = reported_covariance(point, method, x.shape[1])
    if own is not None:
        matrices = own[rows].reshape(len(rows), *x.shape[1:], x.shape[2])
        # A method that reports none has recorded NaN only.
        P = matrices if np.isfinite(matrices).any() else P
    size = np.maximum(np.abs(x[rows]), np.abs(x_hat[rows])).max(axis=1, initial=0.0)[:, None, :]
    return ErrorRuns(traces.runs[rows], traces.difference("x", x_hat[rows], x[rows]), P, size, n_failed)


def recorded_innovations(point: Trials, method: str) -> ErrorRuns | None:
    """Read the innovations and their covariances; None where one of them is not recorded."""
    traces = point.traces.get(method)
    if traces is None or not {INNOVATION, INNOVATION_COVARIANCE} <= set(traces.signals):
        return None
    rows, n_failed = _finished(point, method, traces.runs)
    e, S = traces.signals[INNOVATION][rows], traces.signals[INNOVATION_COVARIANCE][rows]
    size = np.nanmax(np.abs(e), axis=1, initial=0.0)[:, None, :]
    return ErrorRuns(traces.runs[rows], e, S.reshape(*e.shape, e.shape[2]), size, n_failed)


def ensemble_errors(point: Trials, method: str, *, exact: bool) -> ErrorMoments | None:
    """Read the moments of the errors over an ensemble, exact ones or those from runs; None where there are none."""
    found = ([each for each in point.series_of(name, method) if (each.n == 0) == exact] for name in (MEAN, SCATTER))
    mean, cov = (next(iter(each), None) for each in found)
    return None if mean is None or cov is None else ErrorMoments(-mean.values, cov.values, mean.n)


def reported_covariance(point: Trials, method: str, n_samples: int) -> Array | None:
    """Read the covariance that a design reports, (n_samples, n, n); None where it has none."""
    try:
        P = point.matrix_series(COVARIANCE, method)
    except KeyError:
        return None
    return np.repeat(P, n_samples, axis=0) if len(P) == 1 else P[:n_samples]


def _finished(point: Trials, method: str, runs: Array) -> tuple[Array, int]:
    """Positions of the recorded runs that finished, and the number of those that failed."""
    failed = np.isin(runs, point.runs[point.failed(method)])
    return np.flatnonzero(~failed), int(failed.sum())


def average_of_moments(mean: Array, second: Array, P: Array) -> NormalisedSquares:
    """Compute the average of e' P^+ e over runs with a common P, from moments: trace(P^+ (S + m m')).

    S is the mean square deviation of the errors over the number of runs, not one less.
    """
    std, lam, U = correlations(P)
    certain = std == 0.0
    scale = np.where(certain, 1.0, std)
    total = second + mean[:, :, None] * mean[:, None, :]
    scaled = np.where(certain[:, :, None] | certain[:, None, :], 0.0, total / scale[:, :, None] / scale[:, None, :])
    powers = np.einsum("kji,kjl,kli->ki", U, scaled, U)
    kept = lam > RANK
    # The size of the state is not known here, so that only what is large beside the other errors leaves the range.
    spread = np.sqrt(np.diagonal(total, axis1=1, axis2=2))
    outside = (certain & (spread > ROUNDING * spread.max(axis=1, keepdims=True))).any(axis=1)
    outside |= (~kept & (powers > OUTSIDE**2)).any(axis=1)
    values = np.where(kept, powers / np.where(kept, lam, 1.0), 0.0).sum(axis=1)
    unknown = ~np.isfinite(total).all(axis=(1, 2)) | np.isnan(std).any(axis=1)
    return NormalisedSquares(np.where(unknown, np.nan, np.where(outside, np.inf, values)), lam, std)


def chi_square_band(freedom: Array, level: float) -> tuple[Array, Array]:
    """Return the ends of the central band of chi-square over its degrees of freedom; NaN where there are none."""
    from scipy.special import gammainccinv, gammaincinv

    half = np.where(np.asarray(freedom) > 0, np.asarray(freedom, dtype=float) / 2, np.nan)
    tail = (1 - level) / 2
    return np.asarray(gammaincinv(half, tail) / half), np.asarray(gammainccinv(half, tail) / half)
