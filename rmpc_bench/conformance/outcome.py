"""What a component returns for the runs of an example, and the checks that every kind of component has in common."""

from __future__ import annotations

import pickle
import random
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np

from rmpc_bench.conformance.results import FROZEN, Check, NotApplicableError, require, require_same
from rmpc_bench.simulation.run_start import RunStart, RunState
from rmpc_bench.types import Array, Journal, RunFailure, SolverError, Status, Statuses

SEED = 16
"""Of the random generators that components get."""
UNSOLVED = (Status.NOT_CONVERGED, Status.INFEASIBLE)
"""Statuses of a run in which a component raised `SolverError`."""
WORDS = {int(status): status.word for status in Status}
"""Number of a status -> its word."""
NOT_FINITE = re.compile(r"\b(nan|inf|infinite|finite|not a number)\b", re.IGNORECASE)
"""Words of a message about a return value that is not finite."""


@contextmanager
def global_seed(seed: int) -> Iterator[None]:
    """Seed the global random generators of Python and NumPy, and restore them at the end."""
    numpy_state, python_state = np.random.get_state(), random.getstate()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002  # the generator that a component must not use
    random.seed(seed)
    try:
        yield
    finally:
        np.random.set_state(numpy_state)  # noqa: NPY002
        random.setstate(python_state)


@dataclass(eq=False)
class Outcome:
    """Answers of a component for some runs, sample by sample."""

    noun: str  # what the numbers are: ``x_hat``, ``u``, ``(x, y)``
    rows: list[int]  # indices of the runs in the example
    numbers: list[Array] = field(default_factory=list)  # (runs, n) numbers of every sample
    returned: list[Any] = field(default_factory=list)  # everything that was returned at every sample
    states: list[Any] = field(default_factory=list)  # states of the component after every call
    error: BaseException | None = None  # what a call has raised; the remaining samples are then missing
    k: int = -1  # the sample that was begun last; see `samples`

    def __post_init__(self) -> None:
        self.journal, self.shared = Journal(), RunState.of(len(self.rows))
        self.status: Statuses = np.zeros(len(self.rows), np.int8)
        """First status of every run that is not `ok`."""

    @property
    def start(self) -> RunStart:
        """What components that start runs get."""
        return RunStart(SEED, tuple(self.rows), self.journal)

    def samples(self, n: int) -> Iterator[int]:
        """Return 0..n-1, and remember where an exception comes from."""
        for k in range(n):
            self.k = k
            yield k

    def add_status(self, status: Statuses) -> None:
        """Keep the first status of every run that is not `ok`, and tell the component which runs go on."""
        self.status[:] = np.where(self.status != Status.OK, self.status, status)
        self.shared.after(self.status)

    @property
    def values(self) -> Array:
        """Numbers of all samples, of shape (runs, samples, n)."""
        if self.error is not None:
            raise self.error
        return np.stack(self.numbers, axis=1)


@dataclass(frozen=True, eq=False)
class RunsExample(ABC):
    """Data of some runs that a component is called with, sample by sample."""

    known: dict[int, tuple[Any, Outcome]] = field(default_factory=dict, repr=False, kw_only=True)
    """Outcome of the whole example by component, computed once for each of them."""
    noun: ClassVar[str]
    checks: ClassVar[tuple[Check, ...]]

    @property
    @abstractmethod
    def n_runs(self) -> int:
        """Number of runs."""

    @abstractmethod
    def start(self, component: Any, outcome: Outcome) -> Any:
        """State of some runs before the first sample."""

    @abstractmethod
    def call(self, component: Any, outcome: Outcome) -> None:
        """Call the component for all samples of the outcome's runs, and keep what it returns."""

    def outcome(self, rows: Sequence[int] | None = None) -> Outcome:
        """Return the outcome of some runs, or of all, before the first sample."""
        return Outcome(self.noun, list(range(self.n_runs) if rows is None else rows))

    def evaluate(self, component: Any, rows: Sequence[int] | None = None, *, seed: int = 0) -> Outcome:
        """Call the component for some runs (all unless given); an exception ends them.

        `seed` is that of the global random generators, which a component must not use.
        """
        outcome = self.outcome(rows)
        # As in the simulation, in which failed runs may overflow.
        with global_seed(seed), np.errstate(over="ignore", invalid="ignore"):
            try:
                self.call(component, outcome)
            except (Exception, SystemExit) as error:  # a component under test may raise anything
                error.add_note(f"k = {outcome.k}" if outcome.k >= 0 else "before the first sample")
                outcome.error = error
        return outcome

    def all(self, component: Any) -> Outcome:
        """Evaluate the whole example; computed once per component."""
        if id(component) not in self.known:
            self.known[id(component)] = component, self.evaluate(component)
        return self.known[id(component)][1]

    def results(self, component: Any) -> Array:
        """Numbers of all runs."""
        return self.evaluate(component).values

    def changed(self, **data: Any) -> Self:
        """The example with other data."""
        return replace(self, known={}, **data)

    def begun(self, component: Any) -> Any:
        """State of all runs before the first sample; refused if written for one run (no tuple of arrays)."""
        state = self.start(component, self.outcome())
        arrays = isinstance(state, tuple) and all(isinstance(array, np.ndarray) for array in state)
        if component.starts_runs and not arrays:
            raise NotApplicableError("a component written for one run may have a memory and gets copies of all arrays")
        return state


