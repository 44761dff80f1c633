"""Matrices: products over runs, expansion of short forms, discretisation."""

from __future__ import annotations

from math import ceil, log2
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.types import Array, DesignError, Matrix

SMALLEST = 1e-13
"""Pivot relative to its rows that counts as 0, because of the rounding of a factorisation."""


def symmetrise(P: Float[Array, "*k n n"]) -> Float[Array, "*k n n"]:
    """Return the symmetric part of P, or of every matrix of a stack, to remove rounding errors."""
    return 0.5 * (P + P.mT)


def mv(A: Float[Array, "n m"] | Float[Array, "runs n m"], x: Float[Array, "runs m"]) -> Float[Array, "runs n"]:
    """Multiply every row of ``x`` by a shared or a per-run matrix.

    The sum goes by einsum and not by BLAS, whose blocking lets the last bits depend on the number of rows; on
    contiguous memory, because einsum adds up in an order that depends on the layout.
    """
    A, x = np.ascontiguousarray(A), np.ascontiguousarray(x)
    return np.einsum("ij,rj->ri" if A.ndim == 2 else "rij,rj->ri", A, x)


def congruence(
    A: Float[Array, "n m"] | Float[Array, "runs n m"], P: Float[Array, "runs m m"]
) -> Float[Array, "runs n n"]:
    """Return A P A' for every run, with a shared or a per-run A; by einsum for the reason given in `mv`."""
    A = np.ascontiguousarray(A)
    shape = "ij" if A.ndim == 2 else "rij"
    half = np.einsum(f"{shape},rjk->rik", A, np.ascontiguousarray(P))
    return np.einsum(f"rik,{shape.replace('i', 'l').replace('j', 'k')}->ril", half, A)


def appended(window: Array, newest: Array, begin: int = 1) -> Array:
    """Return a window (runs, places, ..) from a place on, with the newest entry as the last one."""
    return np.concatenate([window[:, begin:], newest[:, None]], axis=1)


def as_compiled(array: Array) -> Array:
    """Return an array of the one kind that kernels are compiled for: of doubles, contiguous and writable."""
    # `np.require` takes ten times as long for an array that is of this kind already.
    is_ready = array.flags.carray and array.dtype == np.float64
    return array if is_ready else np.require(array, np.float64, ["C", "W"])


def at_sample(schedule: Any, k: int) -> Any:
    """Return entry k of a schedule, an array with axis 0 = k or a list; a constant one has length 1."""
    if len(schedule) == 1:
        return schedule[0]
    check_time(k, len(schedule))
    return schedule[k]


def check_time(k: int, n: int | float) -> None:
    """Refuse a time index for which NumPy would count from the end."""
    if not 0 <= k < n:
        raise DesignError(f"k = {k} is outside the design, which has 0 <= k < {n}", "k")


def innovation(y: Float[Array, "_ _"], y_pred: Float[Array, "runs ny"]) -> Float[Array, "runs ny"]:
    """Return e = y - y_pred, where y is a measurement of every run."""
    check_signal("y", y, *y_pred.shape)
    return y - y_pred


def driven(B: Float[Array, "n nu"] | Float[Array, "runs n nu"], u: Float[Array, "runs nu"]) -> Float[Array, "runs n"]:
    """Return B u, where u is an input of every run."""
    check_signal("u", u, len(u), B.shape[-1])
    return mv(B, u)


def check_signal(name: str, value: Array, runs: int, n: int) -> None:
    """Refuse a y or u that NumPy would repeat, or of which a kernel would read more than there is."""
    if np.shape(value) == (runs, n):
        return
    noun, shape = {"y": "output", "u": "input"}[name], np.shape(value)
    what = f"must have the axes (runs, {noun}s)"
    if len(shape) == 2:
        what = f"has {shape[1]} value{'s' * (shape[1] != 1)}, the model has {n} {noun}{'s' * (n != 1)}"
        if shape[1] == n:
            what = f"has {shape[0]} row{'s' * (shape[0] != 1)}, the state has {runs} run{'s' * (runs != 1)}"
    raise DesignError(f"{name} {what} (shape {shape}; ({runs}, {n}) fits)", name)


