"""Recorded data of a run: the signals of a block, what a method reports of itself, and the bursts of the noise.

A component may reuse one array and return it at every k; recorded values must not change with it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.simulation.scenario import Experiment, Recording, Scenario
from rmpc_bench.types import Array, DesignError, Method

BURSTS = "bursts"
"""Whether the measurement noise is in a burst, 0 or 1: recorded by itself wherever a law of it has bursts."""
COVARIANCE = "P"
"""The reported covariance of the estimation error, which is recorded row by row; NaN of a method that reports none."""
SIGNALS = ("y", "u", "u_command", "x", "x_hat")
"""Signals of every run, `u_command` before the bounds of the plant and u after them; others are extra signals of the
plant, reported by the method, or the bursts of the noise."""


class Recorder:
    """Collects copies of signals and matrices.

    With the number of runs `matrices_of` it keeps a matrix for every run also while they have a common one.
    """

    def __init__(self, n_samples: int, matrices_of: int | None = None) -> None:
        self.n_samples, self.matrices_of = n_samples, matrices_of
        self.signals, self.matrices, self.gaps = dict[str, Array](), dict[str, Array](), set[str]()

    def at(self, k: int, **values: Array) -> None:
        """Copy the values (runs, n) of signals at k."""
        for name, value in values.items():
            if k == 0:
                self.signals[name] = np.empty((self.n_samples, *value.shape))
            self.signals[name][k] = value

    def matrix_at(self, k: int, name: str, value: Array | None) -> None:
        """Copy a matrix at k, (nx, nx) or (runs, nx, nx); where it is None, the series has a gap."""
        if value is None:
            self.gaps.add(name)
            return
        if self.matrices_of is not None and value.ndim == 2:
            value = np.broadcast_to(value, (self.matrices_of, *value.shape))
        if name not in self.matrices:
            self.matrices[name] = np.full((self.n_samples, *value.shape), np.nan)
        series = self.matrices[name]
        if value.ndim > series[k].ndim:
            # Runs get matrices of their own once a measurement is missing.
            self.matrices[name] = series = np.repeat(series[:, None], len(value), axis=1)
            series[k] = value
        else:
            series[k] = value

    def all(self) -> dict[str, Float[Array, "runs samples n"]]:
        """Signals with the run first and contiguous in memory: sums over time do not depend on other runs."""
        return {name: np.ascontiguousarray(signal.transpose(1, 0, 2)) for name, signal in self.signals.items()}

    def matrix(
        self, name: str, *, gappy: bool = False
    ) -> Float[Array, "samples nx nx"] | Float[Array, "runs samples nx nx"] | None:
        """Matrices over k, with the run first where every run has its own; None without any, or with gaps.

        With `gappy`, only a series with gaps, NaN there.
        """
        series = self.matrices.get(name) if (name in self.gaps) is gappy else None
        return series if series is None or series.ndim == 3 else np.ascontiguousarray(series.swapaxes(0, 1))


def has_bursts(scenario: Scenario) -> bool:
    """Whether a law of the measurement noise has bursts."""
    return any(law.has_bursts for law in scenario.measurement)


def with_bursts(recording: Recording, *, bursts: bool) -> Recording:
    """Record bursts where there are some and anything is recorded; nowhere else."""
    signals = tuple(name for name in recording.signals if name != BURSTS)
    return recording._replace(signals=(*signals, BURSTS) if bursts and recording.n_runs else signals)


def kept(experiment: Experiment, name: str) -> Recording:
    """What is kept of the runs of one method: a signal that it does not report leaves no trace."""
    recording = experiment.recording
    there = {*SIGNALS, BURSTS, COVARIANCE, *experiment.plant.extra_signals, *experiment.method(name).reports}
    return recording._replace(signals=tuple(signal for signal in recording.signals if signal in there))


def design_series(method: Method) -> dict[str, Array]:
    """Return the series of the estimator of a method, axis 0 = k.

    With disturbances in the design model, P and M are those of x, and P_d and M_d those of d.
    """
    found: dict[str, Array] = {}
    for name, values in method.estimator.series().items():
        try:
            array = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise DesignError(f"`series` returns something else than numbers for {name!r}") from None
        if array.ndim == 0:
            raise DesignError(f"`series` returns a number for {name!r}; axis 0 must be the time index k")
        found[str(name)] = array
    nd = method.n_disturbances
    for name in ("P", "M"):
        if nd and name in found:
            both = found[name]
            found |= {name: both[:, :-nd, :-nd], f"{name}_d": both[:, -nd:, -nd:]}
    return found
