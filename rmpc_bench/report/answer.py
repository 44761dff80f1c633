"""The answer of an experiment in at most 45 words, from its verdicts: what page, screen and report.md begin with."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from rmpc_bench.analysis.result_rows import (
    BETTER,
    EQUIVALENT,
    FAILS_MORE,
    INCONCLUSIVE,
    MOST_UNSORTED,
    NOT_COMPUTED,
    WORSE,
    ResultRow,
    ResultTable,
)
from rmpc_bench.analysis.shown_numbers import is_per_cent, mean_text, short
from rmpc_bench.claims.claim import Finding
from rmpc_bench.claims.verdict import ClaimVerdict

MOST_WORDS = 45
MOST_RANGES = 2
"""Ranges of points that are named; of more the points are counted."""
SMOKE = "A smoke run shows that everything works; its numbers mean nothing."
ORDER = (BETTER, EQUIVALENT, WORSE, INCONCLUSIVE, FAILS_MORE)
_NOT_TESTABLE = "not testable"
_BEGINNINGS = ("Of ", "Better ", "No ", "The ", "All ", "Statements ")
"""Words in front of which the answer does not begin with the name of a method."""
_FORMS = {BETTER: "better than {}", WORSE: "worse than {}", EQUIVALENT: "equivalent to {}"}


class Sweep(NamedTuple):
    """Points of an experiment in words."""

    points: Sequence[str]
    ordered: bool
    """Whether they are numbers of one path, so that neighbours form a range."""


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def answer(tables: Sequence[ResultTable], verdicts: Sequence[ClaimVerdict] = (), *, unfinished: bool = False) -> str:
    """Answer which method is better and by how much.

    Parameters
    ----------
    tables : those of the primary metric, point by point
    verdicts : findings of the claims
    unfinished : whether runs are missing, so that the answer is preliminary
    """
    first = tables[0].trials
    if not first.with_verdicts:
        return SMOKE
    found = _claims(verdicts)
    room = MOST_WORDS - len(found.split())
    said = _of_points(tables, room) if len(tables) > 1 else _of_rows(tables[0])
    text = " ".join(filter(None, [found, said]))
    if not unfinished:
        return text
    return f"So far {text[0].lower()}{text[1:]}" if text.startswith(_BEGINNINGS) else f"So far {text}"


def listed(names: Sequence[str]) -> str:
    """Join names with commas and a final ``and``."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def _claims(verdicts: Sequence[ClaimVerdict]) -> str:
    """Count the findings on the statements of the paper, in the order of the findings."""
    found = Counter(each.finding for each in verdicts if each.claim.of_paper)
    counts = {each.replace("-", " "): found[each] for each in Finding if found[each]}
    tested = {word: n for word, n in counts.items() if word != _NOT_TESTABLE}
    if len(tested) != 1:
        parts = [f"{n} {word}" for word, n in counts.items()]
        return f"Statements of the paper: {', '.join(parts)}." if tested else ""
    [(word, n)] = tested.items()
    if n == 1:
        return f"The statement of the paper that was tested is {word}."
    return f"All {n} statements of the paper that were tested are {word}."


def _of_rows(table: ResultTable) -> str:
    """Answer for one point."""
    rows = table.compared
    if not rows:
        return _alone(table)
    text = _counted(table, rows) if len(rows) > MOST_UNSORTED else _named(table, rows)
    return " ".join(filter(None, [text, *_failures(table, rows)])).strip()


def _alone(table: ResultTable) -> str:
    """State the means where nothing is compared."""
    rows = [row for row in table.rows if row.n][:3]
    if not rows:
        return "No run is finished."
    if table.may_not_occur:
        parts = [f"{row.n_occurred} of {row.n} runs of {row.method} have a {table.quantity}" for row in rows]
        return f"{listed(parts)}."
    unit = f" {table.info.unit}" if table.info.unit else ""
    parts = [f"{mean_text(row.mean)}{unit} for {row.method}" for row in rows]
    return f"The mean {table.quantity} is {listed(parts)} ({rows[0].n} run{'s' * (rows[0].n > 1)})."


