"""Records that plants, estimators and controllers exchange."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from jaxtyping import Float

from rmpc_bench.types.basics import Array
from rmpc_bench.types.status import Statuses


class Estimate(NamedTuple):
    """Result of a correction at k."""

    x_hat: Float[Array, "runs nx"]
    P: Float[Array, "nx nx"] | Float[Array, "runs nx nx"] | None
    """Reported covariance of x_hat - x."""
    M: Float[Array, "nx nx"] | Float[Array, "runs nx nx"] | None
    """Shape matrix of the reported set of x_hat - x."""
    status: Statuses
    info: Mapping[str, Array]


class Command(NamedTuple):
    """Result of a control law at k."""

    u: Float[Array, "runs nu"]
    status: Statuses
    info: Mapping[str, Array]


class Motion(NamedTuple):
    """State of a plant at k+1."""

    x: Float[Array, "runs nx"]
    status: Statuses


class Channel(NamedTuple):
    """Uncertainty H F G: the diagonal entries of F are white and independent, with one variance."""

    H: Float[Array, "nz r"]
    G: Float[Array, "s nq"]
    mean: Float[Array, "r s"]
    variance: float


class Period(NamedTuple):
    """One period of a linear plant: [x(k+1); y(k)] = (M + sum of H F G) [x; w; v] + [B u; 0]."""

    M: Float[Array, "nz nq"]
    B: Float[Array, "nx nu"]
    channels: tuple[Channel, ...]


class LinearPlant(NamedTuple):
    """Linear part of a plant: x(k+1) = A x(k) + B u(k), y(k) = C x(k); the state of the design model is E x(k)."""

    A: Float[Array, "*runs n n"]
    B: Float[Array, "*runs n nu"]
    C: Float[Array, "*runs ny n"]
    E: Float[Array, "*runs nx n"]
    """Selects the states of the design model from the states of the plant."""


class GainSchedule(NamedTuple):
    """A linear filter whose gains do not depend on the data; axis 0 of every matrix is k, of length 1 where constant.

    x_pred(k+1) = F x_pred + B u + f + K e,  x_hat = x_pred + L e,  e = y - C x_pred - d.
    """

    x0: Float[Array, " nx"]
    F: Float[Array, "kF nx nx"]
    B: Float[Array, "kB nx nu"]
    C: Float[Array, "kC ny nx"]
    K: Float[Array, "kK nx ny"]
    L: Float[Array, "kL nx ny"]
    f: Float[Array, "kf nx"] | None = None
    """None where it is zero."""
    d: Float[Array, "kd ny"] | None = None
    """None where it is zero."""


class LinearLaw(NamedTuple):
    """Gains of the control law u(k) = u(k-1) - K_u u(k-1) + K_r [r(k+1); r(k+2); ..] - K_x x_hat(k)."""

    K_x: Float[Array, "nu nx"]
    K_u: Float[Array, "nu nu"]
    K_r: Float[Array, "nu rows"]
