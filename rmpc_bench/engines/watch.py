"""What a worker process is computing, in memory that it shares with its parent, and the time limits.

The worker writes when a block, a control period or a call for one run begins.  The parent reads when that takes too
long: inside compiled code the worker itself cannot act.
"""

from __future__ import annotations

import mmap
import struct
import time
from typing import BinaryIO, NamedTuple

from rmpc_bench.types import Watch

FIRST_STEP = 10.0
"""Factor of the limit of a step at k = 0, and of what happens outside of the steps: a component may compile there."""
_ALL, _REST, _FIRST = struct.Struct("8d"), struct.Struct("7d"), struct.Struct("d")
SIZE = _ALL.size
"""Size of the shared memory [bytes]: start of the block, then start of what is computed now, time that earlier calls of
its run have taken, run, sample, factors of the limits of a step and of a run, number of runs of the block."""
_NONE = -1.0


class Limits(NamedTuple):
    """Limits of a worker process; None where there is none."""

    step: float | None = None  # longest time of a step of a run [s]
    run: float | None = None  # longest time of a run [s]
    memory: int | None = None  # largest memory [bytes]
    memory_text: str = ""  # the same as the configuration states it

    @property
    def timed(self) -> bool:
        """Whether there is a limit of time."""
        return self.step is not None or self.run is not None


class SharedWatch(Watch):
    """Notes what a process is computing in an open file of `SIZE` bytes, which both processes map into memory."""

    def __init__(self, file: BinaryIO) -> None:
        self._memory: mmap.mmap | bytearray = mmap.mmap(file.fileno(), SIZE)
        self._n_runs = 0
        # Times in which a process was stopped, as (start, end).
        self._excused: list[tuple[float, float]] = []

    def detach(self) -> None:
        """Write no longer into the shared memory, in a copy of the process that a component has made."""
        self._memory = bytearray(SIZE)

    def start(self, n_runs: int) -> None:
        """Note that the simulation of a block of runs begins."""
        self._n_runs, self.stopped = n_runs, ""
        now = time.monotonic()
        _ALL.pack_into(self._memory, 0, now, now, 0.0, _NONE, _NONE, FIRST_STEP * n_runs, n_runs, n_runs)

    def step(self, k: int) -> None:
        """Note that the control period k of a block begins."""
        self._note(0.0, _NONE, k, 1.0 if k else FIRST_STEP)

    def call(self, run: int, k: int | None, used: float) -> None:
        """Note that a call for one run begins."""
        self._note(used, run, _NONE if k is None else k, 1.0 if k else FIRST_STEP)

    def _note(self, used: float, run: float, k: float, factor: float) -> None:
        self.stopped = ""
        _REST.pack_into(self._memory, _FIRST.size, time.monotonic(), used, run, k, factor, 1.0, self._n_runs)

    def end(self) -> None:
        """Note that the simulation of the block has ended."""
        _FIRST.pack_into(self._memory, 0, 0.0)

    @property
    def k(self) -> int | None:
        """Sample of the control period; None outside of them."""
        k = self._fields()[4]
        return None if k < 0.0 else int(k)

    @property
    def since(self) -> float:
        """When what is computed now began [s of the monotonic clock]."""
        return self._fields()[1]

    def _fields(self) -> tuple[float, ...]:
        return _ALL.unpack_from(self._memory)

    def overdue(self, limits: Limits) -> str:
        """Say which limit of time is exceeded; empty where none is."""
        started, since, used, _, _, step_factor, run_factor, n_runs = self._fields()
        if not started:
            return ""
        taken = self._elapsed(since)
        if limits.step is not None and taken > limits.step * step_factor:
            return f"a step took longer than {limits.step * min(step_factor, FIRST_STEP):g} s (execution.timeout.step)"
        if limits.run is not None and (
            taken + used > limits.run * run_factor or self._elapsed(started) > limits.run * n_runs
        ):
            return f"the run took longer than {limits.run:g} s (execution.timeout.run)"
        return ""

    def excuse(self, start: float, end: float) -> None:
        """Leave a time [s] of the monotonic clock out of the limits, because no process could compute in it."""
        self._excused = [*(each for each in self._excused if each[1] > self._fields()[0]), (start, end)]

    def _elapsed(self, since: float) -> float:
        """Return the time that has passed and counts [s]."""
        out = sum(max(end - max(start, since), 0.0) for start, end in self._excused)
        return time.monotonic() - since - out

    def begin_again(self, text: str) -> None:
        """Start the time of what is computed now again, after its end was asked for with the text of the limit."""
        self.stopped = text
        _FIRST.pack_into(self._memory, _FIRST.size, time.monotonic())

    def close(self) -> None:
        """Release the shared memory."""
        if isinstance(self._memory, mmap.mmap):
            self._memory.close()
