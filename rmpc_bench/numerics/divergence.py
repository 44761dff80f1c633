"""Least favourable covariance within a divergence ball of radius c around the covariance P = F F'.

The divergence between the covariances V and P is that of the tau family, tr d(S) with S = F^-1 V F^-T and

        d(s) = [s - 1 - (s^tau - 1) / tau] / (1 - tau),   tau = 0: s - 1 - log s,   tau = 1: s log s - s + 1.

The V of largest trace with tr d(S) = c satisfies theta F'F = d'(S) = (I - S^(tau - 1)) / (1 - tau), where theta is the
inverse multiplier of the constraint.  With x_i = theta * lambda_i(P), and the factor s_i of that eigenvalue,

        s_i = (1 - (1 - tau) x_i)^(-1 / (1 - tau)),   tau = 0: 1 / (1 - x_i),   tau = 1: exp(x_i),

and sum_i d(s_i) = c determines theta, as the sum increases strictly from 0 to infinity.  Only the covariance is
perturbed.  With the term dm' P^-1 dm of tau = 0, a shift dm of the mean would be worse where x_i > 1, which requires
tau > 0 and a large c.

Source  zenere2018, (13), (16) at tau = 0 and (19) at tau = 1; between them derived as above (the family is Zorzi's).
Limit   c -> 0 gives theta -> 0 and V -> P.
Method  The unknown is g = log s of the largest eigenvalue, for which the equation has no pole at any tau.  Newton's
        method is applied to the square root of the left side, which is nearly linear, until steps are rounding.
Digits  Given the eigenvalues of P, theta and V are accurate to 2e-15 for every tau and c; sums of positive terms
        replace the closed forms where these cancel.  Rounding of two almost equal eigenvalues is multiplied by s in V.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Float

from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.numerics.square_root import covariance_of
from rmpc_bench.types import Array

Tau: TypeAlias = Annotated[float, Ge(0), Le(1)]
"""Member of the family of divergences."""
Interpretation: TypeAlias = Literal["printed", "half"]
"""(16) as printed, or with the factor 1/2 that the divergence (10) of two Gaussians has."""

LARGEST = 1e100
"""Larger covariances count as an overflow."""


class Inflation(NamedTuple):
    """A root of the least favourable covariance V, and its multiplier."""

    root: Float[Array, "n r"]
    theta: float

    @property
    def V(self) -> Float[Array, "n n"]:
        """The covariance."""
        return covariance_of(self.root)


def right_side(c: float, kl: Interpretation) -> float:
    """Return the right side of (16) for a ball of radius c; `half` uses the factor 1/2 of (10)."""
    return 2.0 * c if kl == "half" else c


def solve_stretch(mu: list[float], c: float, tau: float = 0.0) -> float:
    """Solve sum_i d(s_i) = c > 0 for g = log(s) of the largest eigenvalue; mu are all over the largest."""
    g = math.log1p(math.sqrt(2.0 * c / sum([m * m for m in mu])) + c)  # right for small c, and near for large c
    for _ in range(100):
        left, slope = _divergence(g, mu, tau)
        step = 2.0 * (left - math.sqrt(c) * math.sqrt(left)) / slope
        g = g - step if step < g else 0.5 * g
        if abs(step) <= 1e-9 * g:  # the error after a step is of the order of its square
            break
    return g


def _divergence(g: float, mu: list[float], tau: float) -> tuple[float, float]:
    """Left side sum_i d(s_i) and its derivative by g, at log(s) = g of the largest eigenvalue."""
    a = 1.0 - tau
    x_max = multiplier(g, tau)
    far = (a if tau < 1.0 else 1.0) * g > 0.35  # what the closed form loses by cancellation is then below ten roundings
    left = slope = 0.0
    for m in mu:
        log_s = _log_stretch(m, g, x_max, tau)
        s = math.exp(log_s)
        left += _far(log_s, s, tau) if far else _near(log_s, tau)
        slope += m * m * s * math.exp(a * (log_s - g))  # d'(s_i) = x_i, ds_i/dx_i = s_i^(1 + a), dx_max/dg = e^(-a g)
    return left, slope * x_max


def _far(log_s: float, s: float, tau: float) -> float:
    if tau == 1.0:
        return log_s * s - s + 1.0
    power = math.expm1(tau * log_s) / tau if tau > 1e-17 else log_s
    return (s - 1.0 - power) / (1.0 - tau)


def _near(log_s: float, tau: float) -> float:
    """d(s) as the sum over k >= 2 of (1 + tau + .. + tau^(k-2)) log(s)^k / k!, in which nothing cancels."""
    total = power = 0.5 * log_s * log_s
    term, geometric, k = total, 1.0, 2
    while term > 1e-17 * total:
        k += 1
        power *= log_s / k
        geometric = 1.0 + tau * geometric
        term = power * geometric
        total += term
    return total


def multiplier(g: float, tau: float) -> float:
    """The x = theta * lambda that stretches lambda by e^g."""
    a = 1.0 - tau
    return -math.expm1(-a * g) / a if tau < 1.0 else g


def _log_stretch(m: float, g: float, x_max: float, tau: float) -> float:
    """Log(s) of the eigenvalue m * lambda_max when that of lambda_max is g."""
    a = 1.0 - tau
    if tau == 1.0:
        return m * g
    q = m * (a * x_max)
    return -math.log1p(-q) / a if q < 0.5 else -math.log((1.0 - m) + m * math.exp(-a * g)) / a


def inflate(F: Float[Array, "n r"], theta: float, tau: float = 0.0) -> Inflation:
    """V = F (I - theta (1 - tau) F'F)^(-1/(1 - tau)) F', (13), (19), by eigenvalues: a singular P is no obstacle.

    A ValueError says that theta (1 - tau) lambda_max(P) >= 1, where V is undefined, or V is too large for its gains.
    """
    lam, W = _spectrum(F)
    x, a = theta * lam, 1.0 - tau
    if a * x[0] >= 1.0:
        factor = "theta*lambda_max(P)" if tau == 0.0 else "theta*(1 - tau)*lambda_max(P)"
        raise ValueError(f"{factor} = {a * x[0]:.6g} is not below 1")
    if tau == 0.0:
        return Inflation(_stretched(F, W, 1.0 / (1.0 - x)), theta)
    log_s = -np.log1p(-a * x) / a if tau < 1.0 else x
    if lam[0] > 0.0 and log_s[0] + math.log(lam[0]) > math.log(LARGEST):
        raise ValueError(f"V overflows (theta*lambda_max(P) = {x[0]:.6g})")
    return Inflation(_stretched(F, W, np.exp(log_s)), theta)


def inflate_to_radius(F: Float[Array, "n r"], c: float, tau: float = 0.0) -> Inflation:
    """Solve (16) with the right side c > 0 for theta, and return V of (13) or of another tau; P = 0 gives V = 0."""
    lam, W = _spectrum(F)
    largest = lam.item(0)
    if largest <= 0.0:
        return Inflation(np.zeros_like(F), 0.0)
    mu = [value / largest for value in lam.tolist()]
    g = solve_stretch(mu, c, tau)
    x_max = multiplier(g, tau)
    stretch = np.array([math.exp(_log_stretch(m, g, x_max, tau)) for m in mu])
    return Inflation(_stretched(F, W, stretch), x_max / largest)


def _spectrum(F: Float[Array, "n r"]) -> tuple[Float[Array, " r"], Float[Array, "r r"]]:
    """Return the eigenvalues of F'F, the largest first, and its eigenvectors."""
    _, sizes, W = np.linalg.svd(F)
    lam = np.zeros(len(W))
    lam[: len(sizes)] = sizes * sizes
    return lam, W.T


def _stretched(F: Float[Array, "n r"], W: Float[Array, "r r"], stretch: Float[Array, " r"]) -> Float[Array, "n r"]:
    """Return F W stretch^1/2 W': a small source of F keeps its digits beside a large one, which U s^1/2 would not."""
    return F.dot((W * np.sqrt(stretch)).dot(W.T))


# The Kullback-Leibler divergence of one normal density from another, in its two parts.
#
# Between the true density N(m~, K~) and the nominal density N(m, K), both of dimension n and with dm = m~ - m:
#
#     D = 1/2 [tr(K^-1 K~) - n - ln det(K^-1 K~)]  +  1/2 dm' K^-1 dm
#               covariance part                          mean part
#
# Source  zenere2018, (10), for normal densities.
# Limit   K~ = K and dm = 0 give 0; neither part is negative.
# Fails   numpy.linalg.LinAlgError where K is singular.


def covariance_part(K_true: Float[Array, "*batch n n"], K: Float[Array, "*#batch n n"]) -> Float[Array, "*batch"]:
    """Return the part that does not depend on the means; infinite where K~ is singular.

    K~ is the covariance of the true density, K that of the nominal one, positive definite.

    It is the sum of (lam - 1 - ln lam) / 2 over the eigenvalues lam of K^-1 K~: no term is negative, so none cancels.
    """
    excess = np.maximum(np.linalg.eigvalsh(_whitened(K_true, K)), 0.0) - 1.0
    with np.errstate(divide="ignore"):
        terms: Array = excess - np.log1p(excess)  # keeps its digits where the two densities are close
    return np.asarray(0.5 * terms.sum(axis=-1))


def mean_part(moment: Float[Array, "*batch n n"], K: Float[Array, "*#batch n n"]) -> Float[Array, "*batch"]:
    """Return the expectation of dm' K^-1 dm / 2 from that of dm dm'."""
    return np.asarray(0.5 * np.trace(_whitened(moment, K), axis1=-2, axis2=-1))


def _whitened(M: Float[Array, "*batch n n"], K: Float[Array, "*#batch n n"]) -> Float[Array, "*batch n n"]:
    """W M W' with W K W' = I."""
    root = np.linalg.cholesky(K)
    white: Array = np.linalg.solve(root, np.linalg.solve(root, M).mT)
    return symmetrise(white)
