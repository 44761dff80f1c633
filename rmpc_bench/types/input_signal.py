"""Base class of input signals: inputs of the plant that do not depend on measurements."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import Float

from rmpc_bench.types.basics import Array


class InputSignal:
    """An input known ahead of time, in place of a controller.  A subclass gives the method `sample`."""

    @property
    def n_runs(self) -> int | None:
        """Number of runs that have an input; None where every run has one."""
        return None

    def sample(self, runs: Sequence[int], n_samples: int) -> Float[Array, "runs samples nu"]:
        """Values at k = 0..n_samples - 1 of every run.

        Parameters
        ----------
        runs : indices of the runs; a recorded input may be another one in every run
        n_samples : number of samples
        """
        raise NotImplementedError("sample")
