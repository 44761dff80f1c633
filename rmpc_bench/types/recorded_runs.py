"""What is known of a plant whose runs were recorded elsewhere."""

from __future__ import annotations

from typing import NamedTuple

from rmpc_bench.types.input_signal import InputSignal


class RecordedRuns(NamedTuple):
    """The recorded runs of a plant; their inputs take the place of a controller."""

    input: InputSignal
    n_runs: int
    """Number of recorded runs."""
    gaps: str
    """Where measurements are missing, in words; empty where none are."""
    scale: float
    """Largest magnitude of a recorded number, at least 1."""
