"""No input: u = 0, for experiments that compare estimators only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, Command, CompiledLaw, Controller, Estimate, Status

OK = np.int8(Status.OK)


@dataclass(frozen=True)
class Rest(Controller):
    """A controller that leaves the plant alone."""

    nu: int
    preview = 0
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
