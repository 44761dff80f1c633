"""The nominal plant as functions of state and input, from which design models are made.

An ODE plant gives x' = rhs(t, x, u, p), or x(k+1) of a map, at the nominal parameters p; operating points are those of
t = 0.  A plant that is linear gives the matrices of one period, x(k+1) = A x + B u.  Values that are drawn for a run
have no effect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.noise_sets import DesignNoise, over_sample
from rmpc_bench.models.ode_functions import alone, slopes
from rmpc_bench.numerics.integration import Tolerance, apply_map, halve, inside, rk4, sample_times
from rmpc_bench.numerics.jacobian import Derivative, derivative, jacobian
from rmpc_bench.types import Array, DesignError, NamedSignals, Ode, OperatingPoint, Plant, Signals, SolverError
from rmpc_bench.types.angles import near, period_of
from rmpc_bench.types.basics import attribute

RTOL = 1e-6
"""Tolerance of error control of a design model, relative to the range of a state."""
OUTSIDE_DOMAIN = (ArithmeticError, ValueError, TypeError, SolverError)
"""What a function raises where it is not defined, such as ``math.sqrt`` of a negative number."""


class Tangent(NamedTuple):
    """Matrices at a point: rest(x, u) is about f + A dx + B du, the output about y + C dx + D du."""

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    D: Float[Array, "ny _"]
    """Without columns where the output takes no input."""


class Dynamics:
    """A plant at its nominal parameters; `rest` is zero in a steady state.

    A subclass gives the attributes `signals` and `continuous` and the methods.
    """

    signals: NamedSignals
    """Names, bounds and units of states, inputs and outputs."""
    continuous: bool
    """Whether `rest` is x', in contrast to x(k+1) - x(k)."""
    x_period: Float[Array, " nx"] | None = None
    """Period of every state, 0 of one that is no angle; None where none is."""
    y_period: Float[Array, " ny"] | None = None
    """The same of the outputs."""
    fed: bool = False
    """Whether y(k) depends on u(k)."""

    A_c: Float[Array, "nx nx"] | None = None
    """A of x' = A x + B u, of which a period is a sample; None of any other plant."""

    def noise(self, noise: DesignNoise, Ts: float, A: Float[Array, "nx nx"] | None = None) -> tuple[Array, Array]:
        """Return Q_w and R_v of a noise; A is the Jacobian at an operating point."""
        A = (A if self.continuous else None) if self.A_c is None else self.A_c
        has_rates = self.continuous or self.A_c is not None
        return noise.covariances(self.signals.nx, self.signals.ny, Ts if has_rates else None, A)

    def rest(self, x: Float[Array, " nx"], u: Float[Array, " nu"], t: float = 0.0) -> Float[Array, " nx"]:
        """Return x', or x(k+1) - x(k); NaN where it is not defined."""
        raise NotImplementedError("rest")

    def output(self, x: Float[Array, " nx"], u: Float[Array, " nu"]) -> Float[Array, " ny"]:
        """Return y without noise; NaN where it is not defined."""
        raise NotImplementedError("output")

    def advance(
        self,
        k: int,
        x: Array,
        u: Array,
        Ts: float,
        substeps: int,
        points: int = 1,
        leading: int | None = None,
        *,
        strict: bool = True,
    ) -> Float[Array, "columns nx"]:
        """Return x(k+1) of states and inputs, one per row, with equal steps, or with error control where there are 0.

        With error control so many successive `points` use the same intervals, on which the first `leading` of them
        decide.  An error of the user's function is raised if `strict`; otherwise it gives NaN.
        """
        return np.array([each + self.rest(each, applied) for each, applied in zip(x, u, strict=True)])

    def refuse_errors(self, x: Float[Array, " nx"], u: Float[Array, " nu"], key: str) -> None:
        """Call the functions of a user once; a DesignError at the key reports what they raise."""

    def slopes(self, x: Float[Array, " nx"], u: Float[Array, " nu"], t: float = 0.0) -> Tangent:
        """Return the matrices at a point."""
        nx = len(x)
        J = jacobian(self.rest_near(x, u, t), np.concatenate([x, u]))
        return Tangent(J[:, :nx], J[:, nx:], *self.seen(x, u))

    def rest_near(self, x: Float[Array, " nx"], u: Float[Array, " nu"], t: float = 0.0) -> Callable[[Array], Array]:
        """Return `rest` of [x, u] for differences around a point: angles of a map do not jump there."""
        nx, period = len(x), None if self.continuous else self.x_period
        return near(lambda z: self.rest(z[:nx], z[nx:], t), np.concatenate([x, u]), period)

    def output_near(self, x: Float[Array, " nx"], u: Float[Array, " nu"]) -> Callable[[Array], Array]:
        """Return `output` of [x, u], or of x where it takes no u: angles do not jump around the point."""
        nx = len(x)
        return near(lambda z: self.output(z[:nx], z[nx:]), self._point(x, u), self.y_period)

    def _point(self, x: Float[Array, " nx"], u: Float[Array, " nu"]) -> Float[Array, " n"]:
        return np.concatenate([x, u]) if self.fed else x

    def seen(self, x: Float[Array, " nx"], u: Float[Array, " nu"]) -> tuple[Array, Array]:
        """Return C and D of a tangent."""
        J = jacobian(self.output_near(x, u), self._point(x, u))
        return J[:, : len(x)], J[:, len(x) :]

    def tangent(self, x: Float[Array, " nx"], u: Float[Array, " nu"]) -> tuple[Tangent, tuple[str, ...]]:
        """Return the matrices at a point, and the names of the coordinates with a kink there."""
        nx = len(x)
        moves = derivative(self.rest_near(x, u), np.concatenate([x, u]))
        seen: Derivative = derivative(self.output_near(x, u), self._point(x, u))
        every = (*self.signals.states, *self.signals.inputs)
        kinks = tuple(every[i] for i in sorted({*moves.kinks, *seen.kinks}))
        return Tangent(moves.J[:, :nx], moves.J[:, nx:], seen.J[:, :nx], seen.J[:, nx:]), kinks


