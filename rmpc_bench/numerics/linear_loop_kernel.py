"""Compiled simulation of a linear filter and a linear control law with a plant: 32 runs side by side, over all samples.

Phases
    1  sums of products in the order of np.einsum                 _shared_products, _own_products
    2  the operations of a sample                                 _operate
    3  a plant that is a compiled function                        no_step, rows_kernel
    4  inputs and signals of a sample                             _load, _store
    5  statuses                                                   _within, _settle
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
        AT      first number of the matrix in ``numbers``, moved by EVERY at each k; a row if every run has its own
    No result lies in a row that its operation reads: the compiled loops would not use vectors.

Plants
    A plant without a linear form is a function pointer of the type `FUNCTION`: f(k, x, u, w, own, shared, sizes, work,
    out) writes x(k+1) into ``out`` and returns a status; ``own`` is that of the run, see `types.records.StepFunction`.

The simulation step by step (`simulation.closed_loop.simulate`) is the oracle: all numbers are equal, bit for bit.
"""

from __future__ import annotations

from typing import Any

from rmpc_bench.numerics.compiled import compiled, numba

# Values of types.Status, which compiled code cannot read.
OK, DIVERGED, OUT_OF_RANGE = 0, 1, 2
# Columns of `operations`, and values of the first.
KIND, TO, N, BASE, STEP, SIGN, FROM, M, AT, EVERY = range(10)
PRODUCT, OWN_PRODUCT, ADD, FILL, CLIP = range(5)
# Rows of every workspace: two sums, and -0, which leaves every number as it is.
EVEN, ODD, NOTHING = range(3)
# Positions in `layout`: sizes, number of operations before the law, whether the plant is a function and whether its
# states have bounds, first rows.
N_STEPS, NH, MEASURED, CALLS, BOUNDED = range(5)
NOW, X, X_HAT, NEXT_U, NEXT_X, MOST, LOW, OWN, W, V, GIVEN, Y, E = range(5, 18)

types = numba.types
_INT, _STATUSES = types.int64, types.Array(types.int8, 1, "C")
_INTS, _OPERATIONS = (types.Array(_INT, axes, "C") for axes in (1, 2))
_VECTOR, _MATRIX, _CUBE = (types.Array(types.float64, axes, "C") for axes in (1, 2, 3))
FUNCTION = types.FunctionType(_INT(_INT, _VECTOR, _VECTOR, _VECTOR, _MATRIX, _MATRIX, _INTS, _MATRIX, _VECTOR))
_PLANT = (FUNCTION, _CUBE, _MATRIX, _INTS, _MATRIX, _STATUSES)
_WORK = (*(_VECTOR,) * 4, _MATRIX, _STATUSES, _STATUSES)
LOOP = types.void(*_PLANT, *_WORK, _INTS, _OPERATIONS, _VECTOR, _VECTOR, *(_CUBE,) * 11, _STATUSES)
ROWS = types.void(FUNCTION, _INT, _MATRIX, _MATRIX, _MATRIX, _CUBE, _MATRIX, _INTS, _MATRIX, _MATRIX, _STATUSES)


@compiled()
def _shared_products(
    rows: Any, to: int, n: int, base: int, step: int, sign: float, numbers: Any, at: int, m: int, x: int
) -> None:  # fmt: skip  # pragma: no cover
    """Write base + sign A x of every lane for the (n, m) matrix A that begins at numbers[at]."""
    # The sums are those of np.einsum: even and odd products on their own, and blocks of eight from their last pair to
    # the first. np.einsum adds the sum to zero.
    lanes, whole = rows.shape[1], m - m % 8
    for _ in range(n):
        if m == 1:
            a = numbers[at]
            for lane in range(lanes):
                rows[to, lane] = rows[base, lane] + sign * (0.0 + a * rows[x, lane])
        elif m == 2:
            a, b = numbers[at], numbers[at + 1]
            for lane in range(lanes):
                rows[to, lane] = rows[base, lane] + sign * (0.0 + (a * rows[x, lane] + b * rows[x + 1, lane]))
        elif m == 3:
            a, b, c = numbers[at], numbers[at + 1], numbers[at + 2]
            for lane in range(lanes):
                even = a * rows[x, lane] + c * rows[x + 2, lane]
                rows[to, lane] = rows[base, lane] + sign * (0.0 + (even + b * rows[x + 1, lane]))
        elif m == 4:
            a, b, c, d = numbers[at], numbers[at + 1], numbers[at + 2], numbers[at + 3]
            for lane in range(lanes):
                even = a * rows[x, lane] + c * rows[x + 2, lane]
                odd = b * rows[x + 1, lane] + d * rows[x + 3, lane]
                rows[to, lane] = rows[base, lane] + sign * (0.0 + (even + odd))
        else:
            for lane in range(lanes):
                rows[EVEN, lane] = rows[ODD, lane] = 0.0
            done = 0
            while m - done >= 4:
                p, q = (done ^ 6, (done + 2) ^ 6) if done < whole else (done, done + 2)
                a, b, c, d = numbers[at + p], numbers[at + p + 1], numbers[at + q], numbers[at + q + 1]
                for lane in range(lanes):
                    rows[EVEN, lane] = (rows[EVEN, lane] + a * rows[x + p, lane]) + c * rows[x + q, lane]
                    rows[ODD, lane] = (rows[ODD, lane] + b * rows[x + p + 1, lane]) + d * rows[x + q + 1, lane]
                done += 4
            for j in range(done, m):
                a = numbers[at + j]
                for lane in range(lanes):
                    rows[EVEN + j % 2, lane] += a * rows[x + j, lane]
            for lane in range(lanes):
                rows[to, lane] = rows[base, lane] + sign * (0.0 + (rows[EVEN, lane] + rows[ODD, lane]))
        to, base, at = to + 1, base + step, at + m


