"""Mean and covariance of f(x) for a Gaussian x and a nonlinear f: by sigma points, or by central differences.

Every run has its own mean and covariance; the points of all runs are evaluated in one call.

Points   x and x +- column j of sqrt((n + lam) P), n + lam = alpha^2 (n + kappa).  Weights of the mean: lam / (n + lam),
         others w = 1 / (2 (n + lam)); of the covariance: that of x plus 1 - alpha^2 + beta.
         With d_i = f(x_i) - f(x) and m = sum w d_i these weights give
             mean = f(x) + m,   covariance = sum w d_i d_i' + (beta - alpha^2) m m'.
         In this form no weight of -1e6 cancels digits when alpha is small.
         The root is the Cholesky factor.  Where P is not positive definite it is the symmetric root of the part of P
         with positive eigenvalues.
Differences  Column i of the Jacobian is [f(x + h_i) - f(x - h_i)] / (2 h_i), h_i = spread sqrt(P_ii);
         mean = f(x), covariance = J P J'.  A step of one standard deviation can contain a jump, such as the end of
         sticking; a tiny one does not.
Limit    For a linear f both are exact.  alpha -> 0 gives the mean f(x) of the differences plus a term of order P.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import congruence, symmetrise
from rmpc_bench.types import Array

INDEFINITE = 1e-12
"""A P whose smallest eigenvalue is below minus this share of the largest is indefinite, not only rounded."""
SMALLEST_STEP = 1e-8
"""Shortest step of a difference relative to |x_i|: below it f(x + h) - f(x - h) has no correct digits."""
BEST_STEP = float(np.cbrt(np.finfo(float).eps))
"""Step of a difference relative to |x_i| or 1 where the standard deviation is zero: least sum of both errors."""

Map = Callable[[Float[Array, "runs points n"]], Float[Array, "runs points m"]]
"""A function of the points of every run."""


class Moments(NamedTuple):
    """Moments of f(x), and the covariance of x and f(x)."""

    mean: Float[Array, "runs m"]
    covariance: Float[Array, "runs m m"]
    cross: Float[Array, "runs n m"]
    J: Float[Array, "runs m n"] | None
    """Jacobian with which the covariances are J P J' and P J'; None for sigma points."""
    indefinite: Bool[Array, " runs"]
    """Whether P has a negative eigenvalue beyond rounding."""


class MomentRule:
    """Base class of the ways to compute the moments."""

    def points_of(self, n: int) -> int:
        """Return how many points of a state of size n are evaluated."""
        return 2 * n + 1

    def moments(self, f: Map, x: Float[Array, "runs n"], P: Float[Array, "runs n n"]) -> Moments:
        """Return the moments of f(x), x with mean `x` and covariance `P`."""
        raise NotImplementedError("moments")


@dataclass(frozen=True)
class SigmaPoints(MomentRule):
    """Sigma points with the parameters of the unscented transform; the defaults are those of the cubature rule.

    Parameters
    ----------
    alpha : spread of the points
    beta : added weight of the centre in the covariance
    kappa : added to the number of states in the spread
    """

    alpha: float = 1.0
    beta: float = 0.0
    kappa: float = 0.0

    def moments(self, f: Map, x: Float[Array, "runs n"], P: Float[Array, "runs n n"]) -> Moments:
        """Return the moments of f(x), x with mean `x` and covariance `P`."""
        n = x.shape[1]
        c = self.alpha**2 * (n + self.kappa)
        root, indefinite = covariance_root(P)
        # Row j is column j of the root.
        columns = np.sqrt(c) * root.swapaxes(1, 2)
        at_mean, up, down = _evaluated(f, x, columns)
        d = np.concatenate([up, down], axis=1) - at_mean[:, None]
        w = 0.5 / c
        m = w * np.einsum("rpi->ri", d)
        covariance = w * np.einsum("rpi,rpj->rij", d, d) + (self.beta - self.alpha**2) * np.einsum("ri,rj->rij", m, m)
        cross = w * np.einsum("rpi,rpj->rij", columns, up - down)
        return Moments(at_mean + m, symmetrise(covariance), cross, None, indefinite)


@dataclass(frozen=True)
class CentralDifferences(MomentRule):
    """Linearisation by central differences whose steps are multiples of the standard deviations.

    Parameters
    ----------
    spread : step in standard deviations
    """

    spread: float = 1.0

    def moments(self, f: Map, x: Float[Array, "runs n"], P: Float[Array, "runs n n"]) -> Moments:
        """Return the moments of f(x) with f linearised at `x`; `P` also sets the steps."""
        h = self.spread * np.sqrt(np.maximum(np.einsum("rii->ri", P), 0.0))
        size = np.abs(x)
        h = np.where(h > SMALLEST_STEP * size, h, BEST_STEP * np.maximum(size, 1.0))
        at_mean, up, down = _evaluated(f, x, h[:, :, None] * np.eye(x.shape[1]))
        # The step that the rounded points really have.
        J = np.ascontiguousarray(((up - down) / ((x + h) - (x - h))[:, :, None]).swapaxes(1, 2))
        cross = np.einsum("rij,rkj->rik", P, J)
        # No root of P is needed; only a negative variance is noticed.
        indefinite = (np.einsum("rii->ri", P) < 0.0).any(axis=1)
        return Moments(at_mean, symmetrise(congruence(J, P)), cross, J, indefinite)


def _evaluated(f: Map, x: Float[Array, "runs n"], steps: Float[Array, "runs p n"]) -> tuple[Array, Array, Array]:
    """Return f at x, and at x plus and minus every step, in one call."""
    p, centre = steps.shape[1], x[:, None]
    values = f(np.concatenate([centre, centre + steps, centre - steps], axis=1))
    return values[:, 0], values[:, 1 : p + 1], values[:, p + 1 :]


def covariance_root(P: Float[Array, "runs n n"]) -> tuple[Float[Array, "runs n n"], Bool[Array, " runs"]]:
    """Return S with S S' = P for every run, and whether P is indefinite, so that only its positive part has the root.

    Parameters
    ----------
    P : covariances; NaN in a run gives NaN there

    Examples
    --------
    >>> root, indefinite = covariance_root(np.array([[[4.0, 0.0], [0.0, 1.0]], [[4.0, 0.0], [0.0, -1.0]]]))
    >>> root.tolist(), indefinite.tolist()
    ([[[2.0, 0.0], [0.0, 1.0]], [[2.0, 0.0], [0.0, 0.0]]], [False, True])
    """
    n, indefinite = P.shape[1], np.zeros(len(P), dtype=bool)
    finite: Array = np.asarray(np.isfinite(P).all(axis=(1, 2)))
    sound = P if finite.all() else np.where(finite[:, None, None], P, np.eye(n))
    try:
        root = np.linalg.cholesky(sound)
    except np.linalg.LinAlgError:
        root = np.empty_like(sound)
        for i, each in enumerate(sound):
            root[i], indefinite[i] = _root(each)
    root[~finite] = np.nan
    return root, indefinite


def _root(P: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], bool]:
    """Return the Cholesky factor, or the symmetric root of the positive part."""
    try:
        return np.linalg.cholesky(P), False
    except np.linalg.LinAlgError:
        lam, U = np.linalg.eigh(symmetrise(P))
    positive: Array = np.sqrt(np.maximum(lam, 0.0))
    return np.einsum("ij,j,kj->ik", U, positive, U), bool(lam[0] < -INDEFINITE * np.abs(lam).max())
