"""A plant that consists of environments, one per run and method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.environment_run import Access, EnvironmentRun
from rmpc_bench.components.single_plant import RunPlants, SingleRunPlant
from rmpc_bench.components.user_class import user_class
from rmpc_bench.plants.limited_inputs import limited_inputs
from rmpc_bench.types import Array, Motion, Signals


class EnvironmentPlant(SingleRunPlant):
    """A plant of environments; build it with `rmpc_bench.adapters.gymnasium.design`.

    Parameters
    ----------
    access : how the environments are made, moved and read
    signals : names, units and bounds
    measured : indices of the states that are the outputs; None where `access` measures them
    nominal : nominal parameters
    Ts : sampling time [s]
    n_steps : number of control periods N
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
        super().__init__(user_class("plants", EnvironmentRun), {"access": access, "Ts": Ts, "n_steps": n_steps})
        self.access, self.measured = access, measured
        places = signals.places()
        # A disturbed state and an observation of the undisturbed one would contradict each other.
        disturbed = access.write is not None and access.read is not None and not access.measures_observation
        # These are attributes of the instance in place of the defaults of the base class.
        self.__dict__ |= {
            "signals": signals,
            "nominal": dict(nominal),
            "nx": signals.nx,
            "nu": signals.nu,
            "ny": signals.ny,
            "nv": signals.ny,
            "nw": signals.nx if disturbed else 0,
            "has_own_start": not access.starts_at_x0,
            "names": {place: name for place, name in places.items() if place != name},
            "units": {place: signals.units[name] for place, name in places.items() if name in signals.units},
        }
        self.described: tuple[tuple[str, str], ...] = ()
        self.repeats = True

    @property
    def deterministic(self) -> bool:
        """Whether equal seeds and actions gave equal states when the plant was designed."""
        return self.repeats

    def facts(self) -> list[tuple[str, str]]:
        """What the environment is and how it is used."""
        return list(self.described)

    def first_state(self, delta: RunPlants, x0: Float[Array, "runs nx"]) -> Float[Array, "runs nx"]:
        """Return x(0) of the environments."""
        made = [] if delta.objects is None else delta.objects.made
        first = [getattr(each, "x", x0[row]) for row, each in enumerate(made)]
        return np.array(first).reshape(x0.shape) if first else x0

    def step(self, k: int, delta: RunPlants, x: Array, u: Array, w: Array) -> Motion:
        """Limit the inputs, then move every environment."""
        runs = None if delta.objects is None else delta.objects.runs
        # Without noise the state is not written.
        w = w if w.any() else w[:, :0]
        return super().step(k, delta, x, limited_inputs(cast(Signals, self.signals), u, runs), w)

    def output(self, k: int, delta: RunPlants, x: Array, v: Array) -> Float[Array, "runs ny"]:
        """Measure; entries of the state are taken for all runs at once."""
        y: Array = x[:, self.measured] + v if self.measured is not None else super().output(k, delta, x, v)
        return y
