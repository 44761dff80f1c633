"""The user's objects of a block, one per run; calls of their methods fail their own run, and answers are checked."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy, deepcopy
from itertools import repeat
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.components.user_class import UserClass
from rmpc_bench.components.user_code import one_line, user_trace
from rmpc_bench.types import (
    NO_WATCH,
    Array,
    InvalidReturnValue,
    OutOfRange,
    PassedOn,
    RunFailure,
    RunInfo,
    SolverError,
    Status,
    TimeLimit,
)

_SYMMETRY = 1e-8
"""Largest difference of P from its transpose, relative to its largest entry; rounding leaves about 1e-15."""


def numbers(value: Any, noun: str, shape: tuple[int, ...], owner: str) -> Array:
    """Return an answer as an array of a shape; InvalidReturnValue for another shape or what is no real number."""
    if value is None:
        raise InvalidReturnValue(f"returned nothing; {owner} has {_counted(shape, noun)}")
    try:
        array = np.asarray(value)
    except ValueError:
        raise InvalidReturnValue(f"returned lists of different lengths; {owner} has {_counted(shape, noun)}") from None
    if array.dtype.kind not in "fiu":
        raise InvalidReturnValue(f"returned entries of type {_type_name(array)}; real numbers are expected")
    if array.shape == shape or (array.ndim == 0 and all(n == 1 for n in shape)):
        return array
    raise InvalidReturnValue(f"returned {_given(array)}; {owner} has {_counted(shape, noun)}")


def _type_name(array: Array) -> str:
    if array.dtype == object:
        return next((type(each).__name__ for each in array.flat if not isinstance(each, int | float)), "object")
    return str(array.dtype)


def _counted(shape: tuple[int, ...], noun: str) -> str:
    n = shape[-1]
    text = f"{n} {noun}{'' if n == 1 else 's'}"
    return text if len(shape) == 1 else f"{text}, so that it is {' x '.join(map(str, shape))}"


def _given(array: Array) -> str:
    if array.ndim == 0:
        return "a number"
    if array.ndim == 1:
        return f"{len(array)} number{'' if len(array) == 1 else 's'}"
    return f"an array of shape {array.shape}"


def finite_rows(values: Array) -> Array:
    """Whether all entries of a row are finite, for every row."""
    return np.asarray(np.isfinite(values).all(axis=tuple(range(1, values.ndim))))


def asymmetric_rows(P: Array) -> Array:
    """Whether the matrix of a row is not symmetric, for every row; NaN counts as symmetric."""
    scale = np.abs(P).max(axis=(1, 2), initial=0.0)
    return np.asarray(np.abs(P - P.swapaxes(1, 2)).max(axis=(1, 2), initial=0.0) > _SYMMETRY * scale)


class Reports:
    """Entries of given shapes that a component reports besides its main answer, one array per entry and sample."""

    def __init__(self, declared: Mapping[str, tuple[int, ...]] | Iterable[str]) -> None:
        # A list of names stands for single numbers.
        shapes = declared if isinstance(declared, Mapping) else dict.fromkeys(declared, ())
        self.shapes = {name: tuple(shape) for name, shape in shapes.items()}

    def empty(self, n_runs: int) -> dict[str, Array]:
        """Return arrays of NaN, which stand for an entry that a run does not report."""
        return {name: np.full((n_runs, *shape), np.nan) for name, shape in self.shapes.items()}

    def keep(self, row: int, given: Any, info: Mapping[str, Array]) -> None:
        """Copy what one run reports; InvalidReturnValue for an entry that is not declared or has another shape."""
        if not isinstance(given, Mapping):
            found = type(given).__name__
            raise InvalidReturnValue(f"returned a {found} as its last entry; a mapping name -> number is expected")
        for name, value in given.items():
            if name not in self.shapes:
                known = ", ".join(self.shapes) or "nothing"
                raise InvalidReturnValue(f"reports {name!r}, which `reports` of the class does not name ({known})")
            array = np.asarray(value)
            if array.dtype.kind not in "fiub" or array.shape != self.shapes[name]:
                raise InvalidReturnValue(
                    f"reports {name!r} with shape {array.shape}; `reports` names {self.shapes[name]}"
                )
            info[name][row] = array


def drawing_from(rng: np.random.Generator, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function whose draws from NumPy's global generator come from another one.

    The state of the global generator stays as it is, apart from a normal number that it may have drawn in advance.

    Examples
    --------
    >>> drawing_from(np.random.default_rng(1), np.random.uniform)() == np.random.default_rng(1).uniform()
    True
    """

    def call(*arguments: Any, **keywords: Any) -> Any:
        before = np.random.get_bit_generator()  # type: ignore[attr-defined]  # noqa: NPY002
        np.random.set_bit_generator(rng.bit_generator)  # type: ignore[attr-defined]  # noqa: NPY002
        try:
            return function(*arguments, **keywords)
        finally:
            np.random.set_bit_generator(before)  # type: ignore[attr-defined]  # noqa: NPY002

    return call


