"""Ranks on a page, with what they cannot show."""

from __future__ import annotations

from collections.abc import Sequence

from rmpc_bench.report.page.blocks import Block, bullets, folded, heading, paragraph, table
from rmpc_bench.report.ranks_table import RanksTable

LIMITATIONS = (
    "A rank is that among these methods. Another method may widen or move it.",
    "The points of the sweep have equal weights and are all that the ranks describe: they are chosen, not drawn from a "
    "population of systems, so that the intervals do not hold for other systems.",
    "The intervals contain the chance of the runs only. Where parameters are tuned, another set of tuning runs may "
    "choose other values.",
    "Methods whose ranks overlap are not shown to be equal: the runs do not decide between them.",
)
"""Known limitations of ranks."""


def rank_blocks(ranks: RanksTable | None, methods: Sequence[str]) -> list[Block]:
    """Return the table of ranks, what they cannot show, and sentences to quote; nothing if ranks are not known.

    A row can be hidden by the place of its method among all methods of the experiment.
    """
    columns = {} if ranks is None else ranks.columns
    if ranks is None or not columns:
        return []
    info = ranks.trials.primary_info
    shown = table(
        f"Ranks of {len(ranks.methods)} methods by {info.words if info else 'the metric'}",
        {**columns},
        methods=[methods.index(name) for name in ranks.methods],
        notes=[*ranks.legend],
    )
    return [
        shown,
        heading("Known limitations of the ranks"),
        *bullets([*LIMITATIONS]),
        *folded("Sentences to quote", [paragraph(text) for text in ranks.sentences]),
    ]
