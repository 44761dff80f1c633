"""Filters of filterpy for filterpy.yaml: Kalman, extended, unscented and cubature filters of two tanks in series.

Each function returns a new filter, and `filterpy_estimator` makes an estimator of it.  The input reaches `predict`, and
the third argument of `fx`.  The functions f, h and their Jacobians F, H are those of the design model.
"""

from filterpy.kalman import (
    CubatureKalmanFilter,
    ExtendedKalmanFilter,
    KalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
    spherical_radial_sigmas,
)

from rmpc_bench.adapters.filterpy import filterpy_estimator
from rmpc_bench.types import Positive


@filterpy_estimator(deviation=True)
def kf(model, x0, P0):
    """Kalman filter around the operating point: F x + B u has no constant part, so that it works in deviations."""
    made = KalmanFilter(dim_x=model.nx, dim_z=model.ny)
    made.x, made.P, made.Q, made.R = x0, P0, model.Q_w, model.R_v
    made.F, made.B, made.H = model.A, model.B, model.C
    return made


class Extended(ExtendedKalmanFilter):
    """Extended filter that predicts with f(x, u); that of filterpy predicts with F x + B u."""

    model = None

    def predict_x(self, u=0):
        """Set the Jacobian, then move the state."""
        self.F = self.model.F(self.x, u)
        self.x = self.model.f(self.x, u)


@filterpy_estimator
def ekf(model, x0, P0):
    """Extended Kalman filter; `update` needs the Jacobian and the function of the output."""
    made = Extended(dim_x=model.nx, dim_z=model.ny)
    made.x, made.P, made.Q, made.R = x0, P0, model.Q_w, model.R_v
    made.model = model
    return made, {"HJacobian": model.H, "Hx": model.h}


@filterpy_estimator
def ukf(model, Ts, x0, P0, alpha: Positive = 1.0):
    """Unscented Kalman filter.

    Parameters
    ----------
    alpha : spread of the sigma points
    """
    points = MerweScaledSigmaPoints(model.nx, alpha=alpha, beta=2.0, kappa=3.0 - model.nx)
    made = UnscentedKalmanFilter(model.nx, model.ny, Ts, model.h, lambda x, dt, u: model.f(x, u), points)
    made.x, made.P, made.Q, made.R = x0, P0, model.Q_w, model.R_v
    return made


class Cubature(CubatureKalmanFilter):
    """Cubature filter that computes its points again after each prediction.

    The points of filterpy are those that `fx` has moved: their spread has no process noise.  Arasaratnam and Haykin,
    "Cubature Kalman filters", IEEE Transactions on Automatic Control 54(6), 2009, compute them from the prediction.
    """

    def predict(self, dt=None, fx_args=()):
        """Predict, then compute the points."""
        super().predict(dt, fx_args)
        self.sigmas_f = spherical_radial_sigmas(self.x, self.P)


@filterpy_estimator
def ckf(model, Ts, x0, P0):
    """Cubature Kalman filter."""
    made = Cubature(model.nx, model.ny, Ts, model.h, lambda x, dt, u: model.f(x, u))
    made.x, made.P, made.Q, made.R = x0, P0, model.Q_w, model.R_v
    return made
