"""Components of gymnasium.yaml: the pendulum of Gymnasium, measured by cosine and sine of its angle.

Plant   Pendulum-v1: a uniform rod of mass m and length l on a pivot with a torque u [N m] of at most 2.  theta is the
        angle from the upright position and omega its rate; l theta'' = 3/2 g sin(theta) + 3 u / (m l).  Upright is an
        unstable steady state, and 2 N m do not lift the rod at once: it has to swing.
Energy  E = m l^2 omega^2 / 6 + m g l (cos(theta) - 1) / 2 is 0 upright at rest, and E' = u omega.
"""

import numpy as np

from rmpc_bench import single_run
from rmpc_bench.types import Positive


def rhs(x, u, p):
    """Return dx/dt of x = (theta, omega) [rad, rad/s]; u = (torque,) [N m]."""
    return [x[1], 1.5 * p.g / p.l * np.sin(x[0]) + 3.0 * u[0] / (p.m * p.l**2)]


def output(x, p):
    """Return what is measured: cosine and sine of the angle."""
    return [np.cos(x[0]), np.sin(x[0])]


@single_run
class EKF:
    """Extended Kalman filter that starts at the first measured angle."""

    def __init__(self, model):
        self.model = model

    def start(self, P0):
        """Keep the covariance of x(0)."""
        self.P = P0

    def update(self, y, u_previous):
        """Predict with u(k-1), and correct with y(k)."""
        model = self.model
        if u_previous is None:
            self.x_hat = np.array([np.arctan2(y[1], y[0]), 0.0])
            return self.x_hat, self.P
        F = model.F(self.x_hat, u_previous)
        x, P = model.f(self.x_hat, u_previous), F @ self.P @ F.T + model.Q_w
        H = model.H(x)
        L = np.linalg.solve(H @ P @ H.T + model.R_v, H @ P).T
        self.x_hat, P = x + L @ (y - model.h(x)), P - L @ H @ P
        self.P = 0.5 * (P + P.T)
        return self.x_hat, self.P


@single_run
class Differences:
    """Measured angle, and a low pass of its differences as rate.

    Parameters
    ----------
    pole : of the low pass
    """

    def __init__(self, Ts, pole: float = 0.3):
        self.Ts, self.pole = Ts, pole

    def update(self, y, u_previous):
        """Return angle and rate; the angle is continued beyond a full turn."""
        angle = np.arctan2(y[1], y[0])
        if u_previous is None:
            self.x_hat = np.array([angle, 0.0])
        else:
            step = np.arctan2(np.sin(angle - self.x_hat[0]), np.cos(angle - self.x_hat[0]))
            rate = self.pole * self.x_hat[1] + (1.0 - self.pole) * step / self.Ts
            self.x_hat = np.array([self.x_hat[0] + step, rate])
        return self.x_hat


@single_run
class SwingUp:
    """Pumps energy into the rod while it hangs, and holds it by state feedback when it stands.

    Parameters
    ----------
    pump : gain of the energy
    surplus : energy that is aimed at beyond that of the upright rod [J], since mass and length may be smaller
    K_angle, K_rate : gains of the state feedback
    near : largest angle from the upright position for the state feedback [rad]
    m, l, g : mass [kg], length [m] and gravity [m/s^2] that the law assumes
    """

    def __init__(
        self,
        limits,
        pump: Positive = 2.0,
        surplus: float = 0.5,
        K_angle: float = 15.0,
        K_rate: float = 4.0,
        near: float = 0.5,
        m: Positive = 1.0,
        l: Positive = 1.0,  # noqa: E741
        g: Positive = 10.0,
    ):
        self.pump, self.surplus, self.K_angle, self.K_rate, self.near = pump, surplus, K_angle, K_rate, near
        self.limits, self.m, self.l, self.g = limits, m, l, g

    def control(self, x_hat):
        """Return the torque within the limits of the plant."""
        return np.clip([self.torque(np.arctan2(np.sin(x_hat[0]), np.cos(x_hat[0])), x_hat[1])], *self.limits.u)

    def torque(self, theta, omega):
        """Return the torque without limits."""
        if abs(theta) < self.near:
            return -self.K_angle * theta - self.K_rate * omega
        energy = self.m * self.l * (self.l * omega**2 / 6.0 + self.g * (np.cos(theta) - 1.0) / 2.0)
        # Where the rod hangs at rest there is nothing to pump; any torque begins.
        return -self.pump * (energy - self.surplus) * np.sign(omega if omega else 1.0)
