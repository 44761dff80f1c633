"""Captions of figures, and the titles of points of a sweep.

A caption is plain text with formulas as ``$..$``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from rmpc_bench.figures.labels import name_of

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.types import MetricInfo


def joined(words: Iterable[str]) -> str:
    """Join words as a sentence does: ``a, b and c``."""
    *first, last = list(words) or [""]
    return f"{', '.join(first)} and {last}" if first else last


def sentence(*parts: str) -> str:
    """Make one sentence of the parts that are not empty."""
    return f"{'; '.join(filter(None, parts))}."


def quantity(info: MetricInfo) -> str:
    """Name a metric with its unit, such as ``MSE [rad^2]``."""
    return f"{info.words} [{info.unit}]" if info.unit else info.words


def at_point(title: str) -> str:
    """Name the point of a sweep that a figure of one point shows; empty without a sweep."""
    return f" at {title}" if title else ""


def runs_sentence(points: Sequence[Trials], methods: Sequence[str]) -> str:
    """Say how many runs there are, and which methods failed in how many of them."""
    sizes = sorted({len(point.runs) for point in points}) or [0]
    n = f"n = {sizes[0]}" if len(sizes) == 1 else f"n = {sizes[0]} to {sizes[-1]}"
    noun = "run" if sizes == [1] else "runs"
    failed = []
    for point in points:
        where = f" at {short_title(point)}" if len(points) > 1 else ""
        failed += [f"{name_of(point, name)} {point.n_failed(name)}{where}" for name in methods if point.n_failed(name)]
    if not failed:
        return f"{n} {noun} of every method; no run failed"
    return f"{n} {noun} of every method; failed runs are left out ({', '.join(failed)})"


def short_title(point: Trials) -> str:
    """Name a point by the last parts of its paths, such as ``Hp=10, Hu=8``; by whole paths if these are not unique.

    A value of several words, such as ``pi first``, stands without its path if it is the only one.  A point whose values
    share a name has its title, shortened in the same way.
    """
    # The title has only the name of values that change together.
    title = f", {point.title}, "
    named = "name" in point.point
    shown = {path: text for path, text in point.point.items() if not named or f", {path}={text}, " in title}
    last = [path.rpartition(".")[2] for path in shown]
    names = last if len(set(last)) == len(last) else list(shown)
    phrases = [text for text in shown.values() if re.search(r"\w \w", text)]
    words = [text if phrases == [text] else f"{name}={text}" for name, text in zip(names, shown.values(), strict=True)]
    if not named:
        return printed(", ".join(words))
    for (path, text), word in zip(shown.items(), words, strict=True):
        title = title.replace(f", {path}={text}, ", f", {word}, ")
    return printed(title[2:-2])


def printed(title: str) -> str:
    """Write the signs of a title as they are printed: a minus in front of a number, a cross between factors.

    Examples
    --------
    >>> printed("delta from -1 to 1, noise x 0.01, 1e-5, run-2")
    'delta from −1 to 1, noise × 0.01, 1e-5, run-2'
    """
    return re.sub(r"(?<= )x(?= \.?\d)", "×", re.sub(r"(?<![\w.)\]-])-(?=\.?\d)", "−", title))
