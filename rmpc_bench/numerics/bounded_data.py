"""Multiplier of regularised least squares with bounded data uncertainty, for many problems at once.

Problem Minimise over z the largest value over |Delta| <= 1 of
            z' Q z + |A z - b + H Delta (E z - E_b)|^2_W.
        By duality this is the minimum over lam >= |H' W H| of G(lam), the minimum over z of
            z' Q z + lam |E z - E_b|^2 + (A z - b)' (W^-1 - H H' / lam)^-1 (A z - b).
Source  A. H. Sayed, A framework for state-space estimation with uncertain models, IEEE Trans. Automatic Control 46
        (2001) 998-1013, (11).
Method  With mu = 1/lam, the minimum over z is that of a linear regression on [E_b; b] with the prior covariance Q^-1
        and the noise covariance diag(mu I, W^-1 - mu H H'):
            G = d' N(mu)^-1 d,  d = [E_b; b],  N(mu) = [E; A] Q^-1 [E; A]' + diag(mu I, W^-1 - mu H H').
        N is affine in mu, so that G is convex in mu.  The eigenvalues n_i of N' relative to N at the middle of the
        range give G = sum of c_i^2 / (1 + t n_i), and Newton's method with a bracket finds the zero of G'.
Digits  mu is accurate to 1e-12 of its range where G is not flat to rounding.
Step    For x(k+1) = (A + M Delta E_f) x + (Bw + M Delta E_g) w + w2 and y(k+1) = C x(k+1) + v the unknown z is
        (x(k) - x_hat(k), w(k)), Q^-1 = diag(P(k), W), H = C M, E = diag(G_x, G_w), E_b = [-G_x x_hat(k); 0] and b the
        innovation of the nominal prediction; w2 and v enter with the covariances `rest` and R.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import congruence, mv, symmetrise
from rmpc_bench.types import Array

NEAREST = 1e-9
"""The search ends at (1 + NEAREST) times the lower bound of lam, where W^-1 - H H' / lam is still regular."""
FARTHEST = 1e9
"""The search ends at FARTHEST times the lower bound of lam."""
_STEPS = 200


class BoundedStep(NamedTuple):
    """Matrices of one step from k to k+1, shared by all runs."""

    A: Float[Array, "nx nx"]
    G_x: Float[Array, "sx nx"]
    Bw: Float[Array, "nx nw"]
    G_w: Float[Array, "sw nw"]
    W: Float[Array, "nw nw"]
    rest: Float[Array, "nx nx"]  # covariance of the process noise without Bw w
    C: Float[Array, "ny nx"]  # output matrix at k+1
    R: Float[Array, "ny ny"]  # covariance of v at k+1
    HH: Float[Array, "ny ny"]  # H H' = C M M' C'
    lam_l: float  # lower bound of lam, > 0

    def multiplier(
        self, x_hat: Float[Array, "runs nx"], P: Float[Array, "runs nx nx"], b: Float[Array, "runs ny"]
    ) -> Float[Array, " runs"]:
        """Return mu = 1/lam of every run; b is the innovation of the nominal prediction at k+1."""
        (sx, nx), (sw, nw), ny = self.G_x.shape, self.G_w.shape, len(self.C)
        of_x = np.vstack([self.G_x, np.zeros((sw, nx)), self.C.dot(self.A)])
        of_w = np.vstack([np.zeros((sx, nw)), self.G_w, self.C.dot(self.Bw)])
        noise, slope = of_w.dot(self.W).dot(of_w.T), np.eye(sx + sw + ny)
        noise[sx + sw :, sx + sw :] += self.C.dot(self.rest).dot(self.C.T) + self.R
        slope[sx + sw :, sx + sw :] = -self.HH
        d = np.concatenate([-mv(self.G_x, x_hat), np.zeros((len(b), sw)), b], axis=1)
        return search(symmetrise(congruence(of_x, P) + noise), slope, d, self.lam_l)

    def advance(
        self, mu: Float[Array, " runs"], P: Float[Array, "runs nx nx"]
    ) -> tuple[Float[Array, "runs nx nx"], Float[Array, "runs nx nx"], Float[Array, "runs ny ny"]]:
        """Return the transition matrix, P_pred and the modified R of every run, Steps 2 and 3 of the filter."""
        W = np.broadcast_to(self.W, (len(mu), *self.W.shape))
        shrunk, part = _shrunk(P, self.G_x, mu)
        F = self.A - np.einsum("ij,rjk->rik", self.A, np.einsum("rij,jk->rik", part, self.G_x))
        noise = congruence(self.Bw, _shrunk(W, self.G_w, mu)[0]) + self.rest
        P_pred = symmetrise(congruence(self.A, shrunk) + noise)
        return F, P_pred, self.R - mu[:, None, None] * self.HH


