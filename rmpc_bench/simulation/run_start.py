"""Start of the components of a method in a block of runs: their states before the first sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.simulation.random_streams import stream
from rmpc_bench.simulation.state_range import OK
from rmpc_bench.types import NO_WATCH, Array, Controller, Estimator, Journal, Plant, RunInfo, Statuses, Watch


class RunState(NamedTuple):
    """What the simulation and the components of a block write and read in place."""

    alive: Bool[Array, " runs"]  # whether a run has not failed
    failed: Statuses  # statuses that components report outside of their answers

    @classmethod
    def of(cls, n_runs: int) -> RunState:
        """Return that of runs of which none has failed."""
        return cls(np.ones(n_runs, dtype=bool), np.zeros(n_runs, dtype=np.int8))

    def after(self, status: Statuses) -> Statuses:
        """Note which runs have not failed, and return the statuses."""
        np.equal(status, OK, out=self.alive)
        return status

    def with_reported(self, status: Statuses) -> Statuses:
        """Return the statuses with those that components report outside of their answers."""
        return self.after(np.where(status == OK, self.failed, status)) if self.failed.any() else status


class RunStart(NamedTuple):
    """The runs of a block, for components with the capability `starts_runs`.

    The random generators of a component depend on the seed, the run and the role of the component.  They do not depend
    on the name of the method: methods with equal components have equal runs.
    """

    seed: int
    runs: tuple[int, ...]
    journal: Journal
    watch: Watch = NO_WATCH

    def plant(self, plant: Plant, delta: Any, x0: Float[Array, "runs nx"], shared: RunState) -> Any:
        """Return the record of the plant for one method."""
        return plant.start(delta, x0, self._runs("plant", shared)) if plant.starts_runs else delta

    def estimator(self, estimator: Estimator, n_runs: int, delta: Any, shared: RunState) -> Any:
        """Return the state of an estimator; an oracle estimator gets the drawn uncertainty."""
        init: Callable[..., Any] = estimator.init
        keywords = {"runs": self._runs("estimator", shared)} if estimator.starts_runs else {}
        return init(n_runs, delta, **keywords) if estimator.knows_uncertainty else init(n_runs, **keywords)

    def controller(self, controller: Controller, n_runs: int, shared: RunState) -> Any:
        """Return the state of a controller."""
        init: Callable[..., Any] = controller.init
        return init(n_runs, runs=self._runs("controller", shared)) if controller.starts_runs else init(n_runs)

    def note_steps(self, step_status: Statuses | None, shared: RunState) -> None:
        """Count the failed steps of runs that go on."""
        if step_status is None:
            return
        for row in np.flatnonzero((step_status != OK) & shared.alive).tolist():
            self.journal.failed_steps[self.runs[row], int(step_status[row])] += 1

    def _runs(self, role: str, shared: RunState) -> RunInfo:
        rngs = tuple(stream(self.seed, run, f"own/{role}") for run in self.runs)
        return RunInfo(self.runs, rngs, shared.alive, self.journal, shared.failed, self.watch)
