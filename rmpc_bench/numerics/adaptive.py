"""Integration of one run by `scipy.integrate.solve_ivp`, with bounds of the states and events.

Bounds   The right-hand side is asked inside the bounds only: at a state outside, which an integrator may try or pass
         through on its way out, it is asked at the nearest state inside.  A run has left its bounds when a state is
         outside at the end of a step of the integrator.
Events   A scalar function passes through 0.  The run ends there, or its state is replaced and the integration goes on.
Limits   Some integrators never return where a solution grows without limit in a finite time; they are stopped after
         `MAX_CALLS` calls of the right-hand side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple
from warnings import catch_warnings, filterwarnings

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.integration import Bounds
from rmpc_bench.types import Array

MAX_CALLS = 50_000
"""Calls of the right-hand side in one sample of one run."""
MAX_RESETS = 32
"""Events in one sample after which a run is given up: they may accumulate, as those of a bouncing ball do."""
PAUSE = 1e-6
"""Part of a sample during which an event that has just replaced the state is not looked for again."""


class Tolerances(NamedTuple):
    """An integrator and its tolerances."""

    method: str
    rtol: float
    atol: float


class Event(NamedTuple):
    """An event: where `value` passes through 0."""

    value: Callable[[float, Array], float]
    direction: float
    """Positive: upwards only; negative: downwards only; 0: both."""
    reset: Callable[[float, Array], Array] | None
    """Returns the new state; None where the run ends."""


class Solution(NamedTuple):
    """Result of an integration of one run."""

    x: Float[Array, " nx"]
    t: float
    """Time at which it ended [s]."""
    state: int = -1
    """Index of the state that has left its bounds; -1 where none has."""
    event: int = -1
    """Index of the event that has ended the run; -1 where none has."""
    failure: str = ""
    """What the integrator reports; empty where it has reached the end."""
    crowded: bool = False
    """Whether there were more than `MAX_RESETS` events."""


class _TooManyCalls(Exception):
    """The right-hand side has been called `MAX_CALLS` times."""


class _User:
    """Calls of the user's functions: counted, and with the exception that one has raised."""

    def __init__(self, slope: Callable[[float, Array], Array], bounds: Bounds | None) -> None:
        self._slope, self._bounds, self._calls = slope, bounds, 0
        self.error: Exception | None = None

    def slope(self, t: float, x: Array) -> Array:
        """Time derivative at the nearest state inside the bounds."""
        self._calls += 1
        if self._calls > MAX_CALLS:
            raise _TooManyCalls
        x = x if self._bounds is None else np.clip(x, self._bounds.low, self._bounds.high)
        if not np.isfinite(x).all():
            # Functions of one number, such as math.sin, raise an exception there.
            return np.full(len(x), np.nan)
        return self._guarded(self._slope, t, x)  # type: ignore[no-any-return]

    def event(self, event: Event | None) -> Callable[[float, Array], float]:
        """Return an event as `solve_ivp` takes it; it never happens where there is None."""

        def value(t: float, x: Array) -> float:
            return 1.0 if event is None else float(self._guarded(event.value, t, x))

        value.terminal, value.direction = True, 0.0 if event is None else event.direction  # type: ignore[attr-defined]
        return value

    def _guarded(self, function: Callable[..., Any], t: float, x: Array) -> Any:
        try:
            return function(float(t), x)
        except Exception as error:
            self.error = error
            raise


def solve(
    slope: Callable[[float, Array], Array],
    start: float,
    end: float,
    x: Float[Array, " nx"],
    tolerances: Tolerances,
    bounds: Bounds | None = None,
    events: Sequence[Event] = (),
) -> Solution:
    """Integrate one run from ``start`` to ``end``."""
    user, t, last, resets = _User(slope, bounds), start, -1, 0
    while t < end:
        # An event that has just replaced the state is at its 0 still.
        stop = end if last < 0 else min(t + PAUSE * (end - start), end)
        active = [None if i == last else event for i, event in enumerate(events)]
        found = _piece(user, t, stop, x, tolerances, bounds, active)
        x, t, last = found.x, found.t, found.event
        if found.state >= 0 or found.failure:
            return found
        if last >= 0:
            reset, resets = events[last].reset, resets + 1
            if reset is None:
                return found
            if resets > MAX_RESETS:
                return Solution(x, t, crowded=True)
            x = reset(t, x)
    return Solution(x, end)


def _piece(
    user: _User,
    t: float,
    stop: float,
    x: Float[Array, " nx"],
    tolerances: Tolerances,
    bounds: Bounds | None,
    events: Sequence[Event | None],
) -> Solution:
    """Integrate until the end, or until the first event."""
    from scipy.integrate import solve_ivp

    watched = [user.event(event) for event in events]
    method, rtol, atol = tolerances
    try:
        # Some integrators warn of what is returned as a failure here.
        with catch_warnings():
            filterwarnings("ignore", module="scipy")
            found = solve_ivp(user.slope, (t, stop), x, method, rtol=rtol, atol=atol, events=watched or None)
    except _TooManyCalls:
        return Solution(x, t, failure=f"more than {MAX_CALLS:,} calls of the right-hand side in one sample")
    except Exception as error:
        if error is user.error:
            raise
        # Such as a matrix of numbers that are not finite, within an implicit method.
        return Solution(x, t, failure=str(error))
    event = next((i for i, times in enumerate(found.t_events or ()) if len(times)), -1)
    inner = found.y[:, : -1 if event >= 0 else None]
    if bounds is not None and (outside := bounds.outside(inner)).any():
        step = int(outside.any(axis=0).argmax())
        return Solution(found.y[:, max(step - 1, 0)], float(found.t[step]), state=int(outside[:, step].argmax()))
    failure = str(found.message) if found.status < 0 else ""
    return Solution(found.y[:, -1], float(found.t[-1]) if event >= 0 or failure else stop, event=event, failure=failure)
