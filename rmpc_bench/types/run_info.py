"""What a component may know of the runs of a block, and the record of what happened in them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np
from jaxtyping import Bool, Int8

from rmpc_bench.types.basics import Array


class RunFailure(NamedTuple):
    """Why a run has failed, as text and plain data, since it is stored and shown without any code."""

    run: int
    status: int  # number of a `Status`
    component: str  # ``estimator``, ``controller``, ``plant`` or ``metric``; empty where it is not known
    k: int | None  # sample at which it happened; None where it is not known
    message: str  # one line, such as ``ValueError: negative level``
    trace: str = ""  # frames of the user's code, as a traceback shows them; empty where there are none
    values: Mapping[str, Any] = {}  # name -> numbers in nested lists: y, u_previous, x_hat, parameters of the run


class PassedOn(BaseException):
    """An exception of a component that `Journal.call` raises to end the simulation, in place of a failed run."""

    def __init__(self, error: BaseException) -> None:
        self.error = error
        super().__init__(str(error))


def passed_on(role: str, k: int | None, function: Callable[..., Any], values: Sequence[Any]) -> Any:
    """Call a method of a component for `Journal.call`, so that its exception ends the simulation."""
    try:
        return function(*values)
    except Exception as error:
        raise PassedOn(error) from error


@dataclass
class Journal:
    """What happened in the runs of a block besides their numbers."""

    failures: dict[int, RunFailure] = field(default_factory=dict)  # run -> its first failure
    held: Counter[int] = field(default_factory=Counter)  # run -> number of held steps
    # run and number of a `Status` -> number of steps whose optimisation failed, and whose run went on
    failed_steps: Counter[tuple[int, int]] = field(default_factory=Counter)
    # component and phase, such as ``estimator`` or ``estimator, first step`` -> durations of its calls [s]; phase
    # ``block`` is the time per run and step of calls for all runs of a block
    seconds: dict[str, list[float]] = field(default_factory=dict)
    # text of a warning of a component -> how often it was given
    warnings: Counter[str] = field(default_factory=Counter)
    # calls the methods of components written for one run in place of the bench, for a debugger
    call: Callable[..., Any] | None = None

    def fail(self, failure: RunFailure) -> None:
        """Note a failure; the first one of a run counts."""
        self.failures.setdefault(failure.run, failure)

    @contextmanager
    def user_code(self, *, floating: bool = True) -> Iterator[None]:
        """Run a user's code with NumPy's own settings, and count its warnings instead of printing them."""
        on: Literal["warn", "ignore"] = "warn" if floating else "ignore"
        with np.errstate(divide=on, over=on, under="ignore", invalid=on), catch_warnings(record=True) as caught:
            simplefilter("always")
            yield
        for each in caught:
            # Not `pathlib`: below `config` nothing touches files.
            place = f"{each.filename.replace(chr(92), '/').rpartition('/')[2]}:{each.lineno}"
            self.warnings[f"{each.category.__name__}: {each.message} ({place})"] += 1


class Watch:
    """Notes what a process is computing, for the time limits; this one notes nothing."""

    stopped: str = ""
    """Which limit of time has ended the call that runs now; empty where none has, or where another call has begun."""

    has_limits: bool = False
    """Whether a step or a run has a limit of time."""

    def start(self, n_runs: int) -> None:
        """Note that the simulation of a block of runs begins."""

    def step(self, k: int) -> None:
        """Note that the control period k of a block begins."""

    def call(self, run: int, k: int | None, used: float) -> None:
        """Note that a call for one run begins; `used`: time of its earlier calls [s]; no k before the first."""

    def end(self) -> None:
        """Note that the simulation of the block has ended."""


NO_WATCH = Watch()


@dataclass(frozen=True)
class RunInfo:
    """The runs of a block, for a component with the capability `starts_runs`."""

    index: tuple[int, ...]
    """Indices of the runs."""
    rngs: tuple[np.random.Generator, ...]
    """A random generator of its own for every run; it depends on the seed, the run and the role of the component."""
    alive: Bool[Array, " runs"]
    """Whether a run has not failed; the simulation updates it in place."""
    journal: Journal
    """Where the component notes failures, held steps, durations and warnings."""
    failed: Int8[Array, " runs"] = field(default_factory=lambda: np.zeros(0, dtype=np.int8))
    """Status of a run that a component reports outside of its answers, from `init`, `start` or `output`; 0 is OK.

    The component writes into it, and the simulation reads it after every call.
    """
    watch: Watch = NO_WATCH
    """Where a component that works run by run notes the begin of every call."""

    def __post_init__(self) -> None:
        if not len(self.failed):
            object.__setattr__(self, "failed", np.zeros(len(self.index), dtype=np.int8))
