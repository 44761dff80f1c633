"""The template context of a page as plain data, and the statements of papers, which the index of several shows too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rmpc_bench.analysis.result_rows import NOT_COMPUTED, ResultTable, result_table
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import IDENTIFIERS, Finding, usual_parameters
from rmpc_bench.claims.markdown import INFORMATIONAL, cases_text, evidence, limits
from rmpc_bench.claims.record import ClaimRecord, ExperimentRecord
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.report.notes import note_of
from rmpc_bench.report.page.folds import folds_of, moments_of
from rmpc_bench.report.page.matrix import MOST_BESIDE, MOST_BESIDE_NARROW, Group, matrices_of
from rmpc_bench.report.page.rows import Cell, Head, Rows, ranked_rows, row_of, rows_of
from rmpc_bench.report.run_notes import counted, ran_counts
from rmpc_bench.report.source import PageSource, Table
from rmpc_bench.report.two_way_table import two_way_tables

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


PAPERS = ("zenere2018", "zenere2017", "souto2011", "ma2025", "belda2017")  # papers that come first, in this order
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


FILES = ("comparisons.csv", "summary.csv", "trials.csv", "claims.md", "report.md")  # that the foot links


class Main(NamedTuple):
    """The main part of the page."""

    rows: Rows | None = None
    groups: Sequence[Group] = ()
    moments: Table | None = None
    note: str = ""
    shape: str = ""  # how a matrix and its lines stand: beside each other, beside a small drawing, or below it

    @property
    def n_words(self) -> int:
        """Count the words of the tables that are not folded."""
        tables = [self.rows.columns] if self.rows else []
        tables += [each.columns for group in self.groups if not group.title for each in group.matrices]
        return sum(len(text.split()) for table in tables for texts in table.values() for text in texts)


def page_context(source: PageSource) -> dict[str, Any]:
    """Return the plain data that the templates of a page lay out."""
    tables, trials, record = source.tables_of(source.info), source.trials, source.record
    all_plants = source.tables.pooled
    pooled = result_table(*all_plants, source.info) if all_plants and source.info else None
    informational, paper = bool(source.overrides or source.incomplete), record["paper"] or ""
    address, identifier = paper_link(paper)
    directories = dict.fromkeys(f"{file.partition('/')[0]}/" for file in source.files if "/" in file)
    claims = claim_items(source.verdicts) if trials.with_verdicts else []
    main = _main(source, tables, pooled)
    opened = n_open(claims, main.n_words)
    of_paper = any(verdict.claim.of_paper for verdict in source.verdicts)
    return {
        "version": record["version"],
        "title": " ".join((record["title"] or trials.name).split()),
        "name": "/".join(part for part in (record["paper"], trials.name) if part),
        "names": tuple(sorted(trials.all_methods, key=len, reverse=True)),
        "paper": (address, identifier or (paper if usual_parameters(paper) == "as published" else "")),
        "index": source.index,
        "banner": _banner(source),
        "answer": source.answer,
        "main": main,
        "drawings": source.drawings if trials.with_verdicts else {},
        "quantity": tables[0].quantity if tables else "",
        "baseline": trials.baseline,
        "claims_title": "What the paper says" if of_paper and record["paper"] else "Claims",
        "claims": claims[:opened],
        "more_claims": claims[opened:],
        "claims_note": INFORMATIONAL if informational else "",
        "two_way": two_way_tables(trials)[:MOST_OPEN],
        "folds": folds_of(source, tables),
        "command": record["command"],
        "foot": _foot(source),
        "files": [*(name for name in FILES if name in source.files), *directories],
        "pictures": [(each.name, *_picture(each.files)) for each in source.figures if each.files],
    }


def _banner(source: PageSource) -> tuple[str, str]:
    if not source.trials.with_verdicts:
        return "Smoke run.", "It shows that everything works; it is too short for verdicts."
    if source.manifest.get("origin") == "imported":
        doubts = (f" {text[:1].upper()}{text[1:]}" for text in source.manifest.get("warnings", ()))
        return "Runs made elsewhere,", f"not simulated by rmpc-bench.{''.join(doubts)}"
    if not source.extent.is_unfinished:
        return "", ""
    runs = "the runs" if len(source.extent.points) > 1 else f"the {source.extent.n} runs"
    text = f"The same command continues. The numbers are those of {runs} that every computed method has."
    return f"Unfinished: {source.extent.text}.", text


def _main(source: PageSource, tables: Sequence[ResultTable], pooled: ResultTable | None) -> Main:
    """Choose what stands below the answer."""
    trials, n = source.trials, source.extent.fewest
    if not tables:
        return Main(moments=moments_of(trials, short=len(trials.each) > 1))
    if not trials.with_verdicts:
        return Main(rows=_ran(trials))
    if source.ranks.found is not None:
        note = f"{n} runs per point and method. Ratio: geometric mean over {len(tables)} points. Brackets, bars and "
        note += f"ranks: simultaneous {100 * trials.confidence:g} % intervals."
        return Main(rows=ranked_rows(source.ranks.found, trials), note=note)
    if len(tables) == 1 or pooled is not None:
        rows = rows_of(pooled or tables[0])
        note = f"One run of each method at each of {len(tables)} points." if pooled else note_of(tables, n, rows)
        return Main(rows=rows, note=note)
    groups = matrices_of(tables)
    first = groups[0].matrices[0]
    underlined = any("best" in cell.css.split() for row in first.rows for cell in row.cells)
    lowest = "" if not underlined else "column" if first.corner == "method" else "row"
    n_heads = len(first.heads)
    shape = "two" if n_heads <= MOST_BESIDE else "two narrow" if n_heads <= MOST_BESIDE_NARROW else "one"
    return Main(groups=groups, note=note_of(tables, n, lowest=lowest), shape=shape)


def _ran(trials: Trials) -> Rows:
    """Say of every method of a smoke run whether it ran, at all points together."""
    rows = []
    for method, (failed, n) in ran_counts(trials).items():
        word = "failed" if failed else "ran" if n else NOT_COMPUTED
        text = f"{failed} of {n} runs failed" if failed else counted(n, "run")
        cell = Cell(f"v {'fails' if failed else 'base'}", word, "", text)
        rows.append(row_of(trials, method, [cell])._replace(css=""))
    return Rows([Head("result", "v")], rows)


def _foot(source: PageSource) -> list[tuple[str, str]]:
    """Return name and text of what the foot says besides command and files."""
    record, manifest = source.record, source.manifest
    versions = manifest.get("versions") or {}
    known = [f"{name} {versions[key]}" for key, name in (("python", "Python"), ("numpy", "NumPy")) if key in versions]
    with_libraries = f" ({', '.join(known)})" if known else ""
    starts = [session["start"] for session in manifest.get("sessions", []) if isinstance(session.get("start"), str)]
    cite = f"rmpc-bench {record['version']}, {record['name']} ({record['hash'][:12]}), seed {record['seed']}"
    items = {
        **{"seed": str(record["seed"]), "hash": record["hash"][:12]},
        "version": f"rmpc-bench {record['version']}, numerics {record['numerics']}{with_libraries}",
        **{"computed": starts[0][:10] if starts else "", "cite": f"{cite}, n = {record['runs']}"},
    }
    return [(name, text) for name, text in items.items() if text]


def _picture(files: Sequence[str]) -> tuple[str, bool]:
    """Return the file of a figure that Markdown can show, or another one to link."""
    shown = [file for ending in (".svg", ".png") for file in files if file.endswith(ending)]
    return (shown or list(files))[0], bool(shown)
