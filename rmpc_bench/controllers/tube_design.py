"""Design of `tube-mpc`: feedback, tightened limits, terminal set, and the quadratic program of one sample.

Model   x+ = A x + B u + w with w in the box W; the law is u = K x + c(k), K the gain of the infinite horizon, and
        A_K = A + B K.  Nominal predictions z(0) = s, z(j+1) = A_K z(j) + B c_j use the inputs K z(j) + c_j.
Cost    sum_{j<N} |z(j)|^2_Qx + |K z(j) + c_j|^2_Ru + |z(N)|^2_P is |s|^2_P + sum_j |c_j|^2_S with S = R_u + B'P B,
        because P solves the Riccati equation.  In the unknowns V = [P^(1/2) s; S^(1/2) c_0; ..] it is |V|^2.
Limits  Each one is tightened by what Z reaches (`tube`), at step j by what W + A_K W + .. + A_K^(j-1) W reaches
        (`growing`), or not at all (`none`).  After step N, where c_j = 0, the largest invariant set stands for them.
        Limits of x alone are not applied to x(k): no input acts on it.  The nominal s of `tube` is free and has them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.constrained import Rows
from rmpc_bench.controllers.limits import bounds_of, key_of, signal_of
from rmpc_bench.numerics.intervals import Pairs
from rmpc_bench.numerics.linalg import as_covariance, as_positive, psd_sqrt
from rmpc_bench.numerics.stability import spectral_radius
from rmpc_bench.numerics.zonotope import InvariantRows, Zonotope, box, largest_invariant, reached, robust_invariant
from rmpc_bench.types import Array, DesignError, Matrix, Model, PlantInfo
from rmpc_bench.types.errors import no_such_component


class LimitRows(NamedTuple):
    """Limits low <= H_x x + H_u u <= high on deviations from the operating point; infinite where there is none."""

    H_x: Float[Array, "rows nx"]
    H_u: Float[Array, "rows nu"]
    low: Float[Array, " rows"]
    high: Float[Array, " rows"]
    names: tuple[str, ...]  # name of the limited signal of every row, for messages


def limit_rows(model: Model, limits: Mapping[str, Pairs], plant_info: PlantInfo | None = None) -> LimitRows:
    """Return the limits as rows of x - x_op and u - u_op; names are `u`, `u.0` and those of a soft limit."""
    if not limits:
        raise DesignError("needs a limit, such as `u: [-1, 1]`", "limits")
    parts = []
    for name, pairs in limits.items():
        key = key_of("limits", name)
        try:
            H_x, H_u, constant = _signal(name, model, plant_info)
        except DesignError as error:
            raise DesignError(str(error), key) from None
        low, high = bounds_of(pairs, len(H_x), key)
        rest = constant + H_x @ model.x_op + H_u @ model.u_op
        inside = (low < rest) & (rest < high)
        if not inside.all():
            row = int(np.argmin(inside))
            raise DesignError(f"must have {rest[row]:g}, the steady state of the law, between its bounds", key)
        parts.append((H_x, H_u, low - rest, high - rest))
    H_x, H_u, low, high = (np.concatenate(each) for each in zip(*parts, strict=True))
    names = [name for name, part in zip(limits, parts, strict=True) for _ in part[0]]
    return LimitRows(H_x, H_u, low, high, tuple(names))


def _signal(name: str, model: Model, plant_info: PlantInfo | None) -> tuple[Array, Array, Array]:
    """Return what x, u and a constant contribute to a signal."""
    letter, _, number = name.partition(".")
    if letter == "u" and (not number or number.isdecimal()):
        chosen = np.eye(model.nu)
        if number:
            if int(number) >= model.nu:
                raise DesignError(no_such_component("input", int(number), model.nu))
            chosen = chosen[int(number) :][:1]
        return np.zeros((len(chosen), model.nx)), chosen, np.zeros(len(chosen))
    signal = signal_of(name, model, plant_info)
    return signal.Z, np.zeros((len(signal.Z), model.nu)), signal.constant


Tightening = Literal["tube", "growing", "none"]
UNSTABLE = 1.0 - 1e-9
"""Modulus of an eigenvalue from which on an input has to reach its mode."""
MOST_FACETS = 5000
"""Largest number of pairs of facets of Z: each one is a row of every quadratic program."""


class Feedback(NamedTuple):
    """Linear-quadratic feedback u = K x of the infinite horizon."""

    K: Float[Array, "nu nx"]
    P: Float[Array, "nx nx"]  # cost |x|^2_P of the states after x
    S: Float[Array, "nu nu"]  # R_u + B' P B
    A_K: Float[Array, "nx nx"]


def feedback(A: Float[Array, "nx nx"], B: Float[Array, "nx nu"], Q_x: Matrix, R_u: Matrix) -> Feedback:
    """Solve the Riccati equation of the infinite horizon, for inputs that reach all unstable modes."""
    from scipy.linalg import solve_discrete_are

    Q, R = as_covariance(Q_x, len(A), "Q_x"), as_positive(R_u, B.shape[1], "R_u")
    _require_stabilisable(A, B)
    unobserved = "does not weigh every state: the cost must grow with each of them, at once or later"
    try:
        P = solve_discrete_are(A, B, Q, R)
    except np.linalg.LinAlgError:
        raise DesignError(unobserved, "Q_x") from None
    sizes = np.linalg.eigvalsh(P)
    S = R + B.T @ P @ B
    K = -np.linalg.solve(S, B.T @ P @ A)
    if sizes[0] <= 1e-12 * sizes[-1] or spectral_radius(A + B @ K) > UNSTABLE:
        raise DesignError(unobserved, "Q_x")
    return Feedback(K, P, S, A + B @ K)


def _require_stabilisable(A: Array, B: Array) -> None:
    """Raise a DesignError if a mode is not stable and no input reaches it."""
    nx = len(A)
    for mode in np.linalg.eigvals(A):
        if abs(mode) < UNSTABLE:
            continue
        if np.linalg.matrix_rank(np.hstack([A - mode * np.eye(nx), B])) < nx:
            raise DesignError(
                f"needs a design model whose inputs reach every mode that is not stable; they do not reach that of the "
                f"eigenvalue {mode:.4g}, such as the disturbance of a model with `disturbance`"
            )


@dataclass(frozen=True, eq=False)
class TubeDesign:
    """Tightened limits, terminal set and rows."""

    B: Float[Array, "nx nu"]  # input matrix
    feedback: Feedback  # gain and cost of the infinite horizon
    limits: LimitRows  # limits of inputs and states
    horizon: int  # N
    tightening: Tightening  # how the limits are tightened
    half_widths: Float[Array, " nx"]  # of the box W of the design, its margin included
    largest_alpha: float  # accuracy of Z

    @cached_property
    def Z(self) -> Zonotope:
        """Robust invariant set of x+ = A_K x + w; only 0 for `none`."""
        if self.tightening == "none":
            return Zonotope(np.zeros((len(self.B), 1)))
        try:
            return robust_invariant(self.feedback.A_K, self.half_widths, self.largest_alpha).set
        except ValueError as error:
            raise DesignError(f"the feedback is too slow: {error}", "alpha") from None

    @cached_property
    def closed(self) -> Float[Array, "rows nx"]:
        """Rows H_x + H_u K of the limits under the feedback alone."""
        closed: Array = self.limits.H_x + self.limits.H_u @ self.feedback.K
        return closed

    def kept_free(self, j: int) -> Float[Array, " rows"]:
        """Return the part of the limits that is kept free for the noise, j samples ahead."""
        if self.tightening == "growing":
            return reached(self.feedback.A_K, box(self.half_widths), j).support(self.closed)
        return self.Z.support(self.closed)

    @cached_property
    def terminal(self) -> InvariantRows:
        """Rows H z <= b of the states z(N) from which the feedback alone keeps the tightened limits at all times."""
        signs, upper, which = self._one_sided
        widest = self.Z.support(self.closed)
        left = upper - widest[which]
        if not (left > 0.0).all():
            row = int(np.argmin(left))
            name, bound = self.limits.names[which[row]], signs[row] * upper[row]
            raise DesignError(
                f"leaves no room at the limit {bound:g} of {name}: the noise takes {widest[which[row]]:.4g} of it",
                "W" if self.tightening != "none" else "limits",
            )

        def bounds(t: int) -> Array:
            return np.asarray(upper - self.kept_free(self.horizon + t)[which])

        try:
            return largest_invariant(self.feedback.A_K, signs[:, None] * self.closed[which], bounds, left)
        except ValueError as error:
            raise DesignError(str(error), "limits") from None

    @cached_property
    def _one_sided(self) -> tuple[Array, Array, Array]:
        """Sign, bound and row of every finite limit, as sign row <= bound."""
        rows = np.arange(len(self.limits.low))
        signs = np.repeat([1.0, -1.0], len(rows))
        upper = np.concatenate([self.limits.high, -self.limits.low])
        finite = np.isfinite(upper)
        return signs[finite], upper[finite], np.tile(rows, 2)[finite]

    @cached_property
    def roots(self) -> tuple[Float[Array, "nx nx"], Float[Array, "nu nu"]]:
        """Symmetric roots of P and S: s and c_j are V times their inverses."""
        return psd_sqrt(self.feedback.P), psd_sqrt(self.feedback.S)

    @cached_property
    def rows(self) -> Rows:
        """Rows low <= A V + E x <= high of the quadratic program of one sample."""
        # First, because it finds limits that leave no room.
        terminal = self._terminal_rows()
        return Rows.stacked([*self._set_rows(), *self._stage_rows(), terminal])

    @property
    def free_start(self) -> bool:
        """Whether s is an unknown; otherwise it is x."""
        return self.tightening == "tube"

    @cached_property
    def nominal(self) -> list[tuple[Float[Array, "nx unknowns"], Float[Array, "nx nx"]]]:
        """What V and what x contribute to z(j), j = 0..N."""
        nx, nu = self.B.shape
        first = nx if self.free_start else 0
        of_V, of_x = np.zeros((nx, first + self.horizon * nu)), np.zeros((nx, nx))
        if self.free_start:
            of_V[:, :nx] = np.linalg.inv(self.roots[0])
        else:
            of_x = np.eye(nx)
        found = [(of_V, of_x)]
        for j in range(self.horizon):
            of_V, of_x = self.feedback.A_K @ of_V + self.B @ self.correction(j), self.feedback.A_K @ of_x
            found.append((of_V, of_x))
        return found

    def correction(self, j: int) -> Float[Array, "nu unknowns"]:
        """Return what V contributes to c_j."""
        nx, nu = self.B.shape
        first = nx if self.free_start else 0
        chosen = np.zeros((nu, first + self.horizon * nu))
        chosen[:, first + j * nu : first + (j + 1) * nu] = np.linalg.inv(self.roots[1])
        return chosen

    def _set_rows(self) -> list[Rows]:
        """Rows of x - s in Z."""
        if not self.free_start:
            return []
        if self.Z.most_facets() > MOST_FACETS:
            raise DesignError(
                f"the robust invariant set may have {self.Z.most_facets()} pairs of facets, and at most {MOST_FACETS} "
                "are supported; use `growing`, which needs no set, or a larger alpha",
                "tightening",
            )
        normals, bounds = self.Z.facets()
        return [_hard(-normals @ self.nominal[0][0], normals, -bounds, bounds)]

    def _stage_rows(self) -> list[Rows]:
        """Tightened limits of steps 0 to N - 1."""
        found = []
        for j in range(self.horizon):
            of_V, of_x = self.nominal[j]
            free = self.kept_free(j)
            # No input acts on x(k).
            acts = self.limits.H_u.any(axis=1) | (j > 0 or self.free_start)
            A_V = self.closed @ of_V + self.limits.H_u @ self.correction(j)
            low, high = self.limits.low + free, self.limits.high - free
            found.append(_hard(A_V[acts], (self.closed @ of_x)[acts], low[acts], high[acts]))
        return found

    def _terminal_rows(self) -> Rows:
        of_V, of_x = self.nominal[-1]
        H, b, _ = self.terminal
        return _hard(H @ of_V, H @ of_x, np.full(len(b), -np.inf), b)


def _hard(A: Array, E: Array, low: Array, high: Array) -> Rows:
    """Return rows whose unit is their tightest bound."""
    unit = np.minimum(*(np.where(np.isfinite(bound), np.abs(bound), np.inf) for bound in (low, high)))
    return Rows.hard(A, E, low, high, np.where(np.isfinite(unit), unit, 1.0))
