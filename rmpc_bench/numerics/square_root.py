"""Roots of covariances: the correction and the prediction that the filters share.

Root        F with P = F F'; its columns are the independent sources of an error.  A root holds variances whose ratio is
            up to 1e28, where P itself, in doubles, has lost the small ones at 1e16: predicted with A P A', a variance R
            beside P(0) has the relative error 1e-16 P(0) / R before any correction.
Correction  y and a vector z have the joint root [Y; Z].  The orthogonal triangularisation of [Y' Z'] is [U W; 0 F'],
            with U' U the covariance of y, W' U that of z and y, and F F' the covariance of z given y.
            z = x is the correction of a filter, z = x(k+1) that of a one-step predictor, also with correlated noises.
Order       Every column is eliminated with the row (source) that is largest in it, which makes Householder's method
            accurate relative to every source (Cox and Higham 1998): relative errors of the variances are below 3e-10 at
            P(0) / R = 1e14 (measured; without exchanges, as LAPACK, up to 1e-8; Joseph's form of P: 1e-3).
Singular    Where the covariance of y is singular to rounding of U, the gain is that of its pseudo-inverse.
Bits        A matrix of a stack is computed alone, whatever other matrices there are.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.types import Array

SINGULAR = 4 * np.finfo(float).eps
"""Pivots of a root that are smaller, relative to their column, are roundings of 0."""


_SMALL = 4000
"""Size m n^2 of an array from which on NumPy is faster."""


class Conditional(NamedTuple):
    """A vector z given y."""

    gain: Float[Array, "*k nz ny"]  # z_hat = z_mean + gain (y - y_mean)
    root: Float[Array, "*k nz nz"]  # lower triangular root of the covariance of z_hat - z
    upper: Float[Array, "*k ny ny"]  # upper triangular U with U' U the covariance of y
    regular: Bool[Array, "*k"]  # whether that covariance is regular; False for NaN


def covariance_of(root: Float[Array, "*k n r"]) -> Float[Array, "*k n n"]:
    """Return F F', symmetric to the last bit."""
    root = np.ascontiguousarray(root)  # for the reason given in `linalg.mv`
    product: Array = root @ root.mT
    return 0.5 * (product + product.mT)


def root_of(P: Float[Array, "*k n n"]) -> Float[Array, "*k n n"]:
    """Return a root: the Cholesky factor, or the symmetric root where P is singular."""
    return _root(P.shape, P.tobytes()) if P.ndim == 2 else _root_of(P)


@lru_cache(maxsize=256)
def _root(shape: tuple[int, ...], content: bytes) -> Array:
    """Return the root of a matrix; the noises of a model are asked for at every step."""
    root = _root_of(np.frombuffer(content).reshape(shape))
    root.flags.writeable = False
    return root


def _root_of(P: Array) -> Array:
    try:
        return np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        # A singular matrix of one run must not change the bits of the others.
        return psd_sqrt(P) if P.ndim == 2 else np.array([_root_of(each) for each in P])


def triangle(rows: Float[Array, "*k m n"]) -> Float[Array, "*k n n"]:
    """Return the upper triangular U with U' U = rows' rows, by Householder's method with row exchanges."""
    m, n = rows.shape[-2:]
    if rows.ndim == 2 and m * n * n < _SMALL:
        return _small_triangle(rows)
    W = np.zeros((int(np.prod(rows.shape[:-2])), max(m, n), n))
    W[:, :m] = rows.reshape(-1, m, n)
    each = np.arange(len(W))
    for j in range(min(m - 1, n)):
        left = W[:, j:]
        pivot = np.abs(left[:, :, j]).argmax(axis=1)
        left[each, pivot], left[:, 0] = left[:, 0].copy(), left[each, pivot]
        v = left[:, :, j].copy()
        length = -np.copysign(np.sqrt((v * v).sum(axis=1)), v[:, 0])
        v[:, 0] -= length
        half = -length * v[:, 0]
        half[half == 0.0] = 1.0
        rest = left[:, :, j + 1 :]
        rest -= v[:, :, None] * ((v[:, :, None] * rest).sum(axis=1) / half[:, None])[:, None]
        left[:, 0, j], left[:, 1:, j] = length, 0.0
    return W[:, :n].reshape(*rows.shape[:-2], n, n)


