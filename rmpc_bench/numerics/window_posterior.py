"""States and noises of a window of samples, given its measurements: the normal law of all of them at once.

Model   x(j+1) = A_j x(j) + .. + G_j xi_{j+1},  y(j) = C_j x(j) + R_j^(1/2) eta_j,  x of the first sample has the
        covariance P P' with the root P.  xi = [xi_0, xi_1 .. xi_m] and eta are independent, N(0, I).  x = x_bar +
        Psi xi, where x_bar is the window without noise.
Method  The posterior of xi has the mean gain r, with r = y - C x_bar, and the covariance root root'.  Both follow from
        an orthogonal triangularisation of [R^(1/2) Phi; 0 I], Phi = C Psi.  Nothing is inverted but the root of the
        covariance of r: P, G and R may be singular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import psd_sqrt, symmetrise
from rmpc_bench.types import Array

RANK = 1e-14
"""Smaller eigenvalues of a matrix of correlations are roundings of 0."""


class WindowStages(NamedTuple):
    """Matrices of the samples j = 0..m of a window."""

    A: Float[Array, "m nx nx"]
    G: Float[Array, "m nx nr"]
    """Roots of the process noise: its covariance is G G'."""
    C: Float[Array, "points ny nx"]
    R_v: Float[Array, "points ny ny"]


class WindowPosterior(NamedTuple):
    """The unknowns xi of a window and their law, given the residuals r of its measurements."""

    states: Float[Array, "points nx n"]
    """Psi: states from xi."""
    outputs: Float[Array, "points ny n"]
    """Phi: outputs from xi; zero for a missing output."""
    gain: Float[Array, "n p"]
    """Mean of xi from the residuals of all samples, p = points ny."""
    root: Float[Array, "n n"]
    """Root of the covariance of xi."""


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


def window_posterior(
    stages: WindowStages, P_root: Float[Array, "nx n0"], measured: Bool[Array, "points ny"]
) -> WindowPosterior:
    """Return the law of xi.

    Parameters
    ----------
    stages : matrices of the window
    P_root : root of the covariance of the first state
    measured : which outputs are there; a missing one becomes noise alone

    Raises
    ------
    numpy.linalg.LinAlgError
        If the covariance of the residuals is singular.
    """
    (points, ny), (nx, n0), nr = measured.shape, P_root.shape, stages.G.shape[2]
    n, p = n0 + (points - 1) * nr, points * ny
    states = np.zeros((points, nx, n))
    states[0, :, :n0] = P_root
    for j in range(points - 1):
        states[j + 1] = stages.A[j] @ states[j]
        states[j + 1, :, n0 + j * nr : n0 + (j + 1) * nr] = stages.G[j]
    outputs = np.where(measured[:, :, None], stages.C @ states, 0.0)
    both = measured[:, :, None] & measured[:, None, :]
    roots = psd_sqrt(np.where(both, stages.R_v, np.eye(ny)))
    array = np.zeros((p + n, p + n))
    for j in range(points):
        array[j * ny : (j + 1) * ny, j * ny : (j + 1) * ny] = roots[j]
    array[:p, p:] = outputs.reshape(p, n)
    array[p:, p:] = np.eye(n)
    lower = np.asarray(np.linalg.qr(array.T, mode="r")).T
    gain = np.linalg.solve(lower[:p, :p].T, lower[p:, :p].T).T
    return WindowPosterior(states, outputs, gain, lower[p:, p:])
