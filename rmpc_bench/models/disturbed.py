"""Design models of any kind with disturbances as further states.

Kinds   linear            the augmented matrices (models/disturbance.py)
        varying with k    those of every k
        nonlinear         f(x, u + S d) + N d, h(x, u + S d) + C_d d
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from rmpc_bench.models.disturbance import (
    Disturbance,
    Entry,
    augmented,
    block_diagonal,
    entry_of,
    padded_signals,
    refuse_undetectable,
)
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.models.state_dependent import Affine, Pair, StateDependentModel
from rmpc_bench.models.uncertain_linear import UncertainModel
from rmpc_bench.models.uncertain_system import Matrices, UncertainSystem
from rmpc_bench.numerics.jacobian import jacobian
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.types import Array, Model, OperatingPoint


class Augmented:
    """What models with disturbances have in common."""

    undisturbed: Any  # model of x
    entry: Entry  # how d enters it
    label: str  # places, drift and rank in words

    def __init__(self, undisturbed: Any, entry: Entry, label: str = "") -> None:
        vars(self).update(undisturbed=undisturbed, entry=entry, label=label)

    n_disturbances = property(lambda self: self.entry.nd)
    D0 = property(lambda self: self.entry.D0)
    remarks = property(lambda self: self.undisturbed.remarks)

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
    def deviation(self) -> Model:
        """The model of x - x_op, u - u_op and y - y_op, with the same d."""
        within = self.undisturbed.deviation
        return self if within is self.undisturbed else disturbed(within, self.entry, self.label)  # type: ignore[return-value]

    def facts(self) -> list[tuple[str, str]]:
        """Those of the model of x, and the disturbances."""
        return [*self.undisturbed.facts(), ("disturbance", self.label)]

    def warm_up(self) -> None:
        """Do that of the model of x."""
        self.undisturbed.warm_up()


class DisturbedLinear(Augmented, LinearModel):
    """A linear model of [x; d], the same at all k."""

    def __init__(self, undisturbed: LinearModel, entry: Entry, label: str = "") -> None:
        super().__init__(undisturbed, entry, label)
        vars(self).update(vars(augmented(undisturbed, entry)))


class AugmentedWhenAsked(Augmented):
    """A model with disturbances whose sizes and covariances are not stored."""

    nx = property(lambda self: self.undisturbed.nx + self.entry.nd)
    nu = property(lambda self: self.undisturbed.nu)
    ny = property(lambda self: self.undisturbed.ny)
    Q_w = property(lambda self: block_diagonal(self.undisturbed.Q_w, self.entry.drift))
    R_v = property(lambda self: self.undisturbed.R_v)


class DisturbedModel(AugmentedWhenAsked, Model):
    """A model of [x; d] that may vary with k."""

    varies = property(lambda self: self.undisturbed.varies)
    has_sets = property(lambda self: self.undisturbed.has_sets)

    @cached_property
    def _made(self) -> dict[int, tuple[LinearModel, LinearModel]]:
        """Cache of the linear models by k: that of x and that of [x; d]."""
        return {}

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

    Ts = property(lambda self: self.undisturbed.Ts)

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

    def h(self, x: ArrayLike, u: ArrayLike = ()) -> Float[Array, "*m ny"]:
        """Return y without noise, of a state or of one per row; u, the same for all, where the output takes it."""
        x, d = self._parts(x)
        if self.feedthrough:
            acting = np.atleast_2d(np.atleast_1d(np.asarray(u, dtype=float)) + d @ self.entry.S.T)
            rows = [self.undisturbed.h(*each) for each in zip(np.atleast_2d(x), acting, strict=True)]
            of_x = np.reshape(rows, (*x.shape[:-1], self.ny))
        else:
            of_x = self.undisturbed.h(x)
        return of_x + d @ self.entry.C_d.T

    def F(self, x: ArrayLike, u: ArrayLike, k: int = 0) -> Float[Array, "n n"]:
        """Return the Jacobian of f with respect to [x; d]."""
        return jacobian(lambda z: self.f(z, u, k, (x, u)), np.asarray(x, dtype=float))

    def H(self, x: ArrayLike, u: ArrayLike = ()) -> Float[Array, "ny n"]:
        """Return the Jacobian of h with respect to [x; d]."""
        return jacobian(lambda z: self.h(z, u), np.asarray(x, dtype=float))

    def _parts(self, x: ArrayLike) -> tuple[Array, Array]:
        both, nx = np.asarray(x, dtype=float), self.undisturbed.nx
        return both[..., :nx], both[..., nx:]


# State-dependent model with disturbances as further states.
#
# Model   The matrices are those at the estimate of x; d enters by B(x) where it is at the input.  A model that is
#         linearised along the trajectory is linearised at x and u + S d.


class DisturbedStates(AugmentedWhenAsked, StateDependentModel):
    """A state-dependent model of [x; d]."""

    has_offsets = property(lambda self: self.undisturbed.has_offsets)
    R_v_varies = property(lambda self: self.undisturbed.R_v_varies)

    @property
    def largest(self) -> Float[Array, " n"]:
        """Largest magnitude of every coordinate; the limit of a coordinate of x says nothing about d."""
        nx = self.undisturbed.nx
        return np.concatenate([np.full(nx, self.undisturbed.largest), np.full(self.entry.nd, np.inf)])

    @property
    def C(self) -> Float[Array, "ny n"]:
        """Output matrix."""
        return np.hstack([self.undisturbed.C, self.entry.C_d])

    def R_v_at(self, k: int) -> Float[Array, "ny ny"]:
        """Covariance of the measurement noise at k."""
        return self.undisturbed.R_v_at(k)

    def at_state(self, x: Float[Array, "runs n"]) -> Pair:
        """Sample the model with its matrices frozen at the state of every run."""
        return Pair(*self._pair(*self.undisturbed.at_state(self._parts(x)[0])))

    def around(self, k: int, x: Float[Array, "runs n"], u: Float[Array, "runs nu"]) -> Affine:
        """Linearise at the state, the disturbances and the input of every run."""
        x, d = self._parts(x)
        now = self.undisturbed.around(k, x, u + mv(self.entry.S, d))
        A, B = self._pair(now.A, now.B)
        runs, nd = d.shape
        C = np.concatenate([now.C, np.broadcast_to(self.entry.C_d, (runs, *self.entry.C_d.shape))], axis=2)
        return Affine(A, B, np.hstack([now.f, np.zeros((runs, nd))]), C, now.d)

    def advance(self, k: int, x: Float[Array, "runs n"], u: Float[Array, "runs nu"]) -> Float[Array, "runs n"]:
        """Return x(k+1) of the model without linearisation, and the same d."""
        x, d = self._parts(x)
        moved = self.undisturbed.advance(k, x, u + mv(self.entry.S, d)) + mv(self.entry.N, d)
        return np.hstack([moved, d])

    def measure(self, x: Float[Array, "runs n"]) -> Float[Array, "runs ny"]:
        """Return y of the model without linearisation."""
        x, d = self._parts(x)
        return self.undisturbed.measure(x) + mv(self.entry.C_d, d)

    def _parts(self, x: Float[Array, "runs n"]) -> tuple[Array, Array]:
        nx = self.undisturbed.nx
        return np.ascontiguousarray(x[:, :nx]), np.ascontiguousarray(x[:, nx:])

    def _pair(self, A: Float[Array, "runs nx nx"], B: Float[Array, "runs nx nu"]) -> tuple[Array, Array]:
        runs, nx, nu = B.shape
        full = np.zeros((runs, self.nx, self.nx))
        full[:, :nx, :nx], full[:, :nx, nx:] = A, self.entry.B_d(B)
        full[:, nx:, nx:] = np.eye(self.entry.nd)
        return full, np.concatenate([B, np.zeros((runs, self.entry.nd, nu))], axis=1)


# Uncertain linear model with disturbances as further states.
#
# Model   [x; d] with the uncertainty of x: d is certain, so that rows of H and columns of G are zero.  The drift is a
#         further process noise: w becomes [w; xi].


class DisturbedUncertain(Augmented, UncertainModel):
    """An uncertain linear model of [x; d]: the drift is a further process noise, and d has no uncertainty."""

    def __init__(self, undisturbed: UncertainModel, entry: Entry, label: str = "") -> None:
        super().__init__(undisturbed, entry, label)
        vars(self).update(
            system=augmented_system(undisturbed.system, entry),
            W=block_diagonal(undisturbed.W, entry.drift),
            V=undisturbed.V,
            S=np.vstack([undisturbed.S, np.zeros((entry.nd, len(undisturbed.V)))]),
            wbar=entry.padded(undisturbed.wbar),
            vbar=undisturbed.vbar,
        )


def augmented_system(system: UncertainSystem, entry: Entry) -> UncertainSystem:
    """Return the uncertain system of [x; d] with the noise [w; xi]."""
    m, nd = system.over_time, entry.nd
    A, B_d = _same_times(m.A, entry.B_d(m.B))
    below = np.zeros((len(A), nd, A.shape[2]))
    kept = np.broadcast_to(np.eye(nd), (len(A), nd, nd))
    C, C_d = _same_times(m.C, entry.of_output(m.D))
    Bw = np.pad(m.Bw, ((0, 0), (0, nd), (0, nd)))
    Bw[:, -nd:, -nd:] = np.eye(nd)
    changed = {
        "A": np.concatenate([np.concatenate([A, B_d], axis=2), np.concatenate([below, kept], axis=2)], axis=1),
        "C": np.concatenate([C, C_d], axis=2),
        "Bw": Bw,
        **{name: np.pad(getattr(m, name), ((0, 0), (0, nd), (0, 0))) for name in ("B", "Bv", "H_A", "H_Bw", "H_Bv")},
        **{name: np.pad(getattr(m, name), ((0, 0), (0, 0), (0, nd))) for name in ("Dw", "G_x", "G_w")},
    }
    return UncertainSystem(Matrices(**{**m._asdict(), **changed}))


def _same_times(A: Array, B: Array) -> tuple[Array, Array]:
    """Return two series over k with the same number of entries."""
    n = max(len(A), len(B))
    return tuple(np.broadcast_to(each, (n, *each.shape[1:])) for each in (A, B))  # type: ignore[return-value]


# Adds the disturbances of a configuration to a design model of any kind, and checks that they are detectable.


def disturbed(model: Model, entry: Entry, label: str = "") -> Model:
    """Return a model of any kind with disturbances as further states."""
    kinds = (
        (LinearModel, DisturbedLinear),
        (UncertainModel, DisturbedUncertain),
        (StateDependentModel, DisturbedStates),
        (NonlinearModel, DisturbedNonlinear),
        (Model, DisturbedModel),
    )
    make: Any = next(made for kind, made in kinds if isinstance(model, kind))
    return make(model, entry, label)


def with_disturbance(model: Model, disturbance: Disturbance, n_steps: int, x0: Float[Array, " nx"]) -> Model:
    """Return the design model with the disturbances of a configuration."""
    entry = entry_of(model, disturbance)
    models = _linear_models(model, n_steps, x0)
    rank, needed = refuse_undetectable(models, entry) if models else (0, 0)
    places = disturbance.at if isinstance(disturbance.at, list) else [disturbance.at]
    words = ", ".join(place if isinstance(place, str) else "B_d, C_d" for place in places)
    drift = ", ".join(f"{value:g}" for value in entry.drift.diagonal())
    detectable = f", detectable: rank {rank} of {needed}" if needed else ""
    return disturbed(model, entry, f"at {words}, drift {drift}{detectable}")


def _linear_models(model: Model, n_steps: int, x0: Float[Array, " nx"]) -> list[LinearModel]:
    """Return the linear models with which detectability is checked; none where the model has none."""
    if isinstance(model, StateDependentModel):
        if model.has_offsets:
            low, high = model.dynamics.signals.limits(model.dynamics.signals.inputs)  # type: ignore[attr-defined]
            A, B, f0, C, d0 = (part[0] for part in model.around(0, x0[None], np.clip(0.0, low, high)[None]))
        else:
            (A, B), C = (part[0] for part in model.at_state(x0[None])), model.C
            f0, d0 = np.zeros(model.nx), np.zeros(model.ny)
        fits = all(np.isfinite(part).all() for part in (A, B, C))
        return [LinearModel(A, B, C, model.Q_w, model.R_v, f0=f0, d0=d0)] if fits else []
    if isinstance(model, NonlinearModel) and model.linear_keys is None:
        u0 = np.zeros(model.nu)
        F, B = model.F(x0, u0), jacobian(lambda u: model.f(x0, u, near=(x0, u0)), u0)
        C, D = model.dynamics.seen(x0, u0)
        fits = all(np.isfinite(part).all() for part in (F, B, C, D))
        return [LinearModel(F, B, C, model.Q_w, model.R_v, D=D if model.feedthrough else None)] if fits else []
    return [model.at(k) for k in range(n_steps + 1 if model.varies else 1)]
