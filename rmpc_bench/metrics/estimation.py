"""Metrics of the estimation error x_hat - x.

The plant must have the states of the estimator's model; different lengths are an error of the configuration.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.components import SumMetric
from rmpc_bench.metrics.estimate_checks import check_state_lengths, estimate_error
from rmpc_bench.metrics.norms import mean_square
from rmpc_bench.types import Array, Issue, MetricLayout, Record

EQUATION = r"\frac{1}{N n_x} \sum_{k=0}^{N-1} \Vert \hat x_k - x_k \Vert^2"


@dataclass(frozen=True, kw_only=True)
class EstimationMse(SumMetric):
    """Mean square of x_hat - x over k = 0..N-1 and all coordinates; lower is better.

    It is the same as `{kind: mse, of: estimate}`.

    Examples
    --------
    >>> EstimationMse().evaluate(Record.of_run(x=[0.0, 1.0, 1.0], x_hat=[2.0, 1.0, 9.0])).item()  # errors 2, 0
    2.0
    """

    name: str = "estimation_mse"

    letter: ClassVar[str] = "x"
    adds: ClassVar[str] = "squares"
    reads: ClassVar[tuple[str, ...]] = ("y", "x", "x_hat")
    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, and estimates of another length than the state."""
        yield from super().check(layout)
        yield from check_state_lengths(layout)

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Average the squares."""
        error = estimate_error(record)[:, self.samples(record).slice]
        return mean_square(self.chosen(error, record.layout))
