"""The key `calibration`: its checks, and the metrics that it adds to those of the experiment."""

from __future__ import annotations

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Map, Mark, locate
from rmpc_bench.types.metric import CalibrationKeys


def read_calibration(draft: DraftConfig) -> None:
    """Replace `true` by the defaults and `false` by None; the level of the verdict is one of the levels."""
    keys = draft.values["calibration"]
    draft.values["calibration"] = keys = CalibrationKeys() if keys is True else keys or None
    if keys is None:
        return
    levels = ", ".join(f"{100 * level:g}%" for level in keys.levels)
    if keys.verdict not in keys.levels:
        draft.note(["calibration", "verdict"], f"{100 * keys.verdict:g}% is not among levels [{levels}]")
    if len({*map(keys.name, keys.levels)}) < len(keys.levels):
        draft.note(["calibration", "levels"], f"must name each level once (got [{levels}])")
    if "runs" not in draft.values["evaluate"]:
        draft.note(["calibration"], "counts errors of runs, but no runs are evaluated: add `runs` to `evaluate`")


def shares(draft: DraftConfig, nx: int) -> list[Component]:
    """Return the metrics of every level, for all states and, of several, for each; none where the key has an error."""
    keys, path = draft.values["calibration"], ["calibration"]
    if keys is None or any(problem.path.startswith("calibration") for problem in draft.problems):
        return []
    found, mark = [], Mark(*locate(draft.tree, path))
    for of in ("joint", *(f"x.{i}" for i in range(nx) if nx > 1)):
        for level in keys.levels:
            given = {"kind": "coverage", "name": keys.name(level, of), "level": level, "of": of}
            given |= {} if keys.from_ is None else {"from": keys.from_}
            found.append(draft.component("metrics", Map(given, mark=mark), path))
    return [component for component in found if component is not None]
