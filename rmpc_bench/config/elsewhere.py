"""Findings of the same statement in other configurations of a paper, which lie in the same folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rmpc_bench.claims.claim import FINDINGS
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.tree import Map
from rmpc_bench.config_file.yaml import load
from rmpc_bench.received.plain_files import text_of
from rmpc_bench.types import ConfigError


def join_findings(path: Path, draft: DraftConfig) -> None:
    """Give every claim with an `id` the findings that other configurations record for the same `id`.

    A claim that has the key `elsewhere`, as in config.resolved.yaml, keeps it: the results of an experiment do not need
    the other files.  A claim whose `id` is given twice is a problem of the draft.
    """
    seen: dict[str, int] = {}
    open_ids = set()
    for number, keys in enumerate(draft.claims):
        if keys is None or keys.id is None:
            continue
        if keys.id in seen:
            message = f"is that of claim {seen[keys.id] + 1}, too; a statement has one claim"
            draft.note(["claims", number, "id"], message)
        seen.setdefault(keys.id, number)
        if keys.elsewhere is None:
            open_ids.add(keys.id)
    paper = draft.values["paper"]
    found = _findings(path, paper, open_ids) if open_ids and paper else {}
    draft.claims = [
        keys
        if keys is None or keys.id not in open_ids
        else replace(keys, elsewhere={name: each[keys.id] for name, each in found.items() if keys.id in each})
        for keys in draft.claims
    ]


def _findings(path: Path, paper: str, ids: set[str]) -> dict[str, dict[str, str]]:
    """Read configuration -> id -> recorded finding from the other files of the folder."""
    found = {}
    for other in sorted(path.parent.glob("*.yaml")):
        if other.resolve() == path.resolve():
            continue
        try:
            text = text_of(other)
            # Reading YAML takes ten times as long as looking for a name in its text.
            tree = load(other) if any(name in text for name in ids) else None
        except (OSError, UnicodeDecodeError, ConfigError):
            # The file has its own errors, which `check` reports for it.
            continue
        if isinstance(tree, Map) and tree.get("paper") == paper:
            found[str(tree.get("name", other.stem))] = _recorded(tree.get("claims"), ids)
    return found


def _recorded(claims: Any, ids: set[str]) -> dict[str, str]:
    entries: Sequence[Any] = claims if isinstance(claims, list) else ()
    named = [entry for entry in entries if isinstance(entry, Map) and entry.get("id") in ids]
    return {entry["id"]: entry["finding"] for entry in named if entry.get("finding") in FINDINGS}
