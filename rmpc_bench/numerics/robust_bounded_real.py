"""One step of a robust filter with a bound of the error's second moment and a bound of its energy.

Model   x+ = (A + M1 F N) x + w,  y = (C + M2 F N) x + v with any F of norm at most 1, covariance [[Q, S], [S', R]] of
        [w; v], and the estimator x_pred+ = F_hat x_pred + K y with the error e = x - x_pred.
Bounds  If diag(P, X) is a bound of the second moment of [e; x], then so is diag(P+, X+), with
            diag(P+, X+) >= A_c [diag(P, X)^-1 - diag(theta^2 L'L, N'N / alpha)]^-1 A_c' + alpha M_c M_c' + D_c D_c'
        where A_c, M_c and D_c are the matrices of [e; x].  F_hat makes the block between e and x zero, and K minimises
        P+.  As the inequality is that of the bounded real lemma, too, theta^2 times the sum of |L e|^2 is at most the
        energy of the noises, each relative to its covariance, plus [e; x]' diag(P, X)^-1 [e; x] at the start.
        Without uncertainty e does not depend on x: F_hat = A - K C, and no X is needed.
Source  estimators/robust_h_infinity.py, with all symbols.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.numerics.square_root import conditional, lower_root, root_of
from rmpc_bench.types import Array


class Bounds(NamedTuple):
    """Bounds of the second moments of e and x; that of e as a root."""

    root: Float[Array, "nx nx"]
    X: Float[Array, "nx nx"] | None  # none without uncertainty


class BoundedRealStep(NamedTuple):
    """Gains at k and bounds at k+1."""

    K: Float[Array, "nx ny"]
    F: Float[Array, "nx nx"]  # transition matrix beside the innovation: x_pred+ = F x_pred + K (y - C x_pred)
    after: Bounds


class Uncertain(NamedTuple):
    """The uncertain system at one k, with the joint covariance of its noises widened by the uncertainty."""

    A: Float[Array, "nx nx"]
    C: Float[Array, "ny nx"]
    N: Float[Array, "s nx"]
    R: Float[Array, "nz nz"]  # covariance of [w; v] plus alpha [M1; M2] [M1; M2]'


class Limits(NamedTuple):
    """Free parameters of the bounds."""

    alpha: float
    theta: float
    L: Float[Array, "m nx"]
    eps: float


class OutOfRangeError(ValueError):
    """A bound does not exist; the argument is the parameter that is too large or too small."""


def bounded_real_step(system: Uncertain, bounds: Bounds, limits: Limits) -> BoundedRealStep:
    """Return the gains at k and the bounds at k+1.

    An OutOfRangeError names `alpha` if alpha I > N X N' does not hold, `theta` if I > theta^2 L P L' does not.
    """
    (A, C, _, R), nx = system, len(system.A)
    M, joint, X = np.vstack([A, C]), R, None
    extra = limits.eps * np.eye(nx)
    if bounds.X is not None:
        X_inv = _shrunk_inverse(system, bounds.X, limits.alpha)
        # The inverse of R1 in the source, and R2.
        back = np.linalg.solve(A.T, X_inv)
        R2 = symmetrise(np.linalg.solve(A.T, back.T))
        M, joint = M + R[:, :nx].dot(back), R + R[:, :nx].dot(R2).dot(R[:, :nx].T)
        X = symmetrise(A.dot(np.linalg.solve(X_inv, A.T)) + R[:nx, :nx]) + extra
    both = np.hstack([M.dot(_widened(bounds.root, limits)), root_of(joint)])
    found = conditional(both[nx:], both[:nx])
    if not found.regular:
        raise np.linalg.LinAlgError("Singular matrix")
    F = M[:nx] - found.gain.dot(M[nx:]) + found.gain.dot(C)
    return BoundedRealStep(found.gain, F, Bounds(lower_root(found.root, root_of(extra)), X))


def _shrunk_inverse(system: Uncertain, X: Float[Array, "nx nx"], alpha: float) -> Float[Array, "nx nx"]:
    """Return X^-1 - N'N / alpha."""
    N = system.N
    if not np.linalg.eigvalsh(symmetrise(alpha * np.eye(len(N)) - N.dot(X).dot(N.T)))[0] > 0.0:
        raise OutOfRangeError("alpha")
    return np.linalg.inv(X) - N.T.dot(N) / alpha


def _widened(root: Float[Array, "nx nx"], limits: Limits) -> Float[Array, "nx nx"]:
    """Return the root of (P^-1 - theta^2 L'L)^-1, also of a singular P."""
    _, sizes, W = np.linalg.svd(limits.theta * limits.L.dot(root))
    left = 1.0 - np.pad(sizes, (0, len(W) - len(sizes))) ** 2
    if not left[0] > 0.0:
        raise OutOfRangeError("theta")
    return root.dot((W.T / np.sqrt(left)).dot(W))
