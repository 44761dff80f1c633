"""Warnings that `run` prints before the first run and `check` in its report.

Those of the configuration concern what its author probably does not mean; the others concern what makes the results
useless although every run may end well.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rmpc_bench.config_file.component import build_component
from rmpc_bench.diagnostics import run_warnings
from rmpc_bench.simulation.threads import single_thread

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig

MAX_POINTS = 12
"""Points of a sweep that are examined, the first ones."""


def warning_texts(config: ExperimentConfig) -> list[str]:
    """Return one text per warning; equal warnings of the points of a sweep share one.

    Parameters
    ----------
    config : from `load_config`
    """
    found: dict[str, list[str]] = {}
    with single_thread():
        for point in config.points[:MAX_POINTS]:
            for text in run_warnings.run_warnings(point.experiment, point.methods, build_component):
                found.setdefault(text, []).append(point.title)
    n_points = len(config.points[:MAX_POINTS])
    return [
        *map(str, config.warnings),
        *(
            text + (f" (at {', '.join(titles[:2])}{' ..' * (len(titles) > 2)})" if n_points > 1 else "")
            for text, titles in found.items()
        ),
    ]
