"""Forty-digit reference of the nonlinear servomechanism: few loops, no doubt about rounding or truncation.

Written from section 4.1 of Zenere and Zorzi (2018), read in the sense of Filippov. Power series of order 40 of every
smooth piece in mpmath; a step is shortened until its last terms are below 1e-38; events are found by de Casteljau's
subdivision of the series in Bernstein form, down to 1e-36 of a step.
"""

from collections.abc import Mapping, Sequence
from math import comb
from typing import Any

import mpmath
import numpy as np
from mpmath import mpf

DIGITS, ORDER, STEP = 40, 40, 0.02
SMALL = mpf(10) ** -38  # of the last terms [rad, rad/s, A]
DEPTH = 120  # halvings: 2^-120 = 1e-36
MARGIN = mpf(10) ** -30  # relative excess of the breakaway torque at a release

with mpmath.workdps(DIGITS):
    _BERNSTEIN = [[mpf(comb(j, i)) / comb(ORDER, i) for i in range(j + 1)] for j in range(ORDER + 1)]
_SPEED = (1, 3)


def _limit(p: Mapping[str, Any], body: int) -> Any:
    return p[f"alpha_{'lm'[body]}0"] + p[f"alpha_{'lm'[body]}1"]


def _torque(p: Mapping[str, Any], body: int, twist: Any, current: Any) -> Any:
    """Torque on a body at rest, friction apart."""
    return p["k_theta"] * twist if body == 0 else p["K_t"] * current - p["k_theta"] / p["rho"] * twist


def _at_rest(p: Mapping[str, Any], body: int, z: Sequence[Any]) -> int:
    torque, limit = _torque(p, body, z[2], z[4]), _limit(p, body)
    if limit == 0:
        return 1
    return 0 if abs(torque) <= limit * (1 + MARGIN) else int(mpmath.sign(torque))


def _series(p: Mapping[str, Any], u: Any, mode: Sequence[int], z: Sequence[Any]) -> list[list[Any]]:
    """Coefficients of ``[theta_l, omega_l, twist, omega_m, I]`` in powers of time."""
    angle, load, twist, motor, current = ([value] for value in z)
    speeds, decays = (load, motor), []
    for body, b in enumerate("lm"):
        decays.append([mpmath.exp(-p[f"alpha_{b}2"] * mode[body] * z[_SPEED[body]])])
    for n in range(ORDER):
        accelerations = []
        for body, (b, inertia) in enumerate((("l", p["J_l"]), ("m", p["J_m"]))):
            friction = p[f"alpha_{b}1"] * decays[body][n] + (p[f"alpha_{b}0"] if n == 0 else 0)
            torque = _torque(p, body, twist[n], current[n]) - p[f"beta_{b}"] * speeds[body][n] - mode[body] * friction
            accelerations.append(torque / inertia if mode[body] else mpf(0))
        slope = ((u if n == 0 else 0) - p["R"] * current[n] - p["K_t"] * motor[n]) / p["L"]
        angle.append(load[n] / (n + 1))
        twist.append((motor[n] / p["rho"] - load[n]) / (n + 1))
        current.append(slope / (n + 1))
        for body, b in enumerate("lm"):
            speeds[body].append(accelerations[body] / (n + 1))
            # E = exp(-a s w) has E' = -a s w' E
            products = [((j + 1) * speeds[body][j + 1], decays[body][n - j]) for j in range(n + 1)]
            decays[body].append(-p[f"alpha_{b}2"] * mode[body] / (n + 1) * mpmath.fdot(products))
    return [angle, load, twist, motor, current]


def _converged(p: Mapping[str, Any], series: list[list[Any]], h: Any) -> bool:
    """Whether the series represent the solution over a step.

    Small last terms do not suffice: where exp(-a |w|) starts at 1e-260 and w falls to zero, all terms that would tell
    of it are as small. So its exponent may not change by more than 10.
    """
    if max(abs(c[-i]) * h ** (ORDER + 1 - i) for c in series for i in (1, 2, 3)) > SMALL:
        return False
    changes = [sum(abs(value) * h**n for n, value in enumerate(series[speed]) if n) for speed in _SPEED]
    return all(p[f"alpha_{b}2"] * change <= 10 for b, change in zip("lm", changes, strict=True))


