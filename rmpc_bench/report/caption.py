"""Captions and notes of the tables of a paper.

A caption is one short line, for many classes of documents set captions of tables in capitals.  The note below the table
defines every column, the pairing, failures and verdicts in full sentences.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rmpc_bench.analysis.failures import FACTOR
from rmpc_bench.analysis.parameter_text import parameter_groups
from rmpc_bench.analysis.result_rows import ResultTable, result_table
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.captions import printed
from rmpc_bench.report.columns import other_average
from rmpc_bench.report.latex import ALL_METRICS, WIDTH, shown_points
from rmpc_bench.report.latex_columns import capitalised, chosen_columns
from rmpc_bench.report.latex_text import printed_latex, to_latex
from rmpc_bench.report.sentences import AVERAGES
from rmpc_bench.report.summary import Summary
from rmpc_bench.types.report_choices import Column

BEST = {"lower": "lower is better", "higher": "higher is better", "zero": "0 is best", "one": "1 is best"}
"""Direction of a metric -> words."""
DEFINITIONS: dict[Column, str] = {
    "mean": "Mean: average over the finished runs, with half its {level} interval.",
    "lost": "Lost: share of the runs that failed or whose {metric} exceeds {lost} times that of {baseline} in the same "
    "run, with its {level} interval.",
    "median": "Median: of the finished runs, with the quartiles in brackets.",
    "n": "Runs/failed: number of finished runs and of failed runs.",
    "held": "Held steps: share of the steps in which a failed component kept its last value.",
    "steps": "Failed steps: share of the steps in which the optimisation failed and the fallback was applied.",
    "change": "Change: relative to {baseline}, {average}, with {kind}{level} intervals in brackets.",
    "other": "The other change is the {other}.",
    "counts": "Won/lost/tied: number of runs in which the method is better, worse or {tied}.",
    "superiority": "Superiority: share of the runs in which the method is better, those that are {tied} counted half.",
    "p": "$p$: p value of the Wilcoxon signed-rank test, adjusted by Holm's method.",
    "verdict": "Verdict: from the interval and a margin of {margin}.",
    "pairs": "Pairs: runs that both methods finished.",
}
"""Column -> what it has."""
PAIRING = "Each run is paired with the run of {baseline} that has the same random parameters, initial state and noise."


def latex_captions(summary: Summary) -> dict[str, str]:
    """Return name -> LaTeX of the caption of every table that `latex.latex_tables` writes."""
    points = shown_points(summary)
    if not points:
        return {}
    trials = points[0].trials
    captions = {info.name: _subject(info.words, trials, len(points)) for info in trials.metrics}
    if len(captions) > 1:
        captions[ALL_METRICS] = _subject("Metrics", trials, len(points))
    return {name: f"{to_latex(text)}%\n" for name, text in captions.items()}


def latex_notes(summary: Summary, columns: Sequence[Column] | None = None, width: float = WIDTH) -> dict[str, str]:
    """Return name -> LaTeX of the note below every table that `latex.latex_tables` writes.

    Columns are those behind the name of the method; without them the usual ones that fit into the width [pt].
    """
    points = shown_points(summary)
    if not points:
        return {}
    infos = points[0].trials.metrics
    tables = {info.name: [result_table(*point, info) for point in points] for info in infos}
    notes = {name: table_note(each, chosen_columns(each, columns, width)) for name, each in tables.items()}
    if len(infos) > 1:
        notes[ALL_METRICS] = _note_of_all([each[0] for each in tables.values()])
    return {name: f"{printed_latex(text)}%\n" for name, text in notes.items()}


def table_note(tables: Sequence[ResultTable], shown: Sequence[Column]) -> str:
    """Define the columns behind the name of the method: plain text with formulas between dollar signs.

    The tables are of one metric, at every point of the sweep.
    """
    first = tables[0]
    words = _words(first)
    sentences = [f"{capitalised(first.info.words)}: {BEST[first.info.direction]}."]
    sentences += [DEFINITIONS[name].format(**words) for name in shown if name != "mean" or not first.may_not_occur]
    sentences += ["Occurred: runs in which the event occurred, and the median."] if first.may_not_occur else []
    sentences += [PAIRING.format(**words)] * bool(
        {"change", "other", "counts", "superiority", "p", "verdict"} & {*shown}
    )
    return " ".join([*sentences, *_parameters(first.trials), _failures(tables)])


def _words(table: ResultTable) -> dict[str, str]:
    """Return what the definitions name."""
    trials, margin = table.trials, _plain(table.margin_text)
    simultaneous = any(row.compared and row.compared["ci_level"] > trials.confidence for row in table.rows)
    other = other_average(table) or "mean"
    return {
        "level": f"{100 * trials.confidence:g} %",
        "kind": "simultaneous " * simultaneous,
        "baseline": _name(trials, trials.baseline),
        "average": table.average or "average",
        "other": AVERAGES[other],
        "margin": margin,
        "tied": "equal" if margin.split()[0] == "0" else f"within {margin}",
        "lost": f"{trials.lost or FACTOR:g}",
        "metric": table.info.words,
    }


def _subject(what: str, trials: Trials, n_points: int) -> str:
    """Name what is shown, methods, runs and points of a sweep."""
    where = f" at {n_points} points of the sweep" if n_points > 1 else ""
    return f"{capitalised(what)} of {_counted(len(trials.methods), 'method')} in {_runs(trials)}{where}"


def _runs(trials: Trials) -> str:
    if trials.alike and not trials.points and trials.title:
        return f"one run at {_plain(printed(trials.title))}"
    return f"{_counted(len(trials.runs), 'run')} per method"


def _parameters(trials: Trials) -> Iterable[str]:
    """Say where the parameters of the methods come from; nothing where it is not known."""
    groups = parameter_groups(trials, trials.methods)
    if len(groups) == 1:
        yield f"Parameters of all methods: {next(iter(groups))}."
    elif groups:
        parts = [f"{', '.join(_name(trials, name) for name in names)}: {word}" for word, names in groups.items()]
        yield f"Parameters: {'; '.join(parts)}."


def _failures(tables: Sequence[ResultTable]) -> str:
    """Name the failed runs of every method, and say how they count."""
    counts: dict[str, int] = {}
    for table in tables:
        for row in table.rows:
            counts[row.method] = counts.get(row.method, 0) + row.n_failed
    failed = [f"{_name(tables[0].trials, name)} {n}" for name, n in counts.items() if n]
    if not failed:
        return "No run failed."
    return f"Failed runs: {', '.join(failed)}; they are left out of averages, and count as worse than any finished run."


def _note_of_all(tables: Sequence[ResultTable]) -> str:
    """Define the columns of the table with a column per metric."""
    parts = ["Mean over the finished runs."]
    absent = [table.info.words for table in tables if table.may_not_occur]
    parts += [f"{capitalised(', '.join(absent))}: runs in which the event occurred."] if absent else []
    parts.append(capitalised("; ".join(f"{table.info.words}: {BEST[table.info.direction]}" for table in tables)) + ".")
    return " ".join([*parts, _failures(tables)])


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _name(trials: Trials, method: str) -> str:
    """Return the label of a method, which may have formulas."""
    return trials.labels.get(method, _plain(method))


def _plain(text: str) -> str:
    """Protect the dollar signs of a name."""
    return text.replace("$", r"\$")