def _named(table: ResultTable, rows: Sequence[ResultRow]) -> str:
    """Name up to 6 methods by their verdicts, with the size of the largest improvement."""
    parts: list[str] = []
    for word, form in _FORMS.items():
        names = [row.method for row in rows if row.word == word]
        if names:
            other = "it" if parts else table.baseline
            parts.append(f"{listed(names)} {_are(names)} {form.format(other)}")
    unsure = [row.method for row in rows if row.word == INCONCLUSIVE]
    if unsure:
        n = f" with {rows[0].n + rows[0].n_failed} runs" if not parts else ""
        parts.append(f"{listed(unsure)} {_are(unsure)} inconclusive{n}")
    missing = [row.method for row in rows if row.word == NOT_COMPUTED]
    parts += [f"{listed(missing)} {_are(missing)} not computed"] if missing else []
    text = "; ".join(parts)
    best = table.best
    if best is None or best.word != BETTER:
        return f"{text}." if text else ""
    if table.form == "share":
        return f"{text}: {_occurrence(table, best)}."
    return _with_size(table, best, text, alone=len(rows) == 1)


def _are(names: Sequence[str]) -> str:
    return "are" if len(names) > 1 else "is"


def _occurrence(table: ResultTable, best: ResultRow) -> str:
    """Compare how often the event did not occur, or the medians where that is the same."""
    base = next(row for row in table.rows if row.is_baseline)
    lost = [(row, row.n - row.n_occurred) for row in (base, best)]
    if lost[0][1] == lost[1][1]:
        medians = [f"{short(row.quantiles[2])} for {row.method}" if row.quantiles else "" for row in (best, base)]
        return f"its median {table.quantity} is {medians[0]}, {medians[1]}"
    parts = [f"{k or 'none'} of {row.n} runs of {row.method}" for row, k in lost]
    return f"there is no {table.quantity} in {listed(parts)}"


def _with_size(table: ResultTable, best: ResultRow, text: str, *, alone: bool) -> str:
    """Add by how much the best method is better."""
    sizes = [" ".join(filter(None, table.change_texts(best, mirrored=mirror))) for mirror in (False, True)]
    higher = table.info.direction == "higher"
    as_factor = table.form == "ratio" and not is_per_cent(best.change)
    if as_factor:
        size, verb, adjective = sizes[0], "", ""
    else:
        size = sizes[0].replace("+", "") if higher else sizes[1]
        verb, adjective = ("raises", "higher") if higher else ("lowers", "lower")
    if alone:
        of_base = f" that of {table.baseline}" if as_factor else f" {adjective}"
        return f"{text}: its {table.quantity} is {size}{of_base}."
    if as_factor:
        extreme = f"the {'highest' if higher else 'lowest'} {table.quantity}"
        return f"{text}. {best.method} has {extreme}, {size} that of {table.baseline}."
    return f"{text}. {best.method} {verb} the {table.quantity} most, by {size}."


def _counted(table: ResultTable, rows: Sequence[ResultRow]) -> str:
    """Count the verdicts of many methods, with the largest improvement."""
    counts = Counter(row.word for row in rows)
    parts = [f"{counts[word]} {word}" for word in ORDER if counts[word]]
    first, _, word = parts[0].partition(" ") if parts else ("", "", "")
    verb = "is" if first == "1" else "are"
    form = _FORMS.get(word, word).format(table.baseline)
    text = f"Of {len(rows)} methods, {listed([f'{first} {verb} {form}', *parts[1:]])}."
    best = table.best
    if best is None or best.word != BETTER:
        return text
    return f"{text} Largest improvement of the {table.quantity}: {best.method}, {table.change_text(best)}."


def _failures(table: ResultTable, rows: Sequence[ResultRow]) -> list[str]:
    """Say which methods fail more, and in how many runs."""
    base = next((row for row in table.rows if row.is_baseline), None)
    lost = base.n_failed if base else 0
    found = [row for row in rows if row.word == FAILS_MORE]
    if len(found) > 2:
        return [f"{listed([row.method for row in found[:3]])}{' and others' * (len(found) > 3)} fail more."]
    return [
        f"{row.method} fails more: {row.n_failed} of its {row.n + row.n_failed} runs failed, "
        f"{lost or 'none'} of {table.baseline}."
        for row in found
    ]


