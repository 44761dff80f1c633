"""Keys `bounds` and `diverged` of every plant: limits of the true state beyond which a run has failed."""

from __future__ import annotations

import re
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Len, Lt

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.tree import Map
from rmpc_bench.simulation.state_range import LARGEST, StateRange
from rmpc_bench.types import Array, Plant

KEYS = ("bounds", "diverged")
"""Keys of a plant that are no parameters of its design."""

Bounds: Any = dict[str, Annotated[list[float | None], Len(2, 2)]]
Limit = Annotated[float, Gt(0), Lt(LARGEST)]
Limits: Any = Limit | list[Limit]


def read_range(draft: DraftConfig) -> None:
    """Validate the keys as far as the plant need not be known.

    Parameters
    ----------
    draft : with a plant; gets the values in `plant_range`
    """
    tree = draft.tree["plant"]
    for key, annotation in zip(KEYS, (Bounds, Limits), strict=True):
        if isinstance(tree, Map) and key in tree:
            draft.plant_range[key] = draft.checked(annotation, ["plant", key])


def build_range(draft: DraftConfig, plant: Plant, x0: Array | None) -> StateRange:
    """Expand the keys to the states of a plant; errors are added to the problems of the draft.

    Parameters
    ----------
    draft : with the validated keys
    plant : for its number of states
    x0 : true initial state, without its deviation; None where it has an error
    """
    bounds, diverged = draft.plant_range.get("bounds"), draft.plant_range.get("diverged")
    low, high, found = np.full(plant.nx, -np.inf), np.full(plant.nx, np.inf), len(draft.problems)
    for name, (lower, upper) in (bounds or {}).items():
        lower, upper = -np.inf if lower is None else lower, np.inf if upper is None else upper
        if not lower < upper:
            message = f"the lower bound {lower:g} must be below the upper bound {upper:g}"
            draft.note(["plant", "bounds", name], message)
        states = _states(draft, name, plant.nx)
        if states is not None:
            low[states], high[states] = lower, upper
    largest = None
    if isinstance(diverged, list) and len(diverged) != plant.nx:
        message = f"has {len(diverged)} entries; give one number, or one for each of the {plant.nx} states"
        draft.note(["plant", "diverged"], message)
    elif diverged is not None:
        largest = np.broadcast_to(np.array(diverged, dtype=float), (plant.nx,)).copy()
    if x0 is not None and x0.shape == low.shape and len(draft.problems) == found:
        _check_start(draft, x0, low, high, largest)
    return StateRange(low, high, largest) if bounds else StateRange(largest=largest)


def _states(draft: DraftConfig, name: str, nx: int) -> slice | None:
    """Return the states that a name stands for: `x` for all, `x.i` for one, counted from 0."""
    if name == "x":
        return slice(None)
    number = int(name[2:]) if re.fullmatch(r"x\.\d{1,6}", name) else nx
    if number < nx:
        return slice(number, number + 1)
    known = "x.0" if nx == 1 else f"x.0 to x.{nx - 1}"
    message = f"{name!r} is not a state of this plant; its states are {known}, and x stands for all of them"
    draft.note(["plant", "bounds", name], message, key=True)
    return None


def _check_start(draft: DraftConfig, x0: Array, low: Array, high: Array, largest: Array | None) -> None:
    """Report an initial state with which every run fails at once."""
    path: list[str | int] = ["initial", "x"] if "x" in draft.tree.get("initial", {}) else ["plant"]
    for i in np.flatnonzero((x0 < low) | (x0 > high)):
        draft.note(path, f"x.{i} starts at {x0[i]:g}, outside its plant.bounds [{low[i]:g}, {high[i]:g}]")
    for i in np.flatnonzero(np.abs(x0) > (np.inf if largest is None else largest)):
        draft.note(path, f"x.{i} starts at {x0[i]:g}, beyond plant.diverged = {np.asarray(largest)[i]:g}")
