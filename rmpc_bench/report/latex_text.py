r"""Texts and numbers of a paper in LaTeX: labels with formulas, cells of tables, and how wide they are.

A text is plain except for formulas between dollar signs, ``R-MPC, $c=10^{-1}$``.  A dollar sign that is meant is
written ``\$``; where the number of the others is odd, there is no formula.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

from rmpc_bench.figures.labels import can_be_set

_WITH_ARGUMENT = r"\\(?:hat|bar|tilde|breve|dot|ddot|vec|check|mathrm|mathit|mathbf|mathcal|mathsf|sqrt)\{[^{}]*\}"
_SEVERAL = r"\\(?:log|ln|exp|cos|sin|tan|min|max|det|sup|inf|[lc]dots|quad|neq?|int|langle|rangle|Vert)"
"""Commands that TeX replaces by several tokens, which an index or an exponent has in braces only."""
_DOLLAR = re.compile(r"(?<!\\)\$")
# Exponent of a unit, minus in front of a number, and infinity.
_SIGN = re.compile(r"(?<=[A-Za-z])\^(?P<exponent>-?\d+(?:\.\d+)?)|(?<![\w.^-])-(?=[\d.])|(?P<infinity>\binf\b)")
_COMMAND = re.compile(r"\\([A-Za-z]+|.)", re.DOTALL)
_ESCAPED = {
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "`": r"\textasciigrave{}"},
    **{each: rf"\{each}" for each in "{}$&%#_"},
    # In the usual encoding of LaTeX these would print other characters.
    **{"<": "$<$", ">": "$>$", "|": "$|$", '"': "''"},
}
_SYMBOLS = {
    **{"−": "-", "×": r"\times", "·": r"\cdot", "±": r"\pm", "≤": r"\le", "≥": r"\ge", "≠": r"\ne", "≈": r"\approx"},
    **{"∞": r"\infty", "→": r"\to", "√": r"\surd", "∈": r"\in", "∑": r"\sum", "°": r"^{\circ}", "µ": r"\mu"},
    **{"⁰": "^0", "¹": "^1", "²": "^2", "³": "^3", "⁴": "^4", "⁻": "^-", "₀": "_0", "₁": "_1", "₂": "_2", "ϕ": r"\phi"},
    **{"α": r"\alpha", "β": r"\beta", "γ": r"\gamma", "δ": r"\delta", "ε": r"\varepsilon", "ζ": r"\zeta"},
    **{"η": r"\eta", "θ": r"\theta", "ι": r"\iota", "κ": r"\kappa", "λ": r"\lambda", "μ": r"\mu", "ν": r"\nu"},
    **{"ξ": r"\xi", "π": r"\pi", "ρ": r"\rho", "σ": r"\sigma", "τ": r"\tau", "φ": r"\varphi", "χ": r"\chi"},
    **{"ψ": r"\psi", "ω": r"\omega", "Γ": r"\Gamma", "Δ": r"\Delta", "Θ": r"\Theta", "Λ": r"\Lambda", "Ξ": r"\Xi"},
    **{"Π": r"\Pi", "Σ": r"\Sigma", "Φ": r"\Phi", "Ψ": r"\Psi", "Ω": r"\Omega"},
}  # LaTeX knows the letters with accents itself
_PUNCTUATION = {"–": "--", "—": "---", "…": r"\ldots{}", "\u00a0": "~", "’": "'", "‘": "`", "“": "``", "”": "''"}
COMMANDS = frozenset(
    (
        "alpha beta gamma delta epsilon varepsilon zeta eta theta vartheta iota kappa lambda mu nu xi pi rho sigma tau "
        "upsilon phi varphi chi psi omega Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega "
        "hat bar tilde breve dot ddot vec check mathrm mathit mathbf mathcal mathsf frac sqrt "
        "cdot times pm mp le leq ge geq ne neq approx sim equiv propto in to infty sum prod int partial nabla ell "
        "circ prime ldots cdots quad top perp Vert mid langle rangle log ln exp sin cos tan min max det sup inf "
        ", ; : ! % # & _ { }"
    ).split()
)  # commands of formulas that LaTeX and matplotlib share; a formula with another one is shown as text


def to_latex(text: str) -> str:
    """Write a text as one paragraph of LaTeX: formulas are kept, and every other special character is printed as it is.

    A formula that uses commands other than `COMMANDS`, or that matplotlib could not set, is printed as text, so that a
    name cannot run a command of LaTeX.
    """
    parts = _DOLLAR.split(one_line(text))
    if len(parts) % 2 == 0:
        return _plain("$".join(parts))
    return "".join(_formula(part) if place % 2 else _plain(part) for place, part in enumerate(parts))


def printed_latex(text: str) -> str:
    """Write full sentences for LaTeX: as `to_latex`, with minus signs, raised exponents of units and infinity."""
    parts = _DOLLAR.split(one_line(text))

    def sign(found: re.Match[str]) -> str:
        return f"$^{{{found['exponent']}}}$" if found["exponent"] else "∞" if found["infinity"] else "−"

    if len(parts) % 2:
        parts[::2] = [_SIGN.sub(sign, part) for part in parts[::2]]
    return re.sub(r"(?<=\d) \\%", r"\,\%", to_latex("$".join(parts)))


def one_line(text: str) -> str:
    """Replace every line break and control character by a blank, so that a text ends neither a comment nor a row."""
    return "".join(" " if unicodedata.category(each) in ("Cc", "Cf", "Cs", "Zl", "Zp") else each for each in text)


def unit_latex(unit: str) -> str:
    """Write a unit such as ``rad^2`` with raised exponents."""
    parts = re.split(r"\^(-?\d+(?:\.\d+)?)", one_line(unit))
    return "".join(f"$^{{{part}}}$" if place % 2 else _plain(part) for place, part in enumerate(parts))


def bracketed(unit: str) -> str:
    """Write a unit in brackets; empty for a number without one."""
    return f"[{unit_latex(unit)}]" if unit else ""


def _plain(text: str) -> str:
    signs = [f"${_SYMBOLS[each]}$" if each in _SYMBOLS else each for each in text.replace(r"\$", "$")]
    written = "".join(_ESCAPED.get(each) or _PUNCTUATION.get(each, each) for each in signs)
    # Two hyphens would become a dash.
    return re.sub(r"-(?=-)", "-{}", written) if "--" in text else written


def _formula(part: str) -> str:
    """Return a formula for LaTeX, or its text where it is not a formula of both."""
    known = all(command in COMMANDS for command in _COMMAND.findall(part))
    # LaTeX reads ^^ as the code of a character, and refuses a second exponent, or a prime behind an exponent.
    part = re.sub(rf"([\^_])\s*({_WITH_ARGUMENT})", r"\1{\2}", part)
    part = re.sub(rf"([\^_])\s*({_SEVERAL})(?![A-Za-z])", r"\1{\2}", part)
    refused = re.search(r"\^\s*\^|_\s*_|\^.*'|[\^_]\s*(?:$|\\(?![A-Za-z])|\\(?:frac|hat|sqrt))", part)
    if not part.strip() or refused or not known or not can_be_set(f"${part}$"):
        return _plain(f"${part}$")
    written = "".join(f"{{{_SYMBOLS[each]}}}" if each in _SYMBOLS else each for each in part)
    return "$" + re.sub(r"(?<!\\)([%#&])", r"\\\1", written) + "$"


_NUMBER = r"[-+]?(?:\d+(?:\.\d+)?|inf)(?:e[-+]?\d+)?"
_TOKEN = re.compile(
    rf"(?P<number>{_NUMBER})|(?P<percent>%)|(?P<power>(?<=\))e[-+]?\d+)|(?P<word>[A-Za-z][\w^.-]*)|(?P<sign>[\[\],/<()\u00b1\u00d7])|(?P<gap>\s+)"
)
_SIGNS = {"\u00b1": r"\pm", "\u00d7": r"\times "}
_EXPONENT = re.compile(r"e([-+]?)0*(\d+)")
_IS_NUMBER = re.compile(rf"[<(\u00d7]?\s*{_NUMBER}")


def number_latex(cell: str) -> str:
    """Write a cell such as ``-10.9 % [-12.1, -9.7]`` as a formula with the digits of the cell; words stay words."""
    cell = cell.replace("\u2212", "-")
    if cell.strip() in ("", "-"):
        return "--"
    tokens = [*_TOKEN.finditer(cell)]
    if not _IS_NUMBER.match(cell) or "".join(token[0] for token in tokens) != cell:
        return to_latex(cell.replace("$", r"\$"))
    return f"${''.join(_part(token, cell) for token in tokens)}$"


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
    if not token["gap"]:
        return text
    # A comma of a formula has its own distance; a unit stands near its number, an interval further away.
    if cell[: token.start()].endswith((",", "<")):
        return " "
    return r"\ " if cell[token.end() :].startswith(("[", "(")) else r"\,"


SIZE = 8.0  # size of the text of a table [pt], that of `\footnotesize`
_WIDTHS = {
    **dict.fromkeys("ijl.,;:|'/ ", 0.30),
    **dict.fromkeys("ftrI-()[]", 0.40),
    **dict.fromkeys("mwMW%", 0.90),
    **dict.fromkeys("ABCDEFGHJKLNOPQRSTUVXYZ", 0.72),
    **dict.fromkeys("0123456789", 0.53),
    **dict.fromkeys("=<>+−", 1.0),
}  # of the size, of the wider of Times and Computer Modern; 0.5 for the others
_SCRIPT = re.compile(r"[\^_](?:\{([^{}]*)\}|(\S))")
_INVISIBLE = re.compile(
    r"\\begin\{tabular\}\[b\]\{@\{\}c@\{\}\}|\\end\{tabular\}|\\(?:mbox|mathrm|textit|text\w+)\b|[${}]"
)
_ANY_COMMAND = re.compile(r"\\([A-Za-z]+) ?")


def width_of(cell: str) -> float:
    """Estimate the width [pt] of the widest line of a cell of LaTeX."""
    return max(_line(line) for line in cell.split(r"\\"))


def _line(text: str) -> float:
    text = text.replace(r"\ ", " ").replace(r"\,", ".").replace(r"\times", "++").replace(r"\%", "%").replace(r"\_", "n")
    text = re.sub(r"(?<=[$\s\[/])[-+](?=[\d\\])", "+", text)
    scripts = "".join(found[1] or found[2] for found in _SCRIPT.finditer(text))
    plain = _ANY_COMMAND.sub("m", _INVISIBLE.sub("", _SCRIPT.sub("", text)))
    return SIZE * (_sum(plain) + 0.7 * _sum(_ANY_COMMAND.sub("m", scripts)))


def _sum(text: str) -> float:
    return sum(_WIDTHS.get(each, 0.5) for each in text)


def table_width(head: Sequence[str], rows: Sequence[Sequence[str]], gap: float) -> float:
    """Estimate the width of a table [pt]; the gap between columns is in units of the size of the text."""
    columns = zip(*[head, *rows], strict=True)
    return sum(max(map(width_of, column)) for column in columns) + gap * SIZE * (len(head) - 1)
