"""One step of the enhanced robust predictor: bounds of the error and of the state under uncertainty of norm at most 1.

Model   estimators/enhanced_robust.py, with all symbols.
Source  souto2011, Table 2, (46)-(49), (51), (59), (75)-(80), (85)-(87).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import psd_sqrt, symmetrise
from rmpc_bench.numerics.norm_bound import FREE, Excess, NoisePair, Noises, Widening, keep_a, spectrum, widen
from rmpc_bench.numerics.riccati import predictor_step
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.types import Array


@dataclass(frozen=True)
class ParameterRules:
    """Rules for the free parameters of Table 2."""

    x: Excess  # x, w, v: excess of a_x, a_w, a_v
    w: Excess
    v: Excess
    state: bool  # whether a_x follows from the bound X of the state instead of P
    tuned: bool  # whether a_w and a_v minimise the trace of the next P
    printed: bool  # whether Step 5 is used as printed


class RobustBounds(NamedTuple):
    """Gains at k and bounds at k+1, by one step of Table 2."""

    K: Float[Array, "nx ny"]
    Phi: Float[Array, "nx nx"]
    root_next: Float[Array, "nx nx"]  # root of the bound P
    X_next: Float[Array, "nx nx"] | None  # none after (47) has failed
    a: tuple[float, float, float]  # a_x, a_w, a_v; 0 without such uncertainty
    noises: Noises

    @property
    def P_next(self) -> Float[Array, "nx nx"]:
        """The bound P."""
        return covariance_of(self.root_next)


class RobustStep:
    """Table 2 for one system; its own part is computed once.  H is [H_A; H_C], G the matrix on the right of F_x."""

    def __init__(
        self,
        A: Float[Array, "nx nx"],
        C: Float[Array, "ny nx"],
        H: Float[Array, "nz r"],
        G: Float[Array, "s nx"],
        noises: NoisePair,
        rules: ParameterRules,
    ) -> None:
        self.A, self.C, self.G, self.noises, self.rules = A, C, G, noises, rules
        self.M: Array = np.vstack([A, C])
        self.HH: Array = H.dot(H.T)
        self.uncertain = bool(H.any() and G.any())
        bounds_X = rules.tuned and rules.state
        self.within = noises.no_worse(A, G, rules.w, rules.v) if bounds_X else (FREE, FREE)

    def first_noises(self) -> Noises:
        """Bound the noises with the given excesses, (86), (87), or with initial values if they are tuned."""
        pair, rules = self.noises, self.rules
        if rules.tuned:
            return pair.at(*(float(channel.lam[-1]) for channel in pair))
        return pair.at(pair.w.excess(rules.w), pair.v.excess(rules.v))

    def step(self, root: Array, X: Array | None, noises: Noises) -> RobustBounds:
        """Compute the bounds at k+1 from those at k."""
        wide, Xc, Phi, a_x, L = root, X, self.A, 0.0, None
        if self.uncertain:
            GF = self.G.dot(root)
            of_P, of_X = self._widenings(GF, X)
            a_x, seen = of_P.a, of_P.inverse.dot(GF)  # Step 1
            # Step 2, (75): P + P G' inverse G P = F (I + (G F)' inverse G F) F'.
            wide = root.dot(psd_sqrt(np.eye(len(GF.T)) + GF.T.dot(seen)))
            L = root.dot(seen.T).dot(self.G)
            Xc = None
            if X is not None and of_X is not None:
                XG = X.dot(self.G.T)
                Xc = X + XG.dot(of_X.inverse).dot(XG.T)  # (59)
        K, root_next, J, noises = self._gain(wide, a_x, noises)
        if L is not None:
            Phi = Phi + (self.A - K.dot(self.C)).dot(L)  # Step 4, (79), (80)
        nx = len(root)
        X_next = None if Xc is None else symmetrise(self.A.dot(Xc).dot(self.A.T) + J[:nx, :nx])  # (51)
        if self.rules.printed:
            root_next = root_of(self._as_printed(covariance_of(wide), J, noises.U))
        a = a_x, self.noises.w.a(noises.t_w), self.noises.v.a(noises.t_v)
        return RobustBounds(K, Phi, root_next, X_next, a, noises)

    def _widenings(self, GF: Array, X: Array | None) -> tuple[Widening, Widening | None]:
        """Compute a_x and invert a_x I - G P G' and a_x I - G X G'; None if (47) fails or has failed."""
        GPG = covariance_of(GF)
        if X is None:
            return widen(GPG, self.rules.x), None  # (76), (85)
        GXG = symmetrise(self.G.dot(X).dot(self.G.T))
        if not self.rules.state:
            of_P = widen(GPG, self.rules.x)
            return of_P, keep_a(of_P, GPG - GXG)
        of_X = widen(GXG, self.rules.x)  # (47)
        # Not negative, as X >= P.
        lam, U = spectrum(GXG - GPG)
        return keep_a(of_X, (U * lam).dot(U.T)) or of_X, of_X

    def _gain(self, wide: Array, a_x: float, noises: Noises) -> tuple[Array, Array, Array, Noises]:
        """Return K, the root of P_next, their J and the noises; if tuned, a_w and a_v alternate with K."""
        own = a_x * self.HH  # Step 1
        if self.rules.tuned:
            (K, root_next), noises = self.noises.tuned_step(self.M, own, wide, noises, self.within)
            return K, root_next, noises.J + own, noises
        J = noises.J + own
        K, root_next = predictor_step(self.M, J, wide)  # Steps 4 and 5
        return K, root_next, J, noises

    def _as_printed(self, Pc: Array, J: Array, U: Array) -> Array:
        """Step 5 as printed, with Delta_1 instead of Psi_1."""
        nx = len(Pc)
        Y = self.M.dot(Pc).dot(self.M.T) + J
        N = Y[:nx, nx:] - U[:nx, nx:]
        return symmetrise(
            Y[:nx, :nx] - N.dot(np.linalg.pinv(symmetrise(Y[nx:, nx:]), hermitian=True)).dot(N.T)
        )  # Step 5


_ASYMMETRY = 1e-3
"""Largest |P - P'| of a covariance, relative to the largest entry of P."""


