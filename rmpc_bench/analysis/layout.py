"""Layout of stored results, so that the same checks of a figure apply to results and to configurations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rmpc_bench.types import ResultLayout

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials


def layout_of(trials: Trials) -> ResultLayout:
    """Return the names and sizes of a table of trials; its `end` is not known.

    The table of a whole sweep has no series or recorded runs of its own.
    """
    of_points = bool(trials.points)
    arrays: dict[str, dict[str, tuple[int, ...]]] = {}
    for each in () if of_points else trials.over_time:
        arrays.setdefault(each.method, {}).setdefault(each.quantity, each.values.shape)
    recorded = {} if of_points else {name: traces for name, traces in trials.traces.items() if len(traces.runs)}
    common = set.intersection(*(set(traces.runs.tolist()) for traces in recorded.values())) if recorded else set()
    return ResultLayout(
        methods=trials.methods,
        metrics=tuple(info.name for info in trials.metrics),
        points=tuple(point.point for point in trials.each),
        has_runs=len(trials.runs) > 0,
        is_uncertain=any(len(point.quantities) > 1 for point in trials.each),
        signals={
            name: {signal: traces.shapes.get(signal, values.shape[2:]) for signal, values in traces.signals.items()}
            for name, traces in recorded.items()
        },
        recorded=sorted(common),
        series={name: shape[1:] for shapes in arrays.values() for name, shape in shapes.items()},
        arrays=arrays,
        tuned=tuple(dict.fromkeys(each.method for each in trials.tuning.searches)) if trials.tuning else (),
    )
