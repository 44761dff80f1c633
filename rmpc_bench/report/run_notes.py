"""Failed runs, held and failed steps, warnings, limitations, adjustments: for screen, tables/summary.md, failures/."""

from __future__ import annotations

import math
import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import Columns, rows_at
from rmpc_bench.analysis.comparison_text import change_of
from rmpc_bench.analysis.result_rows import ResultTable
from rmpc_bench.analysis.rounding import significant_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import RunFailure, Status

MOST_FILES = 20  # failed runs of a method that have a file of their own
MOST_WARNINGS = 10  # different warnings of a method that tables/summary.md shows


def percent(value: float) -> str:
    """Write a number in per cent with two digits, from 100 on without decimals; ``-`` where it is not known."""
    return "-" if math.isnan(value) else f"{value + 0.0:.2g} %" if abs(value) < 99.5 else f"{value:.0f} %"


def short_time(seconds: float) -> str:
    """Write a time with two digits and a unit, such as ``6.7 ms``, ``0.31 us`` and ``12 ms``."""
    unit, size = next((each for each in (("s", 1.0), ("ms", 1e-3)) if seconds >= 0.9995 * each[1]), ("us", 1e-6))
    number = float(f"{seconds / size:.2g}")
    return f"{number:.{2 if number < 1 else 1 if number < 10 else 0}f} {unit}"


def held_sentences(trials: Trials) -> list[str]:
    """Say how many steps of which method were held."""
    held = {method: notes for method, notes in trials.notes.items() if notes.held}
    sizes = {method: f"{notes.n_held:,} of {notes.n_steps * len(trials.runs):,}" for method, notes in held.items()}
    return [f"{name}: {sizes[name]} steps held in {counted(len(notes.held), 'run')}" for name, notes in held.items()]


def failed_sentences(trials: Trials) -> list[str]:
    """Say how many optimisations of which method failed, and in how many runs, of which every one went on."""
    sentences = []
    for method, notes in trials.notes.items():
        words = sum(map(Counter, notes.failed_steps.values()), Counter[str]())
        parts = ", ".join(f"{words[status.word]:,} {status.word}" for status in Status if words[status.word])
        steps = f"{notes.n_failed_steps:,} of {notes.n_steps * len(trials.runs):,} steps ({parts})"
        runs = f"in {counted(len(notes.failed_steps), 'run')}; the fallback was applied"
        sentences += [f"{method}: the optimisation failed in {steps}, {runs}"] if notes.failed_steps else []
    return sentences


def sections_of(trials: Trials) -> dict[str, list[str]]:
    """Return title -> entries of what tables/summary.md says besides its tables; an entry has one line."""
    warned = [
        f"{method}, {counted(n, 'time')}: {' '.join(text.split())}"
        for method, notes in trials.notes.items()
        for text, n in [*notes.warnings.items()][:MOST_WARNINGS]
    ]
    failed = []
    for method in trials.methods:
        for word, n in sorted(Counter(trials.statuses(method).values()).items()):
            status = Status.__members__.get(word.upper().replace("-", "_"))
            # Another program has said why it has no result, if at all.
            unknown = trials.elsewhere and status is Status.CRASHED
            meaning = "" if status is None or unknown else f": {status.explanation}"
            failed += [f"{method}: {counted(n, 'run')} {word}{meaning}"] if word != Status.OK.word else []
    declared = {method: trials.expected_failures.get(method, {}) for method in trials.methods}
    return {
        "Failed runs": failed,
        "Checks that are meant to fail": [
            f"{method}: `{check}` ({reason})" for method, checks in declared.items() for check, reason in checks.items()
        ],
        "Limitations": _limitations(trials),
        "Held steps": held_sentences(trials),
        "Failed steps": failed_sentences(trials),
        "Warnings of components": warned,
    }


def remark_lines(trials: Trials) -> list[str]:
    """Return a line on held steps, failed steps, warnings and limitations each, the first of its kind."""
    held = [text for table in trials.each for text in held_sentences(table)]
    steps = [text for table in trials.each for text in failed_sentences(table)]
    kinds = {text for table in trials.each for notes in table.notes.values() for text in notes.warnings}
    warned = [f"{counted(len(kinds), 'warning')} of components: tables/summary.md"] if kinds else []
    found = [[*each] for each in (steps, held, warned, _limitations(trials)) if each]
    return [text + (f" (and {len(each)} more: tables/summary.md)" if each else "") for text, *each in found]