@dataclass(frozen=True, eq=False)
class OfPlant:
    """What design models have in common that are made from a plant."""

    dynamics: Dynamics  # the nominal plant
    Ts: float  # sampling time [s]
    substeps: int  # given steps of the integration per sample; 0 for error control
    Q_w: Float[Array, "nx nx"]  # Q_w, R_v: covariances of the noises
    R_v: Float[Array, "ny ny"]

    y_period = property(lambda self: self.dynamics.y_period)
    nx = property(lambda self: self.dynamics.signals.nx)
    ny = property(lambda self: self.dynamics.signals.ny)

    @attribute
    def nu(self) -> int:
        """Number of inputs; fewer for a law beside a signal of the others."""
        return self.dynamics.signals.nu


@dataclass(frozen=True, eq=False)
class OdeDynamics(Dynamics):
    """An ordinary differential equation, or a map, at its nominal parameters."""

    ode: Ode

    signals = property(lambda self: self.ode)
    continuous = property(lambda self: not self.ode.discrete)
    fed = property(lambda self: self.ode.fed)

    @cached_property
    def x_period(self) -> Float[Array, " nx"] | None:  # type: ignore[override]
        """Period of every state of the equation."""
        return period_of(self.ode.angles, self.ode.states)

    @cached_property
    def y_period(self) -> Float[Array, " ny"] | None:  # type: ignore[override]
        """Period of every output of the equation."""
        return period_of(self.ode.angles, self.ode.outputs)

    def rest(self, x: Float[Array, " nx"], u: Float[Array, " nu"], t: float = 0.0) -> Float[Array, " nx"]:
        """Return x', or x(k+1) - x(k)."""
        try:
            # Outside of its domain, where a search may try it, the function is NaN.
            with np.errstate(all="ignore"):
                slope: Array = self.ode.slope(t, x, u, self.ode.p)
        except OUTSIDE_DOMAIN:
            return np.full(len(x), np.nan)
        return slope - x if self.ode.discrete else slope

    def output(self, x: Float[Array, " nx"], u: Float[Array, " nu"]) -> Float[Array, " ny"]:
        """Return y."""
        try:
            with np.errstate(all="ignore"):
                y: Array = self.ode.measure(x, u, self.ode.p)
        except OUTSIDE_DOMAIN:
            return np.full(self.ode.ny, np.nan)
        return y

    def advance(
        self,
        k: int,
        x: Array,
        u: Array,
        Ts: float,
        substeps: int,
        points: int = 1,
        leading: int | None = None,
        *,
        strict: bool = True,
    ) -> Float[Array, "columns nx"]:
        """Integrate by the Runge-Kutta method, or apply the map; too large an error is a `SolverError` or NaN."""
        ode, errors, columns = self.ode, list[Exception](), np.ascontiguousarray(x.T)
        of = alone(lambda t, z, v: ode.slope(t, z, v, ode.p), u, errors)
        if ode.rhs_takes_blocks and not strict:
            numbers = np.tile(np.array(list(ode.nominal.values()), dtype=float), (len(x), 1))
            of = slopes(ode, u, numbers, of, OUTSIDE_DOMAIN)
        every = np.arange(len(x))
        if ode.discrete:
            end = apply_map(of(every), k * Ts, (k + 1) * Ts, columns)
        elif substeps:
            end = rk4(inside(of(every), k, Ts), sample_times(k, substeps, Ts), columns, Ts / substeps)
        else:
            tolerance = Tolerance(RTOL, np.array(ode.scale or [0.0] * ode.nx))
            end = halve(of, k, Ts, columns, tolerance, points, leading=leading)
            end.x[:, np.repeat(end.failed, points)] = np.nan
        if errors and (strict or not isinstance(errors[0], OUTSIDE_DOMAIN)) and not np.isfinite(end.x).all():
            raise errors[0]
        if strict and end.failed.any() and np.isfinite(x).all():
            i = points * int(end.failed.argmax())
            raise SolverError(
                f"f(x, u) of the model cannot be integrated at x = {x[i].tolist()}, u = {u[i].tolist()}: the error is "
                "too large with 1/512 of a sample; the equation is stiff or grows without limit; give `substeps` of "
                "the model, or a shorter sampling time"
            )
        return np.ascontiguousarray(end.x.T)

    def slopes(self, x: Float[Array, " nx"], u: Float[Array, " nu"], t: float = 0.0) -> Tangent:
        """Return the matrices at a point; a function with the attribute `jacobian` gives its own, which are exact."""
        rhs, output, p, nx = self.ode.rhs, self.ode.output, self.ode.p, len(x)
        if not hasattr(rhs, "jacobian"):
            return super().slopes(x, u, t)
        A, *B = rhs.jacobian(*([t] if self.ode.timed else []), x, u, p)
        by_x = getattr(output, "jacobian", None)
        C, D = self.seen(x, u) if by_x is None or self.fed else (by_x(x, p)[0], np.zeros((self.ode.ny, 0)))
        return Tangent(A - np.eye(nx) if self.ode.discrete else A, B[0] if B else np.zeros((nx, 0)), C, D)

    def tangent(self, x: Float[Array, " nx"], u: Float[Array, " nu"]) -> tuple[Tangent, tuple[str, ...]]:
        """Return the matrices at a point, and the names of the coordinates with a kink there."""
        found, kinks = super().tangent(x, u)
        return self.slopes(x, u) if hasattr(self.ode.rhs, "jacobian") else found, kinks

    def refuse_errors(self, x: Float[Array, " nx"], u: Float[Array, " nu"], key: str) -> None:
        """Call both functions once and report what they raise."""
        name = "rhs"
        try:
            self.ode.slope(0.0, x, u, self.ode.p)
            name = "output"
            self.ode.measure(x, u, self.ode.p)
        # The functions are the user's: they may raise anything.
        except Exception as error:
            where = ", ".join(f"{each} = {value:.6g}" for each, value in zip(self.ode.states, x, strict=True))
            raise DesignError(f"{name} raises {type(error).__name__} at {where}: {error}", key) from error


