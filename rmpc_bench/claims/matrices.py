"""Functions of claims on matrices: diagonal, trace, determinant, the excess of one over another, distances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import difference
from rmpc_bench.claims.values import EvaluationError, NoValue, Value, aligned, combine, joined
from rmpc_bench.types import Array

_SINGULAR = 1e-12  # of the largest eigenvalue; below it one cannot be told from 0
_ASYMMETRIC = 1e-9  # of the largest entry; CSV text and recursions of thousands of steps keep more than that


def of_matrix(name: str, value: Value) -> Value:
    """Evaluate diag, trace or det of a matrix, or of each of a series; of a number it is the number."""
    if not value.entry:
        return value
    _check_square(name, value)
    if name == "det":
        return value.of(np.linalg.det(value.array))
    diagonal = np.diagonal(value.array, axis1=-2, axis2=-1)
    return value.of(diagonal.sum(axis=-1) if name == "trace" else diagonal)


def excess(a: Value, b: Value) -> Value:
    """Compute the largest generalised eigenvalue, max z'az / z'bz: above 1 where b does not cover a.

    Parameters
    ----------
    a, b : symmetric matrices or series of them, b without negative eigenvalues

    Returns
    -------
    a number or a series; where b is singular inf if a reaches outside its range, else the value on the range (0 where
    both are 0); NaN where an entry is missing
    """
    a, b = aligned(_symmetric("excess", a), _symmetric("excess", b))
    part = _Spectrum.of("excess", b.array)
    finite = _finite(a.array)
    inner = np.where(finite[..., None, None], a.array, 0.0)
    inner = np.swapaxes(part.directions, -2, -1) @ inner @ part.directions
    null = ~part.kept
    # Rounding of a, or of what b may have there, is no reach.
    limit = _SINGULAR * np.maximum(np.abs(inner).max(axis=(-2, -1)), part.largest)
    outside = (np.abs(inner) * null[..., :, None] * null[..., None, :]).max(axis=(-2, -1)) > limit
    inner = inner * part.scale[..., :, None] * part.scale[..., None, :]
    # Directions that b does not have are put below all others, or their 0 would hide a negative largest eigenvalue.
    below = null * np.linalg.norm(inner, axis=(-2, -1))[..., None]
    largest = np.linalg.eigvalsh(inner - below[..., None] * np.eye(inner.shape[-1]))[..., -1]
    return a.of(np.where(finite & part.finite, np.where(outside, np.inf, largest), np.nan))


def distance(x: Value, centre: Value, P: Value) -> Value:
    """Compute sqrt((x - centre)' P^-1 (x - centre)): at most 1 in the ellipsoid of P.

    Parameters
    ----------
    x, centre : vectors, or columns or series of them; numbers for a P that is one
    P : symmetric matrix or series of them, without negative eigenvalues

    Returns
    -------
    a number, column or series; where P is singular inf if x - centre reaches outside its range, else the distance in
    the range; inf where an entry of x - centre is never
    """
    gap, P = combine(difference, x, centre), _symmetric("distance", P)
    gap = gap if gap.entry else gap.of(gap.array[..., None])
    if P.entry != gap.entry * 2:
        raise EvaluationError(f"distance needs a vector and a matrix, got entries of shapes {gap.entry} and {P.entry}")
    gap, P = joined(gap, P)
    part = _Spectrum.of("distance", P.array)
    finite = np.isfinite(gap.array)
    along = np.einsum("...ji,...j->...i", part.directions, np.where(finite, gap.array, 0.0))
    limit = _SINGULAR * np.maximum((along**2).max(axis=-1), part.largest)
    outside = (along**2 * ~part.kept).max(axis=-1) > limit
    found = np.where(outside, np.inf, np.sqrt(((along * part.scale) ** 2).sum(axis=-1)))
    found = np.where(finite.all(axis=-1), found, np.inf)
    return gap.of(np.where(np.isnan(gap.array).any(axis=-1) | ~part.finite, np.nan, found))


class _Spectrum(NamedTuple):
    """Eigenvalues of a stack of symmetric matrices, those that are 0 up to rounding set apart."""

    directions: Array
    """(..., n, n) eigenvectors in the columns."""
    kept: Array
    """(..., n) whether the direction lies in the range."""
    scale: Array
    """(..., n) 1 / sqrt(eigenvalue); 0 for what is not kept."""
    largest: Array
    """(...) eigenvalue."""
    finite: Array
    """(...) whether the matrix is; the others count as the identity here."""

    @classmethod
    def of(cls, name: str, matrices: Array) -> _Spectrum:
        finite = _finite(matrices)
        values, directions = np.linalg.eigh(np.where(finite[..., None, None], matrices, np.eye(matrices.shape[-1])))
        size = np.abs(values).max(axis=-1, keepdims=True)
        if (values < -_SINGULAR * size).any():
            raise NoValue(f"the last argument of {name} has a negative eigenvalue, {values.min():.3g}")
        kept = values > _SINGULAR * size
        return cls(directions, kept, kept / np.sqrt(np.where(kept, values, 1.0)), size[..., 0], finite)


def _finite(matrices: Array) -> Array:
    return np.asarray(np.isfinite(matrices).all(axis=(-2, -1)))


def _symmetric(name: str, value: Value) -> Value:
    """Check that matrices are symmetric up to rounding, and make them so; a number is a matrix of one entry."""
    if value.entry:
        _check_square(name, value)
    array = value.array if value.entry else value.array[..., None, None]
    mirrored = np.swapaxes(array, -2, -1)
    if (np.abs(array - mirrored) > _ASYMMETRIC * np.abs(array).max(axis=(-2, -1), keepdims=True)).any():
        raise NoValue(f"{name} needs symmetric matrices")
    return value.of((array + mirrored) / 2)


def _check_square(name: str, value: Value) -> None:
    if len(value.entry) != 2 or value.entry[0] != value.entry[1]:
        raise EvaluationError(f"{name} needs square matrices, got entries of shape {value.entry}")
