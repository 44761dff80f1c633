r"""Formulas between dollar signs as MathML, which browsers set without fonts or scripts of their own.

Covered is what labels and captions hold: letters, numbers, indices and exponents, Greek letters, accents, `\mathrm`,
`\sqrt`, `\frac` and common operators.
"""

from __future__ import annotations

import re
from collections.abc import Callable
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
} | {"varepsilon": "\u03b5", "ell": "\u2113", "infty": "\u221e"}
OPERATORS = {
    "le": "\u2264",
    "leq": "\u2264",
    "ge": "\u2265",
    "geq": "\u2265",
    "ne": "\u2260",
    "neq": "\u2260",
    "pm": "\u00b1",
    "times": "\u00d7",
    "cdot": "\u22c5",
    "approx": "\u2248",
    "sim": "\u223c",
    "in": "\u2208",
    "to": "\u2192",
    "sum": "\u2211",
    "ldots": "\u2026",
    "dots": "\u2026",
    "prime": "\u2032",
    "%": "%",
    "|": "\u2016",
    "{": "{",
    "}": "}",
}
SPACES = {",": "0.17em", ";": "0.28em", ":": "0.22em", " ": "0.33em", "quad": "1em", "!": "-0.17em"}
ACCENTS = {"hat": "^", "bar": "\u00af", "tilde": "~", "breve": "\u02d8", "dot": "\u02d9", "vec": "\u2192"}
UPRIGHT = ("mathrm", "text", "operatorname", "mathit")
FUNCTIONS = ("log", "ln", "exp", "max", "min", "det", "sin", "cos", "arg")
_TOKEN = re.compile(r"\\(?:[A-Za-z]+|.)|\d+(?:\.\d+)?|\s+|.")


class FormulaError(ValueError):
    """A formula holds something that is not covered."""


def mathml(formula: str) -> str:
    """Write a formula, without its dollar signs, as a MathML element.

    Raises a FormulaError if it holds something that is not covered; it is then shown as text.

    Examples
    --------
    >>> mathml("c=10^{-1}")
    '<math><mi>c</mi><mo>=</mo><msup><mn>10</mn><mrow><mo>-</mo><mn>1</mn></mrow></msup></math>'
    """
    reader = _Reader(_TOKEN.findall(formula))
    try:
        found = reader.row("")
    except RecursionError:
        raise FormulaError("nested too deep") from None
    if reader.left:
        raise FormulaError(f"a brace is closed that was not opened in {formula!r}")
    return f"<math>{''.join(found)}</math>"


class _Reader:
    """Reads tokens from left to right.

    Parameters
    ----------
    tokens : of the formula
    """

    def __init__(self, tokens: list[str]) -> None:
        self.left = tokens[::-1]

    def row(self, end: str) -> list[str]:
        """Read elements up to a token that ends them."""
        found: list[str] = []
        while self.left:
            if self.left[-1] == end:
                self.left.pop()
                return found
            if self.left[-1] == "}":
                break
            if self.left[-1].isspace():
                self.left.pop()
                continue
            found.append(self._with_scripts(self._atom()))
        if end:
            raise FormulaError("a brace is not closed")
        return found

    def _with_scripts(self, base: str) -> str:
        scripts: dict[str, str] = {}
        while self.left and self.left[-1] in ("_", "^"):
            which = self.left.pop()
            if which in scripts:
                raise FormulaError("two indices or two exponents")
            scripts[which] = self._argument()
        low, high = scripts.get("_"), scripts.get("^")
        if low and high:
            return f"<msubsup>{base}{low}{high}</msubsup>"
        if low:
            return f"<msub>{base}{low}</msub>"
        return f"<msup>{base}{high}</msup>" if high else base

    def _argument(self) -> str:
        """Read one token or a group as one element."""
        while self.left and self.left[-1].isspace():
            self.left.pop()
        if not self.left:
            raise FormulaError("something is missing at the end")
        return self._atom()

    def _atom(self) -> str:
        token = self.left.pop()
        if token == "{":
            inner = self.row("}")
            return inner[0] if len(inner) == 1 else f"<mrow>{''.join(inner)}</mrow>"
        if token in ("_", "^"):
            raise FormulaError("an index without a base")
        if token.startswith("\\"):
            return self._command(token[1:])
        if token[0].isdigit():
            return f"<mn>{token}</mn>"
        return f"<mi>{escape(token)}</mi>" if token.isalpha() else f"<mo>{escape(token)}</mo>"

    def _command(self, name: str) -> str:
        if name in GREEK:
            return f"<mi>{GREEK[name]}</mi>"
        if name in OPERATORS:
            return f"<mo>{OPERATORS[name]}</mo>"
        if name in SPACES:
            return f'<mspace width="{SPACES[name]}"/>'
        if name in FUNCTIONS:
            return f"<mi>{name}</mi>"
        if name in UPRIGHT:
            return f'<mi mathvariant="normal">{escape(self._words())}</mi>'
        with_arguments: dict[str, Callable[[], str]] = {
            "sqrt": lambda: f"<msqrt>{self._argument()}</msqrt>",
            "frac": lambda: f"<mfrac>{self._argument()}{self._argument()}</mfrac>",
            **{accent: lambda mark=mark: self._accent(mark) for accent, mark in ACCENTS.items()},  # type: ignore[misc]
        }
        if name not in with_arguments:
            raise FormulaError(f"\\{name} is not covered")
        return with_arguments[name]()

    def _accent(self, mark: str) -> str:
        return f'<mover accent="true">{self._argument()}<mo>{mark}</mo></mover>'

    def _words(self) -> str:
        """Read a group as plain words."""
        if not self.left or self.left.pop() != "{":
            raise FormulaError("words need braces")
        words = []
        while self.left and self.left[-1] != "}":
            words.append(self.left.pop())
        if not self.left:
            raise FormulaError("a brace is not closed")
        self.left.pop()
        if any(word[0] in "\\{^_" for word in words):
            raise FormulaError("words hold a command")
        return "".join(words)
