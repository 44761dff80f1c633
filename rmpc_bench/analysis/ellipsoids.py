"""Symmetric matrices as shapes of ellipsoids, some of them singular: spectrum and distance from the centre."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rmpc_bench.types import Array

SINGULAR = 1e-12
"""Share of the largest eigenvalue below which an eigenvalue counts as 0."""
ASYMMETRIC = 1e-9
"""Share of the largest entry that mirrored entries may differ by; text files and long recursions keep more digits."""


class Spectrum(NamedTuple):
    """Eigenvalues of a stack of symmetric matrices, with those apart that are 0 up to rounding."""

    directions: Array  # (..., n, n) eigenvectors in the columns
    kept: Array  # (..., n) whether the direction lies in the range
    scale: Array  # (..., n) 1 / sqrt(eigenvalue); 0 for what is not kept
    largest: Array  # (...) eigenvalue
    finite: Array  # (...) whether the matrix is finite; the identity replaces the others here

    @classmethod
    def of(cls, matrices: Array) -> Spectrum:
        """Decompose matrices (..., n, n); a ValueError says that one has a negative eigenvalue."""
        finite = are_finite(matrices)
        values, directions = np.linalg.eigh(np.where(finite[..., None, None], matrices, np.eye(matrices.shape[-1])))
        size = np.abs(values).max(axis=-1, keepdims=True)
        if (values < -SINGULAR * size).any():
            raise ValueError(f"has a negative eigenvalue, {values.min():.3g}")
        kept = values > SINGULAR * size
        return cls(directions, kept, kept / np.sqrt(np.where(kept, values, 1.0)), size[..., 0], finite)


def are_finite(matrices: Array) -> Array:
    """Whether all entries of matrices (..., n, n) are finite, (...)."""
    return np.asarray(np.isfinite(matrices).all(axis=(-2, -1)))


def symmetrised(matrices: Array) -> Array:
    """Return the symmetric part of matrices (..., n, n); a ValueError says that they are not symmetric."""
    mirrored = np.swapaxes(matrices, -2, -1)
    if (np.abs(matrices - mirrored) > ASYMMETRIC * np.abs(matrices).max(axis=(-2, -1), keepdims=True)).any():
        raise ValueError("is not symmetric")
    return np.asarray((matrices + mirrored) / 2)


def distances(gaps: Array, shapes: Array) -> Array:
    """Compute sqrt(z' P^-1 z) of gaps z (..., n) and shapes P (..., n, n): at most 1 in the ellipsoid of P about 0.

    If P is singular it is inf where z reaches outside its range, else the distance in the range; inf where an entry of
    z is infinite, NaN where one is missing.  A ValueError says that a P has a negative eigenvalue.
    """
    part = Spectrum.of(shapes)
    finite = np.isfinite(gaps)
    along = np.einsum("...ji,...j->...i", part.directions, np.where(finite, gaps, 0.0))
    limit = SINGULAR * np.maximum((along**2).max(axis=-1), part.largest)
    outside = (along**2 * ~part.kept).max(axis=-1) > limit
    found = np.where(outside, np.inf, np.sqrt(((along * part.scale) ** 2).sum(axis=-1)))
    found = np.where(finite.all(axis=-1), found, np.inf)
    return np.where(np.isnan(gaps).any(axis=-1) | ~part.finite, np.nan, found)
