"""Stability of an uncertain loop, invariant zeros of a linear system, and what is observable and controllable.

Loop    x(k+1) = (A + H F(k) G) x(k).  It is quadratically stable for all sequences F(k) with F'F <= I if and only if
        rho(A) < 1 and the H-infinity norm of G (zI - A)^-1 H is below 1.  Its second moments converge under white F if
        and only if the spectral radius of X -> E (A + H F G) X (A + H F G)' is below 1.
Source  norm: Bruinsma and Steinbuch, Systems & Control Letters 14 (1990); quadratic stability: Packard and Doyle, IEEE
        Trans. Automatic Control 35 (1990); the mean square by Kronecker products.
Method  The gain is evaluated at the angles of *all* eigenvalues of the symplectic pencil and at the midpoints between
        them.  The ends of every interval in which the gain exceeds a level are among these angles, so that no tolerance
        is needed to decide which eigenvalues are on the unit circle.
"""

from __future__ import annotations

from math import inf, nan, pi, sqrt
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from rmpc_bench.types import Array

ACCURACY = 1e-10
"""Relative accuracy of the norm; limited by double eigenvalues of the pencil, which are accurate to sqrt(1e-16)."""
GRID = 64
"""Number of angles of the first search, in addition to those of the eigenvalues of A."""
INSIDE = 1.0 - 1e-12
"""An eigenvalue of larger modulus counts as on the unit circle or outside: the difference may be rounding."""
NOTHING = 1e-13
"""Relative rounding error of a number."""

System = tuple[Array, Array, Array]


class Peak(NamedTuple):
    """Maximum of the gain of a system over the frequency."""

    norm: float
    angle: float  # frequency [rad per step], 0 to pi; NaN if the gain is infinite or constant


