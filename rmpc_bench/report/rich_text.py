"""Plain text with formulas between dollar signs, such as labels and captions, for HTML and Markdown.

Covered are indices, exponents, Greek letters, accents and common operators.  A fraction is written in one line, and a
prime is U+2032.
"""

from __future__ import annotations

import re
from html import escape

GREEK = {
    name: chr(code)
    for names, first in (
        ("alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi omicron pi rho", 0x3B1),
        ("sigma tau upsilon phi chi psi omega", 0x3C3),
        ("Alpha Beta Gamma Delta Epsilon Zeta Eta Theta Iota Kappa Lambda Mu Nu Xi Omicron Pi Rho", 0x391),
        ("Sigma Tau Upsilon Phi Chi Psi Omega", 0x3A3),
    )
    for code, name in enumerate(names.split(), start=first)
}
SIGNS = {"varepsilon": "\u03b5", "ell": "\u2113", "infty": "\u221e", "sum": "\u2211", "prime": "\u2032"}
SIGNS |= {"ldots": "\u2026", "dots": "\u2026", "cdot": "\u22c5", "%": "%", "|": "\u2016", "{": "{", "}": "}"}
SIGNS |= {name: "" for name in ",;:!"} | {" ": " ", "quad": " "}
SIGNS |= {name: name for name in ("log", "ln", "exp", "max", "min", "det", "sin", "cos", "arg")}
BETWEEN = {"=": "=", "<": "<", ">": ">", "le": "\u2264", "leq": "\u2264", "ge": "\u2265", "geq": "\u2265"}
BETWEEN |= {"ne": "\u2260", "neq": "\u2260", "approx": "\u2248", "sim": "\u223c", "in": "\u2208", "to": "\u2192"}
BETWEEN |= {"pm": "\u00b1", "times": "\u00d7"}
"""Signs with a blank on both sides."""
ACCENTS = {"hat": "\u0302", "bar": "\u0304", "tilde": "\u0303", "breve": "\u0306", "dot": "\u0307", "vec": "\u20d7"}
UPRIGHT = ("mathrm", "text", "operatorname", "mathit")
_TOKEN = re.compile(r"\\(?:[A-Za-z]+|.)|\s+|.", re.DOTALL)
_SIMPLE = re.compile(r"[\w.\u0300-\u036f\u20d7]*")


class FormulaError(ValueError):
    """A formula holds something that is not covered."""


def formula_html(formula: str) -> str:
    r"""Write a formula, without its dollar signs, as HTML with ``sub`` and ``sup``.

    Raises a FormulaError if it holds something that is not covered; it is then shown as text.

    Examples
    --------
    >>> formula_html("c=10^{-1}"), formula_html(r"Q'Q"), formula_html(r"\hat{x}_{k|k}")
    ('c = 10<sup>−1</sup>', 'Q′Q', 'x̂<sub>k|k</sub>')
    """
    left = _TOKEN.findall(formula)[::-1]
    try:
        found = _elements(left, "")
    except RecursionError:
        raise FormulaError("nested too deep") from None
    if left:
        raise FormulaError(f"a brace is closed that was not opened in {formula!r}")
    return " ".join(found.split())


def _elements(left: list[str], end: str) -> str:
    """Read elements, which are in reverse order, up to the one that ends them."""
    found = ""
    while left:
        if left[-1] == end:
            left.pop()
            return found
        if left[-1] == "}":
            break
        if left[-1].isspace():
            left.pop()
            continue
        found += _with_scripts(left)
    if end:
        raise FormulaError("a brace is not closed")
    return found


def _with_scripts(left: list[str]) -> str:
    base, scripts = _atom(left), dict[str, str]()
    while left and left[-1] in ("_", "^"):
        which = left.pop()
        if which in scripts:
            raise FormulaError("two indices or two exponents")
        scripts[which] = _argument(left)
    if scripts.get("^") == "\u2032":
        base += scripts.pop("^")
    return base + "".join(
        f"<{tag}>{scripts[key]}</{tag}>" for key, tag in (("_", "sub"), ("^", "sup")) if key in scripts
    )


def _argument(left: list[str]) -> str:
    """Read one token or a group as one element."""
    while left and left[-1].isspace():
        left.pop()
    if not left:
        raise FormulaError("something is missing at the end")
    return _atom(left).strip()


def _atom(left: list[str]) -> str:
    token = left.pop()
    if token == "{":
        return _elements(left, "}")
    if token in ("_", "^"):
        raise FormulaError("an index without a base")
    if token.startswith("\\"):
        return _command(token[1:], left)
    if token in BETWEEN:
        return f" {escape(BETWEEN[token])} "
    return {"'": "\u2032", "-": "\u2212"}.get(token) or escape(token)


def _command(name: str, left: list[str]) -> str:
    sign = GREEK.get(name, SIGNS.get(name))
    if sign is not None:
        return sign
    if name in BETWEEN:
        return f" {BETWEEN[name]} "
    if name in UPRIGHT:
        return escape(_words(left))
    if name in ACCENTS:
        base = _argument(left)
        return base[:1] + ACCENTS[name] + base[1:]
    if name == "sqrt":
        return f"\u221a{_grouped(_argument(left))}"
    if name == "frac":
        return f"{_grouped(_argument(left))}/{_grouped(_argument(left))}"
    raise FormulaError(f"\\{name} is not covered")


def _grouped(text: str) -> str:
    return text if _SIMPLE.fullmatch(text) else f"({text})"


def _words(left: list[str]) -> str:
    """Read a group as plain words."""
    if not left or left.pop() != "{":
        raise FormulaError("words need braces")
    words = []
    while left and left[-1] != "}":
        words.append(left.pop())
    if not left:
        raise FormulaError("a brace is not closed")
    left.pop()
    if any(word[0] in "\\{^_" for word in words):
        raise FormulaError("words hold a command")
    return "".join(words)


_FORMULA = re.compile(r"(?<!\\)\$((?:\\.|[^$\\])+)\$", re.DOTALL)
_MINUS = re.compile(r"(?<![\w.)\]])-(?=\d)")  # the sign of a number; hyphens in names such as R-MPC1 and in dates stay
_RAISED = re.compile(r"(?<=[A-Za-z])\^(-?\d+)")  # exponent of a unit, such as rad^2
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
