"""Captions and notes below tables, for page, Markdown and LaTeX, and the table of requirements in LaTeX.

The note of a page has two lines at most.  A caption for a paper is one short line, for many classes of documents set
captions of tables in capitals; the note below the table defines every column in full sentences.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from rmpc_bench.analysis.comparison_text import UNPAIRED, adjusted_for, per_cent
from rmpc_bench.analysis.result_rows import EQUIVALENT, FAILS_MORE, INCONCLUSIVE, MARKS, ResultTable, result_table
from rmpc_bench.analysis.statistics import pass_rates
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.tuning import parameter_groups
from rmpc_bench.analysis.verdict import FACTOR
from rmpc_bench.figures.labels import printed
from rmpc_bench.report import latex
from rmpc_bench.report.columns import COLUMNS, USUAL, columns_of, other_average
from rmpc_bench.report.latex import (
    WIDTH,
    Body,
    PaperTable,
    capitalised,
    fitting_body,
    paper_table,
    row_label,
    stacked,
    title_of,
)
from rmpc_bench.report.latex_text import number_latex, to_latex
from rmpc_bench.report.page.rows import Rows
from rmpc_bench.report.point_tables import AVERAGES, Points, PointSummary
from rmpc_bench.report.run_notes import adjustment_text, counted
from rmpc_bench.report.run_tables import REQUIREMENTS, difference_text, share_text
from rmpc_bench.types.metric import Requirement
from rmpc_bench.types.result_layout import Column

LONGEST = 285  # characters of two lines
SHARE = "of the share of runs in which the method is better (ties count half)"


def note_of(tables: Sequence[ResultTable], n: int, rows: Rows | None = None, *, lowest: str = "") -> str:
    """Write the note on n runs of every method; sentences that do not fit are left out, those at the end first.

    A matrix underlines the lowest change of every row or column, which `lowest` names.
    """
    first = tables[0]
    if not first.trials.with_verdicts:
        return ""
    several = len(tables) > 1
    draws = "; they are not paired" if first.trials.unpaired else " on the same draws"
    draws *= any(row.compared for table in tables for row in table.rows)
    sentences = [f"{n} run{'s' * (n > 1)} per {'point and ' * several}method{draws}."]
    oracle = "An oracle knows the true parameters." * any(row.is_oracle for row in first.rows)
    change = f"{'Difference' if first.form == 'difference' else 'Change'}: {first.average}." if first.average else ""
    adjusted = f"{capitalised(adjustment_text(tables))}." * bool(adjustment_text(tables))
    sentences += [_intervals(tables), change, adjusted, _marks(tables, lowest) if several else _drawn(first, rows)]
    look = max((int(row.compared["look"]) for row in first.rows if row.compared), default=1)
    looks = f"Look {look} at a growing number of runs, with wider intervals." if look > 1 else ""
    planned = first.trials.planned
    looks = looks if planned is None else f"{capitalised(planned.text)}."
    sentences += [_parameters(first), oracle, looks, _failures(tables)]
    kept = ""
    for sentence in filter(None, sentences):
        kept += f" {sentence}" * (len(kept) + len(sentence) < LONGEST)
    return kept.strip()


def _intervals(tables: Sequence[ResultTable]) -> str:
    first, level = tables[0], f"{100 * tables[0].trials.confidence:g} %"
    compared = [row.compared for table in tables for row in table.rows if row.compared]
    if not compared:
        return f"\u00b1: {level} interval of the mean." if len(tables) == 1 and not first.may_not_occur else ""
    simultaneous = any(float(row["ci_level"]) > first.trials.confidence for row in compared)
    which = "simultaneous " * simultaneous
    if len(tables) > 1:
        return f"Verdicts: {which}{level} intervals{' of all comparisons' * simultaneous}."
    if first.form == "share":
        return f"Brackets and bars: {which}{level} intervals {SHARE}."
    mean = f"; \u00b1: {level} interval of the mean" if not first.may_not_occur else ""
    return f"Brackets and bars: {which}{level} intervals{mean}."


def _marks(tables: Sequence[ResultTable], lowest: str) -> str:
    words = {row.word for table in tables for row in table.rows}
    texts = {INCONCLUSIVE: INCONCLUSIVE, EQUIVALENT: f"within {tables[0].margin_text}", FAILS_MORE: FAILS_MORE}
    parts = [f"{MARKS[word]} {text}" for word, text in texts.items() if word in words]
    best = "highest" if tables[0].info.direction == "higher" else "lowest"
    parts += [f"underlined: {best} of a {lowest}"] if lowest else []
    return f"{', '.join(parts)}." if parts else ""


def _drawn(table: ResultTable, rows: Rows | None) -> str:
    if table.form in ("alone", "share"):
        infinite = any(not math.isfinite(row.quantiles[-1]) for row in table.rows if row.quantiles)
        return "Arrow: runs without the event." if table.form == "share" and infinite else ""
    strips = [cell.strip for row in (rows.rows if rows else ()) for cell in row.cells]
    arrow = "Arrow: beyond the axis." if any(strip is not None and strip.arrow for strip in strips) else ""
    band = "Margin" if rows and rows.everything else "Grey band"
    return " ".join(filter(None, [f"{band}: within {table.margin_text}." if table.margin else "", arrow]))


def _parameters(table: ResultTable) -> str:
    """Say where the parameters come from: in words where all methods are alike."""
    groups = parameter_groups(table.trials, table.trials.methods)
    of_each = [(names[0] if len(names) == 1 else len(names), word) for word, names in groups.items()]
    short = [f"{n} {word.partition(' (')[0]}" for n, word in of_each]
    return f"Parameters: {'; '.join(groups if len(groups) == 1 else short)}." if groups else ""


def _failures(tables: Sequence[ResultTable]) -> str:
    """Say that failed runs are left out; of one point without lost runs, which share of all runs they can be."""
    if any(row.n_failed for table in tables for row in table.rows):
        return "Failed runs are left out of means and changes."
    rows = [row.compared for row in tables[0].rows if row.compared]
    known = [row for row in rows if row["far_worse_upper"] == row["far_worse_upper"]]
    if len(tables) > 1 or not known or any(row["far_worse_runs"] for row in known):
        return ""
    n = min(row["won"] + row["lost"] + row["tied"] for row in known)
    bound = per_cent(100 * max(float(row["far_worse_upper"]) for row in known))
    factor = f"{tables[0].trials.lost or FACTOR:g} times worse than {tables[0].baseline}"
    return f"No run of {n} was lost (failed or {factor}): at most {bound} of all runs are."


BEST = {"lower": "lower is better", "higher": "higher is better", "zero": "0 is best", "one": "1 is best"}
NO_PAIRING = "Runs are not paired: the intervals are those of Welch for two independent samples."
PAIRING = "Each run is paired with the run of {baseline} that has the same random parameters, initial state and noise."


def latex_tables(
    summary: Points, comments: Sequence[str] = (), columns: Sequence[Column] | None = None, width: float = WIDTH
) -> dict[str, latex.PaperTable]:
    """Return name -> table of requirements, of every metric, and of all metrics together where there are several.

    Comments at the head are version, hash, seed, number of runs and command.  Columns are those behind the name of the
    method; without them the usual ones that fit into the width in footnotesize [pt].
    """
    points = summary.with_runs
    if not 0 < len(points) <= latex.MOST_POINTS:
        return {}
    trials, found = points[0].trials, latex_requirements(points, comments, width)
    every = {info.name: [result_table(*point, info) for point in points] for info in trials.metrics}
    for name, tables in every.items():
        shown, body = latex.metric_body(tables, columns, width)
        caption = _subject(tables[0].info.words, trials, len(points))
        # A metric may have the name of the table of requirements.
        left = [each for each in USUAL if each not in shown and any(each in columns_of(table) for table in tables)]
        text = f"wider than {width:g} pt with {', '.join(left)} (choose columns)" if left and columns is None else ""
        found[name] = paper_table(name, body, caption, table_note(tables, shown), comments, text)
    if len(every) > 1:
        name, body = latex.ALL_METRICS, latex.all_metrics_body(points, width)
        caption, note = _subject("Metrics", trials, len(points)), _note_of_all([each[0] for each in every.values()])
        found[name] = paper_table(name, body, caption, note, comments)
    return found


def table_note(tables: Sequence[ResultTable], shown: Sequence[Column]) -> str:
    """Define the columns of the tables of one metric: plain text with formulas between dollar signs."""
    first, trials = tables[0], tables[0].trials
    margin = _plain(first.margin_text)
    simultaneous = any(row.compared and row.compared["ci_level"] > trials.confidence for row in first.rows)
    words = {
        "level": f"{100 * trials.confidence:g} %",
        "kind": "simultaneous " * simultaneous,
        "baseline": _name(trials, trials.baseline),
        "average": first.average or "average",
        "other": (UNPAIRED if trials.unpaired else AVERAGES)[other_average(first) or "mean"],
        "margin": margin,
        "tied": "equal" if margin.split()[0] == "0" else f"within {margin}",
        "lost": f"{trials.lost or FACTOR:g}",
        "metric": first.info.words,
    }
    sentences = [f"{capitalised(first.info.words)}: {BEST[first.info.direction]}."]
    defined = [name for name in shown if name != "mean" or not first.may_not_occur]
    sentences += [COLUMNS[name].definition.format(**words) for name in defined]
    adjusted = next(filter(None, (adjusted_for(row.compared) for row in first.rows if row.compared)), "")
    sentences += [f"Changes: {_plain(adjusted)}."] if adjusted and "change" in shown else []
    sentences += ["Occurred: runs in which the event occurred, and the median."] if first.may_not_occur else []
    # The sentence on pairs says it itself.
    if any(COLUMNS[name].compares for name in shown if name != "pairs"):
        sentences.append(NO_PAIRING if trials.unpaired else PAIRING.format(**words))
    return " ".join(filter(None, [*sentences, _origins(trials), _failed_runs(tables)]))


def _subject(what: str, trials: Trials, n_points: int) -> str:
    """Name what is shown, methods, runs and points of a sweep."""
    where = f" at {n_points} points of the sweep" if n_points > 1 else ""
    runs = f"{counted(len(trials.runs), 'run')} per method"
    if trials.alike and not trials.points and trials.title:
        runs = f"one run at {_plain(printed(trials.title))}"
    return f"{capitalised(what)} of {counted(len(trials.methods), 'method')} in {runs}{where}"


def _origins(trials: Trials) -> str:
    """Say where the parameters of the methods come from; nothing where it is not known."""
    groups = parameter_groups(trials, trials.methods)
    parts = [f"{', '.join(_name(trials, name) for name in names)}: {word}" for word, names in groups.items()]
    if len(groups) == 1:
        return f"Parameters of all methods: {next(iter(groups))}."
    return f"Parameters: {'; '.join(parts)}." if parts else ""


def _failed_runs(tables: Sequence[ResultTable]) -> str:
    """Name the failed runs of every method, and say how they count."""
    counts = Counter[str]()
    for row in (row for table in tables for row in table.rows):
        counts[row.method] += row.n_failed
    failed = ", ".join(f"{_name(tables[0].trials, name)} {n}" for name, n in counts.items() if n)
    how = "they are left out of averages, and count as worse than any finished run"
    return f"Failed runs: {failed}; {how}." if failed else "No run failed."


def _note_of_all(tables: Sequence[ResultTable]) -> str:
    """Define the columns of the table with a column per metric."""
    absent = ", ".join(table.info.words for table in tables if table.may_not_occur)
    occurred = f" {capitalised(absent)}: runs in which the event occurred." if absent else ""
    best = capitalised("; ".join(f"{table.info.words}: {BEST[table.info.direction]}" for table in tables))
    return f"Mean over the finished runs.{occurred} {best}. {_failed_runs(tables)}"


def _name(trials: Trials, method: str) -> str:
    """Return the label of a method, which may have formulas."""
    return trials.labels.get(method, _plain(method))


def _plain(text: str) -> str:
    """Protect the dollar signs of a name."""
    return text.replace("$", r"\$")


def latex_requirements(points: Sequence[PointSummary], comments: Sequence[str], width: float) -> dict[str, PaperTable]:
    """Return name -> table of requirements for a paper; empty without requirements."""
    tables = [point.trials for point in points if point.trials.requirements]
    if not tables:
        return {}
    first = tables[0]
    where = f" at {len(tables)} points of a sweep" if len(tables) > 1 else ""
    named = ", ".join(dict.fromkeys(_named(trials, each) for trials in tables for each in trials.requirements))
    caption = f"Runs that pass, which is to have {named}; {len(first.runs)} runs per method{where}."
    level = f"{100 * first.confidence:g} %"
    note = [f"Share: with its {level} interval of Wilson in brackets."]
    if len(first.methods) > 1:
        base = first.labels.get(first.baseline, first.baseline.replace("$", r"\$"))
        note.append(f"Each run is paired with the run of {base} that has the same random numbers.")
        what = f"share minus that of {base} in percentage points"
        note.append(f"Difference: {what}, with the paired {level} score interval.")
    failed = {name: sum(trials.n_failed(name) for trials in tables) for name in first.methods}
    counts = ", ".join(f"{first.labels.get(name, name)} {n}" for name, n in failed.items() if n)
    note.append(f"Failed runs: {counts}; they do not pass." if counts else "No run failed.")
    body = fitting_body([_body(tables, short=short) for short in (False, True)], width)
    return {REQUIREMENTS: paper_table(REQUIREMENTS, body, caption, " ".join(note), comments)}


def _named(trials: Trials, requirement: Requirement) -> str:
    """Write a requirement with the unit of its metric."""
    units = {info.name: info.unit for info in trials.metrics}
    return f"{requirement.text} {units.get(requirement.metric, '')}".rstrip().replace("$", r"\$")


def _body(tables: Sequence[Trials], *, short: bool) -> Body:
    """Lay out a group of rows per point and requirement."""
    paired = len(tables[0].methods) > 1
    head = ["Method", "Pass", stacked(["Share", r"[\%]"]), *([stacked(["Difference", "[points]"])] if paired else [])]
    groups = []
    for trials in tables:
        rates = pass_rates(trials)
        for requirement in trials.requirements:
            rows = []
            for row in (row for row in rates if row["requirement"] == requirement.text):
                texts = [f"{row['passed']}/{row['n']}", share_text(row).replace(" %", "", 1)]
                texts += [difference_text(row).replace(" points", "", 1)] if paired else []
                rows.append([row_label(trials, row["method"], short=short), *map(number_latex, texts)])
            title = ", ".join(filter(None, [title_of(trials), to_latex(_named(trials, requirement))]))
            groups.append((title, rows))
    return Body(head, groups)
