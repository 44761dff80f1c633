"""Weights of measured outputs for noise with outliers, given a prediction with the root of its covariance.

Symbols     q whitened innovation, H whitened output matrix (own_covariance.py), P = F F', z the whitened deviation,
            x_hat = x_pred + F z; r = q - H F z the whitened residual of x_hat.  Every x_hat but that of `innovation` is
            the correction with white noise whose variances are 1 over the weights.
student     A common weight w of all outputs, repeatedly w = (dof + m) / (dof + r' r + tr H P_hat H'), m outputs, from
            w = 1; the number of iterations is fixed.
huber       x_hat minimises |x - x_pred|^2_{P^-1} / 2 + sum rho(r_i), rho Huber's function with the corner k; weights
            min(1, k / |r_i|).  The clipped residuals lam solve the dual min lam' (I + G) lam / 2 - lam' q over
            |lam_i| <= k, G = H P H'.  An active-set method finds it after finitely many steps; for one output
            lam = clip(q / (1 + G), +-k).  Reweighting has the same fixed point, and converges by a factor of up to
            G / (1 + G) per step for one output.
correntropy Weights exp(-r_i^2 / (2 sigma^2)), by reweighting from x_pred, for every run until its residuals change by
            less than 1e-11 or 200 times.  There may be several fixed points.
gate        Weights of 1 if e' S^-1 e is at most the gate, else of 0.  It is |U'^-1 q|^2 with the triangle U of the
            correction, I + G = U' U, so that a nearly singular S is not an outlier.
innovation  The entries of U'^-1 q are clipped to +-k; weights |clip| / |U'^-1 q|.
both        huber and correntropy: x - x_pred has weights, too, those of z, F lower triangular: the result depends on
            the order of the states.  By reweighting as above.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.numerics.own_covariance import OwnState
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


class Weighed(NamedTuple):
    """Weights of the whitened outputs, and the correction that they give."""

    weight: Float[Array, "runs ny"]
    after: OwnState


def corrected(
    law: WeightLaw,
    state: OwnState,
    q: Float[Array, "runs ny"],
    H: Float[Array, "runs ny nx"],
    count: Int[Array, " runs"] | None = None,
    kept: float = 1.0,
) -> Weighed:
    """Compute the weights of every run and correct its prediction; q and H are 0 for an output that is missing.

    `count` is the number of the others, None for all, and `kept` the share of the decrease of P.
    """
    from rmpc_bench.numerics.output_weights_kernel import correct_kernel

    found = Weighed(np.empty_like(q), OwnState(np.empty_like(state.x), np.empty_like(state.root)))
    numbers = np.array(law.numbers, dtype=float)
    there = np.full(len(q), q.shape[1]) if count is None else count.astype(np.int64)
    root, q, H, x = map(as_compiled, (state.root, q, H, state.x))
    correct_kernel(LAWS.index(law.name), numbers, law.both, kept, root, q, H, there, x, found.weight, *found.after)
    return found
