"""The response to the uncertain quantities, what share of its variance they explain, and where a method does worst.

There is one number per run and method, from the primary metric.
For a method it is the log ratio to the baseline, for the baseline itself the log of the metric.  A metric without
logarithm has differences, or its values for the baseline.  Where an event does not occur in every run, it is the
indicator of the runs in which it does not, minus that of the baseline.

Model   y = c_0 + sum c_i z_i + sum c_ii z_i^2 + sum c_ij z_i z_j + rest, fitted by least squares over the runs; z_i is
        a quantity moved and scaled to mean 0 and standard deviation 1.  The shares do not depend on that scale: a model
        with all terms of a quantity spans the same functions on any affine scale.
Share   Drop-one R^2: the adjusted R^2 of the whole model minus that of the model without every term that contains the
        quantity.  With independent quantities it estimates the total Sobol index, so that interactions count for each
        of their quantities and the shares need not sum to 1.  Adjustment: each residual sum of squares is divided by
        its degrees of freedom, so that a quantity without effect has the share 0 on average, and not its number of
        terms divided by n.
Spread  Percentile interval of a bootstrap of whole runs; the rest is multiplied by n/(n - K) there for K terms,
        because the fit to all runs has made the residuals smaller.  In the slow test it covers 0.93 to 0.98 of the time
        for 3 quantities and 60 to 200 runs, and 0.90 to 0.96 for 6 of them.  Where `WORK` is exceeded the interval is
        normal, with the variance of the influence of single runs.
Limits  A quantity with two values has no square.  With more than one term for `RUNS_PER_TERM` runs the interactions
        are left out, then the squares.
Source  Sobol, Mathematics and Computers in Simulation 55 (2001) 271; Homma and Saltelli, Reliability Engineering and
        System Safety 52 (1996) 1 (total effects).

Many fifths are compared, so the worst one looks worse than it is.  The intervals of all fifths hold simultaneously
(Bonferroni): with the level of the experiment each of them contains the mean of its fifth, the chosen one too.  The
fifth differs from the whole where its interval lies on the worse side of the mean of all runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain, combinations
from statistics import NormalDist
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import Interval, student, wilson
from rmpc_bench.analysis.pairs import distance_from_best, is_signed, relative_change
from rmpc_bench.analysis.rounding import NEGLIGIBLE
from rmpc_bench.analysis.superiority import shares_interval
from rmpc_bench.types import Array, MetricInfo

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials


LOG_RATIO, LOG = "log ratio", "log"
DIFFERENCE, VALUE = "difference", "value"
SHARE_DIFFERENCE, SHARE = "difference in not occurring", "not occurring"


class Response(NamedTuple):
    """The response of one method."""

    method: str
    kind: str
    values: Array  # (n_runs,) in the order of `Trials.runs`; NaN where the method or its baseline failed

    @property
    def known(self) -> Array:
        """(n_runs,) whether a run has a response."""
        return ~np.isnan(self.values)

    @property
    def has_spread(self) -> bool:
        """Whether the response differs between runs by more than rounding."""
        found = self.values[self.known]
        return len(found) > 1 and float(np.ptp(found)) > NEGLIGIBLE * max(1.0, float(np.abs(found).max()))

    def shown(self, value: float) -> float:
        """Return a mean response in the unit in which it is written: per cent, or the unit of the metric."""
        if self.kind == LOG_RATIO:
            return 100 * relative_change(value)
        if self.kind == LOG:
            return math.exp(value)
        return 100 * value if self.kind in (SHARE, SHARE_DIFFERENCE) else value

    def interval(self, values: Array, level: float) -> Interval:
        """Interval of the mean of some of the responses: of a share where they count runs, else Student's."""
        if self.kind == SHARE:
            return wilson(int(values.sum()), len(values), level)
        if self.kind == SHARE_DIFFERENCE:
            return shares_interval(int((values > 0).sum()), int((values < 0).sum()), len(values), level)
        return student(values, level)

    def unit(self, info: MetricInfo) -> str:
        """Unit of `shown`."""
        if self.kind == SHARE_DIFFERENCE:
            return "percentage points"
        return info.unit if self.kind in (LOG, DIFFERENCE, VALUE) else "%"


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def response_of(trials: Trials, method: str, info: MetricInfo) -> Response:
    """Return the response of a method at one point, or in an experiment without sweep."""
    is_baseline = method == trials.baseline
    a = distance_from_best(trials.column(info.name, method), info.direction)
    b = distance_from_best(trials.column(info.name, trials.baseline), info.direction)
    known = ~(np.isnan(a) | np.isnan(b))
    columns = [column[known] for column in ((a,) if is_baseline else (a, b))]
    if any(np.isinf(column).any() for column in columns):
        kind = SHARE if is_baseline else SHARE_DIFFERENCE
        columns = [np.isinf(column).astype(float) for column in columns]
    elif is_signed(trials, info) or any((column <= 0).any() for column in columns):
        kind = VALUE if is_baseline else DIFFERENCE
    else:
        kind = LOG if is_baseline else LOG_RATIO
        columns = [np.log(column) for column in columns]
    values = np.full(len(a), np.nan)
    values[known] = columns[0] if is_baseline else columns[0] - columns[1]
    return Response(method, kind, values)


