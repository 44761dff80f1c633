"""The index of several experiments: each paper statement by statement, with the pages of its experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rmpc_bench.claims.claim import Finding
from rmpc_bench.claims.papers import IDENTIFIERS
from rmpc_bench.claims.record import ClaimRecord, ExperimentRecord
from rmpc_bench.report.page.blocks import Block, Piece, Text, badge, code, link, paragraph, section, table
from rmpc_bench.report.page.claim_items import finding_style

PAPERS = ("zenere2018", "zenere2017", "souto2011", "ma2025", "belda2017")
"""Papers that come first, in this order."""
KINDS = {
    "statement of the paper": "What the paper says",
    "additional result": "Additional results",
    "suspected misprint": "Suspected misprints",
}
"""Kinds of claims -> caption of their table."""


class IndexEntry(NamedTuple):
    """An experiment of the index."""

    group: str
    """Its paper, or the directory that it stands in."""
    record: ExperimentRecord
    claims: Sequence[ClaimRecord]
    page: str
    """Its page, relative to the index; empty where its trials are not stored."""
    headline: str
    """Its summary; empty where its trials are not stored."""


def index_context(entries: Sequence[IndexEntry], version: str) -> dict[str, Any]:
    """Return all that the template of a page lays out for an index, in the order of the entries."""
    groups: dict[str, list[IndexEntry]] = {}
    for entry in entries:
        groups.setdefault(entry.group, []).append(entry)
    known = [name for name in PAPERS if name in groups]
    order = [*known, *(name for name in groups if name not in known)]
    title = "Reproduced experiments" if len(order) != 1 else f"Experiments of {order[0]}"
    return {
        "version": version,
        "title": title,
        "name": "rmpc-bench",
        "provenance": _provenance(entries),
        "methods": [],
        "metrics": [],
        "sections": [section(_anchor(name), name, _blocks(name, groups[name])) for name in order],
    }


def _provenance(entries: Sequence[IndexEntry]) -> list[tuple[str, Text]]:
    n_pages = sum(bool(entry.page) for entry in entries)
    n_claims = len({_key(entry, claim) for entry in entries for claim in entry.claims})
    return [
        ("Experiments", f"{len(entries)}, of which {n_pages} with a page"),
        ("Statements and results", str(n_claims)),
        ("Findings", "of each experiment as we interpret it; no rating of a paper"),
    ]


def _anchor(name: str) -> str:
    return "group-" + "".join(letter if letter.isalnum() else "-" for letter in name)


def _key(entry: IndexEntry, claim: ClaimRecord) -> tuple[str, ...]:
    """Identify a statement: by its id in all configurations of a paper, else by its place."""
    return (entry.group, claim["id"]) if claim["id"] else (entry.group, entry.record["name"], claim["statement"])


def _blocks(name: str, entries: Sequence[IndexEntry]) -> list[Block]:
    identifier = IDENTIFIERS.get(name, "")
    scheme, _, number = identifier.partition(":")
    cited: Piece = link(f"https://arxiv.org/abs/{number}", identifier) if scheme == "arXiv" else identifier
    blocks = [paragraph(["The paper: ", cited])] if identifier else []
    return [*blocks, *_statements(entries), _experiments(entries)]


def _statements(entries: Sequence[IndexEntry]) -> list[Block]:
    """Return a table for each kind of claim: one row per statement, joined over the experiments that check it."""
    blocks = []
    for kind, caption in KINDS.items():
        found: dict[tuple[str, ...], list[tuple[IndexEntry, ClaimRecord]]] = {}
        for entry in filter(_counts, entries):
            for claim in entry.claims:
                if claim["kind"] == kind:
                    found.setdefault(_key(entry, claim), []).append((entry, claim))
        columns: dict[str, list[Text]] = {"statement": [], "finding": [], "source": [], "experiments": []}
        for places in found.values():
            entry, claim = places[0]
            finding = Finding(claim["joined"])
            columns["statement"].append(claim["statement"])
            # claims.json of an earlier version has no text of the finding; one from elsewhere may have another.
            words = claim.get("words", "") if len(places) == 1 else ""
            words = words if words.startswith(finding.sentence) else finding.sentence
            columns["finding"].append([badge(words, finding_style(finding))])
            columns["source"].append(claim["source"])
            columns["experiments"].append(_joined([_named(each, "claims") for each, _ in places]))
        if found:
            blocks.append(table(caption, {**columns}, prose=True))
    return blocks


def _counts(entry: IndexEntry) -> bool:
    """Whether the findings of an experiment count: it is the configuration as it stands, at full size."""
    return bool(entry.record["final"])


def _joined(pieces: Sequence[Piece]) -> list[Piece]:
    found: list[Piece] = []
    for number, piece in enumerate(pieces):
        found += [", ", piece] if number else [piece]
    return found


def _named(entry: IndexEntry, anchor: str = "") -> Piece:
    """Name an experiment, with a link to its page where there is one."""
    name = entry.record["name"]
    return link(f"{entry.page}#{anchor}" if anchor else entry.page, name) if entry.page else name


def _experiments(entries: Sequence[IndexEntry]) -> Block:
    columns: dict[str, list[Text]] = {
        "experiment": [[_named(entry)] for entry in entries],
        "title": [entry.record["title"] for entry in entries],
        "runs": [str(entry.record["runs"]) if entry.record["runs"] else "exact" for entry in entries],
        "summary": [_summary(entry) for entry in entries],
    }
    return table("Experiments", {**columns}, prose=True)


def _summary(entry: IndexEntry) -> Text:
    if not _counts(entry):
        return f"Modified or not at full size: findings do not count. {entry.headline}".rstrip()
    return entry.headline or _missing(entry.record)


def _missing(record: Mapping[str, Any]) -> Text:
    return ["No trials are stored here; findings are those of the kept claims.json. ", code(record["command"])]
