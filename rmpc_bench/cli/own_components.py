"""Output of `check --deep` for the components of a user."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig

WIDTH = 110
"""Characters of a line."""
TITLE = "  own components, checked on the linear system of their design model (all checks: check --component)"


def own_component_lines(config: ExperimentConfig) -> tuple[list[str], bool]:
    """Check the own components of the first point.

    Parameters
    ----------
    config : a valid configuration

    Returns
    -------
    The lines, none where all components are built in; and whether a check of the class `error` has failed.
    """
    from rmpc_bench.conformance.kit import check_own_components

    lines: list[str] = []
    failed = False
    for each in check_own_components(config.experiment):
        if each.report is None:
            lines.append(f"    {each.method}: {each.text}: not checked: {each.reason}")
            continue
        failed |= not each.report.passed
        where = f" ({each.reason})" if each.reason else ""
        lines.append(f"    {each.method}: {each.text}: {each.report.summary()}{where}")
        for result in each.report.results:
            if result.status in ("failed", "expected"):
                word = result.severity if result.status == "failed" else "expected"
                lines += [f"      {line}" for line in wrap(f"{word} {result.id}: {result.reason}", WIDTH)]
    return (["", TITLE, *lines] if lines else []), failed
