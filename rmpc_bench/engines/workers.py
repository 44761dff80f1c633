"""A worker process as its parent sees it: start, messages, limits, why it has ended, what that means for its job."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any, NamedTuple

from rmpc_bench.child_process import Idleness, held, is_stopped, signal_name, start
from rmpc_bench.engines.messages import Inbox
from rmpc_bench.engines.tasks import Task
from rmpc_bench.engines.watch import SIZE, Limits, SharedWatch
from rmpc_bench.engines.worker import DUMP_TRACE, OUT_OF_MEMORY, STOP_STEP
from rmpc_bench.types import RunFailure, Status

MODULE = "rmpc_bench.engines.worker"
"""What a worker process runs."""
DISTURBED = frozenset({signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGXCPU})
"""Signals that come from outside as a rule: from a person, a batch scheduler, or the system when memory runs out."""
LONGEST_PAUSE = 1.0
"""Longest time between two checks of a process [s]."""
STOPPED = 5.0
"""Time after which a stopped process is replaced [s]."""
HUNG, HUNG_WITH_OWN_CODE = 60.0, 600.0
"""Time after which a process that has a job and does not compute is replaced [s]: a component of the user may wait for
a device, a licence or a file, one of the bench never waits."""
GRACE = 1.0
"""Time in which Python code ends after it was asked to [s]; compiled code is killed then."""
_PACKAGE = f"{Path(__file__).parents[1]}{os.sep}"
MAX_DEATHS = 2
"""How often a worker ends by itself with a run alone before the run has crashed."""
MAX_BLOCK_KILLS = 2
"""How often a worker is disturbed from outside with a block before the runs of the block are repeated one by one."""
MAX_KILLS = 4
"""How often a worker is disturbed from outside with a run alone before the run has crashed."""
MAX_STARTS = 3
"""How many workers may end by themselves one after the other before they have loaded the experiment."""
MAX_KILLED_STARTS = 10
"""How many workers may be disturbed from outside one after the other before they have loaded the experiment."""


class Job(NamedTuple):
    """A task with the way in which it is done."""

    task: Task
    alone: bool = False
    """Whether its runs are simulated one by one."""
    deaths: int = 0
    """How often a worker has ended by itself with its first run alone."""
    kills: int = 0
    """How often a worker has been disturbed from outside with its first run alone, or with the whole task."""


class End(NamedTuple):
    """How a worker process has ended."""

    message: str
    k: int | None = None  # sample that was being simulated
    trace: str = ""
    timed_out: bool = False
    outside: bool = False  # whether the process was probably disturbed from outside


class Failed(NamedTuple):
    """A task of one run that no worker could finish."""

    task: Task
    failure: RunFailure


def after(job: Job, end: End) -> tuple[Failed | None, Job | None]:
    """Return the run that has failed, if one has, and what is left to do.

    A process that ends by itself (an exit code, a fault in compiled code) was ended by a run of its job.  A process
    that was killed, stopped or hung was probably disturbed from outside: by a person, a batch scheduler, or the system
    when memory ran out.  Its job is then repeated as it is, and a run has crashed only if this happens several times.
    """
    task = job.task
    if not task.runs:
        return None, None
    if not job.alone and len(task.runs) > 1:
        if end.outside and job.kills + 1 < MAX_BLOCK_KILLS:
            return None, job._replace(kills=job.kills + 1)
        return None, Job(task, alone=True)
    deaths, kills = job.deaths + (not end.outside), job.kills + end.outside
    if not end.timed_out and deaths < MAX_DEATHS and kills < MAX_KILLS:
        return None, Job(task, True, deaths, kills)
    status = Status.TIMEOUT if end.timed_out else Status.CRASHED
    text = f"{end.message} ({kills} attempts)" if kills == MAX_KILLS else end.message
    failure = RunFailure(task.first, int(status), "", end.k, text, end.trace)
    rest = task._replace(first=task.first + 1)
    return Failed(task._replace(stop=task.first + 1), failure), Job(rest, True) if rest.runs else None


class WorkerProcess:
    """A process that does tasks, with at most two of them waiting in it; `data` are the experiments as bytes.

    The output of components goes to the file `log`, without one to the parent's own streams.  The process is replaced
    after the time `patience` [s] without any computing.
    """

    def __init__(self, data: bytes, limits: Limits, log: Path | None, patience: float = HUNG) -> None:
        self.jobs: deque[Job] = deque()
        self.loaded = False
        self._limits, self._patience = limits, patience
        # Why this process has killed it.
        self._killed: End | None = None
        # When the computation that was asked to end began, when it was asked, and when the last known one began.
        self._late_since, self._asked, self._progress = 0.0, 0.0, 0.0
        # The process reads its experiments from a file: sending them would wait until the process takes them, and one
        # that is stopped while it starts never does.
        with (
            ExitStack() as opened,
            tempfile.TemporaryFile(buffering=0) as file,
            tempfile.TemporaryFile() as experiments,
        ):
            file.truncate(SIZE)
            pickle.dump((data, limits), experiments)
            experiments.seek(0)
            self._watch = SharedWatch(file)
            opened.callback(self._watch.close)
            self._trace = opened.enter_context(tempfile.TemporaryFile())
            self.connection, child = Pipe()
            opened.enter_context(self.connection)
            self._inbox = Inbox(self.connection)
            # An interruption between the start and the assignment would leave a process that nobody ends.
            with held(), child:
                self._process = _started(child, experiments.fileno(), file.fileno(), self._trace.fileno(), log)
                # From now on `close` does it.
                opened.pop_all()
        self._idle, self._checked, self._stopped = Idleness(self._process.pid), time.monotonic(), 0.0

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def give(self, job: Job) -> None:
        """Send a job."""
        self.jobs.append(job)
        try:
            self.connection.send((job.task, job.alone))
        except ConnectionError:
            # The process has ended; `receive` reports that.
            pass

    def receive(self) -> list[Any]:
        """Return the messages that have arrived, none where the first is not complete; EOFError at the end."""
        self._checked = time.monotonic()
        self._idle.reset()
        try:
            return [*self._inbox.messages()]
        except OSError:
            raise EOFError from None

    def check(self) -> None:
        """Kill the process if it is stopped, hangs or takes too long; Python code is first asked to end."""
        now, before = time.monotonic(), self._checked
        self._checked = now
        if self._killed is not None:
            return
        if is_stopped(self._process.pid):
            # Time in which this process was stopped too is not counted.
            self._stopped += min(now - before, LONGEST_PAUSE)
            self._watch.excuse(before, now)
            if self._stopped > STOPPED:
                self._kill(End("the worker process was stopped", outside=True))
            return
        self._stopped = 0.0
        if now - before > 2.0 * LONGEST_PAUSE:
            # The whole group of processes was stopped, or the machine was suspended.
            self._watch.excuse(before, now)
        if self.jobs or not self.loaded:
            self._check_progress()
        if self._limits.timed and self._killed is None:
            self._check_time(now)

    def _check_progress(self) -> None:
        if (since := self._watch.since) != self._progress:
            self._progress = since
            self._idle.reset()
        self._idle.look()
        if self._idle.seconds > self._patience:
            self._kill(End(f"the worker process has computed nothing for {self._patience:g} s", outside=True))

    def _kill(self, end: End) -> None:
        self._killed = end
        self._process.kill()

    def _check_time(self, now: float) -> None:
        """Ask the process to end what takes too long, and kill it if it does not."""
        late = self._watch.overdue(self._limits)
        if not late:
            return
        since = self._watch.since
        if since != self._late_since:
            self._late_since, self._asked = since, now
            self._process.send_signal(STOP_STEP)
        elif now - self._asked > GRACE:
            self._process.send_signal(DUMP_TRACE)
            self._await_trace()
            self._kill(End(late, timed_out=True))

    def _await_trace(self) -> None:
        """Wait until the process has written its frames; one that is stopped is killed without them."""
        until = time.monotonic() + GRACE
        while time.monotonic() < until and not os.fstat(self._trace.fileno()).st_size:
            time.sleep(0.01)
        time.sleep(0.05)

    def end(self) -> End:
        """Wait for the end of the process and say how it has ended."""
        end = self._killed
        if end is None:
            try:
                end = self._ended(self._process.wait(timeout=GRACE))
            except subprocess.TimeoutExpired:
                self._process.kill()
                end = End("the worker process closed its connection")
        self._process.wait()
        self._trace.seek(0)
        trace = "".join(_user_frames(self._trace.read().decode(errors="replace")))
        end = end._replace(k=self._watch.k, trace=trace)
        self.close()
        return end

    def _ended(self, code: int) -> End:
        if code == OUT_OF_MEMORY:
            return End(f"the worker process ran out of memory (execution.memory: {self._limits.memory_text})")
        if code < 0:
            return End(f"the worker process was ended by {signal_name(-code)}", outside=-code in DISTURBED)
        return End(f"the worker process ended with exit code {code}")

    def kill(self) -> None:
        """Kill the process, also from another thread; `receive` reports its end."""
        self._process.kill()

    def close(self) -> None:
        """Kill the process and release what belongs to it."""
        self._process.kill()
        self._process.wait()
        self.connection.close()
        self._watch.close()
        self._trace.close()


def _started(child: Connection, experiments: int, watch: int, trace: int, log: Path | None) -> subprocess.Popen[bytes]:
    """Start the process, which keeps some open files."""
    files = {"connection": child.fileno(), "experiments": experiments, "watch": watch, "trace": trace}
    given = {**files, "parent": os.getpid()}
    with nullcontext() if log is None else _appended(log) as output:
        return start(MODULE, subprocess.DEVNULL, output, output, given=given, inherited=files.values())


def _appended(log: Path) -> IO[bytes]:
    log.parent.mkdir(parents=True, exist_ok=True)
    return log.open("ab")


def _user_frames(dump: str) -> Iterator[str]:
    """Return the frames of a dump of Python's fault handler outside the bench, the last call last."""
    frames = [line for line in dump.splitlines(keepends=True) if line.startswith("  File ")]
    kept = [line for line in frames if _PACKAGE not in line and '"<' not in line]
    yield from reversed(kept)