RUNS_PER_TERM = 5
RESAMPLES = 999
TOGETHER = 100
"""Resamples that are drawn together."""
WORK = 250_000
"""Largest n K^2 for n runs and K terms that is resampled: 0.2 s for all resamples."""
ROWS = 50_000
"""Runs whose products of terms are in memory together; more than are resampled."""
RIDGE = 1e-10
"""Share of a term's own square that is added to it: a value that no run of a resample has leaves a term without any."""
FORMS = ("quadratic", "without interactions", "linear")

Term = tuple[int, ...]
"""Quantities whose product a term is: (i,), (i, i) or (i, j)."""


class Surface(NamedTuple):
    """The terms of a response surface."""

    form: str  # one of `FORMS`
    terms: tuple[Term, ...]  # without the constant

    def columns(self, values: Array) -> Array:
        """(n, 1 + terms) constant and terms at (n, quantities) values."""
        found = np.ones((len(values), 1 + len(self.terms)))
        for place, term in enumerate(self.terms, 1):
            found[:, place] = np.prod(values[:, list(term)], axis=1)
        return found

    def without(self, quantity: int) -> list[int]:
        """Columns that are left without a quantity."""
        return [0, *(place for place, term in enumerate(self.terms, 1) if quantity not in term)]


class Shares(NamedTuple):
    """Shares of the variance of several responses; axis 0 = response, axis 1 = quantity, the last is the rest."""

    value: Array
    low: Array
    high: Array


def standardised(values: Array) -> Array:
    """Move and scale every column of (n, quantities) values to mean 0 and standard deviation 1."""
    centred = values - values.mean(axis=0)
    return np.asarray(centred / np.sqrt((centred**2).mean(axis=0)))


def surface_for(values: Array) -> Surface | None:
    """Choose the terms that (n, quantities) values can determine; None where even the linear ones are too many."""
    n, n_quantities = values.shape
    linear: list[Term] = [(i,) for i in range(n_quantities)]
    squares: list[Term] = [(i, i) for i in range(n_quantities) if len(np.unique(values[:, i])) > 2]
    pairs: list[Term] = list(combinations(range(n_quantities), 2))
    for form, terms in zip(FORMS, (linear + squares + pairs, linear + squares, linear), strict=True):
        if len(terms) <= n / RUNS_PER_TERM:
            return Surface(form, tuple(terms))
    return None


