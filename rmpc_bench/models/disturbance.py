"""Unknown disturbances in the design model: where they enter, and the linear model that has them as states.

Model   x(k+1) = A x(k) + B u(k) + B_d d(k) + f0 + w(k),  y(k) = C x(k) + C_d d(k) + d0 + v(k),
        d(k+1) = d(k) + xi(k),  xi ~ N(0, drift), white, independent of w and v;  d(0) ~ N(0, D0).
        The state of the augmented model is [x; d].  Predictions with it hold d, so that a control law needs no change.
Places  `input` B_d = B, C_d = D;  `output` C_d = I;  further names are those of the model, such as `load` of the
        servomechanism.
Source  Pannocchia and Rawlings (2003): the augmented model of a detectable (A, C) is detectable if and only if
        rank [A - I, B_d; C, C_d] = nx + nd.  The matrix has nx + ny rows, so that nd <= ny is necessary.
Limit   drift = 0 and D0 = 0 give the estimates of the model without disturbance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import as_vector
from rmpc_bench.numerics.stability import RANK
from rmpc_bench.types import Array, DesignError, Matrix, Model, NonNegative, does_not_fit, row_by_row
from rmpc_bench.types.errors import unknown

INPUT, OUTPUT = "input", "output"
"""Places that every model has."""
SWEEPS = 20
"""Sweeps that scale rows and columns of a matrix to similar sizes."""


@dataclass(frozen=True)
class DisturbanceGains:
    """A place that no model names.

    Parameters
    ----------
    B_d : (nx, nd) how they enter x(k+1); 0 if not given
    C_d : (ny, nd) how they enter y(k); 0 if not given
    """

    B_d: Matrix | None = None
    C_d: Matrix | None = None


@dataclass(frozen=True)
class Disturbance:
    """Disturbances that the estimator estimates and the controller takes into account.

    Parameters
    ----------
    at : `input`, `output`, a name of the model such as `load`, `{B_d: .., C_d: ..}`, or a list
    drift : increase per step of the variance of every disturbance
    D0 : variance of every disturbance at k = 0 (default: drift)
    """

    at: str | DisturbanceGains | list[str | DisturbanceGains]
    drift: NonNegative | list[NonNegative]
    D0: NonNegative | list[NonNegative] | None = None


class Entry(NamedTuple):
    """How nd disturbances enter a model: B_d = B S + N, so that a B that varies has its own B_d."""

    S: Float[Array, "nu nd"]
    N: Float[Array, "nx nd"]
    C_d: Float[Array, "ny nd"]
    drift: Float[Array, "nd nd"]  # covariance of xi
    D0: Float[Array, "nd nd"]  # covariance of d(0)

    @property
    def nd(self) -> int:
        """Number of disturbances."""
        return len(self.drift)

    def padded(self, x: Float[Array, " nx"]) -> Float[Array, " n"]:
        """Return [x; 0]."""
        return np.concatenate([x, np.zeros(self.nd)])

    def B_d(self, B: Float[Array, "*runs nx nu"]) -> Float[Array, "*runs nx nd"]:
        """Return how the disturbances enter x(k+1), for an input matrix or one per run."""
        # Every column of S has a single 1, or none: the product has the numbers of B.
        return np.einsum("...ij,jk->...ik", B, self.S) + self.N

    def of_output(self, D: Float[Array, "*k ny nu"]) -> Float[Array, "*k ny nd"]:
        """Return how the disturbances enter y(k): those of the input through its feedthrough, too."""
        return np.einsum("...ij,jk->...ik", D, self.S) + self.C_d


def entry_of(model: Model, disturbance: Disturbance) -> Entry:
    """Return how the disturbances of a configuration enter a model."""
    places = disturbance.at if isinstance(disturbance.at, list) else [disturbance.at]
    if not places:
        raise DesignError("names no place; leave out `disturbance` for none", "at")
    for number, place in enumerate(places):
        if place in places[:number] and isinstance(place, str):
            raise DesignError(f"names {place!r} twice", "at")
    found = [_placed(model, place) for place in places]
    S, N, C_d = (np.hstack(parts) for parts in zip(*found, strict=True))
    nd = S.shape[1]
    given = {"drift": disturbance.drift, "D0": disturbance.drift if disturbance.D0 is None else disturbance.D0}
    variances = {}
    for name, value in given.items():
        try:
            variances[name] = np.diag(as_vector(value, nd))
        except ValueError as error:
            raise DesignError(f"{error}, one per disturbance", name) from None
    if not (variances["drift"] + variances["D0"]).diagonal().all():
        raise DesignError("a disturbance with drift = 0 and D0 = 0 is always 0; give drift > 0", "drift")
    return Entry(S, N, C_d, variances["drift"], variances["D0"])


def _placed(model: Model, place: str | DisturbanceGains) -> tuple[Array, Array, Array]:
    """Return S, N and C_d of one place."""
    nx, nu, ny = model.nx, model.nu, model.ny
    if isinstance(place, DisturbanceGains):
        N, C_d = _rows("B_d", place.B_d, nx, "state"), _rows("C_d", place.C_d, ny, "output")
        if N is None and C_d is None:
            raise DesignError("give B_d, C_d or both", "at")
        nd = (C_d if N is None else N).shape[1] if N is None or C_d is None else N.shape[1]  # type: ignore[union-attr]
        N, C_d = np.zeros((nx, nd)) if N is None else N, np.zeros((ny, nd)) if C_d is None else C_d
        if C_d.shape[1] != nd:
            raise DesignError(f"B_d has {nd} columns and C_d {C_d.shape[1]}: one per disturbance", "at")
        return np.zeros((nu, nd)), N, C_d
    if place == INPUT and nu:
        return np.eye(nu), np.zeros((nx, nu)), np.zeros((ny, nu))
    if place == OUTPUT:
        return np.zeros((nu, ny)), np.zeros((nx, ny)), np.eye(ny)
    named = model.disturbance_inputs
    if place not in named:
        known = [*([INPUT] if nu else []), OUTPUT, *named]
        raise DesignError(unknown(place, known, "place of this model", "or give {B_d: .., C_d: ..}"), "at")
    N = named[place]
    return np.zeros((nu, N.shape[1])), N, np.zeros((ny, N.shape[1]))


def _rows(name: str, value: Matrix | None, n: int, noun: str) -> Float[Array, "n nd"] | None:
    """Read B_d or C_d: rows, or a number times the identity; None where it is not given or 0."""
    if value is None:
        return None
    try:
        given = np.array(value, dtype=float)
    except ValueError:
        raise DesignError(f"{name} must have rows of the same length", f"at.{name}") from None
    if given.ndim == 0:
        return float(given) * np.eye(n) if given else None
    if given.ndim == 1:
        meanings = row_by_row(
            given.tolist(), lambda rows, columns: f"{_number(rows, noun)}, {_number(columns, 'disturbance')}"
        )
        raise DesignError(f"a flat list is ambiguous here: {meanings}", f"at.{name}")
    if len(given) != n:
        raise DesignError(does_not_fit(given.shape, (n, given.shape[1])), f"at.{name}")
    if not given.shape[1]:
        raise DesignError("has no column; one per disturbance is required", f"at.{name}")
    if not np.isfinite(given).all():
        raise DesignError("must be finite", f"at.{name}")
    return given


def _number(n: int, noun: str) -> str:
    return f"{n} {noun}{'s' * (n != 1)}"


def augmented(now: LinearModel, entry: Entry) -> LinearModel:
    """Return the linear model of [x; d]."""
    nx, nd = now.nx, entry.nd
    return LinearModel(
        np.block([[now.A, entry.B_d(now.B)], [np.zeros((nd, nx)), np.eye(nd)]]),
        np.vstack([now.B, np.zeros((nd, now.nu))]),
        np.hstack([now.C, entry.of_output(now.D)]),
        block_diagonal(now.Q_w, entry.drift),
        now.R_v,
        S_wv=np.vstack([now.S_wv, np.zeros((nd, now.ny))]),
        f0=np.concatenate([now.f0, np.zeros(nd)]),
        d0=now.d0,
        D=now.D,
        extra_signals=padded_signals(now.extra_signals, nd),
    )


def block_diagonal(M: Float[Array, "n n"], D: Float[Array, "nd nd"]) -> Float[Array, "nz nz"]:
    """Return [M 0; 0 D]."""
    n, nd = len(M), len(D)
    return np.block([[M, np.zeros((n, nd))], [np.zeros((nd, n)), D]])


def padded_signals(signals: Mapping[str, Array], nd: int) -> dict[str, Float[Array, "nz n"]]:
    """Return signals Z x as signals [Z 0] [x; d]."""
    return {name: np.hstack([Z, np.zeros((len(Z), nd))]) for name, Z in signals.items()}


def rank_and_size(
    A: Float[Array, "nx nx"], B_d: Float[Array, "nx nd"], C: Float[Array, "ny nx"], C_d: Float[Array, "ny nd"]
) -> tuple[int, int]:
    """Return the rank of [A - I, B_d; C, C_d] and the rank nx + nd that it must have."""
    matrix = np.block([[A - np.eye(len(A)), B_d], [C, C_d]])
    # Neither the rank nor its computation should depend on the units of the states, the outputs and d.
    for _ in range(SWEEPS):
        for axis in (1, 0):
            size = np.sqrt(np.abs(matrix).max(axis=axis, keepdims=True))
            matrix = matrix / np.where(size > 0.0, size, 1.0)
    return int(np.linalg.matrix_rank(matrix, rtol=RANK)), matrix.shape[1]


def refuse_undetectable(models: Sequence[LinearModel], entry: Entry) -> tuple[int, int]:
    """Refuse disturbances that no estimator can tell apart from the state, and return the rank and the one needed."""
    rank, needed = max(rank_and_size(now.A, entry.B_d(now.B), now.C, entry.of_output(now.D)) for now in models)
    if rank == needed:
        return rank, needed
    ny = models[0].ny
    more = f": {_number(entry.nd, 'disturbance')}, but {_number(ny, 'output')}" if entry.nd > ny else ""
    raise DesignError(
        f"is not detectable: the rank of [A - I, B_d; C, C_d] is {rank}, and nx + nd = {needed} is necessary{more}; no "
        "estimator can distinguish this disturbance from a change of the state, and its covariance grows without bound",
        "at",
    )
