"""claims.json: its form, from which `claims.schema.json` beside this file is made, and the verdicts as such data.

pydantic takes a third of a second to import, so that it is imported where the schema is made.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Literal, TypeAlias

from typing_extensions import TypedDict

from rmpc_bench.analysis.intervals import Interval
from rmpc_bench.analysis.rounding import significant
from rmpc_bench.claims.claim import FINDINGS, Claim
from rmpc_bench.claims.comparison import ComparisonResult
from rmpc_bench.claims.verdict import ClaimVerdict, Size

# pydantic reads that of `typing` from Python 3.12 on.

Word: TypeAlias = Literal[FINDINGS]  # type: ignore[valid-type]
"""The words of `Finding`."""
Decimal = float | Literal["inf", "-inf"]
"""A number with six significant digits; JSON has no infinity."""
Ends = tuple[float | None, float | None]
"""An interval; None for an open end."""


class ChangeRecord(TypedDict):
    """Where the outcome changes with a number of the check: inconclusive from `low` to `high`."""

    of: Literal["threshold", "factor", "margin", "relative margin"]
    low: float
    high: float


class NumbersRecord(TypedDict):
    """A comparison: the interval is that of left - right; `n` is 0 where no run enters."""

    text: str
    at: str | None
    left: Decimal
    right: Decimal
    holds: bool | None
    interval: Ends | None
    n: int
    n_excluded: int
    k: int | None
    entry: list[int] | None
    change: ChangeRecord | None
    n_deciding: int | None
    exceptions: float | None
    below_margin: str | None


class SizeRecord(TypedDict):
    """A number that the paper gives; without tolerance it is compared by its printed digits."""

    of: str
    stated: float | str
    tolerance: float | None
    text: str
    computed: Decimal
    interval: Ends | None
    finding: Word
    relative_difference: Decimal | None


class InterpretationRecord(TypedDict):
    """The finding at one of several points, and what in the text allows it."""

    at: str
    finding: Word
    ground: str | None


class ClaimRecord(TypedDict):
    """A statement: `finding` is that of this experiment, `joined` that over all configurations with the same `id`.

    `words` is the finding of this experiment as pages write it, with the cases or interpretations that it rests on.
    """

    id: str | None
    statement: str
    quote: str | None
    source: str
    kind: Literal["statement of the paper", "additional result", "suspected misprint"]
    check: list[str]
    holds_for: Literal["all", "most", "any"]
    at: Literal["all"] | list[dict[str, str]]
    assumptions: list[str]
    recorded: Word | None
    finding: Word
    words: str
    joined: Word
    elsewhere: dict[str, Word]
    interpretations: list[InterpretationRecord]
    reason: str | None
    numbers: list[NumbersRecord]
    confidence: float
    stated: str | None
    sizes: list[SizeRecord]
    figures: list[str]
    n_runs: int
    seed: int


class ExperimentRecord(TypedDict):
    """What was computed, by which code, and with which command.

    Nothing here depends on the machine: the platform and the versions of libraries are in manifest.json.
    """

    name: str
    title: str
    paper: str | None
    identifier: str | None
    runs: int
    seed: int
    hash: str
    version: str
    numerics: int
    command: str
    final: bool


class ClaimsRecord(TypedDict):
    """The whole file; the findings count only where the experiment is `final`: unmodified and at full size."""

    schema: Literal["rmpc-bench claims 1"]
    experiment: ExperimentRecord
    claims: list[ClaimRecord]


def json_schema() -> dict[str, Any]:
    """Make the JSON Schema of claims.json; keys that it does not name are refused."""
    from pydantic import TypeAdapter

    schema = TypeAdapter(ClaimsRecord).json_schema()
    for record in (schema, *schema["$defs"].values()):
        record["additionalProperties"] = False
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


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
    interval, change, changed = comparison.interval, comparison.change, None
    if change is not None:
        changed = ChangeRecord(of=change.kind, low=significant(change.low), high=significant(change.high))
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
        "change": changed,
        "n_deciding": comparison.n_deciding,
        "exceptions": None if comparison.exceptions is None else significant(comparison.exceptions),
        "below_margin": comparison.below_margin or None,
    }


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
