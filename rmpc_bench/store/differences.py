"""Differences between what a directory holds and what a configuration describes, in words."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from rmpc_bench.components.source import folder_of
from rmpc_bench.types.result_layout import COPIES

Code = Mapping[str, Any]
"""What identifies the code of some components; see `config.own_code`."""
Names = Mapping[str, Mapping[str, str]]
"""Hash of a source or a data file -> names of its files -> their hashes."""


def changes(there: Code, here: Code, names: Names) -> dict[str, str]:
    """Return role -> what has changed, such as ``tanks.py has changed``; nothing for roles with equal code."""
    found: dict[str, list[str]] = {}
    for part in ("sources", "data", "installed"):
        old, new = there.get(part, {}), here.get(part, {})
        for role in dict.fromkeys([*old, *new]):
            if old.get(role) != new.get(role):
                found.setdefault(role, []).extend(_changes(old.get(role, []), new.get(role, []), names))
    return {role: " and ".join(dict.fromkeys(texts)) for role, texts in found.items()}


def _changes(old: list[str], new: list[str], names: Names) -> Iterator[str]:
    before, after = _files(old, names), _files(new, names)
    common = sorted(name for name in after if name in before and before[name] != after[name])
    if common:
        yield f"{', '.join(common)} {'has' if len(common) == 1 else 'have'} changed"
        return
    gone, added = (sorted(a.keys() - b.keys()) for a, b in ((before, after), (after, before)))
    if gone and added:
        yield f"{', '.join(added)} has taken the place of {', '.join(gone)}"
    elif gone or added:
        yield f"{', '.join(added or gone)} has been {'added' if added else 'removed'}"
    else:
        yield "the order of its files has changed"


def _files(hashes: list[str], names: Names) -> dict[str, str]:
    """Names of files -> hashes; a hash without names, such as a name and version, stands for itself."""
    return {name: each for digest in hashes for name, each in names.get(digest, {digest: digest}).items()}


def differences(before: Any, after: Any, names: Names, path: str = "") -> list[str]:
    """Say where the settings of stored trials and those of the configuration differ, a line each."""
    if path == "code":
        found = changes(before or {}, after or {}, names)
        stored = (before or {}).get("sources", {})
        folders = {
            role: dict.fromkeys(f"{COPIES}/{folder_of(sha)}" for sha in hashes) for role, hashes in stored.items()
        }
        copies = {role: ", ".join(each) for role, each in folders.items()}
        return [
            f"{role}: {text} since the trials were stored"
            + (f" (earlier files: {copies[role]})" if role in copies else "")
            for role, text in found.items()
        ]
    if path == "sweep" and isinstance(before or {}, dict) and isinstance(after or {}, dict) and before != after:
        return [_points(before or {}, after or {})]
    if isinstance(before, dict) and isinstance(after, dict):
        keys = [*before, *(key for key in after if key not in before)]
        return [
            line
            for key in keys
            for line in differences(before.get(key), after.get(key), names, f"{path}.{key}" if path else str(key))
        ]
    return [] if before == after else [f"{path}: there {json.dumps(before)}, here {json.dumps(after)}"]


def _points(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Say which points of a sweep differ, in one line."""
    names = ([name for name in before if name not in after], [name for name in after if name not in before])
    changed = [name for name in before if name in after and before[name] != after[name]]
    parts = [
        f"{len(each)} only {where} ({each[0]}{', ..' * (len(each) > 1)})"
        for each, where in zip(names, ("there", "here"), strict=True)
        if each
    ]
    parts += [f"{len(changed)} with other values ({changed[0]}{', ..' * (len(changed) > 1)})"] if changed else []
    return f"sweep: points differ: {', '.join(parts)}"
