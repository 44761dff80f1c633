"""Metrics: from the trajectories of a run to one number.

Every metric uses the true output (without measurement noise) and the applied input.  `from` and `to` bound the
samples, both included, in seconds or samples as the experiment's `time` is given; without them k = 0..N-1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, DesignError, MetricInfo, NonNegative, Positive, Record

Bound = NonNegative | Literal["N"] | None


class Window(NamedTuple):
    """Samples first..last, both included."""

    first: int
    last: int

    @property
    def slice(self) -> slice:
        """The same samples for indexing."""
        return slice(self.first, self.last + 1)


class Units(NamedTuple):
    """What a metric must know of the experiment."""

    n_steps: int
    tick: float
    """Length of one sample in the unit that `from` and `to` are given in: Ts with seconds, 1 with samples."""
    y: str
    u: str
    cut: bool = False
    """Whether a window that reaches beyond the last sample ends there (a smoke run is short)."""


@dataclass(frozen=True)
class SampleMetric:
    """A metric that maps a window of the trajectories to one number per run."""

    info: MetricInfo
    window: Window
    reduce: Callable[[Record, Window], Float[Array, " runs"]]

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """One value per run."""
        return self.reduce(record, self.window)


@dataclass(frozen=True)
class Settling:
    """Parameters of `settling_time`."""

    band: float

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Time from the start of the window to the first sample after which the output stays in the band."""
        error = _error(record, window)
        edge = record.r[window.first] - record.r[max(window.first - 1, 0)]
        step = np.where(edge != 0.0, np.abs(edge), np.abs(record.r[window.last] - record.y[:, window.first]))
        bound = self.band * step
        outside = np.asarray((np.abs(error) > bound[:, None, :]).any(axis=2))
        last_outside = np.where(outside.any(axis=1), outside.shape[1] - 1 - outside[:, ::-1].argmax(axis=1), -1)
        time = np.round(record.Ts * (last_outside + 1), 12)  # 34 * 0.1 is 3.4000000000000004 in doubles
        return np.where(last_outside == outside.shape[1] - 1, np.inf, time)


@dataclass(frozen=True)
class Tail:
    """Parameters of `steady_state_error`."""

    share: float

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Mean signed error at the end of the window."""
        error = _error(record, window)
        n = max(1, round(self.share * error.shape[1]))
        return _time_mean(error[:, -n:])


def _error(record: Record, window: Window) -> Float[Array, "runs window ny"]:
    return record.y[:, window.slice] - record.r[window.slice]


def _time_mean(values: Float[Array, "runs window n"]) -> Float[Array, " runs"]:
    """Mean over time and coordinates, row by row on contiguous memory: the bits do not depend on the other rows."""
    means: Array = np.ascontiguousarray(values.reshape(len(values), -1)).mean(axis=1)
    return means


def _mean_square_error(record: Record, window: Window) -> Float[Array, " runs"]:
    return _time_mean(_error(record, window) ** 2)


def _root_mean_square_error(record: Record, window: Window) -> Float[Array, " runs"]:
    return np.sqrt(_mean_square_error(record, window))


def _mean_absolute_error(record: Record, window: Window) -> Float[Array, " runs"]:
    return _time_mean(np.abs(_error(record, window)))


def _mean_square_input(record: Record, window: Window) -> Float[Array, " runs"]:
    return _time_mean(record.u[:, window.slice] ** 2)


def _input_roughness(record: Record, window: Window) -> Float[Array, " runs"]:
    """Standard deviation over time of the increments u(k) - u(k-1) inside the window, root mean square over inputs."""
    increments = np.diff(record.u[:, window.slice], axis=1)
    if not increments.size:
        return np.zeros(len(increments))
    means = np.ascontiguousarray(increments.transpose(0, 2, 1)).mean(axis=2)
    return np.sqrt(_time_mean((increments - means[:, None, :]) ** 2))


def _window(units: Units, start: Bound, end: Bound, default_last: int, limit: int) -> Window:
    first, last = (
        limit if bound == "N" else default if bound is None else round(float(bound) / units.tick)
        for bound, default in ((start, 0), (end, default_last))
    )
    if units.cut:
        first = min(first, limit)
        last = max(first, min(last, limit))
    if not 0 <= first <= last <= limit:
        raise DesignError(
            f"the window from {first} to {last} (samples) must lie in 0..{limit} and hold at least one sample"
        )
    return Window(first, last)


def mse(units: Units, *, name: str = "mse", from_: Bound = None, to: Bound = None) -> SampleMetric:
    """Mean square error of the output over k = 0..N-1.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    window = _window(units, from_, to, units.n_steps - 1, units.n_steps)
    return SampleMetric(MetricInfo(name, f"{units.y}^2", "lower"), window, _mean_square_error)


def rmse(units: Units, *, name: str = "rmse", from_: Bound = None, to: Bound = None) -> SampleMetric:
    """Root of the mean square error of the output over k = 0..N-1.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    window = _window(units, from_, to, units.n_steps - 1, units.n_steps)
    return SampleMetric(MetricInfo(name, units.y, "lower"), window, _root_mean_square_error)


def mae(units: Units, *, name: str = "mae", from_: Bound = None, to: Bound = None) -> SampleMetric:
    """Mean absolute error of the output over k = 0..N-1.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    window = _window(units, from_, to, units.n_steps - 1, units.n_steps)
    return SampleMetric(MetricInfo(name, units.y, "lower"), window, _mean_absolute_error)


def input_power(units: Units, *, name: str = "input_power", from_: Bound = None, to: Bound = None) -> SampleMetric:
    """Mean square of the applied input over k = 0..N-1.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included
    """
    last = units.n_steps - 1  # no input is applied at k = N
    window = _window(units, from_, to, last, last)
    return SampleMetric(MetricInfo(name, f"{units.u}^2", "lower"), window, _mean_square_input)


def input_roughness(
    units: Units, *, name: str = "input_roughness", from_: Bound = None, to: Bound = None
) -> SampleMetric:
    """Standard deviation of the increments of the applied input over k = 0..N-1: 0 for a ramp or a single sample.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included
    """
    last = units.n_steps - 1
    window = _window(units, from_, to, last, last)
    return SampleMetric(MetricInfo(name, units.u, "lower"), window, _input_roughness)


def settling_time(
    units: Units, *, name: str = "settling_time", band: Positive = 0.05, from_: Bound = None, to: Bound = None
) -> SampleMetric:
    """Time until the output stays within a band about the reference up to the end; inf is *never*.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    band : half width of the band, as a share of the step: the jump of the reference at the first sample, or for an
        output whose reference does not jump there |r(last) - y(first)|
    from_ : where the step begins (seconds or samples, as `time`); the time counts from there
    to : last sample, included; N, the last one of the experiment, unless given
    """
    window = _window(units, from_, to, units.n_steps, units.n_steps)
    return SampleMetric(MetricInfo(name, "s", "lower", may_be_never=True), window, Settling(band))


def steady_state_error(
    units: Units, *, name: str = "steady_state_error", share: Positive = 0.1, from_: Bound = None, to: Bound = None
) -> SampleMetric:
    """Mean of the signed error y - r over the last part of the window.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    share : length of the part, as a share of the window
    from_ : first sample of the window (seconds or samples, as `time`)
    to : last sample, included; N, the last one of the experiment, unless given
    """
    if share > 1.0:
        raise DesignError(f"must be at most 1 (got {share:g})", "share")
    window = _window(units, from_, to, units.n_steps, units.n_steps)
    return SampleMetric(MetricInfo(name, units.y, "zero"), window, Tail(share))
