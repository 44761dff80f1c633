"""Weights of measured outputs for noise with outliers, given a prediction with the root of its covariance.

Symbols     q whitened innovation, H whitened output matrix, P = F F', z the whitened deviation,
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
from jaxtyping import Bool, Float, Int

from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.numerics.square_root import root_of, without_missing
from rmpc_bench.types import Array

# Riccati recursion of filters in which every run has a root of its covariance of its own.
#
# Whitening   T R_v T' = I, T the inverse of the lower Cholesky factor of R_v; q = T e, H = T C.  A component of q is an
#             output minus its prediction from the outputs before it, over its standard deviation: with correlated
#             noises a weight of one component depends on the order of the outputs.
# Correction  that of output_weights.py.
# Missing     An output that is NaN has no effect.  T is then that of the other outputs.
# Bits        A run is computed alone, whatever other runs the block has.


class Measured(NamedTuple):
    """Measurements compared with their predictions."""

    e: Float[Array, "runs ny"]  # innovation; NaN where an output is missing
    S: Float[Array, "runs ny ny"]  # C P_pred C' + R_v
    q: Float[Array, "runs ny"]
    H: Float[Array, "runs ny nx"]


class OwnState(NamedTuple):
    """Estimate or prediction of every run with a root of its covariance."""

    x: Float[Array, "runs nx"]
    root: Float[Array, "runs nx nx"]


def whitening(R_v: Float[Array, "*k ny ny"]) -> Float[Array, "*k ny ny"]:
    """Return the lower triangular T with T R_v T' = I."""
    return np.tril(np.linalg.inv(np.linalg.cholesky(R_v)))


def whitening_of_runs(
    T: Float[Array, "ny ny"], R_v: Float[Array, "ny ny"], missing: Bool[Array, "runs ny"]
) -> Float[Array, "runs ny ny"]:
    """Return T of every run, that of its outputs which are there."""
    rows = np.flatnonzero(missing.any(axis=1))
    found = np.repeat(T[None], len(missing), axis=0)
    found[rows] = whitening(without_missing(R_v, ~missing[rows]))
    return found


def measured(
    C: Float[Array, "ny nx"],
    d: Float[Array, " ny"],
    R_v: Float[Array, "ny ny"],
    T: Float[Array, "some ny ny"],
    state: OwnState,
    y: Float[Array, "runs ny"],
) -> Measured:
    """Compare y, NaN where it is missing, with the predictions C x + d; T is of every run, or a single one for all."""
    from rmpc_bench.numerics.output_weights_kernel import measure_kernel

    (runs, nx), ny = state.x.shape, len(C)
    found = Measured(np.empty((runs, ny)), np.empty((runs, ny, ny)), np.empty((runs, ny)), np.empty((runs, ny, nx)))
    C, d, R_v, T, x, root, y = map(as_compiled, (C, d, R_v, T, *state, y))
    measure_kernel(C, d, R_v, T, x, root, y, *found)
    return found


def predicted(
    A: Float[Array, "nx nx"],
    B: Float[Array, "nx nu"],
    f: Float[Array, " nx"],
    Q_w: Float[Array, "nx nx"],
    state: OwnState,
    u: Float[Array, "runs nu"],
) -> OwnState:
    """Return A x + B u + f and the root of A P A' + Q_w of every run."""
    from rmpc_bench.numerics.output_weights_kernel import predict_kernel

    after = OwnState(np.empty_like(state.x), np.empty_like(state.root))
    A, B, f, Q_root, x, root, u = map(as_compiled, (A, B, f, root_of(Q_w), *state, u))
    predict_kernel(A, B, f, Q_root, x, root, u, *after)
    return after


LawName: TypeAlias = Literal["student", "huber", "correntropy", "gate", "innovation"]
LAWS: tuple[LawName, ...] = ("student", "huber", "correntropy", "gate", "innovation")
"""In the order of the constants of the kernel."""


@dataclass(frozen=True)
class WeightLaw:
    """A rule for the weights."""

    name: LawName  # one of `LAWS`
    numbers: tuple[float, ...]  # dof and iterations; k; sigma; the gate in e' S^-1 e for 1, 2, .. outputs; or k
    both: bool = False  # whether x - x_pred has weights, too; for `huber` and `correntropy`


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
