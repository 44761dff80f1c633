"""Servomechanism (DC motor, gear box, elastic shaft, load): parameters, linear model, and model with dry friction.

Model   J_l th_l'' = rho T_s - beta_l th_l' - T_fl,   J_m th_m'' = K_t I - T_s - beta_m th_m' - T_fm,
        L I' = V - R I - K_t th_m',   T_s = (k_theta / rho) (th_m / rho - th_l).
        The shaft is on the load side: shaft_torque = k_theta (th_m / rho - th_l) accelerates the load, and
        motor_torque = T_s, rho times smaller, acts on the motor.
        State x = [th_l, w_l, th_m, w_m] (load and motor angle [rad] and velocity [rad/s]), input V [V], output th_l.
        `servo-linear`  It neglects the dry frictions T_fl, T_fm and the inductance L.
        `servo`  x(k+1) = f(x(k), u(k)) + w(k), f the flow of plants/servo.py over a sample, integrated from event to
                 event; y = th_l + v.  Nonlinear filters estimate [th_l, w_l, th_m, w_m, I].  The current I [A] is no
                 state of the design model: its estimate is in the info `x_all`.  Controllers and linear filters use the
                 linear model with the same parameters.
Source  zenere2018, sections 4.1 and 4.2, (20), (21), Tables 1 and 2 (SI units).
Assumed Noise on all four states with intensity `process` each, as the paper does not state G-bar and D-bar; process
        noise sampled by Van Loan's method; R_v = measurement^2, not divided by Ts.
        `servo`  The variance of the process noise of the current, on which that of the paper does not act, is 1e-6 A^2.
                 I(0) has this variance and the mean 0.
Limit   `servo`  Without friction and with a small L the flow is that of the linear model.
Cost    `servo`  About 2.5 times a sample of the plant per point: sigma points have more friction events than a
                 trajectory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.models.flow import Flow
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import as_matrix, discretise, van_loan
from rmpc_bench.types import Array, DesignError, Matrix, Model, NonNegative, Positive, Status
from rmpc_bench.types.basics import Keyword, takes, values_of

EQUATION = {
    "design": r"""J_l \ddot\theta_l = \rho T_s - \beta_l \dot\theta_l - T_{fl}, \quad J_m \ddot\theta_m = K_t I - T_s -
\beta_m \dot\theta_m - T_{fm}, \quad T_s = \frac{k_\theta}{\rho} \left( \frac{\theta_m}{\rho} - \theta_l \right), \quad
T_{fl} = T_{fm} = 0, \quad R I = V - K_t \dot\theta_m""",
    "design_nonlinear": r"""J_l \ddot\theta_l = \rho T_s - \beta_l \dot\theta_l - T_{fl}, \quad