OK = int(Status.OK)
CRASHED, TIMEOUT = int(Status.CRASHED), int(Status.TIMEOUT)
BEFORE = "before "
"""Begin of the name of a signal of the sample before."""
JOINED = f"{BEFORE}correct"
"""A call of `predict` for the sample before and of `correct`."""


class Failed(NamedTuple):
    """A failed call of one run."""

    row: int
    status: int
    message: str
    trace: str


class UserRuns:
    """The objects of the runs of a block; `fixed` has what is the same for all runs by its standard name."""

    def __init__(self, role: str, user: UserClass, runs: RunInfo, fixed: Mapping[str, Any], Ts: float) -> None:
        self.role, self.user, self.runs, self.fixed, self.Ts = role, user, runs, fixed, Ts
        n_runs = len(runs.index)
        self.n_runs = n_runs
        self.failed = np.zeros(n_runs, dtype=np.int8)
        """First failure of every run in this component; 0 is OK."""
        self.held = np.zeros(n_runs, dtype=int)
        self.used = [0.0] * n_runs
        """Time that the calls for every run have taken [s]."""
        self.bound: dict[str, list[Any]] = {}
        self.names: dict[str, tuple[str, ...]] = {}
        self.everyone = list(range(n_runs))
        self.made: list[Any] = [None] * n_runs
        """The object of every run; None where it could not be made."""

    def make(self, keys: Mapping[str, Any], signals: Mapping[str, Any]) -> None:
        """Make the object of every run with the keys, and call its `start`; `signals` has one entry per run."""
        names = tuple(name for name in self.user.of_init.names if name not in keys)

        def make(*values: Any) -> Any:
            return self.user.cls(**dict(zip(names, values, strict=True)), **_own(dict(keys)))

        self.bound["__init__"], self.names["__init__"] = [make] * self.n_runs, names
        self.call("__init__", None, signals, self.made.__setitem__, phase="start")
        self._bind()
        if "start" in self.bound:
            self.call("start", None, signals, lambda row, answer: None, phase="start")

    def _bind(self) -> None:
        """Find the methods of every object."""
        for name, arguments in self.user.arguments.items():
            if name != "prepare":
                bound = [None if each is None else arguments.bind(getattr(each, name)) for each in self.made]
                self.bound[name], self.names[name] = bound, arguments.names
        if "predict" in self.bound:
            self._join("predict", "correct")

    def copied(self) -> UserRuns:
        """Return these runs with copies of their objects; a run whose object cannot be copied fails."""
        other, shared = copy(self), {id(each): each for each in self.fixed.values()}
        other.bound, other.made = dict(self.bound), list(self.made)
        for row in self.rows():
            try:
                other.made[row] = deepcopy(self.made[row], dict(shared))
            except Exception as error:
                message = f"late measurements need a copy of the object: {one_line(error)}"
                self.fail(Failed(row, CRASHED, message, user_trace(error)), None, {})
        other._bind()
        return other

    def _join(self, first: str, second: str) -> None:
        """Add a call of two methods of which the first gets the input, the index and the time of the sample before."""
        n = len(self.names[first])

        def joined(before: Callable[..., Any], after: Callable[..., Any]) -> Callable[..., Any]:
            def both(*values: Any) -> Any:
                before(*values[:n])
                return after(*values[n:])

            return both

        pairs = zip(self.bound[first], self.bound[second], strict=True)
        self.bound[JOINED] = [None if before is None else joined(before, after) for before, after in pairs]
        earlier = (f"{BEFORE}{name}" if name in ("u", "k", "t") else name for name in self.names[first])
        self.names[JOINED] = (*earlier, *self.names[second])

    def rows(self) -> list[int]:
        """Rows of the runs that have not failed, here or in another component."""
        alive = self.runs.alive & (self.failed == OK)
        return self.everyone if alive.all() else np.flatnonzero(alive).tolist()

    def call(
        self,
        method: str,
        k: int | None,
        signals: Mapping[str, Any],
        keep: Callable[[int, Any], None],
        *,
        phase: str = "",
        settle: Callable[[Failed], bool] | None = None,
    ) -> None:
        """Call a method of every run that has not failed.

        A signal has axis 0 = run or is a list with one entry per run.  `keep` stores the answer of a row and raises
        `InvalidReturnValue`; `settle` replaces the answer of a failed call if the step can be held, and says whether.
        `k` is None before the first sample.
        """
        # Where `prepare` has failed there are no objects.
        if method not in self.bound:
            return
        durations: list[float] = []
        failures = self._failures(method, k, self._arguments(self.names[method], k, signals), keep, durations)
        first = k == 0 and not phase
        name = f"{self.role}, {phase}" if phase else f"{self.role}, first step" if first else self.role
        self.runs.journal.seconds.setdefault(name, []).extend(durations)
        for failure in failures:
            self.fail(failure, k, signals, settle)

    def _failures(
        self, method: str, k: int | None, given: Any, keep: Callable[[int, Any], None], durations: list[float]
    ) -> list[Failed]:
        """Call the method of every given row with its arguments, add the durations, and return what has failed."""
        calls, failures = self.bound[method], list[Failed]()
        if (by := self.runs.journal.call) is not None:
            calls = [each and (lambda *values, each=each: by(self.role, k, each, values)) for each in calls]
        watch, index = self.runs.watch, self.runs.index
        with self.runs.journal.user_code():
            for row, values in given:
                if watch is not NO_WATCH:
                    watch.call(index[row], k, self.used[row])
                start = perf_counter()
                try:
                    answer = calls[row](*values)
                except BaseException as error:
                    # The other runs of the block may have used the memory: this run is repeated alone.
                    if is_ctrl_c(error) or isinstance(error, MemoryError | PassedOn):
                        raise
                    durations.append(perf_counter() - start)
                    failures.append(failed_call(row, error))
                    continue
                durations.append(perf_counter() - start)
                self.used[row] += durations[-1]
                if watch.stopped:
                    # The component has caught the exception; what it returns depends on the speed of the machine.
                    failures.append(Failed(row, TIMEOUT, watch.stopped, ""))
                    continue
                try:
                    keep(row, answer)
                except InvalidReturnValue as error:
                    failures.append(Failed(row, CRASHED, f"{method.removeprefix(BEFORE)} {error}{at(k)}", ""))
        return failures

    def _arguments(self, names: Sequence[str], k: int | None, signals: Mapping[str, Any]) -> Any:
        """Return the rows of the runs that have not failed, each with its arguments."""
        rows = self.rows()
        columns = [self._column(name, k, signals) for name in names]
        if rows is not self.everyone:
            columns = [column if isinstance(column, repeat) else [column[row] for row in rows] for column in columns]
        return zip(rows, zip(*columns, strict=False) if names else repeat(()), strict=False)

    def _column(self, name: str, k: int | None, signals: Mapping[str, Any]) -> Any:
        """Return the values of an argument for every run, each its own copy."""
        if name in signals:
            values = signals[name]
            if values is None:
                return repeat(None)
            # The rows of a fresh copy: what a run writes into its row no other run sees.
            return list(values.copy()) if isinstance(values, np.ndarray) else values
        if name in ("k", "t", f"{BEFORE}k", f"{BEFORE}t"):
            sample = k if k is None or not name.startswith(BEFORE) else k - 1
            return repeat(sample if sample is None or name[-1] == "k" else sample * self.Ts)
        if name == "rng":
            return self.runs.rngs
        if name == "run":
            return self.runs.index
        value = self.fixed[name]
        return [value.copy() for _ in self.everyone] if isinstance(value, np.ndarray) else repeat(value)

    def fail(
        self, failure: Failed, k: int | None, signals: Mapping[str, Any], settle: Callable[[Failed], bool] | None = None
    ) -> None:
        """Hold the step of a failed call, or end its run."""
        row, journal = failure.row, self.runs.journal
        # A step that took too long is not held: the numbers of a run do not depend on the speed of the machine.
        if settle is not None and failure.status != TIMEOUT and settle(failure):
            self.held[row] += 1
            journal.held[self.runs.index[row]] += 1
            journal.warnings[f"{self.role}: a step was held: {failure.message.removesuffix(at(k))}"] += 1
            return
        self.failed[row] = failure.status
        values = {name: _plain(each, row) for name, each in signals.items() if not name.startswith(BEFORE)}
        values = {name: value for name, value in values.items() if value is not None}
        run = self.runs.index[row]
        journal.fail(RunFailure(run, failure.status, self.role, k, failure.message, failure.trace, values))

    def refuse(
        self,
        wrong: Array,
        message: str,
        k: int,
        signals: Mapping[str, Any],
        settle: Callable[[Failed], bool] | None = None,
    ) -> None:
        """Fail the rows whose answers have wrong numbers."""
        for row in np.flatnonzero(wrong):
            self.fail(Failed(int(row), CRASHED, f"{message}{at(k)}", ""), k, signals, settle)

    def report(self) -> None:
        """Report the failures outside of an answer, after `init`, `start` or `output`."""
        news = (self.failed != OK) & (self.runs.failed == OK)
        self.runs.failed[news] = self.failed[news]


