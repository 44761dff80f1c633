"""Consistency of an estimator: whether its reported covariance agrees with its actual error, and scores of both."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.metrics.components import ComponentMetric, units_of
from rmpc_bench.metrics.estimate_checks import check_reported, check_state_lengths, estimate_error, squared_size
from rmpc_bench.metrics.norms import time_mean
from rmpc_bench.metrics.sample import SignalComponent
from rmpc_bench.numerics.ellipsoid import confidence
from rmpc_bench.numerics.error_size import RANK, ROUNDING, NormalisedSquares
from rmpc_bench.types import Array, DesignError, Direction, Issue, MetricLayout, Record, SampleWindow, WindowMetric
from rmpc_bench.types.errors import issues_of

EQUATION = {
    "Nees": r"\frac{1}{N n_x} \sum_{k=0}^{N-1} (\hat x_k - x_k)^\top P_k^{-1} (\hat x_k - x_k)",
    "Coverage": r"""\frac{1}{N} \sum_{k=0}^{N-1} \mathbf{1}
\left\lbrace (\hat x_k - x_k)^\top P_k^{+} (\hat x_k - x_k) \le \chi^2_{\mathrm{rank} P_k}(p) \right\rbrace""",
    "Crps": r"""\frac{1}{N} \sum_{k=0}^{N-1} \sigma_k \left( z_k (2 \Phi(z_k) - 1) + 2 \varphi(z_k) -
\frac{1}{\sqrt{\pi}} \right), \quad z_k = \frac{\hat x_{k,i} - x_{k,i}}{\sigma_k}, \quad \sigma_k^2 = P_{k,ii}""",
    "LogScore": r"""\frac{1}{2 N}
\sum_{k=0}^{N-1} \left( n_x \log 2 \pi + (\hat x_k - x_k)^\top P_k^{-1} (\hat x_k - x_k) + \log \det P_k \right)""",
}


@dataclass(frozen=True, kw_only=True)
class Nees(ComponentMetric):
    """Normalised estimation error squared: mean of (x_hat - x)' P^-1 (x_hat - x) / nx over k = 0..N-1; 1 is best.

    P is the covariance of x_hat(k) - x(k) that the estimator reports; with `only` it is the block of these states.  The
    mean over runs is 1 for the actual error covariance, above 1 for an overconfident filter, below 1 for a conservative
    one. 2 and 1/2 are equally far from the best value.

    If P is singular, its pseudo-inverse is used, and the mean of a consistent filter is rank(P)/nx.  A run whose error
    leaves the range of P has the value inf.  A method that reports no P is an error of the configuration; one that
    reports P at some samples only has no value.

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
        window, indices = self.samples(record), self.indices(record.layout)
        # Failed runs overflow here; their values are not used.
        with np.errstate(all="ignore"):
            values = _squares(record, record.P, window, indices).values
            return time_mean(values[:, :, None] / len(indices or range(error.shape[2])))


def _squares(record: Record, P: Array, window: SampleWindow, states: list[int] | None = None) -> NormalisedSquares:
    """Return e' P^+ e in a window, computed once for all metrics."""
    key, part = ("squares", window, None if states is None else tuple(states)), P[..., window.slice, :, :]
    found: NormalisedSquares = record.once(key, lambda: squared_size(record, window.slice, part, states))
    return found


def _deviations(record: Record, P: Array, window: SampleWindow, i: int) -> tuple[Array, Array]:
    """Return |e| of state i in a window and its reported standard deviation, NaN where one is not a number."""
    error = record.once("error", lambda: np.abs(estimate_error(record)))[:, window.slice, i]
    variance = P[..., window.slice, i, i]
    return error, np.where(np.isfinite(variance), np.sqrt(np.maximum(variance, 0.0)), np.nan)


FEWEST = 20
"""Samples with P from which on a run counts whose estimator gives P at some samples only."""


@dataclass(frozen=True, kw_only=True)
class ReportedMetric(WindowMetric):
    """A metric of the estimation error and the reported covariance P, sample by sample; without P there is no value."""

    reads: ClassVar[tuple[str, ...]] = ("y", "x", "x_hat")
    needs_P: ClassVar[bool] = True

    @property
    def state(self) -> int | None:
        """Index of the state that the key `of` names; None for all together."""
        of, some = getattr(self, "of", "joint"), isinstance(self, Crps)
        found = re.fullmatch(r"x\.([0-9]+)", of)
        if found is None and (of != "joint" or some):
            raise DesignError(f"must be {'' if some else 'joint or '}x.I, I from 0 on (got {of!r})", "of")
        return None if found is None else int(found[1])

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window or state, estimates of another length than the state, and that no method reports P."""
        yield from super().check(layout)
        yield from check_state_lengths(layout)
        yield from check_reported(layout, "P", of_all=False)
        nx = 10**9 if layout.plant is None else layout.plant.nx
        yield from issues_of(lambda: SignalComponent("x", self.state or 0).check(nx))

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Average over the samples that have a P."""
        P, window = record.gappy_P if record.P is None else record.P, self.samples(record)
        if P is None:
            return np.full(len(record.x), np.nan)
        # Failed runs overflow here; their values are not used.
        with np.errstate(all="ignore"):
            total, n = self.sums(record, P, window)
            return np.where(n >= min(FEWEST, window.length), total / n, np.nan)

    def sums(self, record: Record, P: Array, window: SampleWindow) -> tuple[Array, Array]:
        """Return the sums over the samples of the window that have a value, and their numbers, (runs,) each."""
        values = self.of_samples(record, P, window)
        known = ~np.isnan(values)
        return np.ascontiguousarray(np.where(known, values, 0.0)).sum(axis=1), known.sum(axis=1)

    def of_samples(self, record: Record, P: Array, window: SampleWindow) -> Float[Array, "runs window"]:
        """Return the value at every sample of the window; NaN without P."""
        raise NotImplementedError("of_samples")


