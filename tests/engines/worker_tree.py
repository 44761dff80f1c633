"""Processes below this one, and a signal to one of them in the middle of a computation."""

import os
import time
from pathlib import Path

WORKER, DASK_WORKER = "rmpc_bench.engines.worker", "multiprocessing.spawn"
"""Texts of the command lines of a worker process of the bench and of a dask worker."""


def below(process=None):
    """Yield the numbers of all processes below one, this one unless given."""
    for file in Path(f"/proc/{process or os.getpid()}/task").glob("*/children"):
        try:
            children = [int(word) for word in file.read_text().split()]
        except (FileNotFoundError, ProcessLookupError):
            continue
        for child in children:
            yield child
            yield from below(child)


def with_command(text):
    """Return the processes below this one whose command line contains a text."""
    found = []
    for process in below():
        try:
            command = Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace")
        except (FileNotFoundError, ProcessLookupError):
            continue
        found += [process] if text in command else []
    return found


def disturbed(dones, plan):
    """Return what an engine yields; at some results a process gets a signal.

    Parameters
    ----------
    dones : generator of an engine
    plan : number of a result -> (text of the command line of a process, or file with its number; signal)
    """
    found = []
    for number, done in enumerate(dones):
        found.append(done)
        if number in plan:
            victim, signal_number = plan[number]
            process = at_work(victim) if isinstance(victim, Path) else with_command(victim)[-1]
            os.kill(process, signal_number)
    return found


def at_work(file):
    """Return the process that writes its number to a file next, which is in the middle of a run then."""
    file.unlink(missing_ok=True)
    until = time.monotonic() + 30.0
    while not file.exists() and time.monotonic() < until:
        time.sleep(0.001)
    return int(file.read_text())
