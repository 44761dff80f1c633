"""Metrics of the estimation error x_hat - x and of its reported covariance, and what they require of an estimator.

They compare x_hat with x coordinate by coordinate, so the plant must have the states of the estimator's model.
Different lengths are an error of the configuration.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.metrics.reductions import mean_square, time_mean
from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.types import (
    Array,
    DesignError,
    Direction,
    Estimate,
    Issue,
    MetricLayout,
    Record,
    WindowMetric,
    as_estimate,
    without_disturbances,
)

ReportedMatrix = Literal["P", "M"]
DESCRIPTIONS: dict[ReportedMatrix, str] = {"P": "the covariance P", "M": "the set M"}
"""What an estimator may report about its error."""


def first_estimates(layout: MetricLayout) -> Iterator[tuple[str, Estimate]]:
    """Yield the name of each method and an estimate at k = 0, which has the sizes of all others.

    An estimator that knows the true parameters is left out: it needs a drawn plant first.  One from a file of the user
    is not called here; what it returned in its first call is used.
    """
    if layout.plant is None:
        return
    y = np.zeros((1, layout.plant.ny))
    for method in layout.methods:
        known = layout.first_estimates.get(method.name)
        if known is not None:
            yield method.name, without_disturbances(known, method.n_disturbances)
        elif not (method.estimator.knows_uncertainty or method.name in layout.first_estimates):
            with np.errstate(all="ignore"):
                estimate = as_estimate(method.estimator.correct(0, method.estimator.init(1), y)[1])
            yield method.name, without_disturbances(estimate, method.n_disturbances)


def check_state_lengths(layout: MetricLayout, key: str = "") -> Iterator[Issue]:
    """Find the first method whose x_hat has not as many components as the plant's x."""
    for name, estimate in first_estimates(layout):
        nx = layout.plant.nx if layout.plant is not None else 0
        if estimate.x_hat.shape[1] != nx:
            yield Issue(key, _other_lengths(f" of method {name!r}", estimate.x_hat.shape[1], nx))
            return


def check_reported(layout: MetricLayout, *names: ReportedMatrix, key: str = "") -> Iterator[Issue]:
    """Find the methods whose estimator reports none of the given matrices."""
    without = [
        method for method, estimate in first_estimates(layout) if all(getattr(estimate, name) is None for name in names)
    ]
    if without:
        wanted = " or ".join(DESCRIPTIONS[name] for name in names)
        yield Issue(
            key,
            f"needs {wanted} of the estimate, which the estimator of {', '.join(map(repr, without))} does not give; "
            "leave the metric or the method out",
        )


def estimate_error(record: Record) -> Float[Array, "runs samples nx"]:
    """x_hat - x at all samples."""
    if record.x_hat.shape != record.x.shape:
        raise DesignError(_other_lengths("", record.x_hat.shape[2], record.x.shape[2]))
    return record.x_hat - record.x


def _other_lengths(of: str, n_hat: int, n: int) -> str:
    return (
        f"x_hat{of} has {n_hat} components and x of the plant {n}, so there is no x_hat - x; "
        "choose a plant with the states of the model, or measure the output"
    )


RANK = 1e-14
"""Eigenvalues of a correlation matrix up to this one are rounding of its entries: P is singular there."""
OUTSIDE = 1e-6
"""An error further out than this leaves the range: ten standard deviations of a variance of `RANK`."""
ROUNDING = 1e-9
"""Error of a coordinate without variance, relative to the largest |x| and |x_hat| of the run, that is rounding."""


def squared_size(
    record: Record, samples: slice, S: Float[Array, "window nx nx"] | Float[Array, "runs window nx nx"]
) -> Float[Array, "runs window"]:
    """Return e' S^+ e with e = x_hat - x, run by run and sample by sample; inf where e leaves the range of S."""
    size = np.maximum(np.abs(record.x), np.abs(record.x_hat)).max(axis=1)
    return _normalised_square(estimate_error(record)[:, samples], S, size[:, None, :])


def _normalised_square(
    e: Float[Array, "runs window nx"],
    P: Float[Array, "window nx nx"] | Float[Array, "runs window nx nx"],
    size: Float[Array, "runs 1 nx"],
) -> Float[Array, "runs window"]:
    """Return e' P^+ e: inf outside the range of P, NaN where an entry is not a number.

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
    R = symmetrise(P) / std[..., :, None] / std[..., None, :]
    certain = std == 0.0
    R = np.where(certain[..., :, None] | certain[..., None, :], 0.0, R)
    good: Array = np.asarray((np.isfinite(P) & np.isfinite(R)).all(axis=(-2, -1)))
    # eigh raises for the whole stack where one matrix has a NaN.
    lam, U = np.linalg.eigh(np.where(good[..., None, None], R, 0.0))
    return np.where(good[..., None], std, np.nan), lam, U


@dataclass(frozen=True, kw_only=True)
class EstimationMse(WindowMetric):
    """Mean square of x_hat - x over k = 0..N-1 and all coordinates; lower is better.

    It is the same as `{kind: mse, of: estimate}`.

    Examples
    --------
    >>> EstimationMse().evaluate(Record.of_run(x=[0.0, 1.0, 1.0], x_hat=[2.0, 1.0, 9.0])).item()  # errors 2, 0
    2.0
    """

    name: str = "estimation_mse"

    better: ClassVar[Direction] = "lower"
    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, and estimates of another length than the state."""
        yield from super().check(layout)
        yield from check_state_lengths(layout)

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Average the squares."""
        return mean_square(estimate_error(record)[:, self.samples(record).slice])


@dataclass(frozen=True, kw_only=True)
class Nees(WindowMetric):
    """Normalised estimation error squared: mean of (x_hat - x)' P^-1 (x_hat - x) / nx over k = 0..N-1; 1 is best.

    P is the covariance of x_hat(k) - x(k) that the estimator reports.  The mean over runs is 1 if P is the actual error
    covariance, above 1 if the filter is overconfident, and below 1 if it is conservative, as a robust filter is on its
    nominal plant.  The values 2 and 1/2 are equally far from the best one.

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
        window = self.samples(record).slice
        # Failed runs overflow here; their values are not used.
        with np.errstate(all="ignore"):
            values = squared_size(record, window, record.P[..., window, :, :])
            return time_mean(values[:, :, None] / error.shape[2])
