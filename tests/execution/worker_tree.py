"""Processes below this one, and a signal to one of them in the middle of a computation."""

import os
from pathlib import Path

WORKER, DASK_WORKER = "rmpc_bench.execution.engines.worker", "multiprocessing.spawn"
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
            process = int(victim.read_text()) if isinstance(victim, Path) else with_command(victim)[-1]
            os.kill(process, signal_number)
    return found
