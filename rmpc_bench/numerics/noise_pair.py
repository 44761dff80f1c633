"""The two noises of an uncertain system, and the joint minimisation over their free parameters and the predictor gain.

Model   [x(k+1); y] = M x + contributions of w and v, each a `NoiseChannel` with its own excess t_w, t_v.
Symbols Those of souto2011, Table 2: B = [Bw Bv], D = [Dw Dv], U_c = diag(Wc, Vc), Delta_1 to Delta_3 the terms of a_x,
        a_w and a_v; Psi_1 = B U_c D' + Delta_1, Psi_2 = D U_c D' + Delta_2.
Method  The trace of the bound is jointly convex in 1/a_w, 1/a_v and K (a matrix fraction).  Alternating minimisation
        over a_w, a_v and K does not increase it and converges to the minimum, over all a or over a range.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.norm_bound import Excess, NoiseChannel
from rmpc_bench.numerics.riccati import PredictorStep, error_map, predictor_step
from rmpc_bench.types import Array

# The alternating minimisation ends if both t change by less than this share, or after this number of iterations.
_SETTLED, _MAX_TURNS = 1e-9, 200

Range = tuple[float, float]
"""Smallest and largest excess."""
FREE: Range = (0.0, math.inf)


class Noises(NamedTuple):
    """Contributions of the noises to [x(k+1); y], for excesses t_w and t_v of a_w and a_v."""

    t_w: float
    t_v: float
    U: Float[Array, "nz nz"]
    """[B; D] U_c [B; D]'."""
    J: Float[Array, "nz nz"]
    """[B U_c B' + Delta_3, Psi_1; Psi_1', Psi_2] without the terms of a_x."""


class NoisePair(NamedTuple):
    """Both noises, w and v."""

    w: NoiseChannel
    v: NoiseChannel

    def at(self, t_w: float, t_v: float) -> Noises:
        """Bound the noises with given excesses."""
        U = self.w.nominal(t_w) + self.v.nominal(t_v)  # Step 3
        return Noises(t_w, t_v, U, U + self.w.own(t_w) + self.v.own(t_v))

    def no_worse(self, A: Float[Array, "nx nx"], G: Float[Array, "s nx"], w: Excess, v: Excess) -> tuple[Range, Range]:
        """Return the ranges of t_w and t_v in which the bound of x(k+1) is not larger than with given excesses.

        The compared sizes are the trace of the bound and the traces of G A^j times the bound times its transpose for
        j = 0..nx-1: the combinations of the states that F_x multiplies, at the next nx steps.  An excess of 0, for
        which there may be no bound, is replaced by gamma = 1.

        Parameters
        ----------
        A : transition of x
        G : combination of the states that F_x multiplies
        w, v : rules of the given excesses
        """
        nx, nz = len(A), len(self.w.base)
        rows = [np.eye(nx), G]
        while len(rows) <= nx:
            rows.append(rows[-1].dot(A))
        ranges = []
        for channel, rule in ((self.w, w), (self.v, v)):
            t0 = channel.excess(rule) or float(channel.lam[-1])
            ends = [channel.no_worse(np.hstack([T, np.zeros((len(T), nz - nx))]), t0) for T in rows]
            ranges.append((max(low for low, _ in ends), min(high for _, high in ends)))
        return ranges[0], ranges[1]

    def tuned_step(
        self,
        M: Float[Array, "nz nx"],
        J_x: Float[Array, "nz nz"],
        root: Float[Array, "nx r"],
        first: Noises,
        within: tuple[Range, Range] = (FREE, FREE),
    ) -> tuple[PredictorStep, Noises]:
        """Compute gain and excesses within their ranges that minimise the trace of the next P, from `first` on.

        J_x is the contribution of the uncertainty of the state to J, `root` that of the widened covariance of x.
        """
        noises, step = first, predictor_step(M, first.J + J_x, root)
        for _ in range(_MAX_TURNS):
            T, before = error_map(step.K), noises
            t_w, t_v = self.w.best(T, within[0]), self.v.best(T, within[1])
            noises = self.at(t_w, t_v)
            step = predictor_step(M, noises.J + J_x, root)  # Steps 4 and 5
            if abs(t_w - before.t_w) <= _SETTLED * t_w and abs(t_v - before.t_v) <= _SETTLED * t_v:
                break
        return step, noises
