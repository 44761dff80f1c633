"""Limits of the inputs u(k)..u(k+Np-1) and of predicted signals as rows of a program.

Units   Hard rows are in units of high - low, soft ones in units of their `scale`.
Order   Limits of the inputs, limits of their increments, then the limited signals, sample by sample.
Shared  By the laws of gpc_law.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.controllers.limits import Bounds, SoftLimit, SoftRows, soft_rows
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.tracking import Path
from rmpc_bench.types import Array, PlantInfo


class HardRows(NamedTuple):
    """Limits of the inputs: rows low <= a U + before u(k-1) <= high."""

    a: Float[Array, "rows inputs"]
    before: Float[Array, "rows nu"]
    low: Float[Array, " rows"]
    high: Float[Array, " rows"]
    unit: Float[Array, " rows"]

    @classmethod
    def of(cls, u: Bounds, du: Bounds, N: int) -> HardRows:
        """Return the rows of a horizon; those without a finite bound are left out."""
        nu = len(u.low)
        every = np.eye(N * nu)
        a = np.vstack([every, every - np.eye(N * nu, k=-nu)])
        before = np.zeros((2 * N * nu, nu))
        before[N * nu : (N + 1) * nu] = -np.eye(nu)
        low, high = (np.concatenate([np.tile(of_u, N), np.tile(of_du, N)]) for of_u, of_du in zip(u, du, strict=True))
        limited = np.isfinite(low) | np.isfinite(high)
        rows = (a, before, low, high, _unit(low, high))
        return cls(*(np.ascontiguousarray(each[limited]) for each in rows))


class SignalRows(NamedTuple):
    """Soft limits of the signals Z x(k+j) + constant; axis 0 of `limited` is j."""

    Z: Float[Array, "nz nx"]
    constant: Float[Array, " nz"]
    low: Float[Array, " nz"]
    high: Float[Array, " nz"]
    unit: Float[Array, " nz"]
    linear: Float[Array, " nz"]
    quadratic: Float[Array, " nz"]
    limited: Bool[Array, "N nz"]  # which predicted samples are limited

    @classmethod
    def of(cls, soft: tuple[SoftRows, ...], nx: int, N: int) -> SignalRows:
        """Return the rows of all signals, whose states may be fewer than the nx states of the predictions."""
        if not soft:
            none = np.zeros(0)
            return cls(np.zeros((0, nx)), none, none, none, none, none, none, np.zeros((N, 0), dtype=bool))
        Z = np.vstack([np.pad(each.signal.Z, ((0, 0), (0, nx - each.signal.Z.shape[1]))) for each in soft])
        low, high = (np.concatenate([each.bounds[side] for each in soft]) for side in (0, 1))
        sizes = [len(each.signal.Z) for each in soft]
        linear, quadratic, steps = (
            np.repeat([getattr(each, name) for each in soft], sizes) for name in ("linear", "quadratic", "steps")
        )
        limited = (np.arange(N)[:, None] < steps) & (np.isfinite(low) | np.isfinite(high))
        constant, unit = (
            np.concatenate(each) for each in zip(*((s.signal.constant, s.scale) for s in soft), strict=True)
        )
        return cls(Z, constant, low, high, unit, linear, quadratic, limited)

    def spread(self, values: Float[Array, " nz"]) -> Float[Array, " rows"]:
        """Repeat what belongs to a signal for its limited samples, sample by sample."""
        repeated: Array = np.broadcast_to(values, self.limited.shape)[self.limited]
        return repeated


class Limited(NamedTuple):
    """All rows of a horizon; create them with `of`."""

    hard: HardRows  # limits of the inputs
    signals: SignalRows  # limits of signals
    unit: Float[Array, " rows"]
    low: Float[Array, " rows"]
    high: Float[Array, " rows"]
    soft: Bool[Array, " rows"]
    weights: tuple[Float[Array, " rows"], Float[Array, " rows"]]  # linear and quadratic ones of the slacks

    @classmethod
    def of(cls, hard: HardRows, signals: SignalRows) -> Limited:
        """Put the rows of the signals below those of the inputs, whose weights 0 and 1 are not used."""
        n, spread = len(hard.unit), signals.spread
        unit, low, high = (
            np.concatenate([getattr(hard, name), spread(getattr(signals, name))]) for name in ("unit", "low", "high")
        )
        linear = np.concatenate([np.zeros(n), spread(signals.linear)])
        quadratic = np.concatenate([np.ones(n), spread(signals.quadratic)])
        return cls(hard, signals, unit, low, high, np.arange(len(unit)) >= n, (linear, quadratic))

    def rows(self, U: Float[Array, "N nu columns"], X: Float[Array, "N nx columns"]) -> Float[Array, "rows columns"]:
        """Return all rows, without constants and u(k-1), for inputs and states as functions of something."""
        z = np.einsum("im,jmn->jin", self.signals.Z, X)
        return np.vstack([self.hard.a @ U.reshape(-1, U.shape[2]), z[self.signals.limited]])

    def values(self, path: Path, u_previous: Float[Array, "runs nu"]) -> Float[Array, "runs rows"]:
        """Return all rows at given inputs and states."""
        n_runs, N, nx = path.X.shape
        signals = self.signals
        z = mv(signals.Z, path.X.reshape(-1, nx)).reshape(n_runs, N, -1) + signals.constant
        inputs = mv(self.hard.a, path.U.reshape(n_runs, -1)) + mv(self.hard.before, u_previous)
        return np.hstack([inputs, z[:, signals.limited]])


def _unit(low: Float[Array, " rows"], high: Float[Array, " rows"]) -> Float[Array, " rows"]:
    """Return the spans of the bounds; the size of the only finite bound where there is one, and 1 if that is 0."""
    sizes = np.array([low, high])
    size = np.abs(np.where(np.isfinite(sizes), sizes, 0.0)).max(axis=0)
    with np.errstate(invalid="ignore"):
        unit: Array = np.where(np.isfinite(high - low), high - low, np.where(size > 0.0, size, 1.0))
    return unit


@dataclass(frozen=True, eq=False)
class LimitedHorizon:
    """Rows of every sample."""

    model: Any  # design model
    nx: int  # number of states of the predictions, of which those of the model are the first
    hard: HardRows  # limits of the inputs
    soft: Mapping[str, SoftLimit]  # name of a signal -> its limit
    N: int  # horizon [samples]
    plant_info: PlantInfo | None = None  # names of the plant

    def at(self, k: int) -> Limited:
        """Return the rows at k; only those of outputs of a time-varying model depend on k."""
        fixed = not self.soft or isinstance(self.model, StateDependentModel | LinearModel)
        return self._first if fixed or k == 0 else self._made(k)

    @cached_property
    def _first(self) -> Limited:
        return self._made(0)

    def _made(self, k: int) -> Limited:
        soft = self._soft(k) if self.soft else {}
        return Limited.of(self.hard, SignalRows.of(tuple(soft.values()), self.nx, self.N))

    def _soft(self, k: int) -> dict[str, SoftRows]:
        model, info, nd = self.model, self.plant_info, self.model.n_disturbances
        if not isinstance(model, StateDependentModel):
            return soft_rows(self.soft, model.at(k), self.N, info, nd)
        if not model.has_offsets:
            return soft_rows(self.soft, _readout(model.C, model.extra_signals), self.N, info, nd)
        # The predictions have the outputs and a 1 as states after those of the model.
        nx, ny = model.nx, model.ny
        C = np.eye(ny, nx + ny + 1, k=nx)
        signals = {name: np.pad(Z, ((0, 0), (0, ny + 1))) for name, Z in model.extra_signals.items()}
        return soft_rows(self.soft, _readout(C, signals), self.N, info, nd + ny + 1)


def _readout(C: Float[Array, "ny nx"], signals: Mapping[str, Array]) -> LinearModel:
    """Return a model that stands for the signals of another one."""
    ny, nx = C.shape
    return LinearModel(np.eye(nx), np.zeros((nx, 1)), C, np.zeros((nx, nx)), np.eye(ny), extra_signals=signals)
