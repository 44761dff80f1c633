"""Tables of the trial store for what happened in the runs: failures, held and failed steps, warnings, durations."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from typing import Any

from jaxtyping import Int

from rmpc_bench.execution.chunks import ranges
from rmpc_bench.execution.database import Statement
from rmpc_bench.execution.durations import Durations
from rmpc_bench.received.plain_files import STORED, checked
from rmpc_bench.types import Array, Journal, RunFailure, Status
from rmpc_bench.types.texts import visible

WORDS = {int(status): status.word for status in Status}
Read = Callable[[str, tuple[Any, ...]], list[Any]]


def journal_rows(method: int, runs: Int[Array, " runs"], journal: Journal) -> list[Statement]:
    """Return the statements that store the journal of a block in place of what an earlier one has stored.

    Warnings and durations belong to a block.  Those of an earlier block that shares a run with it are deleted, so that
    no call counts twice.
    """
    spans = [(method, *bounds) for bounds in ranges(runs)]
    first, stop = int(runs[0]), int(runs[-1]) + 1
    failures = [(method, run, json.dumps(failure._asdict(), default=str)) for run, failure in journal.failures.items()]
    durations = {phase: Durations.of(seconds) for phase, seconds in journal.seconds.items() if seconds}
    return [
        ("DELETE FROM failures WHERE method = ? AND run >= ? AND run < ?", spans),
        ("DELETE FROM held WHERE method = ? AND run >= ? AND run < ?", spans),
        ("DELETE FROM failed_steps WHERE method = ? AND run >= ? AND run < ?", spans),
        ("DELETE FROM warnings WHERE method = ? AND first < ? AND stop > ?", [(method, stop, first)]),
        ("DELETE FROM durations WHERE method = ? AND first < ? AND stop > ?", [(method, stop, first)]),
        ("INSERT INTO failures VALUES (?, ?, ?)", failures),
        ("INSERT INTO held VALUES (?, ?, ?)", [(method, run, n) for run, n in journal.held.items() if n]),
        (
            "INSERT INTO failed_steps VALUES (?, ?, ?, ?)",
            [(method, *run_and_status, n) for run_and_status, n in journal.failed_steps.items()],
        ),
        (
            "INSERT INTO warnings VALUES (?, ?, ?, ?, ?)",
            [(method, first, stop, text, n) for text, n in journal.warnings.items()],
        ),
        (
            "INSERT INTO durations VALUES (?, ?, ?, ?, ?, ?)",
            [
                (method, first, stop, phase, part.largest, json.dumps(sorted(part.counts.items())))
                for phase, part in durations.items()
            ],
        ),
    ]


def read_failures(read: Read, method: int, n_runs: int) -> list[RunFailure]:
    """Return the stored failures of a method, in the order of the runs; controls in what code has said are escapes."""
    rows = read("SELECT failure FROM failures WHERE method = ? AND run < ? ORDER BY run", (method, n_runs))
    found = [checked(text.encode(), STORED["failures.failure"], any_text=True) for (text,) in rows]
    return [RunFailure(**{name: _shown(each[name]) for name in RunFailure._fields if name in each}) for each in found]


def _shown(value: Any) -> Any:
    return visible(value) if isinstance(value, str) else value


def read_failed_steps(read: Read, method: int, n_runs: int) -> dict[int, dict[str, int]]:
    """Return run -> word of a status -> number of steps that failed so, of the runs that have some."""
    found: dict[int, dict[str, int]] = {}
    query = "SELECT run, status, n FROM failed_steps WHERE method = ? AND run < ? ORDER BY run, status"
    for run, status, n in read(query, (method, n_runs)):
        found.setdefault(run, {})[WORDS[status]] = n
    return found


def read_durations(read: Read, method: int, n_runs: int) -> dict[str, Durations]:
    """Return the stored durations of a method by component and phase."""
    found: dict[str, Durations] = {}
    query = "SELECT phase, largest, counts FROM durations WHERE method = ? AND first < ? ORDER BY phase, first"
    for phase, largest, counts in read(query, (method, n_runs)):
        found.setdefault(phase, Durations()).add(
            Durations(Counter(dict(checked(counts.encode(), STORED["durations.counts"]))), largest)
        )
    return found
