"""Recorder of a block: copies of the signals and of the reported matrices, sample by sample.

A component may reuse one array and return it at every k; recorded values must not change with it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array


class Recorder:
    """Collects copies of signals and matrices.

    Parameters
    ----------
    n_samples : number of samples that are recorded
    matrices_of : number of runs, to keep a matrix for every run also while they have a common one; None otherwise
    """

    def __init__(self, n_samples: int, matrices_of: int | None = None) -> None:
        self.n_samples, self.matrices_of = n_samples, matrices_of
        self.signals, self.matrices = dict[str, Array](), dict[str, Array | None]()

    def at(self, k: int, **values: Array) -> None:
        """Copy the values (runs, n) of signals at k."""
        for name, value in values.items():
            if k == 0:
                self.signals[name] = np.empty((self.n_samples, *value.shape))
            self.signals[name][k] = value

    def matrix_at(self, k: int, name: str, value: Array | None) -> None:
        """Copy a matrix at k, (nx, nx) or (runs, nx, nx); where it is None at any k, there is no series."""
        if self.matrices_of is not None and value is not None and value.ndim == 2:
            value = np.broadcast_to(value, (self.matrices_of, *value.shape))
        if k == 0 and value is not None:
            self.matrices[name] = np.empty((self.n_samples, *value.shape))
        series = self.matrices.get(name)
        if value is None or series is None:
            self.matrices[name] = None
        elif value.ndim > series[k].ndim:
            # Runs get matrices of their own once a measurement is missing.
            self.matrices[name] = series = np.repeat(series[:, None], len(value), axis=1)
            series[k] = value
        else:
            series[k] = value

    def all(self) -> dict[str, Float[Array, "runs samples n"]]:
        """Signals with the run first and contiguous in memory: sums over time do not depend on other runs."""
        return {name: np.ascontiguousarray(signal.transpose(1, 0, 2)) for name, signal in self.signals.items()}

    def matrix(self, name: str) -> Float[Array, "samples nx nx"] | Float[Array, "runs samples nx nx"] | None:
        """Matrices over k, with the run first where every run has its own; None where they are not recorded."""
        series = self.matrices.get(name)
        return series if series is None or series.ndim == 3 else np.ascontiguousarray(series.swapaxes(0, 1))
