"""The template context of a page: head, then sections of blocks in their order, all of it plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.papers import IDENTIFIERS
from rmpc_bench.figures.line_styles import line_styles
from rmpc_bench.report.drivers_table import EXPLANATION
from rmpc_bench.report.page.background import (
    failure_blocks,
    limitation_blocks,
    method_blocks,
    trust_blocks,
)
from rmpc_bench.report.page.blocks import (
    Block,
    Text,
    bullets,
    code,
    folded,
    heading,
    link,
    paragraph,
    program,
    section,
    table,
)
from rmpc_bench.report.page.claim_items import claim_blocks
from rmpc_bench.report.page.headline import headline, shown_metric
from rmpc_bench.report.page.rank_table import rank_blocks
from rmpc_bench.report.page.result_tables import result_blocks
from rmpc_bench.report.page.source import PageFigure, PageSource
from rmpc_bench.report.page.tail_tables import requirement_blocks, tail_blocks
from rmpc_bench.report.page.tuning_tables import tuning_blocks
from rmpc_bench.report.run_notes import show_command
from rmpc_bench.report.worst_runs import worst_runs

OVER_TIME = ("signals",)
"""Kinds of figures that stand among the trajectories."""
MOST_TURNS = 4
"""Sentences on where the ranking turns that are not folded."""
MOST_FAILURES = 5
"""Files of failed runs that the page links."""
TUNING = ("tuning",)
"""Kinds of figures that stand with the tuned values."""
DRIVERS = ("ranking",)
"""Kinds of figures that stand with what drives the result."""


def page_context(source: PageSource) -> dict[str, Any]:
    """Return the plain data that the templates of a page lay out.

    They are ``title``, ``subtitle``, ``provenance``, ``methods``, ``metrics`` and ``sections``, each with an id, a
    title and blocks.  Sections without blocks are left out.
    """
    trials = source.trials
    parts = [
        section("summary", "Summary", [paragraph(headline(source.tables), "lead")]),
        # Before the figures, which have a panel for every point of the sweep.
        section("ranks", "Ranks over all points", rank_blocks(source.ranks, trials.all_methods), "Ranks"),
        section("result", "Result", _result_figures(source)),
        section("table", "Table", _table_blocks(source)),
        section("drivers", "What drives the differences", _driver_blocks(source)),
        section("claims", "What the paper says" if _has_paper(source) else "Claims", claim_blocks(source)),
        section("trajectories", "Trajectories and worst runs", _trajectory_blocks(source), "Trajectories"),
        section("tuning", "How the parameters were chosen", _tuning(source), "Tuning"),
        section(
            "methods",
            "What differs between the methods, and what was assumed",
            method_blocks(source),
            "Methods and assumptions",
        ),
        section("limitations", "Known limitations of this comparison", limitation_blocks(source), "Limitations"),
        section("failures", "Failures and timing", failure_blocks(source)),
        section("trust", "Why trust these results", trust_blocks(source)),
        section("files", "Configuration, files and citation", _file_blocks(source), "Files and citation"),
    ]
    return {
        "version": source.record["version"],
        "title": source.record["title"] or trials.name,
        "name": "/".join(part for part in (source.record["paper"], trials.name) if part),
        "provenance": _provenance(source),
        "methods": _method_legend(source),
        "metrics": _metrics(source.tables.points[0].trials),
        "sections": [part for part in parts if part["blocks"]],
    }


def _has_paper(source: PageSource) -> bool:
    return any(verdict.claim.of_paper for verdict in source.verdicts) and source.record["paper"] is not None


def _metrics(trials: Trials) -> list[str]:
    """Return the metrics that a reader can choose, the primary one first; none where there is nothing to choose."""
    names = [info.name for info in sorted(trials.metrics, key=lambda info: info != trials.primary_info)]
    return names if len(names) > 1 and len(trials.each[0].runs) else []


def _method_legend(source: PageSource) -> list[Mapping[str, Any]]:
    """Return the methods that the tables show, with their place among all methods and their colour."""
    trials, shown = source.trials, source.tables.points[0].trials.methods
    styles = line_styles(trials.all_methods, trials.all_methods)
    return [
        {"number": number, "name": name, "label": trials.labels.get(name, name), "colour": styles[name].color}
        for number, name in enumerate(trials.all_methods)
        if name in shown
    ]


def _provenance(source: PageSource) -> list[tuple[str, Text]]:
    record, manifest = source.record, source.manifest
    items: list[tuple[str, Text]] = [("Index", [link(source.index, "all experiments")])] if source.index else []
    if record["paper"]:
        identifier = record["identifier"]
        items.append(("Paper", [f"{record['paper']}, ", _identifier(identifier)] if identifier else record["paper"]))
    trials, points = source.trials, len(source.trials.points)
    runs = f"{record['runs']} runs per method" if record["runs"] else "exact moments, no runs"
    items.append(
        ("Size", f"{len(trials.methods)} methods, {runs}" + (f", {points} points of a sweep" if points else ""))
    )
    items += [("Seed", str(record["seed"])), ("Experiment", [code(record["hash"][:12])])]
    items.append(
        ("Computed with", f"rmpc-bench {record['version']}, numerics {record['numerics']}" + _versions(manifest))
    )
    git = manifest.get("git") or {}
    if git.get("commit"):
        dirty = " with uncommitted changes" if git.get("dirty") else ""
        items.append(("Commit", [code(str(git["commit"])[:12]), dirty]))
    started = next((session.get("start") for session in manifest.get("sessions", [])), None)
    if isinstance(started, str):
        items.append(("First computed", started[:10]))
    return [*items, ("Command", [code(record["command"])])]


def _versions(manifest: Mapping[str, Any]) -> str:
    versions = manifest.get("versions") or {}
    known = [f"{name} {versions[key]}" for key, name in (("python", "Python"), ("numpy", "NumPy")) if key in versions]
    return f" ({', '.join(known)})" if known else ""


def _identifier(text: str) -> Any:
    scheme, _, number = text.partition(":")
    return link(f"https://arxiv.org/abs/{number}", text) if scheme == "arXiv" else text


def _figures(figures: Sequence[PageFigure], *, beside: bool = False) -> list[Block]:
    if not figures:
        return []
    items = [{**each._asdict(), "pictures": each.pictures} for each in figures]
    return [{"kind": "figures", "beside": beside and len(figures) > 1, "items": items}]


def _first_figures(source: PageSource) -> list[PageFigure]:
    """Return the first figure of the configuration and, where it is drawn, the paired change."""
    first = [*source.figures[:1]]
    if first and first[0].kind in DRIVERS + TUNING:
        first = []
    return first + [each for each in source.figures if each.kind == "paired" and each not in first][:1]


def _result_figures(source: PageSource) -> list[Block]:
    """Return the first figure with the paired change beside it, then those that belong to no other section."""
    first = _first_figures(source)
    rest = [each for each in source.figures if each not in first and each.kind not in OVER_TIME + DRIVERS + TUNING]
    return [*_figures(first, beside=True), *_figures(rest, beside=True)]


def _driver_blocks(source: PageSource) -> list[Block]:
    """Return the figures of the drivers, the table and the sentences of the first point, and the others folded."""
    blocks = _figures([each for each in source.figures if each.kind in DRIVERS], beside=True)
    if source.drivers is None or not source.trials.with_verdicts:
        return blocks
    points: list[list[Block]] = []
    for title, columns, sentences in source.drivers.tables:
        shown = table(
            f"Share of the variance that each uncertain quantity explains{f' ({title})' * bool(title)}", {**columns}
        )
        points.append([shown, *bullets([*sentences])])
    blocks += [block for point in points[:1] for block in point]
    turns = source.drivers.turns
    blocks += bullets([*turns]) if len(turns) <= MOST_TURNS else folded("Where the ranking turns", bullets([*turns]))
    rest = [block for point in points[1:] for block in point]
    blocks += folded(f"{len(points) - 1} more point{'s' * (len(points) > 2)} of the sweep", rest)
    return [*blocks, paragraph(EXPLANATION, "note")] if points else blocks


def _tuning(source: PageSource) -> list[Block]:
    """Return the figure of the objectives, then the tables of the tuned values."""
    figures = _figures([each for each in source.figures if each.kind in TUNING])
    return [*figures, *tuning_blocks(source.tuning, source.trials.all_methods)]


def _table_blocks(source: PageSource) -> list[Block]:
    """Return the tables of the metrics, beside them worst runs and requirements."""
    methods = source.trials.all_methods
    return [
        *result_blocks(source.tables, methods),
        *tail_blocks(source.tables, methods),
        *requirement_blocks(source.requirements, methods),
    ]


def _trajectory_blocks(source: PageSource) -> list[Block]:
    """Return the figures over time, and the worst run of every method with the command that shows it."""
    first = _first_figures(source)
    blocks = _figures([each for each in source.figures if each.kind in OVER_TIME and each not in first])
    trials = source.tables.points[0].trials
    info = shown_metric(trials)
    if info is None or trials.alike or not trials.with_verdicts or len(trials.runs) < 2:
        return blocks
    found = worst_runs(trials, info)
    rows = [
        (method, f"{value:.4g}", str(run), show_command(trials, source.place, method, run))
        for method, (value, run) in found.items()
    ]
    if not rows:
        return blocks
    unit = f" [{info.unit}]" if info.unit else ""
    names, values, runs, commands = zip(*rows, strict=True)
    columns: dict[str, list[Text]] = {
        "method": [*names],
        f"worst {name_of_distance(info)}{unit}": [*values],
        "run": [*runs],
        "command that shows it": [[code(command)] for command in commands],
    }
    where = f" ({trials.title})" if trials.title else ""
    numbers = [source.trials.all_methods.index(name) for name in names]
    blocks.append(table(f"Worst finished run of every method{where}", {**columns}, methods=numbers))
    return blocks


def _file_links(source: PageSource) -> list[Text]:
    """Link the files, of failed runs only the first ones."""
    failures = [file for file in source.files if file.startswith("failures/")]
    hidden = {*failures[MOST_FAILURES:]}
    return [[link(file, file)] for file in source.files if file not in hidden]


def _file_blocks(source: PageSource) -> list[Block]:
    record = source.record
    blocks: list[Block] = []
    if source.configuration:
        blocks += folded("Configuration with every default", [program(source.configuration, "yaml")])
    blocks += [heading("Files"), {"kind": "files", "items": _file_links(source)}] if source.files else []
    cite = (
        f"rmpc-bench {record['version']}, experiment {record['name']} ({record['hash'][:12]}), seed {record['seed']}, "
        f"n = {record['runs']}."
    )
    blocks += [heading("Citation"), paragraph(cite)]
    identifier = IDENTIFIERS.get(record["paper"] or "")
    if identifier:
        blocks.append(paragraph(["The paper: ", _identifier(identifier)]))
    return blocks
