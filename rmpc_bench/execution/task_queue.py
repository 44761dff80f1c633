"""The tasks of an experiment that are not handed out yet; an engine takes them one by one."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from rmpc_bench.execution.engines.tasks import Done, Task


class TaskQueue:
    """Tasks in the order in which they are to be computed.

    Parameters
    ----------
    tasks : what is to be computed
    """

    def __init__(self, tasks: Iterable[Task] = ()) -> None:
        self._left = deque(tasks)

    def __len__(self) -> int:
        """How many tasks are not handed out."""
        return len(self._left)

    @property
    def n_trials(self) -> int:
        """How many trials are not handed out."""
        return sum(len(task.runs) for task in self._left)

    def take(self) -> Task | None:
        """Hand out the next task; None if there is none now."""
        return self._left.popleft() if self._left else None

    def add(self, tasks: Iterable[Task]) -> None:
        """Append tasks, also while an engine works; it takes them after those that are there."""
        self._left.extend(tasks)

    def note(self, done: Done) -> None:
        """Note that a task, or a part of one, is finished and how long it has taken."""
