"""SVG of figures: colours are variables of CSS, formulas are words, and nothing names a font or a size.

matplotlib writes fixed colours and fonts, every character of a formula as an element, and an id for every group.
`themed` makes of it what file and page share; `as_file` adds the colours of a light and a dark ground, `for_page` makes
its ids those of one figure.  A group of a method has its key as ``data-method``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from decimal import Decimal

from rmpc_bench.figures.palette import DARK, LIGHT, css_variables, in_css

DECIMALS = Decimal("0.1"), Decimal("0.01")
"""Digits of a place on the picture, and of numbers below 10, such as those of a marker."""
_COORDINATES = re.compile(r'(?<=\s)(?:d|x|y|width|height|points|viewBox)="[^"]*"|(?:translate|rotate)\([^)]*\)')
"""Attributes that hold coordinates in points; a factor in `scale(...)` or a comment is left as it is."""
_LONG_NUMBER = re.compile(r"-?\d+\.\d{2,}")
_HASHED_NAME = re.compile(r'(?<=id=")[a-z][0-9a-f]{10}(?=")')


def stable_svg(text: str) -> str:
    """Round an SVG of matplotlib to a tenth of a point, and number the names that it has made from hashes."""
    text = _COORDINATES.sub(lambda part: _LONG_NUMBER.sub(_rounded, part[0]), text)
    names = dict.fromkeys(_HASHED_NAME.findall(text))
    numbers = {name: f"{name[0]}{number}" for number, name in enumerate(names, start=1)}
    return re.sub(r'(?<=["#])[a-z][0-9a-f]{10}(?=["\)])', lambda found: numbers.get(found[0], found[0]), text)


def _rounded(number: re.Match[str]) -> str:
    """Write a number with few decimals; the six decimals of the text decide a half, not the float."""
    given = Decimal(number[0])
    rounded = given.quantize(DECIMALS[abs(given) < 10])
    return f"{rounded if rounded else abs(rounded):f}".rstrip("0").rstrip(".")


PRIME = "\N{PRIME}"
SUPERSCRIPT = 0.7
"""Size of a superscript; matplotlib sets a prime as one, from a font in which it stands in the place of a 0."""
RAISED = 0.59  # how far a superscript is raised, as a share of its size
NAMESPACES = ' xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'

_LEFT_OUT = re.compile(r"<metadata>.*?</metadata>\s*|<!--.*?-->\s*|<defs>\s*<style[^>]*>.*?</style>\s*</defs>\s*", re.S)
_ROOT = re.compile(r"<svg\b[^>]*>", re.S)
_VIEW = re.compile(r'viewBox="[^"]*"')
_OWN_STYLE = re.compile(r"<style>.*?</style>\n?", re.S)
_COLOUR = re.compile(r"#[0-9a-f]{6}\b")
_FAMILY = re.compile(r"; font-family: [^\";]*|font-family: [^\";]*(?:; )?")
_TURNED_BY_0 = re.compile(r' transform="rotate\(-?0 [^)]*\)"')
_FONT = re.compile(r"font-size: [\d.]+px")
_SPANS = re.compile(r'(?:<tspan x="[^"]*" y="[^"]*" style="[^"]*">(?:[^<&]|&[^;]*;)</tspan>\s*){2,}')
_SPAN = re.compile(r'<tspan x="([^"]*)" y="([^"]*)" style="([^"]*)">((?:[^<&]|&[^;]*;))</tspan>')
_PRIMES = re.compile(r'y="([^"]*)" style="font-size: ([\d.]+)px; font-family: \'cmsy10\'">0<')
_SHOWN = re.compile(r"(?<=>)(?!\s*<|&[^;]*;<)[^<]{2,}")
_GIVEN_ID = re.compile(r"""\bid=(?:"([^"]*)"|'([^']*)')""")
_HIDDEN = re.compile("\0([0-9]+)\0")
_MARKUP = re.compile(r'"|(?<=url\()#|(?<=xlink:href)=')
"""What `for_page` would take for its own in a name."""
_ID = re.compile(r' id="([^"]*)"')
_GROUP = re.compile(r"<(/?)g\b([^>]*)>\s*")
_REFERENCE = re.compile(r'(href="#|url\(#)([^")]+)')
_STYLE = re.compile(r'(?<= style=")[^"]*')
_USUAL = re.compile(r"(?<=[:;]) |; stroke-dashoffset: 0\b|; stroke-linejoin: miter\b")
_NOTHING = re.compile(r'<path [^>]*style="fill:none"/>\n')
_DEFINED = re.compile(r'<path id="([^"]+)"[^>]*?(style="[^"]*")/>')
_LINES = re.compile(
    r'<path d="M[^"z]*"((?: clip-path="[^"]*")? style="fill:none;(?:(?!opacity)[^"])*")/>\n'
    r'(?:<path d="M[^"z]*"\1/>\n)+'
)
_POINTS = re.compile(r' d="([^"]*)"')
_PATH = re.compile(r'(?<= d=")[^"]*(?=")')


