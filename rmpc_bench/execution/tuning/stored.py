"""How the parameters of a stored experiment were chosen; nothing is simulated and no configuration is read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rmpc_bench.execution.tuning.record import read_record, read_seconds
from rmpc_bench.types.tuning import Tuning

if TYPE_CHECKING:
    from rmpc_bench.execution.stored_experiment import StoredExperiment


def tuning_of(experiment: StoredExperiment, directory: Path) -> Tuning | None:
    """Return the searches that tuning.json has, None where nothing is tuned; a StoreError for a damaged file."""
    stored = experiment.tuning
    if stored is None:
        return None
    found, seconds = read_record(directory), read_seconds(directory)
    searches = [
        found[key].search(point, method, key, stored.protocol, seconds.get(key, 0.0))
        for point, method, key in stored.searches
        if key in found
    ]
    return Tuning(stored.protocol, tuple(searches), experiment.origins)
