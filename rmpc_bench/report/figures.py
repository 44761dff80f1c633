"""Kinds of figures with their keys, at the width of a printed column.

This module is light, because a configuration is checked against its signatures: whoever draws brings matplotlib along.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge, Le

from rmpc_bench.types import DesignError, MetricInfo

Inches = Annotated[float, Ge(1), Le(100)]

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rmpc_bench.analysis.trials import Trials


def boxplot(
    trials: Trials,
    *,
    metric: str | None = None,
    width: Inches = 3.5,
    height: Inches = 2.4,
    log: bool = False,
    order: list[str] | None = None,
) -> Figure:
    """Draw one box per method: red median, blue quartiles, whiskers to 1.5 of their distance, red outliers.

    Below a box stands the number of runs, as n/total where some failed, and how many of them are never; these are
    not part of the box.

    Parameters
    ----------
    trials : the table of trials
    metric : name of the metric; the first one if not given
    width, height : of the whole picture [in]; labels too wide for their box stand upright and add to the height
    log : logarithmic axis; linear nevertheless, and said so, where a value is not positive
    order : methods to show, from left to right; all if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when a metric or method is unknown or the size below an inch
    """
    from rmpc_bench.report.boxplot import draw

    info, methods = _metric(trials, metric), _methods(trials, order)
    for name, size in (("width", width), ("height", height)):
        if not 1 <= size < math.inf:
            raise DesignError(f"must be at least 1 inch (got {size:g})", name)
    return draw(trials, info, methods, (width, height), log=log)


def save(figure: Figure, directory: Path, stem: str) -> list[Path]:
    """Write a picture as SVG and as PNG (200 dpi), with the same bytes every time.

    Parameters
    ----------
    figure : the picture
    directory : where to; made if it is not there
    stem : file name without ending

    Returns
    -------
    the two files
    """
    from rmpc_bench.report.style import style

    directory.mkdir(parents=True, exist_ok=True)
    svg, png = directory / f"{stem}.svg", directory / f"{stem}.png"
    with style():
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
        figure.savefig(png, format="png", dpi=200, metadata={"Software": None})
    return [svg, png]


def _metric(trials: Trials, name: str | None) -> MetricInfo:
    known = {info.name: info for info in trials.metrics}
    if name is None:
        return trials.metrics[0]
    if name not in known:
        raise DesignError(f"'{name}' is not a metric of this experiment (known: {', '.join(known)})", "metric")
    return known[name]


def _methods(trials: Trials, order: list[str] | None) -> Sequence[str]:
    if order is None:
        return trials.methods
    for name in order:
        if name not in trials.methods:
            known = ", ".join(trials.methods)
            raise DesignError(f"'{name}' is not a method of this experiment (known: {known})", "order")
    if not order or len(set(order)) < len(order):
        raise DesignError("must name at least one method, and each one once", "order")
    return order
