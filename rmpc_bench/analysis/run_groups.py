"""Moments of an ensemble over the runs, group by group, for intervals of what is computed from them.

The series of an ensemble are means and covariances over all runs.  Their Monte Carlo error needs parts that can be left
out: single runs where the trajectories are recorded, else the groups of runs that the trial store keeps.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rmpc_bench.types import Array

MAX_GROUPS = 100
"""Largest number of groups; more are merged with their neighbours, which saves memory and time."""
_QUANTITY = re.compile(r"(mean|cov)\((x|x_hat|e)\)")


@dataclass(frozen=True, eq=False)
class RunGroups:
    """Mean and scatter of z = (x, x_hat) over the runs of each group.

    Parameters
    ----------
    runs : indices of the runs of every group
    n : (groups,) how many of them ended well
    mean : (groups, samples, nz) their mean
    second : (groups, samples, nz, nz) sum of (z - mean)(z - mean)'
    nx : number of the plant's states, the first entries of z
    """

    runs: tuple[Array, ...]
    n: Array
    mean: Array
    second: Array
    nx: int

    @classmethod
    def of_trajectories(cls, runs: Array, x: Array, x_hat: Array | None) -> RunGroups:
        """Take every recorded run, or some neighbours, as a group.

        Parameters
        ----------
        runs : (n,) indices of the runs
        x, x_hat : (n, samples, states) trajectories; None for an estimate that is not recorded
        """
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
        """Compute a series over all groups but one.

        Parameters
        ----------
        quantity : such as ``mean(x)`` or ``cov(e)``
        without : number of the group to leave out; None for none

        Returns
        -------
        (samples, states) mean, or (samples, states, states) covariance over n - 1
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
        covariance = (about - n * shift[..., :, None] * shift[..., None, :]) / (n - 1)
        return np.asarray(select @ covariance @ select.T)

    def _select(self, signal: str) -> Array:
        """Matrix that takes a signal from z."""
        nx, nz = self.nx, self.mean.shape[2]
        if signal == "x_hat":
            return np.eye(nz)[nx:]
        return np.eye(nz)[:nx] - (np.eye(nz)[nx:] if signal == "e" else 0.0)