def shares(values: Array, y: Array, surface: Surface, confidence: float, seed: int) -> Shares:
    """Compute the share of every quantity, and of the rest, in the variance of every one of the (n, responses) y."""
    A = surface.columns(values)
    # Of one size, so that the sums of squares of the fit lose no digits; the given ones need not stay in memory.
    y = standardised(y)
    kept = [surface.without(i) for i in range(values.shape[1])]
    value = _shares(A, y, np.ones((1, len(y))), kept)[0]
    if A.size * A.shape[1] > WORK:
        reach = NormalDist().inv_cdf((1 + confidence) / 2) * _standard_errors(A, y, value, kept)
        return Shares(value, value - reach, value + reach)
    drawn = _shares(A, y, _resampled(len(y), seed), kept)
    # A resample is drawn from the residuals of the fit, which are already smaller than the errors by this factor.
    drawn[:, :, -1] *= len(y) / (len(y) - A.shape[1])
    low, high = np.quantile(drawn, [(1 - confidence) / 2, (1 + confidence) / 2], axis=0)
    return Shares(value, low, high)


def _resampled(n: int, seed: int) -> Array:
    """(RESAMPLES, n) how often each run is in a resample of all runs."""
    rng, counts = np.random.Generator(np.random.PCG64(seed)), np.empty((RESAMPLES, n))
    # Only the counts are in memory for all resamples: those of 10,000 runs take 80 MB.
    for first in range(0, RESAMPLES, TOGETHER):
        part = counts[first : first + TOGETHER]
        flat = rng.integers(0, n, part.shape) + n * np.arange(len(part))[:, None]
        part[:] = np.bincount(flat.ravel(), minlength=part.size).reshape(part.shape)
    return counts


def _shares(A: Array, y: Array, weights: Array, kept: Sequence[Sequence[int]]) -> Array:
    """(samples, responses, quantities + 1) shares under weights of the runs, the last one that of the rest."""
    n, n_columns = A.shape
    sums = [_sums(A[i : i + ROWS], y[i : i + ROWS], weights[:, i : i + ROWS]) for i in range(0, n, ROWS)]
    gram, moments, squares = (sum(parts[1:], start=parts[0]) for parts in zip(*sums, strict=True))
    total = (squares - moments[:, 0] ** 2 / n) / (n - 1)
    whole = _residual(gram, moments, squares, range(n_columns)) / (n - n_columns)
    rest = [_residual(gram, moments, squares, columns) / (n - len(columns)) - whole for columns in kept]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.stack([*rest, whole], axis=2) / total[:, :, None])


