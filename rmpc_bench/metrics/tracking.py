"""Metrics of tracking: the error between the true output and the reference.

They use the true output, without measurement noise.  The default window is k = 0..N-1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from annotated_types import Le
from jaxtyping import Float

from rmpc_bench.metrics.burst_samples import BurstMetric
from rmpc_bench.metrics.components import ComponentMetric, SumMetric, output_error, smoothed
from rmpc_bench.metrics.estimate_checks import check_state_lengths, estimate_error
from rmpc_bench.metrics.norms import NORMS, Norm, mean_absolute, mean_square, per_run, time_mean
from rmpc_bench.types import (
    Array,
    DesignError,
    Direction,
    Issue,
    MetricLayout,
    NonNegative,
    Positive,
    Record,
    issues_of,
)

EQUATION = {
    "Mse": r"\frac{1}{N n_y} \sum_{k=0}^{N-1} \Vert y_k - r_k \Vert^2",
    "Mae": r"\frac{1}{N n_y} \sum_{k=0}^{N-1} \sum_i |y_{k,i} - r_{k,i}|",
    "Rmse": r"\sqrt{\frac{1}{N n_y} \sum_{k=0}^{N-1} \Vert y_k - r_k \Vert^2}",
    "Iae": r"\frac{T_s}{n_y} \sum_{k=0}^{N-1} \sum_i |y_{k,i} - r_{k,i}|",
    "SettlingTime": r"""T_s \min \left\lbrace m : |y_{k,i} - r_{k,i}| \le \mathrm{band} \cdot \mathrm{step}_i \quad
\mathrm{for\ all\ } i, k \ge m \right\rbrace""",
    "SteadyStateError": r"\frac{1}{n n_y} \sum_{k \gt N-n} \sum_i (y_{k,i} - r_{k,i})",
    "Tracking": r"\sqrt{\frac{1}{n p} \sum_k \sum_i (r_{k,i} - y_{k,i})^2} \quad (\mathrm{norm: rms})",
}
ErrorSignal: TypeAlias = Literal["output", "state", "estimate"]


@dataclass(frozen=True, kw_only=True)
class ErrorMetric(SumMetric):
    """Mean size of an error over the window and all coordinates; 0 is best.

    Parameters
    ----------
    of : error that is measured: `output` is y - r, `state` is x (the distance from 0), `estimate` is x_hat - x
    """

    of: ErrorSignal = "output"

    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)

    @property
    def letter(self) -> str:  # type: ignore[override]
        """The signal whose components count."""
        return "y" if self.of == "output" else "x"

    @property
    def reads(self) -> tuple[str, ...]:
        """The signals of the error."""
        return {"output": ("y",), "state": ("y", "x"), "estimate": ("y", "x", "x_hat")}[self.of]

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, and estimates of another length than the state."""
        yield from super().check(layout)
        if self.of == "estimate":
            yield from check_state_lengths(layout, "of")

    def error(self, record: Record) -> Float[Array, "runs window n"]:
        """Return the error at the samples of the window."""
        window = self.samples(record).slice
        if self.of == "state":
            error: Array = record.x
        else:
            error = estimate_error(record) if self.of == "estimate" else output_error(record)
        return self.chosen(error[:, window], record.layout)


@dataclass(frozen=True, kw_only=True)
class Mse(ErrorMetric):
    """Mean square error, 1/(N ny) sum_k |y(k) - r(k)|^2 over k = 0..N-1; lower is better.

    Examples
    --------
    Errors -1, 1, 3 against the reference 1; the last sample k = N is not in the default window.

    >>> record = Record.of_run(y=[0.0, 2.0, 4.0], r=1.0)
    >>> Mse().evaluate(record).item(), Mse(to="N").evaluate(record).round(3).item()
    (1.0, 3.667)
    """

    name: str = "mse"

    adds: ClassVar[str] = "squares"

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Average the squares."""
        return mean_square(self.error(record))


@dataclass(frozen=True, kw_only=True)
class Rmse(ErrorMetric):
    """Root of the mean square error, sqrt(1/(N ny) sum_k |y(k) - r(k)|^2) over k = 0..N-1; lower is better.

    Examples
    --------
    >>> Rmse().evaluate(Record.of_run(y=[4.0, -2.0, 9.0], r=1.0)).item()  # errors 3, -3
    3.0
    """

    name: str = "rmse"

    adds: ClassVar[str] = "squares"
    is_root: ClassVar[bool] = True

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Take the root of the mean of the squares."""
        return np.sqrt(mean_square(self.error(record)))


