"""A plant of co-simulation units, one per run and method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
from jaxtyping import Float

from rmpc_bench.adapters.fmu_file import Unit
from rmpc_bench.adapters.fmu_run import FmuRun
from rmpc_bench.components.single_plant import RunPlants, SingleRunPlant
from rmpc_bench.components.user_class import user_class
from rmpc_bench.plants.limited_inputs import limited_inputs
from rmpc_bench.types import Array, Motion, Signals


class FmuPlant(SingleRunPlant):
    """Co-simulation units; build it with `rmpc_bench.adapters.fmu.plant`."""

    def __init__(self, unit: Unit, signals: Signals, nominal: Mapping[str, float], Ts: float, n_steps: int) -> None:
        super().__init__(user_class("plants", FmuRun), {"unit": unit, "signals": signals, "Ts": Ts, "n_steps": n_steps})
        self.unit, places = unit, signals.places()
        self.described: tuple[tuple[str, str], ...] = ()
        # These are attributes of the instance in place of the defaults of the base class.
        self.__dict__ |= {
            "signals": signals, "nominal": dict(nominal), "nx": signals.nx, "nu": signals.nu, "ny": signals.ny,
            "nw": 0, "nv": signals.ny, "has_own_start": not set(signals.states) <= set(unit.at_start),
            "names": {place: name for place, name in places.items() if place != name},
            "units": {place: signals.units[name] for place, name in places.items() if name in signals.units},
        }  # fmt: skip

    def facts(self) -> list[tuple[str, str]]:
        """What the file is and how it is used."""
        return list(self.described)

    def first_state(self, delta: RunPlants, x0: Float[Array, "runs nx"]) -> Float[Array, "runs nx"]:
        """Return x(0) of the instances."""
        made = [] if delta.objects is None else delta.objects.made
        first = [getattr(each, "x", x0[row]) for row, each in enumerate(made)]
        return np.array(first).reshape(x0.shape) if first else x0

    def step(self, k: int, delta: RunPlants, x: Array, u: Array, w: Array) -> Motion:
        """Limit the inputs, then simulate every instance."""
        runs = None if delta.objects is None else delta.objects.runs
        return super().step(k, delta, x, limited_inputs(cast(Signals, self.signals), u, runs), w)
