"""Ranks of tuned methods on the runs of the experiment, and how they depend on the tuning runs and on the budget.

Rank       1 + number of methods with a smaller objective on the runs of the experiment.  Equal ones share a rank.
Runs       The tuning runs are drawn anew with replacement, the same ones for all methods and values.  Each method then
           chooses again among the values that it has tried, and the methods are ranked by their new choices.
Budget     A smaller budget takes the first values in the order in which they were tried.
Limit      The runs of the experiment stay as they are: the intervals of the comparison show their influence.  Values
           that were never tried cannot be chosen, so that the true influence of the tuning runs is larger.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.analysis.tuning import DIGITS, objectives
from rmpc_bench.types import Array
from rmpc_bench.types.tuning import TuningProtocol, TuningSearch

SETS = 200
"""Bootstrap sets of tuning runs."""
SEED = 20
"""Of the bootstrap sets, so that the same results give the same shares."""
FIRST_STAGES = ("grid", "quasi-random")


@dataclass(frozen=True, eq=False)
class TuningRanks:
    """Ranks of the methods at one point of the sweep."""

    point: str  # title of the point; empty without a sweep
    methods: tuple[str, ...]  # all ranked methods, tuned or not, in the order of the experiment
    tuned: tuple[str, ...]  # those of them that are tuned
    budgets: tuple[int, ...]  # numbers of values, ascending; the last one has all of them
    ranks: Array  # (budgets, methods) rank after each budget
    of_sets: Array  # (budgets, sets, methods) the same with bootstrap sets of tuning runs

    @property
    def same_order(self) -> float:
        """Share of the sets whose ranks are those of the tuned values."""
        return float((self.of_sets[-1] == self.ranks[-1]).all(axis=1).mean())

    @property
    def same_winner(self) -> float:
        """Share of the sets with the same methods of rank 1."""
        return float(((self.of_sets[-1] == 1) == (self.ranks[-1] == 1)).all(axis=1).mean())

    @property
    def smallest(self) -> Array:
        """Smallest rank of every method over the sets, (budgets, methods)."""
        found: Array = np.minimum(self.ranks, self.of_sets.min(axis=1))
        return found

    @property
    def largest(self) -> Array:
        """Largest rank of every method over the sets, (budgets, methods)."""
        found: Array = np.maximum(self.ranks, self.of_sets.max(axis=1))
        return found

    @property
    def changing(self) -> dict[str, list[int]]:
        """Method whose rank differs between budgets -> its ranks."""
        differ = (self.ranks != self.ranks[-1]).any(axis=0)
        return {
            name: [int(rank) for rank in self.ranks[:, place]]
            for place, name in enumerate(self.methods)
            if differ[place]
        }

    @property
    def can_change(self) -> list[str]:
        """Methods whose rank is not the same in all bootstrap sets."""
        differ = self.smallest[-1] != self.largest[-1]
        return [name for place, name in enumerate(self.methods) if differ[place]]


def tuning_ranks(
    protocol: TuningProtocol,
    searches: Sequence[TuningSearch],
    others: Mapping[str, Array],
    order: Sequence[str] = (),
) -> TuningRanks | None:
    """Rank the methods at one point of the sweep; `others` has the metric of untuned methods, NaN where a run failed.

    None below two methods, where `why_unranked` has a reason, and where no method has a finite objective.
    """
    tests = [search.test for search in searches if search.test is not None]
    if not searches or len(searches) + len(others) < 2 or why_unranked(searches):
        return None
    budgets, drawn = budgets_of(searches), _sets(searches)
    names = [*(search.method for search in searches), *others]
    places = [names.index(name) for name in dict.fromkeys([*order, *names]) if name in names]
    # The default comes last: a method keeps it where the runs give no value a finite objective.
    on_test = [objectives(protocol, test) for test in tests]
    fixed = [float(objectives(protocol, values)) for values in others.values()]
    whole, of_sets = [], []
    for budget in budgets:
        chosen = [_choice(search, budget) for search in searches]
        tuned = [float(found[index]) for found, index in zip(on_test, chosen, strict=True)]
        if not np.isfinite([*tuned, *fixed]).any():
            return None
        whole.append(ranked(np.array([*tuned, *fixed])))
        again = [found[_smallest(sets[:budget])] for found, sets in zip(on_test, drawn, strict=True)]
        of_sets.append(ranked(np.column_stack([*again, *(np.full(SETS, value) for value in fixed)])))
    return TuningRanks(
        searches[0].point,
        tuple(names[place] for place in places),
        tuple(search.method for search in searches),
        budgets,
        np.array(whole)[:, places],
        np.array(of_sets)[:, :, places],
    )


def why_unranked(searches: Sequence[TuningSearch], n_runs: int | None = None) -> str:
    """Say why methods with these searches have no ranks, beside an experiment of `n_runs` runs; empty if they have."""
    lost = [search.method for search in searches if search.chosen is None]
    if lost:
        return f"nothing could be tuned for {', '.join(lost)}"
    sizes = sorted({0 if search.test is None else search.test.shape[1] for search in searches})
    if sizes[:1] < [2] or sizes[-1] != (n_runs or sizes[0]) or len(sizes) > 1:
        of = f", which has {n_runs}" if n_runs else ""
        return f"the values were computed on {sizes[0] or 'no'} run{'s' * (sizes[0] != 1)} of the experiment{of}"
    is_one = any(search.tuning.shape[1] < 2 for search in searches)
    return "one tuning run does not show how they depend on the tuning runs" if is_one else ""


def budgets_of(searches: Sequence[TuningSearch]) -> tuple[int, ...]:
    """Return the numbers of values after which methods are ranked.

    They are those of the first stage, such as the grid, half of the rest, and all values: 9, 12 and 16 of 16.
    """
    largest = max(len(search.candidates) for search in searches)
    first = max(sum(stage in FIRST_STAGES for stage in search.stages) for search in searches)
    first = min(max(first, 1), largest)
    return tuple(sorted({first, (first + largest) // 2, largest}))


def ranked(values: Array) -> Array:
    """Return the rank of every entry along the last axis: 1 + number of smaller ones.

    >>> ranked(np.array([3.0, 1.0, 3.0, np.inf])).tolist()
    [2, 1, 2, 4]
    """
    found: Array = 1 + (values[..., None, :] < values[..., :, None]).sum(axis=-1)
    return found


def _choice(search: TuningSearch, budget: int) -> int:
    """Return the index of the value of a method after a budget: the first of equally good ones, -1 for the default."""
    if budget >= len(search.candidates) and search.chosen is not None:
        return search.chosen
    return int(_smallest(rounded(search.objectives[:budget], digits=DIGITS)))


def _smallest(values: Array) -> Array:
    """Return the index of the first smallest objective along axis 0; -1, the default, where all are infinite."""
    return np.where(np.isfinite(values).any(axis=0), np.argmin(values, axis=0), -1)


def _sets(searches: Sequence[TuningSearch]) -> list[Array]:
    """Return the objectives of every method with each bootstrap set of tuning runs, (values, sets)."""
    drawn: dict[int, Array] = {}
    found = []
    for search in searches:
        n = search.tuning.shape[1]
        if n not in drawn:
            # The same runs for all methods: differences between methods are paired.
            rng = np.random.Generator(np.random.PCG64(SEED))
            drawn[n] = rng.integers(0, n, (SETS, n))
        found.append(objectives(search.protocol, search.tuning[:, drawn[n]]))
    return found
