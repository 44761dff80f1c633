"""Variables that a batch scheduler sets in its jobs: the position in an array job, and the number of cores.

The first index of the array may be any number.  The array must be a range, as the position of an index in a list of
single numbers is not in the environment.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Mapping
from typing import NamedTuple

from rmpc_bench.execution.shards import Shard

SECONDS = 30.0
"""Longest time that `qstat` may take [s]."""


_CORES = ("SLURM_CPUS_PER_TASK", "NSLOTS", "PBS_NUM_PPN", "NCPUS")
"""Variables with the cores of a job: of SLURM, SGE, TORQUE and PBS Pro."""


class ArrayJobError(Exception):
    """The shard of this process cannot be found from its environment."""


class _Array(NamedTuple):
    """Indices of an array job: first, first + step, .., last."""

    first: int
    last: int
    step: int

    @property
    def size(self) -> int:
        return (self.last - self.first) // self.step + 1


def n_cores(environment: Mapping[str, str]) -> int:
    """Return the number of cores of the batch job, at most those that this process may use."""
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    given = [int(environment[name]) for name in _CORES if environment.get(name, "").isdecimal()]
    return max(1, min([here, *given[:1]]))


def shard_of_array_job(environment: Mapping[str, str]) -> Shard:
    """Return the shard of the task of an array job of SLURM, PBS or SGE; `ArrayJobError` where it is none."""
    if "SLURM_ARRAY_TASK_ID" in environment:
        return _slurm(environment)
    for name in ("PBS_ARRAY_INDEX", "PBS_ARRAYID"):
        if name in environment:
            return _pbs(environment, name)
    if environment.get("SGE_TASK_ID", "undefined") != "undefined":
        return _sge(environment)
    raise ArrayJobError(
        "this process is no task of an array job: none of SLURM_ARRAY_TASK_ID, PBS_ARRAY_INDEX, PBS_ARRAYID and "
        "SGE_TASK_ID is set; give I/N"
    )


def _slurm(environment: Mapping[str, str]) -> Shard:
    first, last = _number(environment, "SLURM_ARRAY_TASK_MIN"), _number(environment, "SLURM_ARRAY_TASK_MAX")
    array = _Array(first, last, _number(environment, "SLURM_ARRAY_TASK_STEP", "1"))
    if array.size != _number(environment, "SLURM_ARRAY_TASK_COUNT"):
        raise ArrayJobError(
            f"the array has {environment['SLURM_ARRAY_TASK_COUNT']} of the {array.size} indices from {first} to "
            f"{last}: --shard auto needs a range without gaps; give I/N"
        )
    return _shard(environment, "SLURM_ARRAY_TASK_ID", array)


def _sge(environment: Mapping[str, str]) -> Shard:
    first, last = _number(environment, "SGE_TASK_FIRST"), _number(environment, "SGE_TASK_LAST")
    return _shard(environment, "SGE_TASK_ID", _Array(first, last, _number(environment, "SGE_TASK_STEPSIZE", "1")))


def _pbs(environment: Mapping[str, str], name: str) -> Shard:
    """Ask `qstat` for the indices: PBS sets the index of the task only."""
    job = environment.get("PBS_ARRAY_ID") or environment.get("PBS_JOBID") or ""
    way_out = f"give --shard with the number of tasks, such as $(({name}))/7 for an array that begins with 1"
    try:
        command = ["qstat", "-f", job]
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=True)
    except (OSError, subprocess.SubprocessError) as error:
        raise ArrayJobError(
            f"`qstat -f {job}` does not show how many tasks the array has ({error}); {way_out}"
        ) from None
    # PBS Pro has the first name, TORQUE the second, with the largest number of running tasks after a %.
    found = re.search(
        r"(?:array_indices_submitted|job_array_request) = (\d+)(?:-(\d+))?(?::(\d+))?(?:%\d+)?\s", done.stdout
    )
    if found is None:
        raise ArrayJobError(f"`qstat -f {job}` shows no range of indices of the array; {way_out}")
    first = int(found[1])
    return _shard(environment, name, _Array(first, int(found[2] or first), int(found[3] or 1)))


def _shard(environment: Mapping[str, str], name: str, array: _Array) -> Shard:
    index = _number(environment, name)
    if array.step < 1 or index not in range(array.first, array.last + 1, array.step):
        text = f"{array.first}-{array.last}" + (f":{array.step}" if array.step != 1 else "")
        raise ArrayJobError(f"{name} is {index}, which is not an index of the array {text}; give I/N")
    return Shard((index - array.first) // array.step + 1, array.size)


def _number(environment: Mapping[str, str], name: str, default: str = "") -> int:
    text = environment.get(name, default)
    try:
        return int(text)
    except ValueError:
        raise ArrayJobError(f"{name} must be a whole number (got {text!r}); give I/N") from None
