"""Adjusted averages: what draws of known law explain is removed from paired differences.

Model   u are the uncertain quantities of a run, H(u) products of polynomials that are orthonormal under their exact
        laws, so that their means are exactly 0.  X = [1, H] over the n drawn runs, also those that failed.  For a
        column z, alpha(z) is the intercept of its regression on X.  With s = 1 where both methods finished, else 0:
            geometric, difference   theta = alpha(s d) / alpha(s), d the log ratio or the difference
            ratio of the means      theta = log alpha(s a) - log alpha(s b)
        Means of the finished runs alone would be wrong: among them H has another mean.
Values  V_i = theta + (n - 1)(mean_j theta_(-j) - theta_(-i)), where theta_(-i) leaves out run i.  Their mean is theta,
        and sd(V)/sqrt(n) its standard error: V stands wherever the mean of the paired values is compared.
Limit   X = [1] and no failed run: V are the paired values, or those of the jackknife.  With all runs finished the
        standard error is that of HC3 times sqrt((n - 1)/n).
Rule    The form follows from the numbers of pairs and of terms, and from u; the paired values have no part in it.
Source  MacKinnon and White, Journal of Econometrics 29 (1985) 305 (HC3, the jackknife of a regression); Owen, Monte
        Carlo theory, methods and examples, 2013, section 8.9 (control variates).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import Interval, mean_interval, student, t_quantile
from rmpc_bench.analysis.rounding import NEGLIGIBLE
from rmpc_bench.types import Array
from rmpc_bench.types.metric import AdjustKeys

PAIRS_PER_TERM = 10
"""With so many pairs per term an adjustment for draws that explain nothing widens an interval by 10 % at most."""
FORMS = {"degree 4": 4, "quadratic": 2, "without interactions": 2, "linear": 1}  # form -> total degree, largest first
ADDITIVE = "without interactions"
HIGHEST = 4  # largest degree of a polynomial
LARGEST_LEVERAGE, SMALLEST_EIGENVALUE = 0.95, 0.02  # beyond these the drawn values do not determine the terms of a form
WIDEST = 2.0
"""Standard deviations from the mean beyond which a normal law is too wide: a rare draw then has a large residual."""
BEYOND = 10.0  # standard deviations from the mean beyond which a normal law has no draw
ROWS = 20_000  # runs whose terms are in memory together
NO_LAW = "no uncertain quantity with a known law"


class Law(NamedTuple):
    """A law as numbers that have its moments up to those of the polynomials."""

    nodes: Array
    weights: Array

    @property
    def is_random(self) -> bool:
        """Whether it has a spread that is more than rounding."""
        return float(np.ptp(self.nodes)) > max(1e-12 * float(np.abs(self.nodes).max()), 1e-100)


def law_of(data: Mapping[str, Any]) -> Law | None:
    """Return a law from its keys, such as ``{"dist": "uniform", "low": -1, "high": 1}``.

    None for a law that no polynomials are made for.  A normal law may be of any width.
    """
    dist = data.get("dist")
    try:
        if dist == "uniform":
            x, weights = np.polynomial.legendre.leggauss(HIGHEST + 1)
            low, high = float(data["low"]), float(data["high"])
            found = Law((low + high) / 2 + (high - low) / 2 * x, weights / 2)
        elif dist == "choice":
            values = np.array(data["values"], dtype=float)
            shares = data.get("probabilities") or np.full(len(values), 1 / len(values))
            nodes, place = np.unique(values, return_inverse=True)
            sums = np.bincount(place, np.array(shares, dtype=float))
            found = Law(nodes[sums > 0], sums[sums > 0])
        elif dist == "normal":
            x, weights = np.polynomial.legendre.leggauss(200)
            low, high = (min(max(each, -BEYOND), BEYOND) for each in _limits(data))
            z = (low + high) / 2 + (high - low) / 2 * x
            weights = weights * np.exp(-(z**2 - min(low**2, high**2) * (low * high > 0)) / 2)
            found = Law(float(data.get("mean") or 0.0) + float(data["std"]) * z, weights / weights.sum())
        else:
            return None
    except (TypeError, ValueError, KeyError, ZeroDivisionError):
        # A record from elsewhere may hold anything.
        return None
    is_law = len(found.nodes) and np.isfinite(found.nodes).all() and abs(found.weights.sum() - 1) < NEGLIGIBLE
    return found if is_law else None


def _limits(data: Mapping[str, Any]) -> tuple[float, float]:
    """Limits of a normal law in standard deviations from its mean."""
    std, mean = float(data["std"]), float(data.get("mean") or 0.0)
    if data.get("truncate") is not None:
        return -float(data["truncate"]), float(data["truncate"])
    low, high = data.get("low"), data.get("high")
    return (
        -math.inf if low is None or not std else (float(low) - mean) / std,
        math.inf if high is None or not std else (float(high) - mean) / std,
    )


def left_out_by_auto(data: Mapping[str, Any]) -> str:
    """Say why `auto` takes a law for noise; empty where it adjusts for it."""
    law = law_of(data)
    if law is None:
        dist = data.get("dist")
        return f"its {dist} law has no polynomials" if isinstance(dist, str) else "its law is not known"
    wide = data["dist"] == "normal" and law.is_random and max(map(abs, _limits(data))) > WIDEST
    return "its normal law is too wide" if wide else ""


class Quantity(NamedTuple):
    """An uncertain quantity with the recurrence of its orthonormal polynomials."""

    name: str
    centre: float
    scale: float
    a: tuple[float, ...]
    b: tuple[float, ...]  # b_(k+1) p_(k+1)(t) = (t - a_k) p_k(t) - b_k p_(k-1)(t), t = (u - centre) / scale

    @property
    def degree(self) -> int:
        """Largest degree: a law of m values has m - 1 polynomials."""
        return len(self.b)

    def polynomials(self, u: Array) -> list[Array]:
        """Return p_1, p_2 .. at values of the quantity."""
        t = (u - self.centre) / self.scale
        found = [np.zeros_like(t), np.ones_like(t)]
        for k, (a, b) in enumerate(zip(self.a, self.b, strict=True)):
            found.append(((t - a) * found[-1] - (self.b[k - 1] if k else 0.0) * found[-2]) / b)
        return found[2:]


def quantity_of(name: str, law: Law) -> Quantity:
    """Make the polynomials of a law that has a spread (Stieltjes)."""
    weights, centre = law.weights, float(law.weights @ law.nodes)
    scale = math.sqrt(float(weights @ (law.nodes - centre) ** 2))
    t = (law.nodes - centre) / scale
    before, p = np.zeros_like(t), np.ones_like(t)
    a, b = [], list[float]()
    for _ in range(min(HIGHEST, len(t) - 1)):
        a.append(float(weights @ (t * p**2)))
        new = (t - a[-1]) * p - (b[-1] if b else 0.0) * before
        b.append(math.sqrt(float(weights @ new**2)))
        before, p = p, new / b[-1]
    return Quantity(name, centre, scale, tuple(a), tuple(b))


Term = tuple[int, ...]  # degree of every quantity in a product


def terms_of(degrees: Sequence[int], form: str) -> list[Term]:
    """Return the terms of a form without the constant, for quantities with these largest degrees."""
    total = FORMS.get(form, 0)
    places = range(len(degrees))
    chosen = (each for k in range(1, total + 1) for each in combinations_with_replacement(places, k))
    found = (tuple(each.count(place) for place in places) for each in chosen if form != ADDITIVE or len({*each}) == 1)
    return [term for term in found if all(n <= most for n, most in zip(term, degrees, strict=True))]


def n_terms(degrees: Sequence[int], form: str) -> int:
    """Count the terms of a form with the constant."""
    total = FORMS.get(form, 0)
    if form == ADDITIVE:
        return 1 + sum(min(total, degree) for degree in degrees)
    counts = [1] + [0] * total
    for degree in degrees:
        counts = [sum(counts[k - n] for n in range(min(k, degree) + 1)) for k in range(total + 1)]
    return sum(counts)


@dataclass(frozen=True, eq=False)
class Basis:
    """The columns X of a form at the drawn values, with what leaving out a run takes."""

    form: str
    quantities: tuple[Quantity, ...]
    values: Array  # (n, quantities) drawn values

    @cached_property
    def p(self) -> int:
        """Number of columns."""
        return 1 + len(self._terms)

    @cached_property
    def _terms(self) -> list[Term]:
        return terms_of([each.degree for each in self.quantities], self.form)

    @cached_property
    def _kept(self) -> list[Array]:
        return [*self._made()] if len(self.values) <= ROWS else []

    def blocks(self) -> Iterator[tuple[slice, Array]]:
        """Yield ranges of runs and the rows of X."""
        firsts = range(0, len(self.values), ROWS)
        for first, block in zip(firsts, self._kept or self._made(), strict=True):
            yield slice(first, first + ROWS), block

    def _made(self) -> Iterator[Array]:
        for first in range(0, len(self.values), ROWS):
            rows = self.values[first : first + ROWS]
            powers = [[np.ones(len(rows)), *q.polynomials(rows[:, i])] for i, q in enumerate(self.quantities)]
            # Columns that are contiguous are made and multiplied several times faster.
            X = np.ones((self.p, len(rows)))
            for column, term in enumerate(self._terms, 1):
                factor, *others = (powers[place][n] for place, n in enumerate(term) if n)
                X[column] = factor
                for each in others:
                    X[column] *= each
            yield X.T

    @cached_property
    def _square(self) -> Array:
        return np.asarray(sum(X.T @ X for _, X in self.blocks()))

    @cached_property
    def _leverages(self) -> tuple[Array, Array]:
        """First row of (X'X)^-1 X' and leverages, (n,) each."""
        inverse, g, h = np.linalg.inv(self._square), np.empty(len(self.values)), np.empty(len(self.values))
        for rows, X in self.blocks():
            product = inverse @ X.T
            g[rows], h[rows] = product[0], (product * X.T).sum(axis=0)
        return g, h

    @cached_property
    def is_determined(self) -> bool:
        """Whether the drawn values determine the terms; a basis without terms is."""
        square = self._square / len(self.values)
        # A record from elsewhere may hold values beyond its laws.
        if not np.isfinite(square).all() or float(np.linalg.eigvalsh(square)[0]) < SMALLEST_EIGENVALUE:
            return False
        return float(self._leverages[1].max()) <= LARGEST_LEVERAGE

    def intercepts(self, z: Array) -> Array:
        """Return the intercepts of the columns z (n, columns) without each run, and in row n those of all runs."""
        (g, h), found = self._leverages, np.empty((len(z) + 1, z.shape[1]))
        beta = np.linalg.solve(self._square, sum(X.T @ z[rows] for rows, X in self.blocks()))
        for rows, X in self.blocks():
            found[:-1][rows] = beta[0] - (g[rows] / (1 - h[rows]))[:, None] * (z[rows] - X @ beta)
        found[-1] = beta[0]
        return found


class Values(NamedTuple):
    """Numbers whose mean is an average."""

    values: Array
    runs: Array  # indices of their runs
    df: float  # degrees of freedom of their standard error
    basis: Basis | None = None  # None for the paired values as they are
    unpaired: bool = False  # whether they are those of two samples, see `pairs.Samples`; their interval is then Welch's

    def interval(self, average: str, level: float, seed: int) -> Interval:
        """Interval of the mean; bootstrap-t makes that of the ratio of the means worse (0.92 instead of 0.945)."""
        plain = average == "mean" or self.unpaired
        low, high = student(self.values, level) if plain else mean_interval(self.values, level, seed)
        if self.df == len(self.values) - 1:
            return low, high
        middle = float(np.mean(self.values))
        factor = t_quantile(self.df, level) / t_quantile(len(self.values) - 1, level)
        return middle + factor * (low - middle), middle + factor * (high - middle)


def _column(name: str, a: Array, b: Array) -> Array:
    """Return the numbers of pairs that an average or a part of it is computed from."""
    if name == "geometric":
        return np.where(a == b, 0.0, np.log(a) - np.log(b))
    return {"s": np.ones(len(a)), "a": a, "b": b}[name] if name != "difference" else a - b


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def leave_one_out(basis: Basis, averages: Collection[str], a: Array, b: Array) -> dict[str, Array]:
    """Return average -> values V over all drawn runs; one whose adjusted means are not positive is left out.

    `a` and `b` are the (n,) values of the two methods over these runs, NaN where one of the two failed or has none.
    """
    n, both = len(a), ~(np.isnan(a) | np.isnan(b))
    names = ["s", *(name for name in averages if name != "mean"), *(("a", "b") if "mean" in averages else ())]
    z = np.zeros((n, len(names)))
    for place, name in enumerate(names):
        z[both, place] = _column(name, a[both], b[both])
    size = dict(zip(names, np.abs(z).max(axis=0).tolist(), strict=True)) | {"mean": 1.0}
    # With the estimate of all runs in the last row.
    alpha = dict(zip(names, basis.intercepts(z).T, strict=True))
    del z
    alpha["s"] = np.ones(n + 1) if both.all() else alpha["s"]
    found = {}
    for name in averages:
        parts = [alpha[each] for each in (("s", "a", "b") if name == "mean" else ("s",))]
        theta = np.log(alpha["a"] / alpha["b"]) if name == "mean" else alpha[name] / alpha["s"]
        if min(each.min() for each in parts) > 0 and np.isfinite(theta).all():
            gaps = theta[:n].mean() - theta[:n]
            gaps *= n - 1
            if np.abs(gaps).max() <= NEGLIGIBLE * size[name]:
                gaps[:] = 0.0  # rounding is no spread: the draws then explain every difference
            gaps += theta[n]
            found[name] = gaps
    return found


@dataclass(frozen=True, eq=False)
class Adjustment:
    """What is adjusted for at one point of a sweep."""

    runs: Array  # (n,) indices of the drawn runs
    quantities: tuple[Quantity, ...] = ()  # those of the basis
    values: Array = field(default_factory=lambda: np.empty((0, 0)))  # (n, quantities) drawn values; empty without any
    forms: tuple[str, ...] = ()  # forms that may be chosen, the largest first
    reason: str = ""  # why there is no basis; empty where there may be one
    left_out: Mapping[str, str] = field(default_factory=dict)  # quantity -> why `auto` takes it for noise
    wide: tuple[str, ...] = ()  # quantities that are asked for although their normal law is too wide

    @cached_property
    def _bases(self) -> dict[str, Basis]:
        return {}

    def basis(self, n_pairs: int) -> Basis | None:
        """Choose the form by the number of pairs and by the drawn values; None where even a linear one is too large."""
        degrees = [each.degree for each in self.quantities]
        for form in self.forms if 2 * n_pairs >= len(self.runs) else ():
            if n_pairs >= PAIRS_PER_TERM * n_terms(degrees, form):
                if form not in self._bases:
                    self._bases[form] = Basis(form, self.quantities, self.values)
                if self._bases[form].is_determined:
                    return self._bases[form]
        return None

    def why_not(self, n_pairs: int) -> str:
        """Say why so many pairs have no adjusted average."""
        q = len(self.quantities)
        least = PAIRS_PER_TERM * (1 + q)
        if self.reason:
            return self.reason
        if n_pairs < least:
            return f"{n_pairs} runs, {least} are needed for {q} quantit{'y' if q == 1 else 'ies'}"
        if 2 * n_pairs < len(self.runs):
            return "most runs failed"
        return "an adjusted mean is not positive" if self.basis(n_pairs) else "the drawn values do not differ enough"

    def of_runs(self, runs: Array) -> Adjustment:
        """Return the same for some of the runs."""
        values = self.values[np.searchsorted(self.runs, runs)] if len(self.values) else self.values
        return replace(self, runs=runs, values=values)

    def adjusted(
        self, runs: Array, a: Array, b: Array, averages: Collection[str], basis: Basis | None = None
    ) -> dict[str, Values]:
        """Adjust averages of pairs of some runs, NaN where one failed: all that can be, by the rule or with a basis."""
        n_pairs = int(np.count_nonzero(~(np.isnan(a) | np.isnan(b))))
        basis = basis or self.basis(n_pairs)
        if basis is None or not averages:
            return {}
        if len(runs) < len(self.runs):
            values = np.full((2, len(self.runs)), np.nan)
            values[:, np.searchsorted(self.runs, runs)] = a, b
            a, b = values
        made = leave_one_out(basis, averages, a, b)
        return {name: Values(V, self.runs, n_pairs - basis.p, basis) for name, V in made.items()}


def adjustment_of(
    adjust: str | Sequence[str] | AdjustKeys,
    runs: Array,
    drawn: Mapping[str, Any],
    laws: Mapping[str, Mapping[str, Any]],
    random_besides: Sequence[str] | None,
) -> Adjustment:
    """Find what the comparisons at one point are adjusted for; the arguments are fields of `Trials`."""
    names = [name for name in drawn if name != "run"]
    if adjust == "none" or not names:
        return Adjustment(runs, reason=NO_LAW)
    keys = adjust if isinstance(adjust, AdjustKeys) else AdjustKeys(None if isinstance(adjust, str) else [*adjust])
    left_out, chosen = dict[str, str](), dict[str, Law]()
    for name in names:
        data = laws.get(name, {})
        law = law_of(data)
        if law is not None and not law.is_random:
            continue
        why = left_out_by_auto(data) if keys.for_ is None else "" if law and name in keys.for_ else "not asked for"
        if law is None or why:
            left_out[name] = why or "its law is not known"
        else:
            chosen[name] = law
    places = np.minimum(np.searchsorted(drawn["run"], runs), max(len(drawn["run"]) - 1, 0))
    has_values = len(drawn["run"]) and (drawn["run"][places] == runs).all()
    values = np.column_stack([drawn[name][places] for name in chosen]) if chosen and has_values else np.empty((0, 0))
    reason = "" if chosen else NO_LAW
    if chosen and not (values.size and np.isfinite(values).all()):
        reason = "the drawn values are not stored"
    nothing_else = random_besides == () and not left_out
    forms = [form for form, degree in FORMS.items() if degree <= keys.degree and (degree < HIGHEST or nothing_else)]
    quantities = tuple(quantity_of(name, law) for name, law in chosen.items())
    wide = tuple(name for name in chosen if left_out_by_auto(laws[name]))
    return Adjustment(runs, quantities, values, () if reason else tuple(forms), reason, left_out, wide)
