"""Theorem 1 of ma2025 as it is printed, with big matrices: oracles of the game recursion.

Nothing here is derived from numerics/lq_game.py: the matrices are (41)-(55), the semidefinite program is (57), and the
dense form has its two multipliers left, with the Schur complement of (57) on G.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from rmpc_bench.numerics.lq_windows import Stages


class Big(NamedTuple):
    """Matrices of (38); the hats without x_hat."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    b: np.ndarray
    c: np.ndarray


def matrices(stages):
    """(41)-(55) for the cost sum x(t+1)' Q x(t+1) + u' R u."""
    N, n, r = stages.B.shape
    z, U = n + N * n, N * r
    big = Big(*(np.zeros(shape) for shape in ((n, n), (U, U), (z, z), (U, z), (U, n), (z, n))))
    for t in range(N):
        product = {t + 1: np.eye(n)}
        for i in range(t, -1, -1):
            product[i] = product[i + 1] @ stages.A[i]
        A_t, B_t, C_t = product[0], np.zeros((n, N * r)), np.zeros((n, N * n))  # (42)-(44)
        for i in range(t + 1):
            B_t[:, i * r : (i + 1) * r] = product[i + 1] @ stages.B[i]
            C_t[:, i * n : (i + 1) * n] = product[i + 1]
        wide, Q = np.hstack([A_t, C_t]), stages.Q[t]  # (46)
        for total, term in zip(
            big,
            (A_t.T @ Q @ A_t, B_t.T @ Q @ B_t, wide.T @ Q @ wide, B_t.T @ Q @ wide, B_t.T @ Q @ A_t, wide.T @ Q @ A_t),
            strict=True,
        ):
            total += term  # (50)-(55)
        big.B[t * r : (t + 1) * r, t * r : (t + 1) * r] += stages.R[t]
    return big


def inverse_sets(M, M_w):
    """(61) and (62)."""
    n, N = len(M), len(M_w)
    first, second = np.zeros((n + N * n,) * 2), np.zeros((n + N * n,) * 2)
    first[:n, :n] = np.linalg.inv(M)
    for t in range(N):
        part = slice(n + t * n, n + (t + 1) * n)
        second[part, part] = np.linalg.inv(M_w[t])
    return first, second


def dense(stages, M, M_w, x):
    """(rho, U): minimise tau_1 + tau_2 + h' G^-1 h over W >= 0, by the zero of its derivative."""
    big, (M_1, M_2), n = matrices(stages), inverse_sets(M, M_w), len(x)
    from_U = np.linalg.solve(big.B, big.D)
    h = (big.c - big.D.T @ np.linalg.solve(big.B, big.b)) @ x  # (58)
    FF = big.D.T @ from_U
    root = np.linalg.cholesky(M)
    w = slice(n, None)

    def edge(tau_2):
        """Smallest tau_1 for W >= 0 and how fast it falls with tau_2, from the null vector of W."""
        inner = np.linalg.solve(tau_2 * M_2[w, w] - big.C[w, w], big.C[w, :n])
        lam, V = np.linalg.eigh(root.T @ (big.C[:n, :n] + big.C[:n, w] @ inner) @ root)
        z_e = root @ V[:, -1]
        z_w = inner @ z_e
        return lam[-1], -(z_w @ M_2[w, w] @ z_w)

    def eta(tau_1, tau_2):
        return np.linalg.solve(tau_1 * M_1 + tau_2 * M_2 - big.C + FF, h)  # (60)

    def best(tau_2):
        low, slope = edge(tau_2)
        excess = lambda tau_1: 1.0 - eta(tau_1, tau_2) @ M_1 @ eta(tau_1, tau_2)  # noqa: E731
        if excess(low) >= 0.0:  # the cost rises with tau_1: on the edge
            return low, excess(low) * slope
        high = 2.0 * low
        while excess(high) < 0.0:
            high *= 2.0
        return brentq(excess, low, high, xtol=1e-14 * low, rtol=1e-15), 0.0

    def derivative(s):
        tau_2 = smallest * (1.0 + np.exp(s))
        tau_1, along = best(tau_2)
        z = eta(tau_1, tau_2)
        return 1.0 - z @ M_2 @ z + along

    G = np.linalg.cholesky(np.linalg.inv(M_2[w, w]))
    smallest = np.linalg.eigvalsh(G.T @ big.C[w, w] @ G)[-1]
    low, high = 0.0, 0.0
    while derivative(low) > 0.0:
        low -= 1.0
    while derivative(high) < 0.0:
        high += 1.0
    tau_2 = smallest * (1.0 + np.exp(brentq(derivative, low, high, xtol=1e-13)))
    tau_1 = best(tau_2)[0]
    z = eta(tau_1, tau_2)
    U = -np.linalg.solve(big.B, big.b @ x) - from_U @ z
    return tau_1 + tau_2 + h @ z, U.reshape(len(stages.A), -1)


def semidefinite(stages, M, M_w, x, **options):
    """(rho, U) of (57), as printed, by cvxpy and Clarabel."""
    import cvxpy

    big, (M_1, M_2) = matrices(stages), inverse_sets(M, M_w)
    lam, V = np.linalg.eigh(big.B)
    root = (V / np.sqrt(lam)) @ V.T
    h = (big.c - big.D.T @ np.linalg.solve(big.B, big.b)) @ x
    F = root @ big.D  # (59)
    y, rho = cvxpy.Variable((len(big.B), 1)), cvxpy.Variable((1, 1))
    tau_1, tau_2 = cvxpy.Variable(nonneg=True), cvxpy.Variable(nonneg=True)
    G = -big.C + tau_1 * M_1 + tau_2 * M_2 + F.T @ F  # (60)
    blocks = [
        [np.eye(len(big.B)), y, F],
        [y.T, rho - tau_1 - tau_2, -h[None]],
        [F.T, -h[:, None], G],
    ]
    matrix = cvxpy.bmat(blocks)
    program = cvxpy.Problem(cvxpy.Minimize(rho[0, 0]), [0.5 * (matrix + matrix.T) >> 0])
    program.solve(solver=cvxpy.CLARABEL, **options)
    U = root @ y.value[:, 0] - np.linalg.solve(big.B, big.b @ x)  # (63)
    return float(rho.value[0, 0]), U.reshape(len(stages.A), -1)


def paper_stages(k, N):
    """The system of (72), (73) and (76) from k on, with R = 1."""
    A = np.array([(1.0 + 0.1 * np.sin(k + t)) * np.array([[0.6, 0.7], [0.25, 0.5]]) for t in range(N)])
    B, Q, R = np.array([[1.0], [0.3]]), np.diag([10.0, 1.0]), np.eye(1)
    return Stages(A, *(np.broadcast_to(each, (N, *each.shape)) for each in (B, Q, R)))


def random_stages(rng, n, r, N):
    """A system and weights that change at every stage."""
    A = rng.standard_normal((N, n, n))
    A *= (0.9 / np.abs(np.linalg.eigvals(A)).max(axis=1))[:, None, None]
    roots_of = [rng.standard_normal((N, m, m)) for m in (n, r)]
    Q, R = (each @ each.mT + shift * np.eye(each.shape[1]) for each, shift in zip(roots_of, (0.0, 0.3), strict=True))
    return Stages(A, rng.standard_normal((N, n, r)), Q, R)


def random_sets(rng, n, N):
    """A set of e and sets of w that change at every stage."""
    M, M_w = rng.standard_normal((n, n)), rng.standard_normal((N, n, n))
    return M @ M.T + 0.1 * np.eye(n), M_w @ M_w.mT + 0.05 * np.eye(n)