def _no_exception(component: Any, example: RunsExample) -> None:
    outcome = example.all(component)
    if outcome.error is not None and not isinstance(outcome.error, SolverError):
        raise outcome.error
    failures, status = outcome.journal.failures.values(), outcome.status
    _refuse([each for each in failures if each.trace and each.status not in UNSOLVED], len(status))
    crashed = np.isin(status, (Status.CRASHED, Status.TIMEOUT))
    require(bool(failures) or not crashed.any(), f"{crashed.sum()} of {len(status)} runs have crashed")


def _solved(component: Any, example: RunsExample) -> None:
    outcome = example.all(component)
    if outcome.error is not None:
        raise outcome.error
    journal, status = outcome.journal, outcome.status
    _refuse([each for each in journal.failures.values() if each.status in UNSOLVED], len(status))
    unsolved = np.isin(status, UNSOLVED)
    if unsolved.any():
        word = WORDS[int(status[unsolved][0])]
        raise AssertionError(f"{unsolved.sum()} of {len(status)} runs end with the status {word}")
    held = sum(journal.held.values())
    require(held == 0, f"{held} steps in {len(journal.held)} of {len(status)} runs were held")


def _finite(component: Any, example: RunsExample) -> None:
    outcome = example.all(component)
    require_valid_return_values(outcome.journal, "finite")
    for k, numbers in enumerate(outcome.numbers):
        wrong = np.asarray(~np.isfinite(numbers).all(axis=1))
        require(not wrong.any(), f"{outcome.noun} of {wrong.sum()} of {len(wrong)} runs is not finite at k = {k}")
    for status in outcome.status[outcome.status.astype(bool)]:
        raise AssertionError(f"the status of a run is {WORDS[int(status)]}")


def require_valid_return_values(journal: Journal, kind: str) -> None:
    """Fail if a single-run component has returned a value that is not ``finite``, or for ``shape`` any other one."""
    wrong = [each for each in journal.failures.values() if not each.trace and each.status not in UNSOLVED]
    _refuse([each for each in wrong if bool(NOT_FINITE.search(each.message)) == (kind == "finite")], None)


def _refuse(failures: Collection[RunFailure], n_runs: int | None) -> None:
    """Fail the running check with the first failure and the number of failed runs, if there are some."""
    if not failures:
        return
    first = min(failures, key=lambda each: (each.k if each.k is not None else -1, each.run))
    known = "" if first.k is None or "k = " in first.message else f" at k = {first.k}"
    shares = "" if n_runs is None else f" ({len(failures)} of {n_runs} runs fail)"
    lines = [line.strip() for line in first.trace.splitlines() if line.strip().startswith("File ")]
    place = f" in {lines[-1].removeprefix('File ')}" if lines else ""
    raise AssertionError(f"run {first.run}{known}: {first.message}{place}{shares}")


def first_checks(base_class: Check, shapes: Callable[[Any, Any], None], says: str) -> tuple[Check, ...]:
    """Return the checks that come first: where one fails, the others make no sense; `says` is the rule of `shapes`."""
    return (
        base_class,
        Check("no-exception", "every call returns without an exception", _no_exception, is_first=True),
        Check("solved", "the problem of every sample is solved (no `SolverError`)", _solved, is_first=True),
        Check("shapes", says, shapes, is_first=True),
        Check("finite", "every number is finite, and every status is ok", _finite, is_first=True),
        FROZEN,
    )


def _repeated(component: Any, example: RunsExample) -> None:
    rows = range(min(5, example.n_runs))
    first = example.all(component)
    try:
        again = example.evaluate(component, rows).values
        require_same(f"{example.noun} of the second time", again, first.values[: len(rows)])
    except AssertionError as error:
        cause = "does something remain from an earlier run, or is a random generator without a seed used?"
        raise AssertionError(f"{error}; {cause}") from None


def _random_state(component: Any, example: RunsExample) -> None:
    rows = range(min(5, example.n_runs))
    once, twice, other = (example.evaluate(component, rows, seed=seed).values for seed in (0, 0, 1))
    if not np.array_equal(once, twice, equal_nan=True):
        raise NotApplicableError("the same data give other numbers, see `repeated`")
    text = "the result depends on the state of NumPy's or Python's global random generator; use `rng`"
    require(np.array_equal(twice, other, equal_nan=True), text)


def _alone(component: Any, example: RunsExample) -> None:
    together = example.results(component)
    for run in range(example.n_runs):
        alone = example.evaluate(component, [run]).values
        require_same(f"{example.noun} of run {run} alone", alone, together[run : run + 1])


def _order(component: Any, example: RunsExample) -> None:
    order = np.random.default_rng(5).permutation(example.n_runs).tolist()
    together, found = example.results(component), example.evaluate(component, order).values
    require_same(f"{example.noun} in another order", found, together[order])


def _pickle(component: Any, example: RunsExample) -> None:
    copy = pickle.loads(pickle.dumps(component))
    require_same(f"{example.noun} of the copy", example.results(copy), example.results(component))


REPETITION: tuple[Check, ...] = (
    Check("repeated", "the same runs a second time give the same bits", _repeated),
    Check("random-state", "no global random generator is used", _random_state),
    Check("batch-independence", "a run gives the same bits alone and inside any block", _alone),
    Check("order", "permuting the runs permutes the results, bit for bit", _order),
    Check("pickle", "a copy made by pickle gives the same bits", _pickle, "information"),
)
"""Checks of the independence of runs from everything but their data."""
