"""Inputs limited to the bounds of a plant."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, NamedSignals, RunInfo


def limited_inputs(signals: NamedSignals, u: Float[Array, "runs nu"], runs: RunInfo | None) -> Float[Array, "runs nu"]:
    """Return the inputs within their bounds; those of running runs that were beyond are counted.

    Parameters
    ----------
    signals : of the plant, with the bounds
    u : (runs, nu) inputs
    runs : what counts; None outside a simulation
    """
    limited = np.clip(u, *signals.limits(signals.inputs))
    if runs is not None:
        beyond = np.isfinite(u) & (u != limited) & runs.alive[:, None]
        for j in np.flatnonzero(beyond.any(axis=0)).tolist():
            name = signals.inputs[j]
            runs.journal.warnings[f"input {name} limited to {signals.bounds_text(name)}"] += int(beyond[:, j].sum())
    return limited
