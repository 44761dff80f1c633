"""Base class of design models: what estimators and controllers assume of the plant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.types.basics import Array, attribute
from rmpc_bench.types.errors import DesignError
from rmpc_bench.types.records import OperatingPoint


class Model:
    """A design model; at every k it is a linear model (`models.linear.LinearModel`), possibly another one.

    A subclass gives the method `at`.  Everything else has a default.
    """

    @attribute
    def nx(self) -> int:
        """Number of states."""
        return int(self.at(0).nx)

    @attribute
    def nu(self) -> int:
        """Number of inputs."""
        return int(self.at(0).nu)

    @attribute
    def ny(self) -> int:
        """Number of outputs."""
        return int(self.at(0).ny)

    @attribute
    def varies(self) -> bool:
        """Whether the linear model depends on k."""
        return False

    @attribute
    def feedthrough(self) -> bool:
        """Whether y(k) depends on u(k): by D, or by h(x, u) of a nonlinear model."""
        within = self.undisturbed
        return within.feedthrough if within is not self else self.is_linear_model and bool(self.at(0).D.any())

    def refuse_feedthrough(self, kind: str) -> None:
        """Raise a DesignError where a method counts with y(k) = C x(k)."""
        if self.feedthrough:
            raise DesignError(f"{kind} needs a model without feedthrough: y(k) must not depend on u(k)", "kind")

    @attribute
    def is_linear_model(self) -> bool:
        """Whether it is itself a linear model, the same at all k, with the matrices A, B, C, Q_w and R_v."""
        return False

    @attribute
    def A(self) -> Float[Array, "nx nx"]:
        """State matrix of a model that is the same at all k."""
        return self._constant("A")

    @attribute
    def B(self) -> Float[Array, "nx nu"]:
        """Input matrix of a model that is the same at all k."""
        return self._constant("B")

    @attribute
    def C(self) -> Float[Array, "ny nx"]:
        """Output matrix of a model that is the same at all k."""
        return self._constant("C")

    @attribute
    def f0(self) -> Float[Array, " nx"]:
        """Constant part of x(k+1) of a model that is the same at all k."""
        return self._constant("f0")

    @attribute
    def d0(self) -> Float[Array, " ny"]:
        """Constant part of y(k) of a model that is the same at all k."""
        return self._constant("d0")

    @attribute
    def Q_w(self) -> Float[Array, "nx nx"]:
        """Covariance of the process noise at k = 0."""
        covariance: Array = self.at(0).Q_w
        return covariance

    @attribute
    def R_v(self) -> Float[Array, "ny ny"]:
        """Covariance of the measurement noise at k = 0."""
        covariance: Array = self.at(0).R_v
        return covariance

    @attribute
    def R_v_varies(self) -> bool:
        """Whether a state-dependent model has another covariance of the measurement noise at some k."""
        return False

    @attribute
    def w_law(self) -> tuple[Float[Array, " nw"], Float[Array, "nw nw"]]:
        """Mean and covariance of the process noise of the plant, as `noise: same` takes them."""
        return np.zeros(self.nx), self.Q_w

    @attribute
    def v_law(self) -> tuple[Float[Array, " nv"], Float[Array, "nv nv"]]:
        """Mean and covariance of the measurement noise of the plant, as `noise: same` takes them."""
        return np.zeros(self.ny), self.R_v

    @attribute
    def S(self) -> Float[Array, "nw nv"] | float:
        """Cross-covariance of the noises of the plant, as `noise: same` takes it; 0 without correlation."""
        return 0.0

    @attribute
    def has_sets(self) -> bool:
        """Whether the noises have bounded parts, in the ellipsoids E(0, M_w) and E(0, M_v)."""
        return False

    @attribute
    def remarks(self) -> tuple[str, ...]:
        """Sentences for the user about this model; `check` prints them."""
        return ()

    @attribute
    def extra_signals(self) -> Mapping[str, Float[Array, "nz nx"]]:
        """Signals besides x and y that limits may name, such as a shaft torque: name -> Z of z = Z x."""
        return {}

    @attribute
    def disturbance_inputs(self) -> Mapping[str, Float[Array, "nx nd"]]:
        """Places besides `input` and `output` where a disturbance may enter, such as the load: name -> B_d."""
        return {}

    @attribute
    def n_disturbances(self) -> int:
        """Number of estimated disturbances, which are the last states."""
        return 0

    @attribute
    def undisturbed(self) -> Model:
        """The model without its disturbances; the model itself if it has none."""
        return self

    @attribute
    def D0(self) -> Float[Array, "nd nd"]:
        """Covariance of the disturbances at k = 0."""
        return np.zeros((self.n_disturbances, self.n_disturbances))

    @attribute
    def operating_point(self) -> OperatingPoint | None:
        """Point around which the model is linear; None for a model without one, whose equations hold everywhere."""
        return None

    @attribute
    def x_op(self) -> Float[Array, " nx"]:
        """State of the operating point; 0 without one."""
        return np.zeros(self.nx) if self.operating_point is None else self.operating_point.x

    @attribute
    def u_op(self) -> Float[Array, " nu"]:
        """Input of the operating point; 0 without one."""
        return np.zeros(self.nu) if self.operating_point is None else self.operating_point.u

    @attribute
    def y_op(self) -> Float[Array, " ny"]:
        """Output at the operating point; 0 without one."""
        return np.zeros(self.ny) if self.operating_point is None else self.operating_point.y

    @attribute
    def deviation(self) -> Model:
        """The model of x - x_op, u - u_op and y - y_op; the model itself without an operating point."""
        return self

    @attribute
    def flow(self) -> Any:
        """The model as maps of many states at once (`models.flow.Flow`); None for a model that is linear at every k."""
        return None

    @attribute
    def y_period(self) -> Float[Array, " ny"] | None:
        """Period of every output of a model with its own `angles`, 0 without one; None for those of the plant."""
        return None

    def measured(self, k: int, x: Float[Array, "runs nx"]) -> Float[Array, "runs ny"]:
        """Return y(k) of states without noise."""
        now = self.at(k)
        y: Array = np.einsum("ij,rj->ri", now.C, x) + now.d0
        return y

    def start(self, x0: Float[Array, " nx"], P0: Float[Array, "nx nx"], M0: Float[Array, "nx nx"]) -> dict[str, Array]:
        """Return x0, P0 and M0 of estimators: the disturbances have mean 0, covariance D0 and no bounded part.

        Parameters
        ----------
        x0, P0, M0 : mean, covariance and shape of the bounded part of x(0), without disturbances
        """
        nd, n = self.n_disturbances, len(x0)
        if not nd:
            return {"x0": x0, "P0": P0, "M0": M0}
        P = np.pad(P0, (0, nd))
        P[n:, n:] = self.D0
        return {"x0": np.pad(x0, (0, nd)), "P0": P, "M0": np.pad(M0, (0, nd))}

    def _constant(self, name: str) -> Array:
        """Return a matrix of the linear model; an AttributeError where it depends on k."""
        if self.varies:
            raise AttributeError(f"{name} of this model depends on k; use model.at(k).{name}")
        matrix: Array = getattr(self.at(0), name)
        return matrix

    def at(self, k: int, /) -> Any:
        """Return the linear model at k."""
        raise NotImplementedError("at")

    def facts(self) -> list[tuple[str, str]]:
        """Properties of the model that are known before any run, as (label, text); `check` prints them."""
        return []

    def M_w(self, k: int, /) -> Float[Array, "nx nx"]:
        """Shape of the ellipsoid of the bounded process noise at k; zero without `has_sets`."""
        return np.zeros_like(self.at(k).Q_w)

    def M_v(self, k: int, /) -> Float[Array, "ny ny"]:
        """Shape of the ellipsoid of the bounded measurement noise at k; zero without `has_sets`."""
        return np.zeros_like(self.at(k).R_v)

    def warm_up(self) -> None:
        """Do costly work that workers share, such as compiling; doing it again costs nothing."""
