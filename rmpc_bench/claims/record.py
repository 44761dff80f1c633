"""The form of claims.json, from which its JSON Schema is made (`claims.schema.json` beside this file).

pydantic takes a third of a second to import, so that it is imported where the schema is made.
"""

from __future__ import annotations

from typing import Any, Literal

# pydantic reads that of `typing` from Python 3.12 on.
from typing_extensions import TypedDict

Word = Literal[
    "confirmed",
    "confirmed-smaller",
    "confirmed-larger",
    "partially-confirmed",
    "inconclusive",
    "depends-on-assumptions",
    "not-confirmed",
    "not-testable",
    "equal",
    "close",
    "different",
]
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
