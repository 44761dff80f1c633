"""The recorded runs of one method, and moments of an ensemble, group by group.

The series of an ensemble are means and covariances over all runs.  Their Monte Carlo error needs parts that can be left
out: single runs where the trajectories are recorded, else the groups of runs that the trial store keeps.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rmpc_bench.types import Array
from rmpc_bench.types.angles import period_of, wrapped

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
    angles: Mapping[str, float] = {}
    """Component that is an angle, such as x.0 -> its period."""

    def difference(self, signal: str, one: Array, other: Array, components: Sequence[int] | None = None) -> Array:
        """Subtract two series (.., components) of a signal, of all components if None; that of an angle is wrapped."""
        error = one - other
        numbers = range(error.shape[-1]) if components is None else components
        return wrapped(error, period_of(self.angles, [f"{signal.removesuffix('_hat')}.{i}" for i in numbers]))

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
        x = self.signals["x"][rows]
        estimate = None if estimate is None else estimate[rows]
        if self.angles and estimate is not None and estimate.shape == x.shape:
            estimate = x + self.difference("x", estimate, x)
        return RunGroups.of_trajectories(self.runs[rows], x, estimate)


MAX_GROUPS = 100
"""Largest number of groups; more are merged with their neighbours, which saves memory and time."""
_QUANTITY = re.compile(r"(mean|cov)\((x|x_hat|e)\)")


@dataclass(frozen=True, eq=False)
class RunGroups:
    """Mean and scatter of z = (x, x_hat) over the runs of each group."""

    runs: tuple[Array, ...]  # indices of the runs of every group
    n: Array  # (groups,) how many of them ended well
    mean: Array  # (groups, samples, nz) their mean
    second: Array  # (groups, samples, nz, nz) sum of (z - mean)(z - mean)'
    nx: int  # number of the plant's states, the first entries of z

    @classmethod
    def of_trajectories(cls, runs: Array, x: Array, x_hat: Array | None) -> RunGroups:
        """Take every recorded run, or some neighbours, as a group; x and x_hat are (n, samples, states)."""
        z = x if x_hat is None else np.concatenate([x, x_hat], axis=2)
        rows = np.array_split(np.arange(len(runs)), min(len(runs), MAX_GROUPS))
        means = [z[part].mean(axis=0) for part in rows]
        scatter = [np.einsum("rki,rkj->kij", z[part] - m, z[part] - m) for part, m in zip(rows, means, strict=True)]
        sizes = np.array([len(part) for part in rows])
        return cls(tuple(runs[part] for part in rows), sizes, np.array(means), np.array(scatter), x.shape[2])

    def __len__(self) -> int:
        return len(self.runs)

    @cached_property
    def _sums(self) -> tuple[Array, Array, Array, Array]:
        """Overall mean, and of every group its deviation, its weighted deviation and its scatter about the mean."""
        weights = self.n[:, None, None]
        centre = (weights * self.mean).sum(axis=0) / self.n.sum()
        deviation = self.mean - centre
        about = self.second + weights[..., None] * deviation[..., :, None] * deviation[..., None, :]
        return centre, deviation, (weights * deviation).sum(axis=0), about.sum(axis=0)

    def has(self, quantity: str) -> bool:
        """Whether a series can be computed again without a group."""
        found = _QUANTITY.fullmatch(quantity)
        nz = self.mean.shape[2]
        return found is not None and nz > {"x": 0, "x_hat": self.nx, "e": 2 * self.nx - 1}[found[2]]

    def series(self, quantity: str, without: int | None = None) -> Array:
        """Compute the mean or the covariance of a series such as ``cov(e)`` over all groups but one, axis 0 = k.

        A covariance is over n - 1, NaN for one run.
        """
        found = _QUANTITY.fullmatch(quantity)
        assert found is not None
        centre, deviation, total, about = self._sums
        n = self.n.sum()
        if without is not None:
            left_out, gap = self.n[without], deviation[without]
            n, total = n - left_out, total - left_out * gap
            about = about - self.second[without] - left_out * gap[..., :, None] * gap[..., None, :]
        shift = total / n
        select = self._select(found[2])
        if found[1] == "mean":
            return np.asarray((centre + shift) @ select.T)
        scatter = about - n * shift[..., :, None] * shift[..., None, :]
        covariance = scatter / (n - 1) if n > 1 else np.full_like(scatter, np.nan)
        return np.asarray(select @ covariance @ select.T)

    def _select(self, signal: str) -> Array:
        """Matrix that takes a signal from z."""
        nx, nz = self.nx, self.mean.shape[2]
        if signal == "x_hat":
            return np.eye(nz)[nx:]
        return np.eye(nz)[:nx] - (np.eye(nz)[nx:] if signal == "e" else 0.0)