@dataclass(frozen=True, kw_only=True)
class Coverage(ReportedMetric):
    """Share of the samples k = 0..N-1 at which the error lies in the region of a level that the covariance P gives.

    `joint` is the ellipsoid e' P^+ e <= c, e = x_hat - x, where c is the quantile of chi-square with as many degrees of
    freedom as P has rank; `x.I` is |e_I| <= z sd_I. An error out of the range of a singular P is not covered.  With the
    covariance of a Gaussian error the mean over runs is the level, and higher is better up to it only: the key
    `calibration` says which estimator is overconfident.

    A method that reports no P has no value.  Where it reports P at some samples only, these count, from 20 per run on.

    Parameters
    ----------
    level : probability of the region
    of : `joint` for all states together, or one state x.I

    Examples
    --------
    Errors 1 and 3 with the reported variance 1; 90 % of a normal number lie within 1.64.

    >>> record = Record.of_run(x=[0.0, 0.0, 0.0], x_hat=[1.0, 3.0, 9.0])
    >>> Coverage(level=0.9).evaluate(record._replace(P=np.ones((3, 1, 1)))).item()
    0.5
    """

    name: str = "coverage"
    level: Annotated[float, Gt(0), Lt(1)] = 0.9
    of: str = "joint"

    better: ClassVar[Direction] = "higher"
    bounds: ClassVar[tuple[float, float]] = (0.0, 1.0)

    def sums(self, record: Record, P: Array, window: SampleWindow) -> tuple[Array, Array]:
        """Count the samples at which the error is covered; regions of other levels share all but the last line."""
        key = ("known", window, self.state)
        size, rank, n = record.once(key, lambda: self._sizes(record, P, window))
        limits = np.array([0.0, *(confidence(self.level, dof) for dof in range(1, P.shape[-1] + 1))])[rank]
        return (size <= limits).sum(axis=1), n

    def _sizes(self, record: Record, P: Array, window: SampleWindow) -> tuple[Array, Array, Array]:
        """Return squares of the errors over P, its rank, and in how many samples of a run both are known."""
        if self.state is None:
            size, lam, _ = _squares(record, P, window)
            return size, (lam > RANK).sum(axis=-1), (~np.isnan(size)).sum(axis=1)
        error, std = _deviations(record, P, window, self.state)
        size, certain = (error / std) ** 2, std == 0.0
        if certain.any():
            largest = np.maximum(*(np.abs(each[:, :, self.state]).max(axis=1) for each in (record.x, record.x_hat)))
            # Without variance only rounding is covered.
            rounding = np.where(error <= ROUNDING * largest[:, None], 0.0, np.inf)
            size = np.where(certain, np.where(np.isnan(error), np.nan, rounding), size)
        return size, np.where(certain, 0, 1), (~np.isnan(size)).sum(axis=1)


@dataclass(frozen=True, kw_only=True)
class Crps(ReportedMetric):
    """Continuous ranked probability score of a state with the normal distribution of x_hat and P; lower is better.

    The mean over k = 0..N-1 of sd (z (2 Phi(z) - 1) + 2 phi(z) - 1/sqrt(pi)), z = e/sd; |e| where sd = 0.  It has the
    unit of the state.  P counts as in `coverage`.

    Parameters
    ----------
    of : the state x.I

    Examples
    --------
    >>> record = Record.of_run(x=[1.0, 1.0], x_hat=[1.0, 9.0])
    >>> round(Crps(of="x.0").evaluate(record._replace(P=np.ones((2, 1, 1)))).item(), 6)
    0.233695
    """

    name: str = "crps"
    of: str

    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)

    def unit(self, layout: MetricLayout) -> str:
        """Return the unit of the state."""
        return units_of(layout, "x", [self.state or 0])[0]

    def of_samples(self, record: Record, P: Array, window: SampleWindow) -> Float[Array, "runs window"]:
        """Compute the closed form for a normal distribution."""
        from scipy.special import erf

        error, std = _deviations(record, P, window, self.state or 0)
        z = error / np.where(std == 0.0, math.nan, std)
        density = np.exp(-0.5 * z**2) * math.sqrt(2.0 / math.pi)
        values = error * erf(z / math.sqrt(2.0)) + std * (density - 1.0 / math.sqrt(math.pi))
        return np.where(std == 0.0, error, values)


@dataclass(frozen=True, kw_only=True)
class LogScore(ReportedMetric):
    """Logarithmic score: mean over k = 0..N-1 of minus the log density of x under the distribution N(x_hat, P).

    0.5 (nx log(2 pi) + e' P^-1 e + log det P) with e = x_hat - x; inf where P is singular.  Lower is better; it may be
    negative, and units of the states shift it.  P counts as in `coverage`.

    Examples
    --------
    >>> record = Record.of_run(x=[1.0, 1.0], x_hat=[1.0, 9.0])
    >>> round(LogScore().evaluate(record._replace(P=np.ones((2, 1, 1)))).item(), 6)
    0.918939
    """

    name: str = "log_score"

    def of_samples(self, record: Record, P: Array, window: SampleWindow) -> Float[Array, "runs window"]:
        """Compute the density; the determinant is that of the correlations times the variances."""
        size, lam, std = _squares(record, P, window)
        half_log = 0.5 * np.log(lam).sum(axis=-1) + np.log(std).sum(axis=-1)
        values = 0.5 * (lam.shape[-1] * math.log(2.0 * math.pi) + size) + half_log
        return np.where(np.isnan(size), np.nan, np.where((lam <= RANK).any(axis=-1), np.inf, values))
