"""Consistency of an estimator: whether its reported covariance agrees with its actual error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.components import ComponentMetric
from rmpc_bench.metrics.error_size import squared_size
from rmpc_bench.metrics.estimate_checks import check_reported, check_state_lengths, estimate_error
from rmpc_bench.metrics.means import time_mean
from rmpc_bench.types import Array, Direction, Issue, MetricLayout, Record


@dataclass(frozen=True, kw_only=True)
class Nees(ComponentMetric):
    """Normalised estimation error squared: mean of (x_hat - x)' P^-1 (x_hat - x) / nx over k = 0..N-1; 1 is best.

    P is the covariance of x_hat(k) - x(k) that the estimator reports; with `only` it is the block of these states.  The
    mean over runs is 1 if P is the actual error covariance, above 1 if the filter is overconfident, and below 1 if it
    is conservative, as a robust filter is on its nominal plant.  The values 2 and 1/2 are equally far from the best
    one.

    If P is singular, its pseudo-inverse is used, and the mean of a consistent filter is rank(P)/nx.  A run whose error
    leaves the range of P has the value inf.  A method whose estimator reports no P is an error of the configuration.  A
    method that reports P at some samples only has no value.

    Examples
    --------
    Errors 2 and 0 with the reported variance 1.

    >>> record = Record.of_run(x=[0.0, 1.0, 1.0], x_hat=[2.0, 1.0, 9.0])
    >>> Nees().evaluate(record._replace(P=np.ones((3, 1, 1)))).item()
    2.0
    """

    name: str = "nees"

    letter: ClassVar[str] = "x"
    reads: ClassVar[tuple[str, ...]] = ("y", "x", "x_hat")
    better: ClassVar[Direction] = "one"
    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)
    needs_P: ClassVar[bool] = True

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, estimates of another length than the state, and estimators without P."""
        yield from super().check(layout)
        yield from check_state_lengths(layout)
        yield from check_reported(layout, "P")

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Average the normalised squares."""
        error = estimate_error(record)
        if record.P is None:
            return np.full(len(error), np.nan)
        window, indices = self.samples(record).slice, self.indices(record.layout)
        # Failed runs overflow here; their values are not used.
        with np.errstate(all="ignore"):
            values = squared_size(record, window, record.P[..., window, :, :], indices)
            return time_mean(values[:, :, None] / len(indices or range(error.shape[2])))
