"""Size of an estimation error relative to a matrix: e' S^-1 e.

S may be singular: an error that leaves its range has the size inf.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.metrics.estimate_checks import estimate_error
from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.types import Array, Record

RANK = 1e-14
"""Eigenvalues of a correlation matrix up to this one are rounding of its entries: P is singular there."""
OUTSIDE = 1e-6
"""An error further out than this leaves the range: ten standard deviations of a variance of `RANK`."""
ROUNDING = 1e-9
"""Error of a coordinate without variance, relative to the largest |x| and |x_hat| of the run, that is rounding."""


class SquaredSize(NamedTuple):
    """e' S^+ e with the spectrum of S, whose leading axes are those of S."""

    values: Float[Array, "runs window"]
    """inf where e leaves the range of S, NaN where an entry is not a number."""
    lam: Float[Array, "*k n"]
    """Eigenvalues of S as a matrix of correlations; S is singular where one is at most `RANK`."""
    std: Float[Array, "*k n"]
    """Roots of the diagonal of S."""


def squared_size(
    record: Record,
    samples: slice,
    S: Float[Array, "window nx nx"] | Float[Array, "runs window nx nx"],
    states: Sequence[int] | None = None,
) -> SquaredSize:
    """Return e' S^+ e with e = x_hat - x and the symmetric S of all runs or of each; `states` are those that count.

    It is inf where e leaves the range of S, NaN where an entry is not a number.
    """
    size = np.maximum(np.abs(record.x), np.abs(record.x_hat)).max(axis=1)
    e = estimate_error(record)[:, samples]
    if states is not None:
        e, S, size = e[..., states], S[..., states, :][..., states], size[:, states]
    return _normalised_square(e, S, size[:, None, :])


def _normalised_square(
    e: Float[Array, "runs window nx"],
    P: Float[Array, "window nx nx"] | Float[Array, "runs window nx nx"],
    size: Float[Array, "runs 1 nx"],
) -> SquaredSize:
    """Return e' P^+ e: inf outside the range of P, NaN where an entry is not a number."""
    # P is brought to the form of a correlation matrix first, so that the units of the coordinates do not matter. Sums
    # over coordinates go one by one: their bits do not depend on how many runs there are.
    std, lam, U = _correlation(P)
    certain, none = std == 0.0, lam <= RANK
    a = np.where(certain, 0.0, e / np.where(certain, 1.0, std))
    outside: Bool[Array, "runs window"] = (certain & (np.abs(e) > ROUNDING * size)).any(axis=2)
    total = np.zeros(e.shape[:2])
    for i in range(e.shape[2]):
        c = np.zeros(e.shape[:2])
        for j in range(e.shape[2]):
            c += U[..., j, i] * a[..., j]
        outside |= none[..., i] & (np.abs(c) > OUTSIDE)
        total += np.where(none[..., i], 0.0, c**2 / lam[..., i])
    unknown = np.isnan(e).any(axis=2) | np.isnan(std).any(axis=-1)
    return SquaredSize(np.where(unknown, np.nan, np.where(outside, np.inf, total)), lam, std)


def _correlation(P: Float[Array, "*k nx nx"]) -> tuple[Float[Array, "*k nx"], Float[Array, "*k nx"], Array]:
    """Standard deviations, and eigenvalues and eigenvectors of the correlations; NaN deviations where P is not finite.

    A coordinate without variance has zeros for its correlations.
    """
    var = np.diagonal(P, axis1=-2, axis2=-1)
    std = np.sqrt(np.where(var <= 0.0, 0.0, var))
    R = symmetrise(P) / std[..., :, None] / std[..., None, :]
    certain = std == 0.0
    R = np.where(certain[..., :, None] | certain[..., None, :], 0.0, R)
    good: Array = np.asarray((np.isfinite(P) & np.isfinite(R)).all(axis=(-2, -1)))
    # eigh raises for the whole stack where one matrix has a NaN.
    lam, U = np.linalg.eigh(np.where(good[..., None, None], R, 0.0))
    return np.where(good[..., None], std, np.nan), lam, U
