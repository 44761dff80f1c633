"""Bursts: time intervals in which a noise is larger.

Model   noise(k) = center + g(k) z(k), where z is the noise without bursts and g(k) the product of the factors of all
        bursts that contain sample k, or 1 outside bursts.  A burst contains the samples k with from <= k Ts <= to.
        In a drift g(k) multiplies the increment that leads to sample k.
Source  belda2017, Section VI: twice the width in <3.4 s, 4 s> and <6.2 s, 6.6 s>.  Random bursts are an addition.
Limit   Bursts with factor 1 do not change the noise.
Streams z is drawn from the generator of the law, random bursts from a child of this generator: z does not depend on the
        bursts.  A law whose z needs children itself takes the first ones.  The child of the bursts draws the factor
        first, then duration and start of each burst, so that an additional window does not change the earlier bursts.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias, TypeVar

import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Bool, Float

from rmpc_bench.noise.distributions import Uniform
from rmpc_bench.numerics.sample_times import Burst, Span, samples_of, spans_of
from rmpc_bench.types import Array, DesignError, Noise, NonNegative
from rmpc_bench.types.basics import attribute

Share: TypeAlias = Annotated[float, Ge(0), Le(1)]
"""A probability."""
Range: TypeAlias = NonNegative | tuple[NonNegative, NonNegative]
"""A number, or the ends of the range in which it is uniform."""


@dataclass(frozen=True)
class RandomBursts:
    """Bursts whose times differ from run to run.

    Parameters
    ----------
    within : windows [from, to] [s]; each contains one burst, whose start is uniform over the starts that fit
    duration : duration of a burst [s], a number or the range [low, high] of a uniform law; start and duration are
        rounded to samples
    factor : factor on the deviation of the noise in all bursts of a run, or the range [low, high]
    """

    within: list[tuple[NonNegative, NonNegative]]
    duration: Range
    factor: Range


@dataclass(frozen=True)
class FixedBursts:
    """The same bursts in every run."""

    fixed: tuple[Span, ...]
    names = ()

    def spans(self, rng: np.random.Generator, child: int) -> Sequence[Span]:
        """Bursts of one run, drawn from a numbered child of the generator."""
        return self.fixed

    def values(self, spans: Sequence[Span]) -> Mapping[str, float]:
        """Drawn values of these bursts, by name."""
        return {}


@dataclass(frozen=True)
class DrawnBursts:
    """One burst in each window, all of one factor."""

    windows: tuple[tuple[int, int], ...]
    """First and last sample of each."""
    duration: Uniform
    """Samples from the first to the last one."""
    factor: Uniform
    Ts: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the drawn values."""
        ends = (f"burst_{number}_{end}" for number in range(1, len(self.windows) + 1) for end in ("from", "to"))
        return (*ends, "burst_factor")

    def spans(self, rng: np.random.Generator, child: int) -> Sequence[Span]:
        """Bursts of one run, by inverse transform."""
        p, *pairs = child_of(rng, child).random(1 + 2 * len(self.windows)).tolist()
        factor = self.factor.quantile(p)
        spans = []
        for (first, last), p_duration, p_start in zip(self.windows, pairs[::2], pairs[1::2], strict=True):
            length = round(self.duration.quantile(p_duration))
            start = round(Uniform(float(first), float(last - length)).quantile(p_start))
            spans.append(Span(start, start + length, factor))
        return spans

    def values(self, spans: Sequence[Span]) -> Mapping[str, float]:
        """Begin and end of every burst [s], and the factor."""
        # 34 * 0.1 is 3.4000000000000004 in doubles
        ends = (round(end * self.Ts, 12) for span in spans for end in (span.first, span.last))
        return dict(zip(self.names, (*ends, spans[0].factor), strict=True))


Bursts: TypeAlias = FixedBursts | DrawnBursts


