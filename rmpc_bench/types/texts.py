"""What names and texts of a file must not contain, and what a screen and a page show of them.

A name contains no character that a reader cannot see, since two names would look alike.  A text may, because some
scripts and emoji need joiners.  Neither contains a control character or one that changes the direction of writing.
"""

from __future__ import annotations

import re
import unicodedata

_DIRECTION = "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"
_REFUSED = re.compile(f"[\0-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff{_DIRECTION}]")
_TAG = re.compile(r"<(?=[A-Za-z/!?])")
_DEFINITION = re.compile(r"^([\s\d>#*.+)-]*\[[^\]\n]*\]):", re.MULTILINE)
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


def inert_markdown(text: str) -> str:
    r"""Return Markdown without HTML, links, images and definitions of links; formulas, code and tables stay.

    Examples
    --------
    >>> inert_markdown("<b>a</b> [b](c) $x < 1$")
    '&lt;b>a&lt;/b> [b]&#40;c) $x < 1$'
    """
    return _DEFINITION.sub(r"\1&#58;", _TAG.sub("&lt;", text).replace("](", "]&#40;"))


def _said(character: str) -> str:
    if not character:
        return ""
    is_control = unicodedata.category(character) == "Cc"
    kind = "control" if is_control else "direction" if re.match(f"[{_DIRECTION}]", character) else "invisible"
    return f"contains the {kind} character U+{ord(character):04X}; leave it out"
