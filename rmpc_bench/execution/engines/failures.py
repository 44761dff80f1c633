"""A failed run as plain data: its exception, the frames of the component's own code, and the last signals."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Sequence
from types import FrameType, TracebackType
from typing import Any

import numpy as np

from rmpc_bench.components.trace import last_user_frame, one_line, user_trace
from rmpc_bench.execution.engines.tasks import Done, Task, named_values
from rmpc_bench.simulation.checked_calls import CheckedController, CheckedEstimator, CheckedPlant
from rmpc_bench.simulation.closed_loop import Block, simulate
from rmpc_bench.simulation.ensemble import Group
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import (
    Controller,
    Estimator,
    InvalidReturnValue,
    Journal,
    Metric,
    Plant,
    RunFailure,
    Status,
    TimeLimit,
)

_ROLES: dict[str, tuple[type, ...]] = {
    "estimator": (Estimator, CheckedEstimator),
    "controller": (Controller, CheckedController),
    "plant": (Plant, CheckedPlant),
    "metric": (Metric,),
}
MAX_FRAMES = 30
"""Frames of the bench that are kept, the innermost ones: a recursion without end has a thousand."""


def failed(experiments: Sequence[Experiment], task: Task, failure: RunFailure) -> Done:
    """Return the result of a task of one run that has failed outside of the simulation loop.

    It has no metrics and no trajectories.
    """
    experiment = experiments[task.point]
    journal = Journal()
    journal.fail(failure)
    # The width of the estimate is not known; the moments of a group leave out a run that has failed.
    group = Group(task.first, task.stop, 0, np.zeros((1, 1)), np.empty((0, 1, 1)))
    ensemble = (group,) if experiment.recording.ensemble else ()
    values = np.full((len(experiment.metrics), 1), np.nan)
    block = Block(np.array([failure.status], dtype=np.int8), values, {}, ensemble, journal)
    return Done(task, block, [named_values(experiment, task.first)])


def failure_of(error: BaseException, experiment: Experiment, run: int) -> RunFailure:
    """Describe the exception that ended a run which was simulated alone."""
    frames = [tb.tb_frame for tb in _entries(error.__traceback__)]
    loop = next((frame.f_locals for frame in frames if _is_loop(frame)), {})
    values = {name: _last(loop.get(key)) for name, key in (("y", "y"), ("u_previous", "u"), ("x_hat", "estimate"))}
    known = {name: value for name, value in values.items() if value is not None}
    return RunFailure(
        run,
        int(Status.TIMEOUT if isinstance(error, TimeLimit) else Status.CRASHED),
        _role(frames),
        loop.get("k"),
        str(error) if isinstance(error, InvalidReturnValue | TimeLimit) else one_line(error),
        _trace(error),
        {**known, "parameters": named_values(experiment, run)},
    )


def _trace(error: BaseException) -> str:
    """Return the frames of the component's own code; those of the bench where there are no others."""
    if last_user_frame(error):
        return user_trace(error)
    return "".join(traceback.format_exception(error, limit=-MAX_FRAMES))


def _entries(entry: TracebackType | None) -> Iterator[TracebackType]:
    while entry is not None:
        yield entry
        entry = entry.tb_next


def _is_loop(frame: FrameType) -> bool:
    return (frame.f_globals.get("__name__"), frame.f_code.co_name) == (simulate.__module__, simulate.__name__)


def _role(frames: Sequence[FrameType]) -> str:
    """Name the component whose method was called first."""
    for frame in frames:
        owner = frame.f_locals.get("self", frame.f_locals.get("metric"))
        for role, classes in _ROLES.items():
            if isinstance(owner, classes):
                return role
    return ""


def _last(value: Any) -> list[Any] | None:
    """Return the signal of the only run."""
    array = getattr(value, "x_hat", value)
    return array[0].tolist() if isinstance(array, np.ndarray) and len(array) == 1 else None