def real_numbers(value: Any) -> Array:
    """Return a new array of real numbers, NaN where a masked array is masked; a ValueError for anything else."""
    try:
        array = np.asanyarray(value)
        if array.dtype.kind not in "biufO":
            raise TypeError(array.dtype)
        return np.array(np.ma.filled(array.astype(float), np.nan))
    except (TypeError, ValueError):
        raise ValueError("must be real numbers") from None


def _numbers(value: Matrix | Array, parameter: str) -> Array:
    try:
        return np.asarray(value, dtype=float)
    except ValueError as error:
        raise DesignError(str(error), parameter) from None


def as_matrix(value: Matrix | Array, n: int, parameter: str = "") -> Float[Array, "n n"]:
    """Expand a number (times the identity), a list (the diagonal) or a matrix to ``(n, n)``."""
    M = _numbers(value, parameter)
    if M.ndim == 0:
        return float(M) * np.eye(n)
    if M.shape == (n,):
        return np.diag(M)
    if M.shape == (n, n):
        return M
    message = f"shape {M.shape} does not fit: a number, {n} numbers or {n} x {n} numbers are required"
    raise DesignError(message, parameter)


def as_covariance(value: Matrix | Array, n: int, parameter: str = "") -> Float[Array, "n n"]:
    """Expand as in `as_matrix` and check that the result is symmetric and positive semidefinite."""
    M = as_matrix(value, n, parameter)
    if not np.isfinite(M).all():
        raise DesignError("must be finite", parameter)
    if not np.array_equal(M, M.T):
        raise DesignError("must be symmetric", parameter)
    smallest, scale = np.linalg.eigvalsh(M)[0], np.abs(M).max()
    if smallest < -1e-12 * scale:  # rounding of eigvalsh is about n * 1e-16 * scale
        raise DesignError(f"must be positive semidefinite (smallest eigenvalue {smallest:.6g})", parameter)
    return M


def as_positive(value: Matrix | Array, n: int, parameter: str = "") -> Float[Array, "n n"]:
    """Expand as in `as_covariance` and check that the result is positive definite."""
    M = as_covariance(value, n, parameter)
    if np.linalg.eigvalsh(M)[0] <= 0.0:
        raise DesignError("must be positive definite", parameter)
    return M


def has_root(P: Float[Array, "*k n n"]) -> bool:
    """Whether a covariance, or every one of a stack, has a Cholesky factor: it is not singular."""
    try:
        np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        return False
    return True


def is_possible(S: Float[Array, "n m"], Q: Float[Array, "n n"], R: Float[Array, "m m"]) -> bool:
    """Whether S can be the cross-covariance of noises with covariances Q and R: [Q S; S' R] is semidefinite."""
    try:
        return not S.any() or bool(len(as_covariance(np.block([[Q, S], [S.T, R]]), len(Q) + len(R))))
    except DesignError:
        return False


def as_vector(value: float | list[float] | Array, n: int, parameter: str = "") -> Float[Array, " n"]:
    """Expand a number (in every entry) or a list to ``(n,)``."""
    v = _numbers(value, parameter)
    if v.ndim == 0:
        return np.full(n, float(v))
    if v.shape == (n,):
        return v
    raise DesignError(f"shape {v.shape} does not fit: a number or {n} numbers are required", parameter)


def psd_sqrt(P: Float[Array, "*k n n"]) -> Float[Array, "*k n n"]:
    """Return the symmetric root S of a positive semidefinite P, or of every matrix of a stack: S S = P."""
    lam, U = np.linalg.eigh(symmetrise(P))
    return (U * np.sqrt(np.maximum(lam, 0.0))[..., None, :]) @ U.mT