def themed(text: str) -> str:
    """Make the SVG element of matplotlib's file that is the same on every ground, with the same bytes every time."""
    names: list[str] = []

    def hidden(name: str) -> str:
        # No step below may take a part of a name for markup, and no SVG has this character.
        names.append(_MARKUP.sub(lambda found: f"&#{ord(found[0])};", name))
        return f"\0{len(names) - 1}\0"

    def named(found: re.Match[str]) -> str:
        name = found[1] or found[2] or ""
        method = name.removeprefix("method-")
        return f'data-method="{hidden(method)}"' if method != name else f'id="{name.replace(chr(34), "")}"'

    text = _SHOWN.sub(lambda found: hidden(found[0]), _LEFT_OUT.sub("", text[text.index("<svg") :]))
    text = stable_svg(_GIVEN_ID.sub(named, text))
    text = _PRIMES.sub(_prime, _TURNED_BY_0.sub("", text))
    text = _FAMILY.sub("", _SPANS.sub(lambda found: _joined(found, hidden), text))
    used = {name for _, name in _REFERENCE.findall(text)}
    text = _ID.sub(lambda found: found[0] if found[1] in used else "", text)
    text = _COLOUR.sub(lambda found: in_css(found[0]), _PATH.sub(_short, text))
    text = _without_empty_groups(re.sub(r"\n\s+", "\n", text))
    view = _VIEW.search(text)
    head = f'<svg {view[0] if view else ""} fill="currentColor" stroke-linejoin="round">'
    text = _with_usual_font(_ROOT.sub(lambda _: head, text, count=1))
    text = _without_repetition(_STYLE.sub(lambda found: _USUAL.sub("", found[0]), text))
    return _HIDDEN.sub(lambda found: names[int(found[1])], text)


def as_file(text: str, families: Sequence[str]) -> str:
    """Give a themed SVG the colours of both grounds, and its fonts, so that it can stand alone."""
    used = {name for name in LIGHT if f"var(--{name})" in text} | {"bg", "fg"}
    fonts = ",".join(name if "-" in name or name == "serif" else f"'{name}'" for name in families)
    light, dark = (css_variables(ground, used) for ground in (LIGHT, DARK))
    style = (
        f"<style>svg{{{light};background:var(--bg);color:var(--fg);font-family:{fonts}}}"
        f"@media(prefers-color-scheme:dark){{svg{{{dark}}}}}</style>"
    )
    return _ROOT.sub(lambda found: f"<svg{NAMESPACES}{found[0][4:]}\n{style}", text, count=1)


def for_page(text: str, css_class: str) -> str:
    """Make a themed SVG, or a file of one, an element of a page: its class is in front of every id."""
    text = _OWN_STYLE.sub("", text[text.index("<svg") :].replace(NAMESPACES, ""), count=1)
    text = _REFERENCE.sub(rf"\g<1>{css_class}-\2", _ID.sub(rf' id="{css_class}-\1"', text))
    text = text.replace("xlink:href=", "href=").rstrip()
    return text.replace("<svg", f'<svg class="{css_class}" aria-hidden="true"', 1)