def spectral_radius(A: Float[Array, "n n"]) -> float:
    """Return the largest modulus of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(A)).max())


def hinf_peak(
    A: Float[Array, "n n"], B: Float[Array, "n m"], C: Float[Array, "p n"], D: Float[Array, "p m"] | None = None
) -> Peak:
    """Find the largest gain of C (zI - A)^-1 B + D on the unit circle.

    This is the norm of the transfer matrix.  It is infinite if a controllable and observable mode has |z| >= 1.  Modes
    that are uncontrollable or unobservable have no effect on it, stable or not; quadratic stability also requires
    rho(A) < 1.  The relative error is 1e-10, or that of the rounding of A: about 1e-15 divided by the distance of the
    poles from the unit circle.
    """
    D = np.zeros((len(C), B.shape[1])) if D is None else D
    A, B, C = balanced(A, B, C)
    if spectral_radius(A) > INSIDE:
        stable, unstable, errors = _split(A, B, C)
        if not _vanishes(unstable, errors):
            return Peak(inf, nan)
        A, B, C = stable
        nothing = _vanishes(stable, errors)
    else:
        nothing = _vanishes((A, B, C))
    if nothing:
        return Peak(float(np.linalg.norm(D, 2)), nan)
    first = np.concatenate([np.linspace(0.0, pi, GRID), np.abs(np.angle(np.linalg.eigvals(A)))])
    peak = _highest((A, B, C), D, first)
    # Every iteration raises the peak and squares the error.
    while True:
        level = peak.norm * (1.0 + ACCURACY)
        found = _highest((A, B, C), D, _candidates((A, B, C), D, level))
        if found.norm <= level:  # nothing exceeds the level
            return max(peak, found)
        peak = found


def balanced(A: Float[Array, "n n"], B: Float[Array, "n m"], C: Float[Array, "p n"]) -> System:
    """Scale the states so that rows and columns have similar norms; exact, because the factors are powers of two.

    The balanced matrix has one additional state, which connects all outputs to all inputs.
    """
    from scipy.linalg import matrix_balance

    n = len(A)
    sizes = np.zeros((n + 1, n + 1))
    sizes[:n, :n], sizes[:n, n], sizes[n, :n] = np.abs(A), np.abs(B).sum(axis=1), np.abs(C).sum(axis=0)
    units = matrix_balance(sizes, permute=False, separate=True)[1][0][:n]
    return A * units / units[:, None], B / units[:, None], C * units


def _highest(system: System, D: Array, angles: Float[Array, " angles"]) -> Peak:
    A, B, C = system
    resolvent = np.exp(1j * angles)[:, None, None] * np.eye(len(A)) - A
    gains = np.linalg.norm(C @ np.linalg.solve(resolvent, B) + D, 2, axis=(-2, -1))
    best = int(np.argmax(gains))
    return Peak(float(gains[best]), float(angles[best]))


def _candidates(system: System, D: Array, level: float) -> Float[Array, " angles"]:
    """Return angles that include one with a gain above a level, if such an angle exists."""
    # If level is a singular value of G(z) with |z| = 1, there are u and v with G u = level v and G* v = level u.
    # Written with the states of G and of its adjoint, this is a generalised eigenvalue problem for z without any
    # inverse.
    from scipy.linalg import block_diag, eig

    A, B, C = system
    n, m, p = len(A), B.shape[1], len(C)
    # Scale of the state for which B and C have the same norm.
    share = sqrt(float(np.linalg.norm(C) / np.linalg.norm(B)))
    B, C, D = B * (share / sqrt(level)), C / (share * sqrt(level)), D / level
    M, N = np.zeros((2, 2 * n + m + p, 2 * n + m + p))
    x, q, u, v = np.split(np.arange(len(M)), [n, 2 * n, 2 * n + m])
    M[np.ix_(x, x)], M[np.ix_(x, u)] = A, B  # z x = A x + B u
    M[np.ix_(q, q)] = np.eye(n)  # q = z (A' q + C' v)
    M[np.ix_(v, x)], M[np.ix_(v, u)], M[np.ix_(v, v)] = C, D, -np.eye(p)  # level v = C x + D u
    M[np.ix_(u, q)], M[np.ix_(u, v)], M[np.ix_(u, u)] = B.T, D.T, -np.eye(m)  # level u = B' q + D' v
    N[: 2 * n, : 2 * n], N[np.ix_(q, v)] = block_diag(np.eye(n), A.T), C.T
    alpha, beta = eig(M, N, right=False, homogeneous_eigvals=True)
    ends = np.concatenate([[0.0], np.sort(np.abs(np.angle(alpha * beta.conj()))), [pi]])
    return np.concatenate([ends, 0.5 * (ends[1:] + ends[:-1])])


def _split(A: Array, B: Array, C: Array) -> tuple[System, System, tuple[float, float]]:
    """Decompose a system into a sum of stable and other modes; also return the rounding errors of their B and C."""
    from scipy.linalg import schur, solve_sylvester

    T, Z, n = schur(A, output="real", sort=lambda re, im: abs(complex(re, im)) <= INSIDE)
    X = solve_sylvester(T[:n, :n], -T[n:, n:], -T[:n, n:]) if 0 < n < len(A) else np.zeros((n, len(A) - n))
    error = NOTHING * (1.0 + float(np.linalg.norm(X)))
    errors = error * float(np.linalg.norm(B)), error * float(np.linalg.norm(C))
    B, C = Z.T @ B, C @ Z
    stable = T[:n, :n], B[:n] - X @ B[n:], C[:, :n]
    unstable = T[n:, n:], B[n:], C[:, :n] @ X + C[:, n:]
    return stable, unstable, errors


def _vanishes(system: System, errors: tuple[float, float] | None = None) -> bool:
    """Whether C (zI - A)^-1 B, and therefore C A^j B for all j < n, is zero up to rounding."""
    # `errors` are the absolute errors of the entries of B and C; if not given, their relative error is `NOTHING`.
    A, B, C = system
    size, seen = np.abs(B), np.abs(C)
    B_error = NOTHING * size if errors is None else np.full(B.shape, errors[0])
    C_error = NOTHING * seen if errors is None else np.full(C.shape, errors[1])
    for _ in range(len(A)):
        if (np.abs(C @ B) > seen @ B_error + C_error @ size).any():
            return False
        B, size, B_error = A @ B, np.abs(A) @ size, np.abs(A) @ B_error
    return True


def mean_square_radius(
    A: Float[Array, "n n"], H: Float[Array, "n r"], G: Float[Array, "s n"], mean: float, variance: float
) -> float:
    """Return the spectral radius of X -> E (A + H F G) X (A + H F G)'.

    F is diagonal, with independent entries of the given mean and variance.
    """
    n_entries = min(H.shape[1], len(G))
    H, G = H[:, :n_entries], G[:n_entries]
    expected = A + mean * (H @ G)
    pairs = np.einsum("ai,ib->iab", H, G)
    moment = np.kron(expected, expected) + variance * sum((np.kron(M, M) for M in pairs), np.zeros((len(A) ** 2,) * 2))
    return spectral_radius(moment)


# Structure of a linear system: invariant zeros, and ranks of observability and controllability.
#
# A zero is a z at which [A - zI, B; C, D] has a lower rank than at almost every other z.  Zeros at infinity are removed
# first by orthogonal transformations, until D is square and regular.  As eigenvalues of the whole pencil they would be
# numbers of the order of 1e16^(1/d) for a relative degree d, which cannot be distinguished from finite zeros.
#
# Source  Emami-Naeini and Van Dooren, Automatica 18 (1982).
# Limit   D square and regular: the eigenvalues of A - B D^-1 C.

SMALL = 10.0 * float(np.finfo(float).eps)
"""Singular values below this number times the size and the norm of the system count as 0."""

Blocks = tuple[Array, Array, Array, Array]


def zeros(
    A: Float[Array, "n n"], B: Float[Array, "n m"], C: Float[Array, "p n"], D: Float[Array, "p m"] | None = None
) -> Complex[Array, " zeros"]:
    """Return the finite zeros in any order, including uncontrollable or unobservable modes that lower the rank."""
    from scipy.linalg import eigvals

    system = _scaled(A, B, C, np.zeros((len(C), B.shape[1])) if D is None else D)
    tol = SMALL * sum(np.shape(system[3]) + np.shape(A)) * float(np.linalg.norm(np.block(_blocks(system))))
    A, B, C, D = _dual(_without_infinite(_dual(_without_infinite(system, tol)), tol))
    n, outputs = len(A), np.hstack([C, D])
    if n == 0:
        return np.empty(0, dtype=complex)
    # Basis (n + r, n) of the states and inputs with output zero.
    W = np.linalg.svd(outputs)[2][len(outputs) :].T
    return eigvals(np.hstack([A, B]) @ W, W[:n]).astype(complex)


def _without_infinite(system: Blocks, tol: float) -> Blocks:
    """Remove zeros at infinity until D has full row rank."""
    # Outputs without direct feedthrough are functions of the state. If they are zero, some directions of the state are
    # zero; the next value of these directions is the new output.
    A, B, C, D = system
    while True:
        U, rank = _range(D, tol)
        C, D = U.T @ C, (U.T @ D)[:rank]
        V, fixed = _range(C[rank:].T, tol)
        A, B, C = V.T @ A @ V, V.T @ B, C[:rank] @ V
        if fixed == 0:
            return A, B, C, D
        C, D = np.vstack([C[:, fixed:], A[:fixed, fixed:]]), np.vstack([D, B[:fixed]])
        A, B = A[fixed:, fixed:], B[fixed:]


def _range(M: Array, tol: float) -> tuple[Array, int]:
    """Return an orthogonal matrix whose first columns span the range of M, and the rank of M."""
    U, s, _ = np.linalg.svd(M)
    return U, int((s > tol).sum())


def _dual(system: Blocks) -> Blocks:
    A, B, C, D = system
    return A.T, C.T, B.T, D.T


def _scaled(A: Array, B: Array, C: Array, D: Array) -> Blocks:
    """Scale states, inputs and outputs so that A, B and C have similar norms; this does not change the zeros."""
    A, B, C = balanced(A, B, C)
    size = float(np.linalg.norm(A)) or 1.0
    b, c = (size / (float(np.linalg.norm(M)) or size) for M in (B, C))
    return A, b * B, c * C, b * c * D


def _blocks(system: Blocks) -> list[list[Array]]:
    A, B, C, D = system
    return [[A, B], [C, D]]


RANK = 1e-9
"""Singular values below this, relative to the largest one, count as 0."""


def observable_states(A: Float[Array, "n n"], C: Float[Array, "ny n"]) -> int:
    """Return the rank of [C; C A; C A^2; ..], the number of observable states."""
    scale = float(np.abs(A).max(initial=0.0)) or 1.0
    rows = [C]
    for _ in range(len(A) - 1):
        rows.append(rows[-1] @ A / scale)
    # Each output is divided by its size, so that no output is lost beside another one.
    stacked = np.vstack(rows)
    length = np.linalg.norm(stacked, axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(stacked / np.where(length > 0.0, length, 1.0), rtol=RANK))


def controllable_states(A: Float[Array, "n n"], B: Float[Array, "n nu"]) -> int:
    """Return the rank of [B, A B, A^2 B, ..], the number of controllable states."""
    return observable_states(A.T, B.T)
