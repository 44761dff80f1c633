"""Controllers of experiments that compare estimators only: a given input (open loop), or none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, Command, CompiledLaw, Controller, Estimate, InputSignal, RunInfo, Status

OK = np.int8(Status.OK)


@dataclass(frozen=True, eq=False)
class OpenLoop(Controller):
    """A controller that applies a given input.

    Parameters
    ----------
    signal : the input
    n_steps : number of control periods N
    """

    signal: InputSignal
    n_steps: int
    preview = 0
    uses_estimate = False
    starts_runs = True
    has_compiled_form = True

    def compiled_form(self, r: Float[Array, "known ny"], n_steps: int, runs: Sequence[int]) -> CompiledLaw:
        """Return the inputs of the runs."""
        return CompiledLaw(self.signal.sample(runs, self.n_steps))

    def init(self, n_runs: int, runs: RunInfo | None = None) -> Float[Array, "runs samples nu"]:
        """Return the inputs of the runs; they are those of runs 0, 1, .. unless ``runs`` is given."""
        index = range(n_runs) if runs is None else runs.index
        return self.signal.sample(index, self.n_steps)

    def control(
        self,
        k: int,
        state: Float[Array, "runs samples nu"],
        y: Float[Array, "runs ny"],
        estimate: Estimate,
        r: Float[Array, "preview ny"],
    ) -> tuple[Float[Array, "runs samples nu"], Command]:
        """Return u(k) of every run."""
        return state, Command(state[:, k], np.full(len(y), OK), {})


@dataclass(frozen=True)
class Rest(Controller):
    """A controller that leaves the plant alone."""

    nu: int
    preview = 0
    uses_estimate = False
    has_compiled_form = True

    def compiled_form(self, r: Float[Array, "known ny"], n_steps: int, runs: Sequence[int]) -> CompiledLaw:
        """Return u = 0 for every k."""
        return CompiledLaw(np.zeros((1, 1, self.nu)))

    def init(self, n_runs: int) -> None:
        """There is nothing to remember."""

    def control(
        self,
        k: int,
        state: None,
        y: Float[Array, "runs ny"],
        estimate: Estimate,
        r: Float[Array, "preview ny"],
    ) -> tuple[None, Command]:
        """Return u = 0."""
        return None, Command(np.zeros((len(y), self.nu)), np.full(len(y), OK), {})