def _small_triangle(rows: Float[Array, "m n"]) -> Float[Array, "n n"]:
    """Return the same in Python's numbers, five times as fast for the few numbers of the step of a design."""
    m, n = rows.shape
    columns = [[*column, *[0.0] * (n - m)] for column in rows.T.tolist()]
    for j in range(min(m - 1, n)):
        sizes = [abs(each) for each in columns[j][j:]]
        pivot = j + sizes.index(max(sizes))
        if pivot > j:
            for column in columns[j:]:
                column[j], column[pivot] = column[pivot], column[j]
        v, total = columns[j][j:], 0.0
        for each in v:
            total += each * each
        if total == 0.0:
            continue
        length = -math.copysign(math.sqrt(total), v[0])
        v[0] -= length
        half = -length * v[0]
        columns[j][j:] = [length, *[0.0] * (len(v) - 1)]
        for column in columns[j + 1 :]:
            total = 0.0
            for a, b in zip(v, column[j:], strict=True):
                total += a * b
            total /= half
            column[j:] = [b - total * a for a, b in zip(v, column[j:], strict=True)]
    return np.array(columns).T[:n].copy()


def lower_root(*parts: Array) -> Float[Array, "... n n"]:
    """Return the lower triangular root of the sum of the covariances of some roots."""
    if all(each.ndim == 2 for each in parts):
        return triangle(np.concatenate(parts, axis=1).T).T.copy()
    stack = np.broadcast_shapes(*(each.shape[:-2] for each in parts))
    rows = [np.broadcast_to(each.mT, (*stack, *each.mT.shape[-2:])) for each in parts]
    return np.ascontiguousarray(triangle(np.concatenate(rows, axis=-2)).mT)


def conditional(Y: Float[Array, "*k ny r"], Z: Float[Array, "*k nz r"]) -> Conditional:
    """Return z given y, which have the joint root [Y; Z]."""
    ny = Y.shape[-2]
    upper = triangle(np.concatenate([Y.mT, Z.mT], axis=-1))
    U, W, root = upper[..., :ny, :ny], upper[..., :ny, ny:], np.ascontiguousarray(upper[..., ny:, ny:].mT)
    pivots = np.abs(np.diagonal(U, axis1=-2, axis2=-1))
    size = np.sqrt((U * U).sum(axis=-2))
    regular = np.asarray((pivots > SINGULAR * ny * size).all(axis=-1))
    sound = U if regular.all() else np.where(regular[..., None, None], U, np.eye(ny))
    gain = (W / sound if ny == 1 else np.linalg.solve(sound, W)).mT
    if sound is U:
        return Conditional(gain, root, U, regular)
    gain = np.where(regular[..., None, None], gain, W.mT @ _pseudo_inverse(U, size).mT)
    rest = lower_root(Z - gain @ Y)
    return Conditional(gain, np.where(regular[..., None, None], root, rest), U, regular)


def without_missing(R_v: Float[Array, "ny ny"], there: Bool[Array, "*k ny"]) -> Float[Array, "*k ny ny"]:
    """Return the covariance in which a missing output is independent of the others; its row of C must be 0."""
    return np.where(there[..., :, None] & there[..., None, :], R_v, np.eye(len(R_v)))


def _pseudo_inverse(U: Array, size: Array) -> Array:
    """Return U^+ with the outputs scaled to variance 1, so that their units do not decide; NaN stays NaN."""
    finite = np.isfinite(U).all(axis=(-2, -1), keepdims=True)
    unit = np.where(size > 0.0, size, 1.0)[..., None, :]
    inverse = np.linalg.pinv(np.where(finite, U / unit, 0.0), rcond=SINGULAR * U.shape[-1])
    return np.where(finite, inverse / unit.mT, np.nan)


def corrected(
    C: Float[Array, "... ny nx"], R_root: Float[Array, "... ny m"], root: Float[Array, "... nx r"]
) -> Conditional:
    """Return x given y = C x + v, from the roots of the prediction and of v."""
    ny, both = C.shape[-2], joint_root(C @ root, R_root, root)
    return conditional(both[..., :ny, :], both[..., ny:, :])


def joint_root(
    image: Float[Array, "*k ny r"], R_root: Float[Array, "... ny m"], source: Float[Array, "*k nx r"]
) -> Float[Array, "... nz more"]:
    """Return the joint root of y = h(x) + v and x, where `image` and `source` are that of h(x) and x."""
    stack = image.shape[:-2] if R_root.ndim == 2 else np.broadcast_shapes(image.shape[:-2], R_root.shape[:-2])
    (ny, r), m = image.shape[-2:], R_root.shape[-1]
    both = np.zeros((*stack, ny + source.shape[-2], r + m))
    both[..., :ny, :r], both[..., :ny, r:], both[..., ny:, :r] = image, R_root, source
    return both
