"""Outline of an ellipse that is given by its centre and its shape matrix."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rmpc_bench.types import Array

N_POINTS = 181
FLAT = 1e-12
"""Distance from 1 of the correlation of a segment: the rounding of a singular P."""

THIN = 0.02
"""Width of an ellipse, relative to its length in units of the standard deviations, below which it looks like a line."""


class Ellipse(NamedTuple):
    """The ellipse (z - centre)' P^-1 (z - centre) = 1."""

    centre: Array
    """(2,)."""
    P: Array
    """(2, 2) covariance or shape matrix."""

    @property
    def shape(self) -> str:
        """What it looks like: ``ellipse``, ``segment``, ``point``, or ``none`` where P is no covariance or not finite.

        An ellipse so thin that both of its sides coincide on paper counts as a segment.
        """
        if outline(self, 1.0) is None:
            return "none"
        deviations = np.sqrt(np.diag(self.P))
        if not deviations.any():
            return "point"
        if not deviations.all():
            return "segment"
        correlation = min(1.0, abs(self.P[0, 1] + self.P[1, 0]) / 2 / float(deviations.prod()))
        return "segment" if math.sqrt(1 - correlation**2) < THIN else "ellipse"


def outline(ellipse: Ellipse, radius: float) -> Array | None:
    """Find the points z with (z - centre)' P^-1 (z - centre) = radius^2; the segment where P is singular.

    Return (points, 2) coordinates, two points for a segment; None where P is no covariance or not finite.
    """
    if not (np.isfinite(ellipse.P).all() and np.isfinite(ellipse.centre).all()):
        return None
    covariance = (ellipse.P[0, 1] + ellipse.P[1, 0]) / 2
    if min(ellipse.P[0, 0], ellipse.P[1, 1]) < 0:
        return None
    # Each coordinate in its own unit: states of very different sizes make no ellipse degenerate.
    deviations = np.sqrt(np.diag(ellipse.P))
    product = float(deviations.prod())
    if abs(covariance) > (1 + math.sqrt(FLAT)) * product:
        return None
    correlation = min(1.0, max(-1.0, covariance / product)) if product else 1.0
    t = np.array([0.0, math.pi]) if abs(correlation) > 1 - FLAT else np.linspace(0.0, 2 * math.pi, N_POINTS)
    across = math.sqrt(1 - correlation**2)
    unit = np.stack([np.cos(t), correlation * np.cos(t) + across * np.sin(t)], axis=1)
    return np.asarray(ellipse.centre + radius * deviations * unit)
