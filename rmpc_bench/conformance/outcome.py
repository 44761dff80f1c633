"""What a component has returned over all samples, and the checks that every kind of component has in common."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from rmpc_bench.conformance.failures import WORDS, require_no_exception, require_solved, require_valid_return_values
from rmpc_bench.conformance.results import FROZEN, Check, NotApplicableError, require, require_same
from rmpc_bench.types import Array, Journal, SolverError, Statuses

GLOBAL_STATE = "the result depends on the state of NumPy's or Python's global random generator; use `rng`"
REMAINS = "; does something remain from an earlier run, or is a random generator without a seed used?"


class Outcome(NamedTuple):
    """Answers of a component for some runs, sample by sample."""

    noun: str
    """What the numbers are: ``x_hat``, ``u``, ``x``."""
    numbers: list[Array]
    """(runs, n) numbers of every sample."""
    status: Statuses
    """First status of every run that is not `ok`."""
    journal: Journal
    error: BaseException | None
    """What a call has raised; the remaining samples are then missing."""
    returned: list[Any]
    """Everything that was returned at every sample."""
    states: list[Any]
    """States of the component after every call."""

    @property
    def values(self) -> Array:
        """Numbers of all samples, of shape (runs, samples, n)."""
        if self.error is not None:
            raise self.error
        return np.stack(self.numbers, axis=1)


class Example(Protocol):
    """Data on which a component is evaluated."""

    @property
    def n_runs(self) -> int:
        """Number of runs."""

    def evaluate(self, component: Any, rows: Sequence[int] | None = None, *, seed: int = 0) -> Outcome:
        """Evaluate the component on some runs; ``seed`` is that of the global random generators."""

    def all(self, component: Any) -> Outcome:
        """Return the numbers of all runs, computed once."""


def _no_exception(component: Any, example: Example) -> None:
    outcome = example.all(component)
    if outcome.error is not None and not isinstance(outcome.error, SolverError):
        raise outcome.error
    require_no_exception(outcome.status, outcome.journal)


def _solved(component: Any, example: Example) -> None:
    outcome = example.all(component)
    if outcome.error is not None:
        raise outcome.error
    require_solved(outcome.status, outcome.journal)


def _finite(component: Any, example: Example) -> None:
    outcome = example.all(component)
    require_valid_return_values(outcome.journal, "finite")
    for k, numbers in enumerate(outcome.numbers):
        wrong = np.asarray(~np.isfinite(numbers).all(axis=1))
        require(not wrong.any(), f"{outcome.noun} of {wrong.sum()} of {len(wrong)} runs is not finite at k = {k}")
    for status in outcome.status[outcome.status.astype(bool)]:
        raise AssertionError(f"the status of a run is {WORDS[int(status)]}")


def first_checks(base_class: Check, shapes: Callable[[Any, Any], None], says: str) -> tuple[Check, ...]:
    """Return the checks that come first: where one fails, the others make no sense.

    Parameters
    ----------
    base_class : check of the class
    shapes : check of the shapes
    says : its rule
    """
    return (
        base_class,
        Check("no-exception", "every call returns without an exception", _no_exception, is_first=True),
        Check("solved", "the problem of every sample is solved (no `SolverError`)", _solved, is_first=True),
        Check("shapes", says, shapes, is_first=True),
        Check("finite", "every number is finite, and every status is ok", _finite, is_first=True),
        FROZEN,
    )


def _repeated(component: Any, example: Example) -> None:
    rows = range(min(5, example.n_runs))
    first = example.all(component)
    try:
        require_same(
            f"{first.noun} of the second time", example.evaluate(component, rows).values, first.values[: len(rows)]
        )
    except AssertionError as error:
        raise AssertionError(f"{error}{REMAINS}") from None


def _random_state(component: Any, example: Example) -> None:
    rows = range(min(5, example.n_runs))
    once, twice, other = (example.evaluate(component, rows, seed=seed).values for seed in (0, 0, 1))
    if not np.array_equal(once, twice, equal_nan=True):
        raise NotApplicableError("the same data give other numbers, see `repeated`")
    require(np.array_equal(twice, other, equal_nan=True), GLOBAL_STATE)


def _alone(component: Any, example: Example) -> None:
    together = example.evaluate(component)
    for run in range(example.n_runs):
        alone = example.evaluate(component, [run]).values
        require_same(f"{together.noun} of run {run} alone", alone, together.values[run : run + 1])


def _order(component: Any, example: Example) -> None:
    order = np.random.default_rng(5).permutation(example.n_runs).tolist()
    together = example.evaluate(component)
    found = example.evaluate(component, order).values
    require_same(f"{together.noun} in another order", found, together.values[order])


def _pickle(component: Any, example: Example) -> None:
    copy, expected = pickle.loads(pickle.dumps(component)), example.evaluate(component)
    require_same(f"{expected.noun} of the copy", example.evaluate(copy).values, expected.values)


REPETITION: tuple[Check, ...] = (
    Check("repeated", "the same runs a second time give the same bits", _repeated),
    Check("random-state", "no global random generator is used", _random_state),
    Check("batch-independence", "a run gives the same bits alone and inside any block", _alone),
    Check("order", "permuting the runs permutes the results, bit for bit", _order),
    Check("pickle", "a copy made by pickle gives the same bits", _pickle, "information"),
)
"""Checks of the independence of runs from everything but their data."""


def refuse_objects(component: Any, state: Any) -> None:
    """Leave a check of single calls out for a component whose state is not a tuple of arrays.

    Raises
    ------
    NotApplicableError
        If the component is written for one run.
    """
    arrays = isinstance(state, tuple) and all(isinstance(array, np.ndarray) for array in state)
    if component.starts_runs and not arrays:
        raise NotApplicableError("a component written for one run may have a memory and gets copies of all arrays")
