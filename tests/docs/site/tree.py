"""The tree of the documentation site: which file of docs/ becomes which pages, and the navigation."""

from __future__ import annotations

from typing import Any

from docs.markdown import DOCS
from docs.site import components, experiments, python_page
from docs.site.pages import Site

PARTS = {
    "Tutorials": "tutorial",
    "How-to": "how-to",
    "Gallery": "experiments",
    "Components": "components",
    "Reference": "reference",
    "Explanation": "explanation",
}
"""Name in the navigation -> folder."""
WHOLE = {
    "tutorial/first-comparison.md": "tutorial.md",
    "tutorial/own-components.md": "own-components.md",
    **{
        f"how-to/{name}.md": f"{name}.md"
        for name in (
            "choose-an-estimator",
            "coming-from",
            "tuning",
            "constraints",
            "own-simulator",
            "cluster",
            "suite",
            "python",
            "security",
            "examples",
        )
    },
    **{f"explanation/{name}.md": f"{name}.md" for name in ("statistics", "design", "glossary")},
    "experiments/numbers.md": "numbers.md",
}
"""Page -> file of docs/."""
SPLIT = {
    "experiments.md": "how-to/experiments",
    "libraries.md": "how-to/libraries",
    "reference.md": "reference/configuration",
}
"""File of docs/ -> folder of its pages."""


def site() -> Site:
    """Return all pages."""
    made = Site()
    made.whole("index.md", "../README.md")
    for path, name in WHOLE.items():
        if (DOCS / name).exists():
            made.whole(path, name)
    for name, folder in SPLIT.items():
        made.split(name, folder)
    papers = sorted((DOCS / "methods").glob("*.md"))
    for file in papers:
        made.whole(f"explanation/papers/{file.name}", f"methods/{file.name}")
    links = [f"- [{made.titles[path]}](/{path})" for path in (f"explanation/papers/{file.name}" for file in papers)]
    made.add("explanation/papers/index.md", "# Equations of the papers\n\n" + "\n".join(links))
    made.lead("files.md", "", "explanation/design.md")
    made.lead("methods", "", "explanation/papers/index.md")
    experiments.write(made)
    components.write(made)
    python_page.write(made)
    return made


def navigation(made: Site) -> list[Any]:
    """Return the navigation: a part per folder, in it the pages in the order in which they were added."""
    return [{"Home": "index.md"}, *({title: _group(made, f"{folder}/")} for title, folder in PARTS.items())]


def _group(made: Site, prefix: str) -> list[Any]:
    inner = [path.removeprefix(prefix) for path in made.texts if path.startswith(prefix)]
    pages = [name for name in inner if "/" not in name and name != "index.md"]
    folders = sorted({name.partition("/")[0] for name in inner if "/" in name})
    first: list[Any] = [f"{prefix}index.md"] * ("index.md" in inner)
    found = [{made.titles[prefix + name]: prefix + name} for name in pages]
    return [*first, *found, *({name: _group(made, f"{prefix}{name}/")} for name in folders)]
