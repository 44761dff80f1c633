"""Average normalised error squared of a method over the samples: of the ensemble, or of recorded runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.analysis.estimation_errors import (
    ErrorRuns,
    ensemble_errors,
    recorded_errors,
    recorded_innovations,
    reported_covariance,
)
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials


class NeesLines(NamedTuple):
    """NEES of a method over the samples, divided by the degrees of freedom."""

    exact: Array | None
    """(samples,) expected value; None without exact moments."""
    average: Array | None
    """(samples,) average over runs; None without runs."""
    freedom: Array
    """(samples,) degrees of freedom of all runs together."""

    @property
    def main(self) -> Array:
        """The main line."""
        found = self.average if self.exact is None else self.exact
        assert found is not None, "a method has one of both"
        return found


def nees_of(point: Trials, method: str) -> NeesLines | None:
    """Compute the average NEES: of the ensemble where all runs have the same P, else of the recorded runs."""
    recorded = recorded_errors(point, method)
    exact, sampled = (ensemble_errors(point, method, exact=each) for each in (True, False))
    known = exact or sampled
    P = None if known is None else reported_covariance(point, method, len(known.mean))
    own = recorded is not None and recorded.P is not None and recorded.P.ndim == 4
    expected, average = None, None
    if exact is not None and P is not None:
        squares = exact.squares(P)
        expected = _divided(squares.values, squares.freedom)
    if sampled is not None and P is not None and not own:
        squares = sampled.squares(P)
        average = _divided(squares.values, squares.freedom)
        return NeesLines(expected, average, sampled.n * squares.freedom)
    if recorded is not None and recorded.P is not None and len(recorded.runs):
        return _of_runs(recorded, expected)
    return None if expected is None else NeesLines(expected, None, np.zeros(len(expected)))


def nis_of(point: Trials, method: str) -> NeesLines | None:
    """Compute the average NIS of the recorded runs; see `nees_of`."""
    recorded = recorded_innovations(point, method)
    return None if recorded is None or not len(recorded.runs) else _of_runs(recorded, None)


def _of_runs(recorded: ErrorRuns, expected: Array | None) -> NeesLines | None:
    """Average the normalised squares of runs; a sample that a run does not have counts for the others only."""
    values, freedom = recorded.squares()
    missing = np.isnan(values)
    if missing.all():
        return None
    total = np.where(missing, 0, freedom).sum(axis=0)
    average = _divided(np.where(missing, 0.0, values).sum(axis=0), total)
    return NeesLines(expected, average, total)


def _divided(values: Array, freedom: Array) -> Array:
    """Divide by the degrees of freedom; NaN where there are none."""
    return np.asarray(np.where(freedom > 0, values / np.maximum(freedom, 1), np.nan))
