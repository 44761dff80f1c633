"""Compiled simulation of the servomechanism: Taylor series between friction events, for all rows of a block.

Phases
    1  one sample: loop over the pieces between events        servo_points, servo_advance, _sample
    2  mode of each body from the state (stick or slip)       _begin, _mode
    3  Taylor series of one piece, shortened until accurate   _series, _expand, _converge, _brake, _shrink
    4  recursion of the coefficients                          _prepare, _accelerations, _slip
    5  first event: smallest zero of a polynomial             _first_event, _first_fall, _walk, _stride
    6  state at the end of the piece                          _evaluate

Model
    Each body slips forwards (mode 1), slips backwards (-1) or sticks (0).  While the modes are constant the equations
    are smooth, and the state is a power series in the time tau in [0, 1], scaled to the rest of the sample.  Its
    coefficients, from a recursion, serve as dense output: an event is the first zero of a polynomial in tau.  A body
    that slips stops at velocity zero; one that sticks starts when the torque on it exceeds the largest friction torque.

Arrays
    ``c`` contains
        row 0..4   coefficients of the state [th_l, w_l, th_m, w_m, I]
        row 5, 6   coefficients of the accelerations of load and motor without dry friction, a
        row 7, 8   coefficients of the derivatives of their velocities, d, without the first one
        row 9, 10  coefficients of e = exp(-alpha_2 s w), s the mode, in reverse order and followed by zeros: the first
                   coefficient is in column ORDER, so that rows 7 + b and 9 + b, shifted, multiply element by element
        row 11     modes of load and motor
        row 12     1 for a body that has just started to slip, else 0
    ``p`` (3, 9) contains `servo.coefficients`: linear ones, friction of load, of motor; torques by inertias.

Functions of the inner loop are inlined: a call takes as much time as the work.
"""

from __future__ import annotations

from math import exp, isfinite, sqrt
from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled

WORK = (13, 57)  # shape of the memory of `servo_advance`
# Values of types.Status, which compiled code cannot read.
OK, TOO_MANY_EVENTS = 0, 3
# The kernel writes NaN with status OK for such a run; the closed loop detects NaN and sets the status `diverged`.
NO_NUMBERS = -1
# Largest order of a series, a multiple of 4.  A sample of 0.1 s needs order 20 with the parameters of the paper.
ORDER = 28
INVERSE = 1.0 / np.maximum(1.0, np.arange(ORDER + 1.0))
LEAST_ORDER = 8  # two small terms at a lower order may be a coincidence
MOST_EVENTS = 1000  # per sample
MOST_PIECES = 20_000  # per sample; about 20 ms
# Relative tolerance, a few hundred roundings: a torque this close to the friction limit does not exceed it.
TIE = 1e-13
# Values of alpha_2 |w|: exp(-38) = 3e-17 is below the rounding of the friction at rest.
FAST, STILL_FAST = 45.0, 38.0
NOTHING = 1e-250  # zero in the search for events: far below any rounding and far above underflow
MOST_STRIDES = 60  # of the root search: one to ten are usual, sixty occur only close to a double zero
# That of simulation.state_range: the closed loop stops such a run as `diverged`; larger values overflow here when
# squared.
LARGEST = 1e100


@compiled(inline="always")
def _accelerations(c: Any, n: int, p: Any) -> tuple[float, float]:  # pragma: no cover
    """Write and return coefficients n of the accelerations without dry friction."""
    twist = c[2, n] * p[0, 0] - c[0, n]
    c[5, n] = p[0, 1] * twist - p[0, 2] * c[1, n]
    c[6, n] = p[0, 5] * c[4, n] - p[0, 3] * twist - p[0, 4] * c[3, n]
    return c[5, n], c[6, n]


@compiled(inline="always")
def _slip(
    c: Any, b: int, n: int, d_0: float, d_n: float, e_0: float, e_n: float, rate: float
) -> tuple[float, float]:  # fmt: skip  # pragma: no cover
    """Write and return coefficients n + 1 of the velocity and of e, from e' = rate w' e, of a body that slips, n > 0.

    The sum of products has four partial sums, so that the processor adds them at the same time.  Products beyond n are
    zero and are left out.
    """
    p_0 = p_1 = p_2 = p_3 = 0.0
    for j in range(0, n, 4):
        p_0 += c[7 + b, j] * c[9 + b, ORDER - n + j]
        p_1 += c[7 + b, j + 1] * c[9 + b, ORDER - n + j + 1]
        p_2 += c[7 + b, j + 2] * c[9 + b, ORDER - n + j + 2]
        p_3 += c[7 + b, j + 3] * c[9 + b, ORDER - n + j + 3]
    w, ends = INVERSE[n + 1] * d_n, d_0 * e_n + d_n * e_0
    e = rate * INVERSE[n + 1] * (((p_0 + p_1) + (p_2 + p_3)) + ends)
    c[1 + 2 * b, n + 1], c[7 + b, n], c[9 + b, ORDER - n - 1] = w, d_n, e
    return w, e


