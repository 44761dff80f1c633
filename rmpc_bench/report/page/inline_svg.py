"""SVG files of matplotlib as elements of a page: ids that no other figure has, a title, and groups by method."""

from __future__ import annotations

import re
from html import escape

_METHOD = re.compile(r'\bid="method-(\d+)[^"]*"')
_ID = re.compile(r'\bid="([^"]+)"')
_REFERENCE = re.compile(r'(\b(?:xlink:)?href="#|url\(#)([^")]+)')
_OPENING = re.compile(r"<svg\b[^>]*>", re.DOTALL)
_SIZE = re.compile(r'\bviewBox="[\d.]+ [\d.]+ ([\d.]+) ')
_STYLE = re.compile(r'\bstyle="([^"]*)"\s*')
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_METADATA = re.compile(r"\s*<metadata>.*?</metadata>", re.DOTALL)


def inline_svg(text: str, name: str, title: str, description: str) -> str:
    """Return the SVG element of a file for use in a page, without declarations, comments, dates and links.

    Groups whose id is ``method-2`` or begins so get ``data-method="2"`` instead, by which a script can hide them.  The
    name, unique in the page, is put in front of every id.  Title and description are for readers who cannot see it.
    """
    start = text.find("<svg")
    text = _METADATA.sub("", _COMMENT.sub("", text[start:]))
    text = _METHOD.sub(r'data-method="\1"', text)
    text = _ID.sub(rf'id="{name}-\1"', text)
    text = _REFERENCE.sub(rf"\g<1>{name}-\2", text)
    opening = _OPENING.match(text)
    if opening is None:
        raise ValueError(f"{name}: not an SVG")
    head = (
        opening[0]
        .replace(' xmlns:xlink="http://www.w3.org/1999/xlink"', "")
        .replace(' xmlns="http://www.w3.org/2000/svg"', "")
        .replace(' aria-hidden="true"', "")
    )
    # HTML knows the namespace; the width is that of the print, in CSS so that a screen can enlarge or reduce it.
    width = next((float(found[1]) for found in _SIZE.finditer(head)), 0.0)
    # Browsers take the first of two attributes of one name and drop the other.
    style = "; ".join([*_STYLE.findall(head), f"--width: {width:g}pt"])
    head = re.sub(r"\s+", " ", _STYLE.sub("", head)).replace(" >", ">")
    labels = f'role="img" aria-labelledby="{name}-title {name}-desc" style="{style}"'
    body = f'<title id="{name}-title">{escape(title)}</title><desc id="{name}-desc">{escape(description)}</desc>'
    rest = text[opening.end() :].replace("xlink:href=", "href=").rstrip()
    return f"{head[:-1]} {labels}>{body}{rest}"
