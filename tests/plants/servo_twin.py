"""The scheme of the servomechanism's kernel written plainly: Taylor series between friction events, one run.

Same idea, other means: physical units, no scaling of time, a fixed order on pieces that are short from the start, and
the roots of the events' polynomials by NumPy, which finds all of them.
"""

import math

import numpy as np
from plants.servo_oracle import breakaway, drive

ORDER = 24
LONGEST = 0.02  # s; there a term of order 24 is below 1e-20 of the first at the parameters of the paper
TIE = 1e-13


def series(p, x, u, mode, released):
    """Coefficients (5, ORDER + 1) of the state in the time; a released body starts without acceleration."""
    c = np.zeros((5, ORDER + 1))
    c[:, 0] = x
    e = np.zeros((2, ORDER + 1))
    for b, name in enumerate("lm"):
        e[b, 0] = math.exp(-p[f"alpha_{name}2"] * mode[b] * x[1 + 2 * b])
    for n in range(ORDER):
        torques = drive(p, c[:, n])
        for b, name in enumerate("lm"):
            angle, speed = 2 * b, 1 + 2 * b
            c[angle, n + 1] = c[speed, n] / (n + 1)
            dry = p[f"alpha_{name}0"] * (n == 0) + p[f"alpha_{name}1"] * e[b, n]
            if mode[b] and not (n == 0 and released == b):
                c[speed, n + 1] = (torques[b] - mode[b] * dry) / p[f"J_{name}"] / (n + 1)
            slopes = [(j + 1) * c[speed, j + 1] for j in range(n + 1)]
            rise = sum(slope * e[b, n - j] for j, slope in enumerate(slopes))
            e[b, n + 1] = -p[f"alpha_{name}2"] * mode[b] * rise / (n + 1)
        c[4, n + 1] = (u * (n == 0) - p["R"] * c[4, n] - p["K_t"] * c[3, n]) / p["L"] / (n + 1)
    return c


def first_fall(g, end):
    """First time in [0, end) at which a polynomial falls below zero, or None."""
    known = next((n for n, value in enumerate(g) if value != 0.0), None)
    if known is None:
        return None
    g = g[known:] * end ** np.arange(len(g) - known)
    if g[0] < 0.0:
        return 0.0
    roots = np.roots(g[::-1])
    for t in np.sort(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real < 1.0)]):
        slope = np.polyval(np.polyder(g[::-1]), t)
        if slope < 0.0:
            for _ in range(3):
                t -= np.polyval(g[::-1], t) / np.polyval(np.polyder(g[::-1]), t)
            return t * end
    return None


def events(p, c, mode, end):
    """Events (time, body, new direction, 0 if it stops) within a piece."""
    for b in (0, 1):
        level = breakaway(p, b)
        if level == 0.0:
            continue
        if mode[b]:
            yield first_fall(mode[b] * c[1 + 2 * b], end), b, 0
            continue
        torque = np.array([drive(p, column)[b] for column in c.T])
        for sign in (1, -1):
            margin = -sign * torque
            margin[0] = max(0.0, level - sign * torque[0])
            yield first_fall(margin, end), b, sign


def mode_of(p, x, b):
    """Mode of a body from the state alone."""
    level, torque, w = breakaway(p, b), drive(p, x)[b], x[1 + 2 * b]
    if w != 0.0 or level == 0.0:
        return 1 if w > 0.0 or level == 0.0 else -1
    return 0 if abs(torque) <= level * (1.0 + TIE) else int(math.copysign(1, torque))


def step(p, x, u, Ts=0.1):
    """State after a sample."""
    x, t, released, mode = np.array(x, dtype=float), 0.0, None, [mode_of(p, x, 0), mode_of(p, x, 1)]
    for _ in range(100):
        end = min(LONGEST, Ts - t)
        c = series(p, x, u, mode, released)
        found = [event for event in events(p, c, mode, end) if event[0] is not None]
        elapsed, body, direction = min(found, default=(end, None, 0))
        x = np.array([np.polyval(row[::-1], elapsed) for row in c])
        t, released = t + elapsed, None
        if body is not None:
            x[1 + 2 * body] = 0.0
            mode[body] = direction or mode_of(p, x, body)
            released = body if direction else None
        elif end < LONGEST or t >= Ts:
            return x
    raise AssertionError("a hundred pieces in one sample")
