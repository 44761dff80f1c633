"""Metrics of estimates: how far x_hat is from the true state, and whether its covariance says so.

They compare x_hat with x coordinate by coordinate, so the plant must have the states of the estimator's model; a
configuration whose lengths differ is refused.  `from` and `to` bound the samples, both included, in seconds or samples
as the experiment's `time` is given; without them k = 0..N-1.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.simulation.estimates import estimate_error, refuse_other_states, refuse_without_P
from rmpc_bench.simulation.metrics import Bound, SampleMetric, Units, Window, mse, time_mean, window_of
from rmpc_bench.types import Array, MetricInfo, Record

RANK = 1e-14
"""Eigenvalues of a correlation matrix up to this one are rounding of its entries: P has no width there."""
OUTSIDE = 1e-6
"""An error further out than this leaves the range: ten standard deviations of a variance of `RANK`."""
ROUNDING = 1e-9
"""Error of a coordinate that P calls certain, relative to the largest |x| and |x_hat| of the run, that is rounding."""


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
    refuse_without_P(units.plant, units.methods)
    window = window_of(units, from_, to, units.n_steps - 1, units.n_steps)
    return SampleMetric(MetricInfo(name, "", "one"), window, _mean_normalised_square, needs_P=True)


def _mean_normalised_square(record: Record, window: Window) -> Float[Array, " runs"]:
    error = estimate_error(record)
    if record.P is None:
        return np.full(len(error), np.nan)
    size = np.maximum(np.abs(record.x), np.abs(record.x_hat)).max(axis=1)
    with np.errstate(all="ignore"):  # of failed runs
        values = _normalised_square(error[:, window.slice], record.P[..., window.slice, :, :], size[:, None, :])
        return time_mean(values[:, :, None] / error.shape[2])


def _normalised_square(
    e: Float[Array, "runs window nx"],
    P: Float[Array, "window nx nx"] | Float[Array, "runs window nx nx"],
    size: Float[Array, "runs 1 nx"],
) -> Float[Array, "runs window"]:
    """Return e' P^+ e: inf outside the range of P, NaN where an entry is no number.

    P is brought to the form of a correlation matrix first, so that the units of the coordinates do not matter.  Sums
    over coordinates go one by one: their bits do not depend on how many runs there are.
    """
    std, lam, U = _correlation(P)
    certain, none = std == 0.0, lam <= RANK
    a = np.where(certain, 0.0, e / np.where(certain, 1.0, std))
    outside: Bool[Array, "runs window"] = (certain & (np.abs(e) > ROUNDING * size)).any(axis=2)
    total = np.zeros(e.shape[:2])
    for i in range(e.shape[2]):
        c = np.zeros(e.shape[:2])
        for j in range(e.shape[2]):
            c += U[..., j, i] * a[..., j]
        outside |= none[..., i] & (np.abs(c) > OUTSIDE)
        total += np.where(none[..., i], 0.0, c**2 / lam[..., i])
    unknown = np.isnan(e).any(axis=2) | np.isnan(std).any(axis=-1)
    return np.where(unknown, np.nan, np.where(outside, np.inf, total))


def _correlation(P: Float[Array, "*k nx nx"]) -> tuple[Float[Array, "*k nx"], Float[Array, "*k nx"], Array]:
    """Standard deviations, and eigenvalues and eigenvectors of the correlations; NaN deviations where P is not finite.

    A coordinate without variance has zeros for its correlations.
    """
    var = np.diagonal(P, axis1=-2, axis2=-1)
    std = np.sqrt(np.where(var <= 0.0, 0.0, var))
    R = 0.5 * (P + np.swapaxes(P, -2, -1)) / std[..., :, None] / std[..., None, :]
    certain = std == 0.0
    R = np.where(certain[..., :, None] | certain[..., None, :], 0.0, R)
    good: Array = np.asarray((np.isfinite(P) & np.isfinite(R)).all(axis=(-2, -1)))
    lam, U = np.linalg.eigh(np.where(good[..., None, None], R, 0.0))  # it raises for all of them where one is NaN
    return np.where(good[..., None], std, np.nan), lam, U
