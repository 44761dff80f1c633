"""Hard limits of inputs, states, outputs and signals of the design model, as rows of x and u.

Names   `u` for all inputs, `u.0` for one, and what a soft limit may name: `x.1`, `y.0`, a signal of the design model,
        the name of a state or an output.
Shared  By the design and the law of tube-mpc.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.limits import bounds_of, key_of, signal_of
from rmpc_bench.numerics.intervals import Pairs
from rmpc_bench.types import Array, DesignError, Model, PlantInfo
from rmpc_bench.types.errors import no_such_component


class LimitRows(NamedTuple):
    """Limits low <= H_x x + H_u u <= high on deviations from the operating point; infinite where there is none."""

    H_x: Float[Array, "rows nx"]
    H_u: Float[Array, "rows nu"]
    low: Float[Array, " rows"]
    high: Float[Array, " rows"]
    names: tuple[str, ...]
    """Name of the limited signal of every row, for messages."""


def limit_rows(model: Model, limits: Mapping[str, Pairs], plant_info: PlantInfo | None = None) -> LimitRows:
    """Return the limits of signals, one pair or one per row, as rows of x - x_op and u - u_op."""
    if not limits:
        raise DesignError("needs a limit, such as `u: [-1, 1]`", "limits")
    parts = []
    for name, pairs in limits.items():
        key = key_of("limits", name)
        try:
            H_x, H_u, constant = _signal(name, model, plant_info)
        except DesignError as error:
            raise DesignError(str(error), key) from None
        low, high = bounds_of(pairs, len(H_x), key)
        rest = constant + H_x @ model.x_op + H_u @ model.u_op
        inside = (low < rest) & (rest < high)
        if not inside.all():
            row = int(np.argmin(inside))
            raise DesignError(f"must have {rest[row]:g}, the steady state of the law, between its bounds", key)
        parts.append((H_x, H_u, low - rest, high - rest))
    H_x, H_u, low, high = (np.concatenate(each) for each in zip(*parts, strict=True))
    names = [name for name, part in zip(limits, parts, strict=True) for _ in part[0]]
    return LimitRows(H_x, H_u, low, high, tuple(names))


def _signal(name: str, model: Model, plant_info: PlantInfo | None) -> tuple[Array, Array, Array]:
    """Return what x, u and a constant contribute to a signal."""
    letter, _, number = name.partition(".")
    if letter == "u" and (not number or number.isdecimal()):
        chosen = np.eye(model.nu)
        if number:
            if int(number) >= model.nu:
                raise DesignError(no_such_component("input", int(number), model.nu))
            chosen = chosen[int(number) :][:1]
        return np.zeros((len(chosen), model.nx)), chosen, np.zeros(len(chosen))
    signal = signal_of(name, model, plant_info)
    return signal.Z, np.zeros((len(signal.Z), model.nu)), signal.constant
