"""The control loop without its nonlinear parts: neither friction nor limits of the input.

Model   x(k+1) = A~ x + B~ u, y = C~ x + v; a filter with given gains, x_hat = x_pred + L e, e = y - C x_pred,
        x_pred(k+1) = F x_pred + B u + K e; the law u(k) = u(k-1) + K_r [r(k+1); ..] - K_x x_hat(k) - K_u u(k-1).
Shown   A filter shows the arrays F, B, C, K, L (axis 0 = k, a constant one has length 1) and its start x0; a controller
        shows K_x, K_u and K_r, or has a method `gain()` whose result does.  A pair that does not is not looked at.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, LinearTruth


@runtime_checkable
class GainSchedule(Protocol):
    """A filter whose gains do not depend on the data."""

    x0: Array
    F: Array
    B: Array
    C: Array
    K: Array
    L: Array


class LinearLaw(NamedTuple):
    """Gains of a linear control law."""

    K_x: Float[Array, "nu nx"]
    K_u: Float[Array, "nu nu"]
    K_r: Float[Array, "nu rows"]


class Gains(NamedTuple):
    """The matrices of filter and law at one k."""

    F: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    K: Float[Array, "nx ny"]
    L: Float[Array, "nx ny"]
    J: Float[Array, "nu ny"]
    """u(k) = a(k) + J y(k), where a(k) depends on the past only."""
    from_x_pred: Float[Array, "nu nx"]
    from_u: Float[Array, "nu nu"]
    """a(k) = from_x_pred x_pred(k) + from_u u(k-1) + what the reference adds."""


class LinearPair(NamedTuple):
    """An estimator-controller pair that can be written with gains."""

    schedule: GainSchedule
    law: LinearLaw

    def at(self, k: int) -> Gains:
        """Gains at k; -1 stands for the last ones."""
        F, B, C, K, L = (
            matrices[k] if len(matrices) > 1 else matrices[0]
            for matrices in (getattr(self.schedule, name) for name in "FBCKL")
        )
        J = -self.law.K_x @ L  # u = .. - K_x x_hat, x_hat = (I - L C) x_pred + L y
        return Gains(F, B, C, K, L, J, -self.law.K_x - J @ C, np.eye(len(J)) - self.law.K_u)


def linear_pair(estimator: Any, controller: Any) -> LinearPair | None:
    """Write a pair with gains; None where it does not show them."""
    source = controller.gain() if callable(getattr(controller, "gain", None)) else controller
    gains = [getattr(source, name, None) for name in LinearLaw._fields]
    if not isinstance(estimator, GainSchedule) or any(gain is None or np.ndim(gain) != 2 for gain in gains):
        return None
    return LinearPair(estimator, LinearLaw(*(np.asarray(gain) for gain in gains)))


def spectral_radius(truth: LinearTruth, pair: LinearPair) -> float:
    """Largest modulus of the poles of the loop with the last gains; it decays in the long run if below 1.

    Parameters
    ----------
    truth : one plant
    pair : what controls it
    """
    g = pair.at(-1)
    from_x = g.J @ truth.C
    loop = np.block(  # on [x, x_pred, u(k-1)]
        [
            [truth.A + truth.B @ from_x, truth.B @ g.from_x_pred, truth.B @ g.from_u],
            [g.B @ from_x + g.K @ truth.C, g.F + g.B @ g.from_x_pred - g.K @ g.C, g.B @ g.from_u],
            [from_x, g.from_x_pred, g.from_u],
        ]
    )
    return float(np.abs(np.linalg.eigvals(loop)).max())
