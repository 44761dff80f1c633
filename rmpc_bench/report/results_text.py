"""The comparison of the results of two directories: verdicts beside each other, and every value that differs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import NamedTuple

import pandas as pd

from rmpc_bench.analysis.improvement_difference import ImprovementDifference
from rmpc_bench.analysis.result_rows import ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, difference_texts, plain
from rmpc_bench.analysis.trial_differences import Largest, MetricDifference, TrialDifferences
from rmpc_bench.figures.captions import joined
from rmpc_bench.report.screen_tables import NAME, fitting
from rmpc_bench.types.texts import cut, folded, in_columns, without_formulas, wrapped

MOST_SETTINGS = 5  # settings that differ and are shown with their values
MOST_ROWS = 15  # pairs of verdicts that are shown
MOST_LINES = 20  # lines of one kind that are shown; the rest is counted


class Setting(NamedTuple):
    """A setting that differs, as text."""

    path: str
    a: str
    b: str

    def __str__(self) -> str:
        return f"{self.path}: A {self.a}, B {self.b}"


class FindingDifference(NamedTuple):
    """A claim with two findings."""

    claim: str
    a: str
    b: str

    def __str__(self) -> str:
        return f"{self.claim}: A {self.a}, B {self.b}"


class Beside(NamedTuple):
    """A method at a point in both experiments, with the difference of its changes."""

    tables: tuple[ResultTable, ResultTable]
    rows: tuple[ResultRow, ResultRow]
    difference: ImprovementDifference

    @property
    def gap(self) -> Estimate:
        """Change in B minus change in A, in percentage points, or in the unit of a signed metric."""
        shares, found = self.tables[0].form == "share", self.difference
        if not shares and not found.averages:
            return Estimate()
        value, low, high = (100 * each for each in found.superiority) if shares else found.averages[0].difference
        # It is that of the improvements, A minus B.
        turned = shares or self.tables[0].info.direction == "higher"
        return Estimate(-value, -high, -low) if turned else Estimate(value, low, high)

    @property
    def is_resolved(self) -> bool:
        """Whether the interval of the difference excludes 0."""
        return self.gap.low * self.gap.high > 0

    @property
    def words(self) -> list[str]:
        """The verdict in A and B, once where it is the same."""
        return [*dict.fromkeys(row.word for row in self.rows)]

    @property
    def name(self) -> str:
        """The method and the point."""
        return " ".join(filter(None, [self.rows[0].method, self.difference.point]))


@dataclass(frozen=True, eq=False)
class ResultsComparison:
    """How the results of two directories differ."""

    names: tuple[str, str]  # of the two directories
    sizes: tuple[str, str]  # name, numbers of runs, methods and metrics, and seed of either
    settings: tuple[Setting, ...]  # what differs in the configurations
    trials: TrialDifferences
    findings: tuple[FindingDifference, ...]  # claims of both whose computed findings differ
    beside: tuple[Beside, ...] = ()  # methods of both, where metric and baseline are the same

    @property
    def equal(self) -> bool:
        """Whether trials and findings are equal; settings may differ where they change no number."""
        return self.trials.equal and not self.findings

    def to_frame(self) -> pd.DataFrame:
        """Return the compared metrics: point, method, metric, counts and the largest differences with their runs."""
        rows = [
            {
                **{"point": each.point, "method": each.method, "metric": each.metric},
                **{"n": each.n, "n_differ": each.n_differ},
                **{"relative": each.relative.size, "relative_run": each.relative.run},
                **{"absolute": each.absolute.size, "absolute_run": each.absolute.run, "n_apart": each.n_apart},
            }
            for each in self.trials.values
        ]
        return pd.DataFrame(rows)

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def text(self, width: int, *, values: bool = False) -> str:
        """Lay out the verdicts beside each other and the settings that differ; with `values` all that differs."""
        if values:
            return "\n".join(folded([*self._lines()], width))
        pairs = zip("AB", self.names, self.sizes, strict=True)
        lines = [*in_columns([(f"{letter}  {name}", size) for letter, name, size in pairs], indent=""), ""]
        lines = folded(lines, width) + wrapped(plain(self._answer()), width)
        shown = [each for each in self.beside if len(self.beside) <= MOST_ROWS or each.is_resolved]
        if shown and not self.equal:
            first = shown[0].tables[0]
            what = "better than" if first.form == "share" else f"change of the {first.quantity} against"
            lines += ["", cut(without_formulas(f"{what} {first.baseline}"), width)]
            ways = ((None, True), (NAME, True), (None, False), (NAME, False))
            lines += fitting((partial(_beside_lines, shown[:MOST_ROWS], *way) for way in ways), width)
            lines += [f" and {len(shown) - MOST_ROWS} more"] if len(shown) > MOST_ROWS else []
        return "\n".join([*lines, "", *folded([*self._differing()], width)])

    def _answer(self) -> str:
        """Say whether verdicts differ, and which differences of changes are resolved."""
        conclusion = f"{self._conclusion()[:1].upper()}{self._conclusion()[1:]}."
        if self.equal:
            return conclusion
        n = len(self.findings)
        text = f" {n} finding{'s' * (n > 1)} differ{'s' * (n == 1)}: --values." if n else ""
        if not self.beside:
            return f"{conclusion}{text}"
        other = [each for each in self.beside if len(each.words) > 1]
        resolved = [each.name for each in self.beside if each.is_resolved]
        said = "The verdicts are the same"
        if other:
            said = f"{other[0].name} is {other[0].words[0]} in A and {other[0].words[1]} in B"
            said = f"{len(other)} of {len(self.beside)} verdicts differ: {said}" if len(self.beside) > 1 else said
        names = joined(resolved if len(resolved) <= 3 else [", ".join(resolved[:3]), f"{len(resolved) - 3} more"])
        gap = f"the difference between A and B is resolved for {names}"
        return f"{said}; {gap if resolved else 'no difference between A and B is resolved'}.{text}"

    def _differing(self) -> Iterator[str]:
        """Say which settings and values differ."""
        given = [each for each in self.settings if each.path != "experiment hash"]
        # Options are named by what they change, where that is known.
        settings = [each for each in given if each.path != "options"] or given
        known = [each.path for each in settings if each.path in ("seed", "runs")]
        rest = [each for each in settings if each.path not in known]
        if settings:
            yield f" settings that differ: {', '.join(known)}".rstrip(" ,")
            yield from (f"   {each}" for each in rest[:MOST_SETTINGS])
            yield from [f"   and {len(rest) - MOST_SETTINGS} more: --values"] * (len(rest) > MOST_SETTINGS)
        yield from (f" only in {line}" for line in _alone(self.trials)[:MOST_SETTINGS])
        if not self.equal:
            seeds = ", as with other seeds" if any(each.path == "seed" for each in settings) else ""
            differ = f" values of the runs differ{seeds}: --values lists them"
            yield differ if self.trials.differing else " --values lists all"

    def _lines(self) -> Iterator[str]:
        for letter, name, size in zip("AB", self.names, self.sizes, strict=True):
            yield f"{letter}  {name}   {size}"
        sections = {
            "settings that differ": [*map(str, self.settings)],
            "only in one": _alone(self.trials),
            "statuses that differ": [
                str(Setting(f"{_where(each.point, each.method)} run {each.run}", each.a, each.b))
                for each in self.trials.statuses
            ],
            "metrics that differ": [*map(_metric, self.trials.differing)],
            "findings that differ": [*map(str, self.findings)],
        }
        for title, lines in sections.items():
            if lines:
                yield from ("", title, *(f"  {line}" for line in lines[:MOST_LINES]))
                yield from [f"  and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
        yield ""
        yield self._conclusion()

    def _conclusion(self) -> str:
        trials = self.trials
        basis = f"{trials.n_trials} trials in both, {trials.n_values} values of metrics"
        rule = f"up to a relative difference of {trials.tolerance:g}" if trials.tolerance else "exact"
        if self.equal:
            return f"equal ({rule}): {basis}, all statuses"
        if not trials.n_trials:
            return "different: no trial is in both"
        n_values = sum(each.n_differ for each in trials.values)
        counts = [(n_values, "value"), (len(trials.statuses), "status"), (len(self.findings), "finding")]
        texts = [f"{n} {noun}{'' if n == 1 else 'es' if noun == 'status' else 's'} differ" for n, noun in counts if n]
        texts += ["one has more than the other"] if _alone(trials) else []
        return f"different ({rule}): {', '.join(texts)}; compared: {basis}"


def _beside_lines(shown: Sequence[Beside], size: int | None, with_intervals: bool) -> list[str]:
    """Lay out the changes in A and B, their difference and the verdicts."""
    unit = shown[0].tables[0].info.unit if shown[0].tables[0].form == "difference" else "points"
    lines = [["", "A", "B", f"B - A [{unit}]" if unit else "B - A", "A, B"]]
    for each in shown:
        texts = [
            plain(table.change_text(row) if with_intervals else table.change_texts(row)[0])
            for table, row in zip(each.tables, each.rows, strict=True)
        ]
        gap = plain(" ".join(difference_texts(each.gap)))
        lines.append([cut(each.name, size or 80), *texts, gap, ", ".join(each.words)])
    return in_columns(lines, (1, 2, 3), indent="")


def _alone(trials: TrialDifferences) -> list[str]:
    """Say what only one of the two has."""
    lines = []
    for noun, pair in (("method", trials.methods), ("metric", trials.metrics), ("point", trials.points)):
        for letter, names in zip("AB", pair, strict=True):
            lines += [f"{letter}: {noun} {name}" for name in names]
    groups: dict[tuple[str, str], list[str]] = {}
    for each in trials.runs:
        for letter, runs in (("A", each.runs_a), ("B", each.runs_b)):
            if runs:
                groups.setdefault((letter, _ranges(runs)), []).append(_where(each.point, each.method))
    return lines + [f"{letter}: runs {runs} of {', '.join(where)}" for (letter, runs), where in groups.items()]


def _ranges(runs: Sequence[int]) -> str:
    """Write ascending numbers, consecutive ones as a range.

    Examples
    --------
    >>> _ranges([0, 1, 2, 7, 9, 10])
    '0-2, 7, 9-10'
    """
    # Consecutive numbers have the same distance from their place.
    parts = [[run for _, run in part] for _, part in groupby(enumerate(runs), lambda each: each[1] - each[0])]
    texts = [str(part[0]) if len(part) == 1 else f"{part[0]}-{part[-1]}" for part in parts]
    return ", ".join(texts[:MOST_LINES]) + (f" and {len(texts) - MOST_LINES} more" if len(texts) > MOST_LINES else "")


def _metric(each: MetricDifference) -> str:
    texts = [f"{_where(each.point, each.method)} {each.metric}: {each.n_differ} of {each.n} runs"]
    if each.n_apart:
        pair = f"A {each.apart.a!r}, B {each.apart.b!r}"
        texts.append(f"one of the values is inf or missing in {each.n_apart}, first in run {each.apart.run} ({pair})")
    if each.relative.size:
        together = "" if each.absolute.run != each.relative.run else f", absolute {each.absolute.size:.3g}"
        texts.append(f"largest relative difference {_largest(each.relative)}{together}")
        texts += [] if together else [f"largest absolute difference {_largest(each.absolute)}"]
    return "; ".join(texts)


def _largest(each: Largest) -> str:
    return f"{each.size:.3g} in run {each.run} (A {each.a!r}, B {each.b!r})"


def _where(point: str, method: str) -> str:
    return f"{point}: {method}" if point else method
