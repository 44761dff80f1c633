"""How often a control error leaves its usual size for a while.

belda2017 says of its Fig. 3 that the errors oscillate around zero "with only two departures caused by the noise
increases", and not what a departure is: all numbers here are ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.metrics.burst_samples import During, during_of, lasting, per_run
from rmpc_bench.metrics.bursts import Index, components_of, rms, smoothed_error
from rmpc_bench.metrics.tracking import Bound, SampleMetric, Units, Window, window_of
from rmpc_bench.noise.bursts import ROUNDING
from rmpc_bench.types import Array, MetricInfo, NonNegative, Positive, Record


@dataclass(frozen=True)
class Departures:
    """Parameters of `departures`."""

    counted: During
    """Where a departure must begin to count."""
    quiet: During
    components: tuple[int, ...] | None
    smooth: float
    size: float
    apart: float

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Count them."""
        error = smoothed_error(record, self.components, self.smooth)[:, window.slice]
        usual = per_run(error, self.quiet.among(record, window), rms)
        away = np.asarray((np.abs(error) > self.size * usual[:, None, None]).any(axis=2))
        begins = first_of_each(away, math.ceil(self.apart / record.Ts - ROUNDING))
        count = (begins & self.counted.among(record, window)).sum(axis=1)
        return np.where(np.isnan(usual), np.nan, count.astype(float))


def first_of_each(away: Bool[Array, "runs window"], apart: int) -> Bool[Array, "runs window"]:
    """Tell the samples that begin something: away, as none of the samples before that are less than `apart` away was.

    Parameters
    ----------
    away : samples of interest
    apart : number of samples; two that follow each other are never apart
    """
    before = np.zeros_like(away)
    before[:, 1:] = lasting(away, max(apart, 2) - 2)[:, :-1]
    first: Array = away & ~before
    return first


def departures(
    units: Units,
    *,
    name: str = "departures",
    during: Literal["all", "bursts"] = "all",
    components: list[Index] | None = None,
    smooth: NonNegative = 0.2,
    size: Positive = 4.0,
    apart: NonNegative = 0.8,
    memory: NonNegative = 0.0,
    after: NonNegative = 0.5,
    from_: Bound = None,
    to: Bound = None,
) -> SampleMetric:
    """How often a component of the smoothed control error grows beyond its usual size over k = 0..N-1.

    The usual size is the root of the mean square over quiet samples and components.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    during : count all departures, or those that bursts cause: they begin between the begin of a burst and `after`
        behind its end
    components : the outputs that count, from 0; all unless given
    smooth : length of the moving mean [s], over samples before and after
    size : how many times the usual size is a departure
    apart : what is closer than this [s] to the one before is one with it
    memory : how long behind a burst samples are not quiet [s]
    after : how long behind a burst it causes departures [s]
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    counted = during_of(units, during, after if during == "bursts" else 0.0)
    reduce = Departures(counted, During("quiet", memory), components_of(units, components), smooth, size, apart)
    window = window_of(units, from_, to, units.n_steps - 1, units.n_steps)
    return SampleMetric(MetricInfo(name, "", "lower"), window, reduce)
