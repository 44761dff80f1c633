"""Sentences that captions share: who is shown, how many runs there are, which failed, and the main numbers.

A caption is plain text with formulas as ``$..$``.  Its numbers are written by the functions that write those of the
tables, so that the same number has the same digits everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.analysis.comparison_text import margin_text, size_text, verdict_text
from rmpc_bench.analysis.intervals import quantiles
from rmpc_bench.analysis.number_text import median_text
from rmpc_bench.analysis.parameter_text import untuned_name
from rmpc_bench.figures.compared_rows import compared_rows
from rmpc_bench.figures.labels import DID_NOT_OCCUR
from rmpc_bench.figures.sweep_points import short_title

if TYPE_CHECKING:
    from rmpc_bench.analysis.comparison import Levels
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.figures.window import TimeWindow
    from rmpc_bench.types import MetricInfo

MOST_NUMBERS = 8
"""Methods times points up to which a caption states the number of each."""


def joined(words: Iterable[str]) -> str:
    """Join words as a sentence does: ``a, b and c``."""
    *first, last = list(words) or [""]
    return f"{', '.join(first)} and {last}" if first else last


def sentences(*parts: str) -> str:
    """Join parts of a caption, each a sentence or empty, and end every one with a full stop."""
    return " ".join(part if part.endswith(".") else f"{part}." for part in parts if part)


def quantity(info: MetricInfo) -> str:
    """Name a metric with its unit, such as ``MSE [rad^2]``."""
    return f"{info.words} [{info.unit}]" if info.unit else info.words


def label_of(trials: Trials, method: str) -> str:
    """Return the text that stands for a method in figures."""
    return trials.labels.get(method, method)


def place(trials: Trials, title: str) -> str:
    """Name the point of a sweep that a figure of one point shows; empty without a sweep."""
    return f"Shown is the point {title}" if title else ""


def span_of(window: TimeWindow) -> str:
    """Name the samples that a figure shows, such as ``t = 0 to 20 s``."""
    first, last = (f"{end:g}" for end in window.limits)
    return f"t = {first} to {last} s" if window.in_seconds else f"k = {first} to {last}"


def runs_sentence(points: Sequence[Trials], methods: Sequence[str]) -> str:
    """Say how many runs there are, and which methods failed in how many of them."""
    sizes = sorted({int(point.computed(name).sum()) for point in points for name in methods if name in point.methods})
    sizes = sizes or [0]
    n = f"n = {sizes[0]}" if len(sizes) == 1 else f"n = {sizes[0]} to {sizes[-1]}"
    noun = "run" if sizes == [1] else "runs"
    failed = []
    for point in points:
        where = f" at {short_title(point)}" if len(points) > 1 else ""
        failed += [f"{label_of(point, name)} {point.n_failed(name)}{where}" for name in methods if point.n_failed(name)]
    if not failed:
        return f"{n} {noun} of every method; no run failed"
    return f"{n} {noun} of every method; failed runs are left out ({', '.join(failed)})"


def infinite_sentence(points: Sequence[Trials], methods: Sequence[str], info: MetricInfo) -> str:
    """Count the runs in which the event of a metric did not occur; empty if it always did."""
    found = []
    for point in points:
        where = f" at {short_title(point)}" if len(points) > 1 else ""
        for name in methods:
            n = int(np.isinf(point.column(info.name, name)).sum())
            found += [f"{label_of(point, name)} {n}{where}"] if n else []
    if not found:
        return ""
    return f"Runs in which it {DID_NOT_OCCUR} lie in the grey strip, above every other value ({', '.join(found)})"


def medians_sentence(points: Sequence[Trials], methods: Sequence[str], info: MetricInfo) -> str:
    """State the medians with the quartiles, as the table of the metric does; empty for too many of them."""
    if len(points) * len(methods) > MOST_NUMBERS:
        return ""
    found = []
    for point in points:
        where = f" at {short_title(point)}" if len(points) > 1 else ""
        for name in methods:
            values = point.column(info.name, name)
            values = values[~np.isnan(values)]
            if len(values):
                low, middle, high = map(float, quantiles(values, [0.25, 0.5, 0.75]))
                found.append(f"{label_of(point, name)} {median_text(middle, low, high, len(values))}{where}")
    unit = f" in {info.unit}" if info.unit else ""
    return f"Medians [quartiles]{unit}: {'; '.join(found)}" if found else ""


def changes_sentence(
    point: Trials, methods: Sequence[str], info: MetricInfo, of: Levels | None = None, *, title: str = ""
) -> str:
    """State the paired change of every method against the baseline with its interval and verdict, as the table does.

    Levels of intervals are those of this table alone unless `of` is given.  The title is that of a point, where several
    are shown.
    """
    others = [name for name in methods if name != point.baseline]
    if not others or point.baseline not in point.methods:
        return ""
    rows = compared_rows(point, info, of)
    found = []
    for name in others:
        row = rows.get(name)
        if row is None:
            # An interrupted sweep has no run of some methods at some points.
            found.append(f"{label_of(point, name)} has no runs")
            continue
        words = [size_text(row, info), verdict_text(row, margin_text(point, info, row))]
        text = ": ".join(word for word in words if word and word != "-")
        counts = f"{row['won']} won, {row['lost']} lost, {row['tied']} tied"
        found.append(f"{label_of(point, name)} {text or counts}")
    where = f" at {title}" if title else ""
    baseline = untuned_name(point, point.baseline, label_of(point, point.baseline))
    return f"Change in paired runs against {baseline}{where}: {'; '.join(found)}"
