"""Estimators, controllers and plants with one fault each, as a user's file would contain them."""

import os
import random
import sys
from typing import NamedTuple

import numpy as np

from rmpc_bench import SolverError, single_run
from rmpc_bench.simulation.closed_loop import Loop
from rmpc_bench.types import Command, Controller, Estimate, Estimator, Motion, Plant

SEEN = {}
"""Measurements of earlier runs, which a component must not keep."""
SHARED = {}


@single_run
class Textbook:
    """The Kalman filter as in a textbook."""

    def __init__(self, model):
        self.model, self.k = model, -1

    def start(self, x0, P0):
        self.x, self.P = x0, P0

    def update(self, y, u_previous):
        A, B, C = self.model.A, self.model.B, self.model.C
        self.k += 1
        if u_previous is not None:
            self.x, self.P = A @ self.x + B @ self.used(u_previous), A @ self.P @ A.T + self.model.Q_w
        S = C @ self.P @ C.T + self.model.R_v
        L = self.P @ C.T @ np.linalg.inv(S)
        self.x, self.P = self.x + L @ (y - C @ self.x), self.P - L @ S @ L.T
        self.P = 0.5 * (self.P + self.P.T)
        return self.answer(self.x, self.P, y)

    def used(self, u):
        return u

    def answer(self, x, P, y):
        return x, P


@single_run
class Raising(Textbook):
    def answer(self, x, P, y):
        if self.k == 31:
            raise ValueError("negative level")
        return x


@single_run
class Unsolved(Textbook):
    def answer(self, x, P, y):
        if self.k == 31:
            raise SolverError("maximum number of iterations reached")
        return x


@single_run
class NotANumber(Textbook):
    def answer(self, x, P, y):
        return x * (np.nan if self.k == 31 else 1.0)


@single_run
class Infinite(Textbook):
    def answer(self, x, P, y):
        return x * (np.inf if self.k == 31 else 1.0)


@single_run
class WrongShape(Textbook):
    def answer(self, x, P, y):
        return np.append(x, 0.0)


@single_run
class WrongType(Textbook):
    def answer(self, x, P, y):
        return [str(number) for number in x]


@single_run
class InPlace(Textbook):
    """Overwrites the arrays that it gets, and returns one buffer all the time; both are harmless for one run."""

    def start(self, x0, P0):
        super().start(x0, P0)
        self.buffer = np.zeros_like(x0)

    def answer(self, x, P, y):
        y *= 0.0
        self.buffer[:] = x
        return self.buffer, P


@single_run
class GlobalNumpy(Textbook):
    def answer(self, x, P, y):
        return x + 0.01 * np.random.standard_normal(len(x))  # noqa: NPY002


@single_run
class GlobalPython(Textbook):
    def answer(self, x, P, y):
        return x + 0.01 * random.random()


@single_run
class Unseeded(Textbook):
    def answer(self, x, P, y):
        return x + 0.01 * np.random.default_rng().standard_normal(len(x))


@single_run
class Leaking(Textbook):
    """Starts where the last run ended."""

    def start(self, x0, P0):
        super().start(SHARED.get("x", x0), P0)

    def answer(self, x, P, y):
        SHARED["x"] = x
        return x


@single_run
class Foreseeing(Textbook):
    """Keeps the measurements of a run, and uses them as the future when the run comes again."""

    def start(self, x0, P0, run):
        super().start(x0, P0)
        self.run = run

    def answer(self, x, P, y):
        SEEN[self.run, self.k] = y
        return x + 0.1 * SEEN.get((self.run, self.k + 1), 0.0)


def calling_loop():
    """The loop of the simulation from which the component is called; None in a process without a plant."""
    frame = sys._getframe()
    while frame is not None and not isinstance(frame.f_locals.get("self"), Loop):
        frame = frame.f_back
    return frame and frame.f_locals["self"]


@single_run
class Peeking(Textbook):
    """Reads the true state of its run from the simulation."""

    def start(self, x0, P0, run):
        super().start(x0, P0)
        self.run = run

    def answer(self, x, P, y):
        loop = calling_loop()
        return x if loop is None else loop.x[self.run].copy()


@single_run
class Late(Textbook):
    def answer(self, x, P, y):
        last, self.last = getattr(self, "last", x), x
        return last


@single_run
class Early(Textbook):
    def answer(self, x, P, y):
        return self.model.A @ x


@single_run
class LateInput(Textbook):
    def used(self, u):
        last, self.last = getattr(self, "last", 0.0 * u), u
        return last


