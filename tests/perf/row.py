"""A row of the table: a piece of work done by this package and by a baseline, each in a process of its own."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import NamedTuple

SHORTEST = 0.05
"""Least time of a round [s]."""
LONGEST = 3.0
"""Time of a round after which no further one is measured [s]."""


def cpu():
    """Return the time of this process and of those that it has waited for [s]."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


class Row(NamedTuple):
    """A piece of work.

    `ours` and `baseline` prepare it and return a function without arguments, which is measured, and how many units of
    the work a call of it does.  What both functions return is compared: numbers, or None where there are none.
    """

    name: str
    unit: str
    ours: Callable[[], tuple[Callable[[], object], float]]
    baseline: Callable[[], tuple[Callable[[], object], float]] | None
    """None where this machine cannot compute it; `beside` says why."""
    beside: str
    """What the baseline is, in words."""
    tolerance: float = 1e-6
    """Largest difference of the numbers of both sides, relative to the largest of them."""
    clock: Callable[[], float] = cpu
    """What measures time [s]."""


def measured(prepare, clock=cpu, rounds=3):
    """Return the least time of a unit of the work [s] and what the work returns, after one call that does not count."""
    work, units = prepare()
    result = work()
    best = float("inf")
    for _ in range(rounds):
        before, calls = clock(), 0
        # Short work is repeated, since the clock of child processes ticks a hundred times a second.
        while not calls or clock() - before < SHORTEST:
            work()
            calls += 1
        best = min(best, (clock() - before) / calls)
        if best > LONGEST:
            break
    return max(best, 1e-9) / units, result
