"""Event-driven stick/slip reference of the nonlinear servomechanism.

Written from section 4.1 and Tables 1 and 2 of Zenere and Zorzi (2018), "On the coupling of model predictive
control and robust Kalman filtering", and from nothing else, so that it can judge the bench's own plant. The state
is ``[theta_l, omega_l, theta_m, omega_m, I]``. Friction is read in the sense of Filippov: at rest its torque takes
any value in ``[-(a0 + a1), a0 + a1]``, and a body stays at rest as long as such a value balances it.

Two methods of different kind are given. `flow` integrates the smooth pieces between stick/slip events by DOP853.
Within each step the dense output is a polynomial of degree 7 and every event function is linear in the state, so
*all* roots of it are found: no episode within a step is jumped over, and the known root at the start of a slip
phase is divided out exactly. `fine_step` is a first-order fixed-step impulse scheme without any event.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import DOP853

Vector = NDArray[np.float64]
Mode = tuple[int, int]

EPS_MIN, EPS_MAX = 0.05, 0.10

#: The actual plant of Table 2 at ``eps_min = +5 %`` and ``eps_max = +10 %``.
TABLE_2: dict[str, float] = {
    "L": 0.8,
    "J_m": 0.5 * (1 + EPS_MAX),
    "beta_m": 0.1 * (1 + EPS_MAX),
    "R": 20.0 * (1 + EPS_MIN),
    "K_t": 10.0 * (1 + EPS_MAX),
    "rho": 20.0 * (1 + EPS_MIN),
    "k_theta": 1280.2 * (1 + EPS_MIN),
    "J_l": 25.0 * (1 - EPS_MAX),
    "beta_l": 25.0 * (1 + EPS_MAX),
    "alpha_l0": 0.5,
    "alpha_l1": 10.0,
    "alpha_l2": 0.5,
    "alpha_m0": 0.1,
    "alpha_m1": 2.0,
    "alpha_m2": 0.5,
}

#: A body at rest leaves it where the torque exceeds the breakaway torque by this relative margin. It is far above
#: rounding, so a released body has a strictly positive acceleration, and far below every accuracy asked for.
MARGIN = 1e-11

_BODIES = ("l", "m")
_SPEED = (1, 3)  # where the velocities of load and motor stand in the state
_DEGREE = 7  # of the dense output of DOP853
_IDLE_LIMIT = 50  # events in a row without any progress of time

_NODES = (1 - np.cos(np.pi * (2 * np.arange(1, _DEGREE + 1) - 1) / (2 * _DEGREE))) / 2
_FIT = np.linalg.inv(np.vander(_NODES, increasing=True))
_BERNSTEIN = np.array([[math.comb(i, j) / math.comb(_DEGREE, j) for j in range(_DEGREE + 1)]
                       for i in range(_DEGREE + 1)])  # fmt: skip


def breakaway(p: dict[str, float], body: int) -> float:
    """Return the largest friction torque of a body (0: load, 1: motor) at rest."""
    return p[f"alpha_{_BODIES[body]}0"] + p[f"alpha_{_BODIES[body]}1"]


def drive(p: dict[str, float], x: ArrayLike) -> tuple[float, float]:
    """Return the torques that act on load and motor, friction of (20) and (21) apart."""
    angle_l, speed_l, angle_m, speed_m, current = (float(value) for value in np.asarray(x))
    torsion = p["k_theta"] / p["rho"] * (angle_m / p["rho"] - angle_l)
    return p["rho"] * torsion - p["beta_l"] * speed_l, p["K_t"] * current - torsion - p["beta_m"] * speed_m


def friction_mode(p: dict[str, float], x: ArrayLike) -> Mode:
    """Return the mode of load and motor, derived from the state alone.

    Returns
    -------
    tuple of int
        For each body 1 or -1 if it slips in that direction, 0 if it is stuck. A body without Coulomb friction has
        no modes; it counts as 1.
    """
    torques = drive(p, x)
    speeds = [float(np.asarray(x)[i]) for i in _SPEED]
    modes = []
    for body in (0, 1):
        limit = breakaway(p, body)
        if limit == 0:
            modes.append(1)
        elif speeds[body] != 0:
            modes.append(1 if speeds[body] > 0 else -1)
        elif abs(torques[body]) <= limit * (1 + MARGIN):
            modes.append(0)
        else:
            modes.append(1 if torques[body] > 0 else -1)
    return modes[0], modes[1]


def _smooth_rhs(p: dict[str, float], u: float, mode: Mode) -> Callable[[float, Vector], list[float]]:
    """Return the right-hand side of one smooth mode, extended smoothly through zero velocity."""
    k, rho, mode_l, mode_m = p["k_theta"], p["rho"], *mode
    inertia_l, beta_l, l0, l1, l2 = (p[key] for key in ("J_l", "beta_l", "alpha_l0", "alpha_l1", "alpha_l2"))
    inertia_m, beta_m, m0, m1, m2 = (p[key] for key in ("J_m", "beta_m", "alpha_m0", "alpha_m1", "alpha_m2"))
    inductance, resistance, k_t = p["L"], p["R"], p["K_t"]

    def rhs(_t: float, x: Vector) -> list[float]:
        angle_l, speed_l, angle_m, speed_m, current = x.tolist()
        torsion = k / rho * (angle_m / rho - angle_l)
        acceleration_l = acceleration_m = 0.0
        if mode_l:
            friction = mode_l * (l0 + l1 * math.exp(-l2 * mode_l * speed_l))
            acceleration_l = (rho * torsion - beta_l * speed_l - friction) / inertia_l
        if mode_m:
            friction = mode_m * (m0 + m1 * math.exp(-m2 * mode_m * speed_m))
            acceleration_m = (k_t * current - torsion - beta_m * speed_m - friction) / inertia_m
        slope = (u - resistance * current - k_t * speed_m) / inductance
        return [speed_l, acceleration_l, speed_m, acceleration_m, slope]

    return rhs


def _first_descent(c: Vector) -> float | None:
    """Return the first point of ``[0, 1]`` behind which a polynomial is negative, if any.

    Parameters
    ----------
    c
        Coefficients in increasing powers. Leading exact zeros are the known roots at the start.

    Returns
    -------
    float or None
        0 if the polynomial is negative at once.
    """
    if c[0] >= 0 and bool(np.all(_BERNSTEIN[1:] @ c > 0)):
        return None
    roots = np.roots(c[::-1])
    inside = np.sort(roots.real[(roots.imag == 0) & (roots.real > 0) & (roots.real < 1)])
    marks = np.concatenate([[0.0], inside, [1.0]])
    for left, right in zip(marks[:-1], marks[1:], strict=True):
        if np.polyval(c[::-1], (left + right) / 2) < 0:
            return float(left)
    return None


def _polynomials(start: Vector, slope: Vector, dense: Callable[[Vector], Vector], t: float, h: float) -> Vector:
    """Return the coefficients (5 x 8) of a step's dense output in ``(time - t) / h``; the first two are exact."""
    rise = (dense(t + h * _NODES) - start[:, None]) / _NODES
    c = np.concatenate([start[:, None], rise @ _FIT.T], axis=1)
    c[:, 1] = h * slope
    return c


