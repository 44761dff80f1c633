"""Formulas of figures: matplotlib reads each of them once per resolution, whichever renderer asks for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

MOST = 2000
"""Formulas that are kept; matplotlib keeps 50 for each renderer, and makes a renderer for every file."""


@contextmanager
def formulas_once() -> Iterator[None]:
    """Keep the formulas that matplotlib reads inside the block, for all figures of this process.

    Reading a formula takes about 4 ms, and a label with one stands in every format of several figures.
    """
    from matplotlib.mathtext import MathTextParser

    parser: Any = MathTextParser
    usual = getattr(parser, "_parse_cached", None)
    # The names inside matplotlib may change; its own cache is then used as it is.
    if usual is None or not hasattr(usual, "__wrapped__"):
        yield
        return

    def parsed(self: Any, *settings: Any) -> Any:
        return _parsed(self._output_type, _Reader(self, usual.__wrapped__), *settings)

    parser._parse_cached = parsed
    try:
        yield
    finally:
        parser._parse_cached = usual


class _Reader:
    """Reads a formula; all readers are equal, as the kind of output is an argument of its own."""

    def __init__(self, parser: Any, read: Any) -> None:
        self.parser, self.read = parser, read

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Reader)

    def __hash__(self) -> int:
        return 0


@lru_cache(maxsize=MOST)
def _parsed(output: str, reader: _Reader, *settings: Any) -> Any:
    del output
    return reader.read(reader.parser, *settings)