@dataclass(frozen=True, kw_only=True)
class Mae(ErrorMetric):
    """Mean absolute error, 1/(N ny) sum_k sum_i |y_i(k) - r_i(k)| over k = 0..N-1; lower is better.

    Examples
    --------
    >>> Mae().evaluate(Record.of_run(y=[0.0, 4.0, 9.0], r=1.0)).item()  # errors -1, 3
    2.0
    """

    name: str = "mae"

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Average the absolute values."""
        return mean_absolute(self.error(record))


@dataclass(frozen=True, kw_only=True)
class Iae(ErrorMetric):
    """Integral of the absolute error, Ts/ny sum_k sum_i |y_i(k) - r_i(k)| over k = 0..N-1; lower is better.

    The length of the window times the mean absolute error: a mean over the coordinates, no sum.

    Examples
    --------
    >>> Iae().evaluate(Record.of_run(y=[0.0, 4.0, 9.0], r=1.0, Ts=0.5)).item()  # 0.5 s times sizes 1 and 3
    2.0
    """

    name: str = "iae"

    def unit(self, layout: MetricLayout) -> str:
        """Return the unit of the error times that of the time; no unit has none."""
        unit = super().unit(layout)
        return f"{unit}*{layout.time_unit}" if unit else ""

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Multiply the mean by the length of the window."""
        return record.Ts * self.samples(record).length * mean_absolute(self.error(record))


@dataclass(frozen=True, kw_only=True)
class SettlingTime(ComponentMetric):
    """Time after which the output stays within a band around the reference until the end; lower is better.

    It counts from the first sample of the window to the first one after which no output leaves its band; inf for a run
    outside the band at the last sample.

    Parameters
    ----------
    from_ : begin of the step, in seconds or samples as `time`, from which the time counts
    to : last sample, included; N, the last one of the experiment, if not given
    band : half-width of the band relative to the jump of the reference at the first sample, or without one to |r(last)
        - y(first)|

    Examples
    --------
    The band is 5 % of the step from 0 to 1; the output enters it at k = 2.

    >>> SettlingTime().evaluate(Record.of_run(y=[0.0, 0.5, 0.96, 1.04, 1.0], r=1.0, Ts=0.5)).item()
    1.0
    >>> SettlingTime().evaluate(Record.of_run(y=[0.0, 1.0, 1.0, 1.0, 1.2], r=1.0)).item()
    inf
    """

    name: str = "settling_time"
    band: Positive = 0.05

    reads: ClassVar[tuple[str, ...]] = ("y",)
    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)
    may_not_occur: ClassVar[bool] = True
    to_the_end: ClassVar[bool] = True

    def unit(self, layout: MetricLayout) -> str:
        """Return the unit of the time."""
        return layout.time_unit

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Find the first sample after which the output stays in the band."""
        window = self.samples(record)
        # Of an angle, y is taken with the turns that are nearest to the reference.
        y = record.r + output_error(record) if record.layout.angles else record.y
        y, r = (self.chosen(each, record.layout) for each in (y, record.r))
        return settling_times(y[:, window.slice], r[window.slice], r[max(window.first - 1, 0)], self.band, record.Ts)


def settling_times(
    y: Float[Array, "runs window n"], r: Float[Array, "window n"], r_before: Float[Array, " n"], band: float, Ts: float
) -> Float[Array, " runs"]:
    """Return the times after which the outputs stay in their bands [s]; inf if one is outside at the last sample.

    The half-width `band` is relative to the step, from the reference `r_before` one sample before the window.
    """
    edge = r[0] - r_before
    step = np.where(edge != 0.0, np.abs(edge), np.abs(r[-1] - y[:, 0]))
    outside = np.asarray((np.abs(y - r) > (band * step)[:, None, :]).any(axis=2))
    last_outside = np.where(outside.any(axis=1), outside.shape[1] - 1 - outside[:, ::-1].argmax(axis=1), -1)
    # Rounded, because 34 * 0.1 is 3.4000000000000004 in doubles.
    time = np.round(Ts * (last_outside + 1), 12)
    return np.where(last_outside == outside.shape[1] - 1, np.inf, time)


@dataclass(frozen=True, kw_only=True)
class SteadyStateError(SumMetric):
    """Mean of the signed error y - r over the last part of the window; the value closest to 0 is best.

    Parameters
    ----------
    to : last sample, included; N, the last one of the experiment, if not given
    share : length of this last part relative to the window

    Examples
    --------
    >>> SteadyStateError(share=0.5).evaluate(Record.of_run(y=[0.0, 5.0, 0.75, 0.5], r=1.0)).item()  # -0.25, -0.5
    -0.375
    """

    name: str = "steady_state_error"
    share: Annotated[Positive, Le(1)] = 0.1

    reads: ClassVar[tuple[str, ...]] = ("y",)
    better: ClassVar[Direction] = "zero"
    to_the_end: ClassVar[bool] = True

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Average the last errors."""
        error = self.chosen(output_error(record)[:, self.samples(record).slice], record.layout)
        return time_mean(error[:, -max(1, round(self.share * error.shape[1])) :])