def _limitations(trials: Trials) -> list[str]:
    """Return what a comparison with the plants of all points cannot show, each sentence once."""
    return [*dict.fromkeys(text for table in trials.each for text in table.limitations)]


def failure_files(
    trials: Trials, directory: object, quantities: Columns, versions: Mapping[str, str]
) -> dict[str, str]:
    """Return name -> text of the files on the first failed runs of every method; `versions` are those that computed."""
    files, counts = dict[str, str](), Counter[tuple[str, str]]()
    for table, method, run in failed_runs(trials):
        counts[table.title, method] += 1
        if counts[table.title, method] <= MOST_FILES:
            at = {**table.point, "run": run}
            (rows,) = np.nonzero(np.all([quantities[name] == value for name, value in at.items()], axis=0))
            names = [name for name in quantities if name not in at]
            values = {name: float(quantities[name][rows[0]]) for name in names} if len(rows) else {}
            point = f"{_word(table.title)}-" if table.title else ""
            text = _failure_text(table, directory, method, run, values, versions)
            files[f"{point}{_word(method)}-{run}.txt"] = text
    return files


def show_command(trials: Trials, directory: object, method: str, run: int) -> str:
    """Return the command that replays a run."""
    failure = _failure(trials, method, run)
    command = ["rmpc-bench", "show", str(directory), "--run", str(run), "--method", method]
    command += [part for path, value in trials.point.items() for part in ("--at", f"{path}={value}")]
    if failure is not None and failure.trace:
        command += [*([] if failure.k is None else ["--until", str(failure.k)]), "--pdb"]
    return shlex.join(command)


def failed_runs(trials: Trials) -> list[tuple[Trials, str, int]]:
    """Return point, method and run of every failed trial."""
    failed = [(table, rows_at(table.columns, table.columns["status"] != Status.OK.word)) for table in trials.each]
    return [
        (table, method, run)
        for table, rows in failed
        for method, run in zip(rows["method"].tolist(), rows["run"].tolist(), strict=True)
    ]


def crashed_runs(trials: Trials) -> dict[str, tuple[list[int], int, str]]:
    """Return method -> its runs that crashed, the number of all its runs, and the message of the first one."""
    found = {}
    for method in trials.methods:
        statuses = trials.statuses(method)
        runs = sorted(run for run, word in statuses.items() if word == Status.CRASHED.word)
        if runs:
            found[method] = runs, len(statuses), message_of(trials, method, runs[0])
    return found


def _failure(trials: Trials, method: str, run: int) -> RunFailure | None:
    notes = trials.notes.get(method)
    return next((each for each in notes.failures if each.run == run), None) if notes else None


def ran_counts(trials: Trials) -> dict[str, tuple[int, int]]:
    """Return method -> its failed runs and all its runs, all points together."""
    failed = {name: sum(table.n_failed(name) for table in trials.each) for name in trials.methods}
    sizes = {name: sum(len(table.statuses(name)) for table in trials.each) for name in failed}
    return {name: (failed[name], sizes[name]) for name in failed}


def of_run(trials: Trials, method: str, run: int) -> str:
    """Say in one line what happened to a run."""
    failure = _failure(trials, method, run)
    where = f" at {trials.title}" if trials.title else ""
    why = f"{_at(trials, failure.k)} ({message_of(trials, method, run)})" if failure is not None else ""
    return f"{method} run {run}{where}: {trials.statuses(method)[run]}{why}"


def message_of(trials: Trials, method: str, run: int) -> str:
    """Return the first line of the message of a failed run; its status where there is none."""
    failure = _failure(trials, method, run)
    text = failure.message or failure.component if failure is not None else ""
    return text.splitlines()[0] if text else trials.statuses(method)[run]


def _at(trials: Trials, k: int | None) -> str:
    return "" if k is None else f" at k = {k}" + (f", t = {k * trials.Ts:g} {trials.time_unit}" if trials.Ts else "")


