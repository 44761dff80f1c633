"""Design model of the servomechanism with inductance and dry friction: the plant `servo` at nominal parameters.

Model   x(k+1) = f(x(k), u(k)) + w(k), f the flow of plants/servo.py over a sample, integrated from event to event;
        y = th_l + v.  Nonlinear filters estimate [th_l, w_l, th_m, w_m, I].  The current I [A] is no state of the
        design model: its estimate is in the info `x_all`.  Controllers and linear filters use the linear model of
        models/servo.py with the same parameters.
Source  zenere2018, section 4.1, (20), (21), Tables 1 and 2.
Assumed Covariance of the process noise: that of the linear model for its four states, and 1e-6 A^2 for the current, on
        which the process noise of the paper does not act.  I(0) has this variance and the mean 0.
Limit   Without friction and with a small L the flow is that of the linear model.
Cost    About 2.5 times a sample of the plant per point: sigma points have more friction events than a trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from rmpc_bench.models import servo
from rmpc_bench.models.flow import Flow
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.servo import LINEAR, NONLINEAR, ServoNoise, coefficients, nonlinear_parameters
from rmpc_bench.types import Array, Model, Status
from rmpc_bench.types.basics import takes

EQUATION = r"""J_l \ddot\theta_l = \rho T_s - \beta_l \dot\theta_l - T_{fl}, \quad
J_m \ddot\theta_m = K_t I - T_s - \beta_m \dot\theta_m - T_{fm}, \quad
T_s = \frac{k_\theta}{\rho} \left( \frac{\theta_m}{\rho} - \theta_l \right), \quad L \dot I =
V - R I - K_t \dot\theta_m, \quad T_f(\omega) = (\alpha_0 + \alpha_1 e^{-\alpha_2 |\omega|}) \mathrm{sgn}(\omega)"""
CURRENT_VARIANCE = 1e-6
"""Variance of the current, at the start and added per sample [A^2]."""


@dataclass(frozen=True, eq=False)
class ServoFlow(Flow):
    """The flow of the servomechanism."""

    Ts: float  # sampling time [s]
    coefficients: Float[Array, "3 9"]  # of the equations of motion, see `servo.coefficients`
    Q_w: Float[Array, "5 5"]  # Q_w, R_v: covariances of the noises
    R_v: Float[Array, "1 1"]
    cost_per_point: float = field(default=3e-6, init=False)

    def advance(self, k: int, x: Float[Array, "points 5"], u: Float[Array, "points 1"]) -> Float[Array, "points 5"]:
        """Advance one sample with constant voltage; NaN where friction events are too many."""
        from rmpc_bench.models.servo_compiled import compiled_servo, servo_flow

        moved, status = servo_flow(compiled_servo(self.coefficients[None], self.Ts), x, u)
        moved[status != Status.OK] = np.nan
        return moved

    def measure(self, k: int, x: Float[Array, "points 5"], *u: Array) -> Float[Array, "points 1"]:
        """Return the load angle."""
        return x[:, :1]

    def C_at(self, k: int) -> Float[Array, "1 5"]:
        """Output matrix."""
        return np.eye(1, 5)

    def start(self, x0: Float[Array, " 4"], P0: Float[Array, "4 4"]) -> tuple[Float[Array, " 5"], Float[Array, "5 5"]]:
        """Return mean and covariance at k = 0, with a current of 0."""
        return np.pad(x0, (0, 1)), with_current_variance(P0)

    def warm_up(self) -> None:
        """Compile the kernel."""
        self.advance(0, np.zeros((1, 5)), np.zeros((1, 1)))


def with_current_variance(P: Float[Array, "4 4"]) -> Float[Array, "5 5"]:
    """Return a covariance with the variance of the current as its last entry."""
    padded = np.pad(P, (0, 1))
    padded[4, 4] = CURRENT_VARIANCE
    return padded


@dataclass(frozen=True, eq=False)
class ServoModel(Model):
    """The servomechanism as a design model: linear for controllers, nonlinear for filters that use `flow`."""

    linear: LinearModel  # model of the four states without inductance and dry friction
    flow: ServoFlow  # flow of the five states

    extra_signals = property(lambda self: self.linear.extra_signals)
    disturbance_inputs = property(lambda self: self.linear.disturbance_inputs)

    def at(self, k: int) -> LinearModel:
        """Return the linear model."""
        return self.linear

    def facts(self) -> list[tuple[str, str]]:
        """What uses which part of the model."""
        return [
            ("f(x, u)", "with dry friction and inductance, for extended-kalman and unscented-kalman"),
            ("linear model", "servo-linear, for controllers and all other estimators"),
        ]

    def warm_up(self) -> None:
        """Compile the kernel."""
        self.flow.warm_up()


@takes(NONLINEAR)
def design(Ts: float, *, noise: ServoNoise, **parameters: float) -> ServoModel:
    """Nonlinear servomechanism as a design model: nonlinear filters use its flow, controllers its linear part.

    Parameters
    ----------
    Ts : sampling time [s]
    noise : `process` acts on the four states, `measurement` on the load angle
    parameters : those of the servomechanism

    Raises
    ------
    DesignError
        If a mode of the linear part is too fast for the kernel: the inductance or an inertia is too small.
    """
    p = nonlinear_parameters(parameters, Ts)
    linear = servo.design(Ts, noise=noise, **{name: p[name] for name in LINEAR})
    flow = ServoFlow(Ts, coefficients(p), with_current_variance(linear.Q_w), linear.R_v)
    return ServoModel(linear, flow)