def _without_repetition(text: str) -> str:
    """Leave out what draws nothing, and what is said twice."""
    for name, style in dict(_DEFINED.findall(text)).items():
        text = re.sub(rf'(href="#{re.escape(name)}"[^>]*?) {re.escape(style)}', r"\1", text)
    # Lines of one style that follow each other, such as those of a grid, are one.
    text = _NOTHING.sub("", text)
    return _LINES.sub(lambda found: f'<path d="{" ".join(_POINTS.findall(found[0]))}"{found[1]}/>\n', text)


def _without_empty_groups(text: str) -> str:
    """Leave out the groups that say nothing of what is in them."""
    kept: list[bool] = []

    def tag(found: re.Match[str]) -> str:
        if found[2].endswith("/"):
            return ""
        if not found[1]:
            kept.append(bool(found[2]))
            return found[0] if kept[-1] else ""
        return found[0] if kept.pop() else ""

    return _GROUP.sub(tag, text)


def _with_usual_font(svg: str) -> str:
    """Name the size of most texts once, at the root."""
    usual = Counter(_FONT.findall(svg)).most_common(1)
    if not usual:
        return svg
    font = usual[0][0]
    svg = re.sub(
        rf'(?:; )?{re.escape(font)}(?:; )?(?=([^"]*)")',
        lambda found: "; " if found[0].startswith("; ") and found[1] else "",
        svg,
    ).replace(' style=""', "")
    return svg.replace("<svg ", f'<svg style="{font}" ', 1)


def _prime(found: re.Match[str]) -> str:
    """Write a prime as the character, which is raised in its font, at the height and in the size of the letters."""
    height, size = float(found[1]), float(found[2])
    return f'y="{height + RAISED * size:.2f}" style="font-size: {size / SUPERSCRIPT:g}px">{PRIME}<'


def _short(found: re.Match[str]) -> str:
    """Write straight lines by the steps from point to point, which have fewer digits; curves stay as they are."""
    tokens = found[0].split()
    if not tokens or not {each for each in tokens if each.isalpha()} <= {"M", "L", "z"}:
        return re.sub(r" \n|\n ", "\n", found[0].strip())
    parts: list[str] = []
    at, place = (0, 0), 0
    while place < len(tokens):
        letter = tokens[place]
        if letter == "z":
            parts.append("z")
            place += 1
            continue
        # In hundredths: sums of rounded steps have no error.
        x, y = (round(100 * float(number)) for number in tokens[place + 1 : place + 3])
        if letter == "M":
            parts.append(f"M{_digits(x)} {_digits(y)}l")
        else:
            dx, dy = _digits(x - at[0]), _digits(y - at[1])
            parts.append(
                f"{'' if parts[-1].endswith('l') or dx[0] == '-' else ' '}{dx}{'' if dy[0] == '-' else ' '}{dy}"
            )
        at, place = (x, y), place + 3
    return "".join(parts).replace("lM", "M").removesuffix("l")


def _digits(hundredths: int) -> str:
    text = f"{abs(hundredths) / 100:.2f}".rstrip("0").rstrip(".").removeprefix("0")
    return f"{'-' if hundredths < 0 else ''}{text or '0'}" if hundredths else "0"


def _joined(found: re.Match[str], hidden: Callable[[str], str]) -> str:
    """Join neighbours of one style and one height; each character keeps its horizontal position."""
    words: list[tuple[list[str], str, str, str]] = []
    # matplotlib orders them by style; a reader of the text by position.
    for x, y, style, character in sorted(_SPAN.findall(found[0]), key=lambda span: float(span[0])):
        if words and words[-1][1:3] == (y, style):
            words[-1] = ([*words[-1][0], x], y, style, words[-1][3] + character)
        else:
            words.append(([x], y, style, character))
    return "".join(
        f'<tspan x="{" ".join(at)}" y="{y}" style="{style}">{hidden(text)}</tspan>\n' for at, y, style, text in words
    )