@compiled()
def _own_products(
    rows: Any, to: int, n: int, base: int, step: int, sign: float, at: int, m: int, x: int
) -> None:  # fmt: skip  # pragma: no cover
    """Do the same for matrices that differ from run to run: row ``at`` has their first numbers."""
    lanes, whole = rows.shape[1], m - m % 8
    for _ in range(n):
        if m == 1:
            for lane in range(lanes):
                rows[to, lane] = rows[base, lane] + sign * (0.0 + rows[at, lane] * rows[x, lane])
        elif m == 4:
            for lane in range(lanes):
                even = rows[at, lane] * rows[x, lane] + rows[at + 2, lane] * rows[x + 2, lane]
                odd = rows[at + 1, lane] * rows[x + 1, lane] + rows[at + 3, lane] * rows[x + 3, lane]
                rows[to, lane] = rows[base, lane] + sign * (0.0 + (even + odd))
        else:
            for lane in range(lanes):
                rows[EVEN, lane] = rows[ODD, lane] = 0.0
            for j in range(m):
                p = j ^ 6 if j < whole else j
                for lane in range(lanes):
                    rows[EVEN + j % 2, lane] += rows[at + p, lane] * rows[x + p, lane]
            for lane in range(lanes):
                rows[to, lane] = rows[base, lane] + sign * (0.0 + (rows[EVEN, lane] + rows[ODD, lane]))
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
                for lane in range(lanes):
                    rows[to + j, lane] = rows[base + step * j, lane] + sign * rows[x + j, lane]
        elif kind == FILL:
            for j in range(n):
                for lane in range(lanes):
                    rows[to + j, lane] = numbers[at + j]
        else:
            for j in range(n):
                for lane in range(lanes):
                    value = rows[x + j, lane]
                    value = rows[base, lane] if value < rows[base, lane] else value
                    rows[to + j, lane] = rows[at, lane] if value > rows[at, lane] else value


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
def _take(rows: Any, at: int, lane: int, out: Any) -> None:  # pragma: no cover
    """Copy the vector of one lane."""
    for j in range(len(out)):
        out[j] = rows[at + j, lane]


@compiled()
def _load(rows: Any, at: int, values: Any, k: int, first: int, n_runs: int) -> None:  # pragma: no cover
    """Write values[run, k] into rows; what has one sample only stays, and the last run fills lanes that are left."""
    if len(values) == 0 or k >= values.shape[1]:
        return
    for j in range(values.shape[2]):
        for lane in range(rows.shape[1]):
            rows[at + j, lane] = values[min(first + lane, n_runs - 1), k, j]


@compiled()
def _store(signal: Any, rows: Any, at: int, k: int, first: int) -> None:  # pragma: no cover
    """Keep the rows of a signal at k; a signal without rows is not wanted."""
    for lane in range(min(rows.shape[1], len(signal) - first)):
        for j in range(signal.shape[2]):
            signal[first + lane, k, j] = rows[at + j, lane]


@compiled()
def _within(rows: Any, at: int, most: int, n: int) -> bool:  # pragma: no cover
    """Whether all lanes of n rows are numbers up to their limits."""
    beyond = 0
    for j in range(n):
        for lane in range(rows.shape[1]):
            beyond += 0 if abs(rows[at + j, lane]) <= rows[most + j, lane] else 1
    return beyond == 0


