"""Functions of claims on matrices: diagonal, trace, determinant, the excess of one over another, distances."""

from __future__ import annotations

import numpy as np

from rmpc_bench.analysis.ellipsoids import SINGULAR, Spectrum, are_finite, distances, symmetrised
from rmpc_bench.analysis.intervals import difference
from rmpc_bench.claims.values import EvaluationError, NoValue, Value, aligned, combine, joined
from rmpc_bench.types import Array


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

    Where b is singular it is inf if a reaches outside its range, else the value on the range (0 where both are 0); NaN
    where an entry is missing.
    """
    a, b = aligned(_symmetric("excess", a), _symmetric("excess", b))
    part = _spectrum("excess", b.array)
    finite = are_finite(a.array)
    inner = np.where(finite[..., None, None], a.array, 0.0)
    inner = np.swapaxes(part.directions, -2, -1) @ inner @ part.directions
    null = ~part.kept
    # Rounding of a, or of what b may have there, is no reach.
    limit = SINGULAR * np.maximum(np.abs(inner).max(axis=(-2, -1)), part.largest)
    outside = (np.abs(inner) * null[..., :, None] * null[..., None, :]).max(axis=(-2, -1)) > limit
    inner = inner * part.scale[..., :, None] * part.scale[..., None, :]
    # Directions that b does not have are put below all others, or their 0 would hide a negative largest eigenvalue.
    below = null * np.linalg.norm(inner, axis=(-2, -1))[..., None]
    largest = np.linalg.eigvalsh(inner - below[..., None] * np.eye(inner.shape[-1]))[..., -1]
    return a.of(np.where(finite & part.finite, np.where(outside, np.inf, largest), np.nan))


def distance(x: Value, centre: Value, P: Value) -> Value:
    """Compute sqrt((x - centre)' P^-1 (x - centre)): at most 1 in the ellipsoid of P.

    Where P is singular it is inf if x - centre reaches outside its range, else the distance in the range.
    """
    gap, P = combine(difference, x, centre), _symmetric("distance", P)
    gap = gap if gap.entry else gap.of(gap.array[..., None])
    if P.entry != gap.entry * 2:
        raise EvaluationError(f"distance needs a vector and a matrix, got entries of shapes {gap.entry} and {P.entry}")
    gap, P = joined(gap, P)
    try:
        return gap.of(distances(gap.array, P.array))
    except ValueError as error:
        raise NoValue(f"the last argument of distance {error}") from None


def _spectrum(name: str, matrices: Array) -> Spectrum:
    try:
        return Spectrum.of(matrices)
    except ValueError as error:
        raise NoValue(f"the last argument of {name} {error}") from None


def _symmetric(name: str, value: Value) -> Value:
    """Check that matrices are symmetric up to rounding, and make them so; a number is a matrix of one entry."""
    if value.entry:
        _check_square(name, value)
    array = value.array if value.entry else value.array[..., None, None]
    try:
        return value.of(symmetrised(array))
    except ValueError:
        raise NoValue(f"{name} needs symmetric matrices") from None


def _check_square(name: str, value: Value) -> None:
    if len(value.entry) != 2 or value.entry[0] != value.entry[1]:
        raise EvaluationError(f"{name} needs square matrices, got entries of shape {value.entry}")