@compiled()
def _prepare(c: Any, p: Any) -> None:  # pragma: no cover
    """Clear the sums of the recursion and set the first coefficient of e, 0 if e is below rounding."""
    for b in range(2):
        drop = p[1 + b, 2] * abs(c[1 + 2 * b, 0])
        c[9 + b, ORDER] = exp(-drop) if drop < FAST else 0.0
        for n in range(ORDER):
            c[1 + 2 * b, n + 1], c[7 + b, n] = 0.0, 0.0


@compiled()
def _expand(c: Any, u: float, h: float, p: Any, tolerance: float) -> tuple[int, float]:  # pragma: no cover
    """Compute the coefficients over a time h from the state c[:, 0]; return the order and the size of the series."""
    # The series ends after two consecutive small terms of velocities and current (those of the angles are then small,
    # too). The order is ORDER + 1 if the series has not ended. A body that has just started to slip has acceleration
    # exactly zero.
    _prepare(c, p)
    m_l, m_m, f_l, f_m, e_0l, e_0m = c[11, 0], c[11, 1], p[1, 1], p[2, 1], c[9, ORDER], c[10, ORDER]
    rate_l, rate_m, e_l, e_m, d_l, d_m, calm = -p[1, 2] * m_l, -p[2, 2] * m_m, e_0l, e_0m, 0.0, 0.0, 0
    a_l, a_m = _accelerations(c, 0, p)
    c[0, 1], c[2, 1] = h * c[1, 0], h * c[3, 0]
    current = h * (p[0, 8] * u - p[0, 6] * c[4, 0] - p[0, 7] * c[3, 0])
    c[4, 1] = current
    if m_l != 0.0:
        d_l = h * (a_l - m_l * (p[1, 0] + f_l * e_0l)) * (1.0 - c[12, 0])
        e_l = rate_l * (0.0 + d_l * e_0l)
        c[1, 1], c[9, ORDER - 1] = d_l, e_l
    if m_m != 0.0:
        d_m = h * (a_m - m_m * (p[2, 0] + f_m * e_0m)) * (1.0 - c[12, 1])
        e_m = rate_m * (0.0 + d_m * e_0m)
        c[3, 1], c[10, ORDER - 1] = d_m, e_m
    w_l, w_m, size_l, size_m, size_i = d_l, d_m, abs(c[1, 0]), abs(c[3, 0]), abs(c[4, 0])
    # A zero with the sign of u, as if the voltage had a coefficient for every n.
    no_voltage = 0.0 * p[0, 8] * u
    for n in range(1, ORDER + 1):
        term_l, term_m, term_i = abs(w_l), abs(w_m), abs(current)
        size_l, size_m, size_i = max(size_l, term_l), max(size_m, term_m), max(size_i, term_i)
        small = term_l <= tolerance * size_l and term_m <= tolerance * size_m and term_i <= tolerance * size_i
        calm = calm + 1 if small else 0
        a_l, a_m = _accelerations(c, n, p)
        if calm >= 2 and n >= LEAST_ORDER:
            return n, size_l + size_m + size_i
        if n == ORDER:
            break
        step = h * INVERSE[n + 1]
        c[0, n + 1], c[2, n + 1] = step * c[1, n], step * c[3, n]
        current = step * (no_voltage - p[0, 6] * c[4, n] - p[0, 7] * c[3, n])
        c[4, n + 1] = current
        # 0 + f e, because the sign of a zero has an effect.
        if m_l != 0.0:
            w_l, e_l = _slip(c, 0, n, d_l, h * (a_l - m_l * (0.0 + f_l * e_l)), e_0l, e_l, rate_l)
        if m_m != 0.0:
            w_m, e_m = _slip(c, 1, n, d_m, h * (a_m - m_m * (0.0 + f_m * e_m)), e_0m, e_m, rate_m)
    # The last terms make the size NaN if any coefficient is NaN.
    return ORDER + 1, size_l + size_m + size_i + term_l + term_m + term_i


@compiled()
def _shrink(c: Any, order: int, factor: float) -> None:  # pragma: no cover
    """Rescale the series to a shorter time; a factor of the time multiplies coefficient n by factor^n."""
    power = 1.0
    for n in range(1, order + 1):
        power *= factor
        for i in range(7):
            c[i, n] *= power


