"""Minimax fits: the smallest bounds of residuals, one linear program per row.

Problem   minimise sum over g of r_g over x and r, |d_i - F_i x| <= r_g for every point i of group g.
Dual      maximise sum d_i mu_i, F' mu = 0, sum over the points of a group of |mu_i| <= 1.
Solution  Simplex method on the dual, an exchange of points: a basis has as many columns as there are unknowns and
          groups, for any number of points.  The duality gap, including rounding, must be below 1e-6 of the optimum.  A
          row without this certificate has failed, and so has a row with nearly dependent unknowns.
Unique    a dual solution whose basis is nowhere 0 leaves one x only, as complementary slackness makes every optimum
          solve the equations of that basis.  So does a fit without residuals, if F has full column rank.  Otherwise
          there may be other optima.
Cost      5 us a row for 12 points, 6 unknowns and 3 groups.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.types import Array


class FitOutcome(IntEnum):
    """Outcome of a fit; the numbers are those of minimax_kernel.py."""

    UNIQUE = 0
    """The only optimum."""
    OPTIMAL = 1
    """An optimum; there may be others."""
    FAILED = 2
    """No result: the data are not finite, or rounding is too large."""


class Fits(NamedTuple):
    """Solutions, one per row; NaN where there is none."""

    x: Float[Array, "rows p"]
    r: Float[Array, "rows groups"]  # largest residual of every group; 0 of one without points
    mu: Float[Array, "rows n"]  # dual values
    outcome: Int8[Array, " rows"]  # members of `FitOutcome`


def fit(F: Float[Array, "rows n p"], d: Float[Array, "rows n"], group: Int[Array, " n"]) -> Fits:
    """Fit every row; no row depends on the others, and one with NaN or inf has the outcome `FAILED`."""
    from rmpc_bench.numerics.minimax_kernel import minimax_kernel

    rows, n, p = F.shape
    groups = int(group.max(initial=-1)) + 1
    fits = Fits(np.empty((rows, p)), np.empty((rows, groups)), np.empty((rows, n)), np.empty(rows, dtype=np.int8))
    F, d = as_compiled(F), as_compiled(d)
    minimax_kernel(F, d, np.require(group, np.int64, ["C", "W"]), *fits)
    return fits
