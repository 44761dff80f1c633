"""Markdown of the generated pages: tables, escaped text, anchors, and the command that made a page."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path

from rmpc_bench import registry
from rmpc_bench.schema.manual import KeyEntry

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
MADE = "<!-- Made by `make docs`; changes by hand are lost. -->"
PLACE = re.compile(r"(<!-- begin of the table (\S+) -->\n).*?(<!-- end of the table -->)", re.DOTALL)
"""A generated table in a page that is written by hand."""
_CODE = re.compile(r"(``.+?``|`[^`]+`)")


def text(plain: str) -> str:
    """Escape a text of a docstring or of a configuration; what stands in backticks stays code.

    Parameters
    ----------
    plain : a text in one line or several
    """
    parts = _CODE.split(" ".join(plain.split()))
    return "".join(_code(part) if number % 2 else _escaped(part) for number, part in enumerate(parts))


def _escaped(part: str) -> str:
    """Escape what Markdown reads as markup; an underline between letters is none."""
    return re.sub(r"([*<|$\[\]\\~]|(?<!\w)_|_(?!\w))", r"\\\1", part).replace("`", "&#96;")


def _code(part: str) -> str:
    inner = part.strip("`")
    return _escaped(part) if "`" in inner else code(inner)


def code(plain: str) -> str:
    """Return a text as code, in a table, too; empty for an empty one."""
    return f"`{plain}`".replace("|", "\\|") if plain else ""


def block(language: str, lines: str) -> str:
    """Return a block of code; a line that would end it begins with a sign without width."""
    inner = re.sub(r"^([ \t>]*)(?=```|~~~)", "\\1\u200b", lines.strip("\n"), flags=re.MULTILINE)
    return f"```{language}\n{inner}\n```"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table.

    Parameters
    ----------
    heads : of the columns
    rows : cells in Markdown
    """
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("|".join(["", *(f" {cell.strip()} " if cell else " " for cell in line), ""]) for line in lines)


def key_table(keys: Iterable[KeyEntry]) -> str:
    """Return the table of some keys; the keys of a mapping follow it as PATH.KEY.

    Parameters
    ----------
    keys : of a component or of a section
    """
    rows = [row for key in keys for row in _rows(key, "")]
    return table(("key", "type", "default", "unit", "meaning"), rows)


def _rows(key: KeyEntry, prefix: str) -> list[tuple[str, ...]]:
    name = prefix + key.name
    default = "**required**" if key.default is None else code(key.default)
    meaning = text(key.meaning.replace(f" [{key.unit}]", "") if key.unit else key.meaning)
    row = (code(name), text(key.kind), default, key.unit, meaning)
    return [row, *(inner for each in key.keys for inner in _rows(each, f"{name}."))]


def anchor(*words: str) -> str:
    """Return the name of an anchor."""
    return re.sub(r"[^\w.-]", "-", "-".join(words))


def heading(level: int, title: str, *words: str) -> str:
    """Return a heading, with an anchor of its own where words are given."""
    mark = f'<a id="{anchor(*words)}"></a>\n\n' if words else ""
    return f"{mark}{'#' * level} {title}"


def page(*parts: str) -> str:
    """Join the paragraphs of a page."""
    return "\n\n".join([MADE, *(part for part in parts if part)]) + "\n"


def filled(page: Path, tables: Mapping[str, Callable[[], str]]) -> str:
    """Return the text of a page with every generated table made again; each of them has one place."""
    written = page.read_text(encoding="utf-8")
    assert sorted(name for _, name, _ in PLACE.findall(written)) == sorted(tables), page.name
    return PLACE.sub(lambda found: f"{found[1]}\n{tables[found[2]]()}\n\n{found[3]}", written)


@cache
def kept_figures() -> list[str]:
    """Return the figures that git keeps; others may lie beside them after a run."""
    lines = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    return [line.removeprefix("!") for line in lines if line.startswith("!results/") and line.endswith(".svg")]


def equation_of(group: str, kind: str) -> str:
    """Return the central equation of a kind in LaTeX, `EQUATION` of its module; empty where it is defined in words.

    A module with several kinds has a mapping from the names of their functions or classes.  A plant without an equation
    has that of the design model of its name.
    """
    if kind not in registry.BUILT_IN[group]:
        return ""
    module, name = registry.BUILT_IN[group][kind].split(":")
    found = getattr(import_module(module), "EQUATION", "")
    equation = found if isinstance(found, str) else found.get(name, "")
    return equation or (equation_of("models", kind) if group == "plants" else "")
