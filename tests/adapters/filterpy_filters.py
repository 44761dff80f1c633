"""Filters of filterpy for the linear system of one_run.py, each as its own documentation writes it."""

import numpy as np
import pytest

pytest.importorskip("filterpy")

from filterpy.kalman import (
    CubatureKalmanFilter,
    EnsembleKalmanFilter,
    ExtendedKalmanFilter,
    IMMEstimator,
    InformationFilter,
    KalmanFilter,
    MerweScaledSigmaPoints,
    SquareRootKalmanFilter,
    UnscentedKalmanFilter,
    spherical_radial_sigmas,
)

from rmpc_bench.adapters.filterpy import filterpy_estimator


def start(made, model, x0, P0):
    """Set what all filters have."""
    made.x, made.P, made.Q, made.R = x0, P0, model.Q_w, model.R_v
    return made


def linear(kind, model, x0, P0):
    """Return a filter whose model is the matrices F, B, H."""
    made = start(kind(dim_x=len(model.A), dim_z=len(model.C)), model, x0, P0)
    made.F, made.B, made.H = model.A, model.B, model.C
    return made


@filterpy_estimator
def kf(model, x0, P0):
    """Kalman filter, x of shape (n,)."""
    return linear(KalmanFilter, model, x0, P0)


@filterpy_estimator
def kf_column(model, x0, P0):
    """Kalman filter, x of shape (n, 1)."""
    return linear(KalmanFilter, model, x0[:, None], P0)


@filterpy_estimator
def square_root(model, x0, P0):
    """Square-root filter."""
    return linear(SquareRootKalmanFilter, model, x0, P0)


@filterpy_estimator
def information(model, x0, P0):
    """Information filter, which reports no P."""
    made = InformationFilter(dim_x=2, dim_z=1)
    made.x, made.P_inv, made.Q, made.R_inv = x0[:, None], np.linalg.inv(P0), model.Q_w, np.linalg.inv(model.R_v)
    made.F, made.B, made.H = model.A, model.B, model.C
    return made


@filterpy_estimator
def ekf(model, x0, P0):
    """Extended filter with the functions of its update."""
    made = start(ExtendedKalmanFilter(dim_x=len(model.A), dim_z=len(model.C)), model, x0, P0)
    made.F, made.B = model.A, model.B
    return made, {"HJacobian": lambda x: model.C, "Hx": lambda x: model.C @ x}


@filterpy_estimator
def ekf_column(model, x0, P0):
    """The same with x of shape (n, 1)."""
    made = start(ExtendedKalmanFilter(dim_x=len(model.A), dim_z=len(model.C)), model, x0[:, None], P0)
    made.F, made.B = model.A, model.B
    return made, {"HJacobian": lambda x: model.C, "Hx": lambda x: model.C @ x}


def functions(model):
    """Return hx and fx of a linear model."""
    return lambda x: model.C @ x, lambda x, dt, u: model.A @ x + model.B @ u


@filterpy_estimator
def ukf(model, Ts, x0, P0, alpha: float = 0.5):
    """Unscented filter."""
    nx = len(model.A)
    points = MerweScaledSigmaPoints(nx, alpha, 2.0, 3.0 - nx)
    return start(UnscentedKalmanFilter(nx, len(model.C), Ts, *functions(model), points), model, x0, P0)


@filterpy_estimator
def ckf(model, Ts, x0, P0):
    """Cubature filter of filterpy, whose update leaves out the process noise."""
    return start(CubatureKalmanFilter(len(model.A), len(model.C), Ts, *functions(model)), model, x0, P0)


class Redrawn(CubatureKalmanFilter):
    """Cubature filter that draws its points again after each prediction."""

    def predict(self, dt=None, fx_args=()):
        """Predict."""
        super().predict(dt, fx_args)
        self.sigmas_f = spherical_radial_sigmas(self.x, self.P)


@filterpy_estimator
def ckf_redrawn(model, Ts, x0, P0):
    """Cubature filter of the literature."""
    return start(Redrawn(len(model.A), len(model.C), Ts, *functions(model)), model, x0, P0)


@filterpy_estimator
def imm(model, x0, P0):
    """Two equal models: their mixture is the Kalman filter."""
    bank = [linear(KalmanFilter, model, x0, P0) for _ in range(2)]
    return IMMEstimator(bank, [0.3, 0.7], np.array([[0.9, 0.1], [0.2, 0.8]]))


class Driven(EnsembleKalmanFilter):
    """Ensemble filter whose fx takes an input."""

    def predict(self, u):
        """Predict with u."""
        self.u = u
        super().predict()


@filterpy_estimator
def enkf(model, Ts, x0, P0, N: int = 40):
    """Ensemble filter."""
    hx, fx = functions(model)
    made = Driven(x0, P0, len(model.C), Ts, N, hx, lambda x, dt: fx(x, dt, made.u))
    made.Q, made.R = model.Q_w, model.R_v
    return made
