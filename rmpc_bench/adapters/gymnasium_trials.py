"""What an environment does with random numbers, its state and its parameters: tried when a plant is designed.

Two copies of the environment start from the same seed.  Where they draw other random numbers after other actions, the
methods of an experiment have different noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from timeit import default_timer
from traceback import extract_tb
from typing import Any, NamedTuple, TypeVar

import numpy as np

from rmpc_bench.components.loading import is_source
from rmpc_bench.components.single_plant import Access, EnvironmentRun
from rmpc_bench.components.user_code import last_user_frame, one_line
from rmpc_bench.extras import MissingLibraryError
from rmpc_bench.types import Array, DesignError, OutOfRange, Parameters

SAMPLES = 20
"""Steps for which an environment is tried."""
NO_NOISE = np.zeros(0)
T = TypeVar("T")


class Trial(NamedTuple):
    """Some steps of one environment."""

    x: list[Array]
    """States from k = 0 on."""
    random: list[Any]
    """State of its random generator after each of them; None where it has none."""
    seconds: float
    """Shortest time of a step [s]."""


def attempt(key: str, call: Callable[[], T]) -> T:
    """Call something of the environment or of the user; what it raises is a DesignError at the key."""
    try:
        return call()
    except (DesignError, MissingLibraryError):
        raise
    except Exception as error:
        frame = extract_tb(error.__traceback__)[-1]
        # The line of an error is shown where it is in a file of the user, not in a library.
        place = last_user_frame(error) if is_source(frame.filename) else ""
        text = one_line(error)
        if type(error).__module__.startswith("gymnasium"):
            text = text.partition(": ")[2]
        raise DesignError(f"{place}: {text}" if place else text, key) from None


def started(access: Access, p: Parameters, x0: Array | None = None) -> EnvironmentRun:
    """Start a new environment from a fixed seed, at x0 or at the state of `reset`."""
    run = EnvironmentRun(replace(access, starts_at_x0=x0 is not None))
    run.start(p, np.zeros(0) if x0 is None else x0, np.random.Generator(np.random.PCG64(0)))
    return run


def trial(access: Access, p: Parameters, inputs: Sequence[Array], x0: Array | None = None) -> Trial:
    """Step a new environment with one input per step, until it ends an episode."""
    run = started(access, p, x0)
    x, random, seconds = [run.x], [_generator(run.inner)], np.inf
    for u in inputs:
        before = default_timer()
        try:
            x.append(run.step(u.copy(), NO_NOISE))
        except OutOfRange:
            break
        seconds = min(seconds, default_timer() - before)
        random.append(_generator(run.inner))
    return Trial(x, random, float(seconds) if np.isfinite(seconds) else 0.0)


def _generator(inner: Any) -> Any:
    """State of the generator of an environment; None where `reset` has not made one."""
    generator = getattr(inner, "_np_random", None)
    return None if generator is None else repr(generator.bit_generator.state)


def inputs_between(low: Array, high: Array, share: float) -> list[Array]:
    """Return constant inputs at a share of their range; without limits it is -1 to 1."""
    low, high = np.where(np.isfinite(low), low, -1.0), np.where(np.isfinite(high), high, 1.0)
    return [np.asarray(low + share * (high - low), dtype=float)] * SAMPLES


def is_repeatable(first: Trial, again: Trial) -> bool:
    """Whether the same seed and the same actions give the same states."""
    same_length = len(first.x) == len(again.x)
    return same_length and all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first.x, again.x, strict=True))


def random_numbers(first: Trial, other: Trial) -> str:
    """Say when an environment draws: ``never``, ``every action alike`` or ``by action``, from trials of two actions."""
    n = min(len(first.random), len(other.random))
    if first.random[:n] != other.random[:n]:
        return "by action"
    return "never" if len(set(first.random)) == 1 else "every action alike"


def is_writable(access: Access, p: Parameters, inputs: Sequence[Array]) -> bool:
    """Whether a state that is written is read back, and the next step starts from it."""
    if access.write is None or access.read is None:
        return False
    run = started(access, p)
    other = run.x + 1e-3 * (1.0 + np.abs(run.x))
    try:
        access.write(run.inner, other.copy())
        read_back = access.state(run.inner, run.observation)
        moved, unmoved = trial(access, p, inputs[:1], other), trial(access, p, inputs[:1])
    except (AttributeError, TypeError, ValueError):
        return False
    # An episode that ends at once has no second state.
    differs = len(moved.x) != len(unmoved.x) or not np.array_equal(moved.x[-1], unmoved.x[-1])
    return bool(np.array_equal(read_back, other) and differs)


def without_effect(access: Access, p: Parameters, inputs: Sequence[Array], first: Trial) -> list[str]:
    """Return the parameters of which a change by 10 % changes no state."""
    found = []
    for name in p:
        changed = Parameters({**p, name: p[name] * 1.1 if p[name] else 0.1})
        if is_repeatable(first, trial(access, changed, inputs)):
            found.append(name)
    return found
