"""A plant, a linear filter and a control law as operations of `numerics.linear_loop_kernel`.

A `Program` is a list of sums of rows, or of matrices times rows; a row has one number of every run of a block.  A sum
adds its terms from the left, as the methods of the components do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics import linear_loop_kernel as kernel
from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.simulation.state_range import RunLimits
from rmpc_bench.types import Array, CompiledFilter, CompiledLaw, CompiledPlant, Statuses, StepFunction, Term

LANES = 32
"""Runs of a block: many enough to share the cost of an operation; the rows of a block stay in the fastest memory."""
NONE = np.empty((0, 1, 1))
NO_STEP = StepFunction(kernel.no_step, NONE, np.empty((0, 1)), np.zeros(1, dtype=np.int64), (0, 1))


class Rows(NamedTuple):
    """Consecutive rows: a vector of every run."""

    at: int
    n: int


Signed: TypeAlias = tuple[Any, ...]
"""1 or -1, the rows, and the matrices that they are multiplied by, the first one first."""


class Program:
    """Operations on rows, the numbers that the rows start with, and the matrices."""

    def __init__(self) -> None:
        self.start: list[float] = [0.0, 0.0, -0.0]
        self.operations: list[list[int]] = []
        self.numbers: list[Array] = [np.zeros(0)]
        # By the identity of a matrix; the terms keep it in memory while the operations are written.
        self.own: dict[int, tuple[Rows, Array]] = {}

    def rows(self, values: Sequence[float] | Array) -> Rows:
        """Take rows that start with these numbers, the same for every run."""
        rows = Rows(len(self.start), len(values))
        self.start.extend(values)
        return rows

    def vector(self, values: Float[Array, "k n"]) -> Rows:
        """Take rows for a vector that all runs have in common."""
        rows = self.rows(values[0])
        if len(values) > 1:
            self._append(kernel.FILL, *self._numbers(values), rows)
        return rows

    def own_matrices(self, terms: Sequence[Term]) -> None:
        """Take rows for the matrices that every run has of its own."""
        for matrix in (each for term in terms for each in term.matrices if each.ndim == 4):
            if id(matrix) not in self.own:
                flat = matrix.reshape(*matrix.shape[:2], -1)
                self.own[id(matrix)] = self.rows(np.zeros(flat.shape[2])), flat

    def total(self, *terms: Signed, to: Rows | None = None) -> Rows:
        """Add terms from the left, and write the sum to given rows or to new ones."""
        total: Rows | None = None
        for number, (sign, rows, *matrices) in enumerate(terms):
            for matrix in matrices[:-1]:
                rows = self.total((1, rows, matrix))
            wanted = to if number == len(terms) - 1 else None
            if total is None and not matrices and sign == 1 and wanted is None:
                total = rows
                continue
            result = wanted or self.rows(np.zeros(matrices[-1].shape[-2] if matrices else rows.n))
            base = (kernel.NOTHING, 0) if total is None else (total.at, 1)
            self._append(*self._factor(*matrices[-1:]), to=result, base=base, sign=sign, source=rows)
            total = result
        assert total is not None
        return total

    def clipped(self, rows: Rows, low: float, high: float, to: Rows) -> None:
        """Write rows within bounds."""
        bounds = self.rows([low, high])
        self._append(kernel.CLIP, bounds.at + 1, 0, to, base=(bounds.at, 0), source=rows)

    def run(
        self,
        places: Mapping[int, int],
        inputs: Sequence[Float[Array, "_ _ _"]],
        signals: Sequence[Float[Array, "_ _ _"]],
        status: Statuses,
        reported: Statuses,
        widths: tuple[int, int, int] = (0, 0, 0),
        step: StepFunction = NO_STEP,
    ) -> None:
        """Call the kernel, which writes the signals x, y, x_hat, u and e, and the statuses.

        `places` has entries of its layout, `inputs` are x0, the limits, w, v and given, `widths` those of x, u and w.
        Inputs that have no effect and signals that nobody reads have no rows.
        """
        lanes, layout = max(1, min(LANES, len(status))), np.zeros(kernel.E + 1, dtype=np.int64)
        layout[kernel.OWN] = next((rows.at for rows, _ in self.own.values()), 0)
        layout[list(places)] = list(places.values())
        matrices = [values for _, values in self.own.values()]
        own = as_compiled(np.concatenate(matrices, axis=2)) if matrices else NONE
        x0, most, *others = map(as_compiled, inputs)
        kernel.ready(kernel.loop_kernel, kernel.LOOP)(
            step.advance, as_compiled(step.own), as_compiled(step.shared), step.sizes, np.zeros(step.work),
            np.require(reported, np.int8, ["C", "W"]), *(np.empty(n) for n in (*widths, widths[0])),
            np.empty((len(self.start), lanes)), *np.empty((2, lanes), np.int8), layout, np.array(self.operations),
            np.concatenate(self.numbers), np.array(self.start), x0, most, own, *others, *signals, status,
        )  # fmt: skip

    def _factor(self, matrix: Array | None = None) -> tuple[int, int, int]:
        """Return the kind of an operation, where its matrix begins, and the distance to that of the next sample."""
        if matrix is None:
            return kernel.ADD, 0, 0
        if matrix.ndim == 4:
            return kernel.OWN_PRODUCT, self.own[id(matrix)][0].at, 0
        return kernel.PRODUCT, *self._numbers(matrix)

    def _numbers(self, values: Float[Array, "k ..."]) -> tuple[int, int]:
        """Keep numbers of every k; return where they begin, and the distance between samples."""
        self.numbers.append(values.ravel())
        return sum(map(len, self.numbers[:-1])), values[0].size if len(values) > 1 else 0

    def _append(
        self, kind: int, at: int, every: int, to: Rows, *, base: tuple[int, int] = (0, 0), sign: int = 1,
        source: tuple[int, int] = (0, 0),
    ) -> None:  # fmt: skip
        """Append an operation, with the columns of the kernel."""
        self.operations.append([kind, *to, *base, sign, *source, at, every])


def loop_program(
    plant: CompiledPlant, filter_: CompiledFilter, law: CompiledLaw, sizes: tuple[int, int, int, int], limits: RunLimits
) -> tuple[Program, dict[int, int]]:
    """Return the operations of a sample and the layout of their rows; `sizes` has nx, nu, ny and the length of w."""
    s, (nx, nu, ny, nw), p = filter_.schedule, sizes, Program()
    nh = len(s.x0)
    bounds = [np.full(nx, np.nan) if each is None else each for each in (limits.low, limits.high)]
    # The kernel needs these in this order.
    u, x, x_pred = p.rows(np.zeros(nu) if law.start is None else law.start), p.rows(np.zeros(nx)), p.rows(s.x0)
    x_hat, u_next, x_next, pred_next = (p.rows(np.zeros(n)) for n in (nh, nu, nx, nh))
    most, low, _ = p.rows(np.zeros(nh + nu + nx)), *map(p.rows, bounds)
    w, v, given = (p.rows(np.zeros(n)) for n in (nw, ny, nu))
    signals = {"x": x, "u": u_next, "w": w}

    def sum_of(terms: Sequence[Term]) -> list[Signed]:
        return [(1, signals[term.signal], *term.matrices) for term in terms]

    step = () if isinstance(plant.step, StepFunction) else plant.step
    p.own_matrices([*step, *plant.output])
    output = p.total(*sum_of(plant.output))
    # The true output is that with a noise of zero.
    y = p.total((1, Rows(output.at, ny)), (1, p.rows(np.zeros(ny))))
    d = () if s.d is None else ((-1, p.vector(s.d)),)
    e = p.total((1, p.total((1, Rows(output.at, ny)), (1, v))), (-1, x_pred, s.C), *d)
    p.total((1, x_pred), *(((1, e, s.L),) if s.L.any() else ()), to=x_hat)
    measured = len(p.operations)
    _choose(p, law, u, x_hat, given, u_next)
    if step:
        p.total(*sum_of(step), to=x_next)
    f = () if s.f is None else ((1, p.vector(s.f)),)
    driven = ((1, u_next, s.B),) if s.B.any() else ()
    p.total((1, x_pred, s.F), *driven, (1, e, s.K), *f, to=pred_next)
    layout = {
        kernel.NH: nh, kernel.MEASURED: measured, kernel.CALLS: not step,
        kernel.BOUNDED: limits.low is not None, kernel.NOW: u.at, kernel.X: x.at, kernel.X_HAT: x_hat.at,
        kernel.NEXT_U: u_next.at, kernel.NEXT_X: x_next.at, kernel.MOST: most.at, kernel.LOW: low.at, kernel.W: w.at,
        kernel.V: v.at, kernel.GIVEN: given.at, kernel.Y: y.at, kernel.E: e.at,
    }  # fmt: skip
    return p, layout


def _choose(p: Program, law: CompiledLaw, u: Rows, x_hat: Rows, given: Rows, to: Rows) -> None:
    """Write u(k)."""
    if len(law.given) == 1:
        given = p.vector(law.given[0])
    u_0 = () if law.u_0 is None else ((-1, p.vector(law.u_0)),)
    if law.K_x is None:
        p.total((1, given), to=to)
    elif law.K_u is not None:
        moved = p.total((1, u), (-1, u, law.K_u[None]), (1, given), (-1, x_hat, law.K_x), *u_0)
        p.clipped(moved, law.low, law.high, to)
    elif law.point is None:
        p.total((-1, x_hat, law.K_x), *u_0, to=to)
    else:
        seen = p.total((1, x_hat), (-1, p.rows(law.point.x)))
        p.total((1, p.rows(law.point.u)), (1, p.total((-1, seen, law.K_x), *u_0)), to=to)
