"""Weights of measured outputs for noise with outliers, given a prediction with its covariance.

Symbols     q whitened innovation, H whitened output matrix (own_covariance.py), G = H P H', W the diagonal matrix of
            the weights, lam = (W^-1 + G)^-1 q, so that x_hat = x_pred + P H' lam; r = q - G lam the whitened residual
            of x_hat.
student     A common weight w of all outputs, repeatedly w = (dof + m) / (dof + r' r + tr H P_hat H'), m outputs, from
            w = 1; the number of iterations is fixed.
huber       x_hat minimises |x - x_pred|^2_{P^-1} / 2 + sum rho(r_i), rho Huber's function with the corner k; weights
            min(1, k / |r_i|).  lam solves the dual min lam' (I + G) lam / 2 - lam' q over |lam_i| <= k.  An active-set
            method finds it after finitely many steps; for one output lam = clip(q / (1 + G), +-k).  Reweighting has
            the same fixed point, and converges by a factor of up to G / (1 + G) per step for one output.
correntropy Weights exp(-r_i^2 / (2 sigma^2)), by reweighting from x_pred, for every run until its residuals change by
            less than 1e-11 or 200 times.  There may be several fixed points.
gate        Weights of 1 if e' S^-1 e is at most the gate, else of 0.
innovation  lam = U'^-1 clip(U^-1 q, +-k), I + G = U U', U lower triangular; weights |clip| / |U^-1 q|.
both        huber and correntropy: x - x_pred has weights, too, those of T^-1 (x - x_pred), P = T T', T lower
            triangular: the result depends on the order of the states.  By reweighting as above.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.types import Array

LawName: TypeAlias = Literal["student", "huber", "correntropy", "gate", "innovation"]
LAWS: tuple[LawName, ...] = ("student", "huber", "correntropy", "gate", "innovation")
"""In the order of the constants of the kernel."""


@dataclass(frozen=True)
class WeightLaw:
    """A rule for the weights.

    Parameters
    ----------
    name : one of `LAWS`
    numbers : dof and iterations; k; sigma; the gate in e' S^-1 e for 1, 2, .. outputs; or k
    both : whether x - x_pred has weights, too; for `huber` and `correntropy`
    """

    name: LawName
    numbers: tuple[float, ...]
    both: bool = False


class Weights(NamedTuple):
    """Weights of the whitened outputs, and the correction that they give."""

    weight: Float[Array, "runs ny"]
    lam: Float[Array, "runs ny"]
    P: Float[Array, "runs nx nx"]
    """Covariance of the prediction over the weights of x - x_pred; that of the prediction unless they have any."""


def weights(
    law: WeightLaw,
    P: Float[Array, "runs nx nx"],
    q: Float[Array, "runs ny"],
    H: Float[Array, "runs ny nx"],
    count: Int[Array, " runs"] | None = None,
) -> Weights:
    """Compute the weights of every run.

    Parameters
    ----------
    law : the rule
    P : covariances of the predictions
    q, H : whitened innovations and output matrices, zero for an output that is missing
    count : number of outputs that are there; None if all are
    """
    from rmpc_bench.numerics.output_weights_kernel import weight_kernel

    P = as_compiled(P)
    found = Weights(np.empty_like(q), np.empty_like(q), np.empty_like(P) if law.both else P)
    numbers = np.array(law.numbers, dtype=float)
    there = np.full(len(q), q.shape[1]) if count is None else count.astype(np.int64)
    weight_kernel(LAWS.index(law.name), numbers, law.both, P, as_compiled(q), as_compiled(H), there, *found)
    return found