def _descent(b: list[Any], depth: int = DEPTH) -> Any:
    """Place in [0, 1] where a polynomial in Bernstein form first becomes negative, or None."""
    if all(value >= 0 for value in b):
        return None
    if depth == 0:
        return mpf(0)
    left, right, row = [b[0]], [b[-1]], b
    while len(row) > 1:
        row = [(x + y) / 2 for x, y in zip(row[:-1], row[1:], strict=True)]
        left.append(row[0])
        right.append(row[-1])
    place = _descent(left, depth - 1)
    if place is not None:
        return place / 2
    place = _descent(right[::-1], depth - 1)
    return None if place is None else (1 + place) / 2


def _first(p: Mapping[str, Any], mode: Sequence[int], c: list[list[Any]]) -> tuple[Any, int]:
    """Place of the first event within a step of scaled coefficients, and its body (-1: there is none)."""
    first = mpf(1), -1
    for body in (0, 1):
        limit = _limit(p, body)
        if limit == 0:
            continue
        gaps = [[mode[body] * value for value in c[_SPEED[body]]]]
        if not mode[body]:
            torque = [_torque(p, body, *pair) for pair in zip(c[2], c[4], strict=True)]
            gaps = [[-sign * value for value in torque] for sign in (1, -1)]
            for gap in gaps:
                gap[0] += limit * (1 + MARGIN)
        for gap in gaps:
            place = _descent([mpmath.fdot(zip(row, gap, strict=False)) for row in _BERNSTEIN])
            if place is not None and place < first[0]:
                first = place, body
    return first


def _hold(p: Mapping[str, Any], z: list[Any], u: Any, duration: Any) -> tuple[list[Any], int]:
    """State after a duration under a voltage, and the number of events."""
    friction = [_limit(p, body) > 0 for body in (0, 1)]
    mode = [
        int(mpmath.sign(z[_SPEED[body]])) if z[_SPEED[body]] and friction[body] else _at_rest(p, body, z)
        for body in (0, 1)
    ]
    t, events = mpf(0), 0
    while t < duration:
        series, h = _series(p, u, mode, z), min(mpf(STEP), duration - t)
        while not _converged(p, series, h):
            h /= 2
        place, body = _first(p, mode, [[value * h**n for n, value in enumerate(c)] for c in series])
        z = [mpmath.polyval(c[::-1], place * h) for c in series]
        t = duration if place * h == duration - t else t + place * h
        if body >= 0:
            z[_SPEED[body]], events = mpf(0), events + 1
            sign = 1 if _torque(p, body, z[2], z[4]) > 0 else -1
            mode[body] = sign if mode[body] == 0 else _at_rest(p, body, z)
        if events > 1000:
            raise RuntimeError(f"no progress at {t}: {z}")
    return z, events


def held(p: Mapping[str, float], volts: Sequence[float], x: Sequence[float], Ts: float = 0.1) -> tuple[Any, int]:
    """Integrate the plant under voltages that are held for one sample each.

    Parameters
    ----------
    p, volts, x, Ts
        As in `servo_reference.held`; the numbers are taken to be exact.

    Returns
    -------
    states : array
        States (samples + 1, 5), rounded.
    events : int
        Number of events.
    """
    with mpmath.workdps(DIGITS):
        exact = {name: mpf(float(value)) for name, value in p.items()}
        z, states, events = [mpf(float(value)) for value in x], [[float(value) for value in x]], 0
        z[2] = z[2] / exact["rho"] - z[0]
        for u in volts:
            z, new = _hold(exact, z, mpf(float(u)), mpf(float(Ts)))
            events += new
            motor = exact["rho"] * (z[2] + z[0])
            states.append([float(value) for value in (z[0], z[1], motor, z[3], z[4])])
        return np.array(states), events
