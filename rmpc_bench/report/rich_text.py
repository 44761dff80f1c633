"""Plain text with formulas between dollar signs, such as labels and captions, for HTML and Markdown."""

from __future__ import annotations

import re
from html import escape

from rmpc_bench.report.mathml import FormulaError, mathml

_FORMULA = re.compile(r"(?<!\\)\$((?:\\.|[^$\\])+)\$", re.DOTALL)
_MINUS = re.compile(r"(?<![\w.)\]])-(?=\d)")
"""The sign of a number; hyphens in names such as R-MPC1 and in dates stay."""
_INTERVAL = re.compile(r"\[[-+\u2212]?(?:\d[\d.e+-]*|inf), [-+\u2212]?(?:\d[\d.e+-]*|inf)\]")
_PER_CENT = re.compile(r"(?<=\d) %(?: (?=\[)|)")
_RAISED = re.compile(r"(?<=[A-Za-z])\^(-?\d+)")
"""Exponent of a unit, such as rad^2."""
_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#|~$])")
_LIST_MARK = re.compile(r"^(\s*)([-+]|\d+[.)])(?=\s)")


def to_html(text: str) -> str:
    r"""Write a text as HTML; formulas become MathML, and one that is not covered stays as it is.

    Numbers have a minus sign, intervals are not broken, and ``\$`` is a dollar sign.

    Examples
    --------
    >>> to_html("R-MPC <1>, $c$")
    'R-MPC &lt;1&gt;, <math><mi>c</mi></math>'
    """
    found, end = [], 0
    for formula in _FORMULA.finditer(text):
        try:
            element = mathml(formula[1])
        except FormulaError:
            continue
        found += [_plain(text[end : formula.start()]), element]
        end = formula.end()
    return "".join([*found, _plain(text[end:])])


def _plain(text: str) -> str:
    text = _MINUS.sub("\u2212", text.replace(r"\$", "$"))
    text = _INTERVAL.sub(lambda found: found[0].replace(" ", "\u00a0"), text)
    return _RAISED.sub(
        r"<sup>\1</sup>", escape(_PER_CENT.sub(lambda found: found[0].replace(" ", "\u00a0"), text))
    ).replace("<sup>-", "<sup>\u2212")


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
            mathml(formula[1])
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


def plain_text(text: str) -> str:
    r"""Write a text without the marks of formulas, for readers who hear it.

    Examples
    --------
    >>> plain_text(r"in $\hat{x}_{1}$")
    'in hat x_1'
    """
    words = re.sub(r"\\([A-Za-z]+)\{?", r" \1 ", text.replace(r"\$", "\0"))
    return " ".join(re.sub(r"[{}$\\]", "", words).replace("\0", "$").split())
