"""Plants of one object of another program per run, such as an environment or an FMU, with named signals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.components.single_plant import RunPlants, SingleRunPlant
from rmpc_bench.components.user_class import user_class
from rmpc_bench.types import Array, Signals


class ObjectPlant(SingleRunPlant):
    """A plant whose objects have their own state, which their attribute `x` shows after the start.

    Parameters
    ----------
    run : class of the objects, with `start`, `step` and `output`
    given : arguments of the class, with `Ts` and `n_steps`
    signals : names, units and bounds
    nominal : nominal parameters
    nw : number of process noises
    has_own_start : whether x(0) is that of the objects
    """

    def __init__(
        self,
        run: type,
        given: Mapping[str, Any],
        signals: Signals,
        nominal: Mapping[str, float],
        *,
        nw: int,
        has_own_start: bool,
    ) -> None:
        super().__init__(user_class("plants", run), given)
        self.described: tuple[tuple[str, str], ...] = ()
        # These are attributes of the instance in place of the defaults of the base class.
        self.__dict__ |= {
            "signals": signals,
            "nominal": dict(nominal),
            "nx": signals.nx,
            "nu": signals.nu,
            "ny": signals.ny,
            "nv": signals.ny,
            "nw": nw,
            "has_own_start": has_own_start,
            "names": signals.component_names(),
            "units": signals.component_units(),
        }

    def facts(self) -> list[tuple[str, str]]:
        """What the objects are and how they are used."""
        return list(self.described)

    def first_state(self, delta: RunPlants, x0: Float[Array, "runs nx"]) -> Float[Array, "runs nx"]:
        """Return x(0) of the objects."""
        made = [] if delta.objects is None else delta.objects.made
        first = [getattr(each, "x", x0[row]) for row, each in enumerate(made)]
        return np.array(first).reshape(x0.shape) if first else x0
