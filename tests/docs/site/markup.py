"""Markdown of code hosts as the Markdown of the site's parser, and formulas as MathML."""

from __future__ import annotations

import re
from functools import cache

from docs.site.pages import outside_code
from latex2mathml.converter import convert

_CODE = re.compile(r"(^ *```.*?^ *```$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
_BLOCK = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"(?<![\\$\w])\$([^\s$](?:[^$\n]*[^\s$\\])?)\$(?![\w$])")


def math(text: str) -> str:
    """Formulas between dollar signs as MathML; code stays as it is."""
    text = re.sub(r"^ *```math\n(.*?)^ *```$", r"$$\1$$", text, flags=re.MULTILINE | re.DOTALL)
    return outside_code(_formulas, text, _CODE)


def _formulas(part: str) -> str:
    part = _BLOCK.sub(lambda found: f'\n<div class="formula">{_lines(found[1])}</div>\n', part)
    part = _INLINE.sub(lambda found: mathml(found[1], "inline"), part)
    # At the begin of a line it would be a paragraph of its own.
    return re.sub(r"^( {0,3})(<math.*?</math>)", r"\1<span>\2</span>", part, flags=re.MULTILINE)


def _lines(formula: str) -> str:
    """A formula as one or several, divided where it has a wide space, so that they may stand below each other."""
    parts, depth = [""], 0
    for piece in re.split(r"(\\q?quad\b|[{}]|\\(?:left|right|begin|end)\b)", " ".join(formula.split())):
        depth += (piece in ("{", r"\left", r"\begin")) - (piece in ("}", r"\right", r"\end"))
        parts += [""] * (piece in (r"\quad", r"\qquad") and not depth)
        parts[-1] += piece
    return " ".join(mathml(re.sub(r"^\\q?quad", "", part), "block") for part in parts)


@cache
def mathml(formula: str, display: str) -> str:
    """A formula of LaTeX in MathML, in one line and without a character that Markdown reads as a mark."""
    made = convert(" ".join(formula.split()), display=display)
    return made.replace("*", "&#42;").replace("_", "&#95;").replace("|", "&#124;").replace("\n", " ")


def _entities(part: str) -> str:
    """Escaped marks; a brace begins attributes of HTML, such as a script, for the parser."""
    part = re.sub(r"\{(?! loading=lazy \})", "&#123;", part)
    return re.sub(r"\\([~<|$])", lambda found: f"&#{ord(found[1])};", part)


def commonmark(text: str) -> str:
    """Files named in fences, the depth of what lies inside a list, and escaped marks, as the site's parser has them."""
    lines, inside, more = [], False, 0
    for line in text.split("\n"):
        inner = line.lstrip(" ")
        depth = len(line) - len(inner)
        if inside:
            lines.append(" " * more + line if line else line)
            inside = not (inner.startswith("```") and not inner.strip("`"))
            continue
        inside = inner.startswith("```")
        more = depth if inside or depth in (2, 4, 6) else 0
        inner = (
            re.sub(r"^```(\w+) (\S+)$", r'```\1 title="\2"', inner) if inside else outside_code(_entities, inner, _CODE)
        )
        lines.append(" " * (depth + more) + inner)
    return "\n".join(lines)
