"""Plain twins of predictive control and of LP2, everything stacked and solved at once; models that are not constant."""

import numpy as np
from scipy.optimize import linprog

from rmpc_bench.models.state_dependent import Pair, StateDependentModel
from rmpc_bench.types import Estimate, Model


def dense(A, B, f, C, Q_yw, Q_u, w, x):
    """(u(0), least cost) of (12), filled entry by entry and solved by lstsq; w is (N, ny)."""
    N, (nx, nu) = len(w), B.shape
    power = [np.linalg.matrix_power(A, j) for j in range(N + 1)]
    rows, right = [], []
    for j in range(1, N + 1):
        row = np.zeros((len(C), N * nu))
        for i in range(j):
            row[:, i * nu : (i + 1) * nu] = C @ power[j - 1 - i] @ B
        free = power[j] @ x + sum((power[i] @ f for i in range(j)), np.zeros(nx))
        rows.append(Q_yw @ row)
        right.append(Q_yw @ (w[j - 1] - C @ free))
    stack = np.vstack([*rows, np.kron(np.eye(N), Q_u)])
    b = np.concatenate([*right, np.zeros(N * len(Q_u))])
    U = np.linalg.lstsq(stack, b, rcond=None)[0]
    return U[:nu], np.sum((stack @ U - b) ** 2)


def strictly_upper(n):
    """Places (i, j) of the entries of Pi or Lambda, row by row."""
    return [(i, j) for i in range(n) for j in range(i + 1, n)]


def full_lp2(y, y_hat, x_hat, x_tilde, sign=1.0):
    """(Pi, r, Lambda, rho) of one run by HiGHS: (22)-(27) with all unknowns in one program; arrays (samples, n).

    The sign belongs to the lower half of b_k: with -1 it is as printed.
    """
    ny, nx = y.shape[1], x_hat.shape[1]
    places_x, places_y = strictly_upper(nx), strictly_upper(ny)
    first_y = len(places_x)
    first_rho = first_y + len(places_y)
    rows, right = [], []
    for at in range(len(y)):
        for n, z, rest, places, first, bounds, s in (
            (nx, x_hat[at], x_tilde[at] - x_hat[at], places_x, 0, first_rho, 1.0),
            (ny, y[at], y_hat[at] - y[at], places_y, first_y, first_rho + nx, sign),
        ):
            for i in range(n):
                for side in (1.0, -1.0):
                    row = np.zeros(first_rho + nx + ny)
                    for number, (line, j) in enumerate(places):
                        if line == i:
                            row[first + number] = side * z[j]
                    row[bounds + i] = -1.0
                    rows.append(row)
                    right.append(side * s * rest[i])
    cost = np.concatenate([np.zeros(first_rho), np.ones(nx + ny)])
    limits = [(None, None)] * first_rho + [(0.0, None)] * (nx + ny)
    found = linprog(cost, np.array(rows), np.array(right), bounds=limits, method="highs")
    assert found.status == 0
    Lambda, Pi = np.zeros((nx, nx)), np.zeros((ny, ny))
    for number, place in enumerate(places_x):
        Lambda[place] = found.x[number]
    for number, place in enumerate(places_y):
        Pi[place] = found.x[first_y + number]
    return Pi, found.x[first_rho + nx :], Lambda, found.x[first_rho : first_rho + nx]


class Swing(StateDependentModel):
    """A pendulum with a torque as a state-dependent model; it keeps the states at which it has been asked."""

    nx, nu, ny, largest = 2, 1, 1, 20.0
    C, Q_w, R_v = np.array([[1.0, 0.0]]), np.eye(2), np.eye(1)

    def __init__(self):
        self.asked = []

    def at_state(self, x):
        """Freeze sin(angle) / angle."""
        self.asked.append(x.copy())
        A = np.tile(np.array([[1.0, 0.1], [0.0, 0.95]]), (len(x), 1, 1))
        A[:, 1, 0] = -0.3 * np.sinc(x[:, 0] / np.pi)
        return Pair(A, np.tile(np.array([[0.005], [0.1]]), (len(x), 1, 1)) * (1.0 + 0.1 * x[:, :1, None] ** 2))


class Varying(Model):
    """A linear model with another pair at every k."""

    def __init__(self, models):
        self.models = models

    def at(self, k):
        """The model at k."""
        return self.models[k]


def estimate_of(x_hat):
    """What a controller is told of an estimate."""
    return Estimate(x_hat, None, None, np.zeros(len(x_hat), dtype=np.int8), {})


def commands(controller, x_hat, y, r):
    """Commands of a block over time; estimates and measurements are (runs, samples, n)."""
    state, found = controller.init(len(y)), []
    for k in range(y.shape[1]):
        ahead = r[k : k + controller.preview]
        state, command = controller.control(k, state, y[:, k], estimate_of(x_hat[:, k]), ahead)
        found.append(command)
    return found
