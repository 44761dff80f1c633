"""Looking more than once at a growing number of runs: schedule of looks and level of the intervals at each.

A verdict that is repeated with more runs until it is decided has several chances to be wrong.

Planned looks at verdicts or claims, of which there are at most K: each interval has the level 1 - alpha/K, so that all
looks together are wrong in at most alpha of the experiments (Bonferroni).

Planned looks at widths end an experiment when its intervals are narrow enough, whatever they contain.  Their levels
stay as they are.

Unplanned looks, where a user raises the number of runs after a verdict was printed: the number of further looks is
unknown, and the first one has used alpha already.  Look k > 1 gets alpha / (k (k + 1)); their sum over all k > 1 is
alpha / 2.  All looks together are thus wrong in at most 1.5 alpha of the experiments, however often a user looks.  As
they share their runs it is less: 6.1 % for alpha = 5 % and eight doublings by simulation, against 25 % with alpha at
every look.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


def schedule(min_runs: int, max_runs: int) -> tuple[int, ...]:
    """Return the numbers of runs of planned looks: min_runs times powers of 2 below max_runs, and max_runs.

    Examples
    --------
    >>> schedule(100, 2000), schedule(100, 400)
    ((100, 200, 400, 800, 1600, 2000), (100, 200, 400))
    """
    looks, n = [], min_runs
    while n < max_runs:
        looks.append(n)
        n *= 2
    return (*looks, max_runs)


def planned_level(confidence: float, n_looks: int) -> float:
    """Return the level of the intervals at each of so many planned looks.

    Examples
    --------
    >>> round(planned_level(0.95, 6), 4)
    0.9917
    """
    return 1 - (1 - confidence) / n_looks


def next_width_look(n: int, half_width: float, resolve: float, every: int, max_runs: int) -> int:
    """Return the number of runs of the next look at the width of intervals.

    The width falls with the root of the number of runs.  The next look is half way to the number that would resolve, in
    steps of `every`, so that no look is wasted on intervals that are certainly too wide; it is at most twice the number
    now, as few runs predict badly.

    >>> next_width_look(100, 0.03, 0.02, 50, 2000), next_width_look(100, 0.021, 0.02, 50, 2000)
    (150, 150)
    >>> next_width_look(400, 0.05, 0.02, 50, 10_000), next_width_look(400, 0.05, 0.02, 50, 700)
    (800, 700)
    """
    distance = n * ((half_width / resolve) ** 2 - 1) / 2 if half_width < resolve * max_runs else n
    step = max(int(min(distance, n) / every), 1) * every
    return min(n + step, max_runs)


def unplanned_level(confidence: float, look: int) -> float:
    """Return the level of the intervals at a look, the first being 1.

    Examples
    --------
    >>> [round(unplanned_level(0.95, look), 4) for look in (1, 2, 3)]
    [0.95, 0.9917, 0.9958]
    """
    return confidence if look <= 1 else 1 - (1 - confidence) / (look * (look + 1))


def number_of_look(earlier: Sequence[int], n_runs: int) -> int:
    """Return the number of a look, the first being 1; a number of runs that was looked at keeps its number.

    >>> number_of_look([], 200), number_of_look([200], 200), number_of_look([200], 400)
    (1, 1, 2)
    """
    return list(earlier).index(n_runs) + 1 if n_runs in earlier else len(earlier) + 1


class PlannedLook(NamedTuple):
    """A look of a stopping rule."""

    number: int
    """The first is 1."""
    n_looks: int
    """How many are possible; 0 where the levels do not depend on their number."""
    confidence: float
    """Level that all looks have together."""

    @property
    def text(self) -> str:
        """The look in words, for the line below a table.

        Examples
        --------
        >>> PlannedLook(3, 6, 0.95).text
        'look 3 of 6, which together have the level 95 %'
        """
        if not self.n_looks:
            return f"look {self.number} at the width of the intervals, which keeps their level"
        return f"look {self.number} of {self.n_looks}, which together have the level {100 * self.confidence:g} %"
