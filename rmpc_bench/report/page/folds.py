"""What a page shows on demand, in its order: folds with a title that says what they contain."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import Rows, n_rows
from rmpc_bench.analysis.drivers import FAILED, REST, per_cent
from rmpc_bench.analysis.drivers import gist as drivers_gist
from rmpc_bench.analysis.pairs import distance_from_best
from rmpc_bench.analysis.result_rows import ResultTable
from rmpc_bench.analysis.shown_numbers import short
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.tuning import is_tuned, parameter_groups, parameter_text
from rmpc_bench.claims.claim import Finding
from rmpc_bench.figures.labels import quantity, short_title
from rmpc_bench.report.calibration_table import CALIBRATION
from rmpc_bench.report.page.matrix import MOST_OPEN, MOST_ROWS, interval_rows, matrices_of
from rmpc_bench.report.point_tables import columns_from, texts_of
from rmpc_bench.report.ranks_table import LIMITATIONS
from rmpc_bench.report.run_notes import counted, failed_runs, message_of, of_run, sections_of, show_command
from rmpc_bench.report.run_tables import (
    REQUIREMENTS,
    REQUIREMENTS_NOTE,
    correlated_text,
    ensemble_rows,
    requirement_columns,
    tail_columns,
    worst_of,
)
from rmpc_bench.report.source import Fold, PageFigure, PageSource, Part, Table
from rmpc_bench.report.tuning_table import EXPLANATION
from rmpc_bench.report.two_way_table import two_way_tables


def _settings(source: PageSource) -> Fold:
    """Show the keys in which the methods differ, and what they share."""
    trials, differences, parts = source.trials, source.differences, list[Part]()
    keys = [*dict.fromkeys(key for row in differences.values() for key in row)]
    if keys and len(differences) > 1:
        columns = {"method": [*differences]}
        origins = [parameter_text(trials, name) or "-" for name in differences]
        columns |= {"parameters": origins} if len(set(origins)) > 1 else {}
        columns |= {key: [row.get(key, "-") for row in differences.values()] for key in keys}
        parts.append(Part(table=Table(columns, numeric=False, by_method=True)))
    parts += [Part(items=[f"{name}: {text}" for name, text in source.shared.items()])] if source.shared else []
    if trials.points:
        parts.append(Part(text=f"Sweep of {len(trials.points)} points over {', '.join(trials.paths)}."))
    if n_rows(source.timings):
        table = Table(texts_of(source.timings, 3))
        parts += [Part(text="Durations of the calls of components [s]:"), Part(table=table)]
    parts.append(Part(note="config.resolved.yaml has every key with its default."))
    n = len(trials.methods)
    uncertain = len(trials.each[0].quantities) - 1
    gist = counted(n, "method")
    gist += f", {uncertain} uncertain quantit{'y' if uncertain == 1 else 'ies'}" if uncertain > 0 else ""
    return Fold("Settings", gist, parts)


def _limits(source: PageSource) -> Iterator[str]:
    """Say where these are not the results of the configuration as it stands, then what is not compared."""
    trials = source.trials
    if source.overrides:
        yield f"The configuration was overridden ({', '.join(source.overrides)}); findings do not count."
    if source.manifest.get("origin") == "imported":
        yield "The runs were made elsewhere: their draws, their code and its versions are not known here."
    if source.incomplete:
        yield f"Not all runs are computed ({', '.join(source.incomplete)}); findings do not count."
    changed = sum(each.differs for each in source.verdicts)
    if changed and trials.with_verdicts:
        yield f"{counted(changed, 'finding')} changed since it was recorded."
    if trials.n_failed_trials:
        yield "Averages rest on the runs that both methods finished."
    yield from (f"A figure is missing: {text}." for text in source.left_out)
    if (source.manifest.get("git") or {}).get("dirty"):
        yield "The working tree had uncommitted changes when this was computed."
    groups = parameter_groups(trials, trials.methods) if len(trials.methods) > 1 else {}
    left = {word: names for word, names in groups.items() if not is_tuned(trials, names[0])}
    if len(left) == len(groups) == 1:
        word = next(iter(left)).removesuffix(", not tuned")
        yield f"No parameter was tuned: all are {word}. Other parameters may change a verdict."
    else:
        others = "other parameters may change a verdict"
        yield from (f"{', '.join(names)}: {word}; {others}." for word, names in left.items())
    yield from source.tuning.limitations
    yield from dict.fromkeys(text for table in trials.each for text in table.limitations)
    yield from (f"{name} knows the true parameters; no real estimator can do that." for name in sorted(trials.oracles))
    if source.confounded:
        pair = f"{trials.baseline} and {', '.join(source.confounded)}"
        yield f"Both the estimator and the controller differ between {pair}; the effect of one alone is not known."
    yield from LIMITATIONS if source.ranks.found is not None else ()
    for verdict in source.verdicts:
        if verdict.joined is Finding.DEPENDS_ON_ASSUMPTIONS:
            yield f"The finding depends on unstated assumptions: {' '.join(verdict.claim.says.split())}."
    if trials.with_verdicts and len(trials.runs):
        yield "All numbers hold for this plant and these distributions of its uncertain quantities and noises only."


MOST_LISTED = 6  # entries of a list
MOST_NAMED = 3  # metrics and limits that a title names
MOST_POINTS = 12  # points of a sweep whose tables a fold has; CSV files have all
SHARES = (
    "Share of the variance of the change that a quantity explains; shares need not sum to 100 %. "
    "-: too uncertain to be shown."
)
TAILS = (
    "95 % quantile: interval between order statistics. Mean of the worst 5 % of the runs: bootstrap interval of whole "
    "runs; none below 72 runs. Failed runs are in neither."
)


def folds_of(source: PageSource, tables: Sequence[ResultTable]) -> list[Fold]:
    """Return the folds that have content, in their order; `tables` are those of the primary metric."""
    limits = [*_limits(source)]
    gist = "".join(text.rstrip(".").partition(". ")[0] for text in limits[:1])
    gist += f" (and {len(limits) - 1} more)" if len(limits) > 1 else ""
    stand_above = not len(source.trials.runs) and len(source.trials.each) == 1
    moments = None if stand_above else moments_of(source.trials)
    in_short = "bias, variance and reported covariance by state"
    found = [
        _failures(source),
        _calibration(source),
        _two_way(source),
        _drivers(source),
        *_points(source, tables),
        _metrics(source),
        Fold("Error at the end", in_short, [Part(table=moments)] if moments else []),
        _requirements(source),
        _worst(source, tables),
        *_figures(source),
        _settings(source),
        Fold("Limits of this comparison", gist, [Part(items=limits)] if limits else []),
    ]
    return [fold for fold in found if fold is not None and fold.parts]


def _failures(source: PageSource) -> Fold:
    """Say which runs failed and why, with the command that computes the first one again; held and failed steps."""
    parts, trials = list[Part](), source.trials
    failed = failed_runs(trials)
    sections = [sections_of(table) for table in trials.each]
    lines = [
        f"{f'{short_title(table)}: ' if table.title else ''}{text}"
        for table, found in zip(trials.each, sections, strict=True)
        for text in (*found["Failed runs"], *found["Checks that are meant to fail"])
    ]
    left = [f"{len(lines) - MOST_POINTS} more: failures/"] if len(lines) > MOST_POINTS + 1 else []
    parts += [Part(items=[*lines[:MOST_POINTS], *left] if left else lines)] if lines else []
    if failed:
        table, method, run = failed[0]
        parts.append(Part(text=f"First: {'; '.join(of_run(*each) for each in failed[:MOST_NAMED])}. See failures/."))
        parts.append(Part(command=show_command(table, source.place, method, run)))
    steps = [f"Held: {text}" for each in sections for text in each["Held steps"]]
    steps += [f"Steps: {text}" for each in sections for text in each["Failed steps"]]
    warned = dict.fromkeys(text for table in trials.each for notes in table.notes.values() for text in notes.warnings)
    steps += [f"Warning of a component: {' '.join(text.split())}" for text in warned]
    parts += [Part(items=steps[:MOST_LISTED])] if steps else []
    gist = steps[0].partition(";")[0] if steps else "checks that are meant to fail"
    if failed:
        [(message, n)] = Counter(message_of(*each) for each in failed).most_common(1)
        names = {method for _, method, _ in failed}
        gist = f"{message} ({f'all {n}' if n == len(failed) else f'{n} of {len(failed)}'}"
        gist += f", {names.pop()})" if len(names) == 1 else ")"
    return Fold("Failures", gist, parts)


def _calibration(source: PageSource) -> Fold | None:
    """Compare the reported covariances with the errors."""
    table = source.calibration
    if not source.trials.with_verdicts:
        return None
    parts = _by_point(table.points, table.columns, CALIBRATION, by_method=True)
    return Fold("Calibration", table.gist, [*parts, Part(note=table.note)] if parts else [])


def _by_point(
    points: Sequence[tuple[Trials, Rows]], columns: Callable[..., dict[str, list[str]]], file: str, **how: bool
) -> list[Part]:
    """Show the table of every point that has rows; of many points the first ones."""
    shown, parts = [(trials, rows) for trials, rows in points if rows], list[Part]()
    for trials, rows in shown[:MOST_POINTS]:
        parts += [Part(text=f"{short_title(trials)}:")] if trials.title else []
        parts.append(Part(table=Table(columns(trials, rows, plain=True), **how)))
    left = len(shown) - MOST_POINTS
    return parts + ([Part(note=f"{left} more points are in {file}.csv.")] if left > 0 else [])


def _two_way(source: PageSource) -> Fold:
    """Show main effects and interactions of two axes of methods."""
    tables, parts = two_way_tables(source.trials), list[Part]()
    for table in tables[:MOST_POINTS]:
        parts += [Part(text=f"{table.title}:"), Part(table=Table(table.columns())), Part(items=table.sentences)]
    parts += [Part(note=table.note) for table in tables[:1]]
    gist = next((text for table in tables for text in table.sentences), "main effects and interactions")
    return Fold(" and ".join(source.trials.two_way or ()).capitalize(), gist, parts)


def _drivers(source: PageSource) -> Fold | None:
    """Say which quantities explain the change; nothing where no share is resolved."""
    if not source.trials.with_verdicts:
        return None
    baseline = source.trials.baseline
    found: list[Mapping[str, str]] = []
    every: list[Mapping[Any, Any]] = []
    for trials, every_row in source.drivers.points:
        rows = [row for row in every_row if row["quantity"] != REST and row["response"] != FAILED]
        gist = drivers_gist(rows, baseline)
        rows = [row for row in rows if row["method"] != baseline] or rows
        every += rows if gist else []
        for method in dict.fromkeys(row["method"] for row in rows) if gist else ():
            cells = {"method": method} | _point(trials)
            of_method = [row for row in rows if row["method"] == method]
            shares = [f"{per_cent(max(row['share'], 0.0))} %" if row["resolved"] else "-" for row in of_method]
            found.append(cells | dict(zip((row["quantity"] for row in of_method), shares, strict=True)))
    if not found:
        return None
    left = [Part(note=f"{len(found) - MOST_ROWS} more rows are in drivers.csv.")] if len(found) > MOST_ROWS else []
    by_method = Table(columns_from(found[:MOST_ROWS]), by_method=True)
    correlated = correlated_text([trials for trials, _ in source.drivers.points])
    left += [Part(note=correlated)] if correlated else []
    return Fold(
        "What drives the change", drivers_gist(every, baseline), [Part(table=by_method), *left, Part(note=SHARES)]
    )


def _point(trials: Trials) -> dict[str, str]:
    """Name a point of a sweep in a column of its own."""
    return {"point": short_title(trials)} if trials.title else {}


def _points(source: PageSource, tables: Sequence[ResultTable]) -> Iterator[Fold]:
    """List the intervals of a sweep, and its points where ranks or all points together stand above."""
    if len(tables) < 2 or not source.trials.with_verdicts:
        return
    n = f"{len(tables)} points"
    if source.ranks.found is not None or source.tables.pooled is not None:
        yield Fold("Points of the sweep", n, [Part(groups=matrices_of(tables))])
    columns = interval_rows(tables)
    left = sum(len(table.rows) for table in tables) - len(columns.get("point", ()))
    more = [Part(note=f"{left} more rows are in comparisons.csv.")] if left > 0 else []
    yield Fold("Intervals and means of all points", n, [Part(table=Table(columns)), *more] if columns else [])


def _metrics(source: PageSource) -> Fold | None:
    """Show the other metrics: of one point their means, of a sweep the changes."""
    primary = source.info
    infos = [info for info in source.tables.points[0].trials.metrics if info != primary]
    every = {info.name: source.tables_of(info) for info in infos}
    every = {name: tables for name, tables in every.items() if tables}
    if not every or not source.trials.with_verdicts:
        return None
    parts = list[Part]()
    first = next(iter(every.values()))
    if len(first) == 1:
        methods = [row.method for row in first[0].ordered]
        columns = {"method": methods}
        for (table,) in every.values():
            rows = {row.method: row for row in table.rows}
            head = quantity(table.info) + "; occurred, median" * table.may_not_occur
            columns[head] = [table.mean_text(rows[name]) for name in methods]
        parts = [Part(table=Table(columns, by_method=True))]
    elif len(first) <= MOST_OPEN:
        for tables in every.values():
            parts += [Part(text=f"{quantity(tables[0].info)}:"), Part(groups=matrices_of(tables))]
    else:
        parts = [Part(text="summary.csv and comparisons.csv have them at every point.")]
    return Fold("Other metrics", _best_of([*every.values()]), parts)


def _best_of(every: Sequence[Sequence[ResultTable]]) -> str:
    """Name who has the best median in each metric at one point; the metrics alone for a sweep."""
    words, left = [], len(every) - MOST_NAMED
    more = f" and {left} more" if left > 0 else ""
    if len(every[0]) > 1:
        return ", ".join(tables[0].info.words for tables in every[:MOST_NAMED]) + more
    for (table,) in every[:MOST_NAMED]:
        direction = table.info.direction
        sign = -1.0 if direction == "higher" else 1.0
        rows = [row for row in table.rows if row.n and not row.is_oracle]
        medians = sign * distance_from_best(np.array([row.quantiles[2] for row in rows]), direction)
        least = medians.min(initial=math.inf)
        # Of equal ones none is the best.
        if len(table.rows) > 1 and np.isfinite(least) and np.count_nonzero(medians == least) == 1:
            best = "highest median" if direction == "higher" else "lowest median"
            words.append((best, f"{table.quantity}: {rows[int(medians.argmin())].method}"))
    said = [f"{best} {text}" if k == 0 or best != words[k - 1][0] else text for k, (best, text) in enumerate(words)]
    return ", ".join(said) + more if said else ", ".join(tables[0].info.words for tables in every[:MOST_NAMED])


def moments_of(trials: Trials, *, short: bool = False) -> Table | None:
    """Return bias and variance of the error at the end, where moments were evaluated; in short its mean square."""
    found: list[Mapping[str, str]] = []
    for table in trials.each:
        for row in ensemble_rows(table):
            name, *cells = row.values()
            named = dict(zip([*row][1:-1] + ["basis"], cells, strict=True))
            start = {"method": name.removesuffix(" (oracle)")} | _point(table)
            found.append(start | ({"mean square": named["mean square"]} if short else named))
    return Table(columns_from(found)) if found else None


def _requirements(source: PageSource) -> Fold | None:
    if not source.trials.with_verdicts:
        return None
    parts = _by_point(source.requirements.points, requirement_columns, REQUIREMENTS)
    parts += [Part(note=REQUIREMENTS_NOTE)] if parts else []
    n = sum(bool(rows) for _, rows in source.requirements.points)
    gist = source.requirements.gist.partition(": tables/")[0] if n == 1 else f"at {n} points"
    return Fold("Requirements", gist, parts)


def _worst(source: PageSource, tables: Sequence[ResultTable]) -> Fold | None:
    """Name the worst run of every method with the command that shows it, and the worst 5 % of the runs."""
    worst = worst_of(tables)
    if worst is None or not source.trials.with_verdicts:
        return None
    columns = {
        "method": [*worst.found],
        f"worst {tables[0].quantity_with_unit}": [short(value, 4) for value, _, _ in worst.found.values()],
        "run": [str(run) for _, run, _ in worst.found.values()],
    }
    if len(tables) > 1:
        columns["point"] = [short_title(trials) for _, _, trials in worst.found.values()]
    else:
        of_tails = tail_columns(tables[0].trials, [tables[0].info])
        for head in ("95 % quantile", "mean of the worst 5 %") if of_tails else ():
            by_method = dict(zip(tables[0].trials.methods, of_tails[head], strict=True))
            columns[head] = [by_method[name] for name in worst.found]
    parts = [Part(table=Table(columns, by_method=True)), Part(command=worst.command(source.place))]
    parts += [Part(note=TAILS)] if len(columns) > 4 else []
    return Fold("Worst runs", worst.gist, parts)


def _figures(source: PageSource) -> Iterator[Fold]:
    """Show signals, the tuned values, then what the configuration asks for."""
    over_time = [each for each in source.figures if each.kind == "signals"]
    n = max((len(trace.runs) for table in source.trials.each for trace in table.traces.values()), default=0)
    gist = counted(n, "recorded run") if n else "series of the designs"
    yield Fold("Signals", gist, [Part(figure=each) for each in over_time])
    yield _tuning(source, [each for each in source.figures if each.kind == "tuning"])
    others: dict[tuple[str, str], list[PageFigure]] = {}
    for figure in source.figures:
        if figure.kind not in ("signals", "tuning"):
            # What a caption says first.
            subject = re.split(r"[:;]\s|\.\s", figure.caption, maxsplit=1)[0].rstrip(".")
            others.setdefault((figure.kind, subject), []).append(figure)
    for (kind, subject), figures in others.items():
        title = f"{len(figures)} figures {kind}" if len(figures) > 1 else f"Figure {figures[0].name}"
        yield Fold(title, subject, [Part(figure=figure) for figure in figures])


def _tuning(source: PageSource, figures: Sequence[PageFigure]) -> Fold:
    tuning, parts = source.tuning, [Part(figure=each) for each in figures]
    if not tuning.outcomes:
        return Fold("Tuning", "tried values", parts)
    tables = [Part(text=tuning.protocol)]
    for title, values, ranks, sentences in tuning.tables:
        tables += [Part(text=f"{title}:")] if title else []
        tables += [Part(table=Table(each, by_method=True)) for each in (values, ranks) if each]
        tables += [Part(items=sentences)] if sentences else []
    left = f" {tuning.n_left} more points are in tuning.csv." if tuning.n_left else ""
    tables += [Part(text=f"Cost: {tuning.cost}.{left}"), Part(note=EXPLANATION)]
    return Fold("Tuning", tuning.gist.removeprefix("tuned: ").replace(" (tables/tuning.md)", ""), [*tables, *parts])
