"""What happened in the runs of a method besides their numbers: failures, held steps and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rmpc_bench.types import RunFailure


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
    """

    n_steps: int
    holds: bool = False
    failures: tuple[RunFailure, ...] = ()
    held: Mapping[int, int] = field(default_factory=dict)
    warnings: Mapping[str, int] = field(default_factory=dict)
    seconds_per_step: float | None = None

    @property
    def n_held(self) -> int:
        """Number of held steps of all runs."""
        return sum(self.held.values())

    def share_held(self, n_runs: int) -> float:
        """Return the share of the steps of all runs that were held.

        Parameters
        ----------
        n_runs : number of runs
        """
        return self.n_held / (self.n_steps * n_runs) if n_runs else 0.0
