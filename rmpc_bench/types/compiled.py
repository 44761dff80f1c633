"""Components as arrays, for the compiled simulation of a whole period (`simulation.linear_loop`).

A component returns one of these records only if the compiled simulation gives the very numbers of its own methods.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxtyping import Float, Int

from rmpc_bench.types.basics import Array
from rmpc_bench.types.records import GainSchedule, OperatingPoint, Statuses


class CompiledPlant(NamedTuple):
    """A plant whose step and output are compiled functions, see `numerics.linear_loop_kernel`."""

    advance: Any
    """Compiled function that writes x(k+1), w(k) included, and returns a status."""
    measure: Any
    """Compiled function that writes y(k) without measurement noise."""
    own: Float[Array, "runs rows own"]
    """Numbers of every run, as the two functions need them; those of one run are passed to them."""
    shared: Float[Array, "kshared shared"]
    """Numbers that all runs have in common; axis 0 is k and has length 1 if they are constant."""
    sizes: Int[Array, " sizes"]
    """Numbers of rows and columns, for the two functions."""
    work: tuple[int, int]
    """Shape of the memory that the two functions write into."""
    status: Statuses
    """What the plant reports at every step of a run, unless it is OK."""


class CompiledFilter(NamedTuple):
    """A linear filter with given gains, and what it reports; axis 0 of every array is k, of length 1 if constant."""

    schedule: GainSchedule
    S: Float[Array, "kS ny ny"] | None = None
    """Covariance of the innovation."""


class CompiledLaw(NamedTuple):
    """A linear control law; axis 0 of K_x and u_0 is k and has length 1 if they are constant.

    With K_u     u(k) = (u(k-1) - K_u u(k-1) + given(k) - K_x x_hat(k)) - u_0(k), limited to [low, high]
    without K_u  u(k) = u_op + (-K_x (x_hat(k) - x_op) - u_0(k)), with or without an operating point
    without K_x  u(k) = given(k)
    """

    given: Float[Array, "runs kgiven nu"]
    """Axis 0 has length 1 if it is the same for all runs, axis 1 if it is constant."""
    K_x: Float[Array, "kK nu nx"] | None = None
    K_u: Float[Array, "nu nu"] | None = None
    u_0: Float[Array, "k0 nu"] | None = None
    low: float = -float("inf")
    high: float = float("inf")
    start: Float[Array, " nu"] | None = None
    """Input before k = 0; None for 0."""
    point: OperatingPoint | None = None
