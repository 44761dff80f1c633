"""Bounds of a covariance for every F of norm at most 1.

For a > lambda_max(G P G') and every F with F' F <= I,

        (M + H F G) P (M + H F G)' <= M Pc M' + a H H',   Pc = P + P G' (a I - G P G')^-1 G P.

The free parameter is the excess t = a - lambda_max(G P G') > 0.  a I - G P G' is computed from t and not as a
difference, which is accurate for a small t.  If P G' = 0, the uncertainty has no effect: at t = 0 the bound is M P M'.

Symbols a is 1/alpha: a_x, a_w, a_v = 1/alpha_x, 1/alpha_w, 1/alpha_v; Pc, Wc, Vc are P, W, V widened as above.
Source  souto2011, Lemma 1, (46)-(49), Table 2, Steps 1 and 2, (85)-(87).  Additions: the a that minimises a trace
        (`best_excess`), and the range of a that does not increase it (`no_worse`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.riccati import PredictorStep, error_map, predictor_step
from rmpc_bench.types import Array

_FLOOR, _CEILING = 1e-9, 1e9
"""Limits of a computed excess, relative to lambda_max(G P G'): beyond them the bound is flat or overflows."""


@dataclass(frozen=True)
class Excess:
    """Excess of a over lambda_max(G P G'): `eps`, or `gamma` times lambda_max."""

    eps: float | None = None
    gamma: float | None = None

    def over(self, largest: float) -> float:
        """Return t for the largest eigenvalue of G P G'."""
        if self.eps is not None:
            return self.eps  # (85)-(87)
        return (self.gamma or 0.0) * largest


class Widening(NamedTuple):
    """The multiplier a, the gap a I - G P G' and its inverse; the inverse is 0 if G P G' = 0 and t = 0."""

    a: float
    gap: Float[Array, "s s"]
    inverse: Float[Array, "s s"]


def spectrum(GPG: Float[Array, "s s"]) -> tuple[Float[Array, " s"], Float[Array, "s s"]]:
    """Return the eigenvalues of G P G', ascending, with negative ones set to 0, and its eigenvectors."""
    if len(GPG) == 1:
        return np.maximum(GPG[0], 0.0), np.ones((1, 1))
    lam, U = np.linalg.eigh(GPG)
    return np.maximum(lam, 0.0), U


def widen(GPG: Float[Array, "s s"], excess: Excess) -> Widening:
    """Choose a for G P G' and invert a I - G P G'; a ZeroDivisionError if the excess is 0 but has an effect."""
    lam, U = spectrum(GPG)
    largest = float(lam[-1])
    t = excess.over(largest)
    if t > 0.0:
        gaps = (largest - lam) + t
        return Widening(largest + t, (U * gaps).dot(U.T), (U / gaps).dot(U.T))
    if largest > 0.0:
        raise ZeroDivisionError("a must exceed the largest eigenvalue of G P G'")
    nothing = np.zeros((len(lam), len(lam)))
    return Widening(0.0, nothing, nothing)


def keep_a(old: Widening, difference: Float[Array, "s s"]) -> Widening | None:
    """Use the same a for another covariance, smaller by `difference` in G P G'; None if a is too small for it."""
    if not difference.any():
        return old
    gap = old.gap + difference
    smallest = gap.item() if len(gap) == 1 else float(np.linalg.eigvalsh(gap)[0])
    return Widening(old.a, gap, 1.0 / gap if len(gap) == 1 else np.linalg.inv(gap)) if smallest > 0.0 else None


def best_excess(lam: Float[Array, " s"], p: Float[Array, " s"], q: float) -> float:
    """Return the t = a - lambda_max that minimises sum_i p_i / (a - lam_i) + q a.

    The derivative is 0 where sum_i p_i / (a - lam_i)^2 = q; with one eigenvalue t = sqrt(p / q).
    """
    largest = float(lam[-1])
    floor, ceiling = _FLOOR * largest, _CEILING * largest
    if q <= 0.0 or not np.isfinite(p).all():
        return ceiling if q <= 0.0 and p.any() else floor
    return min(max(_fall_to(q, p, largest - lam, 2), floor), ceiling)


def no_worse(lam: Float[Array, " s"], p: Float[Array, " s"], q: float, t0: float) -> tuple[float, float]:
    """Return the smallest and the largest t at which sum_i p_i / (a - lam_i) + q a is not larger than at t0.

    The sum is convex in t, so that t0 is one end.  With d_i = lambda_max - lam_i, the other end solves
    sum_i p_i / ((t0 + d_i) (t + d_i)) = q; with one eigenvalue it is t = p / (q t0).
    """
    if q <= 0.0:
        return (t0 if p.any() else 0.0), math.inf
    gaps = lam[-1] - lam
    other = _fall_to(q, p / (t0 + gaps), gaps, 1)
    return min(t0, other), max(t0, other)


def _fall_to(q: float, p: Float[Array, " s"], gaps: Float[Array, " s"], power: int) -> float:
    """Return the t >= 0 with sum_i p_i / (t + gaps_i)^power = q, or 0 if the sum is at most q for all t > 0."""
    # The sum is decreasing and convex, so that Newton's method converges monotonically from the left. It starts at the
    # largest t at which a single term equals q.
    terms = [(one / q, gap) for one, gap in zip(p.tolist(), gaps.tolist(), strict=True) if one > 0.0]
    t = max((weight ** (1.0 / power) - gap for weight, gap in terms), default=0.0)
    if t <= 0.0:
        t = 0.0
        if sum(weight / gap**power for weight, gap in terms) <= 1.0:
            return 0.0
    for _ in range(100 if len(terms) > 1 and t < math.inf else 0):
        ratios = [(weight / (t + gap) ** power, t + gap) for weight, gap in terms]
        step = (sum(r for r, _ in ratios) - 1.0) / (power * sum(r / d for r, d in ratios))
        t += step
        if step <= 1e-12 * t:
            break
    return t


class NoiseChannel:
    """Bound of (M + H F G) W (M + H F G)' for one white noise of covariance W, as a function of the excess t.

    In Table 2, for w: M = [Bw; Dw] and H = [H_Bw; H_Dw], so that M Wc M' + a_w H H' is the contribution of w to
    [B U_c B' + Delta_3, Psi_1; Psi_1', Psi_2].
    """

    def __init__(
        self, M: Float[Array, "nz n"], H: Float[Array, "nz r"], G: Float[Array, "s n"], W: Float[Array, "n n"]
    ) -> None:
        self.base: Array = M.dot(W).dot(M.T)
        self.lam, U = spectrum(G.dot(W).dot(G.T))
        self.present = bool(H.any() and self.lam[-1] > 0.0)
        """Whether the uncertainty has an effect."""
        self.cross: Array = M.dot(W).dot(G.T).dot(U)
        self.H = H
        self._HH: Array = H.dot(H.T)

    def excess(self, rule: Excess) -> float:
        """Return the t of a rule; 0 without uncertainty."""
        return rule.over(float(self.lam[-1])) if self.present else 0.0  # Step 1, (86), (87)

    def best(self, T: Float[Array, "nx nz"], within: tuple[float, float] = (0.0, math.inf)) -> float:
        """Return the admissible t that minimises trace(T bound T'); 0 if the infimum is at t -> 0."""
        if not self.present or not self.cross.any():
            return 0.0
        return min(max(best_excess(self.lam, *self._coefficients(T)), within[0]), within[1])

    def no_worse(self, T: Float[Array, "nx nz"], t0: float) -> tuple[float, float]:
        """Return the smallest and the largest t at which trace(T bound T') is not larger than at t0 > 0."""
        return no_worse(self.lam, *self._coefficients(T), t0) if self.present else (0.0, math.inf)

    def _coefficients(self, T: Float[Array, "nx nz"]) -> tuple[Float[Array, " s"], float]:
        """Return the p and q of trace(T bound T') = constant + sum_i p_i / (a - lam_i) + q a."""
        seen, own = T.dot(self.cross), T.dot(self.H)
        return (seen * seen).sum(axis=0), float((own * own).sum())

    def a(self, t: float) -> float:
        """Multiplier; 0 without uncertainty."""
        return float(self.lam[-1]) + t if self.present else 0.0  # Step 1, (48), (49)

    def nominal(self, t: float) -> Float[Array, "nz nz"]:
        """Return M Wc M'; ZeroDivisionError if t = 0 although nominal noise shares directions with the uncertainty."""
        if not self.present or not self.cross.any():
            return self.base
        if not t > 0.0:
            raise ZeroDivisionError("a must exceed the largest eigenvalue of G W G'")
        return self.base + (self.cross / ((self.lam[-1] - self.lam) + t)).dot(self.cross.T)  # Step 2

    def own(self, t: float) -> Float[Array, "nz nz"]:
        """Return a H H'."""
        return self.a(t) * self._HH  # Step 1: Delta_3, Delta_1, Delta_2


# The alternating minimisation ends if both t change by less than this share, or after this number of iterations.
_SETTLED, _MAX_TURNS = 1e-9, 200

Range = tuple[float, float]
"""Smallest and largest excess."""
FREE: Range = (0.0, math.inf)


# The two noises of an uncertain system, and the joint minimisation over their free parameters and the predictor gain.
#
# Model   [x(k+1); y] = M x + contributions of w and v, each a `NoiseChannel` with its own excess t_w, t_v.
# Symbols Those of souto2011, Table 2: B = [Bw Bv], D = [Dw Dv], U_c = diag(Wc, Vc), Delta_1 to Delta_3 the terms of
#         a_x, a_w and a_v; Psi_1 = B U_c D' + Delta_1, Psi_2 = D U_c D' + Delta_2.
# Method  The trace of the bound is jointly convex in 1/a_w, 1/a_v and K (a matrix fraction).  Alternating minimisation
#         over a_w, a_v and K does not increase it and converges to the minimum, over all a or over a range.


class Noises(NamedTuple):
    """Contributions of the noises to [x(k+1); y], for excesses t_w and t_v of a_w and a_v."""

    t_w: float
    t_v: float
    U: Float[Array, "nz nz"]  # [B; D] U_c [B; D]'
    J: Float[Array, "nz nz"]  # [B U_c B' + Delta_3, Psi_1; Psi_1', Psi_2] without the terms of a_x


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
