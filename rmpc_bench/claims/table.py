"""claims.json: the verdicts as data, rounded so that another CPU writes the same."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Literal

from rmpc_bench.analysis.intervals import Interval
from rmpc_bench.analysis.rounding import significant
from rmpc_bench.claims.claim import Claim
from rmpc_bench.claims.comparison import ComparisonResult
from rmpc_bench.claims.decision import Change
from rmpc_bench.claims.record import (
    ChangeRecord,
    ClaimRecord,
    ClaimsRecord,
    Decimal,
    Ends,
    ExperimentRecord,
    NumbersRecord,
    SizeRecord,
)
from rmpc_bench.claims.size import Size
from rmpc_bench.claims.verdict import ClaimVerdict


def claims_record(verdicts: Iterable[ClaimVerdict], experiment: ExperimentRecord) -> ClaimsRecord:
    """Turn verdicts into what claims.json holds, as in `claims.schema.json`."""
    return {"schema": "rmpc-bench claims 1", "experiment": experiment, "claims": claims_table(verdicts)}


def claims_table(verdicts: Iterable[ClaimVerdict]) -> list[ClaimRecord]:
    """Turn verdicts into one record per claim; infinity is a text, an open end of an interval None."""
    return [_claim(verdict) for verdict in verdicts]


def _claim(verdict: ClaimVerdict) -> ClaimRecord:
    claim = verdict.claim
    return {
        "id": claim.name or None,
        "statement": claim.says,
        "quote": claim.quote or None,
        "source": claim.source,
        "kind": _kind(claim),
        "check": list(claim.check),
        "holds_for": claim.holds_for.value,
        "at": "all" if claim.pooled else [dict(at) for at in claim.at],
        "assumptions": list(claim.assumptions),
        "recorded": None if claim.finding is None else claim.finding.value,
        "finding": verdict.finding.value,
        "words": verdict.words,
        "joined": verdict.joined.value,
        "elsewhere": {name: finding.value for name, finding in claim.elsewhere.items()},
        "interpretations": [
            {"at": each.at, "finding": each.finding.value, "ground": claim.grounds.get(each.at)}
            for each in verdict.interpretations
        ],
        "reason": verdict.reason or None,
        "numbers": [_numbers(comparison) for comparison in verdict.comparisons],
        "confidence": significant(verdict.confidence),
        "stated": claim.stated if isinstance(claim.stated, str) else None,
        "sizes": [_size(size) for size in verdict.sizes],
        "figures": list(claim.figures),
        "n_runs": verdict.n_runs,
        "seed": verdict.seed,
    }


def _kind(claim: Claim) -> Literal["statement of the paper", "additional result", "suspected misprint"]:
    if claim.of_paper:
        return "statement of the paper"
    return "suspected misprint" if claim.is_misprint else "additional result"


def _numbers(comparison: ComparisonResult) -> NumbersRecord:
    comparison = comparison.rounded()
    interval, change = comparison.interval, comparison.change
    return {
        "text": comparison.text,
        "at": comparison.at or None,
        "left": _number(comparison.left),
        "right": _number(comparison.right),
        "holds": comparison.holds,
        "interval": None if interval is None else _interval(interval),
        "n": comparison.n,
        "n_excluded": comparison.n_excluded,
        "k": comparison.k,
        "entry": None if comparison.entry is None else list(comparison.entry),
        "change": None if change is None else _change(change),
        "n_deciding": comparison.n_deciding,
        "exceptions": None if comparison.exceptions is None else significant(comparison.exceptions),
        "below_margin": comparison.below_margin or None,
    }


def _change(change: Change) -> ChangeRecord:
    return {"of": change.kind, "low": significant(change.low), "high": significant(change.high)}


def _size(size: Size) -> SizeRecord:
    size = size.rounded()
    stated, interval = size.stated, size.interval
    return {
        "of": stated.of,
        "stated": stated.printed or stated.value,
        "tolerance": stated.tolerance,
        "text": stated.text,
        "computed": _number(size.value),
        "interval": None if interval is None else _interval(interval),
        "finding": size.finding.value,
        "relative_difference": None if size.relative is None else _number(size.relative),
    }


def _interval(interval: Interval) -> Ends:
    low, high = (significant(end) if math.isfinite(end) else None for end in interval)
    return low, high


def _number(value: float) -> Decimal:
    """Round a number; infinity, for which JSON has none, becomes a text."""
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return significant(value)
