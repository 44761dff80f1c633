"""States of a window that minimise the bounds of the noises: the most probable states for uniform noise.

Problem     Minimise sum rho_i + sum r_o over the states x(j) of the window and the half-widths rho, r >= 0 subject to
            |x(j) - A_j x(j-1) - c_j| <= rho,  |y(j) - C_j x(j)| <= r.  In a `free` window the first state has no state
            equation; in an `anchored` window it has one with the estimate of the previous state.
Dual        lam_j and mu_j are the Lagrange multipliers of the equations at j.  The sums over the window of |lam_j,i|
            and |mu_j,o| are at most 1, lam_j = A_(j+1)' lam_(j+1) + C_j' mu_j (the coefficients of x(j) vanish), and
            lam = 0 at the first point of a free window, which has no state equation.
Reduced     With rho = 0 the first state is the only unknown: a minimax fit of the outputs.  Its dual has the same mu,
            the same value, and F' mu = 0, which is lam = 0 at the first point.
Certificate If all sums |lam_j,i| are at most 1, mu of the reduced program and the lam that follow from it are feasible
            in the dual of the full program.  Their value is then a lower bound of the full optimum, and rho = 0 is
            optimal.  Conversely, if rho = 0 is optimal, such a mu exists.  If the sums are below 1, complementary
            slackness, rho_i (1 - sum |lam_j,i|) = 0, gives rho = 0 in every optimum; a unique reduced optimum is then
            the unique full optimum.  A fit without residuals needs no certificate: its value 0 is optimal.
Otherwise   The optimum may not be unique; if rho > 0, even x at the last point is not unique if its output is far from
            its bounds.  In this case, and for every anchored window, the full linear program is solved with a second
            objective: among all optima, the least weighted sum of the absolute values of all noises.  With equal
            weights this is not unique either, and solvers return estimates that differ by half of the noise.  Therefore
            process noise has 1 % more weight, or a weight of the caller, and the weight of every noise falls by 1 %
            per sample of age, which excludes ties between a few noises.
Cost        7 us per run for 4 points of 6 states and 3 outputs with a certificate; 1.6 ms without.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rmpc_bench.numerics.linalg import as_compiled, mv
from rmpc_bench.numerics.lp import Bounds, LpStatus, lexicographic
from rmpc_bench.numerics.minimax import FitOutcome, fit
from rmpc_bench.types import Array

CERTAIN = 1.0 - 1e-9
"""Largest sum of |lam| that is certainly below 1."""
NOTHING = 1e-11
"""Residuals that count as zero, relative to the data: the accuracy of minimax.py."""

WIDEST = 1e6
"""Largest ratio of the sizes of two outputs that the solver supports: it keeps bounds to 1e-10."""

AGE, PROCESS = 0.99, 1.01
"""Weight of a noise in the second objective, per sample of age, and the usual one of process noise."""


class MeasurementWindow(NamedTuple):
    """The last samples of every run, the newest one last; places before the first point are not used.

    Entry j of A, c and before belongs to the step from the point before to point j: x(j) = A_j x(j-1) + c_j.
    """

    y: Float[Array, "runs places ny"]
    A: Float[Array, "runs places nx nx"]
    c: Float[Array, "runs places nx"]
    before: Float[Array, "runs places nx"]  # estimate of x(j-1)


class WindowFits(NamedTuple):
    """Solutions of the windows, one per run."""

    x: Float[Array, "runs nx"]  # state at the last point
    rho: Float[Array, "runs nx"]
    r: Float[Array, "runs ny"]
    solved: Bool[Array, " runs"]  # false if the data are not finite or a solver fails


def fit_free(
    window: MeasurementWindow, C: Float[Array, "kC ny nx"], points: int, process: float = PROCESS
) -> WindowFits:
    """Fit the last points, two or more, without a state equation of the first one; C for all of them or one each."""
    path, d = predicted(window, C, points, anchored=False)
    F, moved = reduced(window, C, points)
    fits = fit(F, d, np.tile(np.arange(C.shape[1]), points))
    x = path[:, -1] + mv(moved, fits.x)
    certain = (multiplier_sums(window, C, points, fits.mu) < CERTAIN).all(axis=1)
    exact = fits.r.sum(axis=1) <= NOTHING * np.abs(d).max(axis=1)
    found = WindowFits(x, np.zeros_like(x), fits.r, (fits.outcome == FitOutcome.UNIQUE) & (certain | exact))
    rest = np.flatnonzero(~found.solved)
    return _solved_in_full(found, rest, window, C, path, d, process, anchored=False) if len(rest) else found


def fit_anchored(
    window: MeasurementWindow, C: Float[Array, "kC ny nx"], points: int, process: float = PROCESS
) -> WindowFits:
    """Fit the last points with a state equation from the estimate before the first one; parameters as in `fit_free`."""
    path, d = predicted(window, C, points, anchored=True)
    x, r = np.empty_like(path[:, -1]), np.empty_like(window.y[:, -1])
    found = WindowFits(x, np.empty_like(x), r, np.zeros(len(x), dtype=bool))
    return _solved_in_full(found, np.arange(len(x)), window, C, path, d, process, anchored=True)


def predicted(
    window: MeasurementWindow, C: Float[Array, "kC ny nx"], points: int, *, anchored: bool
) -> tuple[Float[Array, "runs points nx"], Float[Array, "runs outputs"]]:
    """Return the states of the points without noise, and the differences of the outputs; rounding counts as 0."""
    from rmpc_bench.numerics.bounded_window_kernel import path_kernel

    runs, places, ny = window.y.shape
    path, d = np.empty((runs, points, window.c.shape[2])), np.empty((runs, points * ny))
    y, A, c, before, C = map(as_compiled, (*window, C))
    path_kernel(y, A, c, before, C, places - points, anchored, path, d)
    return path, d


def reduced(
    window: MeasurementWindow, C: Float[Array, "kC ny nx"], points: int
) -> tuple[Float[Array, "runs outputs nx"], Float[Array, "runs nx nx"]]:
    """Return the derivatives of the outputs and of the last state by the first state, without process noise."""
    from rmpc_bench.numerics.bounded_window_kernel import reduced_kernel

    runs, places, ny = window.y.shape
    nx = window.c.shape[2]
    F, moved = np.empty((runs, points * ny, nx)), np.empty((runs, nx, nx))
    A, C = as_compiled(window.A), as_compiled(C)
    reduced_kernel(A, C, places - points, F, moved)
    return F, moved


def multiplier_sums(
    window: MeasurementWindow, C: Float[Array, "kC ny nx"], points: int, mu: Float[Array, "runs outputs"]
) -> Float[Array, "runs nx"]:
    """Return the sums of |lam_j,i| over the points, from the multipliers mu of the outputs."""
    from rmpc_bench.numerics.bounded_window_kernel import multiplier_kernel

    sums = np.empty((len(mu), window.c.shape[2]))
    A, C = as_compiled(window.A), as_compiled(C)
    multiplier_kernel(A, C, A.shape[1] - points, mu, sums)
    return sums


def full_matrix(
    window: MeasurementWindow, C: Float[Array, "kC ny nx"], points: int, *, anchored: bool
) -> Float[Array, "runs equations states"]:
    """Return the matrix of all equations in the states of the points: C x(j) of every point, then x(j) - A_j x(j-1)."""
    runs, places, ny = window.y.shape
    nx = window.c.shape[2]
    outputs, begin = points * ny, 0 if anchored else 1
    F = np.zeros((runs, outputs + (points - begin) * nx, points * nx))
    for j in range(points):
        now, before = slice(j * nx, (j + 1) * nx), slice((j - 1) * nx, j * nx)
        F[:, j * ny : (j + 1) * ny, now] = C[min(j, len(C) - 1)]
        if j >= begin:
            rows = slice(outputs + (j - begin) * nx, outputs + (j - begin + 1) * nx)
            F[:, rows, now] = np.eye(nx)
            if j > 0:
                F[:, rows, before] = -window.A[:, places - points + j]
    return F


def _solved_in_full(
    found: WindowFits,
    rows: Array,
    window: MeasurementWindow,
    C: Array,
    path: Array,
    d: Array,
    process: float,
    *,
    anchored: bool,
) -> WindowFits:
    points, nx, ny = path.shape[1], path.shape[2], C.shape[1]
    F = full_matrix(MeasurementWindow(*(each[rows] for each in window)), C, points, anchored=anchored)
    outputs, states = np.arange(points * ny), np.arange(0 if anchored else nx, points * nx)  # one equation each
    group = np.concatenate([outputs % ny, ny + states % nx])
    age = points - 1 - np.concatenate([outputs // ny, states // nx])
    weight = AGE**age * np.where(group < ny, 1.0, process)
    data = np.concatenate([d[rows], np.zeros((len(rows), len(states)))], axis=1)
    finite = np.isfinite(F).all(axis=(1, 2)) & np.isfinite(data).all(axis=1)
    for i, run in enumerate(rows):
        answer = least_noise_fit(F[i], data[i], group, weight) if finite[i] else None
        found.solved[run] = answer is not None
        z, bounds = answer or (np.full(F.shape[2], np.nan), np.full(ny + nx, np.nan))
        found.x[run], found.r[run], found.rho[run] = path[run, -1] + z[-nx:], bounds[:ny], bounds[ny:]
    return found


def least_noise_fit(
    F: Float[Array, "n p"], d: Float[Array, " n"], group: Int[Array, " n"], weight: Float[Array, " n"]
) -> tuple[Float[Array, " p"], Float[Array, " groups"]] | None:
    """Return the minimax fit with the least weighted sum of absolute residuals.

    None if the solver fails, or if the sizes of the outputs differ by more than `WIDEST`.

    The unknowns are x, the positive and the negative parts of the residuals, and the bounds.
    """
    n, p = F.shape
    scale, groups = float(np.abs(d).max()), int(group.max()) + 1
    if scale == 0.0:
        return np.zeros(p), np.zeros(groups)
    sizes = np.array([np.abs(d[group == g]).max() for g in range(groups)])
    if sizes[sizes > 0.0].min() * WIDEST < scale:
        return None
    A = np.zeros((2 * n, p + 2 * n + groups))
    A[:n, :p], A[:n, p : p + n], A[:n, p + n : p + 2 * n] = F, np.eye(n), -np.eye(n)
    A[n:, p : p + n], A[n:, p + n : p + 2 * n] = np.eye(n), np.eye(n)
    A[n + np.arange(n), p + 2 * n + group] = -1.0
    signs = np.concatenate([np.full(p, -np.inf), np.zeros(2 * n + groups)])
    data = d / scale
    lower, upper = np.concatenate([data, np.full(n, -np.inf)]), np.concatenate([data, np.zeros(n)])
    largest, total = np.zeros(A.shape[1]), np.zeros(A.shape[1])
    largest[p + 2 * n :], total[p : p + 2 * n] = 1.0, np.tile(weight, 2)
    found = lexicographic(largest, total, Bounds(A, lower, upper, signs, np.full(A.shape[1], np.inf)))
    if found.status is not LpStatus.OPTIMAL:
        return None
    return scale * found.x[:p], scale * np.maximum(found.x[p + 2 * n :], 0.0)