# Table 2 of the enhanced robust predictor evaluated line by line, to see where rounding errors make it fail.
#
# Model   estimators/enhanced_robust.py, with all symbols.  P, W and V enter in the same way, each through a channel.
#         P is not symmetrised, its excess is a difference of matrices, and Step 5 is a difference of two large terms.
#         An error of rounding that is not symmetric grows from step to step when the excess eps is small.
# Source  souto2011, Table 2, (85)-(87).


class Channel(NamedTuple):
    """What one of x, w and v adds to x(k+1) and y(k), nominally and by its uncertainty."""

    B: Float[Array, "nx n"]
    D: Float[Array, "ny n"]
    H: Float[Array, "nx r"]
    H_out: Float[Array, "ny r"]
    G: Float[Array, "s n"]
    Q: Float[Array, "n n"]  # covariance; of x it is P, whatever stands here
    excess: Excess


def is_covariance(
    P0: Float[Array, "nx nx"], channels: Sequence[tuple[Channel, Channel, Channel]]
) -> Float[Array, " steps"]:
    """Return at which k the P of Table 2, evaluated line by line, is a covariance matrix.

    1 as long as P is finite, symmetric to 0.1 % and positive semidefinite; 0 from the first k at which it is not.
    """
    found, P = np.zeros(len(channels)), P0
    for k, (x, w, v) in enumerate(channels):
        if not _is_covariance(P):
            break
        found[k] = 1.0
        try:
            P = _next((x._replace(Q=P), w, v))
        except np.linalg.LinAlgError:
            break
    return found


def _is_covariance(P: Array) -> bool:
    if not np.isfinite(P).all():
        return False
    size = _ASYMMETRY * float(np.abs(P).max())
    return float(np.abs(P - P.T).max()) <= size and float(np.linalg.eigvalsh(P + P.T)[0]) >= -size


def _next(channels: tuple[Channel, ...]) -> Array:
    """Compute P at k+1 as Table 2 prints it; each sum has the terms of x, w and v."""
    a = [_parameter(each) for each in channels]  # Step 1
    Qc = [_widened(each, a_i) for each, a_i in zip(channels, a, strict=True)]  # Step 2
    parts = list(zip(channels, a, Qc, strict=True))
    own = np.add.reduce([c.B @ Q @ c.B.T + a_i * c.H @ c.H.T for c, a_i, Q in parts])
    S = np.add.reduce([c.D @ Q @ c.D.T + a_i * c.H_out @ c.H_out.T for c, a_i, Q in parts])
    x, Pc = channels[0], Qc[0]
    # As printed, without B U D'.
    N = x.B @ Pc @ x.D.T + np.add.reduce([a_i * c.H @ c.H_out.T for c, a_i, _ in parts])
    return np.asarray(own - N @ np.linalg.pinv(S) @ N.T)  # Step 5


def _parameter(channel: Channel) -> float:
    """Compute a = 1/alpha, (85)-(87)."""
    G, Q = channel.G, channel.Q
    largest = float(np.linalg.svd(G @ Q @ G.T, compute_uv=False).max())
    return largest + channel.excess.over(largest)


def _widened(channel: Channel, a: float) -> Array:
    G, Q = channel.G, channel.Q
    return np.asarray(Q + Q @ G.T @ np.linalg.inv(a * np.eye(len(G)) - G @ Q @ G.T) @ G @ Q)
