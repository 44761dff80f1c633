"""An estimator and a controller that report something of themselves; as YAML, `reporting` after `registered`."""

from dataclasses import dataclass

import numpy as np

from rmpc_bench import registry
from rmpc_bench.estimators import kalman
from rmpc_bench.types import Command, Controller, Estimator


@dataclass(frozen=True)
class Wrapped(Estimator):
    """A Kalman filter that reports its first coordinate as `r`, and as `fallback` whether it is positive."""

    inner: object
    reports = {"r": (1,), "fallback": ()}

    def init(self, n_runs):
        """Start as the filter does."""
        return self.inner.init(n_runs)

    def correct(self, k, state, y):
        """Correct as the filter does."""
        state, estimate = self.inner.correct(k, state, y)
        first = estimate.x_hat[:, :1]
        return state, estimate._replace(info={"r": first, "fallback": (first[:, 0] > 0).astype(float), "secret": first})

    def predict(self, k, state, u):
        """Predict as the filter does."""
        return self.inner.predict(k, state, u)


@dataclass(frozen=True)
class Law(Controller):
    """u = gain (r - y); it reports a matrix `Q_yw`, made of two coordinates of the estimate."""

    gain: float
    preview = 1
    reports = {"Q_yw": (2, 2)}

    def init(self, n_runs):
        """Nothing to remember."""
        return None

    def control(self, k, state, y, estimate, r):
        """Act on the error."""
        u = self.gain * (r[0] - y)
        return None, Command(u, np.zeros(len(u), dtype=np.int8), {"Q_yw": matrix(estimate.x_hat)})


def matrix(x_hat):
    """What the law reports, from estimates (.., n)."""
    z = x_hat[..., :2]
    return z[..., :, None] * z[..., None, :] + np.array([[0.0, 1.0], [0.0, 0.0]])


def design_estimator(model, n_steps, *, x0, P0):
    """Make the filter."""
    return Wrapped(kalman.design(model, n_steps, x0=x0, P0=P0))


def design_controller(model, *, gain: float = 0.1):
    """Make the law."""
    return Law(gain)


def registered(monkeypatch):
    """Register both under the kind `reporting` for one test."""
    monkeypatch.setitem(registry._REGISTERED["estimators"], "reporting", design_estimator)
    monkeypatch.setitem(registry._REGISTERED["controllers"], "reporting", design_controller)


METHODS = "{R: {estimator: {kind: reporting}, controller: {kind: reporting}}, S: {estimator: {kind: kalman}}}"
BURSTS = "{measurement: {uniform: {radius: 0.01, bursts: [{from: 0.3, to: 0.5, factor: 3}]}}}"
"""Samples 3, 4 and 5 at a sampling time of 0.1 s."""
