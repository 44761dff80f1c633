"""An S with hooks in the plane as a function of time, from rest to rest.

With s = t/duration in [0, 1]: g = 10 s^3 - 15 s^4 + 6 s^5 runs from 0 to 1 without velocity or acceleration at the
ends, f = (5/4 g - 1/8) pi, and the point is x = -width sin 2f, y = height cos f, turned by angle sin^2(pi g).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array

DURATION, WIDTH, HEIGHT, ANGLE = 8.0, 0.08, 0.10, 0.20  # s, m, m, rad


def s_curve(
    t: Float[Array, " samples"],
    duration: float = DURATION,
    width: float = WIDTH,
    height: float = HEIGHT,
    angle: float = ANGLE,
) -> Float[Array, "samples 3"]:
    """Return x, y and the angle [m, m, rad] at times in seconds; it is constant before the start and after the end."""
    s = np.clip(t / duration, 0.0, 1.0)
    g = s * s * s * (10.0 - s * (15.0 - 6.0 * s))
    f = (1.25 * g - 0.125) * np.pi
    turn = np.sin(np.pi * g)
    return np.stack([-width * np.sin(2.0 * f), height * np.cos(f), angle * turn * turn], axis=1)
