"""Texts of an SVG: fonts that stand in for a missing one, and formulas as words instead of single characters.

matplotlib names one font only, and writes every character of a formula as an element of its own with the whole style.
"""

from __future__ import annotations

import re
from collections import Counter

from rmpc_bench.figures.fonts import families

_FAMILY = re.compile(r"font-family: ((?:'[^']*'|[\w-]+)(?:, (?:'[^']*'|[\w-]+))*)")
_TURNED_BY_0 = re.compile(r' transform="rotate\(-?0 [^)]*\)"')
_FONT = re.compile(r"font-size: [\d.]+px; font-family: [^\";]*")
_SPANS = re.compile(r'(?:<tspan x="[^"]*" y="[^"]*" style="[^"]*">(?:[^<&]|&[^;]*;)</tspan>\s*){2,}')
_SPAN = re.compile(r'<tspan x="([^"]*)" y="([^"]*)" style="([^"]*)">((?:[^<&]|&[^;]*;))</tspan>')


def readable_text(svg: str) -> str:
    """Give an SVG of rounded coordinates shorter, searchable formulas and fonts for machines without the first."""
    svg = _FAMILY.sub(_with_others, _SPANS.sub(_joined, _TURNED_BY_0.sub("", svg)))
    usual = Counter(_FONT.findall(svg)).most_common(1)
    return _with_usual_font(svg, usual[0][0]) if usual else svg


def _with_usual_font(svg: str, font: str) -> str:
    """Name the font of most texts once, at the root."""
    svg = re.sub(rf'(?:; )?{re.escape(font)}(?:; )?(?=([^"]*)")', _between, svg).replace(' style=""', "")
    return svg.replace("<svg ", f'<svg style="{font}" ', 1)


def _between(found: re.Match[str]) -> str:
    """Keep one semicolon where declarations stand on both sides."""
    return "; " if found[0].startswith("; ") and found[1] else ""


def _with_others(found: re.Match[str]) -> str:
    first = found[1].split(",")[0].strip("' ")
    names = (name if "-" in name or name == "serif" else f"'{name}'" for name in families(first))
    return f"font-family: {', '.join(names)}"


def _joined(found: re.Match[str]) -> str:
    """Join neighbours of one style and one height; each character keeps its horizontal position."""
    words: list[tuple[list[str], str, str, str]] = []
    # matplotlib orders them by style; a reader of the text by position.
    for x, y, style, character in sorted(_SPAN.findall(found[0]), key=lambda span: float(span[0])):
        if words and words[-1][1:3] == (y, style):
            words[-1] = ([*words[-1][0], x], y, style, words[-1][3] + character)
        else:
            words.append(([x], y, style, character))
    return (
        "\n".join(
            f'<tspan x="{" ".join(places)}" y="{y}" style="{style}">{text}</tspan>' for places, y, style, text in words
        )
        + "\n"
    )
