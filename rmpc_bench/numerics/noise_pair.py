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

# The alternation ends when both t change by less than this share, or after this many turns.
_SETTLED, _MAX_TURNS = 1e-9, 200

Range = tuple[float, float]
"""Least and largest excess."""
FREE: Range = (0.0, math.inf)


class Noises(NamedTuple):
    """What the noises do to [x(k+1); y], for excesses t_w and t_v of a_w and a_v."""

    t_w: float
    t_v: float
    U: Float[Array, "nz nz"]
    """[B; D] U_c [B; D]'."""
    J: Float[Array, "nz nz"]
    """[B U_c B' + Delta_3, Psi_1; Psi_1', Psi_2] without what a_x adds."""


class NoisePair(NamedTuple):
    """Both noises, w and v."""

    w: NoiseChannel
    v: NoiseChannel

    def at(self, t_w: float, t_v: float) -> Noises:
        """Bound the noises with given excesses."""
        U = self.w.nominal(t_w) + self.v.nominal(t_v)  # Step 3
        return Noises(t_w, t_v, U, U + self.w.own(t_w) + self.v.own(t_v))

    def no_worse(self, A: Float[Array, "nx nx"], G: Float[Array, "s nx"], w: Excess, v: Excess) -> tuple[Range, Range]:
        """Return the t_w and the t_v that make the bound of x(k+1) no larger than given excesses do.

        That is its trace, and the trace of what F_x sees of it, at once and until nx steps later (through the rows
        G A^j, with the A and G given).  An excess of 0, with which there may be no bound, counts as gamma = 1.

        Parameters
        ----------
        A : transition of x
        G : what F_x sees of x
        w, v : how the given excesses are chosen
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
        P: Float[Array, "nx nx"],
        first: Noises,
        within: tuple[Range, Range] = (FREE, FREE),
    ) -> tuple[PredictorStep, Noises]:
        """Choose gain and excesses so that the trace of the next P is least.

        Parameters
        ----------
        M : A over C
        J_x : what the uncertainty of the state adds to J
        P : covariance of the error of x, widened
        first : noises to begin with
        within : t_w and t_v to choose from
        """
        noises, step = first, predictor_step(M, first.J + J_x, P)
        for _ in range(_MAX_TURNS):
            T, before = error_map(step.K), noises
            t_w, t_v = self.w.best(T, within[0]), self.v.best(T, within[1])
            noises = self.at(t_w, t_v)
            step = predictor_step(M, noises.J + J_x, P)  # Step 4, and Step 5 in Joseph form
            if abs(t_w - before.t_w) <= _SETTLED * t_w and abs(t_v - before.t_v) <= _SETTLED * t_v:
                break
        return step, noises