def _of_points(tables: Sequence[ResultTable], room: int) -> str:
    """Answer for a sweep: where each method is better or worse than the baseline."""
    first, sweep = tables[0], sweep_of(tables)
    words = {row.method: [_word_of(table, row.method) for table in tables] for row in first.compared}
    if not words:
        return ""
    better, worse = (_groups(words, word, sweep) for word in (BETTER, WORSE))
    text = f"Better than {first.baseline} in {first.quantity}"
    if not better:
        text = f"No method is better than {first.baseline} in {first.quantity} at any point."
    else:
        # The worse ones get what the better ones leave, but for the first group of each.
        reserved = len(worse[0].split()) + 1 if worse else 0
        text = f"{text}: {_fitting(better, room - len(text.split()) - reserved)}."
    return f"{text} Worse: {_fitting(worse, room - len(text.split()) - 1)}." if worse else text


def sweep_of(tables: Sequence[ResultTable]) -> Sweep:
    """Name the points of a sweep: by the value of the only path, or by all their values."""
    trials = [table.trials for table in tables]
    paths = {path for point in trials for path in point.point}
    if len(paths) != 1:
        return Sweep([point.title for point in trials], ordered=False)
    names = [str(next(iter(point.point.values()))) for point in trials]
    return Sweep(names, ordered=all(map(_is_number, names)))


def _word_of(table: ResultTable, method: str) -> str:
    return next((row.word for row in table.rows if row.method == method), "")


def _groups(words: Mapping[str, Sequence[str]], wanted: str, sweep: Sweep) -> list[str]:
    """Join the methods that have a verdict at the same points, those at most points first."""
    says: dict[str, list[str]] = {}
    size: dict[str, int] = {}
    write: Callable[[Sequence[bool]], str] = partial(ranges, sweep.points) if sweep.ordered else _where
    for method, found in words.items():
        chosen = [word == wanted for word in found]
        if any(chosen):
            text = write(chosen)
            says.setdefault(text, []).append(method)
            size[text] = sum(chosen)
    ordered = sorted(says, key=lambda text: -size[text])
    return [f"{listed(says[text])} {text}" for text in ordered]


def _fitting(groups: Sequence[str], room: int) -> str:
    """Join as many groups as a number of words allows, at least one, and say that there are others."""
    kept = [groups[0]]
    for group in groups[1:]:
        if sum(len(each.split()) for each in [*kept, group]) > room - 2 * (group is not groups[-1]):
            break
        kept.append(group)
    separator = "; " if any(" and " in group for group in kept) else ", "
    return separator.join([*kept, "and others"] if len(kept) < len(groups) else kept)


def ranges(points: Sequence[str], chosen: Sequence[bool]) -> str:
    """Say at which points of a sweep something holds; of three ranges or more the points are counted.

    Examples
    --------
    >>> points = ["0", "0.1", "0.2", "0.3"]
    >>> ranges(points, [False, True, True, True]), ranges(points, [True, False, False, True])
    ('from 0.1', 'at 0 and at 0.3')
    """
    found: list[tuple[int, int]] = []
    for k, yes in enumerate(chosen):
        if yes and found and found[-1][1] == k - 1:
            found[-1] = (found[-1][0], k)
        elif yes:
            found.append((k, k))
    last = len(points) - 1
    if len(found) > MOST_RANGES:
        return f"at {sum(chosen)} of {len(points)} points"
    words = []
    for a, b in found:
        if (a, b) == (0, last):
            words.append("everywhere")
        elif a == b:
            words.append(f"at {points[a]}")
        elif b == last:
            words.append(f"from {points[a]}")
        else:
            words.append(f"up to {points[b]}" if a == 0 else f"from {points[a]} to {points[b]}")
    return " and ".join(words)


def _where(chosen: Sequence[bool]) -> str:
    """Count the points, where they have no order."""
    n = sum(chosen)
    return f"at all {len(chosen)} points" if n == len(chosen) else f"at {n} of {len(chosen)}"
