"""Tables of games: everything that runs share, as functions of s; game_lookup.py reads them.

On the edge of the domain, tau_1 = lambda_max(M^1/2 Y_0 M^1/2), a state enters the slope D and the first control as a
quadratic and a linear form whose matrices depend on s alone.  Chebyshev series of these at `NODES` points of a window
about the optimum for x_hat = 0 are fixed by the design: no result depends on which runs share a block.  A series whose
last coefficients are not small (nearly double eigenvalues do that) is not used; nor is one for a state whose optimum
lies outside the window or off the edge: these problems are solved one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.lq_game import Game, smallest_multiplier
from rmpc_bench.types import Array

NODES = 44
"""The last coefficients are then a few roundings where no eigenvalues cross."""
BELOW, ABOVE = 1.5, 5.5
"""Window of s about the optimum for x_hat = 0: larger states want larger s."""
TAIL = 1e-12
"""Largest relative error of the first control, as the last coefficients tell it."""
ROUGH = 1e-6
"""Largest share of the last coefficients in what leads to s, and to whether the optimum is on the edge."""
TINY = 1e-300
MIDDLE, HALF = 0.5 * (ABOVE - BELOW), 0.5 * (ABOVE + BELOW)


class Tables(NamedTuple):
    """Axis 0 is k."""

    tau_min: Float[Array, " k"]
    """Smallest price of noise."""
    s: Float[Array, " k"]
    """Its optimal logarithm for x_hat = 0."""
    series: Float[Array, "k rows nodes"]
    """As game_lookup.py says."""
    usable: Bool[Array, " k"]


def tables(games: Sequence[Game], M_roots: Float[Array, "k n n"]) -> Tables:
    """Make the tables of all k.

    Parameters
    ----------
    games : the games of k = 0..
    M_roots : roots of the sets of e(k), of length 1 where they are the same at all k
    """
    found = [_table(game, M_roots[k if len(M_roots) > 1 else 0]) for k, game in enumerate(games)]
    tau_min, s, series, usable = zip(*found, strict=True)
    return Tables(np.array(tau_min), np.array(s), np.array(series), np.array(usable))


def _table(game: Game, M_root: Float[Array, "n n"]) -> tuple[float, float, Array, bool]:
    from rmpc_bench.numerics.game_kernel import nodes_kernel

    n, tau_min = len(M_root), smallest_multiplier(game)
    found = np.full((NODES, 6, n, n), np.nan)
    offsets = MIDDLE + HALF * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    s = nodes_kernel(*game, tau_min, offsets, M_root, found) if tau_min > 0.0 else np.nan
    if not np.isfinite(found).all():
        return tau_min, 0.0, np.zeros((1 + 3 * n * n, NODES)), False
    with np.errstate(all="ignore"):  # what is not finite is not used
        groups = [_coefficients(values) for values in _functions(found, M_root, offsets)]
        return tau_min, s, np.concatenate(groups), _is_resolved(*groups)


def _functions(found: Float[Array, "nodes 6 n n"], M_root: Float[Array, "n n"], offsets: Array) -> list[Array]:
    """Values of the functions at the nodes, group by group."""
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
    """Chebyshev series through values at the nodes."""
    degrees = np.arange(NODES)
    basis = np.cos(np.pi * np.outer(degrees, degrees + 0.5) / NODES) * (2.0 / NODES)
    basis[0] *= 0.5
    series: Array = (basis @ values).T
    return series


def _is_resolved(alone: Array, D: Array, E: Array, first: Array) -> bool:
    """Whether the last coefficients say that no more are needed.

    An error of the slope moves s by as much, relative, and that moves the first control by its derivative: beside the
    edge of the domain the slope has few digits, but the first control hardly depends on s there.
    """
    tails = [np.abs(each[:, -4:]).max() / max(np.abs(each).max(), TINY) for each in (alone, D, E, first)]
    change = (np.abs(first) * np.arange(NODES)).sum(axis=1).max() / HALF  # bounds the derivative
    scale = np.abs(first).max()
    return bool(tails[3] <= TAIL and max(tails[:2]) * change <= TAIL * scale and max(tails[:3]) <= ROUGH)
