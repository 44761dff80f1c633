"""Pages of the components: the files of docs/components, one per kind and one per group."""

from __future__ import annotations

from docs.markdown import DOCS
from docs.site.pages import Site

from docs import components_page


def write(site: Site) -> None:
    """Add docs/components.md and all files of docs/components at the same places."""
    for file in components_page.pages():
        name = file.relative_to(DOCS).as_posix()
        path = "components/index.md" if file == components_page.INDEX else name
        site.whole(path, name)
