"""Child processes: how they start and end with their parent, and whether they are stopped or compute nothing."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

_PROGRAM = """
import json, sys
sys.path[:], given = json.loads(sys.argv[1])
from {module} import main
main(**given)
"""
_ENVIRONMENT = dict.fromkeys(
    (f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMEXPR", "NUMBA")), "1"
) | {
    "VECLIB_MAXIMUM_THREADS": "1",
    # What a component prints shortly before it ends the process is wanted most.
    "PYTHONUNBUFFERED": "1",
}
QUIET = 0.02
"""A process that uses less time of the processor between two looks does not compute [s]."""
BETWEEN = 2.0
"""Time between two looks [s]."""
_DELAYED = frozenset({signal.SIGINT, signal.SIGTERM})
_KILL_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of Linux."""


@contextmanager
def held() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM until the end of the block; processes that it starts inherit the delay.

    The mask of this thread is what they inherit.  It does not suffice here: the system gives a signal that the main
    thread delays to another thread, and Python then calls the handler in the main thread nevertheless.  So the
    handlers only note the signal meanwhile.  In another thread than the main one no handler runs; there only the mask
    changes, and a SIGTERM without a handler ends the process as usual.
    """
    arrived = set[int]()
    with ExitStack() as after:
        after.callback(_raise_again, arrived)
        if threading.current_thread() is threading.main_thread():
            for number in _DELAYED:
                # One that is ignored stays so: a process that the block starts inherits this.
                if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN):
                    after.callback(signal.signal, number, handler)
                    signal.signal(number, lambda number, frame: arrived.add(number))
        # Removed first: what this thread has delayed is noted before the handlers are put back.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _DELAYED)
        after.callback(signal.pthread_sigmask, signal.SIG_SETMASK, before)
        yield


def _raise_again(numbers: Collection[int]) -> None:
    # The handler of one may raise an exception; the other comes all the same.
    with ExitStack() as last:
        for number in numbers:
            last.callback(signal.raise_signal, number)


def signal_name(number: int) -> str:
    """Return the name of a signal; those for own use of programs have none."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def start(
    module: str,
    stdin: int,
    stdout: int | IO[bytes] | None,
    stderr: int | IO[bytes] | None,
    *,
    given: Mapping[str, Any] | None = None,
    inherited: Collection[int] = (),
    environment: Mapping[str, str] | None = None,
    directory: Path | None = None,
    session: bool = False,
) -> subprocess.Popen[bytes]:
    """Start a Python process that calls ``main`` of a module, with `given` as keyword arguments, which JSON can write.

    Nothing of the program that runs here is imported in it.  It keeps the files `inherited`, `environment` has the
    variables that differ, and with `session` the process gets a group of its own, which can be ended together.
    """
    # Each entry once: an argument has a limited length.
    path = [*dict.fromkeys(entry or os.getcwd() for entry in sys.path)]
    return subprocess.Popen(
        # -P: a file of the current directory with the name of a standard module is not imported in its place.
        [sys.executable, "-P", "-c", _PROGRAM.format(module=module), json.dumps([path, given or {}])],
        pass_fds=inherited,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        cwd=directory,
        start_new_session=session,
        env={**os.environ, **_ENVIRONMENT, **(environment or {})},
    )


def end_with(parent: int) -> None:
    """End this process when its parent has been killed, also while compiled code runs where the system can do that."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_KILL_WITH_PARENT, signal.SIGKILL)
    threading.Thread(target=_follow, args=(parent,), daemon=True).start()


def _follow(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def is_stopped(process: int) -> bool:
    """Whether a child process is stopped, as by SIGSTOP, and has not been continued."""
    if not hasattr(os, "waitid"):
        return False
    try:
        return os.waitid(os.P_PID, process, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:
        return False


def processor_seconds(process: int) -> float | None:
    """Return the time of the processor that a process and its children have used [s]; None where it is not known."""
    try:
        return sum(map(_own_seconds, _with_children(process)))
    except (OSError, ValueError):
        return None


def _own_seconds(process: int) -> float:
    try:
        text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    except (FileNotFoundError, ProcessLookupError):
        if not Path("/proc/self/stat").exists():
            raise
        # A child has ended in the meantime.
        return 0.0
    # The second field is the name, which may contain spaces; user and system time are the fields 14 and 15.
    fields = text.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _with_children(process: int) -> Iterator[int]:
    yield process
    for file in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            children = file.read_text(encoding="ascii").split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        for child in children:
            yield from _with_children(int(child))


class Idleness:
    """How long a process that has a job has neither computed nor made progress."""

    def __init__(self, process: int) -> None:
        self._process, self._used = process, 0.0
        self._looked = time.monotonic()
        self.seconds = 0.0
        """As of the last look [s]."""

    def reset(self) -> None:
        """Note progress."""
        self.seconds = 0.0

    def look(self) -> None:
        """Look at the time of the processor, not more often than every few seconds."""
        now = time.monotonic()
        elapsed = now - self._looked
        if elapsed < BETWEEN:
            return
        self._looked = now
        used = processor_seconds(self._process)
        if used is None or abs(used - self._used) > QUIET:
            self.seconds, self._used = 0.0, used or 0.0
        else:
            # This process may have been stopped too: then nobody has looked for a long time.
            self.seconds += min(elapsed, 2.0 * BETWEEN)
