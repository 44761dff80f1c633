"""Mean and covariance over the runs at every k, computed in groups so that trajectories need not be stored.

A group is a fixed range of 50 runs.  The moments of the groups are combined in the order of the runs.
A block reduces the groups that lie in it; the runs of a group that it cuts are kept one by one and are reduced together
when the others are there.  The arithmetic is therefore the same for any blocks, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.types import Array

SIZE = 50


class Group(NamedTuple):
    """Runs first..stop-1, without those that failed: a whole group, or a single run of it."""

    first: int
    stop: int
    n: int
    """How many of them ended well."""
    mean: Float[Array, "samples nz"]
    """Of z = (x, x_hat); zero where there is none."""
    second: Float[Array, "_ nz nz"]
    """Sum of (z - mean)(z - mean)' at every sample; of a single run it is zero and left out (no samples)."""

    @property
    def is_single(self) -> bool:
        """Whether it is a single run."""
        return self.stop == self.first + 1


def groups(
    x: Float[Array, "runs samples nx"],
    x_hat: Float[Array, "runs samples nx_hat"],
    ok: Bool[Array, " runs"],
    runs: range,
) -> list[Group]:
    """Reduce the runs of a block: groups that lie in it, and one by one the runs of those that it cuts."""
    found = list[Group]()
    for start, members in groupby(range(len(runs)), key=lambda row: start_of_group(runs[row])):
        rows = list(members)
        block = slice(rows[0], rows[-1] + 1)
        if len(rows) == SIZE:
            good = ok[block]
            found.append(_reduced(start, np.concatenate([x[block][good], x_hat[block][good]], axis=2)))
        else:
            found += [_single(runs[row], x[row], x_hat[row], ok=bool(ok[row])) for row in rows]
    return found


def start_of_group(run: int) -> int:
    """Return the first run of the group that a run belongs to."""
    return run // SIZE * SIZE


def _reduced(first: int, z: Float[Array, "n samples nz"]) -> Group:
    n = len(z)
    mean = z.sum(axis=0) / max(n, 1)
    deviation = np.ascontiguousarray((z - mean).transpose(1, 2, 0))
    return Group(first, first + SIZE, n, mean, deviation @ deviation.mT)


def _single(run: int, x: Float[Array, "samples nx"], x_hat: Float[Array, "samples nx_hat"], *, ok: bool) -> Group:
    z = np.concatenate([x, x_hat], axis=1)
    mean = z if ok else np.zeros_like(z)
    return Group(run, run + 1, int(ok), mean, np.empty((0, z.shape[1], z.shape[1])))


def gathered(singles: Sequence[Group]) -> Group:
    """Reduce single runs of one group, by the arithmetic of a block of them all; missing runs count as failed."""
    good = [single.mean for single in singles if single.n]
    z = np.array(good) if good else np.zeros((0, *singles[0].mean.shape))
    # A block is reduced on one thread as well.
    with single_thread():
        return _reduced(start_of_group(singles[0].first), z)


def joined(parts: Sequence[Group]) -> tuple[int, Float[Array, "samples nz"], Float[Array, "samples nz nz"]]:
    """Return the number of runs, their mean and their covariance (over n - 1; NaN of less than two runs)."""
    by_group = (list(members) for _, members in groupby(parts, key=lambda part: start_of_group(part.first)))
    whole = [gathered(members) if members[0].is_single else members[0] for members in by_group]
    # A group without a run that ended well adds nothing, and the width of its moments may not be known.
    whole = [part for part in whole if part.n] or whole
    _, _, n, mean, second = whole[0]
    for part in whole[1:]:
        if part.n:
            gap, total = part.mean - mean, n + part.n
            mean = mean + gap * (part.n / total)
            second = second + part.second + gap[..., :, None] * gap[..., None, :] * (n * part.n / total)
            n = total
    return n, mean, second / (n - 1) if n > 1 else np.full_like(second, np.nan)