@single_run
class NoInput(Textbook):
    def used(self, u):
        return 0.0 * u


@single_run
class Endless(Textbook):
    def answer(self, x, P, y):
        while self.k == 31:
            pass
        return x


@single_run
class Exiting(Textbook):
    def answer(self, x, P, y):
        if self.k == 31:
            os._exit(3)
        return x


@single_run
class Hashing(Textbook):
    def answer(self, x, P, y):
        return x + 1e-9 * (hash("x_hat") % 1000)


@single_run
class Loss(Textbook):
    """Saturates its correction, and says so."""

    expected_failures = {"consistent": "the loss is not quadratic"}

    def answer(self, x, P, y):
        return x, 0.1 * P


@single_run
class Boasting(Textbook):
    expected_failures = {"exact": "it is said to be inexact"}


@single_run
class Confused(Textbook):
    expected_failures = {"exactly": "no check has this name"}


class State(NamedTuple):
    x: np.ndarray


class Batch(Estimator):
    """x_hat = x_pred + 0.4 (y - C x_pred) in the first state."""

    def __init__(self, model, x0):
        self.model, self.x0 = model, x0
        self.buffer = np.zeros((40, 2))

    def init(self, n_runs):
        return State(np.tile(self.x0, (n_runs, 1)))

    def correct(self, k, state, y):
        x_hat = state.x + 0.4 * (y - state.x[:, :1])
        return State(x_hat), self.estimate(x_hat, y)

    def estimate(self, x_hat, y):
        return Estimate(x_hat)

    def predict(self, k, state, u):
        A, B = self.model.A, self.model.B
        return State(np.einsum("ij,rj->ri", A, state.x) + np.einsum("ij,rj->ri", B, u))


class SinglePrecision(Batch):
    def estimate(self, x_hat, y):
        return Estimate(x_hat.astype(np.float32))


class Reusing(Batch):
    def estimate(self, x_hat, y):
        rows = self.buffer[: len(x_hat)]
        rows[:] = x_hat
        return Estimate(rows)


class Overwriting(Batch):
    def correct(self, k, state, y):
        y -= state.x[:, :1]
        x_hat = state.x + 0.4 * y
        return State(x_hat), Estimate(x_hat)


@single_run
class Follower:
    """A proportional law with a preview of two samples."""

    preview = 2

    def __init__(self, K: float = 0.5):
        self.K = K

    def start(self, run):
        self.run = run

    def control(self, k, y, r):
        return self.answer(k, self.K * (r[1] - y), r)

    def answer(self, k, u, r):
        return u


@single_run
class PeekingLaw(Follower):
    def answer(self, k, u, r):
        loop = calling_loop()
        return u if loop is None else -loop.x[self.run][:1]


@single_run
class ForeseeingLaw(Follower):
    """Keeps the reference of a run, and looks beyond its preview when the run comes again."""

    def answer(self, k, u, r):
        SEEN["r", self.run, k] = r[1]
        return u + SEEN.get(("r", self.run, k + 2), 0.0)


class Walk(Plant):
    """x(k+1) = 0.9 x + u + w, y = x + v."""

    nx, nu, ny = 1, 1, 1
    nominal = {"a": 0.9}

    def __init__(self, Ts):
        self.Ts = Ts
        self.calls = []

    def draw(self, parameters, rngs, n_steps):
        return State(parameters["a"])

    def step(self, k, delta, x, u, w):
        return Motion(delta.x[:, None] * x + u + w)

    def output(self, k, delta, x, v):
        return x + v


class StickyWalk(Walk):
    """Adds how often it has moved."""

    def step(self, k, delta, x, u, w):
        self.calls.append(k)
        return Motion(delta.x[:, None] * x + u + w + 1e-3 * len(self.calls))


class Tank:
    level = 0.0


class SharedObjects(Walk):
    """Keeps an object per run in what `draw` returns, as a simulator with memory would; drawn again per method."""

    def draw(self, parameters, rngs, n_steps):
        return [Tank() for _ in rngs]

    def step(self, k, delta, x, u, w):
        for tank, push in zip(delta, u[:, 0], strict=True):
            tank.level = 0.9 * tank.level + push
        return Motion(np.array([[tank.level] for tank in delta]))


class BatchLaw(Controller):
    def init(self, n_runs):
        return None

    def control(self, k, state, y, estimate, r):
        return None, Command(-0.1 * y)
