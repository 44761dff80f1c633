"""Limits of the input of laws without an optimisation, and the anti-windup of their integrals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from rmpc_bench.controllers.limits import Bounds, one_for_all
from rmpc_bench.numerics.intervals import Pairs

AntiWindup: TypeAlias = Literal["back-calculation", "clamping", "none"]


@dataclass(frozen=True)
class InputLimits:
    """Bounds of the input.

    Parameters
    ----------
    u : [low, high] for every input, or one pair per input, in the unit of the input
    """

    u: Pairs


def common_limits(bounds: Bounds) -> tuple[float, float] | Bounds | None:
    """Return the lower and the upper limit of all inputs, or of each; None where there are none."""
    return None if np.isinf(bounds).all() else one_for_all(bounds)
