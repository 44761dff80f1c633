"""Metrics of estimates: how far x_hat is from the true state, and whether its covariance says so.

They compare x_hat with x coordinate by coordinate, so the plant must have the states of the estimator's model; a
configuration whose lengths differ is refused.  `from` and `to` bound the samples, both included, in seconds or samples
as the experiment's `time` is given; without them k = 0..N-1.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.error_size import squared_size
from rmpc_bench.metrics.estimates import estimate_error, refuse_other_states, refuse_without
from rmpc_bench.metrics.tracking import Bound, SampleMetric, Units, Window, mse, time_mean, window_of
from rmpc_bench.types import Array, MetricInfo, Record


def estimation_mse(
    units: Units, *, name: str = "estimation_mse", from_: Bound = None, to: Bound = None
) -> SampleMetric:
    """Mean square of x_hat - x over k = 0..N-1 and all coordinates: `{kind: mse, of: estimate}`.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    refuse_other_states(units.plant, units.methods)  # here, because there is no key `of` to blame
    return mse(units, name=name, of="estimate", from_=from_, to=to)


def nees(units: Units, *, name: str = "nees", from_: Bound = None, to: Bound = None) -> SampleMetric:
    """Normalised squared error of the estimate: mean of (x_hat - x)' P^-1 (x_hat - x) / nx over k = 0..N-1.

    P is the estimator's own covariance of x_hat(k) - x(k).  The mean over runs is 1 where it tells the truth, above 1
    where the filter is too sure of itself and below 1 where it is too careful, as a robust filter is on its nominal
    plant.  Best at 1, and twice as much is as far from it as half as much.

    Where P is singular its pseudo-inverse counts, and the mean of a truthful filter is rank(P)/nx; a run whose error
    leaves the range of P has inf, which tables show as never.  A method whose estimator gives no P is refused; one that
    gives it at some samples only has no value.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    refuse_other_states(units.plant, units.methods)
    refuse_without(units.plant, units.methods, "P")
    window = window_of(units, from_, to, units.n_steps - 1, units.n_steps)
    return SampleMetric(MetricInfo(name, "", "one"), window, _mean_normalised_square, needs_P=True)


def _mean_normalised_square(record: Record, window: Window) -> Float[Array, " runs"]:
    error = estimate_error(record)
    if record.P is None:
        return np.full(len(error), np.nan)
    with np.errstate(all="ignore"):  # of failed runs
        values = squared_size(record, window.slice, record.P[..., window.slice, :, :])
        return time_mean(values[:, :, None] / error.shape[2])