@dataclass(frozen=True, eq=False)
class LinearDynamics(Dynamics):
    """A plant with constant matrices."""

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    signals: NamedSignals
    A_c: Float[Array, "nx nx"] | None = None
    D: Float[Array, "ny nu"] | float = 0.0

    continuous = False
    fed = property(lambda self: bool(np.any(self.D)))

    def rest(self, x: Float[Array, " nx"], u: Float[Array, " nu"], t: float = 0.0) -> Float[Array, " nx"]:
        """Return x(k+1) - x(k)."""
        return self.A @ x + self.B @ u - x

    def output(self, x: Float[Array, " nx"], u: Float[Array, " nu"]) -> Float[Array, " ny"]:
        """Return y."""
        return self.C @ x + self.D @ u if self.fed else self.C @ x

    def tangent(self, x: Float[Array, " nx"], u: Float[Array, " nu"]) -> tuple[Tangent, tuple[str, ...]]:
        """Return the matrices, which are the same at every point and have no kink."""
        return self.slopes(x, u), ()

    def slopes(self, x: Float[Array, " nx"], u: Float[Array, " nu"], t: float = 0.0) -> Tangent:
        """Return the matrices, which are the same at every point."""
        return Tangent(self.A - np.eye(len(self.A)), self.B, self.C, np.broadcast_to(self.D, (len(self.C), len(u))))


