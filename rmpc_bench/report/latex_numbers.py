"""Cells of a table as LaTeX: the same digits as on the page, set as formulas."""

from __future__ import annotations

import re

from rmpc_bench.report.latex_text import to_latex, unit_latex

_NUMBER = r"[-+]?(?:\d+(?:\.\d+)?|inf)(?:e[-+]?\d+)?"
_TOKEN = re.compile(
    rf"(?P<number>{_NUMBER})|(?P<percent>%)|(?P<power>(?<=\))e[-+]?\d+)|(?P<word>[A-Za-z][\w^.-]*)|(?P<sign>[\[\],/<()\u00b1\u00d7])|(?P<gap>\s+)"
)
_SIGNS = {"\u00b1": r"\pm", "\u00d7": r"\times "}
_EXPONENT = re.compile(r"e([-+]?)0*(\d+)")
_IS_NUMBER = re.compile(rf"[<(\u00d7]?\s*{_NUMBER}")


def number_latex(cell: str) -> str:
    r"""Write a cell such as ``-10.9 % [-12.1, -9.7]`` as a formula; the digits are those of the cell.

    It has numbers with half an interval, an interval, unit or counts; words stay words.

    Examples
    --------
    >>> print(number_latex("−10.9 % [−12.1, −9.7]"), number_latex("1.2e-05"), number_latex("-"), number_latex("×2.6"))
    $-10.9\,\%\ [-12.1, -9.7]$ $1.2\times 10^{-5}$ -- $\times 2.6$
    """
    cell = cell.replace("\u2212", "-")
    if cell.strip() in ("", "-"):
        return "--"
    if not _IS_NUMBER.match(cell):
        return to_latex(cell.replace("$", r"\$"))
    parts, end = [], 0
    for token in _TOKEN.finditer(cell):
        if token.start() > end:
            return to_latex(cell.replace("$", r"\$"))
        parts.append(_part(token, cell))
        end = token.end()
    return f"${''.join(parts)}$" if end == len(cell) else to_latex(cell.replace("$", r"\$"))


def _part(token: re.Match[str], cell: str) -> str:
    text = token[0]
    if text in _SIGNS:
        return _SIGNS[text]
    if token["number"] or token["power"]:
        power = _EXPONENT.sub(lambda found: rf"\times 10^{{{found[1].strip('+')}{found[2]}}}", text)
        return power.replace("inf", r"\infty")
    if token["percent"]:
        return r"\%"
    if token["word"]:
        return rf"\mbox{{{unit_latex(text)}}}"
    if token["gap"]:
        # A comma of a formula has its own distance; a unit stands near its number, an interval further away.
        before, after = cell[: token.start()], cell[token.end() :]
        if before.endswith(",") or before.endswith("<"):
            return " "
        return r"\ " if after.startswith(("[", "(")) else r"\,"
    return text
