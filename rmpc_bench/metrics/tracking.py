"""Metrics: from the trajectories of a run to one number.

Every metric uses the true output (without measurement noise), the true state and the applied input.  `from` and `to`
bound the samples, both included, in seconds or samples as the experiment's `time` is given; without them k = 0..N-1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.estimates import estimate_error, refuse_other_states
from rmpc_bench.types import Array, DesignError, Method, MetricInfo, NonNegative, Plant, Positive, Record

Bound = NonNegative | Literal["N"] | None
Of = Literal["output", "state", "estimate"]


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
    plant: Plant | None = None
    methods: tuple[Method, ...] = ()
    """With the plant, for what a metric must refuse before any run; without them it refuses when it is evaluated."""
    bursts: bool | None = None
    """Whether a law of the measurement noise has bursts; None where nobody knows."""


@dataclass(frozen=True)
class SampleMetric:
    """A metric that maps a window of the trajectories to one number per run."""

    info: MetricInfo
    window: Window
    reduce: Callable[[Record, Window], Float[Array, " runs"]]
    needs_P: bool = False
    """Whether it reads `Record.P`, which is not kept for other metrics."""
    needs_M: bool = False
    """Whether it reads `Record.M`, likewise."""
    needs_info: tuple[str, ...] = ()
    """What it reads of `Record.info`, likewise."""

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """One value per run."""
        return self.reduce(record, self.window)


@dataclass(frozen=True)
class MeanError:
    """Parameters of `mse`, `rmse` and `mae`."""

    of: Of
    square: bool
    root: bool = False

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Mean size over the window and the coordinates."""
        error = _error(record, window, self.of)
        mean = time_mean(error**2 if self.square else np.abs(error))
        return np.sqrt(mean) if self.root else mean


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
        return time_mean(error[:, -n:])


def _error(record: Record, window: Window, of: Of = "output") -> Float[Array, "runs window n"]:
    if of == "state":
        return record.x[:, window.slice]
    if of == "estimate":
        return estimate_error(record)[:, window.slice]
    return record.y[:, window.slice] - record.r[window.slice]


def time_mean(values: Float[Array, "runs window n"]) -> Float[Array, " runs"]:
    """Mean over time and coordinates, row by row on contiguous memory: the bits do not depend on the other rows."""
    means: Array = np.ascontiguousarray(values.reshape(len(values), -1)).mean(axis=1)
    return means


def _mean_square_input(record: Record, window: Window) -> Float[Array, " runs"]:
    return time_mean(record.u[:, window.slice] ** 2)


def _input_roughness(record: Record, window: Window) -> Float[Array, " runs"]:
    """Standard deviation over time of the increments u(k) - u(k-1) inside the window, root mean square over inputs."""
    increments = np.diff(record.u[:, window.slice], axis=1)
    if not increments.size:
        return np.zeros(len(increments))
    means = np.ascontiguousarray(increments.transpose(0, 2, 1)).mean(axis=2)
    return np.sqrt(time_mean((increments - means[:, None, :]) ** 2))


def window_of(units: Units, start: Bound, end: Bound, default_last: int, limit: int) -> Window:
    """Samples between two bounds, up to ``default_last`` unless told; ``limit`` is the last one there is."""
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


def _squared(unit: str) -> str:
    return f"{unit}^2" if unit else ""


def _mean_error(units: Units, name: str, reduce: MeanError, start: Bound, end: Bound) -> SampleMetric:
    """Make a metric of a mean error; states have no unit, as their coordinates differ in it."""
    if reduce.of == "estimate":
        refuse_other_states(units.plant, units.methods, "of")
    unit = units.y if reduce.of == "output" else ""
    info = MetricInfo(name, _squared(unit) if reduce.square and not reduce.root else unit, "lower")
    return SampleMetric(info, window_of(units, start, end, units.n_steps - 1, units.n_steps), reduce)


def mse(units: Units, *, name: str = "mse", of: Of = "output", from_: Bound = None, to: Bound = None) -> SampleMetric:
    """Mean square error over k = 0..N-1 and all coordinates, of the output unless told.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    of : output is y - r; state is x, its distance from 0; estimate is x_hat - x
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    return _mean_error(units, name, MeanError(of, square=True), from_, to)


def rmse(units: Units, *, name: str = "rmse", of: Of = "output", from_: Bound = None, to: Bound = None) -> SampleMetric:
    """Root of the mean square error over k = 0..N-1 and all coordinates, of the output unless told.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    of : output is y - r; state is x, its distance from 0; estimate is x_hat - x
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    return _mean_error(units, name, MeanError(of, square=True, root=True), from_, to)


def mae(units: Units, *, name: str = "mae", of: Of = "output", from_: Bound = None, to: Bound = None) -> SampleMetric:
    """Mean absolute error over k = 0..N-1 and all coordinates, of the output unless told.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    of : output is y - r; state is x, its distance from 0; estimate is x_hat - x
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    return _mean_error(units, name, MeanError(of, square=False), from_, to)


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
    window = window_of(units, from_, to, last, last)
    return SampleMetric(MetricInfo(name, _squared(units.u), "lower"), window, _mean_square_input)


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
    window = window_of(units, from_, to, last, last)
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
    window = window_of(units, from_, to, units.n_steps, units.n_steps)
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
    window = window_of(units, from_, to, units.n_steps, units.n_steps)
    return SampleMetric(MetricInfo(name, units.y, "zero"), window, Tail(share))