def _events(p: dict[str, float], mode: Mode, c: Vector) -> list[tuple[float, int, int]]:
    """Return the first event of each kind within a step.

    Returns
    -------
    list of tuple
        Place in ``[0, 1]``, body, and the direction of the release (0: the body comes to rest).
    """
    k, rho = p["k_theta"], p["rho"]
    rows = (np.array([-k, 0, k / rho, 0, 0]), np.array([k / rho, 0, -k / rho**2, -p["beta_m"], p["K_t"]]))
    torques = drive(p, c[:, 0])
    candidates = []
    for body in (0, 1):
        limit = breakaway(p, body)
        if mode[body]:
            if limit > 0:
                candidates.append((mode[body] * c[_SPEED[body]], body, 0))
            continue
        torque = rows[body] @ c
        torque[0] = torques[body]
        for sign in (1, -1):
            gap = -sign * torque
            gap[0] += limit * (1 + MARGIN)
            candidates.append((gap, body, sign))
    places = [(_first_descent(g), body, sign) for g, body, sign in candidates]
    return [(place, body, sign) for place, body, sign in places if place is not None]


def _piece(
    p: dict[str, float], x: Vector, u: float, mode: Mode, duration: float, tol: dict[str, float]
) -> tuple[Vector, Mode, float]:
    """Integrate until the first event or the end; return state, next mode, elapsed time."""
    rhs = _smooth_rhs(p, u, mode)
    solver = DOP853(rhs, 0.0, x, duration, **tol)
    while solver.status == "running":
        start, slope = solver.y.copy(), np.array(rhs(0.0, solver.y))
        with np.errstate(invalid="ignore"):  # at rest SciPy's error norm may be 0 / 0; it then takes a shorter step
            message = solver.step()
        if solver.status == "failed":
            raise RuntimeError(message)
        h = solver.t - solver.t_old
        dense = solver.dense_output()
        found = _events(p, mode, _polynomials(start, slope, dense, solver.t_old, h))
        if not found:
            continue
        place, body, sign = min(found)
        elapsed = solver.t_old + place * h
        end = start if place == 0 else dense(elapsed)
        modes = list(mode)
        end[_SPEED[body]] = 0.0
        modes[body] = sign or friction_mode(p, end)[body]
        return end, (modes[0], modes[1]), elapsed
    return solver.y, mode, duration


