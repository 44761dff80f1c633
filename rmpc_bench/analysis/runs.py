"""Which runs count, how many of the planned ones there are, and what happened in them besides their numbers.

At every point of a sweep those runs count that every method has, finished or failed.  A method without a row leaves no
run out: it is not computed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import NamedTuple

import numpy as np

from rmpc_bench.types import Array, RunFailure, Status


def common_runs(found: Iterable[Array]) -> Array | None:
    """Return the run indices that all methods with runs have; None where these are all indices of all methods.

    >>> runs = np.arange(48)
    >>> common_runs([runs, runs[:47], runs[:0]]).max().item(), common_runs([runs, runs, runs[:0]])
    (46, None)
    """
    known = [runs for runs in found if len(runs)]
    if not known or all(np.array_equal(runs, known[0]) for runs in known):
        return None
    return np.asarray(reduce(np.intersect1d, known))


class PointExtent(NamedTuple):
    """What is there of one point of a sweep, or of an experiment without one."""

    title: str  # the point in words; empty without a sweep
    coordinates: Mapping[str, str]
    n: int  # runs that count
    absent: tuple[str, ...]  # methods without any run


class Extent(NamedTuple):
    """What is there of an experiment."""

    planned: int  # runs of every method at every point; with a stopping rule those up to its next look
    points: Sequence[PointExtent]  # all points, also those without a run

    @property
    def n(self) -> int:
        """Runs that count, of all points."""
        return sum(point.n for point in self.points)

    @property
    def total(self) -> int:
        """Planned runs of all points."""
        return self.planned * len(self.points)

    @property
    def absent(self) -> tuple[str, ...]:
        """Methods that are not computed at any point."""
        first = self.points[0].absent
        return tuple(name for name in first if all(name in point.absent for point in self.points))

    @property
    def fewest(self) -> int:
        """Runs that count at the point with fewest, of the points that have any."""
        return min((point.n for point in self.points if point.n), default=0)

    @property
    def is_unfinished(self) -> bool:
        """Whether there are runs, but not all; a method without any does not make an experiment unfinished."""
        return 0 < self.n < self.total

    @property
    def blank(self) -> tuple[PointExtent, ...]:
        """Points without a run that counts."""
        return tuple(point for point in self.points if not point.n) if self.planned else ()

    @property
    def is_complete(self) -> bool:
        """Whether every planned run of every method is there."""
        return self.n >= self.total and not any(point.absent for point in self.points)

    @property
    def text(self) -> str:
        """How far the experiment is, such as ``400 of 1000 runs``, and the methods that are not computed.

        >>> [Extent(9, [PointExtent(str(n), {}, n, absent) for n in sizes]).text
        ...  for sizes, absent in (([4], ()), ([9], ("B",)), ([4, 4], ()), ([9, 4, 0], ()))]
        ['4 of 9 runs', '9 of 9 runs, B not computed', '4 of 9 runs at each of 2 points', '13 of 27 runs at 3 points']
        """
        k, each = len(self.points), {point.n for point in self.points}
        text = f"{self.n} of {self.total} runs{f' at {k} points' if k > 1 else ''}"
        if k > 1 and len(each) == 1:
            text = f"{each.pop()} of {self.planned} runs at each of {k} points"
        return f"{text}, {' and '.join(self.absent)} not computed" if self.absent else text


@dataclass(frozen=True)
class RunNotes:
    """Notes on the runs of one method."""

    n_steps: int  # number of control periods of a run
    holds: bool = False  # whether a component of the method holds a failed step
    failures: tuple[RunFailure, ...] = ()  # failures that have a description, in the order of the runs
    held: Mapping[int, int] = field(default_factory=dict)  # run -> number of held steps, of the runs that have some
    # text of a warning of a component -> how often it was given
    warnings: Mapping[str, int] = field(default_factory=dict)
    # time of estimator and controller together per run and step [s]; None where it is not known
    seconds_per_step: float | None = None
    optimises: bool = False  # whether the controller goes on after a step whose optimisation failed
    # run -> word of a status -> number of steps whose optimisation failed so, of the runs that have some
    failed_steps: Mapping[int, Mapping[str, int]] = field(default_factory=dict)

    def of_runs(self, runs: Array) -> RunNotes:
        """Return the notes on some of the runs; warnings are counted over all runs."""
        chosen = {*runs.tolist()}
        return replace(
            self,
            failures=tuple(each for each in self.failures if each.run in chosen),
            held={run: n for run, n in self.held.items() if run in chosen},
            failed_steps={run: steps for run, steps in self.failed_steps.items() if run in chosen},
        )

    @property
    def n_held(self) -> int:
        """Number of held steps of all runs."""
        return sum(self.held.values())

    @property
    def n_failed_steps(self) -> int:
        """Number of steps of all runs whose optimisation failed."""
        return sum(map(self.n_failed_of, self.failed_steps))

    def n_failed_of(self, run: int) -> int:
        """Return the number of steps of a run whose optimisation failed."""
        return sum(self.failed_steps.get(run, {}).values())

    def worst_step_of(self, run: int) -> str:
        """Return the word of the worst status of the steps of a run: ``ok``, ``infeasible`` or ``not-converged``.

        >>> RunNotes(10, failed_steps={3: {"infeasible": 2}}).worst_step_of(3), RunNotes(10).worst_step_of(3)
        ('infeasible', 'ok')
        """
        found = self.failed_steps.get(run, {})
        return max((status for status in Status if status.word in found), default=Status.OK).word
