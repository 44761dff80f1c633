"""The parent's side of a worker process: start, messages, limits of time, end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from rmpc_bench.execution.engines.tasks import Task
from rmpc_bench.execution.engines.watch import SIZE, Limits, SharedWatch
from rmpc_bench.execution.engines.worker import DUMP_TRACE, OUT_OF_MEMORY, STOP_STEP
from rmpc_bench.execution.interrupts import held

_PROGRAM = """
import json, sys
given = json.loads(sys.argv[1])
sys.path[:] = given["path"]
from rmpc_bench.execution.engines.worker import main
main(given)
"""
_ENVIRONMENT = dict.fromkeys(
    (f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMEXPR", "NUMBA")), "1"
) | {
    "VECLIB_MAXIMUM_THREADS": "1",
    # What a component prints shortly before it ends the process is wanted most.
    "PYTHONUNBUFFERED": "1",
}
GRACE = 1.0
"""Time in which Python code ends after it was asked to [s]; compiled code is killed then."""
_PACKAGE = f"{Path(__file__).parents[2]}{os.sep}"


class Job(NamedTuple):
    """A task with the way in which it is done."""

    task: Task
    alone: bool = False
    """Whether its runs are simulated one by one."""
    deaths: int = 0
    """How often a worker has died with its first run alone."""


class End(NamedTuple):
    """How a worker process has ended."""

    message: str
    k: int | None
    trace: str
    timed_out: bool


class WorkerProcess:
    """A process that does tasks, with at most two of them waiting in it.

    Parameters
    ----------
    limits : of time and memory
    log : file that gets the output of components; None for the parent's own streams
    """

    def __init__(self, limits: Limits, log: Path | None) -> None:
        self.jobs: deque[Job] = deque()
        self.loaded = False
        self._limits, self._asked, self._late = limits, 0.0, ""
        self._since = 0.0
        with tempfile.TemporaryFile(buffering=0) as file:
            file.truncate(SIZE)
            self._watch = SharedWatch(file)
            self._trace = tempfile.TemporaryFile()
            self.connection, child = Pipe()
            # An interruption between the start and the assignment would leave a process that nobody ends.
            with held(), child:
                self._process = _started(child, file.fileno(), self._trace.fileno(), log)

    def load(self, data: bytes) -> None:
        """Send the experiments, which the process reads once it has started.

        Parameters
        ----------
        data : experiments as bytes
        """
        self._send((data, self._limits))

    def give(self, job: Job) -> None:
        """Send a job."""
        self.jobs.append(job)
        self._send((job.task, job.alone))

    def _send(self, message: Any) -> None:
        try:
            self.connection.send(message)
        except ConnectionError:
            # The process has ended; `receive` reports that.
            pass

    def receive(self) -> Any:
        """Return the next message.

        Raises
        ------
        EOFError
            If the process has ended.
        """
        try:
            return self.connection.recv()
        except (ConnectionError, OSError):
            raise EOFError from None

    def check_time(self) -> None:
        """Ask the process to end what takes too long, and kill it if it does not."""
        late = self._watch.overdue(self._limits)
        if not late:
            return
        now, since = time.monotonic(), self._watch.since
        if since != self._since:
            self._since, self._asked = since, now
            self._process.send_signal(STOP_STEP)
        elif now - self._asked > GRACE and not self._late:
            self._late = late
            self._process.send_signal(DUMP_TRACE)
            self._await_trace()
            self._process.kill()

    def _await_trace(self) -> None:
        """Wait until the process has written its frames; one that is stopped is killed without them."""
        until = time.monotonic() + GRACE
        while time.monotonic() < until and not os.fstat(self._trace.fileno()).st_size:
            time.sleep(0.01)
        time.sleep(0.05)

    def end(self) -> End:
        """Wait for the end of the process and say how it has ended."""
        if not self._late:
            self._watch_for_end()
        code = self._process.wait()
        message = self._late or _ended(code, self._limits)
        self._trace.seek(0)
        trace = "".join(_user_frames(self._trace.read().decode(errors="replace")))
        end = End(message, self._watch.k, trace, bool(self._late))
        self.close()
        return end

    def _watch_for_end(self) -> None:
        """Kill a process that has closed its connection and goes on."""
        try:
            self._process.wait(timeout=GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()

    def close(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._process.wait()
        self.connection.close()
        self._watch.close()
        self._trace.close()


def _started(child: Connection, watch: int, trace: int, log: Path | None) -> subprocess.Popen[bytes]:
    """Start the process; nothing of the program that runs here is imported in it."""
    connection = child.fileno()
    # Each entry once: an argument has a limited length.
    path = [*dict.fromkeys(sys.path)]
    given = {"connection": connection, "watch": watch, "trace": trace, "parent": os.getpid(), "path": path}
    output: Any = None
    if log is not None:
        log.parent.mkdir(parents=True, exist_ok=True)
        output = log.open("ab")
    try:
        return subprocess.Popen(
            # -P: a file of the current directory with the name of a standard module is not imported in its place.
            [sys.executable, "-P", "-c", _PROGRAM, json.dumps(given)],
            pass_fds=(connection, watch, trace),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            env={**os.environ, **_ENVIRONMENT},
        )
    finally:
        if output is not None:
            output.close()


def _ended(code: int, limits: Limits) -> str:
    if code == OUT_OF_MEMORY:
        return f"the worker process ran out of memory (execution.memory: {limits.memory_text})"
    if code < 0:
        return f"the worker process was ended by {signal.Signals(-code).name}"
    return f"the worker process ended with exit code {code}"


def _user_frames(dump: str) -> Iterator[str]:
    """Return the frames of a dump of Python's fault handler outside the bench, the last call last."""
    frames = [line for line in dump.splitlines(keepends=True) if line.startswith("  File ")]
    kept = [line for line in frames if _PACKAGE not in line and '"<' not in line]
    yield from reversed(kept)
