"""Components of two-tanks.yaml: plant, noise, controller and estimator of two tanks in series.

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
from rmpc_bench.types import Count, Noise, Positive

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


@single_run
class MHE:
    """Moving-horizon estimator of a nonlinear model, with a Huber loss and bounds of the states.

    The states x(k-Ne), .., x(k) of the window minimise
        |x(k-Ne) - x_bar|^2_(P^-1) + sum |x(j+1) - f(x(j), u(j))|^2_(Q_w^-1) + 2 sum huber((y(j) - h(x(j))) / s),
    where s are the standard deviations of R_v and huber(r) is r^2 / 2 up to |r| = delta and linear beyond.  x_bar is
    the prediction f(x_hat(k-Ne-1), u(k-Ne-1)), and P its covariance by the Riccati equation along the estimates, as in
    an extended Kalman filter.

    Method: Gauss-Newton from the last solution, with the weights min(1, delta / |r|) of the Huber loss; after each
    iteration the states are projected onto their bounds.  One iteration per sample is usual: a state is improved at
    every sample while it is in the window.

    Limit: a linear model, a large `delta` and no active bound give the Kalman filter, for any Ne and one iteration.

    Parameters
    ----------
    Ne : length of the window [samples]
    delta : residual beyond which the loss is linear [standard deviations]
    iterations : Gauss-Newton iterations per sample
    """

    def __init__(self, model, Ne: Count = 6, delta: Positive = 1.5, iterations: Count = 1):
        self.model, self.Ne, self.delta, self.iterations = model, Ne, delta, iterations
        self.Q_inv = np.linalg.inv(model.Q_w)
        self.noise = np.sqrt(np.diag(model.R_v))

    def start(self, x0, P0):
        """Begin with the prediction of x(0) and its covariance; they move along with the window."""
        self.x_bar, self.P = [x0], P0
        self.x, self.y, self.u = [x0], [], []

    def update(self, y, u_previous):
        """Return x_hat(k) from y(k) and u(k-1)."""
        model = self.model
        if u_previous is not None:
            self.u.append(u_previous)
            self.x.append(model.f(self.x[-1], u_previous))
            self.x_bar.append(self.x[-1])
        self.y.append(y)
        if len(self.y) > self.Ne + 1:
            self._move()
        for _ in range(self.iterations):
            self.x = list(np.clip(np.array(self.x) + self._change(), *model.limits))
        return self.x[-1]

    def _move(self):
        """Drop the oldest sample; the covariance of x_bar follows the Riccati equation."""
        model, P = self.model, self.P
        F, H = model.F(self.x[0], self.u[0]), model.H(self.x[0])
        S = H @ P @ H.T + model.R_v
        P = P - P @ H.T @ np.linalg.solve(S, H @ P)
        self.P = F @ P @ F.T + model.Q_w
        for series in (self.x_bar, self.x, self.y, self.u):
            del series[0]

    def _change(self):
        """Return the Gauss-Newton change of the states of the window, one row per sample."""
        model, m, n, ny = self.model, len(self.y), len(self.P), len(self.noise)
        # Rows of `motion` change x(0) and x(j+1) - f(x(j), u(j)); rows of `output` change h(x(j)) / s.
        motion, output = np.eye(m * n), np.zeros((m * ny, m * n))
        information = np.kron(np.eye(m), self.Q_inv)
        information[:n, :n] = np.linalg.inv(self.P)
        for j in range(m):
            output[j * ny : (j + 1) * ny, j * n : (j + 1) * n] = model.H(self.x[j]) / self.noise[:, None]
        for j in range(m - 1):
            motion[(j + 1) * n : (j + 2) * n, j * n : (j + 1) * n] = -model.F(self.x[j], self.u[j])
        predicted = [model.f(x, u) for x, u in zip(self.x[:-1], self.u, strict=True)]
        missing = np.concatenate([self.x_bar[0], *predicted]) - np.concatenate(self.x)
        residual = np.concatenate([(y - model.h(x)) / self.noise for x, y in zip(self.x, self.y, strict=True)])
        weight = np.minimum(1.0, self.delta / np.maximum(np.abs(residual), 1e-12))
        normal = motion.T @ information @ motion + output.T @ (weight[:, None] * output)
        right = motion.T @ information @ missing + output.T @ (weight * residual)
        return np.linalg.solve(normal, right).reshape(m, n)
