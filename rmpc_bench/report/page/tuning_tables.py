"""How the parameters were chosen, on a page: values, regret, ranks and cost."""

from __future__ import annotations

from collections.abc import Sequence

from rmpc_bench.report.page.blocks import Block, Text, bullets, folded, paragraph, table
from rmpc_bench.report.tuning_sentences import EXPLANATION
from rmpc_bench.report.tuning_table import TuningTable


def tuning_blocks(tuning: TuningTable | None, methods: Sequence[str]) -> list[Block]:
    """Return the protocol, and for each point the tables of values and ranks with their sentences; nothing untuned.

    A row can be hidden by the place of its method among all methods of the experiment.
    """
    if tuning is None or not tuning.outcomes:
        return []
    points = [_point_blocks(*point, methods) for point in tuning.tables]
    first, rest = points[0], [block for point in points[1:] for block in point]
    blocks = [paragraph(tuning.protocol), *first]
    blocks += folded(f"{len(points) - 1} more point{'s' * (len(points) > 2)} of the sweep", rest)
    if tuning.n_left:
        blocks.append(
            paragraph(f"{tuning.n_left} more point{'s' * (tuning.n_left > 1)} of the sweep: tuning.csv", "note")
        )
    return [*blocks, paragraph(f"Cost: {tuning.cost}."), paragraph(EXPLANATION, "note")]


def _point_blocks(
    title: str,
    values: dict[str, list[str]],
    ranks: dict[str, list[str]],
    sentences: Sequence[str],
    methods: Sequence[str],
) -> list[Block]:
    where = f" ({title})" if title else ""
    blocks = [table(f"Tuned parameters{where}", {**values}, methods=_numbers(values["method"], methods))]
    if ranks:
        caption = f"Ranks on the runs of the experiment{where}"
        blocks.append(table(caption, {**ranks}, methods=_numbers(ranks["method"], methods)))
    items: list[Text] = [*sentences]
    return [*blocks, *bullets(items)]


def _numbers(names: Sequence[str], methods: Sequence[str]) -> list[int | None]:
    return [methods.index(name) if name in methods else None for name in names]
