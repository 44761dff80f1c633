"""What a published experiment shows: report.html and report.md, the text on the screen, and its place in an index."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import rmpc_bench
from rmpc_bench.claims.claim import FINDINGS
from rmpc_bench.claims.record import ClaimsRecord, ExperimentRecord, claims_record
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.config.methods import method_differences, short_value
from rmpc_bench.figures.style import Rendering, rendered
from rmpc_bench.figures.sweep import page_drawings
from rmpc_bench.figures.tuning import MOST_METHODS
from rmpc_bench.publishing.figure_files import more_figures
from rmpc_bench.publishing.published import with_time
from rmpc_bench.publishing.table_files import experiment_record
from rmpc_bench.received import plain_files
from rmpc_bench.received.plain_files import json_of
from rmpc_bench.replaced_file import replace_text
from rmpc_bench.report.page.context import KINDS, IndexEntry, index_context, page_context
from rmpc_bench.report.page.rendering import render_html, render_markdown
from rmpc_bench.report.screen import WIDTH, Screen
from rmpc_bench.report.source import Evaluation, PageFigure, PageSource
from rmpc_bench.results.manifest import read, relative_to_cwd
from rmpc_bench.results.results import Results, resolved_keys
from rmpc_bench.types.tuning import Tuning


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Publication(Evaluation):
    """What `publish` has written, and what is in it."""

    results: Results
    directory: Path  # where the files are
    paths: tuple[Path, ...] = ()  # the files, in the order in which they were written
    figures: tuple[PageFigure, ...] = ()
    left_out: tuple[str, ...] = ()  # figures that could not be drawn, each as ``kind: reason``
    remarks: tuple[str, ...] = ()  # what a reader of the files should know, such as a font that is not installed

    @property
    def differing(self) -> tuple[ClaimVerdict, ...]:
        """Claims whose finding differs from the recorded one; none where `results` are not final."""
        return tuple(each for each in self.verdicts if each.differs) if self.results.is_final else ()

    def summary(self, seconds: float | None = None, width: int = WIDTH) -> str:
        """Return the text that the command line shows at the end of a run, with the time that it took unless None."""
        experiment, place = self.results.experiment, self.results.directory
        screen = Screen(
            **self.evaluation(),
            name="/".join(filter(None, [experiment.paper, experiment.name])),
            metric=(experiment.report.metrics or [experiment.primary])[0],
            page=self.directory / PAGE,
            stored=Path(relative_to_cwd(place) or place),
            stop="" if experiment.stop is None else experiment.stop.text,
        )
        text = screen.text(width)
        return text if seconds is None else with_time(text, seconds, width)

    def __repr__(self) -> str:
        return f"<Publication: {len(self.paths)} files in {self.directory}>"

    def __str__(self) -> str:
        return self.summary()


PAGE = "report.html"
SHARED = {
    "time": "Time",
    "plant": "Plant",
    "model": "Design model",
    "uncertainty": "Uncertain quantities",
    "noise": "Noise",
    "initial": "Initial values",
    "reference": "Reference",
    "input": "Input",
}  # keys that hold for all methods -> their name on the page
LONGEST = 300  # characters of a value that the page shows; config.resolved.yaml has all


def write_page(
    published: Publication, record: ExperimentRecord, rendering: Rendering, place: str, index: Path | None
) -> list[Path]:
    """Write report.html and report.md beside the files that are written already."""
    results, directory = published.results, published.directory
    more = more_figures(results, _wanted(results, published.figures), rendering)
    configuration = resolved_keys(results.directory)
    methods = _as_computed(configuration.get("methods", {}), results.tuning)
    differences = method_differences(methods) if methods else {}
    source = PageSource(
        **published.evaluation(),
        record=record,
        figures=[*published.figures, *more],
        place=place,
        drawings=_drawings(published, rendering),
        left_out=published.left_out,
        manifest=read(results.directory),
        differences={
            name: {key: short_value(value) for key, value in keys.items()} for name, keys in differences.items()
        },
        shared=_shared(configuration, differences),
        confounded=_confounded(differences, results.experiment.baseline),
        timings=results.durations,
        files=[*(path.relative_to(directory).as_posix() for path in published.paths), "report.md"],
        index="" if index is None else Path(os.path.relpath(index, directory)).as_posix(),
    )
    return _rendered("page", page_context(source), directory / PAGE)


def _rendered(template: str, context: Mapping[str, Any], page: Path) -> list[Path]:
    """Write a page in HTML and in Markdown."""
    replace_text(page, render_html(f"{template}.html", context))
    replace_text(page.with_suffix(".md"), render_markdown(f"{template}.md", context))
    return [page, page.with_suffix(".md")]


def _wanted(results: Results, figures: Sequence[PageFigure]) -> list[Mapping[str, Any]]:
    """Name figures that a page has even where the configuration does not: boxes of one point, signals, tuning."""
    there = {figure.kind for figure in figures}
    trials = results.trials.each[0]
    wanted: list[Mapping[str, Any]] = []
    if len(results.trials.each) == 1 and len(trials.runs) > 1:
        wanted.append({"kind": "boxplot"})
    if trials.traces:
        wanted.append({"kind": "signals"})
    if results.tuning is not None and results.tuning.searches:
        tuned = [*dict.fromkeys(each.method for each in results.tuning.searches)]
        wanted.append({"kind": "tuning", "order": tuned[:MOST_METHODS]})
    return [keys for keys in wanted if keys["kind"] not in there]


def _drawings(published: Publication, rendering: Rendering) -> Mapping[str, str]:
    """Draw the changes over a swept number; nothing for other sweeps, and where methods are ranked or pooled."""
    rows, trials = published.tables_of(published.info), published.trials
    if len(rows) < 2 or not trials.with_verdicts or trials.ranks or published.tables.pooled:
        return {}
    with rendered(rendering):
        return page_drawings(rows)


def place_of(directory: Path) -> str:
    """Return a directory of results as commands name it: from here, else from ``results`` on, else its last part."""
    if found := relative_to_cwd(directory):
        return found
    parts = directory.resolve().parts
    where = max((number for number, part in enumerate(parts) if part == "results"), default=len(parts) - 1)
    return "/".join(parts[where:])


def _as_computed(methods: Mapping[str, Any], tuning: Tuning | None) -> dict[str, Any]:
    """Return the keys of the methods with tuned values in their places, and without those that ask for tuning."""
    left_out = ("tune", "parameters")
    found = {
        name: {key: deepcopy(each) for key, each in keys.items() if key not in left_out}
        for name, keys in methods.items()
    }
    values: dict[tuple[str, str], set[float]] = {}
    for search in () if tuning is None else tuning.searches:
        for path, value in search.values.items():
            values.setdefault((search.method, path), set()).add(value)
    for (name, path), numbers in values.items():
        *above, last = path.split(".")
        tree = found.get(name, {})
        for key in above:
            tree = tree.setdefault(key, {}) if isinstance(tree, dict) else tree
        if isinstance(tree, dict):
            tree[last] = numbers.pop() if len(numbers) == 1 else "tuned at each point"
    return found


def _shared(configuration: Mapping[str, Any], differences: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Describe what is the same for every method, in short."""
    keys = {key for row in differences.values() for key in row}
    found = {}
    for key, name in SHARED.items():
        if key in configuration and not any(each == key or each.startswith(f"{key}.") for each in keys):
            text = _flow(configuration[key])
            if not text:
                continue
            found[name] = text if len(text) <= LONGEST else f"{text[:LONGEST].rstrip()} ..."
    return found


