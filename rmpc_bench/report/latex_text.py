r"""Texts with formulas, such as labels and captions, in LaTeX.

A text is plain except for formulas between dollar signs, ``R-MPC, $c=10^{-1}$``.  A dollar sign that is meant is
written ``\$``; where the number of the others is odd, there is no formula.
"""

from __future__ import annotations

import re
import unicodedata

from rmpc_bench.figures.labels import is_formula

_WITH_ARGUMENT = r"\\(?:hat|bar|tilde|breve|dot|ddot|vec|check|mathrm|mathit|mathbf|mathcal|mathsf|sqrt)\{[^{}]*\}"
_DOLLAR = re.compile(r"(?<!\\)\$")
_SIGN = re.compile(r"(?<=[A-Za-z])\^(?P<exponent>-?\d+(?:\.\d+)?)|(?<![\w.^-])-(?=[\d.])|(?P<infinity>\binf\b)")
"""Exponent of a unit, minus in front of a number, and infinity."""
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
}
"""Character -> formula; LaTeX knows the letters with accents itself."""
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
)
"""Commands of formulas that LaTeX and matplotlib share; a formula with another one is shown as text."""


def to_latex(text: str) -> str:
    r"""Write a text for LaTeX: formulas are kept, and every other special character is printed as it is.

    The text has formulas between dollar signs; it becomes one paragraph, which needs no package.  A formula that uses
    commands other than `COMMANDS`, or that matplotlib could not set, is printed as text, so that a name cannot run a
    command of LaTeX.

    Examples
    --------
    >>> print(to_latex("R-MPC_1, $c=10^{-1}$: 50 % & more"), to_latex(r"$\input{x}$"))
    R-MPC\_1, $c=10^{-1}$: 50 \% \& more \$\textbackslash{}input\{x\}\$
    """
    parts = _DOLLAR.split(one_line(text))
    if len(parts) % 2 == 0:
        return _plain("$".join(parts))
    return "".join(_formula(part) if place % 2 else _plain(part) for place, part in enumerate(parts))


def printed_latex(text: str) -> str:
    r"""Write full sentences for LaTeX: as `to_latex`, with minus signs, raised exponents of units and infinity.

    Examples
    --------
    >>> print(printed_latex("MSE [rad^2] of R-MPC1: -11.9 % [-13.2, inf]"))
    MSE [rad$^{2}$] of R-MPC1: $-$11.9\,\% [$-$13.2, $\infty$]
    """
    parts = _DOLLAR.split(one_line(text))
    if len(parts) % 2:
        parts[::2] = [_SIGN.sub(_sign, part) for part in parts[::2]]
    written = to_latex("$".join(parts))
    return re.sub(r"(?<=\d) \\%", r"\,\%", written)


def _sign(found: re.Match[str]) -> str:
    if found["exponent"]:
        return f"$^{{{found['exponent']}}}$"
    return "∞" if found["infinity"] else "−"


def one_line(text: str) -> str:
    """Replace every line break and control character by a blank, so that a text ends neither a comment nor a row."""
    return "".join(" " if unicodedata.category(each) in ("Cc", "Cf", "Cs", "Zl", "Zp") else each for each in text)


def unit_latex(unit: str) -> str:
    """Write a unit such as ``rad^2`` with raised exponents."""
    parts = re.split(r"\^(-?\d+(?:\.\d+)?)", one_line(unit))
    return "".join(f"$^{{{part}}}$" if place % 2 else _plain(part) for place, part in enumerate(parts))


def _plain(text: str) -> str:
    text = text.replace(r"\$", "$")
    written = "".join(_character(each) for each in text)
    # Two hyphens would become a dash.
    return re.sub(r"-(?=-)", "-{}", written) if "--" in text else written


def _character(each: str) -> str:
    if each in _SYMBOLS:
        return f"${_SYMBOLS[each]}$"
    return _ESCAPED.get(each) or _PUNCTUATION.get(each, each)


def _formula(part: str) -> str:
    """Return a formula for LaTeX, or its text where it is not a formula of both."""
    known = all(command in COMMANDS for command in _COMMAND.findall(part))
    # LaTeX reads ^^ as the code of a character, and refuses a second exponent, or a prime behind an exponent.
    part = re.sub(rf"([\^_])\s*({_WITH_ARGUMENT})", r"\1{\2}", part)
    refused = re.search(r"\^\s*\^|_\s*_|\^.*'|[\^_]\s*(?:$|\\(?![A-Za-z])|\\(?:frac|hat|sqrt))", part)
    if not part.strip() or refused or not known or not is_formula(part):
        return _plain(f"${part}$")
    written = "".join(_symbol(each) for each in part)
    return "$" + re.sub(r"(?<!\\)([%#&])", r"\\\1", written) + "$"


def _symbol(each: str) -> str:
    return f"{{{_SYMBOLS[each]}}}" if each in _SYMBOLS else each
