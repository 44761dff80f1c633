"""Copies of the random inputs of a block, so that every method has its own.

The methods of a block have the same random inputs.  A plant with memory writes into its record `delta`; without a copy
the next method would start where this one ended.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rmpc_bench.simulation.draws import Draws
from rmpc_bench.simulation.scenario import Scenario
from rmpc_bench.types import Plant

_CONSTANTS = (str, bytes, bool, int, float, complex, np.generic, type(None))


def own_draws(scenario: Scenario, plant: Plant, runs: range, n_steps: int, draws: Draws) -> Draws:
    """Return random inputs that a method may write into.

    Parameters
    ----------
    scenario, plant, runs, n_steps : from which ``draws`` was drawn
    draws : the random inputs, which stay as they are

    Returns
    -------
    Copies of the arrays; a record of the plant that consists of anything but arrays and numbers is drawn again.  What
    alters the measurements is not handed to any component, and is not copied.
    """
    try:
        delta = _copied(draws.delta)
    except TypeError:
        delta = scenario.draw_delta(plant, runs, n_steps)
    return draws._replace(delta=delta, x0=draws.x0.copy(), w=draws.w.copy(), v=draws.v.copy())


def _copied(value: Any) -> Any:
    """Copy the arrays in tuples, lists and mappings; raise a TypeError if there is anything else."""
    if type(value) is np.ndarray and value.dtype != object:
        # Nothing can be written into a read-only array, such as one broadcast to all runs.
        return value.copy() if value.flags.writeable else value
    if isinstance(value, _CONSTANTS):
        return value
    if isinstance(value, tuple):
        parts = [_copied(each) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if type(value) is list:
        return [_copied(each) for each in value]
    if type(value) is dict:
        return {name: _copied(each) for name, each in value.items()}
    raise TypeError(f"cannot copy a {type(value).__name__}")
