"""Looking more than once at a growing number of runs: schedule of looks and level of the intervals at each.

A verdict that is repeated with more runs until it is decided has several chances to be wrong.

Planned looks, of which there are at most K: each interval has the level 1 - alpha/K, so that all looks together are
wrong in at most alpha of the experiments (Bonferroni).

Unplanned looks, where a user raises the number of runs after a verdict was printed: the number of further looks is
unknown, and the first one has used alpha already.  Look k > 1 gets alpha / (k (k + 1)); their sum over all k > 1 is
alpha / 2.  All looks together are thus wrong in at most 1.5 alpha of the experiments, however often a user looks.  As
they share their runs it is less: 6.1 % for alpha = 5 % and eight doublings by simulation, against 25 % with alpha at
every look.
"""

from __future__ import annotations

from collections.abc import Sequence


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

    Parameters
    ----------
    earlier : numbers of runs at which verdicts were published, in this order
    n_runs : number of runs now

    Examples
    --------
    >>> number_of_look([], 200), number_of_look([200], 200), number_of_look([200], 400)
    (1, 1, 2)
    """
    return list(earlier).index(n_runs) + 1 if n_runs in earlier else len(earlier) + 1
