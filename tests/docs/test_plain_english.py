"""Sentences of the guide are short: a reader whose third language is English reads each of them once."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GENERATED = {"reference.md", "components.md"}
"""Their sentences are those of docstrings, of the schema and of claims."""
PAGES = [
    page
    for page in sorted((ROOT / "docs").rglob("*.md"))
    if page.name not in GENERATED and "components" not in page.parts
] + [ROOT / "CONTRIBUTING.md"]
LONGEST = 30
"""Words of a sentence; a formula, a name in code or a link counts as one."""


def paragraphs(text: str) -> list[str]:
    """Prose without code, formulas, headings and generated parts; cells of tables and items of lists are separate."""
    text = re.sub(r"<!-- begin.*?end of .*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"^ *```.*?^ *```", "\n", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"\$\$.*?\$\$", "\n\n", text, flags=re.DOTALL)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`|\$[^$\n]*\$", "X", text)
    text = re.sub(r"^#.*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"^ *\|.*$", lambda row: row[0].replace("|", "\n\n"), text, flags=re.MULTILINE)
    text = re.sub(r"^ *(?:[-*]|\d+\.) ", "\n", text, flags=re.MULTILINE)
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n", text) if part.strip()]


def sentences(text: str) -> list[str]:
    """Sentences end with a point, a question mark or a colon before a space, also inside emphasis."""
    found = [re.split(r"(?<=[.?:!])[*)\"]*\s+(?=[A-Z*(\"])", part) for part in paragraphs(text)]
    return [sentence for part in found for sentence in part]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_sentences_are_short(page):
    found = sentences(page.read_text("utf-8"))
    long = [f"{len(s.split())} words: {s}" for s in found if len(s.split()) > LONGEST]
    assert found and not long, "\n".join(long)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_at_most_one_semicolon_in_a_sentence(page):
    chained = [s for s in sentences(page.read_text("utf-8")) if s.count(";") > 1]
    assert not chained, "\n".join(chained)


def test_sentences_are_found():
    text = "# Head\nOne is here. Two `a.b` is $x. Y$ there: three.\n\n- item\n- other item\n\n| cell | next |\n"
    assert sentences(text) == ["One is here.", "Two X is X there: three.", "item", "other item", "cell", "next"]
