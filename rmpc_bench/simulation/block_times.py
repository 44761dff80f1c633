"""How long the calls of estimators and controllers take that compute all runs of a block at once."""

from __future__ import annotations

from collections.abc import Callable
from timeit import default_timer
from typing import Any

from rmpc_bench.types import Journal

BLOCK = "block"
"""Phase under which the time per run and step is noted; calls for single runs are noted one by one elsewhere."""


class BlockTimes:
    """The calls of estimator and controller in the loop, with the time that they take."""

    def __init__(self, estimator: Any, controller: Any) -> None:
        self._seconds = {"estimator": 0.0, "controller": 0.0}
        self.correct, self.predict = (self._timed("estimator", call) for call in (estimator.correct, estimator.predict))
        calls = controller.control, controller.control_ahead, controller.applied
        self.control, self.control_ahead, self.applied = (self._timed("controller", call) for call in calls)

    def _timed(self, role: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*given: Any) -> Any:
            start = default_timer()
            answer = call(*given)
            self._seconds[role] += default_timer() - start
            return answer

        return timed

    def note(self, journal: Journal, n_runs: int, n_steps: int) -> None:
        """Note the time per run and step of the components whose calls are not timed run by run, once for every run.

        A median then counts runs: blocks of one run, in which a call takes nearly as long as in a block of a hundred,
        do not outweigh a long one.
        """
        for role, seconds in self._seconds.items():
            if not any(name.partition(",")[0] == role for name in journal.seconds):
                journal.seconds[f"{role}, {BLOCK}"] = [seconds / (n_runs * max(n_steps, 1))] * n_runs
