"""Metric of the distance to singular poses, in which the drives cannot move a mechanism in every direction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, DesignError, Issue, MetricLayout, Plant, Positive, Record, WindowMetric, issues_of

EQUATION = r"\mathrm{number\ of\ } \left\lbrace k \lt N : \sigma_{\min} (J(y_k)) \lt b \right\rbrace"


@dataclass(frozen=True, kw_only=True)
class NearSingular(WindowMetric):
    """Number of samples k = 0..N-1 at which the true pose is close to a singular one; lower is better.

    Parameters
    ----------
    below : threshold of the smallest singular value of the matrix from output to drive velocities

    Examples
    --------
    A plant whose manipulability is the distance of its output from 0.

    >>> class Mechanism(Plant):
    ...     has_singular_poses = True
    ...     def manipulability(self, y):
    ...         return abs(y[:, 0])
    >>> layout = MetricLayout(n_steps=3, plant=Mechanism())
    >>> record = Record.of_run(y=[1.0, 0.05, -0.09, 0.0])._replace(experiment=layout)
    >>> NearSingular(below=0.1).evaluate(record).item()  # the sample k = N does not count
    2.0
    """

    name: str = "near_singular"
    below: Positive = 0.1

    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, and a plant without singular poses."""
        yield from super().check(layout)
        yield from issues_of(_mechanism, layout)

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Count the samples in such poses."""
        plant = _mechanism(record.layout)
        poses = record.y[:, self.samples(record).slice]
        rows = np.ascontiguousarray(poses.reshape(-1, poses.shape[2]))
        near = np.zeros(len(rows), dtype=bool)
        # A failed run may have no pose.
        known = np.isfinite(rows).all(axis=1)
        near[known] = plant.manipulability(rows[known]) < self.below
        count: Array = near.reshape(poses.shape[:2]).sum(axis=1).astype(float)
        return count


def _mechanism(layout: MetricLayout) -> Plant:
    """Return the plant, which must have singular poses."""
    if layout.plant is None or not layout.plant.has_singular_poses:
        raise DesignError("needs a plant with singular poses, such as moving-slide; leave the metric out")
    return layout.plant
