"""Design models as maps of many states at once, for filters that evaluate the nonlinear model at points.

Model   x(k+1) = f_k(x(k), u(k)) + w(k), w ~ N(0, Q_w);  y(k) = h_k(x(k)) + v(k), v ~ N(0, R_v);  white, independent.
        A flow may have more states than the design model (the servomechanism: the current).  Those of the design model
        come first, and controllers get those only.
Limit   The flow of a linear model is f(x, u) = A x + B u + f0, h(x) = C x + d0.
Cost    A right-hand side that takes blocks is called once per stage for all points; otherwise once per stage and point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.dynamics import OUTSIDE_DOMAIN, LinearDynamics, OdeDynamics, OfPlant
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.ode_functions import padded, rows
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.numerics.intervals import Interval
from rmpc_bench.numerics.linalg import driven, mv
from rmpc_bench.types import Array, DesignError, Model


class Flow:
    """Base class of the maps of a design model.

    A subclass gives the methods `advance` and `measure`, and `Q_w` and `R_v` or the methods that return them at k; it
    may give the others.
    """

    Q_w: Float[Array, "n n"]
    R_v: Float[Array, "ny ny"]
    cost_per_point: float = 0.0
    """Time of `advance` per state in a large block [s]."""
    x_period: Float[Array, " n"] | None = None
    """Period of every state, 0 of one that is no angle; None where none is: see `types.angles.wrapped`."""
    y_period: Float[Array, " ny"] | None = None
    """The same of the outputs."""
    fed: bool = False
    """Whether h depends on u(k)."""
    limits: Interval | None = None
    """Bounds of the states; None where there are none."""
    varies: bool = False
    """Whether the maps depend on k."""
    adaptive: bool = False
    """Whether the points of a run decide together on the intervals of the integration."""

    def advance(self, k: int, x: Float[Array, "points n"], u: Float[Array, "points nu"]) -> Float[Array, "points n"]:
        """Return x(k+1) without noise; NaN where it is not defined."""
        raise NotImplementedError("advance")

    def advance_points(
        self, k: int, x: Float[Array, "runs points n"], u: Float[Array, "runs nu"], leading: int | None = None
    ) -> Float[Array, "runs points n"]:
        """Return x(k+1) of several points of every run, the first of which is its estimate.

        The first `leading` of them, otherwise all, decide on the intervals of the integration.
        """
        runs, points, n = x.shape
        moved = self._moved(k, x.reshape(-1, n), np.repeat(u, points, axis=0), points, leading)
        return moved.reshape(runs, points, n)

    def _moved(self, k: int, x: Array, u: Array, points: int, leading: int | None) -> Float[Array, "columns n"]:
        """Return x(k+1) of points of all runs; those of a run come one after the other."""
        return self.advance(k, x, u)

    def measure(self, k: int, x: Float[Array, "points n"], *u: Float[Array, "points nu"]) -> Float[Array, "points ny"]:
        """Return y(k) without noise; NaN where it is not defined; u is given where `fed`."""
        raise NotImplementedError("measure")

    def Q_w_at(self, k: int) -> Float[Array, "n n"]:
        """Covariance of the process noise from k to k+1."""
        return self.Q_w

    def R_v_at(self, k: int) -> Float[Array, "ny ny"]:
        """Covariance of the measurement noise at k."""
        return self.R_v

    def A_at(self, k: int) -> Float[Array, "n n"] | None:
        """Transition matrix from k to k+1 of a linear model; None for a nonlinear one."""
        return None

    def C_at(self, k: int) -> Float[Array, "ny n"] | None:
        """Output matrix at k of a linear output; None for a nonlinear one."""
        return None

    def start(
        self, x0: Float[Array, " nx"], P0: Float[Array, "nx nx"]
    ) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
        """Return mean and covariance of the state of the flow at k = 0."""
        return x0, P0

    def warm_up(self) -> None:
        """Compile."""


@dataclass(frozen=True, eq=False)
class LinearFlow(Flow):
    """A linear model, which may depend on k."""

    model: Model
    varies = property(lambda self: self.model.varies)

    def advance(self, k: int, x: Float[Array, "points n"], u: Float[Array, "points nu"]) -> Float[Array, "points n"]:
        """Return A x + B u + f0."""
        now: LinearModel = self.model.at(k)
        return mv(now.A, x) + driven(now.B, u) + now.f0

    def measure(self, k: int, x: Float[Array, "points n"], *u: Float[Array, "points nu"]) -> Float[Array, "points ny"]:
        """Return C x + d0, and D u where u is given; estimators get y - D u."""
        now: LinearModel = self.model.at(k)
        return mv(now.C, x) + now.d0 + (mv(now.D, *u) if u else 0.0)

    def Q_w_at(self, k: int) -> Float[Array, "n n"]:
        """Covariance of the process noise from k to k+1."""
        return self.model.at(k).Q_w

    def R_v_at(self, k: int) -> Float[Array, "ny ny"]:
        """Covariance of the measurement noise at k."""
        return self.model.at(k).R_v

    def A_at(self, k: int) -> Float[Array, "n n"] | None:
        """Transition matrix at k."""
        return self.model.at(k).A

    def C_at(self, k: int) -> Float[Array, "ny n"] | None:
        """Output matrix at k."""
        return self.model.at(k).C


@dataclass(frozen=True, eq=False)
class PlantFlow(OfPlant, Flow):
    """The nominal plant, integrated over a sample by the Runge-Kutta method of order 4, or its map."""

    compiled: Any = None  # model whose method ``f(x, u, k)`` is compiled; None where there is none

    varies = property(lambda self: isinstance(self.dynamics, OdeDynamics) and self.dynamics.ode.timed)
    adaptive = property(lambda self: self.dynamics.continuous and not self.substeps)
    x_period = property(lambda self: self.dynamics.x_period)
    fed = property(lambda self: self.dynamics.fed)

    @property
    def cost_per_point(self) -> float:  # type: ignore[override]
        """Time of `advance` per state in a large block [s], roughly."""
        if self.compiled is not None or isinstance(self.dynamics, LinearDynamics):
            return 3e-6
        in_blocks = isinstance(self.dynamics, OdeDynamics) and self.dynamics.ode.rhs_takes_blocks
        return (self.substeps or 3) * (1e-6 if in_blocks else 3e-5)

    def advance(self, k: int, x: Float[Array, "points n"], u: Float[Array, "points nu"]) -> Float[Array, "points n"]:
        """Return x(k+1) without noise; NaN where the plant is not defined."""
        return self._moved(k, x, u, 1, None)

    def _moved(self, k: int, x: Array, u: Array, points: int, leading: int | None) -> Float[Array, "columns n"]:
        """Return x(k+1) of points of all runs, which use the intervals that all of the run, or the first, need."""
        dynamics = self.dynamics
        if isinstance(dynamics, LinearDynamics):
            return mv(dynamics.A, x) + driven(dynamics.B, u)
        if self.compiled is not None:
            states, inputs = (each.reshape(len(x) // points, points, each.shape[1]) for each in (x, u))
            found = _each(lambda i: self.compiled.points(k, states[i], inputs[i], leading), states.shape)
            return found.reshape(x.shape)
        with np.errstate(all="ignore"):
            return dynamics.advance(k, x, u, self.Ts, self.substeps, points, leading, strict=False)

    def measure(self, k: int, x: Float[Array, "points n"], *u: Float[Array, "points nu"]) -> Float[Array, "points ny"]:
        """Return y(k) without noise; NaN where it is not defined."""
        C, dynamics, shape = self.C_at(k), self.dynamics, (len(x), len(self.R_v))
        if C is not None:
            return mv(C, x) + mv(np.asarray(dynamics.D), *u) if isinstance(dynamics, LinearDynamics) and u else mv(C, x)
        inputs = u[0] if u else np.zeros((len(x), 0))
        if isinstance(dynamics, OdeDynamics) and dynamics.ode.output_takes_blocks:
            ode, columns = dynamics.ode, padded(x)
            try:
                with np.errstate(all="ignore"):
                    y = ode.measure(columns, padded(inputs), _nominal(dynamics, columns))
                    return np.ascontiguousarray(y[:, : len(x)].T)
            except OUTSIDE_DOMAIN:
                pass
        return _each(lambda i: dynamics.output(x[i], inputs[i]), shape)

    def A_at(self, k: int) -> Float[Array, "n n"] | None:
        """Transition matrix of a plant with matrices."""
        return self.dynamics.A if isinstance(self.dynamics, LinearDynamics) else None

    def C_at(self, k: int) -> Float[Array, "ny n"] | None:
        """Output matrix of a plant with matrices, and of one whose states are all measured."""
        if isinstance(self.dynamics, LinearDynamics):
            return self.dynamics.C
        if isinstance(self.dynamics, OdeDynamics) and self.dynamics.ode.output is None:
            return np.eye(len(self.Q_w))
        return None

    @property
    def limits(self) -> Interval | None:  # type: ignore[override]
        """Bounds of the states of the plant."""
        found = Interval(*self.dynamics.signals.limits(self.dynamics.signals.states))
        return found if found.bounded.any() else None

    def warm_up(self) -> None:
        """Compile."""
        if self.compiled is not None:
            self.compiled.warm_up()


def _nominal(dynamics: OdeDynamics, columns: Float[Array, "n width"]) -> Any:
    """Return the nominal parameters as rows over the points, the form for which functions have been tested."""
    numbers = np.array(list(dynamics.ode.nominal.values()), dtype=float)
    return rows(dynamics.ode.nominal, np.repeat(numbers[:, None], columns.shape[1], axis=1))


def _each(make: Callable[[int], Array], shape: tuple[int, ...]) -> Array:
    """Fill an array row by row; a row where the function is not defined is NaN."""
    found = np.full(shape, np.nan)
    with np.errstate(all="ignore"):
        for i in range(len(found)):
            try:
                found[i] = make(i)
            except OUTSIDE_DOMAIN:
                pass
    return found


@dataclass(frozen=True, eq=False)
class StateFlow(Flow):
    """Predictions of a model whose matrices depend on the state."""

    model: StateDependentModel

    def advance(self, k: int, x: Float[Array, "points n"], u: Float[Array, "points nu"]) -> Float[Array, "points n"]:
        """Return x(k+1), linearised at x where the model has nothing else."""
        if self.model.has_offsets:
            return self.model.advance(k, x, u)
        A, B = self.model.at_state(x)
        return mv(A, x) + mv(B, u)

    def measure(self, k: int, x: Float[Array, "points n"], *u: Float[Array, "points nu"]) -> Float[Array, "points ny"]:
        """Return y(k)."""
        return self.model.measure(x) if self.model.has_offsets else mv(self.model.C, x)


def prediction_flow(model: Model) -> Flow:
    """Return any design model as maps of its states, for predictions; a DesignError where it gives none.

    A nonlinear model with disturbances, or whose flow has further states, gives its linear model.
    """
    if model.flow is not None and len(model.flow.Q_w_at(0)) == model.nx:
        return model.flow
    if isinstance(model, StateDependentModel):
        return StateFlow(model)
    model.at(0)
    return LinearFlow(model)


def flow_of(model: Model) -> Flow:
    """Return a design model as maps of many states."""
    found: Flow | None = model.flow
    if found is not None:
        return found
    if model.undisturbed is not model and model.undisturbed.flow is not None:
        raise DesignError(
            "a filter of the nonlinear model has no disturbance states: leave out `disturbance`, or choose kalman",
            "disturbance",
        )
    if isinstance(model, StateDependentModel):
        raise DesignError(
            "this model gives matrices at a state and no map f(x, u): choose kalman, or a model `nonlinear: plant`, "
            "`linearise: plant` or servo",
            "kind",
        )
    if model.at(0).S_wv.any():
        raise DesignError("the noises w and v of this model are correlated (S_wv): choose kalman-predictor", "kind")
    return LinearFlow(model)
