"""State of a worker process: whether it is stopped, and whether it computes."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

QUIET = 0.02
"""A process that uses less time of the processor between two looks does not compute [s]."""
BETWEEN = 2.0
"""Time between two looks [s]."""


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
