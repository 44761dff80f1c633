"""Kalman filter with Huber's loss: large residuals or innovations are clipped.

Model   As `kalman`; v has outliers.  T R_v T' = I and T_S S T_S' = I are lower triangular, e = y - C x_pred,
        S = C P_pred C' + R_v, rho is Huber's function: r^2 / 2 up to k, then linear; psi clips to +-k.
        regression  x_hat = argmin |x - x_pred|^2_{P_pred^-1} / 2 + sum rho((T (y - C x))_i); P is that of the Kalman
                    correction with R_v over the weights psi(r) / r of the residuals r = T (y - C x_hat).  One output:
                    x_hat = x_pred + P_pred C' clip(e / S, +-k / sqrt(R_v)).
        innovation  x_hat = x_pred + P_pred C' T_S' psi(T_S e);
                    P = P_pred - (1 - eps) (1 - 2 Phi(-k)) P_pred C' S^-1 C P_pred, which does not depend on the data.
                    eps is the share of outliers; without the key it is the share for which k is minimax,
                    2 phi(k) / k - 2 Phi(-k) = eps / (1 - eps).
Source  regression: Boncelet and Dickinson (1983), Karlgaard and Schaub (2007).  innovation: Masreliez and Martin
        (1977).  Not compared with the texts of the papers.
Assumed `robust: both` (Karlgaard and Schaub), for outliers of the process noise, applies rho to x - x_pred, too,
        whitened with the Cholesky factor of P_pred.  An outlier of y then moves the state.
Order   Component i of T y is output i minus its prediction from outputs 1..i-1: if R_v (for `innovation`: S) is not
        diagonal, x_hat depends on the order of the outputs; with `both`, on the order of the states.
Limit   k -> infinity is `kalman`.
Method  regression, measurement: the dual problem by an active set, exact after finitely many steps.  both: reweighting
        until the residuals of the run change by less than 1e-11, at most 200 times.
Cost    0.7 us per run and step for two states and one output (`make perf`).
Fails   Design error if R_v is singular.  both: where nearly all residuals are large the loss is almost flat, and 200
        repetitions may not suffice.  In 5 of 150 random corrections with three states and innovations of about 60
        standard deviations the loss was up to 8e-4 of its minimum too large, and x_hat far from where it is attained.
"""

from __future__ import annotations

from math import erf, exp, pi, sqrt
from typing import Annotated, Literal, TypeAlias

from annotated_types import Ge, Lt
from jaxtyping import Float

from rmpc_bench.estimators.weighted import WeightedFilter, weighted_filter
from rmpc_bench.numerics.output_weights import WeightLaw
from rmpc_bench.types import Array, DesignError, Model, Positive

EQUATION = r"""\hat x_{k|k} = \mathrm{arg} \min_x \frac{1}{2} (x - \hat x_{k|k-1})^\top
P_{k|k-1}^{-1} (x - \hat x_{k|k-1}) + \sum_j \rho_k \left( (R_v^{-1/2} (y_k - C x))_j \right)"""
Variant: TypeAlias = Literal["regression", "innovation"]
Robust: TypeAlias = Literal["measurement", "both"]
Share: TypeAlias = Annotated[float, Ge(0), Lt(1)]


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    k: Positive = 1.345,
    variant: Variant = "regression",
    robust: Robust = "measurement",
    eps: Share | None = None,
    use_y0: bool = True,
) -> WeightedFilter:
    """Kalman filter with Huber's loss of the measurement noise.

    Parameters
    ----------
    model : design model; R_v is the covariance of the measurement noise without outliers
    n_steps : number of control periods N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    k : corner of Huber's function, in standard deviations; 1.345 is 95 % efficient for Gaussian noise
    variant : `regression` clips the residuals of x_hat, `innovation` the innovations
    robust : `measurement` allows for outliers of y, `both` for those of x - x_pred, too
    eps : share of outliers for P of `innovation` (default: that for which k is minimax)
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If R_v is singular, or a key does not apply to the variant.
    """
    if variant == "innovation":
        if robust == "both":
            raise DesignError("`both` needs `variant: regression`; choose that variant or `measurement`", "robust")
        law, kept = WeightLaw("innovation", (k,)), decrease(k, eps)
        return weighted_filter(model, n_steps, x0, P0, law, use_y0=use_y0, kept=kept)
    if eps is not None:
        raise DesignError("eps belongs to `variant: innovation`; remove it or choose that variant", "eps")
    return weighted_filter(model, n_steps, x0, P0, WeightLaw("huber", (k,), robust == "both"), use_y0=use_y0)


def decrease(k: float, eps: float | None = None) -> float:
    """Return (1 - eps) (1 - 2 Phi(-k)), the decrease of P by a clipped innovation relative to that of an unclipped one.

    Examples
    --------
    >>> round(decrease(1.345), 3), decrease(40.0)
    (0.774, 1.0)
    """
    inside = erf(k / sqrt(2.0))
    if eps is not None:
        return (1.0 - eps) * inside
    density = exp(-0.5 * k * k) / sqrt(2.0 * pi)
    # 1 / (1 - eps) = 1 + eps / (1 - eps), and 2 Phi(-k) = 1 - inside.
    return inside / (inside + 2.0 * density / k)
