"""Metrics of the applied input, which is within the bounds of the plant.

The default window is k = 0..N-1: no input is applied at k = N.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.burst_samples import BurstMetric, burst_samples
from rmpc_bench.metrics.components import SumMetric
from rmpc_bench.metrics.norms import mean_square, mean_sum, peak, per_run, rms, time_mean
from rmpc_bench.types import Array, Record

EQUATION = {
    "InputPower": r"\frac{1}{N n_u} \sum_{k=0}^{N-1} \Vert u_k \Vert^2",
    "InputRoughness": r"\sqrt{\frac{1}{n_u} \sum_i \mathrm{var}_k (\Delta u_{k,i})}, \quad \Delta u_k = u_k - u_{k-1}",
    "InputVariation": r"\frac{1}{N-1} \sum_{k=1}^{N-1} \sum_i |u_{k,i} - u_{k-1,i}|",
    "InputRms": r"\sqrt{\frac{1}{N n_u} \sum_{k=0}^{N-1} \Vert u_k \Vert^2}",
    "InputPeak": r"\max_{k \lt N, i} |u_{k,i}|",
}


@dataclass(frozen=True, kw_only=True)
class InputMetric(SumMetric):
    """A metric of the sizes of the applied inputs; 0 is best."""

    letter: ClassVar[str] = "u"
    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)
    input_only: ClassVar[bool] = True


@dataclass(frozen=True, kw_only=True)
class InputPower(InputMetric):
    """Mean square of the applied input, 1/(N nu) sum_k |u(k)|^2 over k = 0..N-1; lower is better.

    Examples
    --------
    >>> InputPower().evaluate(Record.of_run(u=[1.0, -2.0, 3.0, 0.0])).item()
    3.5
    """

    name: str = "input_power"

    reads: ClassVar[tuple[str, ...]] = ("y", "u")
    adds: ClassVar[str] = "squares"

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Average the squares."""
        return mean_square(self.chosen(record.u[:, self.samples(record).slice], record.layout))


@dataclass(frozen=True, kw_only=True)
class InputRoughness(InputMetric):
    """Standard deviation over time of the increments u(k) - u(k-1) inside the window; lower is better.

    For several inputs the value is the root mean square of their standard deviations.  It is 0 for a ramp and for a
    single sample.

    Examples
    --------
    >>> InputRoughness().evaluate(Record.of_run(u=[1.0, -2.0, 3.0])).item()  # increments -3, 5
    4.0
    """

    name: str = "input_roughness"

    adds: ClassVar[str] = "squares"
    is_root: ClassVar[bool] = True

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Compute the deviation of the increments."""
        increments = np.diff(self.chosen(record.u[:, self.samples(record).slice], record.layout), axis=1)
        if not increments.size:
            return np.zeros(len(increments))
        means = np.ascontiguousarray(increments.transpose(0, 2, 1)).mean(axis=2)
        return np.sqrt(time_mean((increments - means[:, None, :]) ** 2))


@dataclass(frozen=True, kw_only=True)
class InputVariation(BurstMetric, InputMetric):
    """Mean over k = 1..N-1 of the sum over i of |u_i(k) - u_i(k-1)|; lower is better.

    An increment from k - 1 to k counts if sample k counts.

    Parameters
    ----------
    from_ : first k, in seconds or samples as `time` of the experiment; its increment from k - 1 counts

    Examples
    --------
    >>> InputVariation().evaluate(Record.of_run(u=[1.0, -2.0, 3.0])).item()  # increments -3, 5
    4.0
    """

    name: str = "input_variation"

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Average the sizes of the increments that count."""
        window = self.samples(record)
        # There is no increment to k = 0.
        window = window._replace(first=max(window.first, 1))
        increments = np.diff(self.chosen(record.u, record.layout), axis=1)[:, window.first - 1 : window.last]
        return per_run(increments, burst_samples(record, window, self.during, self.memory), mean_sum)


@dataclass(frozen=True, kw_only=True)
class InputRms(BurstMetric, InputMetric):
    """Root of the mean square of the applied input over k = 0..N-1 and all inputs; lower is better.

    Examples
    --------
    >>> InputRms().evaluate(Record.of_run(u=[3.0, -3.0])).item()
    3.0
    """

    name: str = "input_rms"

    reads: ClassVar[tuple[str, ...]] = ("y", "u")
    adds: ClassVar[str] = "squares"
    is_root: ClassVar[bool] = True

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Reduce the inputs at the samples that count."""
        u = self.chosen(record.u[:, self.samples(record).slice], record.layout)
        return per_run(u, self.counted(record), rms)


@dataclass(frozen=True, kw_only=True)
class InputPeak(BurstMetric, InputMetric):
    """Largest size of an applied input over k = 0..N-1; lower is better.

    Examples
    --------
    >>> InputPeak().evaluate(Record.of_run(u=[1.0, -2.0, 0.5])).item()
    2.0
    """

    name: str = "input_peak"

    adds: ClassVar[str] = ""

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Reduce the inputs at the samples that count."""
        u = self.chosen(record.u[:, self.samples(record).slice], record.layout)
        return per_run(u, self.counted(record), peak)
