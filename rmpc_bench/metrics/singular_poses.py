"""How close a mechanism comes to poses in which its drives cannot move it every way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.tracking import Bound, SampleMetric, Units, Window, window_of
from rmpc_bench.types import Array, DesignError, MetricInfo, Plant, Positive, Record


@dataclass(frozen=True)
class NearSingular:
    """Parameters of `near_singular`."""

    plant: Plant
    below: float

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Count the samples in such poses."""
        poses = record.y[:, window.slice]
        rows = np.ascontiguousarray(poses.reshape(-1, poses.shape[2]))
        near = np.zeros(len(rows), dtype=bool)
        known = np.isfinite(rows).all(axis=1)  # a run that failed may have no pose
        near[known] = self.plant.manipulability(rows[known]) < self.below
        count: Array = near.reshape(poses.shape[:2]).sum(axis=1).astype(float)
        return count


def near_singular(
    units: Units,
    *,
    name: str = "near_singular",
    below: Positive = 0.1,
    from_: Bound = None,
    to: Bound = None,
) -> SampleMetric:
    """Number of samples k = 0..N-1 at which the true pose is close to a singular one.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    below : the smallest singular value of what maps output velocities to those of the drives is less than this
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    if units.plant is None or not units.plant.has_singular_poses:
        raise DesignError("needs a plant that knows singular poses, such as moving-slide; leave the metric out")
    window = window_of(units, from_, to, units.n_steps - 1, units.n_steps)
    return SampleMetric(MetricInfo(name, "", "lower"), window, NearSingular(units.plant, below))