@compiled()
def _settle(
    rows: Any, layout: Any, nx: int, n_checked: int, first: int, moves: bool, reported: Any, state: Any, end: Any
) -> None:  # fmt: skip  # pragma: no cover
    """Set the statuses of a sample, and move the runs that have not failed to their next state."""
    x_next, low, most = layout[NEXT_X], layout[LOW], layout[MOST] + n_checked
    for lane in range(len(state)):
        for j in range(n_checked):
            if state[lane] == OK and not abs(rows[layout[X_HAT] + j, lane]) <= rows[layout[MOST] + j, lane]:
                state[lane] = DIVERGED
        if state[lane] != OK or not moves:
            continue
        fits, inside = True, True
        for j in range(nx):
            value = rows[x_next + j, lane]
            fits = fits and abs(value) <= rows[most + j, lane]
            inside = inside and not (value < rows[low + j, lane] or value > rows[low + nx + j, lane])
        state[lane] = reported[min(first + lane, len(reported) - 1)]
        if state[lane] == OK:
            state[lane] = end[lane]
        if state[lane] == OK:
            state[lane] = (OK if fits else DIVERGED) if inside else OUT_OF_RANGE
        if state[lane] == OK:
            for j in range(nx):
                rows[layout[X] + j, lane] = rows[x_next + j, lane]


@compiled()
def loop_kernel(
    advance: Any, own_of_step: Any, shared: Any, sizes: Any, work: Any, reported: Any,
    x_now: Any, u_now: Any, w_now: Any, x_next: Any, rows: Any, state: Any, end: Any,
    layout: Any, operations: Any, numbers: Any, start: Any, x0: Any, most: Any, own: Any, w: Any, v: Any, given: Any,
    x: Any, y: Any, x_hat: Any, u: Any, e: Any, status: Any,
) -> None:  # fmt: skip  # pragma: no cover
    """Simulate all runs: write x, y, x_hat, u and e (runs, samples, n), and the statuses, which may not be OK before.

    Arrays without rows are inputs that have no effect, or signals that nobody reads.  A run that fails keeps its state;
    its estimates and inputs go on.
    """
    n_steps, nx, nu, nh = layout[N_STEPS], len(x_now), len(u_now), layout[NH]
    n_checked, n_runs, lanes = nh + nu, len(status), rows.shape[1]
    for first in range(0, n_runs, lanes):
        for row in range(len(start)):
            for lane in range(lanes):
                rows[row, lane] = start[row]
        # Whether all runs move on alike, without a look at every one.
        alike = layout[CALLS] == 0 and layout[BOUNDED] == 0
        for lane in range(lanes):
            run = min(first + lane, n_runs - 1)
            state[lane], end[lane] = status[run], OK
            alike = alike and status[run] == OK and reported[run] == OK
        _load(rows, layout[X], x0, 0, first, n_runs)
        _load(rows, layout[MOST], most, 0, first, n_runs)
        for k in range(n_steps + 1):
            _load(rows, layout[OWN], own, k, first, n_runs)
            _load(rows, layout[W], w, k, first, n_runs)
            _load(rows, layout[V], v, k, first, n_runs)
            _load(rows, layout[GIVEN], given, k, first, n_runs)
            _operate(rows, operations, layout[MEASURED] if k == n_steps else len(operations), k, numbers)
            _store(x, rows, layout[X], k, first)
            _store(y, rows, layout[Y], k, first)
            _store(x_hat, rows, layout[X_HAT], k, first)
            _store(e, rows, layout[E], k, first)
            moves = k < n_steps
            if moves:
                _store(u, rows, layout[NEXT_U], k, first)
            for lane in range(min(lanes, n_runs - first) if moves and layout[CALLS] != 0 else 0):
                if state[lane] == OK:
                    _take(rows, layout[X], lane, x_now)
                    _take(rows, layout[NEXT_U], lane, u_now)
                    _take(rows, layout[W], lane, w_now)
                    end[lane] = advance(k, x_now, u_now, w_now, own_of_step[first + lane], shared, sizes, work, x_next)
                    for j in range(nx):
                        rows[layout[NEXT_X] + j, lane] = x_next[j]
            # At the end u(k-1) and x(k) are looked at again.
            alike = alike and _within(rows, layout[X_HAT], layout[MOST], n_checked + nx)
            if not alike:
                _settle(rows, layout, nx, n_checked, first, moves, reported, state, end)
            if not moves:
                break
            # u and x_pred of all runs, and x between them where all move on.
            for j in range(nu + nx + nh):
                if alike or not nu <= j < nu + nx:
                    for lane in range(lanes):
                        rows[layout[NOW] + j, lane] = rows[layout[NEXT_U] + j, lane]
        for lane in range(min(lanes, n_runs - first)):
            status[first + lane] = state[lane]


def ready(kernel: Any, signature: Any) -> Any:
    """Return a kernel that is compiled for one signature, with function pointers in place of compiled functions."""
    if not getattr(kernel, "signatures", True):
        kernel.compile(signature)
        kernel.disable_compile()
    return kernel
