"""Failed runs of a component under test, each reported by the check that it belongs to."""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np

from rmpc_bench.conformance.results import require
from rmpc_bench.types import Journal, RunFailure, Status, Statuses

UNSOLVED = (Status.NOT_CONVERGED, Status.INFEASIBLE)
"""Statuses of a run in which a component raised `SolverError`."""
WORDS = {int(status): status.word for status in Status}
"""Number of a status -> its word."""
NOT_FINITE = re.compile(r"\b(nan|inf|infinite|finite|not a number)\b", re.IGNORECASE)
"""Words of a message about a return value that is not finite."""


def require_no_exception(status: Statuses, journal: Journal) -> None:
    """Fail the running check if a call of a single-run component has raised an exception.

    Parameters
    ----------
    status : of every run
    journal : failures of the runs

    Raises
    ------
    AssertionError
        With the first failure and the number of failed runs.
    """
    failed = [each for each in journal.failures.values() if each.trace and each.status not in UNSOLVED]
    _refuse(failed, len(status))
    explained = {each.run for each in journal.failures.values()}
    crashed = np.isin(status, (Status.CRASHED, Status.TIMEOUT))
    require(bool(explained) or not crashed.any(), f"{crashed.sum()} of {len(status)} runs have crashed")


def require_solved(status: Statuses, journal: Journal) -> None:
    """Fail the running check if a `SolverError` has ended a run.

    Parameters
    ----------
    status, journal : as in `require_no_exception`

    Raises
    ------
    AssertionError
        With the first failure and the number of failed runs.
    """
    _refuse([each for each in journal.failures.values() if each.status in UNSOLVED], len(status))
    unsolved = np.isin(status, UNSOLVED)
    if unsolved.any():
        word = WORDS[int(status[unsolved][0])]
        raise AssertionError(f"{unsolved.sum()} of {len(status)} runs end with the status {word}")
    held = sum(journal.held.values())
    require(held == 0, f"{held} steps in {len(journal.held)} of {len(status)} runs were held")


def require_valid_return_values(journal: Journal, kind: str) -> None:
    """Fail the running check if a single-run component has returned an invalid value.

    Parameters
    ----------
    journal : failures of the runs
    kind : ``finite`` for numbers that are not finite, ``shape`` for everything else

    Raises
    ------
    AssertionError
        With the first failure.
    """
    wrong = [each for each in journal.failures.values() if not each.trace and each.status not in UNSOLVED]
    _refuse([each for each in wrong if bool(NOT_FINITE.search(each.message)) == (kind == "finite")], None)


def _refuse(failures: Collection[RunFailure], n_runs: int | None) -> None:
    if not failures:
        return
    first = min(failures, key=lambda each: (each.k if each.k is not None else -1, each.run))
    known = "" if first.k is None or "k = " in first.message else f" at k = {first.k}"
    shares = "" if n_runs is None else f" ({len(failures)} of {n_runs} runs fail)"
    lines = [line.strip() for line in first.trace.splitlines() if line.strip().startswith("File ")]
    place = f" in {lines[-1].removeprefix('File ')}" if lines else ""
    raise AssertionError(f"run {first.run}{known}: {first.message}{place}{shares}")
