"""File names of the figures of an experiment, which its claims refer to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from rmpc_bench.components.code import split_reference


def figure_names(kinds: Iterable[str]) -> tuple[str, ...]:
    """Name the files of figures, without ending: the kind, or the name in a user's file, with a number if repeated.

    Examples
    --------
    >>> figure_names(["boxplot", "rows", "boxplot", "own.py:Picture"])
    ('boxplot', 'rows', 'boxplot-2', 'Picture')
    """
    counts: Counter[str] = Counter()
    names = []
    for kind in kinds:
        parts = split_reference(kind)
        name = kind if parts is None else parts[1]
        counts[name] += 1
        names.append(name if counts[name] == 1 else f"{name}-{counts[name]}")
    return tuple(names)
