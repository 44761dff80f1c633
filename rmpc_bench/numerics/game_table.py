"""Tables of games: the functions of s that all runs share; game_lookup.py evaluates them.

At the boundary of the domain, tau_1 = lambda_max(M^1/2 Y_0 M^1/2), the slope D is a quadratic form and the first
control a linear form of the state, whose matrices depend on s alone.  Chebyshev series of these matrices with `NODES`
points, around the optimum for x_hat = 0, are computed by the design, so that no result depends on the runs of a block.
A table is not used if the last coefficients of a series are not small, as with nearly double eigenvalues, and not for a
state whose optimum is outside the range of s or in the interior of the domain.  These problems are solved individually.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.lq_game import Game, smallest_multiplier
from rmpc_bench.types import Array

NODES = 44
"""Number of nodes; the last coefficients are then a few roundings if no eigenvalues cross."""
BELOW, ABOVE = 1.5, 5.5
"""Range of s around the optimum for x_hat = 0; larger states have larger optimal s."""
TAIL = 1e-12
"""Largest relative error of the first control, estimated from the last coefficients."""
ROUGH = 1e-6
"""Largest relative size of the last coefficients of the functions that determine s and the validity of the table."""
TINY = 1e-300
MIDDLE, HALF = 0.5 * (ABOVE - BELOW), 0.5 * (ABOVE + BELOW)


class Tables(NamedTuple):
    """Tables of all k; axis 0 is k."""

    tau_min: Float[Array, " k"]
    """Smallest multiplier of the noise."""
    s: Float[Array, " k"]
    """Optimal s = log(tau / tau_min - 1) for x_hat = 0."""
    series: Float[Array, "k rows nodes"]
    """Chebyshev coefficients; game_lookup.py describes the rows."""
    usable: Bool[Array, " k"]


def tables(games: Sequence[Game], M_roots: Float[Array, "k n n"]) -> Tables:
    """Compute the tables of all k.

    Parameters
    ----------
    games : the games of k = 0..
    M_roots : roots of the sets of e(k), of length 1 if they are the same at all k
    """
    found = [_table(game, M_roots[k if len(M_roots) > 1 else 0]) for k, game in enumerate(games)]
    tau_min, s, series, usable = zip(*found, strict=True)
    return Tables(np.array(tau_min), np.array(s), np.array(series), np.array(usable))


def _table(game: Game, M_root: Float[Array, "n n"]) -> tuple[float, float, Array, bool]:
    from rmpc_bench.numerics.game_kernel import backward_kernel, optimum_kernel

    N, n, tau_min, s = len(game.A), len(M_root), smallest_multiplier(game), np.nan
    found, paths = np.full((NODES, 6, n, n), np.nan), np.empty((2, 0, n, n))
    offsets = MIDDLE + HALF * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    if tau_min > 0.0:
        s = optimum_kernel(*game, M_root, np.zeros(n), tau_min, 0.0, found[0])
        for offset, X in zip(offsets.tolist(), found, strict=True):
            if not backward_kernel(*game, np.full(N, tau_min * (1.0 + exp(s + offset))), X, paths):
                X[:] = np.nan
    if not np.isfinite(found).all():
        return tau_min, 0.0, np.zeros((1 + 3 * n * n, NODES)), False
    # A table with values that are not finite is not used.
    with np.errstate(all="ignore"):
        groups = [_coefficients(values) for values in _functions(found, M_root, offsets)]
        return tau_min, s, np.concatenate(groups), _is_resolved(*groups)


def _functions(found: Float[Array, "nodes 6 n n"], M_root: Float[Array, "n n"], offsets: Array) -> list[Array]:
    """Return the values of the functions at the nodes, by groups."""
    Pi, _, Y, d_Pi, d_Y, first = np.moveaxis(found, 1, 0)
    lam, V = np.linalg.eigh(M_root @ Pi @ M_root)
    edge, U = np.linalg.eigh(M_root @ Y @ M_root)
    top = np.einsum("ij,kj->ki", M_root, U[:, :, -1])
    f = V.mT @ M_root @ Pi / (edge[:, -1:] - lam)[:, :, None]  # e = M_root V f x_hat
    x_w = np.eye(len(M_root)) + M_root @ V @ f
    E = f.mT @ f
    weight = np.exp(2.0 * offsets)
    alone = -weight * np.einsum("ki,kij,kj->k", top, d_Y, top)
    D = -weight[:, None, None] * (x_w.mT @ d_Pi @ x_w) - alone[:, None, None] * E
    return [alone[:, None], *(each.reshape(NODES, -1) for each in (D, E, first @ x_w))]


def _coefficients(values: Float[Array, "nodes rows"]) -> Float[Array, "rows nodes"]:
    """Return the coefficients of the Chebyshev series through the values at the nodes."""
    degrees = np.arange(NODES)
    basis = np.cos(np.pi * np.outer(degrees, degrees + 0.5) / NODES) * (2.0 / NODES)
    basis[0] *= 0.5
    series: Array = (basis @ values).T
    return series


def _is_resolved(alone: Array, D: Array, E: Array, first: Array) -> bool:
    """Return whether the last coefficients are small enough.

    A relative error of the slope causes an error of s of the same size, which affects the first control through its
    derivative.  Close to the smallest multiplier the slope has few digits, but the first control hardly depends on s.
    """
    tails = [np.abs(each[:, -4:]).max() / max(np.abs(each).max(), TINY) for each in (alone, D, E, first)]
    # An upper bound of the derivative of the first control with respect to s.
    change = (np.abs(first) * np.arange(NODES)).sum(axis=1).max() / HALF
    scale = np.abs(first).max()
    return bool(tails[3] <= TAIL and max(tails[:2]) * change <= TAIL * scale and max(tails[:3]) <= ROUGH)
