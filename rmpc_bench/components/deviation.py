"""Components for one run that work in deviations from the operating point of the design model.

A class with ``deviation = True`` gets `model.deviation` as its model, which has no constant parts in a steady state.
Its signals are deviations: y - y_op, u(k-1) - u_op, r - y_op, x_hat - x_op, limits of u - u_op.  What it returns is
moved back.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rmpc_bench.components.user_class import UserClass
from rmpc_bench.types import OperatingPoint


def in_deviation(user: UserClass, given: Mapping[str, Any]) -> tuple[Mapping[str, Any], OperatingPoint | None]:
    """Return what a design is made from, and the operating point to move its signals by where the class asks for it."""
    model = given.get("model")
    point = getattr(model, "operating_point", None)
    if model is None or point is None or not user.constant("deviation", False):
        return given, None
    moved = {**given, "model": model.deviation}
    if "x0" in given:
        moved["x0"] = np.asarray(given["x0"], dtype=float) - point.x
    if given.get("plant_info") is not None:
        info = given["plant_info"]
        low, high = info.limits.u
        moved["plant_info"] = info._replace(limits=info.limits._replace(u=(low - point.u, high - point.u)))
    return moved, point
