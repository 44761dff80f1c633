"""How long the calls of estimators and controllers take that compute all runs of a block at once."""

from __future__ import annotations

from timeit import default_timer
from typing import Any

from rmpc_bench.types import Array, Journal

BLOCK = "block"
"""Phase under which the time per run and step is noted; calls for single runs are noted one by one elsewhere."""


class BlockTimes:
    """The calls of estimator and controller in the loop, with the time that they take."""

    def __init__(self, estimator: Any, controller: Any) -> None:
        self._estimator, self._controller = estimator, controller
        self._seconds = {"estimator": 0.0, "controller": 0.0}

    def correct(self, k: int, state: Any, y: Any) -> Any:
        """Call the estimator with y(k), or with what arrives at k."""
        start = default_timer()
        answer = self._estimator.correct(k, state, y)
        self._seconds["estimator"] += default_timer() - start
        return answer

    def predict(self, k: int, state: Any, u: Array) -> Any:
        """Call the estimator with u(k)."""
        start = default_timer()
        answer = self._estimator.predict(k, state, u)
        self._seconds["estimator"] += default_timer() - start
        return answer

    def control(self, k: int, state: Any, y: Array, estimate: Any, r: Array, *ahead: Any) -> Any:
        """Call the controller; `ahead` is what `control_ahead` takes besides."""
        start = default_timer()
        call = self._controller.control_ahead if ahead else self._controller.control
        answer = call(k, state, y, estimate, r, *ahead)
        self._seconds["controller"] += default_timer() - start
        return answer

    def applied(self, k: int, state: Any, u: Array) -> Any:
        """Pass the u(k) that acts to the controller."""
        start = default_timer()
        answer = self._controller.applied(k, state, u)
        self._seconds["controller"] += default_timer() - start
        return answer

    def note(self, journal: Journal, n_runs: int, n_steps: int) -> None:
        """Note the time per run and step of the components whose calls are not timed run by run, once for every run.

        A median then counts runs: blocks of one run, in which a call takes nearly as long as in a block of a hundred,
        do not outweigh a long one.
        """
        for role, seconds in self._seconds.items():
            if not any(name.partition(",")[0] == role for name in journal.seconds):
                journal.seconds[f"{role}, {BLOCK}"] = [seconds / (n_runs * max(n_steps, 1))] * n_runs
