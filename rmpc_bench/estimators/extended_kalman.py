"""Extended Kalman filter: it linearises the design model at the estimate.

Model   x(k+1) = f(x(k), u(k)) + w(k), w ~ N(0, Q_w);  y(k) = h(x(k)) + v(k), v ~ N(0, R_v);  white, independent.
        x_pred = f(x_hat, u), P_pred = J P J' + Q_w with the Jacobian J of f at x_hat; the correction has that of h at
        x_pred.  A linear f or h has its own matrix.
        With the key `spread` column i of J is [f(x + h_i) - f(x - h_i)] / (2 h_i), h_i = spread sqrt(P_ii).
Source  The textbook filter (Simon 2006, 13.2).  `spread: 1` is the filter of Norgaard, Poulsen and Ravn (Automatica 36,
        2000) without the terms of second order.
Assumed The Jacobian is that of central differences with ten correct digits (numerics/moment_transform.py).  With dry
        friction the derivative with respect to the velocity of a body at rest is 0: a resting load never moves; with
        `spread: 1` it can.
Limit   A linear model: `kalman`.
Cost    2 n + 1 evaluations of f per run and step, and of h where the output is not linear.
Fails   As estimators/gaussian_filter.py.
"""

from __future__ import annotations

from jaxtyping import Float

from rmpc_bench.estimators.gaussian_filter import GaussianFilter, gaussian_filter
from rmpc_bench.numerics.moment_transform import CentralDifferences
from rmpc_bench.types import Array, Model, Positive

EQUATION = r"""\hat x_{k+1|k} = f(\hat x_{k|k}, u_k), \quad
P_{k+1|k} = J P_{k|k} J^\top + Q_w, \quad J = \frac{\partial f}{\partial x}(\hat x_{k|k}, u_k)"""


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    spread: Positive | None = None,
    use_y0: bool = True,
) -> GaussianFilter:
    """Extended Kalman filter of a nonlinear design model.

    Parameters
    ----------
    model : design model: `servo`, `nonlinear`, `linearise` with `at: trajectory`, or a linear one
    n_steps : number of control periods N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    spread : step of the differences in standard deviations of the state; without it, the Jacobian itself
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If the model has no map f(x, u), or R_v is singular.
    """
    return gaussian_filter(model, CentralDifferences(spread), n_steps, x0, P0, use_y0=use_y0)
