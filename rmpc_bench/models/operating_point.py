"""Operating points: the key `at` of a design model, and the steady state that belongs to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.dynamics import Dynamics
from rmpc_bench.numerics.jacobian import Zero, find_zero
from rmpc_bench.types import Array, DesignError, NamedSignals, OperatingPoint
from rmpc_bench.types.errors import unknown

Values: TypeAlias = float | list[float] | dict[str, float]
"""One number for all, one number each, or numbers by name."""


@dataclass(frozen=True)
class At:
    """Where a plant is linearised; give `u`, or `x` and `u`, or `y`.

    Parameters
    ----------
    x : state; with it, the point need not be a steady state
    u : input
    y : output of a steady state, whose input is computed
    guess : where the search for the steady state starts, by name also inputs (default: the middle of the bounds)
    """

    x: Values | None = None
    u: Values | None = None
    y: Values | None = None
    guess: Values | None = None


class Found(NamedTuple):
    """An operating point and how it was found."""

    point: OperatingPoint
    rest: Float[Array, " nx"]  # x', or x(k+1) - x(k), at the point; exactly 0 in a steady state
    residual: float  # largest entry of it that is left by the search
    iterations: int | None  # steps of the search; None for a given point


def find_point(dynamics: Dynamics, at: At) -> Found:
    """Return the operating point that `at` describes."""
    _refuse_incomplete(at)
    signals = dynamics.signals
    if at.y is not None:
        return _of_output(dynamics, at)
    u = numbers(at.u, signals.inputs, "at.u", "input")
    _refuse_outside(signals, u, signals.inputs, "at.u")
    if at.x is None:
        return _of_input(dynamics, at, u)
    x = numbers(at.x, signals.states, "at.x", "state")
    _refuse_outside(signals, x, signals.states, "at.x")
    dynamics.refuse_errors(x, u, "at.x")
    rest, y = dynamics.rest(x, u), dynamics.output(x, u)
    if not (np.isfinite(rest).all() and np.isfinite(y).all()):
        raise DesignError(f"the plant is not defined at {text(signals, signals.states, x)}", "at.x")
    return Found(OperatingPoint(x, u, y), rest, float(np.abs(rest).max(initial=0.0)), None)


def numbers(given: Any, names: Sequence[str], key: str, noun: str) -> Float[Array, " n"]:
    """Return one number per name."""
    if not isinstance(given, dict):
        values = np.array(given, dtype=float)
        if values.ndim and values.shape != (len(names),):
            raise DesignError(f"has {len(values)} entries; {noun}s: {len(names)} ({', '.join(names)})", key)
        return np.full(len(names), float(values)) if values.ndim == 0 else values
    for name in given:
        if name not in names:
            raise DesignError(unknown(name, names, noun), key)
    missing = [name for name in names if name not in given]
    if missing:
        raise DesignError(f"has no value for {', '.join(missing)}", key)
    return np.array([given[name] for name in names], dtype=float)


def text(signals: NamedSignals, names: Sequence[str], values: Float[Array, " n"]) -> str:
    """Write numbers with their names and units."""
    units = [f" {signals.units[name]}" if signals.units.get(name) else "" for name in names]
    return ", ".join(f"{name} = {value:.6g}{unit}" for name, value, unit in zip(names, values, units, strict=True))


def _refuse_incomplete(at: At) -> None:
    if at.y is not None and (at.x is not None or at.u is not None):
        raise DesignError("give either y or u: the input of a steady state with this output is computed", "at.y")
    if at.y is None and at.u is None:
        raise DesignError("is incomplete; give u, x and u, y, or the word trajectory", "at")
    if at.x is not None and at.guess is not None:
        raise DesignError("has no effect beside x, which is the operating point", "at.guess")


def _of_input(dynamics: Dynamics, at: At, u: Float[Array, " nu"]) -> Found:
    """Find the steady state of an input."""
    signals = dynamics.signals
    low, high = signals.limits(signals.states)
    start = _start(signals, at.guess, signals.states, ())
    dynamics.refuse_errors(start, u, "at.guess")
    zero = find_zero(lambda x: dynamics.rest(x, u), start, low, high)
    if not zero.converged:
        raise _not_found(signals, text(signals, signals.inputs, u), zero, start, signals.states)
    point = OperatingPoint(zero.x, u, dynamics.output(zero.x, u))
    return Found(point, np.zeros(len(start)), zero.residual, zero.iterations)


def _of_output(dynamics: Dynamics, at: At) -> Found:
    """Find the steady state of an output, and its input."""
    signals = dynamics.signals
    y, nx = numbers(at.y, signals.outputs, "at.y", "output"), len(signals.states)
    every = (*signals.states, *signals.inputs)
    low, high = signals.limits(every)
    start = _start(signals, at.guess, signals.states, signals.inputs)
    dynamics.refuse_errors(start[:nx], start[nx:], "at.guess")

    def missed(z: Float[Array, " n"]) -> Float[Array, " m"]:
        return np.concatenate([dynamics.rest(z[:nx], z[nx:]), dynamics.output(z[:nx], z[nx:]) - y])

    zero = find_zero(missed, start, low, high)
    x, u = zero.x[:nx], zero.x[nx:]
    if not zero.converged:
        raise _not_found(signals, text(signals, signals.outputs, y), zero, start, every)
    return Found(OperatingPoint(x, u, dynamics.output(x, u)), np.zeros(nx), zero.residual, zero.iterations)


def _start(
    signals: NamedSignals, guess: Values | None, states: tuple[str, ...], inputs: tuple[str, ...]
) -> Float[Array, " n"]:
    """Return the first point of a search: the guess, and the middle of the bounds where there is none."""
    every = (*states, *inputs)
    low, high = signals.limits(every)
    start = _middle(low, high)
    if isinstance(guess, dict):
        for name, value in guess.items():
            if name not in every:
                raise DesignError(unknown(name, every, "state"), "at.guess")
            start[every.index(name)] = value
    elif guess is not None:
        start[: len(states)] = numbers(guess, states, "at.guess", "state")
    _refuse_outside(signals, start, every, "at.guess")
    return start


def _middle(low: Float[Array, " n"], high: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the middle of bounds; 1 away from the only bound; 0 without bounds."""
    below, above = np.isfinite(low), np.isfinite(high)
    middle = np.zeros(len(low))
    middle[below & ~above], middle[~below & above] = low[below & ~above] + 1.0, high[~below & above] - 1.0
    middle[below & above] = 0.5 * (low[below & above] + high[below & above])
    return middle


def _refuse_outside(signals: NamedSignals, values: Float[Array, " n"], names: tuple[str, ...], key: str) -> None:
    low, high = signals.limits(names)
    for name, value, least, most in zip(names, values, low, high, strict=True):
        if not least <= value <= most:
            raise DesignError(f"{name} = {value:g} is outside the bounds of the plant, [{least:g}, {most:g}]", key)


def _not_found(
    signals: NamedSignals, wanted: str, zero: Zero, start: Float[Array, " n"], names: tuple[str, ...]
) -> DesignError:
    reached = text(signals, names, zero.x)
    return DesignError(
        f"no steady state was found for {wanted} from the guess {text(signals, names, start)}: after "
        f"{zero.iterations} steps the residual is {zero.residual:.3g} at {reached}; give another `guess`, or `x` and "
        "`u` of a point that need not be a steady state",
        "at",
    )
