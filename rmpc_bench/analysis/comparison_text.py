"""Comparisons in short words: the size of a change, the verdict, and the margin of relevance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rmpc_bench.analysis.pairs import is_signed
from rmpc_bench.analysis.rounding import significant_text
from rmpc_bench.analysis.shown_numbers import Estimate, interval_text
from rmpc_bench.analysis.verdict import BOUND, FACTOR, Verdict
from rmpc_bench.types import MetricInfo

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

AVERAGE_WORDS = {
    "geometric": "geometric mean of the ratios",
    "mean": "ratio of the means",
    "difference": "mean difference",
}
"""What an average change is called in a sentence, a caption or a legend."""
UNPAIRED = AVERAGE_WORDS | {"geometric": "ratio of the geometric means"}
"""What it is called where runs are not paired."""
MOST_RUNS = 1e6
"""Runs beyond which a number of runs that would decide is not given."""


def size_text(row: Mapping[str, Any], info: MetricInfo, average: str = "") -> str:
    """Write the average difference of a comparison with its interval, such as "-10.2 % [-11.3, -9.0]", or "-"."""
    unit = info.unit if row["average"] == "difference" else "%"
    return interval_text(change_of(row, average), unit, sign=True)


def change_of(row: Mapping[str, Any], average: str = "") -> Estimate:
    """Return the change of a comparison with its interval, adjusted where it can be; of another average if given."""
    if row["average"] != "difference" and not average:
        return Estimate(*(float(row[name]) for name in ("change_pct", "ci_low", "ci_high")))
    stem, size = (average, "_pct") if average else ("difference", "")
    is_adjusted = not math.isnan(row.get(f"{stem}_adjusted{size}", math.nan))
    return _estimate(row, stem + "_adjusted" * is_adjusted, size)


def _estimate(row: Mapping[str, Any], stem: str, size: str) -> Estimate:
    return Estimate(*(float(row[name]) for name in (f"{stem}{size}", f"{stem}_low", f"{stem}_high")))


def plain_change_of(row: Mapping[str, Any]) -> Estimate:
    """Return the change of an adjusted comparison as it is without the adjustment; NaN for any other."""
    if not row.get("adjusted_form"):
        return Estimate()
    return _estimate(row, row["average"], "" if row["average"] == "difference" else "_pct")


def adjusted_for(row: Mapping[str, Any]) -> str:
    """Name the quantities that a comparison is adjusted for; empty where it is not."""
    return f"adjusted for {', '.join(row['adjusted_for'].split())}" if row.get("adjusted_form") else ""


def contradicting(row: Mapping[str, Any]) -> bool:
    """Whether geometric mean and ratio of the means have opposite signs."""
    return change_of(row, "geometric").value * change_of(row, "mean").value < 0


def verdict_text(row: Mapping[str, Any], margin: str) -> str:
    """Write a verdict in words, with the numbers that it needs, such as "equivalent (within 1 %)"."""
    word = str(row["verdict"])
    if word == Verdict.FAILS_MORE:
        return f"fails more ({_failed_alone(row)})"
    if word == Verdict.EQUIVALENT:
        return f"equivalent (within {margin})"
    if word == Verdict.INCONCLUSIVE:
        return _inconclusive(row)
    return {
        str(Verdict.BETTER_SIZE_UNCERTAIN): "better, size uncertain",
        str(Verdict.WORSE_SIZE_UNCERTAIN): "worse, size uncertain",
        str(Verdict.DEPENDS_ON_AVERAGE): "depends on the average",
    }.get(word, word)


def seen_text(row: Mapping[str, Any], margin: str) -> str:
    """Write a verdict for a sentence; that a method is better, or equivalent, holds in these runs."""
    word = verdict_text(row, margin)
    if not word.startswith((Verdict.BETTER, Verdict.EQUIVALENT)):
        return word
    return f"{word}, in these runs" if "," in word else f"{word} in these runs"


def per_cent(size: float) -> str:
    """Write a bound with two significant digits, at most one of them behind the point from 1 % on."""
    return f"{size:.1f} %" if size >= 1 else f"{significant_text(size, 2)} %"


def far_worse_bound(rows: Iterable[Mapping[str, Any]], trials: Trials, info: MetricInfo) -> str:
    """Count the runs that failed or are far worse, and bound their share; methods with equal numbers together."""
    groups: dict[tuple[int, int, float], list[str]] = {}
    for row in (row for row in rows if not math.isnan(row["far_worse_upper"])):
        n = row["won"] + row["lost"] + row["tied"]
        groups.setdefault((row["far_worse_runs"], n, row["far_worse_upper"]), []).append(str(row["method"]))
    texts = []
    for (k, n, upper), names in groups.items():
        of = (f" of {' and '.join(names)}" if len(names) < 4 else f" of {len(names)} methods") * (len(groups) > 1)
        bound = f", so at most {per_cent(100 * upper)} of all runs ({100 * BOUND:g} % bound)" if k < n else ""
        texts.append(f"{k} of {n} runs{of}{bound}")
    far = "" if is_signed(trials, info) else f" or {trials.lost or FACTOR:g} times worse than the partner"
    return f"failed{far}: {', and '.join(texts)}" if texts else ""


def _inconclusive(row: Mapping[str, Any]) -> str:
    """Name about how many runs would decide, for each word; none where it is the failed runs that leave it open."""
    numbers = [
        (row["runs_for_direction"], "better or worse"),
        (row["runs_for_equivalence"], "equivalent"),
    ]
    known = [f"{about(n)} for {word}" for n, word in numbers if n is not None]
    if known:
        return f"inconclusive (runs needed: {', '.join(known)})"
    has_failures = row["failed_only"] != row["baseline_failed_only"]
    return f"inconclusive (failures could change it: {_failed_alone(row)})" if has_failures else "inconclusive"


def _failed_alone(row: Mapping[str, Any]) -> str:
    """Name the runs in which one of the two failed and the other did not."""
    if row["n_pairs"] is None:
        return f"{row['failed_only']} runs, {row['baseline']} {row['baseline_failed_only']}"
    return f"alone in {row['failed_only']} runs, {row['baseline']} alone in {row['baseline_failed_only']}"


def about(runs: float) -> str:
    """Write a number of runs with two digits, as it is an estimate."""
    number = float(runs)
    if number >= MOST_RUNS:
        return f"more than {MOST_RUNS:.0f}"
    digits = max(0, math.floor(math.log10(max(number, 1))) - 1)
    return f"about {math.ceil(number / 10**digits) * 10**digits:.0f}"


def margin_of(trials: Trials, info: MetricInfo, *, signed: bool) -> str:
    """Write the smallest relevant difference of a metric: in per cent, or in its unit where differences are signed."""
    if signed:
        return f"{trials.relevant_of(info.name, default=0.0):g} {info.unit}".strip()
    return f"{100 * trials.relevant_of(info.name):g} %"
