"""States and noises of a window of samples, given its measurements: the normal law of all of them at once.

Model   x(j+1) = A_j x(j) + .. + G_j xi_{j+1},  y(j) = C_j x(j) + R_j^(1/2) eta_j,  x of the first sample has the
        covariance P P' with the root P.  xi = [xi_0, xi_1 .. xi_m] and eta are independent, N(0, I).
Method  Sample by sample: given y up to a sample, state and values are a mean plus a root times zeta, N(0, I).
        A measurement rotates zeta so that only its first coordinates act on y.  What y says of every value is then its
        gain on the innovation e(j) of a Kalman filter that starts with the window.  Everything is a response of the
        error of this filter, which is stable: no power of A appears, also for a plant that is unstable.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rmpc_bench.numerics.linalg import eliminated, psd_sqrt, symmetrise
from rmpc_bench.types import Array

RANK = 1e-14
"""Smaller eigenvalues of a matrix of correlations are roundings of 0."""


class WindowStages(NamedTuple):
    """Matrices of the samples j = 0..m of a window."""

    A: Float[Array, "m nx nx"]
    W: Float[Array, "m nw nr"]
    """Roots of the process noise in its own coordinates."""
    G: Float[Array, "m nx nr"]
    """Roots of the process noise in the state: its covariance is G G'."""
    C: Float[Array, "points ny nx"]
    R_v: Float[Array, "points ny ny"]


class WindowPosterior(NamedTuple):
    """The last state and chosen values of a window, given its measurements."""

    X: Float[Array, "nx n"]
    """Root of the covariance of the last state."""
    rows: Float[Array, "values n"]
    """Root of the covariance of the values, in the same unknowns."""
    gain: Float[Array, "values p"]
    """Mean of the values from the innovations of all samples."""
    before: Float[Array, " values"]
    """Standard deviations of the values before the measurement of their sample."""
    kind: Int[Array, " values"]
    """0 for w, 1 for x, 2 for v of a sample."""
    L: Float[Array, "points nx ny"]
    """Gains of the last state of every sample on its innovation."""


class Chosen(NamedTuple):
    """Which coordinates of every sample are values."""

    w: Bool[Array, " nw"]
    x: Bool[Array, " nx"]
    v: Bool[Array, " ny"]


def window_laws(
    stages: WindowStages, P_root: Float[Array, "nx n0"], measured: Bool[Array, "points ny"], chosen: Chosen
) -> Iterator[WindowPosterior]:
    """Yield the laws of the windows of 1, 2, .. samples; each one is valid until the next one is asked for.

    A missing output becomes noise alone.  A LinAlgError says that the covariance of an innovation is singular.
    """
    (points, ny), (nx, n), (nr, sizes) = (
        measured.shape,
        P_root.shape,
        (stages.G.shape[2], [each.sum() for each in chosen]),
    )
    there = measured[:, :, None] & measured[:, None, :]
    roots, C = psd_sqrt(np.where(there, stages.R_v, np.eye(ny))), np.where(measured[:, :, None], stages.C, 0.0)
    # Transposed: a row per unknown, the first ny of them for the noise of the outputs; a column per state and value.
    total, m = nx + points * sum(sizes) - sizes[0], nx
    S, gain, L = (
        np.zeros((ny + n + (points - 1) * nr, total)),
        np.zeros((total, points * ny)),
        np.zeros((points, nx, ny)),
    )
    before, kind = np.zeros(total), np.zeros(total, dtype=int)
    S[ny : ny + n, :nx] = P_root.T
    for j in range(points):
        old, x = m, S[ny : ny + n, :nx]
        if j > 0:
            x[:] = x @ stages.A[j - 1].T
            new, n, m = slice(ny + n, ny + n + nr), n + nr, m + sizes[0]
            S[new, :nx], S[new, old:m] = stages.G[j - 1].T, stages.W[j - 1, chosen.w].T
            x = S[ny : ny + n, :nx]
        outputs, first = x @ C[j].T, m
        m += sizes[1] + sizes[2]
        S[ny : ny + n, first : first + sizes[1]], kind[first:m] = x[:, chosen.x], 1
        S[ny : ny + n, first + sizes[1] : m], kind[first + sizes[1] : m] = -outputs[:, chosen.v], 2
        before[old:m] = np.sqrt(np.einsum("ij,ij->j", S[: ny + n, old:m], S[: ny + n, old:m]))
        array = np.empty((ny + n, ny + m))
        array[:ny, :ny], array[ny:, :ny], array[:, ny:] = roots[j], outputs, S[: ny + n, :m]
        array[:ny, ny:] = 0.0
        turned = eliminated(array, ny)[0]
        S[ny : ny + n, :m], now = turned[ny:, ny:], slice(j * ny, (j + 1) * ny)
        gain[:m, now] = np.linalg.solve(turned[:ny, :ny], turned[:ny, ny:]).T * measured[j]
        L[j] = gain[:nx, now]
        root, every = S[ny : ny + n, :m].T, slice(nx, m)
        yield WindowPosterior(root[:nx], root[nx:], gain[every, : now.stop], before[every], kind[every], L[: j + 1])


def range_root(Q: Float[Array, "n n"]) -> Float[Array, "n rank"]:
    """Return a root of a positive semidefinite matrix, Q = root root', with as many columns as its rank.

    The rank is that of the correlations, so that it does not depend on the units of the coordinates.
    """
    size = np.sqrt(np.maximum(Q.diagonal(), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    lam, U = np.linalg.eigh(symmetrise(Q / unit[:, None] / unit))
    kept = lam > RANK
    root: Array = unit[:, None] * U[:, kept] * np.sqrt(lam[kept])
    return root


def range_of_root(root: Float[Array, "n r"]) -> Float[Array, "n rank"]:
    """Return a root of the same matrix with as many columns as its rank, by the singular values of the correlations."""
    size = np.linalg.norm(root, axis=1)
    unit = np.where(size > 0.0, size, 1.0)[:, None]
    U, sizes, _ = np.linalg.svd(root / unit)
    kept = sizes > RANK
    return root if kept.all() else unit * U[:, : len(sizes)][:, kept] * sizes[kept]
