"""Docstrings of a component as Markdown: paragraphs, labelled ones as a list, links to the pages of papers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from docs.markdown import DOCS, text

from rmpc_bench import registry
from rmpc_bench.schema.manual import Manual

_LABEL = re.compile(r"([A-Z][a-z]+) +(?=\S)")
_INDENT = 8
"""Column at which the text of a labelled paragraph of a module begins."""
_TERM = re.compile(r"(`?[a-z][a-z_-]*`?) {2,}(?=\S)")
_PAPER = re.compile(r"\b[a-z]+\d{4}\b")
_EQUATION = "="
SHARED_BY = 3
"""Kinds with the same key or text from which on it stands on the page of their group only."""


def texts(manual: Manual, formula: Sequence[str]) -> list[str]:
    """Return the paragraphs of a component: its own ones, its equation and those of its module.

    The first line of a module is left out: that of the component says the same.  A part of the module that names
    another kind of it is left out, too.
    """
    rest, labelled = _labelled(manual.module)
    module = registry.BUILT_IN[manual.group][manual.kind].partition(":")[0]
    others = {
        kind for kinds in registry.BUILT_IN.values() for kind in kinds if kinds[kind].startswith(f"{module}:")
    } - {manual.kind}
    items = [item for label, words in labelled for item in _item(label, words, manual.kind, others)]
    about = [] if len(sharing(manual)) >= SHARED_BY else _paragraphs(rest)
    # Parsers that are not of a code host end a list item of several blocks at an empty line only.
    between = "\n\n" if any("\n" in item for item in items) else "\n"
    listed = re.sub(r"\n{3,}", "\n\n", between.join(items))
    return [*_paragraphs(manual.text), *about, *formula, listed, *_methods(manual)]


def module_text(manual: Manual) -> str:
    """Return what three kinds or more of a module have in common, without its labelled paragraphs."""
    return text(" ".join(_labelled(manual.module)[0].split())) if len(sharing(manual)) >= SHARED_BY else ""


def sharing(manual: Manual) -> list[str]:
    """Return the kinds of the group that are in the same module."""
    kinds = registry.BUILT_IN[manual.group]
    modules = {kind: place.partition(":")[0] for kind, place in kinds.items()}
    return sorted(kind for kind, module in modules.items() if module == modules[manual.kind])


def _item(label: str, words: str, kind: str, others: set[str]) -> Iterator[str]:
    """A labelled paragraph as an item of a list; its terms are items below it, its equations are code."""
    (_, first), *rest = [(name, lines) for name, lines in _parts(words) if name not in others]
    opened = " ".join([*first, *(line for name, lines in rest if name == kind for line in lines)])
    if opened.strip() or rest:
        yield f"- **{label}** {text(opened)}".rstrip()
    for name, lines in rest:
        if name == _EQUATION:
            yield "\n  ```text\n" + "\n".join(f"  {line.strip()}" for line in lines) + "\n  ```\n"
        elif name != kind:
            yield (f"  - `{name}` " if name else "\n  ") + text(" ".join(lines))


def _parts(words: str) -> list[tuple[str, list[str]]]:
    """Parts of a labelled paragraph, each after its name: a term, "=" for an equation, "" for prose as the first is."""
    found: list[tuple[str, list[str]]] = [("", [])]
    for line in words.split("\n"):
        inner, last = line.removeprefix(" " * _INDENT), found[-1][0]
        term = _TERM.match(inner)
        name = _EQUATION if inner.startswith("    ") and last in ("", _EQUATION) else ""
        if term:
            found.append((term[1].strip("`"), [inner[term.end() :]]))
        elif last == name or (last not in ("", _EQUATION) and inner.startswith(" ")):
            found[-1][1].append(inner)
        else:
            found.append((name, [inner]))
    return [found[0], *(part for part in found[1:] if "".join(part[1]).strip())]


def _labelled(module: str) -> tuple[str, list[tuple[str, str]]]:
    """Split the docstring of a module, without its first line, at its labelled paragraphs."""
    _, *lines = module.split("\n")
    title: list[str] = []
    found: list[tuple[str, list[str]]] = []
    for line in lines:
        label = _LABEL.match(line)
        if label and label.end() == _INDENT:
            found.append((label[1], [line[_INDENT:]]))
        elif found and (line.startswith(" ") or not line):
            found[-1][1].append(line)
        else:
            title.append(line)
    return "\n".join(title), [(label, "\n".join(words)) for label, words in found]


def _paragraphs(doc: str) -> list[str]:
    """Paragraphs of a docstring; indented ones are code."""
    found = []
    for paragraph in re.split(r"\n\s*\n", doc.strip()):
        indented = paragraph.startswith("    ")
        items = [text(item) for item in re.split(r"\n(?=- )", paragraph)]
        found.append(f"```text\n{paragraph}\n```" if indented else "\n".join(items))
    return [each for each in found if each]


def _methods(manual: Manual) -> list[str]:
    """Links to the pages of the papers that the module names."""
    papers = dict.fromkeys(_PAPER.findall(manual.module + manual.text))
    links = [f"[{paper}](../../methods/{paper}.md)" for paper in papers if (DOCS / "methods" / f"{paper}.md").exists()]
    return [f"Paper: {', '.join(links)}."] if links else []
