"""The recorded runs of one method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.run_groups import RunGroups
from rmpc_bench.types import Array

COVARIANCE = "P"
"""Recorded signal: the covariance of x_hat - x that a method reports, row by row."""


def last_new_sample(state: Array) -> int:
    """Return the last sample at which a state (samples, n) has changed: that of a failed run is kept afterwards."""
    return int(np.flatnonzero(np.append(True, (state[1:] != state[:-1]).any(axis=1)))[-1])


class Traces(NamedTuple):
    """The recorded runs of one method."""

    runs: Array
    """(n,) indices of the runs, ascending."""
    signals: Mapping[str, Array]
    """Signal -> (n, samples, components): ``y``, ``x``, ``x_hat``, ``P`` at k = 0..N, ``u`` at k = 0..N-1.

    What the method reports of itself is at k = 0..N if it comes from the estimator, else at k = 0..N-1; ``bursts`` is 1
    where the measurement noise is in one.
    """
    r: Array
    """(samples, ny) reference at k = 0..N."""
    shapes: Mapping[str, tuple[int, ...]] = {}
    """Signal that the method reports -> shape of an entry, whose components follow each other row by row."""

    def until(self, last: Mapping[int, int]) -> Traces:
        """Return the runs with NaN after the last sample of those that failed, run -> sample."""
        signals = {name: np.array(values, dtype=float) for name, values in self.signals.items()}
        for row, run in enumerate(self.runs.tolist()):
            for values in signals.values() if run in last else ():
                values[row, last[run] + 1 :] = np.nan
        return self._replace(signals=signals)

    def of_runs(self, runs: Array) -> Traces:
        """Return those of the runs that are recorded."""
        rows = np.isin(self.runs, runs)
        return self._replace(
            runs=self.runs[rows], signals={name: values[rows] for name, values in self.signals.items()}
        )

    def groups(self, finished: Array) -> RunGroups | None:
        """Take the runs that were finished as groups; None where the state is not recorded."""
        rows, estimate = np.isin(self.runs, finished), self.signals.get("x_hat")
        if "x" not in self.signals:
            return None
        return RunGroups.of_trajectories(
            self.runs[rows], self.signals["x"][rows], None if estimate is None else estimate[rows]
        )
