"""Recorded data as plant: files of runs that took place elsewhere, and which of their cells may be empty.

Model   None: y(k) and u(k) are those of the files, and so is a recorded x(k).  Run i is file i, sorted by name.  There
        is no controller.
Limit   Estimators do not act on the data (open loop).
Fails   Design error: a file has no such columns, other sampling steps, too few samples or no input at a sample.  A
        missing measurement (NaN) is no failure of the plant; an estimator that does not bridge it diverges there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.recordings.recorded_input import RecordedInput, inputs
from rmpc_bench.recordings.sampling import File, Resample, Sampling, columns_of, read_table
from rmpc_bench.types import Array, DataFiles, DesignError, Motion, Plant, RecordedRuns, RunInfo
from rmpc_bench.types.plant import Generators, Inputs, Noises, Outputs, ParameterValues, States

Rows = Int[Array, " runs"]


@dataclass(frozen=True)
class Columns:
    """Names of the columns of the recorded signals, each one name or a list.

    Parameters
    ----------
    y : of the outputs
    u : of the inputs; no input if not given
    x : of the states; no state if not given
    """

    y: str | list[str] = "y"
    u: str | list[str] | None = None
    x: str | list[str] | None = None


@dataclass(frozen=True, eq=False)
class RecordedPlant(Plant):
    """A plant that replays recorded runs; build it with `design`."""

    Ts: float  # sampling time [s]
    y: Float[Array, "files samples ny"]  # measurements, NaN where one is missing
    x: Float[Array, "files samples nx"]  # states; nx = 0 where they were not recorded
    u: RecordedInput
    names: Mapping[str, str]  # names of single components
    recorded: RecordedRuns  # number of runs, gaps and scale
    starts_runs = True
    nw = 0

    @property
    def nx(self) -> int:
        """Number of recorded states."""
        return int(self.x.shape[2])

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return int(self.u.values.shape[2])

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return int(self.y.shape[2])

    def facts(self) -> list[tuple[str, str]]:
        """Size of the recording and its gaps."""
        return [
            ("recorded runs", f"{len(self.y)}, the input is replayed"),
            ("recorded state", f"{self.nx} components" if self.nx else "none: only the innovation can be judged"),
            ("missing measurements", self.recorded.gaps or "none"),
        ]

    def draw(self, parameters: ParameterValues, rngs: Generators, n_steps: int) -> Rows:
        """Return the files of runs 0, 1, ..; `start` knows the indices of the runs."""
        return np.arange(len(rngs)) % len(self.y)

    def start(self, delta: Rows, x0: States, runs: RunInfo) -> Rows:
        """Return the file of every run."""
        return np.asarray(runs.index, dtype=int)

    def first_state(self, delta: Rows, x0: States) -> States:
        """Return the recorded x(0)."""
        first: Array = self.x[delta, 0]
        return first

    def step(self, k: int, delta: Rows, x: States, u: Inputs, w: Noises) -> Motion:
        """Return the recorded x(k+1)."""
        return Motion(self.x[delta, k + 1], np.zeros(len(delta), dtype=np.int8))

    def output(self, k: int, delta: Rows, x: States, v: Noises) -> Outputs:
        """Return the recorded y(k)."""
        y: Array = self.y[delta, k] + v
        return y


def design(
    Ts: float,
    n_steps: int,
    *,
    data: DataFiles,
    columns: Columns = Columns(),
    t: str | None = None,
    resample: Resample | None = None,
) -> RecordedPlant:
    """Recorded runs from csv or npz files in place of a simulated plant.

    Without the state x there are only metrics of the innovation: nis, innovation_mse and whiteness.

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    data : a file, or a pattern such as 'runs/*.csv': file i, sorted by name, is run i
    columns : names of the columns; an empty cell or NaN in y is a missing measurement
    t : name of the column of the time [s]; without it the rows are Ts apart
    resample : how to find y and x between recorded samples; the input is held; without it, other steps than Ts are
        refused

    Raises
    ------
    DesignError
        If a file is not such a table, is too short, or misses an input or a state.
    """
    reader = _Reader(Ts, n_steps, columns, t, resample)
    runs = [reader.run(file) for file in data]
    y, u, x = (np.array(each) for each in zip(*runs, strict=True))
    numbers = [each for each in (y, u, x) if each.size and not np.isnan(each).all()]
    scale = max(1.0, *(float(np.nanmax(np.abs(each))) for each in numbers)) if numbers else 1.0
    signal = RecordedInput(u)
    recorded = RecordedRuns(signal, len(data), _gaps(y, data), scale)
    return RecordedPlant(Ts, y, x, signal, _names(columns, {"y": y, "u": u, "x": x}), recorded)


@dataclass(frozen=True)
class _Reader:
    """Reads the signals of a file at the samples of the experiment."""

    Ts: float
    n_steps: int
    columns: Columns
    t: str | None
    resample: Resample | None

    def run(self, file: File) -> tuple[Array, Array, Array]:
        """Return y and u and x of a file."""
        table, n = read_table(file), self.n_steps + 1
        time = None if self.t is None else columns_of(table, self.t, file, "t")[:, 0]
        names = {"y": self.columns.y, "u": self.columns.u or (), "x": self.columns.x or ()}
        given = {signal: columns_of(table, each, file, "columns") for signal, each in names.items()}
        sampling = Sampling(time, len(given["y"]), self.Ts, self.resample, file)
        if sampling.n_samples < n:
            text = f"has {sampling.n_samples} samples at a step of {self.Ts:g}, and the experiment needs {n}"
            raise DesignError(f"{file.name}: {text}; choose a shorter `time`", "data")
        y, x = sampling.measured(given["y"])[:n], sampling.values(given["x"])[:n]
        for name, values in (("y", y), ("x", x)):
            if np.isinf(values).any() or (name == "x" and np.isnan(values).any()):
                k = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
                text = f"{name} is {'missing' if np.isnan(values[k]).any() else 'infinite'} at sample {k}"
                raise DesignError(f"{file.name}: {text}; leave the column or the file out", "columns")
        return y, inputs(sampling, given["u"], self.n_steps, file, None if self.t is None else "previous"), x


def _gaps(y: Float[Array, "files samples ny"], files: Sequence[File]) -> str:
    """Say where measurements are missing."""
    missing = np.asarray(np.isnan(y).any(axis=2))
    with_gaps = np.flatnonzero(missing.any(axis=1))
    if not len(with_gaps):
        return ""
    first, k = files[with_gaps[0]].name, int(np.argmax(missing[with_gaps[0]]))
    runs = f"{len(with_gaps)} of {len(y)} runs"
    return f"{int(missing.sum())} samples in {runs}, the first at sample {k} of {first}"


def _names(columns: Columns, signals: Mapping[str, Array]) -> dict[str, str]:
    """Return the names of the columns, as names of the components that they are."""
    found: dict[str, str] = {}
    for signal, values in signals.items():
        given = getattr(columns, signal) or ()
        names = [given] if isinstance(given, str) else [*given]
        if len(names) == values.shape[2]:
            found |= {f"{signal}.{i}": name for i, name in enumerate(names) if name != f"{signal}.{i}"}
    return found
