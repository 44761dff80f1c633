"""The section `stop` in a configuration: its defaults, and what it needs of the other sections."""

from __future__ import annotations

from dataclasses import replace

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.stop_section import EVERY


def apply_stop(draft: DraftConfig, *, fixed: bool) -> None:
    """Fill in the defaults of the rule, and take its largest number of runs in place of that of the file.

    If the command line gives the number of runs (`fixed`), there is no rule.
    """
    values = draft.values
    stop, runs = values["stop"], values["runs"]
    if stop is None or runs is None:
        return
    if fixed:
        values["stop"] = None
        return
    stop = replace(stop, min_runs=stop.min_runs or runs, every=None if stop.decide else stop.every or EVERY)
    if stop.min_runs > stop.max_runs:
        given = "min_runs" if "min_runs" in draft.tree["stop"] else "runs"
        message = f"must be at least the number of runs at the first look, {given}: {stop.min_runs}"
        draft.note(["stop", "max_runs"], f"{message} (got {stop.max_runs})")
    values["stop"], values["runs"] = stop, stop.max_runs


def check_stop(draft: DraftConfig) -> None:
    """Refuse a rule of the first draft that has nothing to decide on."""
    stop = draft.values["stop"]
    if stop is None:
        return
    if "runs" not in draft.values["evaluate"]:
        draft.note(["stop"], "nothing is computed run by run here; evaluate: [runs, ...]", key=True)
    if stop.decide and not any(claim is None or claim.check for claim in draft.claims):
        draft.note(["stop", "decide"], "this configuration has no claim with a check")
