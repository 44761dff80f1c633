"""Metrics of the innovation e(k) = y(k) - y_pred(k), which need no true state: for recorded data as for simulations.

An estimator reports the innovation as `e` and its covariance as `S`.  A sample without a measurement (NaN) is left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.components import ComponentMetric, SumMetric
from rmpc_bench.types import Array, Count, Direction, Issue, MetricLayout, Record

EQUATION = {
    "Nis": r"\frac{1}{(N+1) n_y} \sum_{k=0}^{N} e_k^\top S_k^{-1} e_k",
    "InnovationMse": r"\frac{1}{(N+1) n_y} \sum_{k=0}^{N} \Vert e_k \Vert^2",
    "Whiteness": r"""\frac{n^2}{m n_y^2} \sum_{j=1}^{m} \frac{\mathrm{tr} (C_j^\top C_0^{-1} C_j C_0^{-1})}{n - j},
\quad C_j = \frac{1}{n} \sum_k (e_k - \bar e) (e_{k-j} - \bar e)^\top""",
}


INNOVATION, COVARIANCE = "e", "S"


@dataclass(frozen=True, kw_only=True)
class InnovationMetric(ComponentMetric):
    """A metric of the innovation over the samples k = 0..N unless `to` is given."""

    to_the_end: ClassVar[bool] = True
    of_innovation: ClassVar[bool] = True
    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)
    needs_info: ClassVar[tuple[str, ...]] = (INNOVATION,)

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, and estimators that do not report what is needed."""
        yield from super().check(layout)
        for name in self.needs_info:
            without = [method.name for method in layout.methods if name not in method.reports]
            if without:
                what = "the innovation e" if name == INNOVATION else "the covariance S of the innovation"
                text = f"needs {what}, which the estimator of {', '.join(map(repr, without))} does not report"
                yield Issue("", f"{text}; leave the metric or the method out")

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Reduce the innovations of every run that were measured."""
        if any(name not in record.info for name in self.needs_info):
            return np.full(len(record.y), np.nan)
        window = self.samples(record).slice
        given = [record.info[name][:, window] for name in self.needs_info]
        indices, ny = self.indices(record.layout), given[0].shape[2]
        if indices is not None:
            # S is reported row by row.
            given[1:] = [S[..., [i * ny + j for i in indices for j in indices]] for S in given[1:]]
        given[0] = self.chosen(given[0], record.layout)
        # Failed runs overflow here; their values are not used.
        with np.errstate(all="ignore"):
            return np.array([self._of_run(*(each[row] for each in given)) for row in range(len(record.y))])

    def _of_run(self, *given: Float[Array, "window _"]) -> float:
        measured = ~np.isnan(given[0]).any(axis=1)
        return self.value(*(each[measured] for each in given)) if measured.any() else np.nan

    def value(self, *given: Float[Array, "measured _"]) -> float:
        """Reduce the innovations of a run, and what else is needed, at the samples with a measurement."""
        raise NotImplementedError("value")


@dataclass(frozen=True, kw_only=True)
class InnovationMse(InnovationMetric, SumMetric):
    """Mean square of the innovation over k = 0..N: mean of e(k)^2 over samples and outputs; lower is better.

    It contains the noise of the measurement, so that it does not go to 0.

    Examples
    --------
    >>> record = Record.of_run(y=[0.0, 0.0])._replace(info={"e": np.array([[[1.0], [3.0]]])})
    >>> InnovationMse().evaluate(record).item()
    5.0
    """

    name: str = "innovation_mse"

    adds: ClassVar[str] = "squares"

    def value(self, *given: Float[Array, "measured ny"]) -> float:
        """Average the squares."""
        return float(np.mean(given[0] ** 2))


@dataclass(frozen=True, kw_only=True)
class Nis(InnovationMetric):
    """Normalised innovation squared: mean of e(k)' S(k)^-1 e(k) / ny over k = 0..N; 1 is best.

    S is the covariance of the innovation that the estimator reports.  The mean over runs is 1 for the actual
    covariance, above 1 for an overconfident estimator, below 1 for a conservative one.

    Examples
    --------
    >>> info = {"e": np.array([[[1.0], [3.0]]]), "S": np.array([[[1.0], [3.0]]])}
    >>> Nis().evaluate(Record.of_run(y=[0.0, 0.0])._replace(info=info)).item()
    2.0
    """

    name: str = "nis"

    better: ClassVar[Direction] = "one"
    needs_info: ClassVar[tuple[str, ...]] = (INNOVATION, COVARIANCE)

    def value(self, *given: Float[Array, "measured _"]) -> float:
        """Average the normalised squares."""
        e, S = given
        ny = e.shape[1]
        try:
            whitened = np.linalg.solve(S.reshape(-1, ny, ny), e[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            return np.nan
        return float(np.mean(np.einsum("ki,ki->k", e, whitened)) / ny)


@dataclass(frozen=True, kw_only=True)
class Whiteness(InnovationMetric):
    """Portmanteau statistic of the innovation over k = 0..N: about 1 per degree of freedom if white; lower is better.

    n^2 sum over j = 1..lags of trace(C_j' C_0^-1 C_j C_0^-1) / (n - j) / (lags ny^2), with the n samples of the window
    and the autocovariances C_j = sum of e(k) e(k-j)' / n of the innovation minus its mean over the window (Hosking,
    1980).  Times lags ny^2 it is about chi-square with that many degrees of freedom for a consistent filter.  A large
    value shows correlated innovations: the model or its noises are wrong.  A constant bias has no effect; `nis` shows
    it.  Missing samples are left out first.

    Parameters
    ----------
    lags : number of lags, smaller than the number of samples

    Examples
    --------
    >>> e = np.array([[[1.0], [-1.0]] * 50])
    >>> round(Whiteness(lags=1).evaluate(Record.of_run(y=[0.0] * 100)._replace(info={"e": e})).item())
    99
    """

    name: str = "whiteness"
    lags: Count = 20

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Add to the common checks: more samples than lags."""
        issues = [*super().check(layout)]
        yield from issues
        if not issues and self.window(layout).length <= self.lags and not layout.cut:
            yield Issue("lags", f"must be smaller than the {self.window(layout).length} samples of the window")

    def value(self, *given: Float[Array, "measured ny"]) -> float:
        """Sum the squared correlations."""
        e = given[0] - given[0].mean(axis=0)
        n, ny = e.shape
        lags = min(self.lags, n - 1)
        try:
            inverse = np.linalg.inv(e.T.dot(e) / n)
        except np.linalg.LinAlgError:
            return np.nan
        total = 0.0
        for lag in range(1, lags + 1):
            C = e[lag:].T.dot(e[:-lag]) / n
            # The divisor makes the mean 1 for few samples, too.
            total += float(np.trace(C.T.dot(inverse).dot(C).dot(inverse))) / (n - lag)
        return float(n**2 * total / (lags * ny**2)) if lags else np.nan
