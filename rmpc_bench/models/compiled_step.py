"""The Runge-Kutta step of an equation, or a map, compiled together with the user's right-hand side."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from rmpc_bench.types import Array, DesignError, Ode

Step: TypeAlias = Callable[[int, Array, Array], Array]
"""x(k+1) of (k, x, u)."""


def compiled_step(ode: Ode, Ts: float, substeps: int) -> Step:
    """Compile x(k+1) for the nominal parameters.

    Parameters
    ----------
    ode : an equation whose rhs reads its parameters as ``p.name``
    Ts : sampling time [s]
    substeps : steps per sample

    Raises
    ------
    DesignError
        If numba cannot compile the right-hand side, with its reason.
    """
    from rmpc_bench.numerics.compiled import numba

    rhs = numba.njit(ode.rhs)
    # A record of plain numbers, which compiled code can read.
    nominal = dict(ode.nominal) or {"nothing": 0.0}
    p = namedtuple("p", [*nominal])(**nominal)  # noqa: PYI024
    slope = _timed(numba.njit, rhs) if ode.timed else _untimed(numba.njit, rhs)
    kernel = numba.njit(_map(slope) if ode.discrete else _kernel(slope))
    h = Ts / substeps

    def step(k: int, x: Array, u: Array) -> Array:
        moved: Array = kernel(k * Ts, np.ascontiguousarray(x), np.ascontiguousarray(u), p, h, substeps)
        return moved

    try:
        step(0, np.ones(ode.nx), np.ones(ode.nu))
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


def _untimed(njit: Any, rhs: Any) -> Any:
    def slope(t, x, u, p):  # type: ignore[no-untyped-def]
        return np.asarray(rhs(x, u, p))

    return njit(slope)


def _timed(njit: Any, rhs: Any) -> Any:
    def slope(t, x, u, p):  # type: ignore[no-untyped-def]
        return np.asarray(rhs(t, x, u, p))

    return njit(slope)


def _map(rhs: Any) -> Any:
    def advance(t, x, u, p, h, substeps):  # type: ignore[no-untyped-def]
        return rhs(t, x.copy(), u, p)

    return advance


def _kernel(slope: Any) -> Any:
    def advance(t, x, u, p, h, substeps):  # type: ignore[no-untyped-def]
        for j in range(substeps):
            now = t + j * h
            k1 = slope(now, x.copy(), u, p)
            k2 = slope(now + h / 2, x + h / 2 * k1, u, p)
            k3 = slope(now + h / 2, x + h / 2 * k2, u, p)
            k4 = slope(now + h, x + h * k3, u, p)
            x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
        return x

    return advance
