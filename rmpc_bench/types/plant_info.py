"""What a component may know of the plant: its nominal data, and never a drawn value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types.basics import Array
from rmpc_bench.types.plant import Plant


class SignalLimits(NamedTuple):
    """Lower and upper limits of the signals of the plant; infinite where there is none."""

    u: tuple[Float[Array, " nu"], Float[Array, " nu"]]
    x: tuple[Float[Array, " nx"], Float[Array, " nx"]]


class PlantInfo(NamedTuple):
    """Sizes, names, units and nominal parameters of the plant."""

    nx: int
    nu: int
    ny: int
    Ts: float
    states: tuple[str, ...]
    """Names; ``x.0``, ``x.1``, .. where the plant has none."""
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Mapping[str, str]
    """Name of a signal, or of a component such as ``y.2`` -> unit."""
    parameters: Mapping[str, float]
    """Nominal values of what `perturb` and `set` may name."""
    limits: SignalLimits

    @classmethod
    def of(cls, plant: Plant) -> PlantInfo:
        """Read a plant."""
        own = plant.signals
        names = (own.states, own.inputs, own.outputs) if own else (_numbered(plant, signal) for signal in "xuy")
        units = {**plant.units, **(own.units if own else {})}
        units |= {name: unit for name, unit in (("y", plant.y_unit), ("u", plant.u_unit)) if unit}
        u, x = (own.limits(own.inputs), own.limits(own.states)) if own else (_free(plant.nu), _free(plant.nx))
        states, inputs, outputs = names
        nominal = {name: float(value) for name, value in plant.nominal.items()}
        sizes = plant.nx, plant.nu, plant.ny, float(plant.Ts)
        return cls(*sizes, states, inputs, outputs, units, nominal, SignalLimits(_locked(u), _locked(x)))


def _numbered(plant: Plant, signal: str) -> tuple[str, ...]:
    return tuple(f"{signal}.{i}" for i in range(int(getattr(plant, f"n{signal}"))))


def _locked(limits: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return limits that cannot be changed: all runs have the same."""
    low, high = (np.array(each) for each in limits)
    for each in (low, high):
        each.setflags(write=False)
    return low, high


def _free(n: int) -> tuple[Array, Array]:
    return np.full(n, -np.inf), np.full(n, np.inf)
