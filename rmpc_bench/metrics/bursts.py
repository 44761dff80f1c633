"""Metrics of tracking under noise with bursts: the true control error and the input, over some of the samples.

The error is r - y with the true output.  `during` picks samples by the bursts of the measurement noise; `from` and `to`
bound them, both included, in seconds or samples as the experiment's `time` is given; `memory`, `smooth` and other
durations are seconds.  A run without a sample that counts, as a short one may be, has no value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np
from annotated_types import Ge
from jaxtyping import Float

from rmpc_bench.metrics.burst_samples import During, When, during_of, moving_mean, per_run
from rmpc_bench.metrics.tracking import Bound, SampleMetric, Units, Window, window_of
from rmpc_bench.types import Array, DesignError, MetricInfo, NonNegative, Record

Norm = Literal["rms", "peak", "length", "bias"]
Index: TypeAlias = Annotated[int, Ge(0)]


def rms(values: Float[Array, "kept n"]) -> float:
    """Root of the mean square over samples and components."""
    return float(np.sqrt(np.mean(values**2)))


def _peak(values: Float[Array, "kept n"]) -> float:
    return float(np.abs(values).max())


def _length(values: Float[Array, "kept n"]) -> float:
    return float(np.sqrt((values**2).sum(axis=1)).max())


def _bias(values: Float[Array, "kept n"]) -> float:
    return float(np.abs(values.mean(axis=0)).max())


def _variation(steps: Float[Array, "kept n"]) -> float:
    return float(np.abs(steps).sum() / len(steps))


NORMS: Mapping[Norm, Callable[[Float[Array, "kept n"]], float]] = {
    "rms": rms,
    "peak": _peak,
    "length": _length,
    "bias": _bias,
}


@dataclass(frozen=True)
class Tracking:
    """Parameters of `tracking`."""

    norm: Norm
    components: tuple[int, ...] | None
    during: During
    smooth: float
    scale: float

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Size of the error over the samples that count."""
        error = smoothed_error(record, self.components, self.smooth)[:, window.slice]
        return self.scale * per_run(error, self.during.among(record, window), NORMS[self.norm])


@dataclass(frozen=True)
class InputSize:
    """Parameters of `input_rms` and `input_peak`."""

    norm: Norm
    during: During

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Size of the input over the samples that count."""
        return per_run(record.u[:, window.slice], self.during.among(record, window), NORMS[self.norm])


@dataclass(frozen=True)
class Variation:
    """Parameters of `input_variation`."""

    during: During

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Mean size of u(k) - u(k-1) over the k that count, from 1 on."""
        later = window._replace(first=max(window.first, 1))
        steps = np.diff(record.u, axis=1)[:, later.first - 1 : later.last]
        return per_run(steps, self.during.among(record, later), _variation)


def smoothed_error(record: Record, components: tuple[int, ...] | None, smooth: float) -> Float[Array, "runs samples n"]:
    """Return r - y of some outputs, or its moving mean over so many seconds."""
    error: Array = record.r - record.y
    if components is not None:
        error = error[:, :, list(components)]
    return moving_mean(error, max(1, round(smooth / record.Ts))) if smooth else error


def components_of(units: Units, components: list[int] | None) -> tuple[int, ...] | None:
    """Check which outputs are to count.

    Raises
    ------
    DesignError
        If one is named twice or there is none of that number.
    """
    if components is None:
        return None
    if not components or len(set(components)) < len(components):
        raise DesignError(f"must name at least one output and none twice (got {components})", "components")
    if units.plant is not None and max(components) >= units.plant.ny:
        raise DesignError(
            f"there is no y.{max(components)}: the plant has {units.plant.ny} outputs (they count from 0)", "components"
        )
    return tuple(components)


def _unit(units: Units, components: tuple[int, ...] | None, unit: str | None) -> tuple[str, float]:
    """Return the unit of the error and what it is to be multiplied with; no unit where outputs differ in it."""
    own = {units.y}
    if units.plant is not None:
        numbers = range(units.plant.ny) if components is None else components
        own = {units.plant.units.get(f"y.{number}", units.y) for number in numbers}
    base = own.pop() if len(own) == 1 else ""
    if unit is None or unit == base:
        return base, 1.0
    if not base:
        raise DesignError("the components have no unit in common; name those of one unit in components", "unit")
    if unit != f"m{base}":
        raise DesignError(f"must be {base} or m{base}, a thousandth of it (got {unit!r})", "unit")
    return unit, 1e3


def tracking(
    units: Units,
    *,
    name: str = "tracking",
    norm: Norm = "rms",
    components: list[Index] | None = None,
    during: When = "all",
    memory: NonNegative = 0.0,
    smooth: NonNegative = 0.0,
    unit: str | None = None,
    from_: Bound = None,
    to: Bound = None,
) -> SampleMetric:
    """Size of the true control error r - y over k = 0..N-1, in bursts of the noise or beside them.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    norm : rms is the root of the mean square over samples and components; peak the largest size of a component; length
        the largest length of the error vector; bias the largest size of a component's mean over time
    components : the outputs that count, from 0; all unless given
    during : all samples, those in bursts, or the quiet ones, which are not
    memory : how long a burst counts after its end [s]
    smooth : length of a moving mean [s] that the error goes through first, over samples before and after
    unit : of the value: that of the components, which must have it in common, or a thousandth of it, such as mm
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    chosen = components_of(units, components)
    shown, scale = _unit(units, chosen, unit)
    reduce = Tracking(norm, chosen, during_of(units, during, memory), smooth, scale)
    window = window_of(units, from_, to, units.n_steps - 1, units.n_steps)
    return SampleMetric(MetricInfo(name, shown, "lower"), window, reduce)


def _of_input(units: Units, name: str, reduce: InputSize | Variation, start: Bound, end: Bound) -> SampleMetric:
    last = units.n_steps - 1  # no input is applied at k = N
    return SampleMetric(MetricInfo(name, units.u, "lower"), window_of(units, start, end, last, last), reduce)


def input_variation(
    units: Units,
    *,
    name: str = "input_variation",
    during: When = "all",
    memory: NonNegative = 0.0,
    from_: Bound = None,
    to: Bound = None,
) -> SampleMetric:
    """How much the input moves from sample to sample: mean over k = 1..N-1 of the sum over i of |u_i(k) - u_i(k-1)|.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    during : all k, those in bursts, or the quiet ones, which are not
    memory : how long a burst counts after its end [s]
    from_ : first k (seconds or samples, as `time`); the input before it counts with it
    to : last k, included
    """
    return _of_input(units, name, Variation(during_of(units, during, memory)), from_, to)


def input_rms(
    units: Units,
    *,
    name: str = "input_rms",
    during: When = "all",
    memory: NonNegative = 0.0,
    from_: Bound = None,
    to: Bound = None,
) -> SampleMetric:
    """Root of the mean square of the applied input over k = 0..N-1 and all inputs.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    during : all samples, those in bursts, or the quiet ones, which are not
    memory : how long a burst counts after its end [s]
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included
    """
    return _of_input(units, name, InputSize("rms", during_of(units, during, memory)), from_, to)


def input_peak(
    units: Units,
    *,
    name: str = "input_peak",
    during: When = "all",
    memory: NonNegative = 0.0,
    from_: Bound = None,
    to: Bound = None,
) -> SampleMetric:
    """Largest size of an applied input over k = 0..N-1.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    during : all samples, those in bursts, or the quiet ones, which are not
    memory : how long a burst counts after its end [s]
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included
    """
    return _of_input(units, name, InputSize("peak", during_of(units, during, memory)), from_, to)
