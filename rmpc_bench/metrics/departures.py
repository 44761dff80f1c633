"""Number of times that the control error temporarily exceeds its usual size.

belda2017 counts departures in its Fig. 3 without a definition: all numbers here are ours.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.metrics.burst_samples import burst_samples, check_bursts, prolonged
from rmpc_bench.metrics.components import ComponentMetric, output_error, smoothed
from rmpc_bench.metrics.norms import per_run, rms
from rmpc_bench.numerics.sample_times import at_least
from rmpc_bench.types import Array, Issue, MetricLayout, NonNegative, Positive, Record

EQUATION = r"""\mathrm{number\ of\ }
\left\lbrace k : \max_i |e_{k,i}| \gt s e_{rms} \mathrm{\ begins\ at\ } k \right\rbrace"""


@dataclass(frozen=True, kw_only=True)
class Departures(ComponentMetric):
    """Number of times that a component of the smoothed control error exceeds its usual size; lower is better.

    The usual size is the root of the mean square over quiet samples and components.  A run without a quiet sample has
    no value.

    Parameters
    ----------
    during : `all`, or those that start during `bursts` or up to `after` seconds later
    smooth : length of the centred moving average [s]
    size : threshold of a departure, as a multiple of the usual size
    apart : a departure that starts less than this time [s] after the previous one is counted as part of it
    memory : time after a burst in which samples are not quiet [s]
    after : time after a burst in which a departure counts as caused by it [s]

    Examples
    --------
    The usual size is 2.2; the error grows beyond 1.5 times of it at k = 3 and again at k = 7.

    >>> record = Record.of_run(y=[1.0, -1.0, 1.0, 4.0, 4.0, 1.0, -1.0, -4.0, 1.0, 1.0, 0.0])
    >>> Departures(smooth=0.0, size=1.5, apart=1.0).evaluate(record).item()
    2.0
    """

    name: str = "departures"
    during: Literal["all", "bursts"] = "all"
    smooth: NonNegative = 0.2
    size: Positive = 4.0
    apart: NonNegative = 0.8
    memory: NonNegative = 0.0
    after: NonNegative = 0.5

    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, missing bursts and outputs that do not exist."""
        yield from super().check(layout)
        yield from check_bursts(layout, self.during)

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Count the departures that begin in the window."""
        window = self.samples(record)
        error = smoothed(self.chosen(output_error(record), record.layout), self.smooth, record.Ts)[:, window.slice]
        usual = per_run(error, burst_samples(record, window, "quiet", self.memory), rms)
        large = np.asarray((np.abs(error) > self.size * usual[:, None, None]).any(axis=2))
        begins = first_of_each(large, at_least(self.apart, record.Ts))
        count = (begins & burst_samples(record, window, self.during, self.after)).sum(axis=1)
        return np.where(np.isnan(usual), np.nan, count.astype(float))


def first_of_each(large: Bool[Array, "runs window"], apart: int) -> Bool[Array, "runs window"]:
    """Return the large samples before which none of the samples less than `apart` away was large."""
    before = np.zeros_like(large)
    before[:, 1:] = prolonged(large, max(apart, 2) - 2)[:, :-1]
    first: Array = large & ~before
    return first
