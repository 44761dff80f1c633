"""Collocation reference of the nonlinear servomechanism, compiled, with a log of its events.

Written from section 4.1 and Tables 1 and 2 of Zenere and Zorzi (2018), "On the coupling of model predictive control
and robust Kalman filtering", read in the sense of Filippov, as `servo_oracle` is, but of a different kind:

- one-step implicit: Gauss collocation (order twice its number of nodes) by fixed-point iteration, on steps of a fixed
  share of the fastest time constant;
- in other coordinates: the shaft's twist ``theta_m / rho - theta_l`` stands in for the motor angle, so that its torque
  suffers no cancellation;
- events by halving: a step is taken only if the Bernstein coefficients of every event function have no sign change
  over it, which excludes a root; otherwise it is integrated again over half its length, down to 1e-15 s. No root is
  ever computed, none can be jumped over, and a known root at the start of a step (Bernstein's first coefficient, the
  others are free of it) needs no care.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np

NAMES = ("L", "J_m", "beta_m", "R", "K_t", "rho", "k_theta", "J_l", "beta_l")
NAMES += ("alpha_l0", "alpha_l1", "alpha_l2", "alpha_m0", "alpha_m1", "alpha_m2")

#: Relative excess of the breakaway torque at which a body leaves rest: above the rounding of the Bernstein
#: coefficients (1e-13), and without effect on accuracy, because what a late release changes is of its second order.
MARGIN = 5e-12
SHORTEST = 1e-15  # s; a body that turns round errs by 2 F / J times this: 1e-14 rad/s of the motor
ITERATIONS = 40  # of the fixed point; about 10 are needed
EVENTS = 200  # room in the log of one sample
STICK, RELEASE, REVERSAL = 0, 1, 2


class Tolerance(NamedTuple):
    """Number of Gauss nodes, and the step in units of the fastest time constant."""

    nodes: int
    share: float


COARSE, FINE = Tolerance(7, 0.25), Tolerance(9, 0.1)


class Table(NamedTuple):
    """Collocation on [0, 1]: weights of the stages (n, n), of the end (n), and of the Bernstein coefficients (n, n)."""

    stages: Any
    end: Any
    bernstein: Any
    share: float


class Log(NamedTuple):
    """Events in the order of their times: sample, time from the first one [s], body (0: load, 1: motor), kind."""

    sample: Any
    t: Any
    body: Any
    kind: Any

    def signature(self) -> tuple[tuple[int, int, int], ...]:
        """Samples, bodies and kinds in their order."""
        return tuple(zip(self.sample.tolist(), self.body.tolist(), self.kind.tolist(), strict=True))


@cache
def table(tolerance: Tolerance) -> Table:
    """Gauss collocation of a tolerance."""
    n = tolerance.nodes
    points, weights = np.polynomial.legendre.leggauss(n)
    legendre = np.polynomial.legendre.legvander(points, n)
    degrees = np.arange(n)
    # discrete orthogonality: the interpolant's Legendre coefficients are projections of the nodes' values
    project = (2 * degrees[:, None] + 1) / 2 * legendre[:, :n].T * weights
    integral = np.zeros((n, n))  # of each Legendre polynomial from -1 to each node
    integral[:, 0] = points + 1
    for j in range(1, n):
        integral[:, j] = (legendre[:, j + 1] - legendre[:, j - 1]) / (2 * j + 1)
    c = (points + 1) / 2
    binomials = np.cumprod(np.concatenate([[1.0], (n - degrees[1:]) / degrees[1:]]))
    basis = binomials * c[:, None] ** degrees * (1 - c[:, None]) ** (n - 1 - degrees)
    return Table(integral @ project / 2, weights / 2, np.linalg.inv(basis), tolerance.share)


@numba.njit(cache=True)
def _slope(p, u, mode_l, mode_m, z, out):
    """Right-hand side at ``z = [theta_l, omega_l, twist, omega_m, I]``."""
    inductance, j_m, beta_m, resistance, k_t, rho, k, j_l, beta_l = p[:9]
    out[0] = z[1]
    out[1] = out[3] = 0.0
    if mode_l != 0:
        out[1] = (k * z[2] - beta_l * z[1] - mode_l * (p[9] + p[10] * np.exp(-p[11] * mode_l * z[1]))) / j_l
    out[2] = z[3] / rho - z[1]
    if mode_m != 0:
        friction = mode_m * (p[12] + p[13] * np.exp(-p[14] * mode_m * z[3]))
        out[3] = (k_t * z[4] - k / rho * z[2] - beta_m * z[3] - friction) / j_m
    out[4] = (u - resistance * z[4] - k_t * z[3]) / inductance


@numba.njit(cache=True)
def _size(p, u, z):
    """Magnitude of the terms that make up the accelerations; their sum is only as exact as they are."""
    inductance, j_m, beta_m, resistance, k_t, rho, k, j_l, beta_l = p[:9]
    load = (abs(k * z[2]) + abs(beta_l * z[1]) + p[9] + p[10]) / j_l
    motor = (abs(k_t * z[4]) + abs(k / rho * z[2]) + abs(beta_m * z[3]) + p[12] + p[13]) / j_m
    return max(load, motor, (abs(u) + abs(resistance * z[4]) + abs(k_t * z[3])) / inductance)


@numba.njit(cache=True)
def _collocate(p, u, mode_l, mode_m, z, h, stages, k):
    """Fill the slopes ``k`` (n, 5) at the nodes of a step; return whether the fixed point was reached."""
    n = stages.shape[0]
    place, slope = np.empty(5), np.empty(5)
    _slope(p, u, mode_l, mode_m, z, slope)
    for i in range(n):
        k[i] = slope
    last, size = np.inf, _size(p, u, z)
    for _ in range(ITERATIONS):
        change = 0.0
        for i in range(n):
            for c in range(5):
                total = 0.0
                for j in range(n):
                    total += stages[i, j] * k[j, c]
                place[c] = z[c] + h * total
            _slope(p, u, mode_l, mode_m, place, slope)
            for c in range(5):
                if not np.isfinite(slope[c]):  # too long a step across an event
                    return False
                change = max(change, abs(slope[c] - k[i, c]))
                k[i, c] = slope[c]
        # at rounding the change stops falling
        if change <= 1e-17 * size or (change <= 1e-13 * size and change >= 0.5 * last):
            return True
        last = change
    return False


@numba.njit(cache=True)
def _bend(p, h, k):
    """How much the exponents of the friction change over a step; from far off an exponential looks like zero."""
    return h * max(p[11] * np.abs(k[:, 1]).max(), p[14] * np.abs(k[:, 3]).max())


@numba.njit(cache=True)
def _torque(p, body, twist, current):
    """Torque on a body at rest, friction apart."""
    return p[6] * twist if body == 0 else p[4] * current - p[6] / p[5] * twist


@numba.njit(cache=True)
def _dips(start, h, rises, sign, offset):
    """Whether ``offset + sign * polynomial`` has a negative Bernstein coefficient; ``rises`` are of its derivative."""
    n, total = rises.shape[0], start
    if offset + sign * start < 0:
        return True
    for j in range(n):
        total += h / n * rises[j]
        if offset + sign * total < 0:
            return True
    return False


@numba.njit(cache=True)
def _suspect(p, mode, z, h, k, bernstein):
    """Body of a possible event within a step, -1 if there is none."""
    rises = bernstein @ k
    for body in range(2):
        limit = p[9 + 3 * body] + p[10 + 3 * body]
        if limit == 0.0:
            continue
        if mode[body] != 0:
            if _dips(z[1 + 2 * body], h, rises[:, 1 + 2 * body], mode[body], 0.0):
                return body
            continue
        if body == 0:
            torques = p[6] * rises[:, 2]
        else:
            torques = p[4] * rises[:, 4] - p[6] / p[5] * rises[:, 2]
        for sign in (1, -1):
            if _dips(_torque(p, body, z[2], z[4]), h, torques, -sign, limit * (1 + MARGIN)):
                return body
    return -1


@numba.njit(cache=True)
def _mode_at_rest(p, body, z):
    """Mode of a body whose velocity is zero."""
    torque, limit = _torque(p, body, z[2], z[4]), p[9 + 3 * body] + p[10 + 3 * body]
    if limit == 0.0:
        return 1
    if abs(torque) <= limit * (1 + MARGIN):
        return 0
    return 1 if torque > 0 else -1


@numba.njit(cache=True)
def _turn(p, mode, z, body):
    """Carry out an event in ``mode`` and ``z``; return its kind, or -1 if a body at rest stays there."""
    slipped = mode[body] != 0
    z[1 + 2 * body] = 0.0
    mode[body] = _mode_at_rest(p, body, z)
    if slipped:
        return STICK if mode[body] == 0 else REVERSAL
    return -1 if mode[body] == 0 else RELEASE


@numba.njit(cache=True)
def _hold(p, z, u, duration, share, longest, stages, end, bernstein, log):
    """Move ``z`` over a duration under a voltage; fill the log and return the number of events, or -1."""
    n, events, t, h = stages.shape[0], 0, 0.0, longest
    k, mode, lost = np.empty((n, 5)), np.empty(2, np.int64), np.zeros(5)
    for body in range(2):
        speed = z[1 + 2 * body]
        friction = p[9 + 3 * body] + p[10 + 3 * body] > 0
        mode[body] = _mode_at_rest(p, body, z) if speed == 0 or not friction else np.int64(np.sign(speed))
    direct = True
    while t < duration:
        h = min(h, longest, duration - t)
        reached = _collocate(p, u, mode[0], mode[1], z, h, stages, k) and _bend(p, h, k) <= 8 * share
        body = _suspect(p, mode, z, h, k, bernstein) if reached else 2
        if body >= 0 and h > SHORTEST:
            h, direct = h / 2, False
            continue
        if body == 2 or events == len(log):
            return -1
        rise = h * (end @ k) + lost
        lost = rise - ((z + rise) - z)  # or thousands of small steps would add up their rounding
        z += rise
        t = duration if h == duration - t else t + h
        h, direct = h * (2 if direct else 1), True
        kind = _turn(p, mode, z, body) if body >= 0 else -1
        if body >= 0:
            lost[1 + 2 * body] = 0.0
        if kind >= 0:
            log[events, 0], log[events, 1], log[events, 2] = t, body, kind
            events, h = events + 1, longest
    return events


@numba.njit(cache=True)
def _held(p, x0, volts, duration, share, longest, stages, end, bernstein, states, log):
    """Fill ``states`` (samples + 1, 5) under held voltages and the log; return the number of events, or -1."""
    rho, count, room = p[5], 0, np.empty((EVENTS, 3))
    states[0] = x0
    z = x0.copy()
    z[2] = x0[2] / rho - x0[0]
    for i in range(len(volts)):
        events = _hold(p, z, volts[i], duration, share, longest, stages, end, bernstein, room)
        if events < 0 or count + events > len(log):
            return -1
        for j in range(events):
            log[count, 0], log[count, 1] = i, i * duration + room[j, 0]
            log[count, 2:] = room[j, 1:]
            count += 1
        states[i + 1] = z
        states[i + 1, 2] = rho * (z[2] + z[0])
    return count


def fastest(p: Mapping[str, float]) -> float:
    """Return an upper estimate of the rates of the plant [1/s]."""
    electric, exchange = p["R"] / p["L"], p["K_t"] / np.sqrt(p["J_m"] * p["L"])
    shaft = np.sqrt(p["k_theta"] / p["J_l"] + p["k_theta"] / p["rho"] ** 2 / p["J_m"])
    load = (p["beta_l"] + p["alpha_l1"] * p["alpha_l2"]) / p["J_l"]
    motor = (p["beta_m"] + p["alpha_m1"] * p["alpha_m2"]) / p["J_m"]
    return float(max(electric, exchange, shaft, load, motor))


def held(
    p: Mapping[str, float], volts: Sequence[float], x: Any = None, Ts: float = 0.1, tolerance: Tolerance = FINE
) -> tuple[Any, Log]:
    """Integrate the plant under a sequence of voltages, each held for one sample.

    Parameters
    ----------
    p, volts
        Parameters, with an inductance above zero, and voltages.
    x
        State ``[theta_l, omega_l, theta_m, omega_m, I]`` at the start; rest at zero if not given.
    Ts, tolerance
        Sampling time, in seconds; nodes and steps.

    Returns
    -------
    states, log
        States (samples + 1, 5), in which the velocity of a stuck body is exactly zero, and what happened.
    """
    row = np.array([p[name] for name in NAMES])
    u = np.array(volts, dtype=np.float64)
    states, log = np.empty((len(u) + 1, 5)), np.empty((EVENTS * (1 + len(u)), 4))
    start = np.zeros(5) if x is None else np.array(x, dtype=np.float64)
    stages, end, bernstein, share = table(tolerance)
    count = _held(row, start, u, Ts, share, share / fastest(p), stages, end, bernstein, states, log)
    if count < 0:
        raise RuntimeError(f"no progress: {dict(p)}, start {start}, volts {u}")
    sample, t, body, kind = log[:count].T
    return states, Log(sample.astype(int), t.copy(), body.astype(int), kind.astype(int))
