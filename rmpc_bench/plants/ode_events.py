"""Events of a differential equation, as a user's file gives them.

An event is a function event(x, u, p) or event(t, x, u, p) of one run, which passes through 0 when it happens.  Its
attribute `word` is a text: the run ends there.  Its attribute `reset` is a function with the same arguments that
returns the new state.  Its attribute `direction` is 1 for upwards only, -1 for downwards only, 0 (default) for both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.ode_names import function_name, is_timed
from rmpc_bench.numerics.adaptive import Event
from rmpc_bench.types import Array, DesignError, Ode, Parameters


class UserEvent(NamedTuple):
    """An event of a user's file."""

    function: Callable[..., Any]
    timed: bool
    word: str
    """What ends the run; empty where the state is replaced."""
    reset: Callable[..., Any] | None
    reset_timed: bool
    direction: float

    def of_run(self, ode: Ode, u: Float[Array, " nu"], p: Parameters) -> Event:
        """Return the event of one run over one sample."""

        def value(t: float, x: Array) -> float:
            return float(_called(self.function, self.timed, t, x, u, p))

        def reset(t: float, x: Array) -> Array:
            assert self.reset is not None
            return ode.as_state("reset", _called(self.reset, self.reset_timed, t, x, u, p))

        return Event(value, self.direction, reset if self.reset is not None else None)


def read_events(given: Any) -> tuple[UserEvent, ...]:
    """Return the events of a function, or of a list or tuple of functions."""
    return tuple(_events(given))


def _events(given: Any) -> Iterator[UserEvent]:
    for function in given if isinstance(given, list | tuple) else [given]:
        timed, name = is_timed(function, "events"), function_name(function)
        word, reset = str(getattr(function, "word", "")), getattr(function, "reset", None)
        if bool(word) == (reset is not None):
            message = f"{name} must have either the attribute `word`, a text with which the run ends, or `reset`, a "
            raise DesignError(
                message + f"function that returns the new state, such as {name}.word = 'overflow'", "events"
            )
        direction = getattr(function, "direction", 0)
        if not isinstance(direction, int | float):
            raise DesignError(f"{name}.direction must be -1, 0 or 1 (got {direction!r})", "events")
        yield UserEvent(
            function, timed, word, reset, reset is not None and is_timed(reset, "events"), float(np.sign(direction))
        )


def _called(function: Callable[..., Any], timed: bool, t: float, x: Array, u: Array, p: Parameters) -> Any:
    """Call with copies of x and u."""
    return function(t, x.copy(), u.copy(), p) if timed else function(x.copy(), u.copy(), p)
