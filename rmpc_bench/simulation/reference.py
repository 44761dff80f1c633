"""References: the signals that the output has to follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_vector
from rmpc_bench.numerics.s_shape import ANGLE, DURATION, HEIGHT, WIDTH, s_curve
from rmpc_bench.types import Array, DesignError, NonNegative, Positive, Reference

EQUATION = {
    "constant": r"r_k = \mathrm{value}",
    "s_shape": r"""x = -w \sin 2f, \quad y = h \cos f, \quad \psi = \alpha \sin^2 (\pi g), \quad
f = \left( \tfrac{5}{4} g - \tfrac{1}{8} \right) \pi, \quad g = 10 s^3 - 15 s^4 + 6 s^5, \quad s = \min(t / T, 1)""",
    "square": r"r_k = v_1 \quad \mathrm{if\ } (k T_s \bmod T) \lt d T, \quad r_k = v_2 \quad \mathrm{otherwise}",
}


@dataclass(frozen=True, eq=False)
class Constant(Reference):
    """The same value at all times."""

    value: Float[Array, " ny"]

    def sample(self, n_samples: int) -> Float[Array, "samples ny"]:
        """Values at k = 0..n_samples - 1."""
        return np.tile(self.value, (n_samples, 1))


def constant(ny: int, *, value: float | list[float]) -> Constant:
    """Constant reference.

    Parameters
    ----------
    ny : number of outputs
    value : its value, in the output's unit

    Raises
    ------
    DesignError
        If the number of values does not fit.
    """
    return Constant(as_vector(value, ny, "value"))


@dataclass(frozen=True, eq=False)
class Square(Reference):
    """Two values in turn."""

    first: Float[Array, " ny"]
    second: Float[Array, " ny"]
    period: int  # samples
    edge: int  # samples of a period that have the first value

    def sample(self, n_samples: int) -> Float[Array, "samples ny"]:
        """Values at k = 0..n_samples - 1."""
        within = np.arange(n_samples) % self.period
        return np.where((within < self.edge)[:, None], self.first, self.second)


def square(
    ny: int,
    Ts: float,
    *,
    values: tuple[float | list[float], float | list[float]],
    period: Positive,
    duty: Annotated[float, Gt(0), Lt(1)] = 0.5,
) -> Square:
    """Square wave that alternates between two values and starts with the first one.

    Parameters
    ----------
    ny : number of outputs
    Ts : sampling time [s]
    values : the first and the second value, in the output's unit
    period : period of the wave [s], a whole number of samples
    duty : share of the period with the first value, a whole number of samples, too

    Raises
    ------
    DesignError
        If an edge is between two samples, or the number of values does not fit.
    """
    samples, edge = period / Ts, duty * period / Ts
    for count, name in ((samples, "period"), (edge, "duty")):
        if abs(count - round(count)) > 1e-9 * max(count, 1.0) or round(count) < 1:
            raise DesignError(f"the edges must lie on samples, {Ts:g} apart", name)
    if round(edge) == round(samples):
        raise DesignError("leaves no sample for the second value", "duty")
    first, second = (as_vector(value, ny, "values") for value in values)
    # Number of samples beyond any experiment; larger numbers are not exact in doubles.
    longest = 2**53
    return Square(first, second, min(round(samples), longest), min(round(edge), longest - 1))


@dataclass(frozen=True, eq=False)
class SShape(Reference):
    """S-shaped path in the plane, with a rotation and its reversal."""

    Ts: float
    duration: float
    width: float
    height: float
    angle: float

    def sample(self, n_samples: int) -> Float[Array, "samples 3"]:
        """Values at k = 0..n_samples - 1."""
        return s_curve(np.arange(n_samples) * self.Ts, self.duration, self.width, self.height, self.angle)


def s_shape(
    ny: int,
    Ts: float,
    *,
    duration: Positive = DURATION,
    width: NonNegative = WIDTH,
    height: NonNegative = HEIGHT,
    angle: float = ANGLE,
) -> SShape:
    """S-shaped path in the plane for three outputs (x, y and an angle), from rest to rest; then the last value is held.

    With s = min(t/duration, 1), g = 10 s^3 - 15 s^4 + 6 s^5 and f = (5/4 g - 1/8) pi: x = -width sin 2f,
    y = height cos f, and the angle is `angle` sin^2(pi g).  The equations are ours: belda2017 shows the path only.

    Parameters
    ----------
    ny : number of outputs
    Ts : sampling time [s]
    duration : time from rest to rest [s]
    width : largest distance from the vertical axis [m]
    height : largest distance from the horizontal axis [m]
    angle : angle at half of the duration [rad]

    Raises
    ------
    DesignError
        If the plant has another number of outputs than 3.
    """
    if ny != 3:
        raise DesignError(f"is a path for x, y and an angle, but the plant has {ny} outputs; use another kind", "kind")
    return SShape(Ts, duration, width, height, angle)
