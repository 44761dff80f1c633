"""Pages of the shipped experiments, of their papers, and the gallery."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docs.markdown import DOCS, ROOT, kept_figures, text
from docs.site.pages import Site, outside_code, sections, slug

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load


def write(site: Site) -> None:
    """Add a page per experiment, one per paper, the reproductions and the gallery."""
    cards: dict[str, list[str]] = {}
    for file in sorted((ROOT / "configs").rglob("*.yaml")):
        name = file.relative_to(ROOT / "configs").with_suffix("").as_posix()
        tree = plain(load(file))
        figure = next((path for path in kept_figures() if path.startswith(f"results/{name}/")), "")
        _page(site, name, file, tree, figure)
        cards.setdefault(name.rpartition("/")[0], []).append(_card(name, str(tree.get("title", name)), figure))
    _reproductions(site)
    grids = {
        group: '<div class="grid" markdown>\n' + "\n".join(each) + "\n</div>" for group, each in cards.items() if group
    }
    for group, grid in grids.items():
        path = f"experiments/{group}/index.md"
        site.add(path, f"# {group}\n\n{grid}")
    body = "\n\n".join(f"## [{group}](/experiments/{group}/index.md)\n\n{grid}" for group, grid in grids.items())
    site.add("experiments/index.md", f"# Gallery\n\n{body}")


def _page(site: Site, name: str, file: Path, tree: dict[str, Any], figure: str) -> None:
    parts = [f"# {name}", text(str(tree.get("title", name))), text(str(tree.get("summary", "")))]
    parts += [f"![{Path(figure).stem} of {name}](../{figure})"] * bool(figure)
    parts += [f"```console\n$ rmpc-bench run {name}\n```", f"## Configuration\n\n```yaml\n{file.read_text('utf-8')}```"]
    site.add(f"experiments/{name}.md", "\n\n".join(parts))
    site.titles[f"experiments/{name}.md"] = name.rpartition("/")[2]


def _card(name: str, title: str, figure: str) -> str:
    path = f"/experiments/{name}.md"
    picture = f"[![{name}](../{figure}){{ loading=lazy }}]({path})" * bool(figure)
    return f'<div class="card" markdown>\n{picture}\n\n[**{name.rpartition("/")[2]}**]({path})\n\n{text(title)}\n</div>'


def _reproductions(site: Site) -> None:
    """The parts of docs/reproductions.md as pages."""
    (_, first), *parts = sections((DOCS / "reproductions.md").read_text(encoding="utf-8"))
    for title, part in parts:
        path = f"experiments/reproductions/{slug(title)}.md"
        up = outside_code(lambda each: re.sub(r"^##(#*) ", r"#\1 ", each, flags=re.MULTILINE), part)
        site.add(path, up, "reproductions.md")
    site.add("experiments/reproductions/index.md", first, "reproductions.md")
    site.lead("reproductions.md", "", "experiments/reproductions/index.md")