@compiled()
def _converge(c: Any, tolerance: float) -> float:  # pragma: no cover
    """Shorten the time of a series that has not ended at ORDER until its last terms are small; return the factor."""
    total = 1.0
    while total > 1e-300:
        excess = 0.0
        for i in (1, 3, 4):
            size = 0.0
            for n in range(ORDER + 1):
                size = max(size, abs(c[i, n]))
            for n in (ORDER - 1, ORDER):
                if abs(c[i, n]) > excess * size:
                    excess = abs(c[i, n]) / size
        if excess <= tolerance:
            break
        factor = min(0.9, (tolerance / excess) ** INVERSE[ORDER])
        _shrink(c, ORDER, factor)
        total *= factor
    return total


@compiled()
def _brake(c: Any, order: int, p: Any) -> float:  # pragma: no cover
    """Limit the loss of speed within a piece, so that e stays negligible if it is at the start; return the factor."""
    # A body with e set to zero stays so fast that e remains below rounding until the end of the piece.
    total = 1.0
    for b in range(2):
        fast = p[1 + b, 2] * abs(c[1 + 2 * b, 0])
        if fast > FAST - STILL_FAST and p[1 + b, 1] > 0.0:
            loss, sign = 0.0, 1.0 if c[1 + 2 * b, 0] > 0.0 else -1.0
            for n in range(order, 0, -1):
                loss = max(0.0, loss - sign * c[1 + 2 * b, n])
            room = (max(fast, FAST) - STILL_FAST) / p[1 + b, 2]
            if loss > room:
                _shrink(c, order, room / loss)
                total *= room / loss
    return total


@compiled()
def _series(c: Any, u: float, h: float, p: Any, tolerance: float) -> tuple[int, float]:  # pragma: no cover
    """Return the order of the series and the fraction of h that it covers; order 0 if no finite series exists."""
    fraction = 1.0
    while fraction > 1e-200:
        order, size = _expand(c, u, fraction * h, p, tolerance)
        if isfinite(size):
            if order > ORDER:
                order = ORDER
                fraction *= _converge(c, tolerance)
            return order, fraction * _brake(c, order, p)
        # The series overflows: try a shorter time.
        fraction *= 1e-2
    return 0, 0.0


@compiled()
def _evaluate(c: Any, order: int, t: float) -> None:  # pragma: no cover
    """Replace the state at 0 by the state at t, by five Horner schemes in parallel."""
    th_l = w_l = th_m = w_m = current = 0.0
    for n in range(order, -1, -1):
        th_l, w_l, th_m = th_l * t + c[0, n], w_l * t + c[1, n], th_m * t + c[2, n]
        w_m, current = w_m * t + c[3, n], current * t + c[4, n]
    c[0, 0], c[1, 0], c[2, 0], c[3, 0], c[4, 0] = th_l, w_l, th_m, w_m, current


@compiled()
def _stride(value: float, slope: float, curvature: float) -> float:  # pragma: no cover
    """Return the distance to the first zero of a parabola that starts above zero; infinity if there is none."""
    root = slope * slope - 2.0 * curvature * value
    if root < 0.0 or (curvature >= 0.0 and slope >= 0.0):
        return np.inf
    return 2.0 * value / (sqrt(root) - slope)


@compiled()
def _walk(
    c: Any, row: int, order: int, first: int, start: float, end: float, sign: float
) -> tuple[float, bool]:  # pragma: no cover
    """Search the first zero of g = start - sign (c[row, first + 1] t + c[row, first + 2] t^2 ...), see `_first_fall`.

    The lower bounds of g and of its curvature are nested: the terms after a coefficient enter only if their bound is
    negative.  If the first step is very short, the bounds over the whole piece are too coarse, and the search covers
    a shorter piece.
    """
    stride, slope = 0.0, -sign * c[row, first + 1]
    while stride < end / 32.0:
        least = curvature = 0.0
        for n in range(order, first, -1):
            least = end * min(0.0, least) - sign * c[row, n]
        if start + end * min(0.0, least) > 0.0:
            return end, False
        for n in range(order, first + 1, -1):
            curvature = end * min(0.0, curvature) - sign * c[row, n] * (n - first) * (n - first - 1)
        stride = _stride(start, slope, curvature)
        if stride < end / 32.0:
            end /= 16.0
    t = 0.0
    for _ in range(MOST_STRIDES):
        t += stride
        if not t < end:
            return end, False
        value = slope = 0.0
        for n in range(order, first, -1):
            value = value * t - sign * c[row, n]
            slope = slope * t + value
        value = value * t + start
        if value <= 0.0 or stride <= 2e-16 * t:
            return t, slope < 0.0
        stride = _stride(value, slope, curvature)
    return t, False


