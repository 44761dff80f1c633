"""A plant that consists of environments, one per run and method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from rmpc_bench.adapters.gymnasium_access import nearest
from rmpc_bench.components.single_plant import Access, EnvironmentRun, ObjectPlant, RunPlants
from rmpc_bench.types import Array, Motion, RunInfo, Signals


@dataclass(frozen=True, eq=False)
class DiscreteInput(Signals):
    """Signals of an environment with discrete actions: the nearest value acts, the first of two equally near ones."""

    values: Float[Array, " actions"] = field(kw_only=True)

    def limited_inputs(self, u: Float[Array, "runs 1"], runs: RunInfo | None = None) -> Float[Array, "runs 1"]:
        """Return the nearest values; inputs beyond the bounds are counted."""
        limited = super().limited_inputs(u, runs)
        chosen = self.values[nearest(limited, self.values)][:, None]
        return np.where(np.isnan(limited), limited, chosen)


class EnvironmentPlant(ObjectPlant):
    """A plant of environments, made by `rmpc_bench.adapters.gymnasium.design`.

    `measured` has the indices of the states that are the outputs; it is None where `access` measures them.
    """

    def __init__(
        self,
        access: Access,
        signals: Signals,
        measured: list[int] | None,
        nominal: Mapping[str, float],
        Ts: float,
        n_steps: int,
    ) -> None:
        # A disturbed state and an observation of the undisturbed one would contradict each other.
        disturbed = access.write is not None and access.read is not None and not access.measures_observation
        given = {"access": access, "Ts": Ts, "n_steps": n_steps}
        nw = signals.nx if disturbed else 0
        super().__init__(EnvironmentRun, given, signals, nominal, nw=nw, has_own_start=not access.starts_at_x0)
        self.access, self.measured, self.repeats = access, measured, True

    @property
    def deterministic(self) -> bool:
        """Whether equal seeds and actions gave equal states when the plant was designed."""
        return self.repeats

    def step(self, k: int, delta: RunPlants, x: Array, u: Array, w: Array) -> Motion:
        """Move every environment; without noise its state is not written."""
        return super().step(k, delta, x, u, w if w.any() else w[:, :0])

    def output(self, k: int, delta: RunPlants, x: Array, v: Array) -> Float[Array, "runs ny"]:
        """Measure; entries of the state are taken for all runs at once."""
        y: Array = x[:, self.measured] + v if self.measured is not None else super().output(k, delta, x, v)
        return y
