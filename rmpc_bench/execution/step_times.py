"""How long estimators and controllers take, from the stored durations of their calls."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from rmpc_bench.analysis.run_notes import RunNotes
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.execution.stored_experiment import StoredExperiment, StoredPoint
from rmpc_bench.simulation.block_times import BLOCK
from rmpc_bench.store.rows import Durations
from rmpc_bench.store.store import Store


def with_step_times(
    notes: Mapping[str, RunNotes], experiment: StoredExperiment, point: StoredPoint, store: Store
) -> dict[str, RunNotes]:
    """Add the times per step, where a component of some method has been called run by run, or methods are ranked."""
    stored = {name: store.durations(point.methods[name].key, experiment.n_runs) for name in notes}
    if not (experiment.ranks or any(map(_is_own, stored.values()))):
        return dict(notes)
    medians = {
        name: {phase: _printed(each.quantile(0.5)) for phase, each in found.items()} for name, found in stored.items()
    }
    return {name: replace(each, seconds_per_step=_step_time(medians[name])) for name, each in notes.items()}


def with_timings(trials: Trials, timings: pd.DataFrame) -> Trials:
    """Return trials with the times per step that follow from a table of `timings`, such as that of an archive."""
    if trials.points:
        return replace(trials, points=tuple(with_timings(table, timings) for table in trials.points))
    for path, value in trials.point.items():
        timings = timings[timings[path].astype(str) == value]
    medians: dict[str, dict[str, float]] = {name: {} for name in trials.notes}
    for row in timings.to_dict("records"):
        phase = "" if row["phase"] == "step" else f", {row['phase']}"
        medians.setdefault(row["method"], {})[f"{row['component']}{phase}"] = row["median_s"]
    notes = {name: replace(each, seconds_per_step=_step_time(medians[name])) for name, each in trials.notes.items()}
    return replace(trials, notes=notes)


def _printed(seconds: float) -> float:
    return float(f"{seconds:.4g}")


def _is_own(durations: Mapping[str, Durations]) -> bool:
    """Whether calls for single runs have been timed."""
    return any(not phase.endswith(f", {BLOCK}") for phase in durations)


def _step_time(medians: Mapping[str, float]) -> float | None:
    """Return the median time of a step of estimator and controller together [s]; None where one is not known."""
    found = [medians.get(role, medians.get(f"{role}, {BLOCK}")) for role in ("estimator", "controller")]
    known = [each for each in found if each is not None]
    return sum(known) if len(known) == len(found) else None


def timings(experiment: StoredExperiment, store: Store) -> pd.DataFrame:
    """Read how long the calls of components took: sweep columns, method, component, phase, calls and quantiles.

    The phase is ``step``, ``first step`` (which may compile) or ``start``; ``block`` is the time per run and step of a
    component that computes all runs of a block at once, with every run as a call.  The quantiles have the relative
    error of a histogram (`Durations`), 1 %.  They differ from computation to computation.  Without components that are
    called run by run, and without ranks, there are none.
    """
    rows, has_own = [], False
    for point in experiment.points:
        for name, method in point.methods.items():
            stored = store.durations(method.key, experiment.n_runs)
            has_own = has_own or _is_own(stored)
            for component, durations in stored.items():
                part, _, phase = component.partition(", ")
                seconds = [durations.quantile(0.5), durations.quantile(0.95), durations.largest]
                share = seconds[1] / point.Ts if point.Ts else math.nan
                numbers = [_printed(value) for value in (*seconds, share)]
                rows.append([*point.coordinates.values(), name, part, phase or "step", durations.n, *numbers])
    names = ("method", "component", "phase", "calls", "median_s", "q95_s", "largest_s", "q95_share_of_Ts")
    return pd.DataFrame(rows if has_own or experiment.ranks else [], columns=[*experiment.paths, *names])