def flow(
    p: dict[str, float], x: ArrayLike, u: float, duration: float,
    rtol: float = 1e-10, atol: float = 1e-12, max_step: float = 5e-3,
) -> Vector:  # fmt: skip
    """Integrate the plant under a constant voltage.

    Parameters
    ----------
    p, x
        Parameters of the plant, with an inductance above zero, and its state at the start.
    u, duration
        Voltage, and the time it is held, in seconds.
    rtol, atol
        Tolerances of DOP853.
    max_step
        Longest step, in seconds; it bounds the error of the dense output in which events are located.

    Returns
    -------
    array
        State at the end. The velocity of a stuck body is exactly zero.
    """
    if p["L"] <= 0:
        raise ValueError("the reference needs an inductance above zero")
    state = np.array(x, dtype=np.float64)
    mode, t, idle = friction_mode(p, state), 0.0, 0
    tol = {"rtol": rtol, "atol": atol, "max_step": max_step}
    while t < duration:
        rest = duration - t
        state, mode, elapsed = _piece(p, state, float(u), mode, rest, tol)
        t = duration if elapsed == rest else t + elapsed
        idle = idle + 1 if elapsed < 1e-15 else 0
        if idle > _IDLE_LIMIT:
            raise RuntimeError(f"events without progress at t = {t}, state {state}")
    return state


def fine_step(p: dict[str, float], x: ArrayLike, u: float, duration: float, h: float) -> Vector:
    """Integrate the plant by a fixed-step impulse scheme of first order, without events.

    The friction torque is evaluated at the old speed and may at most bring a body to rest within the step. The
    angles move with the new speeds.

    Parameters
    ----------
    p, x, u, duration
        As for `flow`.
    h
        Step; rounded so that a whole number of steps makes up the duration.
    """
    steps = max(1, round(duration / h))
    h = duration / steps
    th_l, w_l, th_m, w_m, current = (float(value) for value in np.asarray(x))
    k, rho, k_t = p["k_theta"], p["rho"], p["K_t"]
    for _ in range(steps):
        torsion = k / rho * (th_m / rho - th_l)
        limit_l = p["alpha_l0"] + p["alpha_l1"] * math.exp(-p["alpha_l2"] * abs(w_l))
        limit_m = p["alpha_m0"] + p["alpha_m1"] * math.exp(-p["alpha_m2"] * abs(w_m))
        free_l = w_l + h * (rho * torsion - p["beta_l"] * w_l) / p["J_l"]
        free_m = w_m + h * (k_t * current - torsion - p["beta_m"] * w_m) / p["J_m"]
        current += h * (u - p["R"] * current - k_t * w_m) / p["L"]
        w_l = math.copysign(max(abs(free_l) - h * limit_l / p["J_l"], 0.0), free_l)
        w_m = math.copysign(max(abs(free_m) - h * limit_m / p["J_m"], 0.0), free_m)
        th_l += h * w_l
        th_m += h * w_m
    return np.array([th_l, w_l, th_m, w_m, current])


def closed_loop(
    p: dict[str, float], controller: Callable[[int, float], float], n_steps: int, Ts: float = 0.1, **tol: Any
) -> tuple[Vector, Vector]:
    """Run a sampled controller on the plant, from rest at zero.

    Parameters
    ----------
    controller
        Called as ``controller(k, y_k)`` for ``k = 0 .. n_steps - 1``; returns the voltage held until ``k + 1``.

    Returns
    -------
    y : array
        Load angle at ``k = 0 .. n_steps``.
    u : array
        Voltages at ``k = 0 .. n_steps - 1``.
    """
    x = np.zeros(5)
    y, u = np.zeros(n_steps + 1), np.zeros(n_steps)
    for k in range(n_steps):
        u[k] = controller(k, float(y[k]))
        x = flow(p, x, float(u[k]), Ts, **tol)
        y[k + 1] = x[0]
    return y, u
