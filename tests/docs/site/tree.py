"""The tree of the documentation site: which file of docs/ becomes which pages, and the navigation."""

from __future__ import annotations

from typing import Any

from docs.markdown import DOCS
from docs.site import experiments, python_page
from docs.site.pages import Site

from docs import components_page

PARTS = {
    "Tutorials": "tutorial",
    "How-to": "how-to",
    "Gallery": "experiments",
    "Components": "components",
    "Reference": "reference",
    "Explanation": "explanation",
}
"""Name in the navigation -> folder."""
PLACES = {
    "tutorial.md": "tutorial/first-comparison.md",
    "own-components.md": "tutorial/own-components.md",
    "choose-an-estimator.md": "how-to/choose-an-estimator.md",
    "coming-from.md": "how-to/coming-from.md",
    "statistics.md": "explanation/statistics.md",
    "design.md": "explanation/design.md",
    "glossary.md": "explanation/glossary.md",
    "numbers.md": "experiments/numbers.md",
    "servo-constrained.md": "experiments/servo-constrained/results.md",
}
"""File of docs/ -> page; those that are not named are in how-to, after these."""
SPLIT = {
    "experiments.md": "how-to/experiments",
    "libraries.md": "how-to/libraries",
    "reference.md": "reference/configuration",
}
"""File of docs/ -> folder of its pages."""
ELSEWHERE = {"components.md", "reproductions.md", "suite.md", "files.md"}
"""Files of docs/ that other modules add, and the list of files, which is for those who change the program."""


def site() -> Site:
    """Return all pages."""
    made = Site()
    made.whole("index.md", "../README.md")
    others = {file.name for file in DOCS.glob("*.md")} - {*PLACES, *SPLIT} - ELSEWHERE
    for name, path in {**PLACES, **{name: f"how-to/{name}" for name in sorted(others)}}.items():
        if (DOCS / name).exists():
            made.whole(path, name)
    for name, folder in SPLIT.items():
        made.split(name, folder)
    papers = [f"explanation/papers/{file.name}" for file in sorted((DOCS / "methods").glob("*.md"))]
    for path in papers:
        made.whole(path, f"methods/{path.rpartition('/')[2]}")
    links = "\n".join(f"- [{made.titles[path]}](/{path})" for path in papers)
    made.add("explanation/papers/index.md", f"# Equations of the papers\n\n{links}")
    made.lead("methods", "", "explanation/papers/index.md")
    experiments.write(made)
    for file in components_page.pages():
        name = file.relative_to(DOCS).as_posix()
        made.whole("components/index.md" if file == components_page.INDEX else name, name)
    python_page.write(made)
    return made


def navigation(made: Site) -> list[Any]:
    """Return the navigation: a part per folder, in it the pages in the order in which they were added."""
    return [{"Home": "index.md"}, *({title: _group(made, f"{folder}/")} for title, folder in PARTS.items())]


def _group(made: Site, prefix: str) -> list[Any]:
    inner = [path.removeprefix(prefix) for path in made.texts if path.startswith(prefix)]
    first: list[Any] = [f"{prefix}index.md"] * ("index.md" in inner)
    pages = [{made.titles[prefix + name]: prefix + name} for name in inner if "/" not in name and name != "index.md"]
    folders = [f"{prefix}{name}/" for name in dict.fromkeys(name.partition("/")[0] for name in inner if "/" in name)]
    return [*first, *pages, *({made.titles[f"{folder}index.md"]: _group(made, folder)} for folder in folders)]
