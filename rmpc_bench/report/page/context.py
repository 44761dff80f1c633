"""The template context of a page: title, banner, answer, main table, note, claims, folds and foot as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from rmpc_bench.analysis.result_rows import NOT_COMPUTED, ResultTable, result_table
from rmpc_bench.analysis.runs import Extent
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import usual_parameters
from rmpc_bench.claims.markdown import INFORMATIONAL
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.report.answer import answer
from rmpc_bench.report.notes import note_of
from rmpc_bench.report.page.folds import folds_of, moments_of
from rmpc_bench.report.page.matrix import MOST_BESIDE, MOST_BESIDE_NARROW, Group, matrices_of
from rmpc_bench.report.page.rows import Cell, Head, Rows, ranked_rows, row_of, rows_of
from rmpc_bench.report.page.source import PageSource, Table, info_of, tables_of
from rmpc_bench.report.page.statements import claim_items, n_open, paper_link
from rmpc_bench.report.run_notes import counted, ran_counts
from rmpc_bench.report.summary import Summary

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
    tables, trials, record = tables_of(source.tables, source.info), source.trials, source.record
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
        "answer": answer_of(source.tables, [] if informational else source.verdicts, source.extent),
        "main": main,
        "drawings": source.drawings if trials.with_verdicts else {},
        "quantity": tables[0].quantity if tables else "",
        "baseline": trials.baseline,
        "claims_title": "What the paper says" if of_paper and record["paper"] else "Claims",
        "claims": claims[:opened],
        "more_claims": claims[opened:],
        "claims_note": INFORMATIONAL if informational else "",
        "folds": folds_of(source, tables),
        "command": record["command"],
        "foot": _foot(source),
        "files": [*(name for name in FILES if name in source.files), *directories],
        "pictures": [(each.name, *_picture(each.files)) for each in source.figures if each.files],
    }


def answer_of(summary: Summary, verdicts: Sequence[ClaimVerdict], extent: Extent) -> str:
    """Answer from the tables of an experiment, and the findings that count, which method is better."""
    info = info_of(summary)
    tables = [] if info is None else [result_table(*point, info) for point in summary.with_runs]
    return answer(tables, verdicts, unfinished=extent.is_unfinished, n_blank=len(extent.blank))


def _banner(source: PageSource) -> tuple[str, str]:
    if not source.trials.with_verdicts:
        return "Smoke run.", "It shows that everything works; it is too short for verdicts."
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
    if source.ranked is not None:
        note = f"{n} runs per point and method. Ratio: geometric mean over {len(tables)} points. Brackets, bars and "
        note += f"ranks: simultaneous {100 * trials.confidence:g} % intervals."
        return Main(rows=ranked_rows(source.ranked, trials), note=note)
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
