"""docs/files.md: every file of the package in one sentence, the first one of its docstring."""

from __future__ import annotations

import ast
import re

from docs.markdown import ROOT

PAGE = ROOT / "docs" / "files.md"
PACKAGE = ROOT / "rmpc_bench"
HEAD = """# Every file of the package

[design.md](design.md) says how the folders belong together. Here every file has one sentence, the first one of its
docstring, and the names of its public constants and classes. `make docs` writes this page.
"""


def generated() -> str:
    """The page: a heading for every folder, a line for every file of it."""
    folders: dict[str, list[str]] = {}
    for file in sorted(PACKAGE.rglob("*.py"), key=lambda path: (path.parent.as_posix(), path.name)):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        text = ast.get_docstring(tree) or ""
        if text and file.stem != "__main__":
            sentence = " ".join(re.split(r"(?<=\.)\s|\n\n", f"{text} ", maxsplit=1)[0].split()).rstrip(".:")
            folder = file.parent.relative_to(ROOT).as_posix()
            folders.setdefault(folder, []).append(f"- `{file.name}`: {_plain(sentence)}{_names(tree)}")
    parts = [f"## `{folder}/`\n\n" + "\n".join(lines) + "\n" for folder, lines in folders.items()]
    return "\n".join([HEAD, *parts])


def _names(tree: ast.Module) -> str:
    """The public constants and classes of a file, in their order."""
    found = []
    for each in tree.body:
        if isinstance(each, ast.ClassDef):
            found.append(each.name)
        elif isinstance(each, ast.Assign | ast.AnnAssign):
            targets = each.targets if isinstance(each, ast.Assign) else [each.target]
            found += [name.id for one in targets for name in ast.walk(one) if isinstance(name, ast.Name)]
    names = [name for name in dict.fromkeys(found) if not name.startswith("_") and name != "EQUATION"]
    return f" (`{', '.join(names)}`)" if names else ""


def _plain(text: str) -> str:
    """A sentence in which Markdown finds nothing to set."""
    return re.sub(r"([*_|<>\[\]])", r"\\\1", re.sub(r"`+([^`]*)`+", r"\1", text))