def is_ctrl_c(error: BaseException) -> bool:
    """Whether an exception is a Ctrl-C and not one that a user's code raises; a worker process gets no Ctrl-C."""
    return isinstance(error, KeyboardInterrupt) and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


def failed_call(row: int, error: BaseException) -> Failed:
    """Return the failure that follows from an exception."""
    if isinstance(error, SolverError):
        status = Status.INFEASIBLE if error.infeasible else Status.NOT_CONVERGED
    elif isinstance(error, OutOfRange):
        return Failed(row, int(Status.OUT_OF_RANGE), str(error), "")
    elif isinstance(error, TimeLimit):
        return Failed(row, int(Status.TIMEOUT), str(error), user_trace(error))
    else:
        status = Status.CRASHED
    return Failed(row, int(status), one_line(error), user_trace(error))


def at(k: int | None) -> str:
    """Return the time index for the end of a sentence."""
    return "" if k is None else f" (k = {k})"


def _own(value: Any) -> Any:
    """Return a value of a key with its own arrays and lists."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if type(value) is list:
        return [_own(each) for each in value]
    return {name: _own(each) for name, each in value.items()} if type(value) is dict else value


def _plain(values: Any, row: int) -> Any:
    """Return the entry of a run as plain data; None where it has no such form."""
    try:
        value = values[row]
        value = dict(value) if hasattr(value, "keys") else value
        if isinstance(value, dict):
            return {str(name): float(each) for name, each in value.items()}
        return np.asarray(value, dtype=float).tolist()
    except (TypeError, ValueError, KeyError, IndexError):
        return None
