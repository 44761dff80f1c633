"""report.html and report.md of an experiment, with the figures that only the page shows."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

from rmpc_bench.claims.record import ExperimentRecord
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.config.method_differences import method_differences, short_value
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.execution.figure_files import WrittenFigure, write_more
from rmpc_bench.execution.manifest import read, relative_to_cwd
from rmpc_bench.execution.results import Results
from rmpc_bench.figures.style import Rendering, rendered
from rmpc_bench.figures.sweep import page_drawings
from rmpc_bench.figures.tuning import MOST_METHODS
from rmpc_bench.replaced_file import replace_text
from rmpc_bench.report.page.context import page_context
from rmpc_bench.report.page.rendering import render_html, render_markdown
from rmpc_bench.report.page.source import PageFigure, PageSource, info_of, tables_of
from rmpc_bench.report.ranks_table import RanksTable
from rmpc_bench.report.run_tables import DriversTable, RequirementsTable
from rmpc_bench.report.summary import Summary
from rmpc_bench.report.tuning_table import TuningTable
from rmpc_bench.types import ConfigError
from rmpc_bench.types.tuning import Tuning

PAGE = "report.html"
CONFIGURATION = "config.resolved.yaml"
SHARED = {
    "time": "Time",
    "plant": "Plant",
    "model": "Design model",
    "uncertainty": "Uncertain quantities",
    "noise": "Noise",
    "initial": "Initial values",
    "reference": "Reference",
    "input": "Input",
}
"""Keys that hold for all methods -> their name on the page."""
LONGEST = 300
"""Characters of a value that the page shows; config.resolved.yaml has all."""


class Drawn(NamedTuple):
    """The figures of an experiment."""

    figures: Sequence[WrittenFigure]
    left_out: Sequence[str]
    """Those that could not be drawn, with the reason."""
    rendering: Rendering


class Evaluated(NamedTuple):
    """What is computed from the trials of an experiment."""

    record: ExperimentRecord
    """Name, seed, hash and command."""
    tables: Summary
    verdicts: Sequence[ClaimVerdict]
    drivers: DriversTable
    requirements: RequirementsTable
    ranks: RanksTable
    tuning: TuningTable


def write_page(
    results: Results,
    evaluated: Evaluated,
    drawn: Drawn,
    paths: Sequence[Path],
    directory: Path,
    place: str,
    index: Path | None = None,
) -> list[Path]:
    """Write report.html and report.md beside files that are written already, and return all files of the page."""
    more = write_more(results, _wanted(results, drawn.figures), directory / "figures", drawn.rendering)
    figures = [*drawn.figures, *more]
    written = [path for figure in more for path in figure.paths]
    configuration = _configuration(results.directory)
    methods = _as_computed(configuration.get("methods", {}), results.tuning)
    differences = method_differences(methods) if methods else {}
    files = [path.relative_to(directory).as_posix() for path in [*paths, *written]]
    source = PageSource(
        **evaluated._asdict(),
        trials=results.trials,
        figures=[_page_figure(figure, directory) for figure in figures],
        place=place,
        extent=results.extent,
        drawings=_drawings(results, evaluated.tables, drawn.rendering),
        left_out=drawn.left_out,
        incomplete=results.incomplete,
        overrides=results.overrides,
        manifest=read(results.directory),
        differences={
            name: {key: short_value(value) for key, value in keys.items()} for name, keys in differences.items()
        },
        shared=_shared(configuration, differences),
        confounded=_confounded(differences, results.experiment.baseline),
        timings=results.timings,
        files=[*files, "report.md"],
        index="" if index is None else Path(os.path.relpath(index, directory)).as_posix(),
    )
    context = page_context(source)
    pages = [directory / PAGE, directory / "report.md"]
    replace_text(pages[0], render_html("page.html", context))
    replace_text(pages[1], render_markdown("page.md", context))
    return [*written, *pages]


def _wanted(results: Results, figures: Sequence[WrittenFigure]) -> list[Mapping[str, Any]]:
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


def _drawings(results: Results, tables: Summary, rendering: Rendering) -> Mapping[str, str]:
    """Draw the changes over a swept number; nothing for other sweeps, and where methods are ranked or pooled."""
    rows = tables_of(tables, info_of(tables))
    if len(rows) < 2 or not results.trials.with_verdicts or results.trials.ranked is not None or tables.pooled:
        return {}
    with rendered(rendering):
        return page_drawings(rows)


def _page_figure(figure: WrittenFigure, directory: Path) -> PageFigure:
    files = [path.relative_to(directory).as_posix() for path in figure.paths]
    return PageFigure(figure.name, figure.kind, figure.caption, figure.svg, files)


def place_of(directory: Path) -> str:
    """Return a directory of results as commands name it: from here, else from ``results`` on, else its last part."""
    if found := relative_to_cwd(directory):
        return found
    parts = directory.resolve().parts
    where = max((number for number, part in enumerate(parts) if part == "results"), default=len(parts) - 1)
    return "/".join(parts[where:])


def _configuration(directory: Path) -> Mapping[str, Any]:
    """Return the configuration with every default; empty if it is not there.

    A symbolic link in a directory of somebody else could lead to a private file.
    """
    file = directory / CONFIGURATION
    if file.is_symlink():
        return {}
    try:
        data = plain(load(file))
        return data if isinstance(data, dict) else {}
    except (ConfigError, OSError):
        return {}


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