def _failure_text(
    trials: Trials, directory: object, method: str, run: int, values: Mapping[str, Any], versions: Mapping[str, str]
) -> str:
    word, failure = trials.statuses(method)[run], _failure(trials, method, run)
    status = Status.__members__[word.upper().replace("-", "_")]
    lines = [f"{trials.name}: run {run} of {method}" + (f" at {trials.title}" if trials.title else "")]
    lines += [f"status      {word}: {status.explanation}"]
    if failure is not None:
        where = f"{failure.component}{_at(trials, failure.k)}".lstrip() or "unknown"
        lines += [f"where       {where}", f"reason      {failure.message}"]
    lines += [f"replay      {show_command(trials, directory, method, run)}"]
    if failure is not None and failure.trace:
        lines += ["", failure.trace.rstrip()]
    parts = [("values at the failure", {} if failure is None else failure.values), ("uncertain quantities", values)]
    notes = trials.notes.get(method)
    warned = {f"{n} x": text for text, n in notes.warnings.items()} if notes else {}
    parts += [("warnings of all runs of the method", warned), ("versions", versions)]
    for title, table in parts:
        if table:
            width = 2 + max(len(str(name)) for name in table)
            lines += ["", title, *(f"  {name!s:{width}}{value}" for name, value in table.items())]
    return "\n".join(lines) + "\n"


def _word(text: str) -> str:
    """Write a name so that it can be that of a file on every system."""
    return re.sub(r"[^\w.=,+-]+", "_", text)


def counted(n: int, noun: str) -> str:
    """Write a number with a noun, in the plural unless it is 1."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


MOST_RATIOS = 4  # methods up to which each has its gain by an adjustment in a line


def adjustment_text(tables: Sequence[ResultTable]) -> str:
    """Say what the changes of tables are adjusted for and what it gains, or why they are not; empty without draws."""
    found = [(table, row.compared) for table in tables for row in table.rows if row.compared]
    found = [(table, row) for table, row in found if not math.isnan(change_of(row).low)]
    if not found or tables[0].trials.adjust == "none" or not any(len(t.trials.quantities) > 1 for t in tables):
        return ""
    adjusted = [row for _, row in found if row["adjusted_form"]]
    if not adjusted:
        table, row = found[0]
        return f"not adjusted: {table.trials.adjustment.why_not(row['n_pairs'])}"
    forms = dict.fromkeys(row["adjusted_form"] for row in adjusted)
    names = dict.fromkeys(name for row in adjusted for name in row["adjusted_for"].split())
    text = f"adjusted for {', '.join(names)} ({' or '.join(forms)})"
    ratios = [row["width_ratio"] for row in adjusted]
    if len(adjusted) == 1:
        text += f": {_gain(ratios[0])}"
    elif len(tables) == 1 and len(adjusted) <= MOST_RATIOS:
        text += ": " + "  ".join(f"{row['method']} {_times(row['width_ratio'])}x" for row in adjusted)
    else:
        text += f": {_times(min(ratios))}x to {_times(max(ratios))}x narrower than plain"
    text += f" in {len(adjusted)} of {len(found)} comparisons" if len(adjusted) < len(found) else ""
    made = tables[0].trials.adjustment
    notes = [f"{name} left out: {why}" for name, why in made.left_out.items() if name in tables[0].trials.laws]
    notes = notes if isinstance(tables[0].trials.adjust, str) else []
    notes += [f"the normal law of {name} is wide: intervals of few runs are too short" for name in made.wide]
    return "; ".join([text, *notes])


def _gain(ratio: float) -> str:
    """Compare the width of the plain interval with that of the adjusted one."""
    if math.isinf(ratio):
        return "the draws explain all differences"
    if ratio > 1.1:
        return f"{_times(ratio)} times narrower than plain"
    if ratio >= 0.9:
        return f"gains nothing ({ratio:.2f} times)"
    return f"{_times(1 / ratio)} times wider than plain: the draws explain little"


def _times(ratio: float) -> str:
    return ">1000" if ratio > 1000 else significant_text(ratio, 2)