def dynamics_of(plant: Plant) -> Dynamics:
    """Return the nominal plant as functions."""
    if plant.ode is not None:
        return OdeDynamics(plant.ode)
    constant = plant.system is not None and not plant.system.varies
    now: Any = plant.system.at(0) if constant else plant.linear(dict(plant.nominal))
    if now is not None:
        sizes = {"x": len(now.A), "u": now.B.shape[1], "y": len(now.C)}
        x, u, y = (tuple(f"{letter}.{i}" for i in range(n)) for letter, n in sizes.items())
        return LinearDynamics(now.A, now.B, now.C, plant.signals or Signals(x, u, y), plant.A_c, now.D)
    raise DesignError(
        "needs an ODE plant (`plant: {ode: FILE.py:NAME}`) or a plant with constant matrices; give the equations of "
        "the model by `model: {ode: FILE.py:NAME, ..}`"
    )


def noise_of_plant(plant: Plant, point: OperatingPoint | None, S: Array, Ts: float, *, measured: bool) -> Array:
    """Return the covariance of a sample of white noise with density S; x' is linear around the operating point."""
    dynamics = None if plant.A_c is None and plant.ode is None else dynamics_of(plant)
    if dynamics is None or not (dynamics.continuous or plant.A_c is not None):
        text = "density needs a continuous plant: a differential equation, or a continuous system of control or scipy"
        raise DesignError(text, "density")
    if measured:
        return S / Ts
    fits = point is not None and dynamics.continuous and len(point.x) == plant.nx
    A = dynamics.slopes(point.x, point.u).A if fits and point is not None else plant.A_c
    return over_sample(S, Ts, A)


def neglected(dynamics: Dynamics, S: Array, x: Float[Array, " nx"], Ts: float) -> float:
    """Return the largest difference of Ts S from the covariance over a sample at a state, relative to its variances."""
    low, high = dynamics.signals.limits(dynamics.signals.inputs)
    exact = over_sample(S, Ts, dynamics.slopes(x, np.clip(0.0, low, high)).A)
    size = np.sqrt(exact.diagonal())
    return float(np.max(np.abs(Ts * S - exact) / np.where(size > 0, size[:, None] * size, np.inf)))


def sampled(
    dynamics: Dynamics, tangent: Tangent, rest: Float[Array, " nx"], Ts: float
) -> tuple[Float[Array, "nx nx"], Float[Array, "nx nu"], Float[Array, " nx"]]:
    """Return A, B and the drift over a sampling period, with the input held."""
    if not dynamics.continuous:
        return tangent.A + np.eye(len(rest)), tangent.B, rest
    from scipy.linalg import expm

    nx, nu = tangent.B.shape
    block = np.zeros((nx + nu + 1, nx + nu + 1))
    block[:nx] = np.hstack([tangent.A, tangent.B, rest[:, None]])
    E = expm(block * Ts)
    return E[:nx, :nx], E[:nx, nx:-1], E[:nx, -1]


def steps_of(dynamics: Dynamics) -> int:
    """Return the given steps per sample of the plant; 0 for error control."""
    return dynamics.ode.substeps if isinstance(dynamics, OdeDynamics) else 0
