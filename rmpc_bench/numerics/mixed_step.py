"""Correction step of a filter for an error with a stochastic part (covariance) and a bounded part (ellipsoid).

Problem  With T = I - L C, minimise tr P + tr M over the gain L and the weight q > 0, where
         P = T P_pred T' + L P_v L',  M = (1 + 1/q) T M_pred T' + (1 + q) L M_v L'.
Convex   With s = q / (1 + q) the cost tr T M_pred T' / s + tr L M_v L' / (1 - s) + .. is jointly convex in L and s.
         Therefore the fixed point of (22) and (24), where q is optimal for the gain that is optimal for q, is the
         minimiser.  The sign of log q_best(L(q)) - log q shows on which side of it q lies.
Edges    Without M_pred the optimal q is 0, without M_v it is infinite; the weight of the other set is then 1.
Limit    q stays within REACH of its start.  If the optimal q is 0 or infinite with both sets present, or if M_v is
         nearly singular, tr P + tr M exceeds its minimum by up to 5e-5 of tr P_pred + tr M_pred (measured).
Source   ma2025, (20)-(24) with I - L C in (24); L is the paper's Gamma.
"""

from __future__ import annotations

from math import copysign, exp, inf, isfinite, isnan, log, nan
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.square_root import corrected, covariance_of, lower_root
from rmpc_bench.types import Array

Rule: TypeAlias = Literal["fixed-point", "lag", "one-pass"]

REACH = 18.5
"""Largest distance of log q from its start, a factor of 1e8 in q: beyond it one of the sets has no effect."""

CLOSE = 1e-13
"""Tolerance of log q: the rounding error of a sum of traces."""

MOST = 100
"""Largest number of gains in a search for q; every third one is a bisection step."""


class MixedStep(NamedTuple):
    """One correction."""

    L: Float[Array, "nx ny"]
    """Gain: x_hat = x_pred + L e."""
    P_root: Float[Array, "nx nx"]
    """Root of the covariance of the stochastic part of x_hat - x."""
    M_root: Float[Array, "nx nx"]
    """Root of the shape of the ellipsoid of its bounded part."""
    q: float
    """Weight of (21): the best one for L, (24), or a given one; 0 without a predicted set, infinite without a measured
    one."""

    @property
    def P(self) -> Float[Array, "nx nx"]:
        """Covariance of the stochastic part."""
        return covariance_of(self.P_root)

    @property
    def M(self) -> Float[Array, "nx nx"]:
        """Shape of the ellipsoid of the bounded part."""
        return covariance_of(self.M_root)


class Prior(NamedTuple):
    """Data of a correction: roots of covariances and sets of the prediction error and of the measurement noise."""

    C: Float[Array, "ny nx"]
    P: Float[Array, "nx nx"]
    M: Float[Array, "nx nx"]
    P_v: Float[Array, "ny ny"]
    M_v: Float[Array, "ny ny"]

    def gain(self, q: float) -> Float[Array, "nx ny"]:
        """Return the best gain for a weight, (22)."""
        V, R = self.P, self.P_v
        if self.M.any():
            V = np.hstack([V, (1.0 + 1.0 / q) ** 0.5 * self.M])
        if self.M_v.any():
            R = np.hstack([R, (1.0 + q) ** 0.5 * self.M_v])
        found = corrected(self.C, R, V)
        if not found.regular:
            raise np.linalg.LinAlgError("Singular matrix")
        return found.gain

    def kept(self) -> MixedStep:
        """Return the prediction unchanged, without a measurement."""
        return MixedStep(np.zeros(self.C.T.shape), self.P, self.M, inf)

    def parts(self, L: Float[Array, "nx ny"]) -> tuple[Float[Array, "nx nx"], Float[Array, "nx ny"]]:
        """Return the roots of the two sets after the correction, T M_pred T' and L M_v L'."""
        return self.M - L.dot(self.C.dot(self.M)), L.dot(self.M_v)

    def corrected(self, L: Float[Array, "nx ny"], q: float | None = None) -> MixedStep:
        """Apply a gain, (20) and (21), with the best weight for it if no other one is given."""
        P = lower_root(self.P - L.dot(self.C.dot(self.P)), L.dot(self.P_v))  # (20)
        predicted, measured = self.parts(L)
        best = root_weight(predicted, measured)
        chosen = best if q is None or best in (0.0, inf) else q
        return MixedStep(L, P, sum_root(predicted, measured, chosen), chosen)  # (21)


def root_weight(first: Float[Array, "n r"], second: Float[Array, "n s"]) -> float:
    """Return the weight of `ellipsoid.weight` for the roots of two shapes."""
    below = float(np.linalg.norm(second))
    return float(np.linalg.norm(first)) / below if below else inf


def sum_root(first: Float[Array, "n r"], second: Float[Array, "n s"], q: float) -> Float[Array, "n n"]:
    """Return the root of (1 + 1/q) M1 + (1 + q) M2, of one set alone where q is 0 or infinite."""
    of_first, of_second = ((1.0 + 1.0 / q) ** 0.5 if q else 0.0), ((1.0 + q) ** 0.5 if q < inf else 0.0)
    return lower_root(of_first * first, of_second * second)


def mixed_step(prior: Prior, rule: Rule = "fixed-point", q_before: float = 1.0) -> MixedStep:
    """Correct a prediction; a LinAlgError says that the covariance of the innovation with the sets is singular.

    `fixed-point` finds the minimiser, see Limit.  The other rules evaluate (24) once, for the gain of the weight of the
    previous step (`lag`) or of q = 1 (`one-pass`).
    """
    if not prior.M.any():
        return prior.corrected(prior.gain(0.0))
    if not prior.M_v.any():
        return prior.corrected(prior.gain(inf))
    if rule == "fixed-point":
        return prior.corrected(prior.gain(exp(_root(prior))))
    before = q_before if rule == "lag" and 0.0 < q_before < inf else 1.0
    start = _start(prior)
    q = exp(min(max(log(before) + _distance(prior, log(before)), start - REACH), start + REACH))
    return prior.corrected(prior.gain(q), q)


def _start(prior: Prior) -> float:
    """Return log q at which the two sets have the same trace in the output space."""
    seen = float(np.linalg.norm(prior.C.dot(prior.M)))
    return log(seen) - log(np.linalg.norm(prior.M_v)) if seen > 0.0 else 0.0


def _root(prior: Prior) -> float:
    """Find log q such that q is the best weight for the best gain of q, limited to `REACH`."""
    # Steps of increasing length continue until the root is bracketed. Then two secant steps alternate with one
    # bisection step.
    z = _start(prior)
    low, high, step = (z - REACH, nan), (z + REACH, nan), 0.0  # log q with the distance there
    for count in range(MOST):
        distance = _distance(prior, z)
        low, high = ((z, distance), high) if distance > 0.0 else (low, (z, distance))
        if abs(distance) <= CLOSE or high[0] - low[0] <= CLOSE:
            break
        if isfinite(low[1]) and isfinite(high[1]) and count % 3:
            z = low[0] + (high[0] - low[0]) * low[1] / (low[1] - high[1])
        elif not (isnan(low[1]) or isnan(high[1])):
            z = 0.5 * (low[0] + high[0])
        else:
            step = max(2.0 * abs(distance), 2.0 * step)
            z = min(max(z + copysign(step, distance), low[0]), high[0])
    return z


def _distance(prior: Prior, z: float) -> float:
    """Return log(q_best / q), where q_best is the best weight for the gain of q = exp(z)."""
    best = root_weight(*prior.parts(prior.gain(exp(z))))
    return log(best) - z if best > 0.0 else -inf