J_m \ddot\theta_m = K_t I - T_s - \beta_m \dot\theta_m - T_{fm}, \quad
T_s = \frac{k_\theta}{\rho} \left( \frac{\theta_m}{\rho} - \theta_l \right), \quad L \dot I =
V - R I - K_t \dot\theta_m, \quad T_f(\omega) = (\alpha_0 + \alpha_1 e^{-\alpha_2 |\omega|}) \mathrm{sgn}(\omega)""",
}


LINEAR: Mapping[str, Keyword] = {
    "J_m": Keyword(Positive, 0.5, "motor inertia [kg m^2]"),
    "beta_m": Keyword(NonNegative, 0.1, "viscous friction of the motor [N m s]"),
    "R": Keyword(Positive, 20.0, "armature resistance [Ohm]"),
    "K_t": Keyword(Positive, 10.0, "motor constant [N m/A]"),
    "rho": Keyword(Positive, 20.0, "gear ratio"),
    "k_theta": Keyword(Positive, 1280.2, "torsional rigidity [N m/rad]"),
    "J_l": Keyword(Positive, 25.0, "load inertia [kg m^2]"),
    "beta_l": Keyword(NonNegative, 25.0, "viscous friction of the load [N m s]"),
}
"""Parameters of the linear servomechanism."""
TABLE_1 = values_of(LINEAR, {})
"""Their nominal values."""

LOAD_TORQUE, MOTOR_TORQUE = "shaft_torque", "motor_torque"
"""The torque of the elastic shaft on the load and, rho times smaller, on the motor."""

TORQUE_UNITS: Mapping[str, str] = {LOAD_TORQUE: "N m", MOTOR_TORQUE: "N m"}
"""Torques of the shaft -> unit."""

LOAD = "load"
"""Place of a disturbance: a torque on the load [N m], constant over a sample."""

MUST_BE_POSITIVE = ("J_m", "R", "rho", "J_l")
"""Parameters that appear as divisors in the equations of motion."""


@dataclass(frozen=True)
class ServoNoise:
    """Noise intensities of the linear model.

    Parameters
    ----------
    process : factor G-bar of the continuous-time noise on the four states
    measurement : standard deviation of the measured angle [rad]
    """

    process: Matrix
    measurement: NonNegative


def continuous(p: Mapping[str, Any]) -> tuple[Float[Array, "*runs 4 4"], Float[Array, "*runs 4 1"]]:
    """Continuous-time A and B of the linear servomechanism (no inductance, no dry friction).

    The parameters are numbers, or arrays with one number per run.
    """
    stiffness, runs = p["k_theta"] / p["rho"], np.shape(p["rho"])
    A, B = np.zeros((*runs, 4, 4)), np.zeros((*runs, 4, 1))
    A[..., 0, 1] = A[..., 2, 3] = 1.0
    A[..., 1, 0], A[..., 1, 1] = -p["rho"] * stiffness / p["J_l"], -p["beta_l"] / p["J_l"]
    A[..., 1, 2], A[..., 3, 0] = stiffness / p["J_l"], stiffness / p["J_m"]
    # Without inductance the current follows at once, I = (V - K_t w_m) / R: the back e.m.f. acts like friction.
    damping = p["beta_m"] + p["K_t"] * p["K_t"] / p["R"]
    A[..., 3, 2], A[..., 3, 3] = -stiffness / p["rho"] / p["J_m"], -damping / p["J_m"]
    B[..., 3, 0] = p["K_t"] / (p["R"] * p["J_m"])
    return A, B


def torques(p: Mapping[str, float]) -> dict[str, Float[Array, "1 4"]]:
    """Rows of the torque of the shaft, on the load side and on the motor side [N m]."""
    row = np.array([[-p["k_theta"], 0.0, p["k_theta"] / p["rho"], 0.0]])
    return {LOAD_TORQUE: row, MOTOR_TORQUE: row / p["rho"]}


def shaft_torque(
    name: str, k_theta: Float[Array, " runs"], rho: Float[Array, " runs"], x: Float[Array, "runs samples n"]
) -> Float[Array, "runs samples"]:
    """Return a torque of the shaft [N m] with the parameters of every run."""
    k_theta, rho = k_theta[:, None], rho[:, None]
    torque: Array = k_theta * (x[:, :, 2] / rho - x[:, :, 0])
    return torque if name == LOAD_TORQUE else torque / rho


@takes(LINEAR)
def design(Ts: float, *, noise: ServoNoise, **parameters: float) -> LinearModel:
    """Linear servomechanism with the parameters of Table 1, sampled with a zero-order hold of the voltage.

    Parameters
    ----------
    Ts : sampling time [s]
    noise : `process` acts on the four states, `measurement` on the load angle
    parameters : those of the linear servomechanism
    """
    p = values_of(LINEAR, parameters)
    A_bar, B_bar = continuous(p)
    G_bar = as_matrix(noise.process, 4)
    A, B = discretise(A_bar, B_bar, Ts)
    on_load = discretise(A_bar, np.array([[0.0], [1.0 / p["J_l"]], [0.0], [0.0]]), Ts)[1]
    C = np.array([[1.0, 0.0, 0.0, 0.0]])
    return LinearModel(
        A,
        B,
        C,
        van_loan(A_bar, G_bar @ G_bar.T, Ts),
        np.array([[noise.measurement**2]]),
        extra_signals=torques(p),
        disturbance_inputs={LOAD: on_load},
    )


# With inductance L > 0 and dry friction, as in plants/servo.py, the state is [th_l, w_l, th_m, w_m, I].
# The equations of motion are written as the compiled kernel takes them.

MOST_RATE = 20_000.0
"""Largest |eigenvalue| Ts of the linear part: about 5000 Taylor series, 10 ms per run and sample."""
NONLINEAR: Mapping[str, Keyword] = {
    "L": Keyword(Positive, 0.8, "armature inductance [H]"),
    **LINEAR,
    "alpha_l0": Keyword(NonNegative, 0.5, "Coulomb friction of the load [N m]"),
    "alpha_l1": Keyword(NonNegative, 10.0, "additional friction of the load near standstill [N m]"),
    "alpha_l2": Keyword(NonNegative, 0.5, "decay rate of alpha_l1 with the velocity [s/rad]"),
    "alpha_m0": Keyword(NonNegative, 0.1, "Coulomb friction of the motor [N m]"),
    "alpha_m1": Keyword(NonNegative, 2.0, "additional friction of the motor near standstill [N m]"),
    "alpha_m2": Keyword(NonNegative, 0.5, "decay rate of alpha_m1 with the velocity [s/rad]"),
}
"""Parameters of the servomechanism with inductance and dry friction."""


def nonlinear_parameters(given: Mapping[str, float], Ts: float) -> dict[str, float]:
    """Return all parameters; a DesignError where a mode of the linear part is too fast for the kernel."""
    p = values_of(NONLINEAR, given)
    if not slow_enough([p], Ts)[0]:
        raise DesignError(f"|eigenvalue| Ts of the linear part exceeds {MOST_RATE:,.0f}: increase L or an inertia", "L")
    return p


def coefficients(p: Mapping[str, Any]) -> Float[Array, "*runs 3 9"]:
    """Coefficients of the equations of motion as the kernel takes them, torques divided by inertias.

    The parameters are numbers, or arrays with one number per run.

    First row: twist th_m / rho - th_l, load (twist, w_l), motor (twist, w_m, I), current (I, w_m, V).  Other rows:
    alpha_0 to alpha_2 of the friction of load and motor.
    """
    load, motor, current = p["J_l"], p["J_m"], p["L"]
    linear = [1.0 / p["rho"], p["k_theta"] / load, p["beta_l"] / load]
    linear += [p["k_theta"] / p["rho"] / motor, p["beta_m"] / motor, p["K_t"] / motor]
    linear += [p["R"] / current, p["K_t"] / current, 1.0 / current]
    found = np.zeros((*np.shape(load), 3, 9))
    found[..., 0, :] = np.stack(linear, axis=-1)
    for row, (b, J) in enumerate((("l", load), ("m", motor)), 1):
        found[..., row, :3] = np.stack([p[f"alpha_{b}0"] / J, p[f"alpha_{b}1"] / J, p[f"alpha_{b}2"]], axis=-1)
    return found


def with_current(p: Mapping[str, float]) -> tuple[Float[Array, "5 5"], Float[Array, "5 3"]]:
    """Continuous-time matrices of the linear part with inductance; inputs [V, T_fl, T_fm]."""
    A, B = np.zeros((5, 5)), np.zeros((5, 3))
    A[:4, :4] = continuous(p)[0]
    A[3, 3] = -p["beta_m"] / p["J_m"]
    A[3, 4] = p["K_t"] / p["J_m"]
    A[4, 3], A[4, 4] = -p["K_t"] / p["L"], -p["R"] / p["L"]
    B[4, 0], B[1, 1], B[3, 2] = 1.0 / p["L"], -1.0 / p["J_l"], -1.0 / p["J_m"]
    return A, B


def surely_slow_enough(linear: Float[Array, "runs 9"], Ts: float) -> Bool[Array, " runs"]:
    """Whether a bound of the fastest mode, the largest sum of a row of the matrix, is half the limit or less."""
    l_0, l_1, l_2, m_3, m_4, m_5, i_6, i_7, _ = linear.T
    sums = [np.ones_like(l_0), l_1 * (1.0 + l_0) + l_2, m_3 * (1.0 + l_0) + m_4 + m_5, i_6 + i_7]
    # False for NaN.
    return np.asarray(np.max(sums, axis=0) * Ts <= 0.5 * MOST_RATE)


def slow_enough(rows: Sequence[Mapping[str, float]], Ts: float) -> Bool[Array, " runs"]:
    """Whether the fastest mode of the linear part of each run is within the range of the kernel."""
    if not rows:
        return np.ones(0, dtype=bool)
    A = np.stack([with_current(p)[0] for p in rows])
    finite = np.isfinite(A).all(axis=(1, 2))
    rates = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], A, 0.0))).max(axis=1)
    return np.asarray(finite & (rates * Ts <= MOST_RATE))


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
def design_nonlinear(Ts: float, *, noise: ServoNoise, **parameters: float) -> ServoModel:
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
    linear = design(Ts, noise=noise, **{name: p[name] for name in LINEAR})
    flow = ServoFlow(Ts, coefficients(p), with_current_variance(linear.Q_w), linear.R_v)
    return ServoModel(linear, flow)