def _sums(A: Array, y: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Weighted sums over some runs of the products of columns, of columns with responses, and of squared responses."""
    n, n_columns = A.shape
    products = (A[:, :, None] * A[:, None, :]).reshape(n, -1)
    gram = (weights @ products).reshape(-1, n_columns, n_columns)
    moments = np.stack([weights @ (A * column[:, None]) for column in y.T], axis=2)
    return gram, moments, weights @ y**2


def _residual(gram: Array, moments: Array, squares: Array, columns: Sequence[int]) -> Array:
    """(samples, responses) residual sums of squares of the model with these columns."""
    chosen = list(columns)
    right = moments[:, chosen]
    coefficients = _solve(gram[:, chosen][:, :, chosen], right)
    return np.asarray(squares - np.einsum("bij,bij->bj", coefficients, right))


def _solve(gram: Array, right: Array) -> Array:
    """Solve normal equations (samples, K, K) for (samples, K, responses)."""
    diagonal = np.einsum("bii->bi", gram)
    lifted = gram + np.eye(gram.shape[1]) * (RIDGE * np.maximum(diagonal, 1.0))[:, None, :]
    return np.asarray(np.linalg.solve(lifted, right))


def _standard_errors(A: Array, y: Array, value: Array, kept: Sequence[Sequence[int]]) -> Array:
    """(responses, quantities + 1) standard errors of shares, from the influence of every run on them."""
    # The residuals are those of the best fit, so that a small change of its coefficients changes no share.
    n, n_columns = A.shape
    gram, moments, squares = A.T @ A, A.T @ y, y**2

    def residuals(columns: Sequence[int]) -> Array:
        beta = np.zeros_like(moments)
        beta[columns] = _solve(gram[np.ix_(columns, columns)][None], moments[columns][None])[0]
        found = A @ beta
        found -= y
        found *= found
        found *= n / (n - len(columns))
        return np.asarray(found)

    whole = residuals(range(n_columns))
    influences = chain((residuals(columns) - whole for columns in kept), [whole])
    # The variance of y is 1, and so is the mean of y^2.
    spreads = []
    for place, each in enumerate(influences):
        each -= value[:, place] * squares
        spreads.append(each.std(axis=0, ddof=1))
    return np.asarray(np.stack(spreads, axis=1) / np.sqrt(n))


PARTS = 5
FEWEST = 10
"""Runs below which a fifth is not considered."""
FEWEST_FAILED = 5
"""Failed runs below which no region is named for them."""
NAMES = ("lowest", "second lowest", "middle", "second highest", "highest")


class Region(NamedTuple):
    """A fifth of a quantity, or one of its values where it has at most five."""

    quantity: str
    name: str  # such as ``lowest``; empty for a single value
    low: float
    high: float
    inside: Array  # (n,) which runs are in it


class RegionMean(NamedTuple):
    """Mean of a response in a region."""

    region: Region
    mean: float
    interval: tuple[float, float]  # simultaneous for all regions
    overall: float
    higher: bool = False  # whether higher responses are better

    @property
    def differs(self) -> bool:
        """Whether the interval lies on the worse side of the mean of all runs."""
        return self.interval[1] < self.overall if self.higher else self.interval[0] > self.overall


def regions(values: Mapping[str, Array]) -> Iterator[Region]:
    """Yield the fifths of every quantity."""
    for name, column in values.items():
        order = np.argsort(column, kind="stable")
        ordered = column[order]
        ends = np.flatnonzero(ordered[1:] != ordered[:-1]) + 1
        if len(ends) < PARTS:
            parts = [("", places) for places in np.split(order, ends)]
        else:
            parts = list(zip(NAMES, np.array_split(order, PARTS), strict=True))
        for word, places in parts:
            inside = np.zeros(len(column), dtype=bool)
            inside[places] = True
            if len(places) >= FEWEST:
                yield Region(name, word, float(column[places].min()), float(column[places].max()), inside)


def worst_means(
    values: Mapping[str, Array],
    response: Array,
    confidence: float,
    *,
    higher: bool = False,
    interval: Callable[[Array, float], Interval] = student,
    parts: Sequence[Region] | None = None,
) -> dict[str, RegionMean]:
    """Find the worst region of every quantity that varies; all intervals hold together.

    `parts` are the `regions` of the values, where they are known from another response in the same runs.
    """
    found = list(regions(values)) if parts is None else parts
    level = 1 - (1 - confidence) / max(len(found), 1)
    sign = -1.0 if higher else 1.0
    worst: dict[str, RegionMean] = {}
    overall = float(response.mean())
    for region in found:
        inside = response[region.inside]
        each = RegionMean(region, float(inside.mean()), interval(inside, level), overall, higher)
        known = worst.get(region.quantity)
        if known is None or sign * each.mean > sign * known.mean:
            worst[region.quantity] = each
    return worst


def most_failures(values: Mapping[str, Array], failed: Array, confidence: float) -> RegionMean | None:
    """Find the region with the largest share of failed runs, with its Wilson interval, for all regions together.

    None with fewer than `FEWEST_FAILED` failed runs.
    """
    found = list(regions(values)) if failed.sum() >= FEWEST_FAILED else []
    if not found:
        return None
    level = 1 - (1 - confidence) / len(found)
    worst = max(found, key=lambda region: float(failed[region.inside].mean()))
    inside = failed[worst.inside]
    return RegionMean(worst, float(inside.mean()), wilson(int(inside.sum()), len(inside), level), float(failed.mean()))
