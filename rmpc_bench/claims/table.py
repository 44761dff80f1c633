"""claims.json: the verdicts as data, rounded so that another CPU writes the same."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from rmpc_bench.analysis.intervals import Interval
from rmpc_bench.analysis.rounding import significant
from rmpc_bench.claims.comparison import ComparisonResult
from rmpc_bench.claims.size import Size
from rmpc_bench.claims.verdict import ClaimVerdict


def claims_table(verdicts: Iterable[ClaimVerdict]) -> list[dict[str, Any]]:
    """Turn verdicts into what claims.json holds.

    Parameters
    ----------
    verdicts : the verdicts

    Returns
    -------
    one dictionary per claim, of JSON types and finite numbers with six significant digits; infinity is a text, an open
    end of an interval None
    """
    return [
        {
            "says": verdict.claim.says,
            "source": verdict.claim.source,
            "check": list(verdict.claim.check),
            "at": "all" if verdict.claim.pooled else [dict(at) for at in verdict.claim.at],
            "recorded": None if verdict.claim.finding is None else str(verdict.claim.finding),
            "finding": str(verdict.finding),
            "interpretations": [{"at": each.at, "finding": str(each.finding)} for each in verdict.interpretations],
            "reason": verdict.reason or None,
            "numbers": [_numbers(comparison) for comparison in verdict.comparisons],
            "n_runs": verdict.n_runs,
            "seed": verdict.seed,
            "stated": verdict.claim.stated if isinstance(verdict.claim.stated, str) else None,
            "sizes": [_size(size) for size in verdict.sizes],
            "assumptions": list(verdict.claim.assumptions),
        }
        for verdict in verdicts
    ]


def _numbers(comparison: ComparisonResult) -> dict[str, Any]:
    comparison = comparison.rounded()
    interval = comparison.interval
    return {
        "text": comparison.text,
        "left": _number(comparison.left),
        "right": _number(comparison.right),
        "holds": comparison.holds,
        "interval": None if interval is None else _interval(interval),
        "n": comparison.n,
        "n_excluded": comparison.n_excluded,
        "at": comparison.at or None,
        "k": comparison.k,
        "entry": None if comparison.entry is None else list(comparison.entry),
    }


def _size(size: Size) -> dict[str, Any]:
    size = size.rounded()
    stated, interval = size.stated, size.interval
    return {
        "of": stated.of,
        "stated": stated.printed or stated.value,
        "tolerance": stated.tolerance,
        "text": stated.text,
        "computed": _number(size.value),
        "interval": None if interval is None else _interval(interval),
        "finding": str(size.finding),
        "relative_difference": None if size.relative is None else _number(size.relative),
    }


def _interval(interval: Interval) -> list[float | None]:
    return [significant(end) if math.isfinite(end) else None for end in interval]


def _number(value: float) -> float | str:
    """Round a number; infinity, for which JSON has none, becomes a text."""
    return str(value) if math.isinf(value) else significant(value)
