"""Compiled simulation of a linear filter and a linear control law with a plant: 32 runs side by side, over all samples.

Phases
    1  sums of products in the order of np.einsum                 _shared_products, _own_products
    2  the operations of a sample                                 _operate
    3  a plant that is a compiled function                        no_step, rows_kernel
    4  inputs and signals of a sample                             _load, _store
    5  statuses                                                   _within, _check_inputs, _settle
    6  all samples of all runs                                    loop_kernel

Operations
    The kernel knows neither filters nor laws: `simulation.loop_program` writes them as a list of operations on the rows
    of one matrix (rows, lanes), a lane per run, so that numba compiles one product only and the innermost loops go over
    the runs.  A row of ``operations`` has
        KIND    PRODUCT, OWN_PRODUCT, ADD, FILL or CLIP
        TO, N   first row and number of rows of the result
        BASE    first row that the result is added to; STEP is 0 if it is one row for all
        SIGN    1 or -1
        FROM, M first row and number of rows of the vector
        AT      first number of the matrix in ``numbers``, to which EVERY is added at each k; a row if runs have their own
    No result lies in a row that its operation reads: the compiled loops would not use vectors.

Plants
    A plant without a linear form is a function pointer of the type `FUNCTION`: f(k, x, u, w, own, shared, sizes, work,
    out) writes x(k+1) into ``out`` and returns a status; ``own`` is that of the run, see `types.records.StepFunction`.

The simulation step by step (`simulation.closed_loop.simulate`) is the oracle: all numbers are equal, bit for bit.
Imported at the first step only, as it loads numba.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled, numba

# Values of types.Status, which compiled code cannot read.
OK, DIVERGED, OUT_OF_RANGE = 0, 1, 2
# Columns of `operations`, and values of the first.
KIND, TO, N, BASE, STEP, SIGN, FROM, M, AT, EVERY = range(10)
PRODUCT, OWN_PRODUCT, ADD, FILL, CLIP = range(5)
# Rows of every workspace: two sums, and -0, which leaves every number as it is.
EVEN, ODD, NOTHING = range(3)
# Positions in `layout`: sizes, number of operations before the law, what is left out, first rows.
N_STEPS, LANES, NX, NU, NH, MEASURED, CALLS, BOUNDED = range(8)
NOW, X, X_HAT, NEXT_U, NEXT_X, MOST, LOW, OWN, W, V, GIVEN, Y, E = range(8, 21)

types = numba.types
_INT, _VECTOR, _MATRIX = types.int64, types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_CUBE, _INTS, _STATUSES = (
    types.Array(types.float64, 3, "C"),
    types.Array(types.int64, 1, "C"),
    types.Array(types.int8, 1, "C"),
)
_OPERATIONS = types.Array(types.int64, 2, "C")
FUNCTION = types.FunctionType(
    _INT(_INT, _VECTOR, _VECTOR, _VECTOR, _MATRIX, _MATRIX, _INTS, _MATRIX, _VECTOR),
)
_PLANT = (FUNCTION, _CUBE, _MATRIX, _INTS, _MATRIX, _STATUSES)
LOOP = types.void(*_PLANT, _INTS, _OPERATIONS, _VECTOR, _VECTOR, *(_CUBE,) * 11, _STATUSES)
ROWS = types.void(FUNCTION, _INT, _MATRIX, _MATRIX, _MATRIX, _CUBE, _MATRIX, _INTS, _MATRIX, _MATRIX, _STATUSES)


@compiled()
def _shared_products(
    rows: Any, to: int, n: int, base: int, step: int, sign: float, numbers: Any, at: int, m: int, x: int
) -> None:  # fmt: skip  # pragma: no cover
    """Write base + sign A x of every lane for the (n, m) matrix A that begins at numbers[at].

    The sums are those of np.einsum: even and odd products on their own, and in blocks of eight from the last pair to the
    first.  np.einsum adds the sum to zero.
    """
    lanes, whole = rows.shape[1], m - m % 8
    for i in range(n):
        if m == 1:
            a = numbers[at]
            for l in range(lanes):
                rows[to, l] = rows[base, l] + sign * (0.0 + a * rows[x, l])
        elif m == 2:
            a, b = numbers[at], numbers[at + 1]
            for l in range(lanes):
                rows[to, l] = rows[base, l] + sign * (0.0 + (a * rows[x, l] + b * rows[x + 1, l]))
        elif m == 3:
            a, b, c = numbers[at], numbers[at + 1], numbers[at + 2]
            for l in range(lanes):
                even = a * rows[x, l] + c * rows[x + 2, l]
                rows[to, l] = rows[base, l] + sign * (0.0 + (even + b * rows[x + 1, l]))
        elif m == 4:
            a, b, c, d = numbers[at], numbers[at + 1], numbers[at + 2], numbers[at + 3]
            for l in range(lanes):
                even, odd = a * rows[x, l] + c * rows[x + 2, l], b * rows[x + 1, l] + d * rows[x + 3, l]
                rows[to, l] = rows[base, l] + sign * (0.0 + (even + odd))
        else:
            for l in range(lanes):
                rows[EVEN, l] = rows[ODD, l] = 0.0
            done = 0
            while m - done >= 4:
                p, q = (done ^ 6, (done + 2) ^ 6) if done < whole else (done, done + 2)
                a, b, c, d = numbers[at + p], numbers[at + p + 1], numbers[at + q], numbers[at + q + 1]
                for l in range(lanes):
                    rows[EVEN, l] = (rows[EVEN, l] + a * rows[x + p, l]) + c * rows[x + q, l]
                    rows[ODD, l] = (rows[ODD, l] + b * rows[x + p + 1, l]) + d * rows[x + q + 1, l]
                done += 4
            for j in range(done, m):
                a = numbers[at + j]
                for l in range(lanes):
                    rows[EVEN + j % 2, l] += a * rows[x + j, l]
            for l in range(lanes):
                rows[to, l] = rows[base, l] + sign * (0.0 + (rows[EVEN, l] + rows[ODD, l]))
        to, base, at = to + 1, base + step, at + m


@compiled()
def _own_products(
    rows: Any, to: int, n: int, base: int, step: int, sign: float, at: int, m: int, x: int
) -> None:  # fmt: skip  # pragma: no cover
    """Do the same for matrices that differ from run to run: row ``at`` has their first numbers."""
    lanes, whole = rows.shape[1], m - m % 8
    for i in range(n):
        if m == 1:
            for l in range(lanes):
                rows[to, l] = rows[base, l] + sign * (0.0 + rows[at, l] * rows[x, l])
        elif m == 4:
            for l in range(lanes):
                even = rows[at, l] * rows[x, l] + rows[at + 2, l] * rows[x + 2, l]
                odd = rows[at + 1, l] * rows[x + 1, l] + rows[at + 3, l] * rows[x + 3, l]
                rows[to, l] = rows[base, l] + sign * (0.0 + (even + odd))
        else:
            for l in range(lanes):
                rows[EVEN, l] = rows[ODD, l] = 0.0
            for j in range(m):
                p = j ^ 6 if j < whole else j
                for l in range(lanes):
                    rows[EVEN + j % 2, l] += rows[at + p, l] * rows[x + p, l]
            for l in range(lanes):
                rows[to, l] = rows[base, l] + sign * (0.0 + (rows[EVEN, l] + rows[ODD, l]))
        to, base, at = to + 1, base + step, at + m


@compiled()
def _operate(rows: Any, operations: Any, end: int, k: int, numbers: Any) -> None:  # pragma: no cover
    """Do the first operations of a sample."""
    lanes = rows.shape[1]
    for i in range(end):
        kind, to, n, base = operations[i, KIND], operations[i, TO], operations[i, N], operations[i, BASE]
        step, sign, x = operations[i, STEP], float(operations[i, SIGN]), operations[i, FROM]
        m, at = operations[i, M], operations[i, AT] + k * operations[i, EVERY]
        if kind == PRODUCT:
            _shared_products(rows, to, n, base, step, sign, numbers, at, m, x)
        elif kind == OWN_PRODUCT:
            _own_products(rows, to, n, base, step, sign, at, m, x)
        elif kind == ADD:
            for j in range(n):
                for l in range(lanes):
                    rows[to + j, l] = rows[base + step * j, l] + sign * rows[x + j, l]
        elif kind == FILL:
            for j in range(n):
                rows[to + j] = numbers[at + j]
        else:
            for j in range(n):
                for l in range(lanes):
                    value = rows[x + j, l]
                    value = rows[base, l] if value < rows[base, l] else value
                    rows[to + j, l] = rows[at, l] if value > rows[at, l] else value


@compiled()
def no_step(
    k: int, x: Any, u: Any, w: Any, own: Any, shared: Any, sizes: Any, work: Any, out: Any
) -> int:  # pragma: no cover
    """Stand in for the function of a plant that has a linear form."""
    return OK


@compiled()
def rows_kernel(
    advance: Any, k: int, x: Any, u: Any, w: Any, own: Any, shared: Any, sizes: Any, work: Any, x_next: Any,
    status: Any,
) -> None:  # fmt: skip  # pragma: no cover
    """Advance every row of ``x`` by one sample into ``x_next`` and ``status``."""
    for row in range(len(x)):
        status[row] = advance(k, x[row], u[row], w[row], own[row], shared, sizes, work, x_next[row])


@compiled()
def _take(rows: Any, at: int, l: int, out: Any) -> None:  # pragma: no cover
    """Copy the vector of one lane."""
    for j in range(len(out)):
        out[j] = rows[at + j, l]


@compiled()
def _load(rows: Any, at: int, values: Any, k: int, first: int, n_runs: int) -> None:  # pragma: no cover
    """Write values[run, k] into rows; what has one sample only stays, and the last run fills lanes that are left."""
    if len(values) == 0 or k >= values.shape[1]:
        return
    for j in range(values.shape[2]):
        for l in range(rows.shape[1]):
            rows[at + j, l] = values[min(first + l, n_runs - 1), k, j]


@compiled()
def _store(signal: Any, rows: Any, at: int, k: int, first: int) -> None:  # pragma: no cover
    """Keep the rows of a signal at k; a signal without rows is not wanted."""
    for l in range(min(rows.shape[1], len(signal) - first)):
        for j in range(signal.shape[2]):
            signal[first + l, k, j] = rows[at + j, l]


@compiled()
def _within(rows: Any, at: int, most: int, n: int) -> bool:  # pragma: no cover
    """Whether all lanes of n rows are numbers up to their limits."""
    beyond = 0
    for j in range(n):
        for l in range(rows.shape[1]):
            beyond += 0 if abs(rows[at + j, l]) <= rows[most + j, l] else 1
    return beyond == 0


@compiled()
def _between(rows: Any, at: int, low: int, n: int) -> bool:  # pragma: no cover
    """Whether no lane of n rows is beyond its bounds, the lower ones from row ``low``, the upper ones after them."""
    beyond = 0
    for j in range(n):
        for l in range(rows.shape[1]):
            value = rows[at + j, l]
            beyond += 1 if (value < rows[low + j, l]) | (value > rows[low + n + j, l]) else 0
    return beyond == 0


@compiled()
def _stop(rows: Any, layout: Any, n: int, state: Any) -> None:  # pragma: no cover
    """Set the status of runs whose estimates or inputs, n rows, do not fit."""
    for l in range(len(state)):
        for j in range(n):
            fits = abs(rows[layout[X_HAT] + j, l]) <= rows[layout[MOST] + j, l]
            if state[l] == OK and not fits:
                state[l] = DIVERGED


@compiled()
def _settle(rows: Any, layout: Any, first: int, reported: Any, state: Any, end: Any) -> None:  # pragma: no cover
    """Set the statuses after a step, and move the runs that have not failed to their next state."""
    nx, low = layout[NX], layout[LOW]
    most, x_next = layout[MOST] + layout[NH] + layout[NU], layout[NEXT_X]
    for l in range(len(state)):
        if state[l] != OK:
            continue
        fits, inside = True, True
        for j in range(nx):
            value = rows[x_next + j, l]
            fits = fits and abs(value) <= rows[most + j, l]
            inside = inside and not (value < rows[low + j, l] or value > rows[low + nx + j, l])
        state[l] = reported[min(first + l, len(reported) - 1)]
        if state[l] == OK:
            state[l] = end[l]
        if state[l] == OK:
            state[l] = (OK if fits else DIVERGED) if inside else OUT_OF_RANGE
        if state[l] == OK:
            for j in range(nx):
                rows[layout[X] + j, l] = rows[x_next + j, l]


@compiled()
def loop_kernel(
    advance: Any, own_of_step: Any, shared: Any, sizes: Any, work: Any, reported: Any,
    layout: Any, operations: Any, numbers: Any, start: Any,
    x0: Any, most: Any, own: Any, w: Any, v: Any, given: Any, x: Any, y: Any, x_hat: Any, u: Any, e: Any, status: Any,
) -> None:  # fmt: skip  # pragma: no cover
    """Simulate all runs: write x, y, x_hat, u and e (runs, samples, n), and the statuses, which may not be OK before.

    Arrays without rows are inputs that have no effect, or signals that nobody reads.  A run that fails keeps its state;
    its estimates and inputs go on.
    """
    n_steps, lanes, nx, nu, nh = layout[N_STEPS], layout[LANES], layout[NX], layout[NU], layout[NH]
    limits_x, n_runs = layout[MOST] + nh + nu, len(status)
    rows, state, end = np.empty((len(start), lanes)), np.empty(lanes, np.int8), np.zeros(lanes, np.int8)
    x_now, u_now, w_now, x_next = np.empty(nx), np.empty(nu), np.empty(layout[V] - layout[W]), np.empty(nx)
    for first in range(0, n_runs, lanes):
        for row in range(len(start)):
            rows[row] = start[row]
        # Whether all runs move on alike, without a look at every status.
        alike = layout[CALLS] == 0
        for l in range(lanes):
            run = min(first + l, n_runs - 1)
            state[l], end[l] = status[run], OK
            alike = alike and status[run] == OK and reported[run] == OK
        _load(rows, layout[X], x0, 0, first, n_runs)
        _load(rows, layout[MOST], most, 0, first, n_runs)
        for k in range(n_steps + 1):
            n_checked = nh if k == n_steps else nh + nu
            _load(rows, layout[OWN], own, k, first, n_runs)
            _load(rows, layout[W], w, k, first, n_runs)
            _load(rows, layout[V], v, k, first, n_runs)
            _load(rows, layout[GIVEN], given, k, first, n_runs)
            _operate(rows, operations, layout[MEASURED] if k == n_steps else len(operations), k, numbers)
            _store(x, rows, layout[X], k, first)
            _store(y, rows, layout[Y], k, first)
            _store(x_hat, rows, layout[X_HAT], k, first)
            _store(e, rows, layout[E], k, first)
            if not _within(rows, layout[X_HAT], layout[MOST], n_checked):
                alike = False
                _stop(rows, layout, n_checked, state)
            if k == n_steps:
                break
            _store(u, rows, layout[NEXT_U], k, first)
            for l in range(min(lanes, n_runs - first) if layout[CALLS] != 0 else 0):
                if state[l] == OK:
                    _take(rows, layout[X], l, x_now)
                    _take(rows, layout[NEXT_U], l, u_now)
                    _take(rows, layout[W], l, w_now)
                    end[l] = advance(k, x_now, u_now, w_now, own_of_step[first + l], shared, sizes, work, x_next)
                    for j in range(nx):
                        rows[layout[NEXT_X] + j, l] = x_next[j]
            alike = alike and _within(rows, layout[NEXT_X], limits_x, nx)
            alike = alike and (layout[BOUNDED] == 0 or _between(rows, layout[NEXT_X], layout[LOW], nx))
            if not alike:
                _settle(rows, layout, first, reported, state, end)
            # u and x_pred of all runs, and x between them where all move on.
            for j in range(nu + nx + nh):
                if alike or not nu <= j < nu + nx:
                    for l in range(lanes):
                        rows[layout[NOW] + j, l] = rows[layout[NEXT_U] + j, l]
        for l in range(min(lanes, n_runs - first)):
            status[first + l] = state[l]


def ready(kernel: Any, signature: Any) -> Any:
    """Return a kernel that is compiled for one signature, with function pointers in place of compiled functions."""
    if not getattr(kernel, "signatures", True):
        kernel.compile(signature)
        kernel.disable_compile()
    return kernel
