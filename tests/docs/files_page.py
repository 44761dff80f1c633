"""docs/files.md: every file of the package in one sentence, the first one of its docstring."""

from __future__ import annotations

import ast
import re

from docs.markdown import ROOT

PAGE = ROOT / "docs" / "files.md"
PACKAGE = ROOT / "rmpc_bench"
HEAD = """# Every file of the package

[design.md](design.md) says how the folders belong together. Here every file has one sentence, the first one of its
docstring. `make docs` writes this page.
"""


def generated() -> str:
    """The page: a heading for every folder, a line for every file of it."""
    folders: dict[str, list[str]] = {}
    for file in sorted(PACKAGE.rglob("*.py"), key=lambda path: (path.parent.as_posix(), path.name)):
        text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        if text and file.stem != "__main__":
            sentence = " ".join(re.split(r"(?<=\.)\s|\n\n", f"{text} ", maxsplit=1)[0].split()).rstrip(".:")
            folder = file.parent.relative_to(ROOT).as_posix()
            folders.setdefault(folder, []).append(f"- `{file.name}`: {_plain(sentence)}")
    parts = [f"## `{folder}/`\n\n" + "\n".join(lines) + "\n" for folder, lines in folders.items()]
    return "\n".join([HEAD, *parts])


def _plain(text: str) -> str:
    """A sentence in which Markdown finds nothing to set."""
    return re.sub(r"([*_|<>\[\]])", r"\\\1", re.sub(r"`+([^`]*)`+", r"\1", text))
