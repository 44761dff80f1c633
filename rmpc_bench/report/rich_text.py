"""Plain text with formulas between dollar signs, such as labels and captions, for HTML and Markdown."""

from __future__ import annotations

import re
from html import escape

from rmpc_bench.report.formulas import FormulaError, formula_html

_FORMULA = re.compile(r"(?<!\\)\$((?:\\.|[^$\\])+)\$", re.DOTALL)
_MINUS = re.compile(r"(?<![\w.)\]])-(?=\d)")
"""The sign of a number; hyphens in names such as R-MPC1 and in dates stay."""
_RAISED = re.compile(r"(?<=[A-Za-z])\^(-?\d+)")
"""Exponent of a unit, such as rad^2."""
_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#|~$])")
_LIST_MARK = re.compile(r"^(\s*)([-+]|\d+[.)])(?=\s)")


def to_html(text: str) -> str:
    r"""Write a text as HTML; a formula that is not covered stays as it is, and ``\$`` is a dollar sign.

    Examples
    --------
    >>> to_html("R-MPC <1>, $c_1$ [rad^2]")
    'R-MPC &lt;1&gt;, c<sub>1</sub> [rad<sup>2</sup>]'
    """
    found, end = [], 0
    for formula in _FORMULA.finditer(text):
        try:
            element = formula_html(formula[1])
        except FormulaError:
            continue
        found += [_plain(text[end : formula.start()]), element]
        end = formula.end()
    return "".join([*found, _plain(text[end:])])


def _plain(text: str) -> str:
    text = _MINUS.sub("\u2212", text.replace(r"\$", "$"))
    return _RAISED.sub(r"<sup>\1</sup>", escape(text)).replace("<sup>-", "<sup>\u2212")


def to_markdown(text: str) -> str:
    r"""Write a text as Markdown of one line; formulas stay, as code hosts set them, and everything else is escaped.

    Examples
    --------
    >>> to_markdown("a|b_c *d*, $c_1$")
    'a\\|b\\_c \\*d\\*, $c_1$'
    """
    line = " ".join(text.split())
    found, end = [], 0
    for formula in _FORMULA.finditer(line):
        try:
            formula_html(formula[1])
        except FormulaError:
            continue
        found += [_literal(line[end : formula.start()]), _inert(formula[0])]
        end = formula.end()
    return _LIST_MARK.sub(r"\1\\\2", "".join([*found, _literal(line[end:])]))


def _inert(formula: str) -> str:
    """Write a formula so that it neither ends the cell of a table nor begins a tag, a link or code."""
    return formula.replace("|", r"\vert ").replace("<", r"\lt ").replace("](", "] (").replace("`", "'")


def _literal(text: str) -> str:
    return _MARKDOWN.sub(r"\\\1", text.replace(r"\$", "$"))
