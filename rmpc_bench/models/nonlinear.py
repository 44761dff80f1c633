"""Nonlinear design model: the plant or an equation of its own as functions, for nonlinear filters and own components.

Model   `nonlinear`  x(k+1) = f(x(k), u(k)) + w(k), w ~ N(0, Q_w); y(k) = h(x(k)) + v(k), v ~ N(0, R_v). f integrates
                     the nominal plant by the Runge-Kutta method of order 4 with error control
                     (numerics/integration.py) or `substeps` steps, or is the map of a discrete plant, without its
                     bounds.  F and H are the Jacobians of f and h, by differences; those of f use the intervals of x.
        `ode`  x' = rhs(x, u, p), or x(k+1) with `discrete: true`;  y = output(x, p), or output(x, u, p), with its
               parameters.  With `at` as `linearise`, without as `nonlinear`.
Limit   `nonlinear`  Around an operating point f has the A and B of models/linearised.py.
Cost    `nonlinear`  f of a rhs of two states with `substeps: 10`: about 0.3 ms; compiled (`numba: true`) a few
                     microseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from rmpc_bench.models.compiled_step import Step, compiled_step
from rmpc_bench.models.dynamics import RTOL, Dynamics, OdeDynamics, OfPlant, dynamics_of, steps_of
from rmpc_bench.models.flow import PlantFlow
from rmpc_bench.models.linearised import LinearisedModel, linearised, relinearised
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.ode_functions import Names, is_fed, is_timed, names_of, refuse_shared
from rmpc_bench.models.operating_point import At, find_point
from rmpc_bench.numerics.jacobian import STEP, jacobian, sizes_of_coordinates
from rmpc_bench.types import (
    Array,
    Count,
    DesignError,
    Model,
    Ode,
    OperatingPoint,
    Parameters,
    Plant,
    Positive,
    UserFunction,
)
from rmpc_bench.types.errors import unknown

EQUATION = {
    "design": r"x_{k+1} = f(x_k, u_k) + w_k, \quad y_k = h(x_k) + v_k",
    "design_ode": r"\dot x = f(x, u, p), \quad y = h(x, p)",
}


@dataclass(frozen=True, eq=False)
class NonlinearModel(OfPlant, Model):
    """The nominal plant as functions of one run; create it with `nonlinear_model`."""

    operating_point: OperatingPoint | None = None  # point of the key `at`; None without it
    # keys `at`, `noise` and `jacobian` of the linear model around the operating point
    linear_keys: tuple[At, DesignNoise, Any] | None = None
    compiled: bool = False  # whether f is compiled
    _cache: dict[str, Any] = field(default_factory=dict, init=False, repr=False)
    """The linear model and the compiled step, made on first use; they are not sent to workers."""

    @property
    def rhs(self) -> Callable[..., Any] | None:
        """The user's function (x, u, p) or (t, x, u, p); None for a plant with matrices."""
        return self.dynamics.ode.rhs if isinstance(self.dynamics, OdeDynamics) else None

    @property
    def output(self) -> Callable[..., Any] | None:
        """The user's function (x, p); None where all states are measured, and for a plant with matrices."""
        return self.dynamics.ode.output if isinstance(self.dynamics, OdeDynamics) else None

    @property
    def p(self) -> Parameters:
        """The nominal parameters, as rhs and output take them."""
        return self.dynamics.ode.p if isinstance(self.dynamics, OdeDynamics) else Parameters({})

    @property
    def limits(self) -> tuple[Float[Array, " nx"], Float[Array, " nx"]]:
        """Lower and upper bounds of the states, infinite where there are none."""
        return self.dynamics.signals.limits(self.dynamics.signals.states)

    feedthrough = property(lambda self: self.dynamics.fed)

    @property
    def flow(self) -> PlantFlow:
        """The model as maps of many states at once, for extended-kalman and unscented-kalman."""
        compiled = self if self.compiled else None
        return PlantFlow(self.dynamics, self.Ts, self.substeps, self.Q_w, self.R_v, compiled)

    def f(
        self, x: ArrayLike, u: ArrayLike, k: int = 0, near: tuple[ArrayLike, ArrayLike] | None = None
    ) -> Float[Array, "*n nx"]:
        """Return x(k+1) without noise, of one state and input or one per row.

        Error control uses the intervals of the state and input `near`, so that differences of f are smooth; by default
        every state has its own.
        """
        x, u = np.asarray(x, dtype=float), np.atleast_1d(np.asarray(u, dtype=float))
        rows = x[None] if x.ndim == 1 else x
        inputs = np.broadcast_to(u, (len(rows), self.nu))
        if self.substeps or near is None:
            moved = self._moved(k, rows, inputs, None)
        else:
            x0, u0 = (np.atleast_1d(np.asarray(part, dtype=float)) for part in near)
            # The points that a Jacobian takes: how far they move also decides on the intervals.
            lead = np.vstack([x0, x0 + np.diag(STEP * sizes_of_coordinates(x0))])
            moved = self._moved(k, rows, inputs, (lead, np.tile(u0, (len(lead), 1))))
        return moved[0] if x.ndim == 1 else moved

    def points(
        self, k: int, x: Float[Array, "points nx"], u: Float[Array, "points nu"], leading: int | None = None
    ) -> Float[Array, "points nx"]:
        """Return x(k+1) of points that all, or the first of them, decide on the same intervals."""
        return self._moved(k, x, u, (x[:leading], u[:leading]))

    def _moved(self, k: int, x: Array, u: Array, lead: tuple[Array, Array] | None) -> Array:
        """Return x(k+1) of rows, with the intervals of `lead`, or of every row alone."""
        if lead is None and self.compiled:
            step = self._compiled_step
            return np.vstack([step(k, *pair, *pair) for pair in zip(x[:, None], u[:, None], strict=True)])
        if lead is None:
            return self.dynamics.advance(k, x, u, self.Ts, self.substeps)
        if self.compiled:
            return self._compiled_step(k, x, u, *lead)
        states, inputs, n = np.vstack([lead[0], x]), np.vstack([lead[1], u]), len(lead[0])
        return self.dynamics.advance(k, states, inputs, self.Ts, 0, n + len(x), n)[n:]

    def measured(self, k: int, x: Float[Array, "runs nx"]) -> Float[Array, "runs ny"]:
        """Return y(k) of states without noise."""
        return self.flow.measure(k, x)

    def h(self, x: ArrayLike, u: ArrayLike = ()) -> Float[Array, "*n ny"]:
        """Return y without noise, of a state or of one per row; u, the same for all, where the output takes it."""
        x, u = np.asarray(x, dtype=float), np.atleast_1d(np.asarray(u, dtype=float))
        return self.dynamics.output(x, u) if x.ndim == 1 else np.array([self.dynamics.output(each, u) for each in x])

    def F(self, x: ArrayLike, u: ArrayLike, k: int = 0) -> Float[Array, "nx nx"]:
        """Return the Jacobian of f with respect to x."""
        return jacobian(lambda z: self.f(z, u, k, (x, u)), np.asarray(x, dtype=float))

    def H(self, x: ArrayLike, u: ArrayLike = ()) -> Float[Array, "ny nx"]:
        """Return the Jacobian of h with respect to x."""
        return self.dynamics.seen(np.asarray(x, dtype=float), np.atleast_1d(np.asarray(u, dtype=float)))[0]

    @property
    def deviation(self) -> Model:
        """The linear model in deviations from the operating point; the model itself without one."""
        return self if self.operating_point is None else self.at(0).deviation

    def at(self, k: int) -> LinearisedModel:
        """Return the linear model around the operating point."""
        if self.linear_keys is None:
            raise DesignError(
                "needs a linear model: give the model `linearise: plant`, or give this nonlinear one an operating "
                "point `at`, around which linear methods use it",
                "kind",
            )
        if "linear" not in self._cache:
            self._cache["linear"] = linearised(self.dynamics, self.Ts, *self.linear_keys)
        return self._cache["linear"]

    def facts(self) -> list[tuple[str, str]]:
        """Integration, and the operating point."""
        steps = f"{self.substeps} substeps" if self.substeps else f"error control to {RTOL:g} of the range of a state"
        how = f"Runge-Kutta, {steps}{', compiled' if self.compiled else ''}"
        rows = [("f(x, u)", how)] if self.dynamics.continuous else []
        return rows if self.linear_keys is None else rows + self.at(0).facts()

    def warm_up(self) -> None:
        """Compile."""
        if self.compiled:
            _ = self._compiled_step

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without what a worker makes itself."""
        return {name: value for name, value in vars(self).items() if name != "_compiled_step"} | {"_cache": {}}

    @cached_property
    def _compiled_step(self) -> Step:
        assert isinstance(self.dynamics, OdeDynamics), "only an equation is compiled"
        return compiled_step(self.dynamics.ode, self.Ts, self.substeps, RTOL)


def nonlinear_model(
    dynamics: Dynamics,
    Ts: float,
    noise: DesignNoise,
    at: At | None = None,
    jacobian: Any = None,
    *,
    substeps: int | None = None,
    numba: bool = False,
) -> NonlinearModel:
    """Make a nonlinear model of a plant."""
    point = None if at is None else find_point(dynamics, at).point
    Q_w, R_v = dynamics.noise(noise, Ts, None if point is None else dynamics.slopes(point.x, point.u).A)
    if numba and not isinstance(dynamics, OdeDynamics):
        raise DesignError("has no effect on a plant with matrices", "numba")
    if substeps is not None and not dynamics.continuous:
        raise DesignError("has no effect: the plant is not a differential equation", "substeps")
    keys = None if at is None else (at, noise, jacobian)
    model = NonlinearModel(dynamics, Ts, substeps or steps_of(dynamics), Q_w, R_v, point, keys, numba)
    model.warm_up()
    return model


def design(
    Ts: float,
    plant: Plant,
    *,
    nonlinear: Literal["plant"] = "plant",
    noise: DesignNoise,
    at: At | None = None,
    jacobian: UserFunction = None,
    substeps: Count | None = None,
    numba: bool = False,
) -> Model:
    """Nonlinear model of the nominal plant.

    Own components and nonlinear estimators use its functions f(x, u) and h(x), the Jacobians F(x, u) and H(x), Q_w,
    R_v, Ts, rhs, output and the nominal parameters p.  Built-in linear methods need an operating point `at`.

    Parameters
    ----------
    Ts : sampling time [s]
    plant : plant of the experiment, with its nominal parameters
    nonlinear : `plant`
    noise : covariances `process` and `measurement` of the noise of the sampled model
    at : operating point, as for `linearise`
    jacobian : derivatives at the operating point, as for `linearise`
    substeps : Runge-Kutta steps per sample (default: those of the plant, or error control)
    numba : whether to compile rhs by numba

    Raises
    ------
    DesignError
        If there is no such point, the noise is no covariance, or rhs cannot be compiled.
    """
    return nonlinear_model(dynamics_of(plant), Ts, noise, at, jacobian, substeps=substeps, numba=numba)


# A model that is given by an equation of its own, which may be simpler than that of the plant.


def design_ode(
    Ts: float,
    plant: Plant,
    *,
    ode: UserFunction,
    output: UserFunction = None,
    states: Names | None = None,
    inputs: Names | None = None,
    outputs: Names | None = None,
    parameters: dict[str, float] | None = None,
    noise: DesignNoise,
    at: At | Literal["trajectory"] | None = None,
    jacobian: UserFunction = None,
    substeps: Count | None = None,
    numba: bool = False,
    discrete: bool = False,
    angles: list[str] | dict[str, Positive] | None = None,
    time_unit: str = "s",
) -> Model:
    """Design model with an equation of its own; linear with `at`, nonlinear without.

    Names, parameters and bounds that are not given are those of an ODE plant.

    Parameters
    ----------
    Ts : sampling time [s]
    plant : plant of the experiment
    ode : rhs(x, u, p) or rhs(t, x, u, p), which returns x', or x(k+1) with `discrete`
    output : output(x, p) or output(x, u, p) (default: all states)
    states, inputs, outputs : names or counts
    parameters : name -> value; they replace those of the plant one by one
    noise : covariances `process` and `measurement` of the noise of the sampled model
    at : operating point, as for `linearise`; without it the model is nonlinear
    jacobian : derivatives at the operating point, as for `linearise`
    substeps : Runge-Kutta steps per sample of a nonlinear model (default: those of the plant, or error control)
    numba : whether to compile rhs of a nonlinear model
    discrete : whether rhs returns x(k+1) in place of time derivatives
    angles : states and outputs that are angles, as of the plant (default: those of it)
    time_unit : unit of the time in texts

    Raises
    ------
    DesignError
        If a function, a name or an operating point is not what it must be.
    """
    x_names, x_units = _named(states, plant.ode, "states", "x")
    u_names, u_units = _named(inputs, plant.ode, "inputs", "u")
    refuse_shared(x_names, u_names)
    y_names, y_units = (x_names, x_units) if output is None else _named(outputs, plant.ode, "outputs", "y")
    known = plant.ode or Ode(ode, output, (), (), ())
    ranges = dict(zip(known.states, known.scale, strict=False))
    equation = Ode(
        ode,
        output,
        x_names,
        u_names,
        y_names,
        nominal={**known.nominal, **(parameters or {})},
        units={**known.units, **y_units, **u_units, **x_units},
        bounds={name: known.bounds[name] for name in (*x_names, *u_names) if name in known.bounds},
        timed=is_timed(ode),
        substeps=known.substeps if known.discrete == discrete else 0,
        scale=tuple(ranges.get(name, 0.0) for name in x_names),
        discrete=discrete,
        time_unit=time_unit,
        fed=is_fed(output),
    )
    if (equation.nu, equation.ny) != (plant.nu, plant.ny):
        raise DesignError(
            f"inputs and outputs of the model: {equation.nu} and {equation.ny}; those of the plant: {plant.nu} and "
            f"{plant.ny}; give inputs, outputs and `output`",
            "ode",
        )
    own = _angles(angles, known, dict.fromkeys((*x_names, *y_names)))
    dynamics = OdeDynamics(replace(equation, angles=own))
    if at == "trajectory":
        return relinearised(dynamics, Ts, noise, substeps)
    if at is not None:
        return linearised(dynamics, Ts, at, noise, jacobian)
    return nonlinear_model(dynamics, Ts, noise, substeps=substeps, numba=numba)


def _angles(given: list[str] | dict[str, float] | None, plant: Ode, names: Mapping[str, None]) -> Mapping[str, float]:
    """Return the periods of the states and outputs that are angles, those of the plant unless some are given."""
    if given is None:
        return plant.angles
    for name in given:
        if name not in names:
            raise DesignError(unknown(name, names, "state or output of this model"), "angles")
    return given if isinstance(given, dict) else dict.fromkeys(given, 2.0 * np.pi)


def _named(given: Names | None, plant: Ode | None, key: str, letter: str) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return names with their units; those of the plant, whose units are known, unless some are given."""
    if given is not None:
        return names_of(given, key, letter)
    if plant is None:
        raise DesignError("name them, or give their number: the plant is no ODE plant", key)
    return getattr(plant, key), {}
