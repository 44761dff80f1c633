"""Recorded inputs: the input of run i is that of file i."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rmpc_bench.recordings.sampling import Resample, Sampling, columns_of, read_table
from rmpc_bench.types import Array, DataFiles, DesignError, InputSignal


@dataclass(frozen=True, eq=False)
class RecordedInput(InputSignal):
    """Inputs of recorded runs; one run is the input of all."""

    values: Float[Array, "recorded samples nu"]

    @property
    def n_runs(self) -> int | None:
        """Number of recorded runs; None where one holds for all runs."""
        return len(self.values) if len(self.values) > 1 else None

    def sample(self, runs: Sequence[int], n_samples: int) -> Float[Array, "runs samples nu"]:
        """Values at k = 0..n_samples - 1 of every run."""
        rows = np.asarray(runs, dtype=int) if len(self.values) > 1 else np.zeros(len(runs), dtype=int)
        return self.values[rows, :n_samples]


def design(
    nu: int,
    Ts: float,
    n_steps: int,
    *,
    file: DataFiles,
    columns: str | list[str] = "u",
    t: str | None = None,
    resample: Resample | None = None,
) -> RecordedInput:
    """Recorded input from csv or npz files.

    Parameters
    ----------
    nu : number of inputs
    Ts : sampling time [s]
    n_steps : number of control periods N
    file : a file for all runs, or a pattern such as 'inputs/*.csv': file i, sorted by name, is that of run i
    columns : name of the column, or one per input
    t : name of the column of the time [s]; without it the rows are Ts apart
    resample : how to find values between recorded ones; without it, other steps than Ts are refused

    Raises
    ------
    DesignError
        If a file is not such a table, is too short or has missing values.

    Examples
    --------
    ``input: {file: u.csv, columns: voltage, t: time}``
    """
    return RecordedInput(np.array([_input(each, nu, Ts, n_steps, columns, t, resample) for each in file]))


def _input(
    file: Path, nu: int, Ts: float, n_steps: int, columns: str | list[str], t: str | None, resample: Resample | None
) -> Float[Array, "samples nu"]:
    table = read_table(file)
    time = None if t is None else columns_of(table, t, file, "t")[:, 0]
    given = columns_of(table, columns, file, "columns")
    if given.shape[1] != nu:
        raise DesignError(f"names {given.shape[1]} columns of {file.name}, and there are {nu} inputs", "columns")
    return inputs(Sampling(time, len(given), Ts, resample, file), given, n_steps, file, resample)


def inputs(
    sampling: Sampling, given: Float[Array, "rows nu"], n_steps: int, file: Path, how: Resample | None
) -> Float[Array, "samples nu"]:
    """Return the inputs u(0)..u(N-1) of a recorded run."""
    u = sampling.values(given, how)[:n_steps]
    if len(u) < n_steps:
        raise DesignError(f"{file.name}: has {len(u)} samples, and the experiment needs the input at {n_steps}")
    if not np.isfinite(u).all():
        k = int(np.flatnonzero(~np.isfinite(u).all(axis=1))[0])
        raise DesignError(f"{file.name}: the input is missing at sample {k}; an input must be known at every sample")
    return u
