"""Examples of the kinds, from examples_of_kinds.yaml, and the shipped configurations that use a kind."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from docs.markdown import ROOT

from rmpc_bench import registry
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load

CONFIGS = ROOT / "configs"
SECTION_OF = {
    **{name: group for group in registry.BUILT_IN for name in (group, registry.singular(group))},
    **dict.fromkeys(("noise", "initial"), "noises"),
}
"""Key of a configuration -> group of the components below it."""


class Example(NamedTuple):
    """A configuration that names a kind, and the files that it needs."""

    text: str
    files: Mapping[str, str]


@cache
def examples() -> dict[tuple[str, str], Example]:
    """Return (group, kind) -> its example."""
    data = plain(load(Path(__file__).with_suffix(".yaml")))
    found = {}
    for each in data["examples"]:
        parts = _sections({"base": "open", **each}, data["bases"])
        text = "".join(parts[name] for name in data["order"] if parts.get(name) not in (None, f"{name}:\n"))
        for group in each["groups"]:
            for kind, keys in each["kinds"].items():
                whole = text.replace("THIS", _component(group, kind, keys))
                found[group, kind] = Example(whole, each.get("files", {}))
    return found


def _sections(each: Mapping[str, Any], bases: Mapping[str, Any]) -> dict[str, str]:
    """Key of the top level -> its lines, those of the base first."""
    parts = re.split(r"^(?=\w)", each.get("change", ""), flags=re.MULTILINE)
    own = {part.partition(":")[0]: part for part in parts if part}
    return {**_sections(bases[each["base"]], bases), **own} if "base" in each else own


def _component(group: str, kind: str, keys: str) -> str:
    if group == "noises":
        return f"{{{kind}: {{{keys}}}}}"
    if not keys and group in ("metrics", "figures"):
        return kind
    return f"{{kind: {kind}, {keys}}}" if keys else f"{{kind: {kind}}}"


@cache
def users() -> dict[tuple[str, str], list[str]]:
    """Return (group, kind) -> the configurations that name it, short ones first, interpretations and searches last."""
    files = sorted(CONFIGS.rglob("*.yaml"), key=lambda file: ("-" in file.stem, file.stat().st_size, file))
    found: dict[tuple[str, str], list[str]] = {}
    for file in files:
        name = file.relative_to(CONFIGS).with_suffix("").as_posix()
        for key in dict.fromkeys(named(plain(load(file)))):
            found.setdefault(key, []).append(name)
    return found


def named(tree: Any, group: str = "") -> Iterator[tuple[str, str]]:
    """Find the kinds that a configuration, or a part of it in the section of a group, names."""
    known = registry.BUILT_IN.get(group, {})
    if isinstance(tree, Mapping):
        for key, value in tree.items():
            if key in known:
                yield group, key
            if key == "kind" or not isinstance(value, str):
                yield from named(value, SECTION_OF.get(key, group))
        return
    for each in tree if isinstance(tree, list) else [tree]:
        if isinstance(each, str) and each in known:
            yield group, each
        elif isinstance(each, Mapping):
            yield from named(each, group)
