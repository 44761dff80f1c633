"""Range of the true state: a run that leaves it has failed.

`out-of-range`  a state has left the bounds within which the plant is defined (`plant.bounds`).
`diverged`      a state or an estimate is not a number, or larger than a limit (`plant.diverged`); an input is not a
                number or beyond 1e100.  Without a limit of its own a state has 1e6 times the largest of 1, its initial
                value and the reference.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types import Array, Status, Statuses

# Looked up here once: access to a member of an enumeration is slow.
OK, OUT_OF_RANGE, DIVERGED = np.int8(Status.OK), np.int8(Status.OUT_OF_RANGE), np.int8(Status.DIVERGED)
GROWTH = 1e6
"""Growth beyond which a run counts as diverged."""
LARGEST = 1e100
"""Magnitude of an input beyond which a run counts as diverged: squares must still be numbers that can be summed."""


class StateRange(NamedTuple):
    """Limits of the true state, the same for all runs."""

    low: Float[Array, " nx"] | None = None
    """Lower bounds; None where no state has bounds."""
    high: Float[Array, " nx"] | None = None
    largest: Float[Array, " nx"] | None = None
    """Magnitudes beyond which a run has diverged; None for the default, NaN for that of a single state."""
    least_scale: float = 1.0
    """Magnitude of the signals of the plant, as far as it is known beforehand: the default limits are not below 1e6
    times it."""


DEFAULT_RANGE = StateRange()
"""No bounds, and the default limits of divergence."""


class RunLimits:
    """The limits of every run of a block, and the statuses that follow from them."""

    def __init__(self, state_range: StateRange, x0: Float[Array, "runs nx"], r: Float[Array, "samples ny"]) -> None:
        self.low, self.high, largest, least_scale = state_range
        scale = max(least_scale, float(np.abs(r).max(initial=0.0)))
        # An initial state that is not a number fails its own run only.
        self.of_x = GROWTH * np.fmax(np.abs(x0), scale)
        if largest is not None:
            self.of_x = np.where(np.isnan(largest), self.of_x, largest)
        # Recorded runs may have no state, and their estimates have a limit all the same.
        self._of_x_hat = self.of_x.max(axis=1, initial=0.0 if x0.shape[1] else GROWTH * scale)[:, None]

    def of_state(self, status: Statuses, reported: Statuses, x: Float[Array, "runs nx"]) -> Statuses:
        """Return the first failure of every run after the plant has moved to x."""
        if self.low is not None and (outside := (x < self.low) | (x > self.high)).any():
            # Before the test of the numbers: beyond its bounds a plant may return anything.
            left = np.where(outside.any(axis=1), OUT_OF_RANGE, OK)
            reported = np.where(reported != OK, reported, left)
        return first_failure(status, reported, np.abs(x) <= self.of_x)

    def of_estimate(
        self, status: Statuses, reported: Statuses, x_hat: Float[Array, "runs nx_hat"], n_disturbances: int = 0
    ) -> Statuses:
        """Return the first failure of every run after a correction.

        The states of a design model have no limits of their own: where their number is not that of the plant, the
        largest limit of the plant counts.
        """
        return first_failure(status, reported, np.abs(x_hat) <= self.of_estimates(x_hat.shape, n_disturbances))

    def of_estimates(self, shape: tuple[int, ...], n_disturbances: int = 0) -> Float[Array, "runs _"]:
        """Return the limits of estimates, to be broadcast to their shape (runs, nx_hat).

        Disturbances, the last coordinates, may have any unit: they must be below 1e100, as inputs.
        """
        if n_disturbances:
            runs, n = shape
            of_x = np.broadcast_to(self.of_estimates((runs, n - n_disturbances)), (runs, n - n_disturbances))
            return np.hstack([of_x, np.full((runs, n_disturbances), LARGEST)])
        return self.of_x if shape == self.of_x.shape else self._of_x_hat

    def of_input(self, status: Statuses, reported: Statuses, u: Float[Array, "runs nu"]) -> Statuses:
        """Return the first failure of every run after a control law has chosen u."""
        return first_failure(status, reported, np.abs(u) < LARGEST)


def first_failure(status: Statuses, reported: Statuses, fits: Bool[Array, "runs n"]) -> Statuses:
    """Keep the first failure of every run: the status so far, the one reported, or values that do not fit."""
    if not reported.any() and fits.all():
        return status
    news = np.where(reported != OK, reported, np.where(fits.all(axis=1), OK, DIVERGED))
    return np.where(status != OK, status, news)
