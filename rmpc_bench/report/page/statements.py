"""Statements of papers with their findings: on the page of an experiment, and in the index of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rmpc_bench.claims.claim import IDENTIFIERS, Finding
from rmpc_bench.claims.markdown import cases_text, evidence, limits
from rmpc_bench.claims.record import ClaimRecord, ExperimentRecord
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.report.run_notes import counted

# Statements that are not folded, the words of all of them, and those of them and the main table.
MOST_OPEN, MOST_WORDS, WITH_TABLE = 8, 100, 240
OURS = "additional, not in the paper"


class ClaimItem(NamedTuple):
    """A statement."""

    finding: str
    statement: str
    source: str
    behind: str  # what the folded lines below it contain
    lines: Sequence[str]


def claim_items(verdicts: Sequence[ClaimVerdict]) -> list[ClaimItem]:
    """Return the statements of the paper, then additional results and suspected misprints."""
    order = sorted(verdicts, key=lambda verdict: (not verdict.claim.of_paper, verdict.claim.is_misprint))
    return [*map(_item, order)]


def n_open(items: Sequence[ClaimItem], n_table: int) -> int:
    """Count the statements that are not folded below a main table of so many words; one stands below any table."""
    words, most = 0, min(MOST_WORDS, WITH_TABLE - n_table)
    for n, item in enumerate(items[:MOST_OPEN]):
        words += sum(len(text.split()) for text in (item.finding, item.statement, item.source, item.behind))
        if words > most and n:
            return n
    return min(len(items), MOST_OPEN)


def _item(verdict: ClaimVerdict) -> ClaimItem:
    claim = verdict.claim
    lines = [*claim.assumptions, *limits(verdict)]
    behind = counted(len(lines), "assumption") if lines else "numbers"
    lines += [f"{name}: {ground}" for name, ground in claim.grounds.items()]
    # How the finding came about: joined with others, recorded, by interpretation, by case, and its numbers.
    if claim.quote:
        lines.append(f'The paper: "{claim.quote}"')
    if claim.elsewhere:
        others = ", ".join(f"{name} ({finding.sentence})" for name, finding in claim.elsewhere.items())
        lines.append(f"Combined over this experiment ({verdict.words}) and {others}.")
    if verdict.differs and claim.finding is not None:
        lines.append(f"Recorded earlier: {claim.finding.sentence}. The finding has changed.")
    if verdict.reason:
        lines.append(f"Not evaluated: {verdict.reason}.")
    for finding in dict.fromkeys(each.finding for each in verdict.interpretations):
        points = [each.at for each in verdict.interpretations if each.finding == finding]
        lines.append(f"{finding.sentence.capitalize()} at: {'; '.join(points)}.")
    lines += [cases_text(verdict)] if verdict.cases else []
    lines += [f"{each.text}{f' at {each.at}' if each.at else ''}: {evidence(each)}" for each in verdict.comparisons]
    source = claim.source if claim.of_paper or claim.is_misprint else OURS
    return ClaimItem(verdict.joined_words, _line(claim.says), _line(source), behind, [*map(_line, lines)])


def _line(text: str) -> str:
    return " ".join(text.split())


PAPERS = ("zenere2018", "zenere2017", "souto2011", "ma2025", "belda2017")
"""Papers that come first, in this order."""
KINDS = {
    "statement of the paper": "What the paper says",
    "additional result": "Additional results",
    "suspected misprint": "Suspected misprints",
}  # kinds of claims -> caption of their table


class IndexEntry(NamedTuple):
    """An experiment of the index; page, relative to it, and answer are empty where its trials are not stored."""

    group: str  # its paper, or the directory that it stands in
    record: ExperimentRecord
    claims: Sequence[ClaimRecord]
    page: str
    answer: str


def index_context(entries: Sequence[IndexEntry], version: str) -> dict[str, Any]:
    """Return all that the template of an index lays out, in the order of the entries."""
    groups: dict[str, list[IndexEntry]] = {}
    for entry in entries:
        groups.setdefault(entry.group, []).append(entry)
    known = [name for name in PAPERS if name in groups]
    order = [*known, *(name for name in groups if name not in known)]
    n_pages = sum(bool(entry.page) for entry in entries)
    n_claims = len({_key(entry, claim) for entry in entries for claim in entry.claims})
    return {
        "version": version,
        "title": "Reproduced experiments" if len(order) != 1 else f"Experiments of {order[0]}",
        "name": "rmpc-bench",
        "facts": f"{len(entries)} experiments, {n_pages} with a page; {n_claims} statements and results. Findings are "
        "those of each experiment as we interpret it, and no rating of a paper.",
        "groups": [
            {
                "name": name,
                "paper": paper_link(name),
                "statements": [
                    {"caption": caption, "rows": rows}
                    for kind, caption in KINDS.items()
                    if (rows := _statements(groups[name], kind))
                ],
                "experiments": [_experiment(entry) for entry in groups[name]],
            }
            for name in order
        ],
    }


def _key(entry: IndexEntry, claim: ClaimRecord) -> tuple[str, ...]:
    """Identify a statement: by its id in all configurations of a paper, else by its place."""
    return (entry.group, claim["id"]) if claim["id"] else (entry.group, entry.record["name"], claim["statement"])


def paper_link(name: str) -> tuple[str, str]:
    """Return address and identifier of the paper that a directory is about; empty where it has none."""
    identifier = IDENTIFIERS.get(name, "")
    scheme, _, number = identifier.partition(":")
    return f"https://arxiv.org/abs/{number}" if scheme == "arXiv" else "", identifier


def _statements(entries: Sequence[IndexEntry], kind: str) -> list[dict[str, Any]]:
    """Return a row per statement of a kind, joined over the experiments that check it."""
    found: dict[tuple[str, ...], list[tuple[IndexEntry, ClaimRecord]]] = {}
    for entry in entries:
        # Findings count if they are those of the configuration as it stands, at full size.
        for claim in entry.claims if entry.record["final"] else ():
            if claim["kind"] == kind:
                found.setdefault(_key(entry, claim), []).append((entry, claim))
    rows = []
    for places in found.values():
        entry, claim = places[0]
        finding = Finding(claim["joined"])
        # claims.json of an earlier version has no text of the finding; one from elsewhere may have another.
        words = claim.get("words", "") if len(places) == 1 else ""
        rows.append(
            {
                "statement": claim["statement"],
                "finding": words if words.startswith(finding.sentence) else finding.sentence,
                "source": claim["source"],
                "places": [(f"{each.page}#claims" if each.page else "", each.record["name"]) for each, _ in places],
            }
        )
    return rows


def _experiment(entry: IndexEntry) -> Mapping[str, Any]:
    record = entry.record
    answer = entry.answer or "No trials are stored here; findings are those of the kept claims.json."
    if not record["final"]:
        answer = f"Modified or not at full size: findings do not count. {entry.answer}".rstrip()
    return {
        **{"place": (entry.page, record["name"]), "title": record["title"], "runs": str(record["runs"] or "exact")},
        **{"answer": answer, "command": "" if entry.answer or not record["final"] else record["command"]},
    }
