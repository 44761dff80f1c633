"""Maximum correntropy Kalman filter: outputs far from the estimate have almost no weight.

Model   As `kalman`; v has outliers.  x_hat is a fixed point of the Kalman correction with R_v over the weights
        exp(-r_i^2 / (2 sigma^2)), r = T (y - C x_hat), T R_v T' = I, T lower triangular; it is iterated from x_pred.
Source  Chen, Liu, Zhao and Principe, Automatica 76 (2017); not compared with the text of the paper.
Assumed P is that of the Kalman correction with R_v over the weights, as of `huber-kalman`; `robust: both` weights
        x - x_pred, too, as the paper does.
Order   As `huber-kalman` (numerics/output_weights.py).
Method  Reweighting until the residuals of the run change by less than 1e-11, at most 200 times.
Limit   sigma -> infinity is `kalman`.
Cost    As estimators/weighted.py.
Fails   Design error if R_v is singular.  The loss is not convex: there may be several fixed points.  An estimate far
        from the state can give every measurement a weight of almost 0, and then stays wrong: compare medians and the
        share of lost runs, not means alone.
"""

from __future__ import annotations

from typing import Literal

from jaxtyping import Float

from rmpc_bench.estimators.weighted import WeightedFilter, weighted_filter
from rmpc_bench.numerics.output_weights import WeightLaw
from rmpc_bench.types import Array, Model, Positive

EQUATION = r"""R_v \to T \mathrm{diag}(w_j)^{-1} T^\top, \quad
w_j = \exp \left( - \frac{r_j^2}{2 \sigma^2} \right), \quad r = T^{-1} (y_k - C \hat x_{k|k}), \quad T T^\top = R_v"""


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    sigma: Positive = 5.0,
    robust: Literal["measurement", "both"] = "measurement",
    use_y0: bool = True,
) -> WeightedFilter:
    """Kalman filter with the correntropy loss of the measurement noise.

    Parameters
    ----------
    model : design model; R_v is the covariance of the measurement noise without outliers
    n_steps : number of control periods N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    sigma : width of the kernel, in standard deviations of the measurement noise
    robust : `measurement` allows for outliers of y, `both` for those of x - x_pred, too
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If R_v is singular.
    """
    law = WeightLaw("correntropy", (sigma,), robust == "both")
    return weighted_filter(model, n_steps, x0, P0, law, use_y0=use_y0)
