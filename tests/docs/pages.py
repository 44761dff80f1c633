"""All pages that are made from the program: ``python -m docs.pages`` (or ``make docs``) writes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from docs.markdown import ROOT, filled

from docs import (
    components_page,
    constraints_page,
    decision_page,
    files_page,
    followed_page,
    reference_page,
    reproductions_page,
    suite_page,
    worked_comparisons,
)

WITH_TABLES = (reproductions_page, constraints_page, suite_page, decision_page, worked_comparisons)
"""Modules with the tables of a page that is written by hand."""
PAGES: Mapping[Path, Callable[[], str]] = {
    **components_page.pages(),
    reference_page.PAGE: reference_page.generated,
    files_page.PAGE: files_page.generated,
    **{page: partial(followed_page.updated, page) for page in followed_page.FOLLOWED},
    **{each.PAGE: partial(filled, each.PAGE, each.TABLES) for each in WITH_TABLES},
}
"""Page -> the function that makes its text."""


def left_over() -> list[Path]:
    """Return the pages of components that are no longer made."""
    return sorted({*components_page.FOLDER.rglob("*.md")} - {*PAGES})


def main() -> None:
    """Write the pages that have changed, and remove those of components that no longer exist."""
    for path in left_over():
        path.unlink()
        print(f"removed {path.relative_to(ROOT)}")
    for path, make in PAGES.items():
        text = make()
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
            print(f"written {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
