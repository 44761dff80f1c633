"""What the end of a worker process means for the job that it had.

A process that ends by itself (an exit code, a fault in compiled code) was ended by a run of its job.  A process that
was killed, stopped or hung was probably disturbed from outside: by a person, a batch scheduler, or the system when
memory ran out.  Its job is then repeated as it is, and a run has crashed only if this happens with it several times.
"""

from __future__ import annotations

from typing import NamedTuple

from rmpc_bench.execution.engines.tasks import Task
from rmpc_bench.types import RunFailure, Status

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
    k: int | None = None
    """Sample that was being simulated."""
    trace: str = ""
    timed_out: bool = False
    outside: bool = False
    """Whether the process was probably disturbed from outside."""


class Failed(NamedTuple):
    """A task of one run that no worker could finish."""

    task: Task
    failure: RunFailure


def after(job: Job, end: End) -> tuple[Failed | None, Job | None]:
    """Return the run that has failed, if one has, and what is left to do."""
    task = job.task
    if not task.runs:
        return None, None
    single = job.alone or len(task.runs) == 1
    if not single:
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
