"""Metric of runs whose output goes far beyond the reference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.components import ComponentMetric
from rmpc_bench.types import Array, Issue, MetricLayout, Positive, Record

EQUATION = r"1 \mathrm{\ if\ } \max_k |y_{k,i}| \gt f \max_k |r_{k,i}|, \mathrm{\ else\ } 0"


@dataclass(frozen=True, kw_only=True)
class Runaway(ComponentMetric):
    """Whether the output of the true system goes far beyond the reference: 1 if it does, else 0; lower is better.

    A run is a runaway if for some output i the largest |y_i(k)| of k = 0..N exceeds `factor` times the largest |r_i(k)|
    of the whole experiment.  An output whose reference is always 0 needs `beyond`.

    Parameters
    ----------
    factor : multiple of the largest reference
    beyond : largest size of y, in its unit, in place of a multiple of the reference

    Examples
    --------
    >>> record = Record.of_run(y=[0.0, 1.5, 1.9, 1.0], r=1.0)
    >>> Runaway().evaluate(record).item(), Runaway(factor=1.8).evaluate(record).item()
    (0.0, 1.0)
    """

    name: str = "runaway"
    factor: Positive = 2.0
    beyond: Positive | None = None

    bounds: ClassVar[tuple[float, float]] = (0.0, 1.0)
    to_the_end: ClassVar[bool] = True

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, outputs that do not exist, and a reference that gives no size."""
        issues = [*super().check(layout)]
        yield from issues
        if self.beyond is not None and self.factor != Runaway.factor:
            yield Issue("factor", "has no effect beside `beyond`")
        if issues or self.beyond is not None or layout.r is None:
            return
        if not self.chosen(layout.r, layout).any():
            yield Issue("", "the reference is 0, so that no multiple of it is a size; give `beyond`")

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Compare the largest output with the largest reference."""
        y = np.abs(self.chosen(record.y[:, self.samples(record).slice], record.layout)).max(axis=1)
        if self.beyond is not None:
            return np.asarray((y > self.beyond).any(axis=1), dtype=float)
        r = np.abs(self.chosen(record.r, record.layout)).max(axis=0)
        if not r.any():
            return np.full(len(y), np.nan)
        return np.asarray(((y > self.factor * r) & (r > 0.0)).any(axis=1), dtype=float)
