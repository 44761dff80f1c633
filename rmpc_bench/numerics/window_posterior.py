"""States and noises of a window of samples, given its measurements: the normal law of all of them at once.

Model   x(j+1) = A_j x(j) + .. + G_j xi_{j+1},  y(j) = C_j x(j) + R_j^(1/2) eta_j,  x of the first sample has the
        covariance P P' with the root P.  xi = [xi_0, xi_1 .. xi_m] and eta are independent, N(0, I).
Method  Sample by sample: given y up to a sample, state and values are a mean plus a root times zeta, N(0, I).
        A measurement rotates zeta so that only its first coordinates act on y.  What y says of every value is then its
        gain on the innovation e(j) of a Kalman filter that starts with the window.  Everything is a response of the
        error of this filter, which is stable: no power of A appears, also for a plant that is unstable.
"""

from __future__ import annotations

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

    @classmethod
    def begun(cls, P_root: Float[Array, "nx n0"], ny: int) -> WindowPosterior:
        """Return the law of the first state before its measurement."""
        none, n = np.zeros(0), P_root.shape[1]
        rows, gain = np.zeros((0, n)), np.zeros((0, 0))
        return cls(P_root, rows, gain, none, none.astype(int), np.zeros((0, len(P_root), ny)))

    def moved(self, A: Float[Array, "nx nx"], G: Float[Array, "nx nr"], w: Float[Array, "nw nr"]) -> WindowPosterior:
        """Return the law after a step without its measurement; w are the rows of the noises that are values."""
        rows = np.hstack([self.rows, np.zeros((len(self.rows), G.shape[1]))])
        law = self._replace(X=np.hstack([A @ self.X, G]), rows=rows)
        return law._with(np.hstack([np.zeros((len(w), self.X.shape[1])), w]), np.zeros(len(w), dtype=int))

    def measured(
        self,
        C: Float[Array, "ny nx"],
        R_v: Float[Array, "ny ny"],
        there: Bool[Array, " ny"],
        chosen: tuple[Bool[Array, " nx"], Bool[Array, " ny"]],
    ) -> WindowPosterior:
        """Return the law after the outputs that are there, with the chosen x and v as values.

        A missing output becomes noise alone.  A LinAlgError says that the covariance of the innovation is singular.
        """
        ny, nx = C.shape
        C, R_v = np.where(there[:, None], C, 0.0), np.where(there[:, None] & there, R_v, np.eye(ny))
        outputs = C @ self.X
        rows = np.vstack([self.X[chosen[0]], -outputs[chosen[1]]])
        law = self._with(rows, np.repeat([1, 2], [each.sum() for each in chosen]))
        stack = np.vstack([law.X, law.rows])
        array = np.zeros((ny + stack.shape[1], ny + len(stack)))
        array[:ny, :ny], array[ny:, :ny], array[ny:, ny:] = psd_sqrt(R_v), outputs.T, stack.T
        turned = eliminated(array, ny)[0]
        gain = np.linalg.solve(turned[:ny, :ny], turned[:ny, ny:]).T * there
        return law._replace(
            X=turned[ny:, ny : ny + nx].T,
            rows=turned[ny:, ny + nx :].T,
            gain=np.hstack([law.gain, gain[nx:]]),
            L=np.concatenate([law.L, gain[None, :nx]]),
        )

    def _with(self, rows: Float[Array, "more n"], kind: Int[Array, " more"]) -> WindowPosterior:
        """Return the law with further values, which nothing has been measured of."""
        return self._replace(
            rows=np.vstack([self.rows, rows]),
            gain=np.vstack([self.gain, np.zeros((len(rows), self.gain.shape[1]))]),
            before=np.concatenate([self.before, np.sqrt((rows * rows).sum(axis=1))]),
            kind=np.concatenate([self.kind, kind]),
        )


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
