"""Pages of the components: one per kind, one per group."""

from __future__ import annotations

from docs.markdown import anchor, key_table, table
from docs.site.pages import Site

from docs import components_page
from rmpc_bench import registry
from rmpc_bench.schema.manual import shared_keys


def write(site: Site) -> None:
    """Add a page per kind and one per group."""
    groups = []
    for group, kinds in registry.BUILT_IN.items():
        for kind in sorted(kinds):
            path = f"components/{group}/{kind}.md"
            mark, *body = components_page._component(group, kind)
            parts = [
                f"# {kind}",
                f"*{registry.singular(group).capitalize()}.* `rmpc-bench describe {group}/{kind}`",
                *body,
            ]
            site.add(path, "\n\n".join(parts), "components.md", anchors=False)
            site.lead("components.md", anchor(group, kind), path)
        shared = shared_keys(group)
        keys = [f"## Keys of every kind\n\n{key_table(shared)}"] * bool(shared)
        links = "\n".join(f"- [{kind}](/components/{group}/{kind}.md)" for kind in sorted(kinds))
        path = f"components/{group}/index.md"
        site.add(path, "\n\n".join([f"# {group.capitalize()}", components_page.ABOUT[group], links, *keys]))
        site.lead("components.md", group, path)
        groups.append((f"[{group}](/{path})", components_page.ABOUT[group], str(len(kinds))))
    made = f"{components_page.INTRODUCTION}\n\n{table(('group', 'in a configuration', 'kinds'), groups)}"
    site.add("components/index.md", made, "components.md", anchors=False)
    site.lead("components.md", "", "components/index.md")
