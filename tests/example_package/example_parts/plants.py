"""A plant for many runs at once: axis 0 of every array is the run."""

import numpy as np

from rmpc_bench.types import Motion, Plant, Positive, Status


class DoubleIntegrator(Plant):
    """Mass that is moved by a force; its position is measured.

    Parameters
    ----------
    Ts : sampling time [s]
    mass : nominal mass [kg]
    """

    nx, nu, ny = 2, 1, 1
    y_unit, u_unit = "m", "N"

    def __init__(self, Ts, mass: Positive = 1.0):
        self.Ts, self.mass = Ts, mass

    @property
    def nominal(self):
        """Parameters that `perturb` may name."""
        return {"mass": self.mass}

    def draw(self, parameters, rngs, n_steps):
        """Return the masses of the runs."""
        return parameters["mass"]

    def step(self, k, delta, x, u, w):
        """Move to x(k+1): the force is constant over a sample."""
        acceleration = u[:, 0] / delta
        position = x[:, 0] + self.Ts * x[:, 1] + 0.5 * self.Ts**2 * acceleration
        speed = x[:, 1] + self.Ts * acceleration
        return Motion(np.stack([position, speed], axis=1) + w, np.full(len(x), Status.OK, dtype=np.int8))

    def output(self, k, delta, x, v):
        """Measure the position."""
        return x[:, :1] + v
