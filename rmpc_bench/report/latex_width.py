"""Width of a table in LaTeX, estimated from its source: whether it fits into a column of a paper."""

from __future__ import annotations

import re
from collections.abc import Sequence

SIZE = 8.0
"""Size of the text of a table [pt], that of `\\footnotesize`."""
_WIDTHS = {
    **dict.fromkeys("ijl.,;:|'/ ", 0.30),
    **dict.fromkeys("ftrI-()[]", 0.40),
    **dict.fromkeys("mwMW%", 0.90),
    **dict.fromkeys("ABCDEFGHJKLNOPQRSTUVXYZ", 0.72),
    **dict.fromkeys("0123456789", 0.53),
    **dict.fromkeys("=<>+−", 1.0),
}
"""Width of a character in units of the size, of the wider of Times and Computer Modern; 0.5 for the others."""
_SCRIPT = re.compile(r"[\^_](?:\{([^{}]*)\}|(\S))")
_INVISIBLE = re.compile(
    r"\\begin\{tabular\}\[b\]\{@\{\}c@\{\}\}|\\end\{tabular\}|\\(?:mbox|mathrm|textit|text\w+)\b|[${}]"
)
_COMMAND = re.compile(r"\\([A-Za-z]+) ?")


def width_of(cell: str) -> float:
    """Estimate the width [pt] of the widest line of a cell of LaTeX."""
    return max(_line(line) for line in cell.split(r"\\"))


def _line(text: str) -> float:
    text = text.replace(r"\ ", " ").replace(r"\,", ".").replace(r"\times", "++").replace(r"\%", "%").replace(r"\_", "n")
    text = re.sub(r"(?<=[$\s\[/])[-+](?=[\d\\])", "+", text)
    scripts = "".join(found[1] or found[2] for found in _SCRIPT.finditer(text))
    plain = _COMMAND.sub("m", _INVISIBLE.sub("", _SCRIPT.sub("", text)))
    return SIZE * (_sum(plain) + 0.7 * _sum(_COMMAND.sub("m", scripts)))


def _sum(text: str) -> float:
    return sum(_WIDTHS.get(each, 0.5) for each in text)


def table_width(head: Sequence[str], rows: Sequence[Sequence[str]], gap: float) -> float:
    """Estimate the width of a table [pt]; the gap between columns is in units of the size of the text."""
    columns = zip(*[head, *rows], strict=True)
    return sum(max(map(width_of, column)) for column in columns) + gap * SIZE * (len(head) - 1)