def _flow(value: Any, *, inner: bool = False) -> str:
    """Write keys and values in a row, those of an inner mapping in brackets."""
    if not isinstance(value, dict):
        return short_value(value)
    text = ", ".join(f"{key}: {_flow(each, inner=True)}" for key, each in value.items())
    return f"({text})" if inner else text


def _confounded(differences: Mapping[str, Mapping[str, Any]], baseline: str) -> list[str]:
    """Return the methods that differ from the baseline in the estimator and in the controller."""
    if baseline not in differences:
        return []
    of_baseline, found = differences[baseline], []
    for name, row in differences.items():
        changed = {key.partition(".")[0] for key in {**row, **of_baseline} if row.get(key) != of_baseline.get(key)}
        if {"estimator", "controller"} <= changed:
            found.append(name)
    return found


CLAIMS = "claims.json"


class KeptClaims(NamedTuple):
    """The findings of an experiment whose trials are not stored, from its kept claims.json."""

    directory: Path
    record: ClaimsRecord


def kept_claims(directory: Path) -> KeptClaims | None:
    """Read the claims.json of a directory of an experiment; None where there is none, or one of another version."""
    data: Any = json_of(directory / CLAIMS, plain_files.CLAIMS, "`rmpc-bench report` of its trials writes it again")
    words = [(claim["kind"] in KINDS, claim["joined"] in FINDINGS) for claim in data["claims"]] if data else []
    return KeptClaims(directory, data) if data and all(map(all, words)) else None


def write_site(published: Sequence[Publication | KeptClaims], to: Path) -> list[Path]:
    """Write index.html and index.md of several experiments."""
    to.mkdir(parents=True, exist_ok=True)
    context = index_context([_entry(each, to) for each in published], rmpc_bench.__version__)
    return _rendered("index", context, to / "index.html")


def _entry(each: Publication | KeptClaims, to: Path) -> IndexEntry:
    if isinstance(each, KeptClaims):
        record = each.record["experiment"]
        group = record["paper"] or _group(each.directory)
        return IndexEntry(group, record, each.record["claims"], "", "")
    experiment = experiment_record(each.results)
    page = Path(os.path.relpath(each.directory / PAGE, to)).as_posix()
    group = experiment["paper"] or _group(each.results.directory)
    claims = claims_record(each.verdicts, experiment)["claims"]
    return IndexEntry(group, experiment, claims, page, each.answer)


def _group(directory: Path) -> str:
    """Name the group of an experiment without a paper: the directory that it stands in, below ``results``."""
    name = directory.resolve().parent.name
    return "examples" if name == "results" else name
