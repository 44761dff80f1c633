"""Texts and numbers in LaTeX: formulas stay, everything else is printed as it is, and no name runs a command."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rmpc_bench.report.latex_text import COMMANDS, number_latex, one_line, to_latex, unit_latex

HOSTILE = r"\_%&#~^{}$<>|\"`'-[]*abcR1 ()=.,/" + "\n\r\x0b\x85\u2028αβ±²éß"
PRINTED = {"textbackslash", "textasciitilde", "textasciicircum", "textasciigrave", "ldots"}
TOKEN = re.compile(r"\\(?P<command>[A-Za-z]+|.)|(?P<special>[{}$&%#_^~])|(?P<other>.)", re.DOTALL)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("R-MPC_1 & 50 %", r"R-MPC\_1 \& 50 \%"),
        ("R-MPC, $c=10^{-1}$", r"R-MPC, $c=10^{-1}$"),
        (r"costs \$5", r"costs \$5"),
        ("odd $", r"odd \$"),
        ("$$", r"\$\$"),
        (r"a\b {c} ~d ^e #f", r"a\textbackslash{}b \{c\} \textasciitilde{}d \textasciicircum{}e \#f"),
        (r"$\input{/etc/passwd}$", r"\$\textbackslash{}input\{/etc/passwd\}\$"),
        (r"$x^^M$", r"\$x\textasciicircum{}\textasciicircum{}M\$"),
        ("$x^$", r"\$x\textasciicircum{}\$"),
        ("$50%$", r"\$50\%\$"),
        (r"$50\%$", r"$50\%$"),
        (r"$x^\hat{y}$", r"$x^{\hat{y}}$"),
        (r"$\hat{x}_0$", r"$\hat{x}_0$"),
        (r"$x^\sin + y_\ldots$", r"$x^{\sin} + y_{\ldots}$"),
        (r"$x_\theta^\infty$", r"$x_\theta^\infty$"),
        ("a--b", "a-{}-b"),
        ("θ = 2°", r"$\theta$ = 2$^{\circ}$"),
        ("a\nb\u2028c", "a b c"),
    ],
)
def test_by_hand(text, expected):
    assert to_latex(text) == expected


@settings(max_examples=300)
@given(st.text(alphabet=HOSTILE, max_size=30))
def test_nothing_of_a_text_is_active(text):
    """Braces are balanced, formulas are closed, and outside of them no special character is left."""
    depth, formula = 0, False
    for token in TOKEN.finditer(to_latex(text)):
        command, special = token["command"], token["special"]
        if command is not None:
            assert command in (COMMANDS | {"surd", "to", "ne", "{", "}"} if formula else PRINTED | set("{}$&%#_"))
        elif special == "$":
            formula = not formula
        elif special in ("{", "}"):
            depth += 1 if special == "{" else -1
            assert depth >= 0
        elif special is not None:
            # Within a formula ~ is a blank, for matplotlib too.
            assert formula and special in "_^~"
        else:
            assert token["other"] not in "\n\r\x0b\x85\u2028"
    assert depth == 0 and not formula


@given(st.text(max_size=40))
def test_one_line(text):
    assert len(one_line(text).splitlines()) <= 1 and len(one_line(text)) == len(text)


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("0.1064(7)", "$0.1064(7)$"),
        ("1.2(3)e-05", r"$1.2(3)\times 10^{-5}$"),
        ("3e+12", r"$3\times 10^{12}$"),
        ("-10.9 % [-12.1, -9.7]", r"$-10.9\,\%\ [-12.1, -9.7]$"),
        ("0.114 [0.102, inf]", r"$0.114\ [0.102, \infty]$"),
        ("141/200 (70.5 %)", r"$141/200\ (70.5\,\%)$"),
        ("162/0/38", "$162/0/38$"),
        ("< 0.001", "$< 0.001$"),
        ("-0.10 rad^2 [-0.11, -0.09]", r"$-0.10\,\mbox{rad$^{2}$}\ [-0.11, -0.09]$"),
        ("-", "--"),
        ("better, size uncertain", "better, size uncertain"),
    ],
)
def test_numbers(cell, expected):
    assert number_latex(cell) == expected


@given(st.floats(-1e9, 1e9), st.integers(0, 6))
def test_digits_stay(value, places):
    cell = f"{value:+.{places}f} % [{value - 1:.{places}f}, {value + 1:.{places}f}]"
    assert re.sub(r"[^-+0-9.]", "", number_latex(cell)) == re.sub(r"[^-+0-9.]", "", cell)


def test_units():
    assert unit_latex("rad^2/s^-1") == "rad$^{2}$/s$^{-1}$" and unit_latex("%") == r"\%"