def nearly_equal(P: Float[Array, "*k n n"], other: Float[Array, "n n"], tolerance: float) -> Any:
    """Whether covariances agree: |P_ij - other_ij| <= tolerance (other_ii other_jj)^1/2, False for NaN.

    Every entry is compared with the size that it may have, so that the result does not depend on the units of the
    states.  The result is a Boolean, or an array of them for a stack P.
    """
    size = np.sqrt(np.maximum(other.diagonal(), 0.0))
    return (np.abs(P - other) <= tolerance * np.outer(size, size)).all(axis=(-2, -1))


def eliminated(
    T: Float[Array, "rows columns"], n: int, sizes: Float[Array, " rows"] | None = None
) -> tuple[Float[Array, "rows columns"], Int[Array, " n"]]:
    """Return T rotated so that its first n columns have a triangle above zeros, and the order of these columns.

    Reflections with interchanges of rows and columns keep the digits of every row, also if rows of the sizes 1e36 and 1
    stand beside each other.  With the sizes of the rows, which are interchanged in place, dependent columns raise a
    ValueError and the columns stay in the new order; without them the columns are returned in their old order.
    """
    T, order = T.copy(), np.arange(n)
    for i in range(min(n, len(T))):
        lengths = np.sqrt(np.einsum("ij,ij->j", T[i:, i:n], T[i:, i:n]))
        pivot = i + int(np.argmax(lengths))
        T[:, [i, pivot]], order[[i, pivot]] = T[:, [pivot, i]], order[[pivot, i]]
        length, top = lengths[pivot - i], i + int(np.argmax(np.abs(T[i:, i])))
        if sizes is not None and not length > SMALLEST * sizes[i:].max():
            raise ValueError("the cost does not determine the inputs")
        if length == 0.0:
            break
        T[[i, top]] = T[[top, i]]
        if sizes is not None:
            sizes[[i, top]] = sizes[[top, i]]
        v = T[i:, i] / length
        v[0] += np.copysign(1.0, v[0])
        T[i:, i:] -= np.outer(v, (v @ T[i:, i:]) / abs(v[0]))
        T[i + 1 :, i] = 0.0
    if sizes is None:
        T[:, order] = T[:, :n].copy()
    return T, order


def discretise(
    A: Float[Array, "*runs n n"], B: Float[Array, "*runs n m"], Ts: float
) -> tuple[Float[Array, "*runs n n"], Float[Array, "*runs n m"]]:
    """Sample x' = A x + B u with u held over ``Ts`` seconds, by one exponential of the block matrix [[A, B], [0, 0]].

    The results are e^(A Ts) and the integral of e^(A s) B over s in [0, Ts].  The matrices of a stack are sampled in
    half the time that calls one by one take.
    """
    from scipy.linalg import expm

    n, m = B.shape[-2:]
    block = np.zeros((*B.shape[:-2], n + m, n + m))
    block[..., :n, :n], block[..., :n, n:] = A, B
    E = expm(block * Ts)
    return E[..., :n, :n], E[..., :n, n:]


def van_loan(A: Float[Array, "n n"], S: Float[Array, "n n"], Ts: float) -> Float[Array, "n n"]:
    """Return the covariance due to white noise of intensity ``S`` over ``Ts`` seconds.

    The integral of e^(A s) S e^(A' s) over s in [0, Ts].  One exponential (Van Loan 1978) over a time so short that
    e^(-A s) is of moderate size, then doubling: Q(2 s) = Q(s) + e^(A s) Q(s) e^(A' s).
    """
    from scipy.linalg import expm

    n = len(A)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -A, S, A.T
    doublings = max(0, ceil(log2(max(float(np.linalg.norm(A, 1)) * Ts, 1.0))))
    exponential = expm(block * (Ts / 2**doublings))
    E = exponential[n:, n:].T
    Q = symmetrise(E @ exponential[:n, n:])
    for _ in range(doublings):
        Q = symmetrise(Q + E @ Q @ E.T)
        E = E @ E
    return Q
