"""Sentences that captions share: who is shown, how many runs there are, which failed, and the main numbers.

A caption is plain text with formulas as ``$..$``.  Its numbers are written by the functions that write those of the
tables, so that the same number has the same digits everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from rmpc_bench.figures.sweep_points import short_title

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.figures.window import TimeWindow
    from rmpc_bench.types import MetricInfo


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
    sizes = sorted({len(point.runs) for point in points}) or [0]
    n = f"n = {sizes[0]}" if len(sizes) == 1 else f"n = {sizes[0]} to {sizes[-1]}"
    noun = "run" if sizes == [1] else "runs"
    failed = []
    for point in points:
        where = f" at {short_title(point)}" if len(points) > 1 else ""
        failed += [f"{label_of(point, name)} {point.n_failed(name)}{where}" for name in methods if point.n_failed(name)]
    if not failed:
        return f"{n} {noun} of every method; no run failed"
    return f"{n} {noun} of every method; failed runs are left out ({', '.join(failed)})"
