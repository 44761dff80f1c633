"""What names and texts of a file must not contain, what a screen and a page show of them, and lines of a terminal.

A name contains no character that a reader cannot see, since two names would look alike.  A text may, because some
scripts and emoji need joiners.  Neither contains a control character or one that changes the direction of writing.
"""

from __future__ import annotations

import re
import shlex
import unicodedata
from collections.abc import Sequence

_DIRECTION = "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"
_REFUSED = re.compile(f"[\0-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff{_DIRECTION}]")
_TAG = re.compile(r"<(?=[A-Za-z/!?])")
_DEFINITION = re.compile(r"^([\s\d>#*.+)-]*\[[^\]\n]*\]):", re.MULTILINE)
_LINK = re.compile(r"(?<=:)//|(?<=www)\.|@(?=\w)|&(?=#?\w{1,31};)", re.IGNORECASE)
_LABEL = re.compile(r" *\S+(?: \S+)*?(?<!\.) {2,}(?=\S)")
_LONGEST_LABEL = 28
_FORMULA = re.compile(r"\$([^$]*)\$")
_UNSEEN = ("Cc", "Cf", "Cs", "Zl", "Zp")


def refused_in_name(name: str) -> str:
    r"""Say which character a name must not contain; empty where there is none.

    Examples
    --------
    >>> refused_in_name("KF\u200b"), refused_in_name("Kálmán, $c_1$")
    ('contains the invisible character U+200B; leave it out', '')
    """
    if name.isprintable():
        return ""
    return _said(next((each for each in name if unicodedata.category(each) in _UNSEEN), ""))


def refused_in_text(text: str) -> str:
    r"""Say which character a text of several lines must not contain; empty where there is none.

    Examples
    --------
    >>> refused_in_text("a\x1b]0;b"), refused_in_text("a\n\tb")
    ('contains the control character U+001B; leave it out', '')
    """
    found = _REFUSED.search(text)
    return _said(found[0] if found else "")


def visible(text: str) -> str:
    r"""Return a text with escapes in place of the characters that `refused_in_text` names.

    Examples
    --------
    >>> print(visible("a\x1b[2Jb\u202e"))
    a\x1b[2Jb\u202e
    """
    return _REFUSED.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def without_links(text: str) -> str:
    """Write Markdown in which no address becomes a link, no name a mention, and no entity a character."""
    return _LINK.sub(lambda found: "".join(f"&#{ord(each)};" for each in found[0]), text)


def inert_markdown(text: str) -> str:
    r"""Return Markdown without HTML, links, images and definitions of links; formulas, code and tables stay.

    Examples
    --------
    >>> inert_markdown("<b>a</b> [b](c) $x < 1$")
    '&lt;b>a&lt;/b> [b]&#40;c) $x < 1$'
    """
    return _DEFINITION.sub(r"\1&#58;", _TAG.sub("&lt;", text).replace("](", "]&#40;"))


def width_of(text: str) -> int:
    """Count the columns of a terminal that a text takes."""
    if text.isascii():
        return len(text)
    wide = sum(unicodedata.east_asian_width(each) in "WF" for each in text)
    return (
        len(text) + wide - sum(unicodedata.combining(each) > 0 or unicodedata.category(each) == "Cf" for each in text)
    )


def cut(text: str, width: int) -> str:
    """Shorten a text, with two points in place of its end.

    Examples
    --------
    >>> cut("KF", 12), cut("a-very-long-name", 12)
    ('KF', 'a-very-lon..')
    """
    if width_of(text) <= width:
        return text
    while text and width_of(text) > width - 2:
        text = text[:-1]
    return text + ".."


def without_formulas(text: str, names: Sequence[str] = ()) -> str:
    r"""Write formulas as a terminal shows them; names of methods are none, whatever they contain.

    Examples
    --------
    >>> without_formulas(r"$x_0$ of $\\delta_{v}^2$")
    'x_0 of delta_v^2'
    """
    odd = [re.escape(name) for name in sorted(names, key=len, reverse=True) if "$" in name]
    parts = re.compile("|".join([*odd, _FORMULA.pattern]))
    return parts.sub(lambda found: found[0] if found[1] is None else re.sub(r"[\\{}]", "", found[1]), text)


def squared(unit: str) -> str:
    """Write the square of a unit: rad^2, (mol/l)^2, and nothing for no unit."""
    return f"{unit}^2" if unit.isalpha() else unit and f"({unit})^2"


def wrapped(text: str, width: int, indent: str = "", first: str | None = None) -> list[str]:
    """Break a text at blanks, and a longer word where the line ends; the first line may have another indent."""
    lines, line, empty = list[str](), indent if first is None else first, True
    for word in text.split():
        if not empty and width_of(line) + 1 + width_of(word) > width:
            lines.append(line)
            line, empty = indent, True
        line, empty = f"{line}{'' if empty else ' '}{word}", False
        while width_of(line) > width:
            n = width
            while width_of(line[:n]) > width:
                n -= 1
            lines.append(line[:n])
            line = indent + line[n:]
    return [*lines, line]


def command_lines(command: str, width: int) -> list[str]:
    """Break a command of the shell between its arguments; an argument that is wider than a line stays whole."""
    lines = [""]
    for each in map(shlex.quote, shlex.split(command)):
        if lines[-1] and width_of(lines[-1]) + width_of(each) + 3 > width:
            lines[-1] += " \\"
            lines.append("")
        lines[-1] += f" {each}" if lines[-1] else each
    return lines


def folded(lines: Sequence[str], width: int) -> list[str]:
    """Break the lines that are too long; what follows a label or an indent stays behind it.

    Examples
    --------
    >>> folded(["  plant    servo with parameters that differ"], 30)
    ['  plant    servo with', '           parameters that', '           differ']
    """
    found = list[str]()
    for line in lines:
        if width_of(line) <= width:
            found.append(line)
            continue
        label = _LABEL.match(line)
        start = (
            label[0]
            if label is not None and len(label[0]) <= min(_LONGEST_LABEL, width // 2)
            else line[: len(line) - len(line.lstrip())]
        )
        found += wrapped(
            line[len(start) :], width, " " * (len(start) + 2 * (not start.strip() and len(start) < 4)), start
        )
    return found


def in_columns(rows: Sequence[Sequence[str]], right: Sequence[int] = (), *, indent: str = " ") -> list[str]:
    """Put cells below each other with two blanks between columns; `right` are those that end at the same place."""
    widths = [max(map(width_of, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        blanks = [" " * (width - width_of(cell)) for cell, width in zip(row, widths, strict=True)]
        cells = [
            blank + cell if k in right else cell + blank
            for k, (cell, blank) in enumerate(zip(row, blanks, strict=True))
        ]
        lines.append((indent + "  ".join(cells)).rstrip())
    return lines


def _said(character: str) -> str:
    if not character:
        return ""
    is_control = unicodedata.category(character) == "Cc"
    kind = "control" if is_control else "direction" if re.match(f"[{_DIRECTION}]", character) else "invisible"
    return f"contains the {kind} character U+{ord(character):04X}; leave it out"
