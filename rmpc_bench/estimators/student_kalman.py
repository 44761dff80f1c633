"""Kalman filter for measurement noise of a Student-t distribution, by variational Bayes.

Model   As `kalman`, but v(k) ~ t(dof, 0, R_v): R_v is the scale matrix, the covariance is dof / (dof - 2) R_v for
        dof > 2.  One weight per sample: v(k) given lam is N(0, R_v / lam), lam ~ Gamma(dof / 2, dof / 2).
        lam = 1, then repeatedly: (x_hat, P) is the Kalman correction with R_v / lam,
        lam = (dof + ny) / (dof + r' R_v^-1 r + tr R_v^-1 C P C'), r = y - C x_hat.
Source  Piche, Sarkka and Hartikainen (2012); Agamennoni, Nieto and Nebot (2012); not compared with the texts of the
        papers.
Assumed The number of corrections is fixed, so that a run does not depend on others.  P is that of x_hat - x given lam.
        `R_v: covariance` takes the R_v of the model for the covariance: the scale matrix is (dof - 2) / dof R_v.
        The noise `same: {dof: ..}` has the covariance of the model: use `R_v: covariance` with it.  The weight is
        common to all outputs, so that their order does not matter.  With missing outputs ny is the number of the
        others.  The filter of Roth, Ozkan and Gustafsson (2013) is another one: an outlier has its full effect on x_hat
        there.
Limit   dof -> infinity is `kalman`; the difference decreases as 1 / dof.
Cost    0.8 us per run and step for two states and one output (`make perf`).
Fails   Design error if R_v is singular.
"""

from __future__ import annotations

from typing import Literal

from jaxtyping import Float

from rmpc_bench.estimators.weighted import WeightedFilter, weighted_filter
from rmpc_bench.numerics.output_weights import WeightLaw
from rmpc_bench.types import Array, Count, DesignError, Model, Positive

EQUATION = r"""\lambda = \frac{\nu + n_y}{\nu + r^\top R_v^{-1} r + \mathrm{tr} (R_v^{-1} C P_{k|k} C^\top)}, \quad
r = y_k - C \hat x_{k|k}, \quad R_v \to R_v / \lambda"""


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    dof: Positive = 4.0,
    iterations: Count = 10,
    R_v: Literal["scale", "covariance"] = "scale",
    use_y0: bool = True,
) -> WeightedFilter:
    """Kalman filter for Student-t measurement noise.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    dof : degrees of freedom of the measurement noise
    iterations : number of corrections per sample; 1 is the Kalman filter
    R_v : whether R_v of the model is the scale matrix of the measurement noise or its covariance, which needs dof > 2
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If R_v is singular, or dof <= 2 with `R_v: covariance`.
    """
    if R_v == "covariance" and dof <= 2.0:
        raise DesignError("must be above 2 with `R_v: covariance`: the covariance is infinite; write R_v: scale", "dof")
    law = WeightLaw("student", (dof, float(iterations)))
    share = (dof - 2.0) / dof if R_v == "covariance" else 1.0
    return weighted_filter(model, n_steps, x0, P0, law, use_y0=use_y0, share=share)
