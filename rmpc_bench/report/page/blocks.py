"""Blocks of a page as plain data, which the templates for HTML and for Markdown lay out.

A text is a string with formulas as ``$..$``, or a list of strings and of the pieces that `code`, `strong` and `link`
make.  Everything in a string is escaped, so that labels and titles of a user cannot add markup.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

Piece: TypeAlias = str | dict[str, str]
Text: TypeAlias = str | list[Piece]
Block: TypeAlias = dict[str, Any]


def code(text: str) -> dict[str, str]:
    """Make a piece of program text."""
    return {"code": text}


def strong(text: str) -> dict[str, str]:
    """Make an emphasised piece."""
    return {"strong": text}


def badge(text: str, style: str) -> dict[str, str]:
    """Make a word in a coloured field; `style` is ``yes``, ``no`` or ``open``."""
    return {"badge": text, "style": style}


def link(target: str, text: str) -> dict[str, str]:
    """Make a link to a place of the page (``#id``) or a file beside it."""
    return {"link": target, "text": text}


def paragraph(text: Text, style: str = "") -> Block:
    """Make a paragraph; `style` is ``lead``, ``note`` or empty."""
    return {"kind": "paragraph", "text": text, "style": style}


def heading(text: Text, anchor: str = "") -> Block:
    """Make a heading below that of the section."""
    return {"kind": "heading", "text": text, "id": anchor}


def bullets(items: Sequence[Text]) -> list[Block]:
    """Make a list; nothing without items."""
    return [{"kind": "list", "items": list(items)}] if items else []


def facts(items: Sequence[tuple[str, Text]]) -> list[Block]:
    """Make a list of names with their values; nothing without items."""
    return [{"kind": "facts", "items": [{"name": name, "value": value} for name, value in items]}] if items else []


def folded(title: Text, blocks: Sequence[Block]) -> list[Block]:
    """Make blocks that open on demand; nothing without blocks."""
    return [{"kind": "folded", "title": title, "blocks": list(blocks)}] if blocks else []


def program(text: str, language: str = "") -> Block:
    """Make lines of program text."""
    return {"kind": "program", "text": text.rstrip("\n"), "language": language}


def table(
    caption: Text,
    columns: Mapping[str, Sequence[Text]],
    *,
    methods: Sequence[int | None] = (),
    metric: str = "",
    notes: Sequence[Text] = (),
    prose: bool = False,
) -> Block:
    """Make a table whose first column names its rows, from head -> cells.

    A row has the number of its method, by which it can be hidden, or None.  By its metric the table can be chosen.
    Notes are lines below it.  Cells of `prose` hold sentences, which are broken into lines.
    """
    rows = [list(cells) for cells in zip(*columns.values(), strict=True)]
    numbers = [*methods] if methods else [None] * len(rows)
    return {
        "kind": "table",
        "caption": caption,
        "heads": [{"text": head, "numeric": _is_numeric(cells)} for head, cells in columns.items()],
        "rows": [{"method": number, "cells": cells} for number, cells in zip(numbers, rows, strict=True)],
        "metric": metric,
        "notes": list(notes),
        "prose": prose,
    }


def _is_numeric(cells: Sequence[Text]) -> bool:
    """Whether the cells of a column begin with a number, or with a dash where there is none."""
    texts = [cell.strip() for cell in cells if isinstance(cell, str)]
    starts = [text.lstrip("+-\u2212")[:1] for text in texts if text not in ("", "-")]
    return len(texts) == len(cells) and bool(starts) and all(start.isdigit() for start in starts)


def section(anchor: str, title: str, blocks: Sequence[Block], short: str = "") -> Block:
    """Make a section of the page; `short` is its name in the contents, the title unless given."""
    return {"id": anchor, "title": title, "short": short or title, "blocks": list(blocks)}
