"""A configuration with what there is to tune in it, and with the values that are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.tuning_plan import Origin, parameter_words, tuning_plan


def with_tuning(config: ExperimentConfig, drafts: Sequence[DraftConfig], origin: Origin) -> ExperimentConfig:
    """Return a configuration that knows its searches; the values that are known are added to its resolved form."""
    plan = tuning_plan(drafts, config.points)
    config = replace(config, parameters=parameter_words(drafts[0], plan))
    if plan is None:
        return config
    rows = [
        {
            **({"at": each.point} if each.point else {}),
            "method": each.method,
            "values": dict(each.values),
            "key": each.carried,
        }
        for each in plan.searches
        if each.values is not None
    ]
    resolved, first = (
        {**tree, "tune": {**tree["tune"], "values": rows}} for tree in (config.resolved, config.first_point)
    )
    return replace(config, tuning=plan, origin=origin, resolved=resolved, first_point=first)
