"""The Runge-Kutta step of an equation, or a map, compiled together with the user's right-hand side."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from inspect import unwrap
from typing import Any, TypeAlias

import numpy as np

from rmpc_bench.numerics import integration
from rmpc_bench.numerics.integration import DEEPEST, DIFFERENCES, EDGE, LARGEST_DIFFERENCE, LARGEST_ERROR
from rmpc_bench.types import Array, DesignError, Ode

Step: TypeAlias = Callable[[int, Array, Array, Array, Array], Array]
"""x(k+1) of k, rows of x and u, and rows of those that decide on the intervals of error control."""


def compiled_step(ode: Ode, Ts: float, substeps: int, rtol: float) -> Step:
    """Compile x(k+1) for the nominal parameters, with equal steps, or with error control where there are 0."""
    from rmpc_bench.numerics.compiled import numba

    njit: Any = numba.njit
    rhs = njit(ode.rhs)
    # A record of plain numbers, which compiled code can read.
    nominal = dict(ode.nominal) or {"nothing": 0.0}
    p = namedtuple("p", [*nominal])(**nominal)  # noqa: PYI024
    if ode.timed:
        slope = njit(lambda t, x, u, p: np.asarray(rhs(t, x, u, p)))
    else:
        slope = njit(lambda t, x, u, p: np.asarray(rhs(x, u, p)))
    rk4 = njit(_rk4(slope))
    rules = integration.sizes, integration.relative_errors, integration.distances
    halving = _halving(rk4, *(njit(unwrap(rule)) for rule in rules))
    kernel = njit(_map(slope) if ode.discrete else _equal(rk4) if substeps else halving)
    scale = np.array(ode.scale or [0.0] * ode.nx)

    def step(k: int, x: Array, u: Array, lead: Array, u_lead: Array) -> Array:
        given = (np.ascontiguousarray(each) for each in (x, u, lead, u_lead))
        return kernel(k * Ts, *given, p, Ts, substeps, rtol, scale)

    try:
        step(0, *(np.ones((1, n)) for n in (ode.nx, ode.nu, ode.nx, ode.nu)))
    # Numba raises errors of many kinds, and the function is the user's.
    except Exception as error:
        lines = [line.strip(" :") for line in str(error).splitlines() if line.strip()]
        # The first line of numba's errors names only the stage of the compiler.
        reason = next((line for line in lines if not line.startswith("Failed in")), "no reason given")
        raise DesignError(
            f"rhs cannot be compiled ({type(error).__name__}: {reason}); compiled code reads parameters as p.name and "
            "uses numbers, arrays and functions of math and NumPy only",
            "numba",
        ) from None
    return step


def _map(rhs: Any) -> Any:
    def advance(t, x, u, lead, u_lead, p, Ts, substeps, rtol, scale):  # type: ignore[no-untyped-def]
        found = np.empty_like(x)
        for i in range(len(x)):
            found[i] = rhs(t, x[i].copy(), u[i], p)
        return found

    return advance


def _rk4(slope: Any) -> Any:
    """One step; the slope is asked at times from `first` to `last` only."""

    def step(t, h, x, u, p, first, last):  # type: ignore[no-untyped-def]
        middle = min(max(t + h / 2, first), last)
        k1 = slope(min(max(t, first), last), x.copy(), u, p)
        k2 = slope(middle, x + h / 2 * k1, u, p)
        k3 = slope(middle, x + h / 2 * k2, u, p)
        k4 = slope(min(max(t + h, first), last), x + h * k3, u, p)
        return x + h / 6 * (k1 + 2 * (k2 + k3) + k4)

    return step


def _equal(step: Any) -> Any:
    def advance(t, x, u, lead, u_lead, p, Ts, substeps, rtol, scale):  # type: ignore[no-untyped-def]
        h, found = Ts / substeps, x.copy()
        for i in range(len(x)):
            for j in range(substeps):
                found[i] = step(t + j * h, h, found[i], u[i], p, t + EDGE * Ts, t + Ts - EDGE * Ts)
        return found

    return advance


def _halving(step: Any, sizes: Any, errors: Any, distances: Any) -> Any:
    """The rule of numerics/integration.py as a loop, since numba cannot call its closures."""
    # `done` counts 512ths of the sample; the interval after the left half of another one is its right half.
    parts = 2**DEEPEST

    def advance(t, x, u, lead, u_lead, p, Ts, substeps, rtol, scale):  # type: ignore[no-untyped-def]
        x, lead, one, two = x.copy(), lead.copy(), np.empty_like(lead), np.empty_like(lead)
        done, level, first, last = 0, 0, t + EDGE * Ts, t + Ts - EDGE * Ts
        while done < parts:
            now, h = t + done * Ts / parts, Ts / 2**level
            for j in range(len(lead)):
                one[j] = step(now, h, lead[j], u_lead[j], p, first, last)
                middle = step(now, h / 2, lead[j], u_lead[j], p, first, last)
                two[j] = step(now + h / 2, h / 2, middle, u_lead[j], p, first, last)
            size, largest = sizes(lead[0], two[0], scale)
            error, share = errors(one[0], two[0], size, largest, rtol)
            fine, harmless = (share <= 1.0).all(), (error <= LARGEST_ERROR).all()
            for j in range(1, len(lead)):
                away = distances(lead[j], lead[0], size, largest).max()
                off, far = errors(one[j] - one[0], two[j] - two[0], size * away, largest, DIFFERENCES)
                if np.isfinite(lead[j]).all():
                    fine = fine and (far <= 1.0).all()
                    harmless = harmless and ((off <= LARGEST_DIFFERENCE) | ~np.isfinite(off)).all()
            if not fine and level < DEEPEST:
                level += 1
            elif not fine and not harmless:
                return x * np.nan
            else:
                for i in range(len(x)):
                    middle = step(now, h / 2, x[i], u[i], p, first, last)
                    x[i] = step(now + h / 2, h / 2, middle, u[i], p, first, last)
                lead[:], done = two, done + parts // 2**level
                while level > 0 and done % (2 * parts // 2**level) == 0:
                    level -= 1
        return x

    return advance
