"""Normalised squares e' P^-1 e of errors with a reported covariance, and the band of their average over runs.

If P is the covariance of a Gaussian error e of n components with mean 0, e' P^-1 e has a chi-square distribution with n
degrees of freedom, and the sum over N independent runs one with N n (Bar-Shalom, Li, Kirubarajan: Estimation with
Applications to Tracking and Navigation, 2001, Section 5.4).  A singular P has as many degrees of freedom as its rank.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rmpc_bench.types import Array

RANK = 1e-14
"""Eigenvalues of a correlation matrix up to this one are rounding of its entries: P is singular there."""
OUTSIDE = 1e-6
"""An error further out than this many standard deviations of its coordinates leaves the range of P."""
ROUNDING = 1e-9
"""Error of a coordinate without variance, relative to a given size, that is rounding."""


class NormalisedSquares(NamedTuple):
    """Normalised squares with their degrees of freedom."""

    values: Array
    """(...) e' P^+ e; inf where e leaves the range of P, NaN where an entry is not a number."""
    freedom: Array
    """(...) rank of P."""


def normalised_squares(e: Array, P: Array, size: Array | float = 1.0) -> NormalisedSquares:
    """Compute e' P^+ e with the pseudo-inverse of P, which is brought to the form of a correlation matrix first.

    Parameters
    ----------
    e : (..., n) errors
    P : (..., n, n) positive semidefinite covariances; its leading axes broadcast with those of e
    size : (..., n) size of the numbers whose difference is e, for what counts as rounding
    """
    std, lam, U = _correlation(P)
    certain = std == 0.0
    a = np.where(certain, 0.0, e / np.where(certain, 1.0, std))
    c = np.einsum("...ji,...j->...i", U, a)
    kept = lam > RANK
    outside = (certain & (np.abs(e) > ROUNDING * np.asarray(size))).any(axis=-1)
    outside |= (~kept & (np.abs(c) > OUTSIDE)).any(axis=-1)
    values = np.where(kept, c**2 / np.where(kept, lam, 1.0), 0.0).sum(axis=-1)
    unknown = np.isnan(e).any(axis=-1) | np.isnan(std).any(axis=-1)
    values = np.where(unknown, np.nan, np.where(outside, np.inf, values))
    return NormalisedSquares(values, np.broadcast_to(kept.sum(axis=-1), values.shape))


def average_of_moments(mean: Array, second: Array, P: Array) -> NormalisedSquares:
    """Compute the average of e' P^+ e over runs with a common P, from moments: trace(P^+ (S + m m')).

    S is the mean square deviation of the errors over the number of runs, not one less.
    """
    std, lam, U = _correlation(P)
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
    return NormalisedSquares(np.where(unknown, np.nan, np.where(outside, np.inf, values)), kept.sum(axis=1))


def chi_square_band(freedom: Array, level: float) -> tuple[Array, Array]:
    """Return the ends of the central band of chi-square over its degrees of freedom; NaN where there are none."""
    from scipy.special import gammainccinv, gammaincinv

    half = np.where(np.asarray(freedom) > 0, np.asarray(freedom, dtype=float) / 2, np.nan)
    tail = (1 - level) / 2
    return np.asarray(gammaincinv(half, tail) / half), np.asarray(gammainccinv(half, tail) / half)


def _correlation(P: Array) -> tuple[Array, Array, Array]:
    """Standard deviations, and eigenvalues and eigenvectors of the correlations; NaN deviations where P is not finite.

    A coordinate without variance has the eigenvalue 0.
    """
    var = np.diagonal(P, axis1=-2, axis2=-1)
    std = np.sqrt(np.where(var <= 0.0, 0.0, var))
    scale = np.where(std == 0.0, np.inf, std)
    with np.errstate(invalid="ignore", over="ignore"):
        R = (P + P.swapaxes(-1, -2)) / 2 / scale[..., :, None] / scale[..., None, :]
    good = np.asarray((np.isfinite(P) & np.isfinite(R)).all(axis=(-2, -1)))
    # eigh raises for the whole stack where one matrix has a NaN.
    lam, U = np.linalg.eigh(np.where(good[..., None, None], R, 0.0))
    return np.where(good[..., None], std, np.nan), lam, U
