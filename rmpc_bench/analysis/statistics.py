"""Summary and paired comparisons; the unit is the run, paired with the baseline's run of the same index."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from rmpc_bench.analysis.intervals import (
    NONE,
    Interval,
    difference,
    geometric,
    holm,
    quantile,
    signed_rank_p,
    standard_error,
    student,
    wilson,
)
from rmpc_bench.analysis.rounding import NEGLIGIBLE, STABLE
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array, MetricInfo

__all__ = ["comparisons", "format_with_error", "sentence", "summary", "wilson"]

SUMMARY = "method metric n n_failed mean se ci_low ci_high median q25 q75 min max did_not_occur".split()
COMPARISONS = (
    "method baseline metric change_pct ci_low ci_high won lost tied superiority p_wilcoxon_holm n_pairs word".split()
)


@np.errstate(over="ignore", invalid="ignore")
def summary(trials: Trials) -> pd.DataFrame:
    """Describe every metric of every method.

    Parameters
    ----------
    trials : the table of trials

    Returns
    -------
    one row per method and metric with the columns `SUMMARY`; `n` counts the runs that have a value and
    `did_not_occur` those of them that are inf; where there is one, or could be, mean, se and interval (Student t) are
    NaN
    """
    rows = [_describe(trials, method, info) for method in trials.methods for info in trials.metrics]
    return pd.DataFrame(rows, columns=SUMMARY)


def _describe(trials: Trials, method: str, info: MetricInfo) -> dict[str, Any]:
    values = trials.column(info.name, method)
    values = values[~np.isnan(values)]
    with_mean = len(values) > 0 and not info.may_not_occur and bool(np.isfinite(values).all())
    low, high = student(values, trials.confidence) if with_mean else NONE
    return {
        "method": method,
        "metric": info.name,
        "n": len(values),
        "n_failed": trials.n_failed(method),
        "mean": float(np.mean(values)) if with_mean else math.nan,
        "se": standard_error(values) if with_mean else math.nan,
        "ci_low": low,
        "ci_high": high,
        "median": float(quantile(values, 0.5)),
        "q25": float(quantile(values, 0.25)),
        "q75": float(quantile(values, 0.75)),
        "min": float(quantile(values, 0.0)),
        "max": float(quantile(values, 1.0)),
        "did_not_occur": int(np.isinf(values).sum()),
    }


@np.errstate(over="ignore", invalid="ignore")
def comparisons(trials: Trials) -> pd.DataFrame:
    """Compare every method with the baseline, run by run.

    Parameters
    ----------
    trials : the table of trials

    Returns
    -------
    one row per metric and method but the baseline with the columns `COMPARISONS`; change and interval in per cent of
    the baseline, NaN where a value of the pairs is inf; `superiority` is the share of better runs, a run that does
    not differ counting half; `p_wilcoxon_holm` is a text, empty without pairs
    """
    rows: list[dict[str, Any]] = []
    for info in trials.metrics:
        family = [_compare(trials, method, info) for method in trials.methods if method != trials.baseline]
        for row, p in zip(family, holm([row["p_wilcoxon_holm"] for row in family]), strict=True):
            row["p_wilcoxon_holm"] = _p_text(p)
        rows += family
    return pd.DataFrame(rows, columns=COMPARISONS)


def _compare(trials: Trials, method: str, info: MetricInfo) -> dict[str, Any]:
    a, b = trials.pairs(info.name, method, trials.baseline)
    a, b = from_best(a, info.direction), from_best(b, info.direction)
    change, (low, high) = _change(a, b, trials.confidence)
    gap = _gap(a, b)
    # Two infs have gap 0; a finite value against an infinite baseline is not close to it.
    tied = (gap == 0) | (np.isfinite(gap) & (np.abs(gap) <= trials.relevant * np.abs(b)))
    better = gap > 0 if info.direction == "higher" else gap < 0
    won, lost = int((better & ~tied).sum()), int((~better & ~tied).sum())
    on_logs = bool(np.isfinite(a).all() and np.isfinite(b).all() and (a > 0).all() and (b > 0).all())
    if math.isnan(change):
        word = _word_of_counts(won, lost, trials.confidence)
    else:
        word = _word_of_change(low, high, 100 * trials.relevant, info.direction)
    return {
        "method": method,
        "baseline": trials.baseline,
        "metric": info.name,
        "change_pct": change,
        "ci_low": low,
        "ci_high": high,
        "won": won,
        "lost": lost,
        "tied": int(tied.sum()),
        "superiority": float((better + 0.5 * (gap == 0)).mean()) if len(a) else math.nan,
        "p_wilcoxon_holm": signed_rank_p(_log_gap(a, b, gap) if on_logs else gap),
        "n_pairs": len(a),
        "word": word,
    }


def _gap(a: Array, b: Array) -> Array:
    """Differences run by run, 0 where two values differ by rounding errors only: their sign would depend on the CPU."""
    gap, size = difference(a, b), np.maximum(np.abs(a), np.abs(b))
    return np.where(np.isfinite(gap) & (np.abs(gap) <= NEGLIGIBLE * size), 0.0, gap)


def _log_gap(a: Array, b: Array, gap: Array) -> Array:
    """Differences of the logarithms, rounded so that equal ratios have equal ranks on every CPU."""
    found: Array = np.where(gap == 0, 0.0, np.round(np.log(a) - np.log(b), STABLE))
    return found


def from_best(values: Array, direction: str) -> Array:
    """Distance from the best value where that is neither the lowest nor the highest; from 1 as a ratio."""
    if direction not in ("zero", "one"):
        return values
    with np.errstate(divide="ignore"):
        return np.abs(np.log(values) if direction == "one" else values)


def name_from_best(info: MetricInfo) -> str:
    """Name what `from_best` makes of a metric."""
    return {"zero": f"|{info.name}|", "one": f"|log {info.name}|"}.get(info.direction, info.name)


def _change(a: Array, b: Array, confidence: float) -> tuple[float, Interval]:
    """Change from `b` to `a` in per cent with its interval."""
    if not len(a) or not (np.isfinite(a).all() and np.isfinite(b).all()):
        return math.nan, NONE
    if (a > 0).all() and (b > 0).all():
        ratio, (low, high) = geometric(a, b, confidence)
        return 100 * (ratio - 1), (100 * (low - 1), 100 * (high - 1))
    scale = abs(float(np.mean(b)))
    if scale == 0:
        return math.nan, NONE
    low, high = student(a - b, confidence)
    return 100 * float(np.mean(a - b)) / scale, (100 * low / scale, 100 * high / scale)


def _word_of_change(low: float, high: float, relevant: float, direction: str) -> str:
    if direction == "higher":
        low, high = -high, -low
    low, high = (0.0 if abs(end) < NEGLIGIBLE * 100 else end for end in (low, high))
    if math.isnan(low) or low <= 0 <= high:
        return "not separated"
    if high < -relevant:
        return "better"
    return "worse" if low > relevant else "detectable but small"


def _word_of_counts(won: int, lost: int, confidence: float) -> str:
    """Word where no change exists; ties are left out, or two methods that do not settle would differ."""
    low, high = wilson(won, won + lost, confidence)
    if low > 0.5:
        return "better"
    return "worse" if high < 0.5 else "not separated"


def _p_text(p: float) -> str:
    if math.isnan(p):
        return ""
    return "<0.001" if p < 0.001 else f"{p:.3f}"


def sentence(row: Mapping[str, Any], info: MetricInfo, *, confidence: float = 0.95) -> str:
    """Say one comparison in one sentence that can be pasted into a paper.

    Parameters
    ----------
    row : a row of `comparisons`
    info : the metric of the row
    confidence : level of its interval

    Returns
    -------
    such as "R-MPC1 lowers mse by 10.2 % [9.0, 11.3] against S-MPC (paired, 95 %, 200 runs; better in 195)."
    """
    name = name_from_best(info)
    n, method, baseline = int(row["n_pairs"]), row["method"], row["baseline"]
    counts = f"better in {row['won']}" + (f", tied in {row['tied']}" if row["tied"] else "")
    basis = f"(paired, {100 * confidence:g} %, {n} {'run' if n == 1 else 'runs'}; {counts})"
    change, low, high = float(row["change_pct"]), float(row["ci_low"]), float(row["ci_high"])
    if math.isnan(change):
        verdict = "not separated from" if row["word"] == "not separated" else f"{row['word']} than"
        return f"{method} is {verdict} {baseline} in {name} {basis}."
    if math.isnan(low):
        return f"{method} changes {name} by {change:+.3g} % against {baseline}, without an interval {basis}."
    places = min(3, decimals((high - low) / 2))  # constant ratios have an interval of rounding
    if row["word"] == "not separated":
        interval = f"{change:+.{places}f} % [{low:+.{places}f}, {high:+.{places}f}]"
        return f"{method} is not separated from {baseline} in {name}: {interval} {basis}."
    verb, ends = ("lowers", (-high, -low)) if change < 0 else ("raises", (low, high))
    interval = f"{abs(change):.{places}f} % [{ends[0]:.{places}f}, {ends[1]:.{places}f}]"
    small = ", detectable but small" if row["word"] == "detectable but small" else ""
    return f"{method} {verb} {name} by {interval} against {baseline}{small} {basis}."


def decimals(uncertainty: float) -> int:
    """Decimal places that show an uncertainty with two digits, between 0 and 12; 3 where it is 0 or unknown."""
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return 3
    return min(12, max(0, 1 - math.floor(math.log10(uncertainty))))


def format_with_error(value: float, se: float) -> str:
    """Write a value with no more digits than its standard error supports.

    Parameters
    ----------
    value : the number
    se : its standard error, in the same unit

    Returns
    -------
    such as "0.1186(15)", the bracket being the error of the last digits: two of them up to 35, else one; inf is
    "inf", NaN is "-", and an error that is 0 or unknown leaves four digits without a bracket
    """
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if not (math.isfinite(se) and se > 1e-12 * abs(value)):  # an error below rounding is none
        return f"{value:.4g}"
    size = math.floor(math.log10(max(abs(value), se)))
    if not -4 <= size < 6:
        return f"{format_with_error(value / 10.0**size, se / 10.0**size)}e{size:+03d}"
    exponent = math.floor(math.log10(se))
    lead = se / 10.0**exponent
    # The rule of the Particle Data Group: 1.0 to 3.54 two digits, to 9.49 one, above that "10" of the next decade.
    last = exponent - 1 if lead < 3.55 else exponent
    error = round(se / 10.0**last) * 10.0 ** max(last, 0)
    return f"{round(value, -last):z.{max(-last, 0)}f}({error:.0f})"
