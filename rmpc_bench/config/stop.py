"""The section `stop`: an experiment whose number of runs follows from its results.

It belongs neither to the experiment hash nor to the trials: it chooses how many runs are computed, not their numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt

from rmpc_bench.types import Count

EVERY = 50  # runs between two looks at the width of the intervals, where `every` is not given


@dataclass(frozen=True)
class StopKeys:
    """Rule that ends an experiment before its largest number of runs; give either `resolve` or `decide`.

    The results are those of runs 0 to n-1 at the look that ends it.  The exit code is 4 if the rule is not met with
    `max_runs`.  With `--runs` or `--smoke` there is no rule.

    Parameters
    ----------
    max_runs : largest number of runs
    min_runs : number of runs at the first look; that of `runs` if not given
    resolve : stop when the paired change of the primary metric is known to this relative half width, such as 2%, for
        all methods and all points of a sweep
    decide : `claims` stops when no claim is inconclusive; looks are at `min_runs` times powers of 2 and at `max_runs`
    every : looks of `resolve` follow each other after this number of runs or a multiple of it, as the width is far from
        the one that is asked for or close to it; 50 if not given
    """

    max_runs: Annotated[int, Ge(1), Le(10_000_000)]
    min_runs: Count | None = None
    resolve: Annotated[float, Gt(0), Lt(1)] | None = None
    decide: Literal["claims"] | None = None
    every: Count | None = None

    def __post_init__(self) -> None:
        """Refuse no rule, two rules, and looks of another rule."""
        if (self.resolve is None) == (self.decide is None):
            raise ValueError("give either resolve (a relative half width) or decide (claims)")
        if self.decide is not None and self.every is not None:
            raise ValueError("every belongs to resolve; decide looks at min_runs times powers of 2")

    @property
    def first_look(self) -> int:
        """Number of runs at the first look, of a rule whose defaults are filled in."""
        return self.min_runs or self.max_runs

    @property
    def text(self) -> str:
        """The rule as the section writes it."""
        return f"decide: {self.decide}" if self.resolve is None else f"resolve: {100 * self.resolve:g} %"
