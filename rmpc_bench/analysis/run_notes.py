"""What happened in the runs of a method besides their numbers: failures, held and failed steps, and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rmpc_bench.types import Array, RunFailure, Status


@dataclass(frozen=True)
class RunNotes:
    """Notes on the runs of one method.

    Parameters
    ----------
    n_steps : number of control periods of a run
    holds : whether a component of the method holds a failed step
    failures : failures that have a description, in the order of the runs
    held : run -> number of held steps, of the runs that have some
    warnings : text of a warning of a component -> how often it was given
    seconds_per_step : time of estimator and controller together per run and step [s]; None where it is not known
    optimises : whether the controller goes on after a step whose optimisation failed
    failed_steps : run -> word of a status -> number of steps whose optimisation failed so, of the runs that have some
    """

    n_steps: int
    holds: bool = False
    failures: tuple[RunFailure, ...] = ()
    held: Mapping[int, int] = field(default_factory=dict)
    warnings: Mapping[str, int] = field(default_factory=dict)
    seconds_per_step: float | None = None
    optimises: bool = False
    failed_steps: Mapping[int, Mapping[str, int]] = field(default_factory=dict)

    def of_runs(self, runs: Array) -> RunNotes:
        """Return the notes on some of the runs; warnings are counted over all runs."""
        chosen = {*runs.tolist()}
        return replace(
            self,
            failures=tuple(each for each in self.failures if each.run in chosen),
            held={run: n for run, n in self.held.items() if run in chosen},
            failed_steps={run: steps for run, steps in self.failed_steps.items() if run in chosen},
        )

    @property
    def n_held(self) -> int:
        """Number of held steps of all runs."""
        return sum(self.held.values())

    @property
    def n_failed_steps(self) -> int:
        """Number of steps of all runs whose optimisation failed."""
        return sum(map(self.n_failed_of, self.failed_steps))

    def n_failed_of(self, run: int) -> int:
        """Return the number of steps of a run whose optimisation failed."""
        return sum(self.failed_steps.get(run, {}).values())

    def worst_step_of(self, run: int) -> str:
        """Return the word of the worst status of the steps of a run: ``ok``, ``infeasible`` or ``not-converged``.

        Examples
        --------
        >>> RunNotes(10, failed_steps={3: {"infeasible": 2}}).worst_step_of(3), RunNotes(10).worst_step_of(3)
        ('infeasible', 'ok')
        """
        found = self.failed_steps.get(run, {})
        return max((status for status in Status if status.word in found), default=Status.OK).word
