"""Linear and nonlinear models with disturbances as further states.

Kinds   linear            the augmented matrices (models/disturbance.py)
        varying with k    those of every k
        nonlinear         f(x, u + S d) + N d, h(x) + C_d d
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from rmpc_bench.models.disturbance import Entry, augmented, block_diagonal, padded_signals
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.numerics.jacobian import jacobian
from rmpc_bench.types import Array, Model, OperatingPoint


class Augmented:
    """What models with disturbances have in common; a subclass gives `undisturbed` and `entry`.

    Parameters
    ----------
    undisturbed : model of x
    entry : how d enters it
    label : places, drift and rank in words
    """

    undisturbed: Any
    entry: Entry
    label: str

    @property
    def n_disturbances(self) -> int:
        """Number of disturbances."""
        return self.entry.nd

    @property
    def D0(self) -> Float[Array, "nd nd"]:
        """Covariance of d(0)."""
        return self.entry.D0

    @property
    def extra_signals(self) -> Mapping[str, Float[Array, "nz n"]]:
        """Signals of x, which do not depend on d."""
        return padded_signals(self.undisturbed.extra_signals, self.entry.nd)

    @property
    def operating_point(self) -> OperatingPoint | None:
        """Operating point with d = 0."""
        point = self.undisturbed.operating_point
        return None if point is None else OperatingPoint(self.entry.padded(point.x), point.u, point.y)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Those of the model of x."""
        remarks: tuple[str, ...] = self.undisturbed.remarks
        return remarks

    def facts(self) -> list[tuple[str, str]]:
        """Those of the model of x, and the disturbances."""
        return [*self.undisturbed.facts(), ("disturbance", self.label)]

    def warm_up(self) -> None:
        """Do that of the model of x."""
        self.undisturbed.warm_up()


class DisturbedLinear(Augmented, LinearModel):
    """A linear model of [x; d], the same at all k."""

    def __init__(self, undisturbed: LinearModel, entry: Entry, label: str = "") -> None:
        made = augmented(undisturbed, entry)
        own = {"undisturbed": undisturbed, "entry": entry, "label": label}
        same = {name: getattr(made, name) for name in ("A", "B", "C", "Q_w", "R_v", "S_wv", "f0", "d0")}
        for name, value in {**own, **same}.items():
            object.__setattr__(self, name, value)

    disturbance_inputs: Mapping[str, Array] = {}

    @property
    def deviation(self) -> Model:
        """The model of x - x_op, u - u_op and y - y_op, with the same d."""
        within = self.undisturbed.deviation
        return self if within is self.undisturbed else DisturbedLinear(within, self.entry, self.label)


@dataclass(frozen=True, eq=False)
class DisturbedModel(Augmented, Model):
    """A model of [x; d] that may vary with k."""

    undisturbed: Model
    entry: Entry
    label: str = ""
    _made: dict[int, tuple[LinearModel, LinearModel]] = field(default_factory=dict, init=False, repr=False)
    """Cache of the linear models by k: that of x and that of [x; d]."""

    @property
    def nx(self) -> int:
        """Number of states and disturbances."""
        return self.undisturbed.nx + self.entry.nd

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return self.undisturbed.nu

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return self.undisturbed.ny

    @property
    def varies(self) -> bool:
        """Whether a matrix depends on k."""
        return self.undisturbed.varies

    @property
    def Q_w(self) -> Float[Array, "n n"]:
        """Covariance of the process noise and of the drift."""
        return block_diagonal(self.undisturbed.Q_w, self.entry.drift)

    @property
    def R_v(self) -> Float[Array, "ny ny"]:
        """Covariance of the measurement noise."""
        return self.undisturbed.R_v

    @property
    def has_sets(self) -> bool:
        """Whether the noises have bounded parts."""
        return self.undisturbed.has_sets

    @property
    def deviation(self) -> Model:
        """The model of x - x_op, u - u_op and y - y_op, with the same d."""
        within = self.undisturbed.deviation
        if within is self.undisturbed:
            return self
        if isinstance(within, LinearModel):
            return DisturbedLinear(within, self.entry, self.label)
        return DisturbedModel(within, self.entry, self.label)

    def at(self, k: int) -> LinearModel:
        """Return the linear model at k."""
        now = self.undisturbed.at(k)
        k = k if self.varies else 0
        if k not in self._made or self._made[k][0] is not now:
            self._made[k] = now, augmented(now, self.entry)
        return self._made[k][1]

    def M_w(self, k: int) -> Float[Array, "n n"]:
        """Return the shape of the set of the process noise; the drift has no bounded part."""
        nd = self.entry.nd
        return block_diagonal(self.undisturbed.M_w(k), np.zeros((nd, nd)))

    def M_v(self, k: int) -> Float[Array, "ny ny"]:
        """Return the shape of the set of the measurement noise."""
        return self.undisturbed.M_v(k)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without the cache."""
        return {**vars(self), "_made": {}}


class DisturbedNonlinear(DisturbedModel):
    """A model of [x; d] with functions f and h, for estimators and controllers of a user."""

    undisturbed: NonlinearModel

    @property
    def Ts(self) -> float:
        """Sampling time [s]."""
        return float(self.undisturbed.Ts)

    @property
    def limits(self) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """Lower and upper bounds of the states; d has none."""
        low, high = self.undisturbed.limits
        free = np.full(self.entry.nd, np.inf)
        return np.concatenate([low, -free]), np.concatenate([high, free])

    def f(
        self, x: ArrayLike, u: ArrayLike, k: int = 0, near: tuple[ArrayLike, ArrayLike] | None = None
    ) -> Float[Array, "*m n"]:
        """Return [x; d](k+1) without noise, of one state and input or of one per row; `near` as in NonlinearModel.f."""
        (x, d), at = self._parts(x), None
        if near is not None:
            state, offset = self._parts(near[0])
            at = state, np.atleast_1d(np.asarray(near[1], dtype=float)) + offset @ self.entry.S.T
        moved = self.undisturbed.f(x, np.atleast_1d(np.asarray(u, dtype=float)) + d @ self.entry.S.T, k, at)
        return np.concatenate([moved + d @ self.entry.N.T, d], axis=-1)

    def h(self, x: ArrayLike) -> Float[Array, "*m ny"]:
        """Return y without noise, of one state or of one per row."""
        x, d = self._parts(x)
        measured: Array = self.undisturbed.h(x) + d @ self.entry.C_d.T
        return measured

    def F(self, x: ArrayLike, u: ArrayLike, k: int = 0) -> Float[Array, "n n"]:
        """Return the Jacobian of f with respect to [x; d]."""
        return jacobian(lambda z: self.f(z, u, k, (x, u)), np.asarray(x, dtype=float))

    def H(self, x: ArrayLike) -> Float[Array, "ny n"]:
        """Return the Jacobian of h."""
        return jacobian(self.h, np.asarray(x, dtype=float))

    def _parts(self, x: ArrayLike) -> tuple[Array, Array]:
        both, nx = np.asarray(x, dtype=float), self.undisturbed.nx
        return both[..., :nx], both[..., nx:]
