"""Input signals: inputs in open loop, for the comparison of estimators.

Every kind is the same in all runs.  An input is held over a sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le, Len
from jaxtyping import Float, Int

from rmpc_bench.numerics.linalg import as_vector
from rmpc_bench.types import Array, DesignError, InputSignal, NonNegative, Positive

EQUATION = {
    "prbs": r"u_k = \mathrm{low} + (\mathrm{high} - \mathrm{low}) b_{\lfloor k / n \rfloor}, \quad b = 0, 1",
    "sine": r"u_k = \bar u + a \sin \left( 2 \pi k T_s / T + \varphi \right)",
    "steps": r"u_k = v_i \quad \mathrm{for\ } t_i \le k T_s \lt t_{i+1}",
}
ON_SAMPLE = 1e-9
"""Relative distance from a sample that is rounding."""


@dataclass(frozen=True, eq=False)
class Steps(InputSignal):
    """Values that change at given samples."""

    starts: Int[Array, " n"]  # samples at which the values begin; the first is 0
    values: Float[Array, "n nu"]

    def sample(self, runs: Sequence[int], n_samples: int) -> Float[Array, "runs samples nu"]:
        """Values at k = 0..n_samples - 1, the same for every run."""
        current = np.searchsorted(self.starts, np.arange(n_samples), side="right") - 1
        return np.broadcast_to(self.values[current], (len(runs), n_samples, self.values.shape[1]))


def steps(
    nu: int,
    Ts: float,
    *,
    times: Annotated[list[NonNegative], Len(1)],
    values: Annotated[list[float | list[float]], Len(1)],
) -> Steps:
    """Steps: every value holds from its time until the next one.

    Parameters
    ----------
    nu : number of inputs
    Ts : sampling time [s]
    times : times at which the values begin [s], increasing, on samples; the first is 0
    values : one entry per time, in the input's unit

    Raises
    ------
    DesignError
        If a time is between two samples, the times do not increase from 0, or the number of values does not fit.

    Examples
    --------
    >>> steps(1, 0.5, times=[0, 1], values=[2, 3]).sample([0], 4)[0, :, 0].tolist()
    [2.0, 2.0, 3.0, 3.0]
    """
    if len(times) != len(values):
        raise DesignError(f"there are {len(times)} times and {len(values)} values; give one value per time", "values")
    starts = np.array([_samples(time, Ts, "times") for time in times])
    if starts[0] != 0 or (np.diff(starts) <= 0).any():
        raise DesignError("the times must increase, and the first must be 0", "times")
    return Steps(starts, np.array([as_vector(value, nu, "values") for value in values]))


@dataclass(frozen=True, eq=False)
class Sine(InputSignal):
    """A sine wave around a constant."""

    mean: Float[Array, " nu"]
    amplitude: Float[Array, " nu"]
    step: float  # angle of one sample [rad]
    phase: Float[Array, " nu"]

    def sample(self, runs: Sequence[int], n_samples: int) -> Float[Array, "runs samples nu"]:
        """Values at k = 0..n_samples - 1, the same for every run."""
        angle = self.step * np.arange(n_samples)[:, None] + self.phase
        values = self.mean + self.amplitude * np.sin(angle)
        return np.broadcast_to(values, (len(runs), *values.shape))


def sine(
    nu: int,
    Ts: float,
    *,
    amplitude: float | list[float],
    period: Positive,
    mean: float | list[float] = 0.0,
    phase: float | list[float] = 0.0,
) -> Sine:
    """Sine wave: u(k) = mean + amplitude sin(2 pi k Ts/period + phase).

    Parameters
    ----------
    nu : number of inputs
    Ts : sampling time [s]
    amplitude : largest distance from the mean, in the input's unit
    period : period of the wave [s], longer than two samples
    mean : value around which the wave oscillates, in the input's unit
    phase : angle at k = 0 [rad]

    Raises
    ------
    DesignError
        If the period has no more than two samples, or the number of values does not fit.
    """
    if period <= 2.0 * Ts:
        raise DesignError(f"must be longer than two samples, {2.0 * Ts:g}", "period")
    named = {"mean": mean, "amplitude": amplitude, "phase": phase}
    vectors = {name: as_vector(value, nu, name) for name, value in named.items()}
    return Sine(vectors["mean"], vectors["amplitude"], 2.0 * np.pi * Ts / period, vectors["phase"])


@dataclass(frozen=True, eq=False)
class Prbs(InputSignal):
    """A binary sequence of maximum length, repeated."""

    low: Float[Array, " nu"]
    high: Float[Array, " nu"]
    hold: int  # samples over which every bit is held
    bits: Float[Array, "length nu"]  # 0 or 1

    def sample(self, runs: Sequence[int], n_samples: int) -> Float[Array, "runs samples nu"]:
        """Values at k = 0..n_samples - 1, the same for every run."""
        bits = self.bits[(np.arange(n_samples) // self.hold) % len(self.bits)]
        values = np.where(bits > 0.0, self.high, self.low)
        return np.broadcast_to(values, (len(runs), *values.shape))


def prbs(
    nu: int,
    Ts: float,
    *,
    low: float | list[float],
    high: float | list[float],
    hold: Positive | None = None,
    order: Annotated[int, Ge(2), Le(32)] = 10,
) -> Prbs:
    """Pseudorandom binary signal of maximum length, 2^order - 1 bits.

    Several inputs have the same sequence, shifted by equal parts of its length.  Its spectrum is nearly white.  It does
    not depend on the seed.

    Parameters
    ----------
    nu : number of inputs
    Ts : sampling time [s]
    low, high : the two values, in the input's unit
    hold : time over which every bit is held [s], a whole number of samples; one sample unless given
    order : length of the shift register

    Raises
    ------
    DesignError
        If the changes lie between samples, or the number of values does not fit.
    """
    # Slow to import, and only needed here.
    from scipy.signal import max_len_seq

    length = 2**order - 1
    # A register longer than any experiment repeats nothing in it.
    sequence = max_len_seq(order, length=min(length, MAX_BITS))[0].astype(float)
    shifts = [number * (len(sequence) // max(nu, 1)) for number in range(nu)]
    bits = np.stack([np.roll(sequence, -shift) for shift in shifts], axis=1)
    samples = 1 if hold is None else _samples(hold, Ts, "hold")
    if samples < 1:
        raise DesignError(f"must be one sample, {Ts:g}, or more", "hold")
    return Prbs(as_vector(low, nu, "low"), as_vector(high, nu, "high"), samples, bits)


MAX_BITS = 2**20
"""Bits of a sequence that are kept."""


def _samples(time: float, Ts: float, name: str) -> int:
    """Return a time as a number of samples."""
    count = time / Ts
    if abs(count - round(count)) > ON_SAMPLE * max(count, 1.0):
        raise DesignError(f"{time:g} is between two samples, which are {Ts:g} apart", name)
    return round(count)
