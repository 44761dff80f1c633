"""Recorded files as columns, and which rows are the samples of an experiment, Ts apart; a plant checks the cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.received.arrays import ArrayFileError, columns
from rmpc_bench.types import Array, DesignError
from rmpc_bench.types.errors import unknown

Resample: TypeAlias = Literal["linear", "previous"]

ON_SAMPLE = 0.01
"""Distance from a sample, in samples, that is rounding of the recorded time."""
LONGEST = 2.0
"""Recorded steps, in samples or in usual recorded steps, beyond which measurements between them are missing."""


class Sampling:
    """Where the samples k = 0, 1, .. of an experiment lie in a recorded file, with the recorded time t [s].

    Without t the rows are Ts apart.  A DesignError says that t does not increase, or that its steps are not Ts and
    nothing says how to `resample`.
    """

    def __init__(
        self, t: Float[Array, " rows"] | None, n_rows: int, Ts: float, resample: Resample | None, file: Path
    ) -> None:
        self.t, self.n_samples, self.grid = t, n_rows, None
        self._default = resample
        if t is None:
            if resample is not None:
                raise DesignError("needs the column of the time; give `t`", "resample")
            return
        if not np.isfinite(t).all() or (np.diff(t) <= 0.0).any():
            row = int(np.argmin(np.isfinite(t[1:]) & (np.diff(t) > 0.0))) if len(t) > 1 else 0
            raise DesignError(f"{file.name}: the time does not increase at row {row + 2} of the data", "t")
        if resample is None:
            self._refuse_other_steps(t, Ts, file)
            return
        self.n_samples = int(np.floor((t[-1] - t[0]) / Ts + ON_SAMPLE)) + 1
        self.grid = np.minimum(t[0] + Ts * np.arange(self.n_samples), t[-1])
        step = max(Ts, float(np.median(np.diff(t))) if len(t) > 1 else Ts)
        after = np.searchsorted(t, self.grid)
        before = np.maximum(after - 1, 0)
        # A sample inside a long recorded step has no measurement.
        self.nearest = np.where(self.grid - t[before] < t[after] - self.grid, before, after)
        self.on_row = np.abs(t[self.nearest] - self.grid) <= ON_SAMPLE * Ts
        self.before = np.where(self.on_row, self.nearest, before)
        self.missing = (t[after] - t[before] > LONGEST * step) & ~self.on_row

    def values(self, columns: Float[Array, "rows n"], how: Resample | None = None) -> Float[Array, "samples n"]:
        """Return recorded columns at the samples, resampled as given or as the configuration says."""
        if self.grid is None or self.t is None:
            return columns
        if (how or self._default) == "previous":
            held: Array = columns[self.before]
            return held
        if not columns.shape[1]:
            return np.zeros((self.n_samples, 0))
        between = np.stack([np.interp(self.grid, self.t, column) for column in columns.T], axis=1)
        # The neighbours of a recorded sample do not count for it: one may be missing.
        values: Array = np.where(self.on_row[:, None], columns[self.nearest], between)
        return values

    def measured(self, columns: Float[Array, "rows n"]) -> Float[Array, "samples n"]:
        """Return measured columns at the samples; NaN where the recording has a gap."""
        values = self.values(columns)
        return values if self.grid is None else np.where(self.missing[:, None], np.nan, values)

    @staticmethod
    def _refuse_other_steps(t: Float[Array, " rows"], Ts: float, file: Path) -> None:
        wrong = np.flatnonzero(np.abs(t - t[0] - Ts * np.arange(len(t))) > ON_SAMPLE * Ts)
        if not len(wrong):
            return
        steps = np.diff(t)
        if np.allclose(steps, steps[0], rtol=ON_SAMPLE):
            text = f"the recorded step is {np.mean(steps):.6g}, and time.step is {Ts:g}; make them equal"
        else:
            row = int(wrong[0])
            text = f"the recorded steps are not {Ts:g}: at t = {t[row - 1]:.6g} the next sample is {t[row]:.6g}"
        raise DesignError(f"{file.name}: {text}, or give `resample: linear` (or `previous`)", "t")


File: TypeAlias = Path
"""A recorded file, for rooms that touch no files themselves."""

ENDINGS = (".csv", ".npz")
Columns = Mapping[str, Float[Array, " samples"]]


def read_table(file: Path) -> Columns:
    """Read a file."""
    try:
        if file.suffix.lower() not in ENDINGS:
            raise ArrayFileError(f"the ending must be one of {', '.join(ENDINGS)}")
        return columns(file)
    except ArrayFileError as error:
        raise DesignError(f"{file.name}: {error}") from None


def columns_of(table: Columns, names: str | Sequence[str], file: Path, key: str) -> Float[Array, "samples n"]:
    """Return the columns of some names, side by side."""
    found = []
    for name in [names] if isinstance(names, str) else names:
        numbered = [f"{name}.{i}" for i in range(len(table)) if f"{name}.{i}" in table]
        if name not in table and not numbered:
            raise DesignError(f"{file.name}: {unknown(name, table, 'column')}", key)
        found += [table[each] for each in ([name] if name in table else numbered)]
    return np.stack(found, axis=1) if found else np.zeros((len(next(iter(table.values()))), 0))
