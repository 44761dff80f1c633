"""The answer of an experiment in at most 45 words, from its verdicts: what page, screen and report.md begin with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby, product
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
from rmpc_bench.analysis.shown_numbers import is_per_cent
from rmpc_bench.claims.claim import Finding
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.figures.labels import joined
from rmpc_bench.figures.sweep_content import SweepAxis, axis_of
from rmpc_bench.report.run_notes import counted

MOST_WORDS = 45
ENOUGH = 25  # words for the points of a sweep, below which the findings are counted in fewer words
MOST_RANGES = 2  # ranges of points that are named; of more the points are counted
EXACT = "Exact moments of the error; nothing is simulated."
SMOKE = "A smoke run shows that everything works; its numbers mean nothing."
ORDER = (BETTER, EQUIVALENT, WORSE, INCONCLUSIVE, FAILS_MORE)
_BEGINNINGS = ("Of ", "Better ", "No ", "The ", "All ", "Both ", "Statements ", "Every ")  # no names of methods
_FORMS = {BETTER: "better than {}", WORSE: "worse than {}", EQUIVALENT: "equivalent to {}"}
_FINDINGS = {
    Finding.CONFIRMED_SMALLER: "confirmed with a smaller effect",
    Finding.CONFIRMED_LARGER: "confirmed with a larger effect",
    Finding.DEPENDS_ON_ASSUMPTIONS: "dependent on unstated assumptions",
    Finding.EQUAL: "equal to the printed digits",
    Finding.CLOSE: "close to the printed number",
    Finding.DIFFERENT: "different from the printed number",
}  # behind a form of `be`, where the words of the finding itself do not fit


class Sweep(NamedTuple):
    """Points of an experiment in words."""

    points: Sequence[str]
    ordered: bool  # whether they are numbers of one path, so that neighbours form a range


def answer(
    tables: Sequence[ResultTable], verdicts: Sequence[ClaimVerdict] = (), *, unfinished: bool = False, n_blank: int = 0
) -> str:
    """Answer which method is better and by how much; `n_blank` points of the sweep have no table of the metric."""
    if not tables or not tables[0].trials.with_verdicts:
        return SMOKE if tables else EXACT
    claims, room = _claims(verdicts), MOST_WORDS - 2 * unfinished
    if nothing := _nothing(tables):
        text = " ".join(filter(None, [claims[-1], nothing]))
    elif len(tables) > 1:
        found = next((text for text in claims if len(text.split()) + ENOUGH <= room), claims[-1])
        text = f"{found} {_of_points(tables, n_blank, room - len(found.split()))}".strip()
    else:
        # One wording of each part, the first ones that fit together; the first part is the first to be shortened.
        choices = sorted(
            product(*map(enumerate, (claims, *_of_rows(tables[0])))),
            key=lambda chosen: (sum(k for k, _ in chosen), -chosen[0][0]),
        )
        texts = [" ".join(text for _, text in chosen if text) for chosen in choices]
        text = next((text for text in texts if len(text.split()) <= room), texts[-1])
    if not unfinished:
        return text
    return f"So far {text[0].lower()}{text[1:]}" if text.startswith(_BEGINNINGS) else f"So far {text}"


def _claims(verdicts: Sequence[ClaimVerdict]) -> list[str]:
    """Count the findings on the statements of the paper, joined over configurations, in their order; then shorter."""
    found = Counter(each.joined for each in verdicts if each.claim.of_paper)
    tested = {each: found[each] for each in Finding if found[each] and each is not Finding.NOT_TESTABLE}
    n = sum(tested.values())
    if not tested:
        return [""]
    if len(tested) == 1:
        which = "The statement" if n == 1 else f"{'Both' if n == 2 else f'All {n}'} statements"
        was, word = ("was tested is" if n == 1 else "were tested are"), finding_words(next(iter(tested)))
        return [f"{which} of the paper that {was} {word}."]
    parts = [f"{found[each]} {finding_words(each)}" for each in Finding if found[each]]
    k = sum(count for each, count in tested.items() if each.is_confirmed)
    fewer = f"Of {n} statements of the paper, {k or 'none'} {'are' if k > 1 else 'is'} confirmed."
    return [f"Statements of the paper: {', '.join(parts)}.", fewer]


def finding_words(finding: Finding) -> str:
    """Write a finding so that it can stand behind a number or a form of ``be``."""
    return _FINDINGS.get(finding, finding.sentence)


def _nothing(tables: Sequence[ResultTable]) -> str:
    """Say why nothing can be compared, where more runs would not help: no run of any method has a value."""
    first, rows = tables[0], [row for table in tables for row in table.rows if row.n + row.n_failed]
    at = " at any point" if len(tables) > 1 else ""
    if first.form == "alone" or any(row.n_occurred for row in rows) or not rows:
        return ""
    if all(row.n_failed and not row.n for row in rows):
        return f"Every run failed{at and ' at every point'}."
    return f"No run of any method has a {first.quantity}{at}." if any(table.may_not_occur for table in tables) else ""


def _of_rows(table: ResultTable) -> tuple[list[str], list[str]]:
    """Return the answer for one point and what is said of failures, each in ever fewer words."""
    rows = table.compared
    if not any(row.word for row in rows):
        return [_alone(table)], [""]
    counts, best = _counted(table, rows), table.best
    named = _named(table, rows) if len(rows) <= MOST_UNSORTED else []
    if best is not None and best.word == BETTER and best.is_sized:
        largest = f" Largest improvement of the {table.quantity}: {best.method}, {table.change_text(best)}."
        named.append(f"{counts}{largest}")
    return [*dict.fromkeys([*named, counts])], _failures(table, rows)


def _alone(table: ResultTable) -> str:
    """State the means where nothing is compared."""
    rows = [row for row in table.rows if row.n][:3]
    if not rows:
        return "Every run failed." if any(row.n_failed for row in table.rows) else "No run is finished."
    if table.may_not_occur:
        parts = [f"{row.n_occurred} of {row.n} runs of {row.method} have a {table.quantity}" for row in rows]
        return f"{joined(parts)}."
    unit = f" {table.info.unit}" if table.info.unit else ""
    parts = [f"{table.mean_text(row)}{unit} for {row.method}" for row in rows]
    return f"The mean {table.info.words} is {joined(parts)} ({rows[0].n} run{'s' * (rows[0].n > 1)})."


def _named(table: ResultTable, rows: Sequence[ResultRow]) -> list[str]:
    """Name up to 6 methods by their verdicts, with the size of the largest improvement and without."""
    parts: list[str] = []
    for word, form in (*_FORMS.items(), (INCONCLUSIVE, INCONCLUSIVE), (NOT_COMPUTED, NOT_COMPUTED)):
        names = [row.method for row in rows if row.word == word]
        if names:
            n = f" with {counted(rows[0].n + rows[0].n_failed, 'run')}" if word == INCONCLUSIVE and not parts else ""
            are = "are" if len(names) > 1 else "is"
            parts.append(f"{joined(names)} {are} {form.format('it' if parts else table.baseline)}{n}")
    text = "; ".join(parts)
    best = table.best
    if best is None or best.word != BETTER or not best.is_sized:
        return [f"{text}." if text else ""]
    if table.form != "share":
        return [_with_size(table, best, text, len(rows) == 1), f"{text}."]
    # How often the event did not occur; where that is the same, in how many runs the best is better.
    base = next(row for row in table.rows if row.is_baseline)
    if not base.n:
        return [f"{text}."]
    lost = [(row, row.n - row.n_occurred) for row in (base, best)]
    if lost[0][1] == lost[1][1]:
        return [f"{text}. {best.method} is better in {table.change_text(best)} of the runs.", f"{text}."]
    (_, before), (_, after) = lost
    counts = f"{before} of {base.n} runs, {best.method} in {after} of {best.n}"
    return [f"{text}: {base.method} has no {table.quantity} in {counts}.", f"{text}."]


def _with_size(table: ResultTable, best: ResultRow, text: str, alone: bool) -> str:
    """Add by how much the best method is better; with one method compared, as "its"."""
    higher = table.info.direction == "higher"
    as_factor = table.form == "ratio" and not is_per_cent(best.change)
    # The size of a reduction is a positive number.
    size = " ".join(filter(None, table.change_texts(best, mirrored=not as_factor and not higher)))
    size = size if as_factor else size.replace("+", "")
    if alone:
        behind = f"that of {table.baseline}" if as_factor else "higher" if higher else "lower"
        return f"{text}: its {table.quantity} is {size} {behind}."
    if as_factor:
        most = "highest" if higher else "lowest"
        return f"{text}. {best.method} has the {most} {table.quantity}, {size} that of {table.baseline}."
    return f"{text}. {best.method} {'raises' if higher else 'lowers'} the {table.quantity} most, by {size}."


def _counted(table: ResultTable, rows: Sequence[ResultRow]) -> str:
    """Count the verdicts of many methods."""
    counts = Counter(row.word for row in rows)
    parts = [f"{counts[word]} {word}" for word in (*ORDER, NOT_COMPUTED) if counts[word]]
    if not parts:
        return ""
    n, _, word = parts[0].partition(" ")
    parts = [text.replace("fails", "fail") if text[:2] != "1 " else text for text in parts]
    if word == FAILS_MORE:
        parts[0] = f"{parts[0]} than {table.baseline}"
    else:
        parts[0] = f"{n} {'is' if n == '1' else 'are'} {_FORMS.get(word, word).format(table.baseline)}"
    return f"Of {len(rows)} methods, {joined(parts)}."


def _failures(table: ResultTable, rows: Sequence[ResultRow]) -> list[str]:
    """Say which methods fail more, and in how many runs, in ever fewer words."""
    base, found = table.row_of(table.baseline), [row for row in rows if row.word == FAILS_MORE]
    if base is not None and base.n_failed and not base.n:
        return [f"Every run{f' of {base.method}' if any(row.n for row in rows) else ''} failed."]
    if not found:
        return [""]
    of = f"{base.n_failed or 'none' if base else 'none'} of {table.baseline}"
    each = [
        f"{row.method} fails more: {row.n_failed} of its {row.n + row.n_failed} runs failed, {of}." for row in found
    ]
    verb = "fails" if len(found) == 1 else "fail"
    named = [f"{_few([row.method for row in found], n)} {verb} more than {table.baseline}." for n in (3, 1, 0)]
    return [*([" ".join(each)] if len(found) <= 2 else []), *named, ""]


def _few(names: Sequence[str], n: int) -> str:
    """Name up to n methods and count the others."""
    left = len(names) - n
    others = f"{left} {'other' if n else 'method'}{'s' * (left > 1)}"
    return joined([*names[:n], others] if left > 0 else names)


def _of_points(tables: Sequence[ResultTable], n_blank: int, room: int) -> str:
    """Answer for a sweep: where each method is better or worse than the baseline."""
    axis = _axis(tables)
    if axis is not None and axis.numbers is not None:
        tables = sorted(tables, key=lambda table: axis.place(table.trials.point[axis.path]))
    first, sweep = tables[0], sweep_of(tables)
    computed = [any(row.n + row.n_failed for row in table.rows) for table in tables]
    found = {row.method: [table.row_of(row.method) for table in tables] for row in first.compared}
    words = {name: [row.word if row else "" for row in rows] for name, rows in found.items()}
    if not any(computed):
        return "No run is finished."
    if not words:
        means = [first.mean_text(row) for first in tables for row in first.rows if row.n]
        ends = f" is {means[0]} at the first point, {means[-1]} at the last" if len(means) > 1 else " is in the table"
        return f"The mean {first.info.words} of {first.baseline}{ends}; it has no other method to compare with."
    heads = {BETTER: f"Better than {first.baseline} in {first.quantity}:", WORSE: "Worse:", FAILS_MORE: "Fails more:"}
    kept = [(head, groups) for word, head in heads.items() if (groups := _groups(words, word, sweep, computed))]
    if not kept or kept[0][0] != heads[BETTER]:
        kept = [(f"No method is better than {first.baseline} in {first.quantity} at any point", []), *kept]
    left = room - sum(len(start.split()) for start, _ in kept)
    parts = []
    for k, (start, groups) in enumerate(kept):
        # Those behind need a number of methods, a place, and that there are others.
        reserved = sum(4 + len(others[0].where.split()) for _, others in kept[k + 1 :])
        text = _fitting(groups, left - reserved)
        left -= len(text.split())
        parts.append(f"{start} {text}".strip())
    missing = computed.count(False) + n_blank
    parts[-1] += f", {missing} not computed" if missing and left > 2 else ""
    return " ".join(f"{part}." for part in parts)


def sweep_of(tables: Sequence[ResultTable]) -> Sweep:
    """Name the points of a sweep: by the value of the only path, or by all their values."""
    axis, trials = _axis(tables), [table.trials for table in tables]
    if axis is None:
        return Sweep([point.title for point in trials], ordered=False)
    return Sweep([point.point[axis.path] for point in trials], ordered=axis.numbers is not None)


def _axis(tables: Sequence[ResultTable]) -> SweepAxis | None:
    points = [table.trials.point for table in tables]
    paths = {path for point in points for path in point}
    return axis_of(points, paths.pop()) if len(paths) == 1 else None


class _Group(NamedTuple):
    """Methods that have a verdict at the same points."""

    names: list[str]
    where: str

    def text(self, n: int) -> str:
        """Name n of the methods."""
        return f"{_few(self.names, n)} {self.where}"


def _groups(words: Mapping[str, Sequence[str]], wanted: str, sweep: Sweep, computed: Sequence[bool]) -> list[_Group]:
    """Join the methods that have a verdict at the same points, those at most points first."""
    found = dict[tuple[int, str], list[str]]()
    complete, n = all(computed), sum(computed)
    for method, of_points in words.items():
        chosen = [word == wanted for word in of_points]
        if k := sum(chosen):
            every = f"at all {n} points" if complete and k == n else f"at {k} of {n}"
            where = ranges(sweep.points, chosen) if complete and sweep.ordered else every
            found.setdefault((k, where), []).append(method)
    groups = [_Group(found[key], key[1]) for key in sorted(found, key=lambda key: -key[0])]
    if groups and groups[0].where.endswith(f" of {n}"):
        groups[0] = groups[0]._replace(where=f"{groups[0].where} points")
    return groups


def _fitting(groups: Sequence[_Group], room: int) -> str:
    """Write as many groups as a number of words allows, at least a part of the first, and that there are others."""
    if not groups:
        return ""
    n = next((n for n in range(len(groups[0].names), 0, -1) if len(groups[0].text(n).split()) <= room - 2), 0)
    kept = [groups[0].text(n)]
    for group in groups[1:]:
        text = group.text(len(group.names))
        if sum(len(each.split()) for each in [*kept, text]) > room - 2 * (group is not groups[-1]):
            break
        kept.append(text)
    separator = "; " if any(" and " in text for text in kept) else ", "
    return separator.join([*kept, "and others"] if len(kept) < len(groups) else kept)


def ranges(points: Sequence[str], chosen: Sequence[bool]) -> str:
    """Say at which points something holds, such as ``at 0 and from 0.3``; of three ranges or more count the points."""
    parts = ([k for k, _ in part] for yes, part in groupby(enumerate(chosen), lambda each: each[1]) if yes)
    found, last = [(part[0], part[-1]) for part in parts], len(points) - 1
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
