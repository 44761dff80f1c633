"""Compiled simulation of a linear filter and a linear control law with a plant, over all samples, run after run.

Phases
    1  sums of products in the order of np.einsum                 _product
    2  linear plants                                              sampled_*, uncertain_*, _through
    3  one step of a block, for the simulation step by step       rows_kernel
    4  filter: correction and prediction                          _correct, _predict
    5  control law                                                _choose
    6  all samples of all runs, statuses included                 loop_kernel

Plants
    The kernels call a plant through two function pointers of the type `FUNCTION`, ``advance`` and ``measure``, so that
    its code is compiled and cached on its own: f(k, x, u, w, own, shared, sizes, work, out) writes x(k+1) or y(k) into
    ``out`` and returns a status; ``own`` is that of the run.  The arrays are those of `types.compiled.CompiledPlant`.

Arrays
    Matrices lie row by row, one after the other, in a row of a packed array:
        gains      C (ny, nh), d (ny), L (nh, ny), F (nh, nh), B (nh, nu), K (nh, ny), f (nh)
        law        K_x (nu, nh), K_u (nu, nu), u_0 (nu)
        constants  x_pred(0) (nh), u(-1) (nu), low, high, x_op (nh), u_op (nu), lowest x (nx), highest x (nx)
        shape      number of periods, nx, nu, ny, nh, then `FORM`, `CORRECTS`, `DRIVEN`, `KEEPS_E`, nw, ny

The simulation step by step (`simulation.closed_loop.simulate`) is the oracle: all numbers are equal, bit for bit.
Imported at the first step only, as it loads numba.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled, numba

# Values of types.Status, which compiled code cannot read.
OK, DIVERGED, OUT_OF_RANGE = 0, 1, 2
# That of simulation.state_range; numba's cache would not notice a change of a number in another file.
LARGEST = 1e100
# Positions in `shape`.
N_STEPS, NX, NU, NY, NH, FORM, CORRECTS, DRIVEN, KEEPS_E, NW = range(10)
# Values of shape[FORM].
INCREMENT, REGULATOR, AROUND_POINT, GIVEN = range(4)

types = numba.types
_INT, _VECTOR, _MATRIX = types.int64, types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_CUBE, _INTS, _STATUSES = (
    types.Array(types.float64, 3, "C"),
    types.Array(types.int64, 1, "C"),
    types.Array(types.int8, 1, "C"),
)
FUNCTION = types.FunctionType(
    _INT(_INT, _VECTOR, _VECTOR, _VECTOR, _MATRIX, _MATRIX, _INTS, _MATRIX, _VECTOR),
)
_PLANT = (FUNCTION, FUNCTION, _CUBE, _MATRIX, _INTS, _MATRIX, _STATUSES)
_METHOD = (_MATRIX, _MATRIX, _CUBE, _VECTOR, _INTS, _MATRIX, _MATRIX)
LOOP = types.void(*_PLANT, *_METHOD, _MATRIX, _CUBE, _CUBE, _CUBE, _CUBE, _CUBE, _CUBE, _CUBE, _STATUSES)
PRODUCT = types.void(_MATRIX, _MATRIX, _MATRIX)
ROWS = types.void(FUNCTION, _INT, _MATRIX, _MATRIX, _MATRIX, _CUBE, _MATRIX, _INTS, _MATRIX, _MATRIX, _STATUSES)


@compiled()
def _product(data: Any, i: int, at: int, n: int, m: int, x: Any, out: Any) -> None:  # pragma: no cover
    """Write A x for the (n, m) matrix A that begins at data[i, at], with the sums of np.einsum.

    It adds the even and the odd products on their own, and blocks of eight from their last pair to the first.
    """
    for row in range(n):
        start, even, odd, j = at + row * m, 0.0, 0.0, 0
        while m - j >= 8:
            for pair in range(6, -1, -2):
                even += data[i, start + j + pair] * x[j + pair]
                odd += data[i, start + j + pair + 1] * x[j + pair + 1]
            j += 8
        while j < m:
            even += data[i, start + j] * x[j]
            if j + 1 < m:
                odd += data[i, start + j + 1] * x[j + 1]
            j += 2
        # np.einsum adds the sum to zero.
        out[row] = 0.0 + (even + odd)


@compiled()
def product_kernel(data: Any, x: Any, out: Any) -> None:  # pragma: no cover
    """Multiply every row of ``x`` by the matrix in ``data``."""
    for row in range(len(x)):
        _product(data, 0, 0, out.shape[1], x.shape[1], x[row], out[row])


@compiled()
def first_state(
    k: int, x: Any, u: Any, w: Any, own: Any, shared: Any, sizes: Any, work: Any, out: Any
) -> int:  # pragma: no cover
    """Measure the first state."""
    out[0] = x[0]
    return OK


@compiled()
def sampled_advance(
    k: int, x: Any, u: Any, w: Any, own: Any, shared: Any, sizes: Any, work: Any, out: Any
) -> int:  # pragma: no cover
    """Move x(k+1) = E x + G u + w with E (nx, nx) and G (nx, nu) of the run."""
    nx, nu = len(x), len(u)
    driven = work[0]
    _product(own, 0, 0, nx, nx, x, out)
    _product(own, 0, nx * nx, nx, nu, u, driven)
    for i in range(nx):
        out[i] = (out[i] + driven[i]) + w[i]
    return OK


@compiled()
def _through(
    i_F: int, x: Any, own: Any, shared: Any, i: int, at_G: int, at_H: int, n: int, sizes: Any, work: Any, out: Any
) -> None:  # fmt: skip  # pragma: no cover
    """Add H F G x to ``out``; a scalar F is not summed."""
    nx, r, s = len(x), sizes[0], sizes[1]
    seen, pushed, moved = work[0], work[1], work[2]
    _product(shared, i, at_G, s, nx, x, seen)
    if r == 1 and s == 1:
        for j in range(n):
            out[j] += (own[i_F, 0] * seen[0]) * shared[i, at_H + j]
    else:
        _product(own, i_F, 0, r, s, seen, pushed)
        _product(shared, i, at_H, n, r, pushed, moved)
        for j in range(n):
            out[j] += moved[j]


@compiled()
def uncertain_advance(
    k: int, x: Any, u: Any, w: Any, own: Any, shared: Any, sizes: Any, work: Any, out: Any
) -> int:  # pragma: no cover
    """Move x(k+1) = (A + H_A F G) x + B u + w; ``sizes`` has r, s, whether F and B have an effect, and ny.

    A row of ``shared`` has A, B, C, G, H_A and H_C; ``own`` has F at every k.
    """
    nx, nu, s, ny = len(x), len(u), sizes[1], sizes[4]
    i = k if len(shared) > 1 else 0
    at_B = nx * nx
    at_G = at_B + nx * nu + ny * nx
    _product(shared, i, 0, nx, nx, x, out)
    for j in range(nx):
        out[j] += w[j]
    if sizes[2] != 0:
        _through(k, x, own, shared, i, at_G, at_G + s * nx, nx, sizes, work, out)
    if sizes[3] != 0:
        _product(shared, i, at_B, nx, nu, u, work[0])
        for j in range(nx):
            out[j] += work[0, j]
    return OK


@compiled()
def uncertain_measure(
    k: int, x: Any, u: Any, w: Any, own: Any, shared: Any, sizes: Any, work: Any, out: Any
) -> int:  # pragma: no cover
    """Measure y(k) = (C + H_C F G) x."""
    nx, nu, r, s, ny = len(x), len(u), sizes[0], sizes[1], sizes[4]
    i = k if len(shared) > 1 else 0
    at_C = nx * nx + nx * nu
    at_G = at_C + ny * nx
    _product(shared, i, at_C, ny, nx, x, out)
    if sizes[2] != 0:
        _through(k, x, own, shared, i, at_G, at_G + s * nx + nx * r, ny, sizes, work, out)
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
def _correct(
    gains: Any, i: int, shape: Any, x_pred: Any, y: Any, e: Any, x_hat: Any, half: Any
) -> int:  # fmt: skip  # pragma: no cover
    """Write e = y - C x_pred - d and x_hat = x_pred + L e; return where F begins."""
    ny, nh = shape[NY], shape[NH]
    _product(gains, i, 0, ny, nh, x_pred, half)
    for j in range(ny):
        e[j] = (y[j] - half[j]) - gains[i, ny * nh + j]
    at = ny * nh + ny
    if shape[CORRECTS] != 0:
        _product(gains, i, at, nh, ny, e, half)
        for j in range(nh):
            x_hat[j] = x_pred[j] + half[j]
    else:
        for j in range(nh):
            x_hat[j] = x_pred[j]
    return int(at + nh * ny)


@compiled()
def _predict(
    gains: Any, i: int, at: int, shape: Any, x_pred: Any, u: Any, e: Any, half: Any, x_next: Any
) -> None:  # fmt: skip  # pragma: no cover
    """Replace x_pred by F x_pred + B u + K e + f; F begins at ``at``."""
    nu, ny, nh = shape[NU], shape[NY], shape[NH]
    _product(gains, i, at, nh, nh, x_pred, x_next)
    at += nh * nh
    if shape[DRIVEN] != 0:
        _product(gains, i, at, nh, nu, u, half)
        for j in range(nh):
            x_next[j] += half[j]
    at += nh * nu
    _product(gains, i, at, nh, ny, e, half)
    at += nh * ny
    for j in range(nh):
        x_pred[j] = (x_next[j] + half[j]) + gains[i, at + j]


@compiled()
def _choose(
    law: Any, i: int, given: Any, row: int, k: int, constants: Any, shape: Any, x_hat: Any, u: Any, half: Any,
    kept: Any,
) -> None:  # fmt: skip  # pragma: no cover
    """Replace u(k-1) by u(k)."""
    nu, nh, form = shape[NU], shape[NH], shape[FORM]
    own, now = row if len(given) > 1 else 0, k if given.shape[1] > 1 else 0
    point = nh + nu + 2
    if form == GIVEN:
        for j in range(nu):
            u[j] = given[own, now, j]
    elif form == INCREMENT:
        _product(law, i, nu * nh, nu, nu, u, kept)
        _product(law, i, 0, nu, nh, x_hat, half)
        for j in range(nu):
            value = (((u[j] - kept[j]) + given[own, now, j]) - half[j]) - law[i, nu * nh + nu * nu + j]
            value = constants[nh + nu] if value < constants[nh + nu] else value
            u[j] = constants[nh + nu + 1] if value > constants[nh + nu + 1] else value
    else:
        if form == AROUND_POINT:
            for j in range(nh):
                kept[j] = x_hat[j] - constants[point + j]
        else:
            for j in range(nh):
                kept[j] = x_hat[j]
        _product(law, i, 0, nu, nh, kept, half)
        for j in range(nu):
            u[j] = -half[j] - law[i, nu * nh + nu * nu + j]
        if form == AROUND_POINT:
            for j in range(nu):
                u[j] = constants[point + nh + j] + u[j]


@compiled()
def loop_kernel(
    advance: Any, measure: Any, own: Any, shared: Any, sizes: Any, work: Any, reported: Any,
    gains: Any, law: Any, given: Any, constants: Any, shape: Any, largest_x: Any, largest_x_hat: Any,
    x0: Any, w: Any, v: Any, x: Any, y: Any, x_hat: Any, u: Any, e: Any, status: Any,
) -> None:  # fmt: skip  # pragma: no cover
    """Simulate all runs: write x, y, x_hat, u and e (runs, samples, n), and the statuses, which may not be OK before.

    A run that fails keeps its state; its estimates and inputs go on.
    """
    n_steps, nx, nu, ny, nh = shape[N_STEPS], shape[NX], shape[NU], shape[NY], shape[NH]
    low, width = nh + nu + 2 + nh + nu, max(nx, nu, ny, nh)
    x_now, x_next, u_now, w_now, y_now = np.empty(nx), np.empty(nx), np.empty(nu), np.empty(shape[NW]), np.empty(ny)
    e_now, x_pred, estimate, next_pred = np.empty(ny), np.empty(nh), np.empty(nh), np.empty(nh)
    half, kept = np.empty(width), np.empty(width)
    for row in range(len(x0)):
        own_now = own[row]
        for j in range(nx):
            x_now[j] = x0[row, j]
        for j in range(nh):
            x_pred[j] = constants[j]
        for j in range(nu):
            u_now[j] = constants[nh + j]
        for k in range(n_steps + 1):
            measure(k, x_now, u_now, w_now, own_now, shared, sizes, work, y_now)
            for j in range(nx):
                x[row, k, j] = x_now[j]
            for j in range(ny):
                # The true output is that with a noise of zero.
                y[row, k, j] = y_now[j] + 0.0
                y_now[j] = y_now[j] + v[row, k, j]
            i = k if len(gains) > 1 else 0
            at = _correct(gains, i, shape, x_pred, y_now, e_now, estimate, half)
            fits = True
            for j in range(nh):
                x_hat[row, k, j] = estimate[j]
                fits = fits and abs(estimate[j]) <= largest_x_hat[row, j]
            if shape[KEEPS_E] != 0:
                for j in range(ny):
                    e[row, k, j] = e_now[j]
            if status[row] == OK and not fits:
                status[row] = DIVERGED
            if k == n_steps:
                break
            _choose(law, k if len(law) > 1 else 0, given, row, k, constants, shape, estimate, u_now, half, kept)
            fits = True
            for j in range(nu):
                u[row, k, j] = u_now[j]
                fits = fits and abs(u_now[j]) < LARGEST
            if status[row] == OK and not fits:
                status[row] = DIVERGED
            if status[row] == OK:
                for j in range(shape[NW]):
                    w_now[j] = w[row, k, j]
                end = advance(k, x_now, u_now, w_now, own_now, shared, sizes, work, x_next)
                fits, inside = True, True
                for j in range(nx):
                    fits = fits and abs(x_next[j]) <= largest_x[row, j]
                    inside = inside and not (x_next[j] < constants[low + j] or x_next[j] > constants[low + nx + j])
                if reported[row] != OK:
                    end = reported[row]
                elif end == OK:
                    end = (OK if fits else DIVERGED) if inside else OUT_OF_RANGE
                status[row] = end
                if end == OK:
                    for j in range(nx):
                        x_now[j] = x_next[j]
            _predict(gains, i, at, shape, x_pred, u_now, e_now, half, next_pred)


def ready(kernel: Any, signature: Any) -> Any:
    """Return a kernel that is compiled for one signature, with function pointers in place of compiled functions."""
    if not getattr(kernel, "signatures", True):
        kernel.compile(signature)
        kernel.disable_compile()
    return kernel
