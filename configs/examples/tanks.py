"""Components of two-tanks.yaml: plant, noise and controller of two tanks in series.

Plant   A pump with flow u [m^3/s] fills the first tank, whose orifice empties into the second one.  With the cross
        section A of the tanks and the orifices a_i, Torricelli's law v = sqrt(2 g h) gives
            A h1' = u - a1 sqrt(2 g h1),   A h2' = a1 sqrt(2 g h1) - a2 sqrt(2 g h2).
        Steady state for a constant flow: h_i = (u / a_i)^2 / (2 g).  Time constants around it:
        T_i = (A / a_i) sqrt(2 h_i / g).
Source  Cross section and orifices of one path of the quadruple-tank process: K. H. Johansson, IEEE Transactions on
        Control Systems Technology 8(3), 2000, Table I (A = 28 cm^2, a = 0.071 and 0.057 cm^2).  There the second tank
        has 32 cm^2; here both have 28.
"""

from dataclasses import dataclass

import numpy as np

from rmpc_bench import single_run
from rmpc_bench.types import Noise

GRAVITY = 9.81  # m/s^2


def rhs(x, u, p):
    """Return dx/dt of two tanks in series: x = (h1, h2) levels [m], u = (pump,) flow into the first tank [ml/s].

    x[0] is one number or one row over many runs, so that NumPy functions compute all runs at once.
    """
    q1 = p.a1 * np.sqrt(2 * GRAVITY * x[0])  # Torricelli's law [m^3/s]
    q2 = p.a2 * np.sqrt(2 * GRAVITY * x[1])
    return [(1e-6 * u[0] - q1) / p.area, (q1 - q2) / p.area]


def output(x, p):
    """Return what is measured: the level of the second tank [m]."""
    return [x[1]]


def outliers(n, *, std=1.0, probability=0.05, factor=10.0):
    """Gaussian noise with outliers: a sample has `factor` times the standard deviation with a given probability."""
    return Outliers(n, std, probability, factor)


@dataclass(frozen=True)
class Outliers(Noise):
    """The law of `outliers`."""

    n: int
    std: float
    probability: float
    factor: float

    def draw(self, rng, n_samples):
        """Return n_samples values of one run, from its own random generator.

        Two generators, so that the first values do not depend on how many there are.
        """
        sizes, places = rng.spawn(2)
        is_outlier = places.random((n_samples, 1)) < self.probability
        return self.std * np.where(is_outlier, self.factor, 1.0) * sizes.standard_normal((n_samples, self.n))


@single_run
class PI:
    """PI controller of the level of the second tank, with input limits and anti-windup.

    Parameters
    ----------
    K : gain [ml/s per m]
    Ti : integral time [s]
    u0 : input of the operating point [ml/s]
    low, high : limits of the input [ml/s]
    """

    def __init__(self, Ts, K: float = 60.0, Ti: float = 60.0, u0: float = 8.0, low: float = 0.0, high: float = 30.0):
        self.K, self.rate, self.u0, self.low, self.high = K, Ts / Ti, u0, low, high

    def start(self):
        """Called once per run, before its first sample; every run has its own object."""
        self.integral = 0.0

    def control(self, x_hat, r):
        """Return u(k) from the estimate x_hat(k) and the reference r(k)."""
        error = r[0] - x_hat[1]
        wanted = self.u0 + self.K * (error + self.integral)
        u = min(max(wanted, self.low), self.high)
        if u == wanted:  # anti-windup: no integration while the input is at a limit
            self.integral += self.rate * error
        return [u]