class CenteredNoise(Noise, ABC):
    """Noise with a center."""

    @attribute
    def center(self) -> Float[Array, " n"]:
        """Value from which bursts enlarge the deviation; the mean by default."""
        return self.mean  # type: ignore[return-value]

    @attribute
    def n_children(self) -> int:
        """Number of children of the generator that `deviation` uses."""
        return 0

    @abstractmethod
    def deviation(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run without its center."""

    def enlarged(self, rng: np.random.Generator, gain: Float[Array, " samples"]) -> Float[Array, "samples n"]:
        """Deviation of one run, with a factor for every sample."""
        return gain[:, None] * self.deviation(rng, len(gain))

    def draw(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run."""
        return self.center + self.deviation(rng, n_samples)


Steady = TypeVar("Steady", bound=CenteredNoise)
"""A noise without bursts."""


@dataclass(frozen=True, eq=False)
class BurstyNoise(Noise):
    """A steady noise that is larger in bursts; its moments depend on k."""

    steady: CenteredNoise
    bursts: Bursts

    has_bursts = True

    @property
    def is_white(self) -> bool:
        """Whether samples at different k are independent."""
        return self.steady.is_white

    def draw(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run."""
        gain = np.ones(n_samples)
        for first, last, factor in self._spans(rng):
            gain[first : last + 1] *= factor
        return self.steady.center + self.steady.enlarged(rng, gain)

    @property
    def burst_names(self) -> tuple[str, ...]:
        """Names of the drawn values."""
        return self.bursts.names

    def burst_values(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Drawn values of one run."""
        return self.bursts.values(self._spans(rng))

    def in_burst(self, rng: np.random.Generator, n_samples: int) -> Bool[Array, " samples"]:
        """Whether a sample of one run is in a burst."""
        inside = np.zeros(n_samples, dtype=bool)
        for first, last, _ in self._spans(rng):
            inside[first : last + 1] = True
        return inside

    def _spans(self, rng: np.random.Generator) -> Sequence[Span]:
        return self.bursts.spans(rng, self.steady.n_children)


def child_of(rng: np.random.Generator, number: int) -> np.random.Generator:
    """Return a numbered child of a fresh generator: that of `Generator.spawn`, without counting it.

    The generator has a SeedSequence; children count from 0 and are independent streams.
    """
    seed: Any = rng.bit_generator.seed_seq
    child = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, number), pool_size=seed.pool_size)
    return np.random.Generator(type(rng.bit_generator)(child))


def with_bursts(steady: Steady, bursts: list[Burst] | RandomBursts | None, Ts: float) -> Steady | BurstyNoise:
    """Return a noise with bursts as configured [s]; without any it is the noise itself, with its moments."""
    if not bursts:
        return steady
    placed = _drawn(bursts, Ts) if isinstance(bursts, RandomBursts) else FixedBursts(spans_of(bursts, Ts))
    return BurstyNoise(steady, placed)


def _drawn(bursts: RandomBursts, Ts: float) -> DrawnBursts:
    if not bursts.within:
        raise DesignError("contains no window; leave bursts out if there are none", "bursts.within")
    duration, factor = (_uniform(name, getattr(bursts, name)) for name in ("duration", "factor"))
    windows = tuple(samples_of(start, end, Ts) for start, end in bursts.within)
    for number, ((start, end), (first, last)) in enumerate(zip(bursts.within, windows, strict=True)):
        if end < start or last - first < round(duration.high / Ts):
            raise DesignError(
                f"from {start:g} to {end:g} there is no room for a burst of {duration.high:g}; "
                "widen the window or shorten the duration",
                f"bursts.within.{number}",
            )
    return DrawnBursts(windows, Uniform(duration.low / Ts, duration.high / Ts), factor, Ts)


def _uniform(name: str, given: Range) -> Uniform:
    low, high = given if isinstance(given, tuple) else (given, given)
    if low > high:
        raise DesignError(f"the range must begin with its smaller end (got [{low:g}, {high:g}])", f"bursts.{name}")
    return Uniform(low, high)
