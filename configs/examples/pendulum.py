"""Components of pendulum.yaml: an inverted pendulum on a cart, and an observer written for one run.

Plant   A force F [N] moves a cart of mass M along a rail; a uniform rod of mass m and half length l turns about a pivot
        on it.  p is the position of the cart, theta the angle of the rod from the upright position, positive where the
        rod leans towards positive p.  With the moment of inertia m l^2 / 3 of the rod about its centre and the viscous
        friction b of the cart, Lagrange's equations are
            (M + m) p'' + m l cos(theta) theta'' = F - b p' + m l theta'^2 sin(theta),
            m l cos(theta) p'' + (4/3) m l^2 theta'' = m g l sin(theta).
        The energy (M + m) p'^2 / 2 + m l cos(theta) p' theta' + (2/3) m l^2 theta'^2 + m g l cos(theta) changes by
        F p' - b p'^2 per second.  Upright, theta = 0, is an unstable steady state for every position p.
Source  Parameters of the Control Tutorials for MATLAB and Simulink (University of Michigan), "Inverted Pendulum: System
        Modeling": M = 0.5 kg, m = 0.2 kg, b = 0.1 N s/m, l = 0.3 m, moment of inertia 0.006 kg m^2, which is that of a
        uniform rod.
"""

import numpy as np
from scipy.signal import place_poles

from rmpc_bench import single_run
from rmpc_bench.types import Matrix

GRAVITY = 9.81  # m/s^2


def rhs(x, u, p):
    """Return dx/dt of x = (p, v, theta, omega): position [m], velocity [m/s], angle [rad], rate [rad/s]; u = (F,) [N].

    x[0] is one number or one row over many runs, so that NumPy functions compute all runs at once.
    """
    sin, cos = np.sin(x[2]), np.cos(x[2])
    mass, coupling, inertia = p.M + p.m, p.m * p.l * cos, 4 / 3 * p.m * p.l**2
    force = u[0] - p.b * x[1] + p.m * p.l * x[3] ** 2 * sin
    torque = p.m * GRAVITY * p.l * sin
    determinant = mass * inertia - coupling**2
    acceleration = (inertia * force - coupling * torque) / determinant
    angular = (mass * torque - coupling * force) / determinant
    return [x[1], acceleration, x[3], angular]


def output(x, p):
    """Return what is measured: position [m] and angle [rad]."""
    return [x[0], x[2]]


@single_run
class Luenberger:
    """Observer with a constant gain: x_hat = x_pred + L (y - C x_pred - d0), x_pred = A x_hat + B u + f0.

    Its error obeys e(k+1) = (I - L C) A e(k), which has the given poles.  It uses no covariance of any noise.

    Limit: with the stationary gain of the Kalman filter as `L` and its covariance as `initial.P` it is `kalman`.

    Parameters
    ----------
    poles : of the error, one per state, of magnitude below 1; small poles follow the measurements, large ones the model
        (default: from 0.5 to 0.7)
    L : gain, in place of `poles`
    """

    def __init__(self, model, poles: list[float] | None = None, L: Matrix | None = None):
        self.model = model
        self.L = self._placed(poles) if L is None else np.array(L, dtype=float)

    def _placed(self, poles):
        """Return the gain for which (I - L C) A has these eigenvalues."""
        poles = np.linspace(0.5, 0.7, len(self.model.A)) if poles is None else poles
        A, C = self.model.A, self.model.C
        return place_poles(A.T, (C @ A).T, poles).gain_matrix.T

    def start(self, x0):
        """Begin every run at the prediction of x(0)."""
        self.x_pred = x0

    def predict(self, u):
        """Go from k-1 to k with the applied input u(k-1)."""
        self.x_pred = self.model.A @ self.x_hat + self.model.B @ u + self.model.f0

    def correct(self, y):
        """Return x_hat(k) from the measurement y(k)."""
        self.x_hat = self.x_pred + self.L @ (y - self.model.C @ self.x_pred - self.model.d0)
        return self.x_hat
