"""What a component depends on: it is repeated in a process without a plant, and with other data from a sample on."""

from __future__ import annotations

import os
import pickle
import subprocess
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Self

import numpy as np

from rmpc_bench.child_process import start
from rmpc_bench.conformance.outcome import RunsExample
from rmpc_bench.conformance.results import Check, NotApplicableError, Returned, first_difference, raised
from rmpc_bench.conformance.subject import Subject, packed, unpacked
from rmpc_bench.types import Array

SAME_SEED, OTHER_SEED = {"PYTHONHASHSEED": "0"}, {"PYTHONHASHSEED": "1"}
"""Of the process of the checks, and of the one with another environment."""
CHANGE = 81
"""Sample from which on other data are given to a causal component."""
MODULE = "rmpc_bench.conformance.information"


@dataclass(eq=False)
class SeparateProcess:
    """Repeats the calls of a component in a process that gets only the data and what its design function gets."""

    subject: Subject
    provided: Mapping[str, Any]
    group: str
    seconds: float = 20.0  # time limit, below that of a check
    returned: dict[bool, Returned] = field(default_factory=dict)
    _ends: ExitStack = field(default_factory=ExitStack)

    def __enter__(self) -> Self:
        """Start the process with another environment, so that it imports while other checks run."""
        directory = Path(self._ends.enter_context(tempfile.TemporaryDirectory()))
        self._process = self._started(OTHER_SEED, directory)
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes and delete the directory."""
        self._ends.close()

    def _started(self, seed: Mapping[str, str], directory: Path | None = None) -> subprocess.Popen[bytes]:
        pipe, none = subprocess.PIPE, subprocess.DEVNULL
        process = start(MODULE, pipe, pipe, none, environment=seed, directory=directory)
        self._ends.callback(process.communicate)
        self._ends.callback(process.kill)
        return process

    def __call__(self, data: Any, same: bool) -> Returned:
        """Return what the component returns there."""
        if same not in self.returned:
            self.returned[same] = self._request(self._started(SAME_SEED) if same else self._process, data)
        return self.returned[same]

    def _request(self, process: subprocess.Popen[bytes], data: Any) -> Returned:
        job = {"subject": self.subject, "provided": self.provided, "group": self.group, "data": data}
        try:
            out, _ = process.communicate(packed(self.subject, job), timeout=self.seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return Returned(None, f"no result within {self.seconds:g} s")
        if not out:
            return Returned(None, f"the process ended with code {process.returncode}")
        values, raised = pickle.loads(out)
        return Returned(None if values is None else np.asarray(values), raised)


@contextmanager
def received() -> Iterator[tuple[bytes, BinaryIO]]:
    """In another process: read a job from stdin, yield it with the stream for the answers, and leave the process."""
    out = os.fdopen(os.dup(1), "wb")
    # What the component prints goes where the errors go: it must not get between the answers.
    os.dup2(2, 1)
    with os.fdopen(0, "rb") as stream:
        job = stream.read()
    yield job, out
    out.flush()
    # Threads and handlers at exit of the component's libraries may wait for each other.
    os._exit(0)


def main() -> None:
    """In the other process: make the component and write what it returns for the data to stdout."""
    with received() as (text, out):
        try:
            job = unpacked(text)
            design = job["subject"].made(job["group"], job["provided"])
            result = job["data"].results(design), ""
        except (Exception, SystemExit) as error:  # the component may raise anything
            result = None, raised(error)
        pickle.dump(result, out)


@dataclass(frozen=True, eq=False)
class InformationExample(ABC):
    """An example whose data come from a simulation, so that a component is compared with itself without a plant."""

    separate_process: SeparateProcess | None = field(default=None, kw_only=True)
    """None where there are no other processes."""
    loops: dict[int, tuple[Any, Array]] = field(default_factory=dict, init=False, repr=False)
    checks: ClassVar[tuple[Check, ...]]

    @property
    @abstractmethod
    def data(self) -> RunsExample:
        """Everything that the component may use."""

    @abstractmethod
    def simulated(self, component: Any) -> Array:
        """Numbers of the component in the simulation, where there is a plant."""

    def in_loop(self, component: Any) -> Array:
        """As `simulated`, computed once per component."""
        if id(component) not in self.loops:
            self.loops[id(component)] = component, self.simulated(component)
        return self.loops[id(component)][1]

    def away(self, *, same: bool) -> Returned:
        """Numbers of the component in a process without a plant."""
        if self.separate_process is None:
            raise NotApplicableError("needs another process")
        return self.separate_process(self.data.changed(), same)


def _agrees(result: Returned, expected: Array) -> bool:
    return result.values is not None and np.array_equal(result.values, expected, equal_nan=True)


def _difference(result: Returned, expected: Array, name: str) -> str:
    if result.values is None:
        return result.raised
    if result.values.shape != expected.shape:
        return f"{name} has shape {result.values.shape} instead of {expected.shape}"
    place = first_difference(result.values, expected)
    differing = int((result.values != expected).any(axis=(1, 2)).sum())
    return f"{name} of run {place[0]} differs from k = {place[1]} on, that of {differing} of {len(expected)} runs"


def function_of_data(component: Any, example: InformationExample) -> None:
    """Fail if the component returns other values without a plant in the same environment."""
    loop = example.in_loop(component)
    if _agrees(example.away(same=False), loop):
        return
    same = example.away(same=True)
    if _agrees(same, loop):
        return
    differs = _difference(same, loop, example.data.noun)
    raise AssertionError(f"in a process without a plant {differs}: it uses more than its arguments, such as the plant")


def fresh_process(component: Any, example: InformationExample) -> None:
    """Fail if the component returns other values with another hash seed and another working directory."""
    loop, other = example.in_loop(component), example.away(same=False)
    if _agrees(other, loop):
        return
    if not _agrees(example.away(same=True), loop):
        raise NotApplicableError("see `function-of-data`")
    differs = _difference(other, loop, "the result")
    raise AssertionError(f"with another PYTHONHASHSEED and working directory {differs}; does it iterate over a set?")


FRESH = Check("fresh-process", "the same bits in a fresh process, with another hash seed and directory", fresh_process)


def require_no_lookahead(before: Sequence[Array], after: Sequence[Array], change: int, what: str) -> None:
    """Fail if numbers before a sample depend on data from there on; the error says how far they look ahead.

    `before` and `after` are (runs, samples, n) numbers for the given and for changed data, in the order of the
    evaluations: several of each, because a component may remember the data of an earlier method as the future.
    """
    if not np.array_equal(before[1][:, :change], before[2][:, :change], equal_nan=True):
        raise NotApplicableError("the same data give other numbers, see `repeated`")
    for other in after:
        found, expected = other[:, :change], before[2][:, :change]
        differs = (found != expected) & ~((found != found) & (expected != expected))
        if differs.any():
            ahead = change - int(np.flatnonzero(differs.any(axis=(0, 2)))[0])
            raise AssertionError(f"uses the future: {what} changes {ahead} sample{'s' if ahead > 1 else ''} ahead")
