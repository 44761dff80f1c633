"""Unscented Kalman filter; with the default parameters it is the cubature Kalman filter.

Model   x(k+1) = f(x(k), u(k)) + w(k), w ~ N(0, Q_w);  y(k) = h(x(k)) + v(k), v ~ N(0, R_v);  white, independent.
        Points x +- columns of sqrt((n + lam) P), lam = alpha^2 (n + kappa) - n; weights of the mean lam / (n + lam) and
        1 / (2 (n + lam)), that of the centre in covariances plus 1 - alpha^2 + beta.  The noise is added; the points
        are placed anew before the correction.
Source  Julier and Uhlmann (2004), van der Merwe (2004); cubature: Arasaratnam and Haykin (2009).
Assumed The defaults alpha = 1, beta = 0, kappa = 0 (no weight is negative).  van der Merwe's alpha = 1e-3 places the
        points closer together than the jump of a dry friction, where the plant is linear.
Limit   A linear model: `kalman` for any alpha.  alpha -> 0, beta = 0: the mean of the extended Kalman filter plus terms
        of order P.
Cost    2 n + 1 evaluations of f per run and step, and of h where the output is not linear.  The servomechanism: 24 us
        (`make perf`).
Digits  With kappa < 0 or beta < 0 covariances are formed: relative errors of 2e-8 at P(0) = 1e8 R and 3e-2 at 1e14 R
        (measured).
Fails   As estimators/gaussian_filter.py.  With kappa < 0 or beta < 0 a covariance may become indefinite.
"""

from __future__ import annotations

from jaxtyping import Float

from rmpc_bench.estimators.gaussian_filter import GaussianFilter, gaussian_filter
from rmpc_bench.numerics.moment_transform import SigmaPoints
from rmpc_bench.types import Array, DesignError, Model, Positive

EQUATION = r"""\chi_i = \hat x \pm \sqrt{(n + \lambda) P}_i, \quad \hat x_{k+1|k} = \sum_i W_i f(\chi_i, u_k), \quad
P_{k+1|k} = \sum_i W_i^c (f(\chi_i, u_k) - \hat x_{k+1|k}) (\cdot)^\top + Q_w, \quad L_k = P_{xy} (P_{yy} + R_v)^{-1}"""


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    alpha: Positive = 1.0,
    beta: float = 0.0,
    kappa: float = 0.0,
    use_y0: bool = True,
) -> GaussianFilter:
    """Unscented Kalman filter of a nonlinear design model.

    Parameters
    ----------
    model : design model: `servo`, `nonlinear`, `linearise` with `at: trajectory`, or a linear one
    n_steps : number of control periods N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    alpha : spread of the points
    beta : added weight of the centre in covariances
    kappa : added to the number of states n in the spread; n + kappa must be positive
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If the model has no map f(x, u), R_v is singular, or n + kappa is not positive.
    """
    made = gaussian_filter(model, SigmaPoints(alpha, beta, kappa), n_steps, x0, P0, use_y0=use_y0)
    n = len(made.x_start)
    if not n + kappa > 0.0:
        raise DesignError(f"n + kappa must be positive: choose kappa > {-n} for the {n} states of this model", "kappa")
    return made