@dataclass(frozen=True, kw_only=True)
class Tracking(BurstMetric, SumMetric):
    """Size of the true control error r - y over k = 0..N-1, inside or outside bursts of the noise; lower is better.

    Parameters
    ----------
    norm : `rms` over samples and components, `peak` the largest size of a component, `length` the largest Euclidean
        norm, `bias` the largest absolute mean of a component over time
    smooth : length of a centred moving average [s] that is applied to the error first; 0 for none
    unit_ : unit of the value: the common unit of the components, or a thousandth of it, such as mm

    Examples
    --------
    >>> record = Record.of_run(y=[3.0, -4.0, 9.0])
    >>> Tracking(norm="peak").evaluate(record).item(), Tracking(norm="bias").evaluate(record).item()
    (4.0, 0.5)
    """

    name: str = "tracking"
    norm: Norm = "rms"
    smooth: NonNegative = 0.0
    unit_: str | None = None

    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)

    @property
    def adds(self) -> str:  # type: ignore[override]
        """What is added, before the root is taken; only the largest component counts for `peak` and `bias`."""
        return "squares" if self.is_root else ""

    @property
    def is_root(self) -> bool:  # type: ignore[override]
        """Whether the value is the root of a sum of squares."""
        return self.norm in ("rms", "length")

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, missing bursts, outputs that do not exist and a unit that does not fit them."""
        issues = [*super().check(layout)]
        yield from issues or issues_of(self._unit_and_factor, layout)

    def unit(self, layout: MetricLayout) -> str:
        """Return the given unit or the one that the outputs have in common."""
        return self._unit_and_factor(layout)[0]

    def _unit_and_factor(self, layout: MetricLayout) -> tuple[str, float]:
        """Return the unit of the value and the factor from the common unit of the outputs."""
        common, unit = super().unit(layout), self.unit_
        if unit is None or unit == common:
            return common, 1.0
        if self.scale is not None:
            raise DesignError("a scaled error has no unit; leave `unit` or `scale` out", "unit")
        if not common:
            raise DesignError("the components have no unit in common; name those of one unit in `only`", "unit")
        if unit != f"m{common}":
            raise DesignError(f"must be {common} or m{common}, a thousandth of it (got {unit!r})", "unit")
        return unit, 1e3

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Reduce the error at the samples that count."""
        error = smoothed(self.chosen(output_error(record), record.layout), self.smooth, record.Ts)
        values = per_run(error[:, self.samples(record).slice], self.counted(record), NORMS[self.norm])
        return self._unit_and_factor(record.layout)[1] * values
