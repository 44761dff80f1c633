"""Planar parallel robot with four driven arms and one platform: parameters, geometry and state-dependent model.

Model   y = (x_c, y_c, psi), v = y'.  Arm i turns about the fixed point A_i, corner of a square, driven by the torque
        tau_i.  A passive slide on the arm carries the corner B_i of the platform: angle theta_i, length l_i,
        theta_i' = J_i(y) v, l_i' = S_i(y) v.  The robot is horizontal,
            M(y) v' + N(y, v) v = J' tau,
            M = diag(m_p, m_p, I_p) + sum of I_arm J_i' J_i + m_s W_i' W_i,   B_i' = W_i v,
            N = sum of I_arm J_i' dJ_i/dt + m_s W_i' dW_i/dt + d_rot J_i' J_i + d_sl S_i' S_i.
        State x = [y, v], input tau, output y.  x' = A(x) x + B(x) tau is exact, with A = [[0, I], [0, -M^-1 N]] and
        B = [0; M^-1 J'].  Both are frozen at a state and sampled with a zero-order hold.  Torques in the null space of
        J' do not move the platform.
Source  belda2017, section VI, (29), (30): the robot 'Moving Slide'.
Assumed All parameter values, as the paper prints none; the factorisation N(y, v) v, for which dM/dt - 2 N is
        skew-symmetric without damping; process noise that is a white acceleration, held over a sample.
Limit   At rest and without damping N = 0: every coordinate is a double integrator, driven by M^-1 J' tau.
Cost    0.5 us per run for a pair of matrices.
Fails   Does not fail.  The matrices at an invalid state (an arm of length zero, or NaN) are NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.state_dependent import Pair, StateDependentModel
from rmpc_bench.numerics.linalg import as_compiled, as_vector
from rmpc_bench.numerics.sample_times import Burst, Span, factor_at, spans_of
from rmpc_bench.types import Array, DesignError, NonNegative, Positive
from rmpc_bench.types.basics import Keyword, takes, values_of

EQUATION = r"\ddot y = -M(y)^{-1} N(y, \dot y) \dot y + M(y)^{-1} J(y)^\top \tau"


PARAMETERS: Mapping[str, Keyword] = {
    "mass": Keyword(Positive, 1.0, "factor on all masses and inertias"),
    "a": Keyword(Positive, 0.30, "half side of the square of the base joints [m]"),
    "b": Keyword(Positive, 0.08, "half side of the platform [m]"),
    "m_p": Keyword(Positive, 2.60, "mass of the platform [kg]"),
    "I_p": Keyword(Positive, 0.040, "inertia of the platform [kg m^2]"),
    "m_s": Keyword(Positive, 0.30, "mass of a slide [kg]"),
    "I_arm": Keyword(Positive, 0.030, "inertia of an arm about its base joint [kg m^2]"),
    "d_rot": Keyword(NonNegative, 0.020, "viscous damping of a base joint [N m s]"),
    "d_sl": Keyword(NonNegative, 0.50, "viscous damping of a slide [N s/m]"),
}
NUMBERS = {name: each.default for name, each in PARAMETERS.items() if name != "mass"}
"""Nominal parameters in the order of the kernel."""

MASSES = ("m_p", "I_p", "m_s", "I_arm")
"""Parameters that the factor `mass` multiplies."""

CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
"""Signs of the corners of both squares, one row per arm."""

LARGEST = 20.0
"""Largest entry of a valid estimate [m, rad, m/s, rad/s]; the platform moves by decimetres."""


@dataclass(frozen=True)
class SlideNoise:
    """Noise of the design model.

    Parameters
    ----------
    process : standard deviation of the white acceleration [m/s^2, m/s^2, rad/s^2]; one number or three
    measurement : half-width r of the uniform noise of an output [m, m, rad]; one number or three; variance r^2/3
    bursts : time intervals {from: 3.4, to: 4.0, factor: 2} (seconds, ends included) in which the half-widths are
        multiplied by `factor`; overlapping ones multiply
    """

    process: float | list[float] = 0.05
    measurement: float | list[float] = 5e-4
    bursts: list[Burst] | None = None


NOISE = SlideNoise()


class Arms(NamedTuple):
    """Geometry of the arms at given poses."""

    joints: Float[Array, "poses 4 2"]  # corners B_i of the platform [m]
    lengths: Float[Array, "poses 4"]
    J: Float[Array, "poses 4 3"]  # Jacobian: angular velocities of the arms per velocity of the platform


def arms(y: Float[Array, "poses 3"], a: float, b: float) -> Arms:
    """Compute the geometry of the arms for poses [m, m, rad]; J of an arm of length zero is not finite.

    `a` and `b` are the half sides of the squares of the base joints and of the platform [m].
    """
    cos, sin = np.cos(y[:, 2, None]), np.sin(y[:, 2, None])
    p = b * np.stack([CORNERS[:, 0] * cos - CORNERS[:, 1] * sin, CORNERS[:, 0] * sin + CORNERS[:, 1] * cos], axis=2)
    joints = y[:, None, :2] + p
    d = joints - a * CORNERS
    lengths = np.sqrt((d * d).sum(axis=2))
    with np.errstate(divide="ignore", invalid="ignore"):
        J = np.stack([-d[..., 1], d[..., 0], (d * p).sum(axis=2)], axis=2) / (lengths * lengths)[..., None]
    return Arms(joints, lengths, J)


@dataclass(frozen=True, eq=False)
class MovingSlideModel(StateDependentModel):
    """State-dependent model of the robot; create it with `design`."""

    Ts: float  # sampling time [s]
    numbers: Float[Array, " 8"]  # parameters in the order of `NUMBERS`, masses multiplied by `mass`
    Q_w: Float[Array, "6 6"]  # Q_w, R_v: covariances of the noises
    R_v: Float[Array, "3 3"]
    euler: bool = False  # whether the matrices are sampled by Euler's method
    bursts: tuple[Span, ...] = ()  # samples at which the measurement noise is larger than R_v

    nx, nu, ny, largest = 6, 4, 3, LARGEST
    C = property(lambda self: np.eye(3, 6))
    R_v_varies = property(lambda self: bool(self.bursts))

    def R_v_at(self, k: int, /) -> Float[Array, "3 3"]:
        """Covariance of the measurement noise at k: R_v times the squared factor of the bursts."""
        return factor_at(self.bursts, k) ** 2 * self.R_v if self.bursts else self.R_v

    def at_state(self, x: Float[Array, "runs 6"]) -> Pair:
        """Sample the model with the matrices frozen at the state of every run."""
        from rmpc_bench.models.moving_slide_kernel import pair_kernel

        return Pair(*pair_kernel(as_compiled(x), self.numbers, self.Ts, self.euler))

    def warm_up(self) -> None:
        """Compile the kernel (or load it from the cache)."""
        self.at_state(np.zeros((1, 6)))


def kernel_numbers(p: Mapping[str, float]) -> Float[Array, " 8"]:
    """Return the parameters in the order of the kernel, masses multiplied by `mass`."""
    return np.array([p[name] * (p["mass"] if name in MASSES else 1.0) for name in NUMBERS])


def _noise(noise: SlideNoise, Ts: float) -> tuple[Float[Array, "6 6"], Float[Array, "3 3"]]:
    sizes = []
    for name in ("process", "measurement"):
        size = as_vector(getattr(noise, name), 3, f"noise.{name}")
        if not (np.isfinite(size) & (size >= 0.0)).all():
            raise DesignError("must be >= 0: it is a standard deviation or a half-width", f"noise.{name}")
        sizes.append(size)
    process, measurement = sizes
    G = np.vstack([0.5 * Ts * Ts * np.diag(process), Ts * np.diag(process)])
    return G @ G.T, np.diag(measurement**2 / 3.0)


def _spans(noise: SlideNoise, Ts: float) -> tuple[Span, ...]:
    try:
        return spans_of(noise.bursts or (), Ts)
    except DesignError as error:
        raise DesignError(str(error), f"noise.{error.parameter}") from None


@takes(PARAMETERS)
def design(
    Ts: float, *, noise: SlideNoise = NOISE, discretisation: Literal["zoh", "euler"] = "zoh", **parameters: float
) -> MovingSlideModel:
    """Parallel robot with matrices frozen at the estimate of every run.

    Parameters
    ----------
    Ts : sampling time [s]
    noise : `process` acts on the acceleration, `measurement` on the pose; `bursts` are times of larger measurement
        noise
    discretisation : `zoh` samples the frozen matrices exactly; `euler` uses I + Ts A and Ts B
    parameters : those of the robot

    Raises
    ------
    DesignError
        If the noise is negative, its size does not match the pose, or a burst contains no sample.
    """
    numbers = kernel_numbers(values_of(PARAMETERS, parameters))
    return MovingSlideModel(Ts, numbers, *_noise(noise, Ts), discretisation == "euler", _spans(noise, Ts))
