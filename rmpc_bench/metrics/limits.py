"""Metrics of a signal of the plant against a limit: how often, how far and how long it is exceeded.

The signal is that of the true system with the parameters of the run, not that of the design model.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Float

from rmpc_bench.metrics.named_signal import NamedSignal, signal_of
from rmpc_bench.types import Array, Issue, MetricInfo, MetricLayout, Record, WindowMetric, issues_of

EQUATION = {
    "Violation": r"""\frac{1}{N} |\lbrace k \lt N : e_k \gt 0 \rbrace|, \quad
\max_k e_k, \quad T_s \sum_k e_k, \quad e_k = \max_i \max(z_{min} - z_{k,i}, z_{k,i} - z_{max}, 0)""",
    "Largest": r"\max_{k \lt N, i} |z_{k,i}|",
}
TOLERANCE = 1e-6
"""Part of a limit by which it may be exceeded.  A controller whose limit acts meets it up to rounding errors only."""

What: TypeAlias = Literal["share", "largest", "integral"]
Between: TypeAlias = Annotated[int, Ge(0), Le(1000)]


@dataclass(frozen=True, kw_only=True)
class SignalMetric(WindowMetric):
    """A metric of one signal of the true system.

    Parameters
    ----------
    of : `y`, `x`, `u` (applied input), `u_command` (before the bounds of the plant), a component such as `x.0`, the
        name of a state, input or output, or an extra signal of the plant, such as `shaft_torque`
    between : number of equally spaced times between two samples that count, too
    """

    of: str
    between: Between = 0

    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an unknown signal, an invalid window, and a plant without states between its samples."""
        issues = [*issues_of(signal_of, layout, self.of)]
        yield from issues or super().check(layout)
        if issues or not self.between:
            return
        if self.signal(layout).letter[0] == "u":
            yield Issue("between", "an input is constant between two samples; leave the key out")
        elif layout.plant is not None and not layout.plant.has_between:
            plant = type(layout.plant).__name__
            yield Issue("between", f"the plant ({plant}) gives no states between its samples; leave the key out")

    def signal(self, layout: MetricLayout) -> NamedSignal:
        """Return the signal."""
        return signal_of(layout, self.of)

    def last_sample(self, layout: MetricLayout) -> int:
        """Return N, or N-1 for an input: none is applied at k = N."""
        return layout.n_steps - (self.signal(layout).letter[0] == "u")

    def points(self, record: Record) -> Float[Array, "runs points n"]:
        """Return the signal at all times that count."""
        return self.signal(record.layout).at_points(record, self.samples(record), self.between)


@dataclass(frozen=True, kw_only=True)
class Violation(SignalMetric):
    """How often, how far or how long a signal of the true system exceeds its limit, k = 0..N-1; lower is better.

    A sample counts if a component exceeds its limit by more than a millionth of the limit, or of the larger of two.
    The excess of a sample is that of the component with the largest one.

    Parameters
    ----------
    limit : largest size of every component, or `[lowest, highest]` value; `null` for none
    what : `share` of the samples that exceed the limit, the `largest` excess, or the `integral` of the excess over time

    Examples
    --------
    A torque of a shaft that may be 2 N m at most exceeds its limit at two of four samples.

    >>> record = Record.of_run(u=[1.0, -2.5, 2.0000001, 4.0], Ts=0.1)
    >>> for what in ("share", "largest", "integral"):
    ...     print(Violation(of="u", limit=2.0, what=what).evaluate(record).item())
    0.5
    2.0
    0.25
    """

    name: str = "violation"
    limit: float | tuple[float | None, float | None]
    what: What = "share"

    @property
    def bounds(self) -> tuple[float, float]:  # type: ignore[override]
        """0 and 1 for a share, else 0 and infinity."""
        return (0.0, 1.0 if self.what == "share" else np.inf)

    @property
    def pair(self) -> tuple[float, float]:
        """Lowest and highest value; infinite where there is none."""
        if isinstance(self.limit, int | float):
            return -self.limit, self.limit
        low, high = self.limit
        return -math.inf if low is None else low, math.inf if high is None else high

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Add to the common checks: a limit that a signal can exceed."""
        yield from super().check(layout)
        low, high = self.pair
        if not low < high:
            given = f"{high:g}" if isinstance(self.limit, int | float) else f"[{low:g}, {high:g}]"
            yield Issue("limit", f"must be > 0, or two numbers [lowest, highest] (got {given})")
        elif math.isinf(low) and math.isinf(high):
            yield Issue("limit", "must have a number, or nothing exceeds it")

    def unit(self, layout: MetricLayout) -> str:
        """Return none for a share, the unit of the signal, or this times the unit of time."""
        unit = "" if self.what == "share" else self.signal(layout).unit(layout)
        return f"{unit} {layout.time_unit}".lstrip() if self.what == "integral" else unit

    def info(self, layout: MetricLayout) -> MetricInfo:
        """Describe the column; the label names signal and statistic unless there is another name or label."""
        words = self.signal(layout).words
        text = {
            "share": f"share of samples with {words} beyond its limit",
            "largest": f"largest excess of {words} beyond its limit",
            "integral": f"integral of the excess of {words} beyond its limit",
        }[self.what]
        return _labelled(super().info(layout), "violation", text)

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Reduce the excess over the samples."""
        excess = self.excess(self.points(record))
        if self.what == "share":
            return np.asarray(np.count_nonzero(excess, axis=1) / excess.shape[1])
        if self.what == "largest":
            return np.asarray(excess.max(axis=1))
        return np.asarray(excess.sum(axis=1) * (record.Ts / (self.between + 1)))

    def excess(self, values: Float[Array, "runs points n"]) -> Float[Array, "runs points"]:
        """Return the excess of the component with the largest one; 0 within the tolerance."""
        low, high = self.pair
        finite = [abs(bound) for bound in (low, high) if math.isfinite(bound)]
        # A limit of 0 alone has no size; the tolerance is then in the unit of the signal.
        tolerance = TOLERANCE * (max(finite) or 1.0)
        beyond = np.maximum(low - values, values - high).max(axis=2)
        return np.ascontiguousarray(np.where(beyond > tolerance, beyond, 0.0))


@dataclass(frozen=True, kw_only=True)
class Largest(SignalMetric):
    """Largest size of a component of a signal of the true system over k = 0..N-1; lower is better.

    Examples
    --------
    >>> Largest(of="y").evaluate(Record.of_run(y=[1.0, -3.0, 2.0, 9.0])).item()  # the sample k = N does not count
    3.0
    """

    name: str = "largest"

    def unit(self, layout: MetricLayout) -> str:
        """Return the unit of the signal."""
        return self.signal(layout).unit(layout)

    def info(self, layout: MetricLayout) -> MetricInfo:
        """Describe the column; the label names the signal unless there is another name or label."""
        return _labelled(super().info(layout), "largest", f"largest {self.signal(layout).words}")

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Find the largest size."""
        return np.asarray(np.abs(self.points(record)).max(axis=(1, 2)))


def _labelled(info: MetricInfo, name: str, text: str) -> MetricInfo:
    """Add a label to a column that has no name or label of its own."""
    return info._replace(label=text) if info.name == name and not info.label else info