@compiled()
def _first_fall(
    c: Any, row: int, order: int, end: float, level: float, sign: float
) -> tuple[float, bool]:  # pragma: no cover
    """Find the first sign change of g = level - sign c[row] from + to - over [0, end); return its time and existence.

    If the first coefficients of g are zero, g starts at a known zero, which is divided out.  The search cannot pass
    another zero: each step goes to the first zero of the parabola with the value and slope of g, whose curvature is a
    lower bound of that of g on the whole interval.  The search ends early, without a sign change, at a double zero.
    """
    start, first = level - sign * c[row, 0], 0
    if level > 0.0 and start < 0.0:
        # A negative start within TIE is rounding.
        start = 0.0
    while abs(start) < NOTHING:
        first += 1
        if first > order:
            return end, False
        start = -sign * c[row, first]
    if start < 0.0:
        return 0.0, True
    rest, more = abs(c[row, order]), 0.0
    for n in range(first + 1, order, 2):
        rest, more = rest + abs(c[row, n]), more + abs(c[row, n + 1])
    # A coarse bound first, as most polynomials stay far from zero.
    if first == order or rest + more < start:
        return end, False
    return _walk(c, row, order, first, start, end, sign)


@compiled()
def _first_event(c: Any, order: int, p: Any) -> tuple[float, int, float]:  # pragma: no cover
    """Return the end of the piece, the body with an event there (-1: none) and its new direction (0: it stops)."""
    end, body, direction = 1.0, -1, 0.0
    for b in range(2):
        level = p[1 + b, 0] + p[1 + b, 1]
        for sign in (1.0, -1.0):
            if level == 0.0 or c[11, b] == sign:
                continue
            if c[11, b] == 0.0:
                t, falls = _first_fall(c, 5 + b, order, end, level, sign)
            else:
                t, falls = _first_fall(c, 1 + 2 * b, order, end, 0.0, sign)
            if falls:
                end, body, direction = t, b, sign if c[11, b] == 0.0 else 0.0
            elif t < end:
                end, body = t, -1
    return end, body, direction


@compiled()
def _mode(w: float, acceleration: float, level: float) -> float:  # pragma: no cover
    """Return the mode of a body; a body without friction always has mode 1."""
    if level == 0.0 or w > 0.0:
        return 1.0
    if w == 0.0 and abs(acceleration) <= level * (1.0 + TIE):
        return 0.0
    return 1.0 if w == 0.0 and acceleration > 0.0 else -1.0


@compiled()
def _begin(c: Any, body: int, p: Any) -> None:  # pragma: no cover
    """Determine the mode of a body from the state alone."""
    _accelerations(c, 0, p)
    c[11, body] = _mode(c[1 + 2 * body, 0], c[5 + body, 0], p[1 + body, 0] + p[1 + body, 1])


@compiled()
def _sample(c: Any, u: float, p: Any, Ts: float, tolerance: float) -> int:  # pragma: no cover
    """Advance the state c[:, 0] by one sample; return the status, or NO_NUMBERS."""
    rest, events, size = Ts, 0, abs(u)
    for i in range(5):
        size += abs(c[i, 0])
    if not size < LARGEST:
        return NO_NUMBERS
    for b in range(2):
        _begin(c, b, p)
        c[12, b] = 0.0
    for _ in range(MOST_PIECES):
        order, fraction = _series(c, u, rest, p, tolerance)
        if order == 0:
            return NO_NUMBERS
        t, body, direction = _first_event(c, order, p)
        _evaluate(c, order, t)
        if body < 0 and t * fraction == 1.0:
            return OK
        rest -= t * fraction * rest
        c[12, 0] = c[12, 1] = 0.0
        if body >= 0:
            events += 1
            c[1 + 2 * body, 0] = 0.0
            if direction != 0.0:
                c[11, body], c[12, body] = direction, 1.0
            else:
                _begin(c, body, p)
        if events > MOST_EVENTS:
            break
    return TOO_MANY_EVENTS


@compiled()
def servo_advance(
    k: int, x: Any, u: Any, w: Any, own: Any, shared: Any, sizes: Any, work: Any, out: Any
) -> int:  # fmt: skip  # pragma: no cover
    """Write the state after one sample with constant voltage, process noise included, into ``out``; return the status.

    ``own`` has the coefficients of the run, ``shared`` the sampling time and the bound of the last terms of a series
    relative to its largest term.
    """
    for i in range(5):
        work[i, 0] = x[i]
    end = _sample(work, u[0], own, shared[0, 0], shared[0, 1])
    for i in range(5):
        out[i] = np.nan if end == NO_NUMBERS else work[i, 0]
    for i in range(4):
        out[i] += w[i]
    return max(end, OK)


@compiled()
def servo_points(
    x: Any, u: Any, w: Any, own: Any, shared: Any, sizes: Any, work: Any, x_next: Any, status: Any
) -> None:  # fmt: skip  # pragma: no cover
    """Advance every row of ``x`` by one sample, all with the same coefficients; see `servo_advance`."""
    for row in range(len(x)):
        status[row] = servo_advance(0, x[row], u[row], w, own, shared, sizes, work, x_next[row])
