"""Reference of the public names in Python, from their signatures and docstrings."""

from __future__ import annotations

import inspect
import re
from enum import EnumType

from docs.site.pages import Site

import rmpc_bench

TITLES = {
    "experiments": "run, load and compare experiments",
    "components": "components and registration",
    "types": "types",
}
COMPONENTS = ("components", "config_file", "simulation")
"""Folders whose functions are about components."""
MANY = 20
"""Parameters from which on a class is made by functions only, whose parameters are not described."""
WIDTH = 80
"""Characters of a signature in one line."""


def write(site: Site) -> None:
    """Add a page per kind of name, and their index."""
    parts: dict[str, list[str]] = {kind: [] for kind in TITLES}
    names: dict[str, list[str]] = {kind: [] for kind in TITLES}
    for name, module in rmpc_bench._PUBLIC.items():
        functions = "components" if module.split(".")[1] in COMPONENTS or name == "filter_data" else "experiments"
        kind = "types" if name[0].isupper() else functions
        parts[kind].append(_described(name))
        names[kind].append(f"[`{name}`](/reference/python/{kind}.md#{name.lower()})")
    links = []
    for kind, title in TITLES.items():
        site.add(f"reference/python/{kind}.md", f"# Python: {title}\n\n" + "\n\n".join(parts[kind]))
        site.titles[f"reference/python/{kind}.md"] = title.capitalize()
        links.append(f"- [{title.capitalize()}](/reference/python/{kind}.md): {', '.join(names[kind])}")
    intro = "# Python\n\n`from rmpc_bench import NAME`. The command line calls these functions."
    site.add("reference/python/index.md", intro + "\n\n" + "\n".join(links))


def _described(name: str) -> str:
    """Signature, docstring and methods of a name."""
    thing = getattr(rmpc_bench, name)
    doc = inspect.cleandoc(thing.__doc__ or "")
    doc = re.sub(r"^(\w+)\n-{3,}$", r"**\1**\n", doc, flags=re.MULTILINE)
    doc = re.sub(r"^(>>> .*?)(?=\n\n|\Z)", r"```pycon\n\1\n```", doc, flags=re.MULTILINE | re.DOTALL)
    doc = re.sub(r"^([\w, ]+) : ", r"- `\1`: ", doc, flags=re.MULTILINE)
    doc = re.sub(r"^(\w+(?:, \w+)*)\n {4}(?=\S)", r"- `\1`: ", doc, flags=re.MULTILINE)
    many = isinstance(thing, type) and _signature(thing).count("\n") > MANY
    doc = re.sub(r"^\*\*Parameters\*\*\n.*?(?=^\*\*|\Z)", "", doc, flags=re.MULTILINE | re.DOTALL) if many else doc
    call = "" if many or isinstance(thing, EnumType) else f"```python\n{name}{_signature(thing)}\n```\n\n"
    return f"## {name}\n\n{call}{doc}\n\n{_methods(thing)}"


def _signature(thing: object) -> str:
    """Parameters of a callable, where they are many each in a line of its own."""
    text = str(inspect.signature(thing))  # type: ignore[arg-type]
    text = re.sub(r"(: |-> )(['\"])(.*?)\2(?=[,)]| =|$)", r"\1\3", text).replace("rmpc_bench.", "")
    text = re.sub(r"<(?:function|object|factory).*?>+(?=[,)])", "...", text)
    first, _, end = text[1:].rpartition(")")
    parts, depth = [""], 0
    for piece in re.split(r"(, |[\[\](){}])", first):
        depth += (piece in ("[", "(", "{")) - (piece in ("]", ")", "}"))
        if piece == ", " and not depth:
            parts.append("")
        else:
            parts[-1] += piece
    return text if len(text) < WIDTH else "(\n    " + ",\n    ".join(parts) + f",\n){end}"


def _methods(thing: object) -> str:
    """Public methods and properties of a class that have a docstring, with their types."""
    found = []
    for name, each in vars(thing).items() if isinstance(thing, type) else ():
        inner = getattr(each, "__func__", getattr(each, "fget", getattr(each, "func", each)))
        if inspect.isfunction(inner) and inner.__doc__ and not name.startswith("_"):
            text = re.sub(r"^\((\n    |)(?:self|cls)(?:,\s+)?", r"(\1", _signature(inner))
            found.append(f"{name}{text}" if callable(each) else f"{name}: {text.partition(' -> ')[2]}")
    lines = "\n".join(found)
    return f"**Methods and properties**\n\n```python\n{lines}\n```" if found else ""
