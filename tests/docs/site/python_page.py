"""Reference of the public names in Python, from their signatures and docstrings."""

from __future__ import annotations

import inspect
import re

from docs.site.pages import Site

import rmpc_bench

TITLES = {
    "experiments": "run, load and compare experiments",
    "components": "components and registration",
    "types": "types",
}


def write(site: Site) -> None:
    """Add a page per kind of name, and their index."""
    parts: dict[str, list[str]] = {kind: [] for kind in TITLES}
    names: dict[str, list[str]] = {kind: [] for kind in TITLES}
    for name, module in rmpc_bench._PUBLIC.items():
        kind = _kind(name, module)
        parts[kind].append(_described(name, module))
        names[kind].append(f"`{name}`")
    links = []
    for kind, title in TITLES.items():
        site.add(f"reference/python/{kind}.md", f"# Python: {title}\n\n" + "\n\n".join(parts[kind]))
        links.append(f"- [{title.capitalize()}](/reference/python/{kind}.md): {', '.join(names[kind])}")
    intro = "# Python\n\n`from rmpc_bench import NAME`. The command line calls these functions."
    site.add("reference/python/index.md", intro + "\n\n" + "\n".join(links))


def _kind(name: str, module: str) -> str:
    if name[0].isupper():
        return "types"
    return (
        "experiments" if module.split(".")[1] in ("config_file", "execution", "results", "publishing") else "components"
    )


def _described(name: str, module: str) -> str:
    """Signature and docstring of a name."""
    thing = getattr(rmpc_bench, name)
    try:
        signature = re.sub(r" at 0x[0-9a-f]+", "", str(inspect.signature(thing)).replace("rmpc_bench.", ""))
    except (TypeError, ValueError):
        signature = ""
    doc = inspect.cleandoc(thing.__doc__ or "")
    doc = re.sub(r"^(\w+)\n-{3,}$", r"**\1**\n", doc, flags=re.MULTILINE)
    doc = re.sub(r"^(>>> .*?)(?=\n\n|\Z)", r"```pycon\n\1\n```", doc, flags=re.MULTILINE | re.DOTALL)
    doc = re.sub(r"^(\w+) : ", r"- `\1`: ", doc, flags=re.MULTILINE)
    return f"## {name}\n\n```python\n{name}{signature}\n```\n\n{doc}\n\nDefined in `{module}`."
