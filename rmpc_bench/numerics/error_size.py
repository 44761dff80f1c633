"""Size of an estimation error relative to a matrix: e' P^-1 e.

P may be singular: an error that leaves its range has the size inf.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.types import Array

RANK = 1e-14
"""Eigenvalues of a correlation matrix up to this one are rounding of its entries: P is singular there."""
OUTSIDE = 1e-6
"""An error further out than this leaves the range: ten standard deviations of a variance of `RANK`."""
ROUNDING = 1e-9
"""Error of a coordinate without variance, relative to the numbers whose difference it is, that is rounding."""


class NormalisedSquares(NamedTuple):
    """e' P^+ e with the spectrum of P, whose leading axes are those of P."""

    values: Float[Array, "*k"]
    """inf where e leaves the range of P, NaN where an entry is not a number."""
    lam: Float[Array, "*p n"]
    """Eigenvalues of P as a matrix of correlations; P is singular where one is at most `RANK`."""
    std: Float[Array, "*p n"]
    """Roots of the diagonal of P."""

    @property
    def freedom(self) -> Array:
        """Rank of P for every value."""
        return np.broadcast_to((self.lam > RANK).sum(axis=-1), self.values.shape)


@np.errstate(all="ignore")
def normalised_squares(
    e: Float[Array, "*k n"], P: Float[Array, "*p n n"], size: Float[Array, "*s n"] | float = 1.0
) -> NormalisedSquares:
    """Return e' P^+ e with the pseudo-inverse of P; leading axes broadcast.

    `size` is that of the numbers whose difference is e, for what counts as rounding.
    """
    # P is brought to the form of a correlation matrix first, so that the units of the coordinates do not matter. Sums
    # over coordinates go one by one: their bits do not depend on how many runs there are.
    std, lam, U = correlations(P)
    certain, none = std == 0.0, lam <= RANK
    a = np.where(certain, 0.0, e / np.where(certain, 1.0, std))
    outside = np.asarray((certain & (np.abs(e) > ROUNDING * np.asarray(size))).any(axis=-1))
    total = np.zeros(a.shape[:-1])
    for i in range(e.shape[-1]):
        c = np.zeros(a.shape[:-1])
        for j in range(e.shape[-1]):
            c += U[..., j, i] * a[..., j]
        outside = outside | (none[..., i] & (np.abs(c) > OUTSIDE))
        total += np.where(none[..., i], 0.0, c**2 / lam[..., i])
    unknown = np.isnan(e).any(axis=-1) | np.isnan(std).any(axis=-1)
    return NormalisedSquares(np.where(unknown, np.nan, np.where(outside, np.inf, total)), lam, std)


def correlations(P: Float[Array, "*p n n"]) -> tuple[Float[Array, "*p n"], Float[Array, "*p n"], Array]:
    """Standard deviations, and eigenvalues and eigenvectors of the correlations; NaN deviations where P is not finite.

    A coordinate without variance has zeros for its correlations.
    """
    var = np.diagonal(P, axis1=-2, axis2=-1)
    std = np.sqrt(np.where(var <= 0.0, 0.0, var))
    certain = std == 0.0
    with np.errstate(all="ignore"):
        R = symmetrise(P) / std[..., :, None] / std[..., None, :]
    R = np.where(certain[..., :, None] | certain[..., None, :], 0.0, R)
    good = np.asarray((np.isfinite(P) & np.isfinite(R)).all(axis=(-2, -1)))
    # eigh raises for the whole stack where one matrix has a NaN.
    lam, U = np.linalg.eigh(np.where(good[..., None, None], R, 0.0))
    return np.where(good[..., None], std, np.nan), lam, U
