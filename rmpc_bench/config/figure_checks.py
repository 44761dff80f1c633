"""The figures of a configuration, checked against the layout of the results."""

from __future__ import annotations

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.types import Figure, ResultLayout


def check_figures(draft: DraftConfig, layout: ResultLayout) -> None:
    """Report every figure option that the experiment cannot satisfy; of an incomplete layout only names are checked."""
    for number, component in enumerate(draft.figures):
        if component is None:
            continue
        figure: Figure | None = component.build(draft.problems)
        if figure is None:
            continue
        for key, message in figure.check(layout) if layout.is_complete else figure.check_names(layout):
            draft.note(["figures", number, *([key] if key else [])], message)
