"""Comparison of another form of a nonlinear design model with the model itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from rmpc_bench.models.dynamics import OUTSIDE_DOMAIN
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.types import Array

TRIALS = 20
"""States and inputs at which the functions are compared."""
AGREES = 1e-9
"""Largest difference, relative to the largest state: rounding of two implementations of sin or exp."""


def difference(model: NonlinearModel, name: str, made: Callable[..., Array], arguments: Sequence[str]) -> str:
    """Say where a function gives other numbers than that of the model; empty where it does not.

    Both are called at the operating point and at random states and inputs within the bounds of the plant.  Points at
    which the model is not defined are left out.
    """
    rng, names = np.random.Generator(np.random.PCG64(5)), model.dynamics.names
    for trial in range(TRIALS):
        size = 10.0 ** rng.uniform(-2.0, 1.0)
        x, u = size * np.abs(rng.standard_normal(model.nx)), rng.standard_normal(model.nu)
        if trial == 0 and model.operating_point is not None:
            x, u = model.operating_point.x, model.operating_point.u
        at: dict[str, Any] = {"x": np.clip(x, *model.limits), "u": np.clip(u, *model.dynamics.limits(names.inputs))}
        given = [{**at, "k": trial}[each] for each in arguments]
        try:
            with np.errstate(all="ignore"):
                wanted: Array = getattr(model, name)(*given)
        except OUTSIDE_DOMAIN:
            continue
        found, largest = made(*given), max(np.abs(at["x"]).max(), np.abs(wanted).max())
        if np.isfinite(wanted).all() and not (np.abs(found - wanted) <= AGREES * largest).all():
            return f"{found.tolist()} instead of {wanted.tolist()} at x = {at['x'].tolist()}"
    return ""
