"""Checks of the keys `evaluate` and `record`: whether exact moments are available, and recorded signals exist."""

from __future__ import annotations

from collections.abc import Sequence

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.moments import exact_laws
from rmpc_bench.simulation.recording import BURSTS, COVARIANCE, SIGNALS, has_bursts
from rmpc_bench.simulation.scenario import Experiment


def check_evaluation(draft: DraftConfig, experiment: Experiment) -> None:
    """Add an error for every method without exact moments if no runs are evaluated: nothing would be computed."""
    wanted = draft.values["evaluate"]
    if "runs" in wanted:
        return
    if "moments" not in wanted:
        draft.note(["evaluate"], "an ensemble is one of runs: evaluate: [runs, ensemble]")
        return
    for method in experiment.methods:
        laws = exact_laws(experiment.plant, method, experiment.scenario)
        if isinstance(laws, str):
            draft.note(["evaluate"], f"{method.name} has no exact moments: {laws}; evaluate: [runs, moments]")


def check_recording(draft: DraftConfig, experiments: Sequence[Experiment | None]) -> None:
    """Add an error to the first draft for every signal to record that does not exist at any point of the sweep."""
    found = [experiment for experiment in experiments if experiment is not None]
    if len(found) < len(experiments):
        return
    there = [*SIGNALS, COVARIANCE]
    there += [name for experiment in found for method in experiment.methods for name in method.reports]
    there += [name for experiment in found for name in experiment.plant.extra_signals]
    there += [BURSTS for experiment in found if has_bursts(experiment.scenario)]
    for number, name in enumerate(draft.values["record"].signals):
        if name not in there:
            draft.note(["record", "signals", number], unknown(name, dict.fromkeys(there), "signal"))