def _shrunk(
    P: Float[Array, "runs n n"], G: Float[Array, "s n"], mu: Float[Array, " runs"]
) -> tuple[Float[Array, "runs n n"], Float[Array, "runs n s"]]:
    """Return (P^-1 + G'G / mu)^-1, also of a singular P, and P G' (mu I + G P G')^-1."""
    PG = np.einsum("rij,kj->rik", P, G)
    S = np.einsum("ij,rjk->rik", G, PG) + mu[:, None, None] * np.eye(len(G))
    part = np.linalg.solve(S, PG.mT).mT
    return symmetrise(P - np.einsum("rij,rkj->rik", part, PG)), part


def search(
    fixed: Float[Array, "rows n n"], slope: Float[Array, "n n"], d: Float[Array, "rows n"], lam_l: float
) -> Float[Array, " rows"]:
    """Return mu = 1/lam of every problem, with lam between (1 + NEAREST) and FARTHEST times its lower bound lam_l.

    `fixed` is N at mu = 0, `slope` its derivative diag(I, -H H') by mu, d = [E_b; b]; a row with NaN gives NaN.
    """
    low, high = 1.0 / (FARTHEST * lam_l), 1.0 / ((1.0 + NEAREST) * lam_l)
    middle = 0.5 * (low + high)
    N = fixed + middle * slope
    sound = np.asarray(np.isfinite(N).all(axis=(1, 2)) & np.isfinite(d).all(axis=1))
    # A decomposition of NaN would fail for all rows.
    root = np.linalg.cholesky(np.where(sound[:, None, None], N, np.eye(N.shape[1])))
    half = np.linalg.solve(root, np.broadcast_to(slope, N.shape))
    relative = np.linalg.solve(root, half.mT)
    n, U = np.linalg.eigh(0.5 * (relative + relative.mT))
    c = np.einsum("rji,rj->ri", U, np.linalg.solve(root, np.where(sound[:, None], d, 0.0)[:, :, None])[:, :, 0])
    mu = middle + _least(n, c * c, middle - low)
    return np.where(sound, np.clip(mu, low, high), np.nan)


def _least(n: Float[Array, "rows n"], weight: Float[Array, "rows n"], reach: float) -> Float[Array, " rows"]:
    """Return the t in [-reach, reach] with the least sum of weight / (1 + t n), every row on its own."""
    low, high = np.full(len(n), -reach), np.full(len(n), reach)
    t = np.where(_slope(n, weight, low)[0] >= 0.0, low, np.where(_slope(n, weight, high)[0] <= 0.0, high, 0.0))
    active: Bool[Array, " rows"] = np.abs(t) < reach
    for _ in range(_STEPS):
        if not active.any():
            break
        first, second = _slope(n, weight, t)
        low, high = np.where(active & (first < 0.0), t, low), np.where(active & (first >= 0.0), t, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = t - first / second
        inside = (low < newton) & (newton < high)
        after = np.where(inside, newton, 0.5 * (low + high))
        moved = np.abs(after - t) > 1e-15 * reach
        t, active = np.where(active, after, t), active & moved
    return t


def _slope(
    n: Float[Array, "rows n"], weight: Float[Array, "rows n"], t: Float[Array, " rows"]
) -> tuple[Float[Array, " rows"], Float[Array, " rows"]]:
    """Return the first and the second derivative by t of the sum of weight / (1 + t n)."""
    below = 1.0 + t[:, None] * n
    first, second = np.zeros(len(n)), np.zeros(len(n))
    # Term by term, since the order of a reduction may depend on the number of rows.
    for i in range(n.shape[1]):
        term = weight[:, i] * n[:, i] / below[:, i] ** 2
        first, second = first - term, second + 2.0 * term * n[:, i] / below[:, i]
    return first, second
