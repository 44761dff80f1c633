"""The results of two directories as text: verdicts beside each other, values that differ, and two improvements."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

from rmpc_bench.analysis.columns import columns_of, data_frame
from rmpc_bench.analysis.comparison_text import about, margin_of
from rmpc_bench.analysis.improvement_difference import AverageDifference, ImprovementDifference
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.result_rows import ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, difference_texts, interval_text, plain
from rmpc_bench.analysis.trial_differences import Largest, MetricDifference, TrialDifferences
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.tuning import pair_text
from rmpc_bench.analysis.verdict import Verdict
from rmpc_bench.figures.labels import joined
from rmpc_bench.report.point_tables import AVERAGES
from rmpc_bench.report.screen_tables import NAME, fitting
from rmpc_bench.report.summary import verb_and_size
from rmpc_bench.types import MetricInfo
from rmpc_bench.types.texts import cut, folded, in_columns, without_formulas, wrapped

if TYPE_CHECKING:
    import pandas as pd

MOST_SETTINGS = 5  # settings that differ and are shown with their values
MOST_ROWS = 15  # pairs of verdicts that are shown
MOST_LINES = 20  # lines of one kind that are shown; the rest is counted


class Setting(NamedTuple):
    """A setting that differs, or a claim whose finding does, as text."""

    path: str
    a: str
    b: str

    def __str__(self) -> str:
        return f"{self.path}: A {self.a}, B {self.b}"


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


@dataclass(frozen=True, eq=False, repr=False)
class ResultsComparison:
    """How the results of two directories differ."""

    names: tuple[str, str]  # of the two directories
    sizes: tuple[str, str]  # name, numbers of runs, methods and metrics, and seed of either
    settings: tuple[Setting, ...]  # what differs in the configurations
    trials: TrialDifferences
    findings: tuple[Setting, ...]  # claims of both whose computed findings differ
    beside: tuple[Beside, ...] = ()  # methods of both, where metric and baseline are the same

    @property
    def equal(self) -> bool:
        """Whether trials and findings are equal; settings may differ where they change no number."""
        return self.trials.equal and not self.findings

    def to_frame(self) -> pd.DataFrame:
        """Return the compared metrics: point, method, metric, counts and the largest differences with their runs."""
        rows = []
        for each in self.trials.values:
            found = {name: getattr(each, name) for name in ("point", "method", "metric", "n", "n_differ")}
            for name, largest in (("relative", each.relative), ("absolute", each.absolute)):
                found |= {name: largest.size, f"{name}_run": largest.run}
            rows.append(found | {"n_apart": each.n_apart})
        return data_frame(columns_of(rows, [*rows[0]] if rows else []))

    def __repr__(self) -> str:
        return f"<ResultsComparison of {' and '.join(self.names)}: equal={self.equal}>"

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
            lines += ["", cut(f"{without_formulas(what)} {first.baseline}", width)]
            ways = ((None, True), (NAME, True), (None, False), (NAME, False))
            lines += fitting(partial(_beside_lines, shown[:MOST_ROWS]), ways, width)
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
        resolved = [each.name for each in self.beside if each.is_resolved]
        other = [f"{each.name} is {' in A and '.join(each.words)} in B" for each in self.beside if len(each.words) > 1]
        count = f"{len(other)} of {len(self.beside)} verdicts differ: " * (len(self.beside) > 1)
        said = f"{count}{other[0]}" if other else "The verdicts are the same"
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
            differ = f" values of the runs differ{', as with other seeds' * ('seed' in known)}: --values lists them"
            yield differ if self.trials.differing else " --values lists all"

    def _lines(self) -> Iterator[str]:
        for letter, name, size in zip("AB", self.names, self.sizes, strict=True):
            yield f"{letter}  {name}   {size}"
        sections = {
            "settings that differ": [*map(str, self.settings)],
            "only in one": _alone(self.trials),
            "statuses that differ": [
                f"{_where(each.point, each.method)} run {each.run}: A {each.a}, B {each.b}"
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
    """Write ascending numbers, consecutive ones as a range, such as ``0-2, 7, 9-10``."""
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


VERDICTS = {
    str(Verdict.FAILS_MORE): "{method} alone fails more in A",
    str(Verdict.DEPENDS_ON_AVERAGE): "which improvement is larger depends on the average",
    str(Verdict.BETTER): "the improvement is larger in A",
    str(Verdict.WORSE): "the improvement is smaller in A",
    str(Verdict.BETTER_SIZE_UNCERTAIN): "the improvement is larger in A, size uncertain",
    str(Verdict.WORSE_SIZE_UNCERTAIN): "the improvement is smaller in A, size uncertain",
    str(Verdict.EQUIVALENT): "the improvements are equivalent (within {margin})",
}  # on the improvement in A against that in B
SHORT_AVERAGES = {"geometric": "geometric means of the paired ratios", "mean": "ratios of the means"}
FEW_SETTINGS = 2  # differing settings that the sentence names itself


@dataclass(frozen=True, eq=False, repr=False)
class ImprovementComparison:
    """How much the improvement of a method differs between two experiments."""

    rows: tuple[ImprovementDifference, ...]  # one per common point of the sweeps
    info: MetricInfo
    names: tuple[str, str]  # of the two experiments
    settings: tuple[Setting, ...]  # what differs in the systems, the method and its baseline
    tables: tuple[tuple[Trials, Trials], ...]  # of A and B at these points
    redefined: bool = False  # whether the two define the metric differently

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence per point that can be quoted as it stands."""
        return tuple(self._sentence(row, pair) for row, pair in zip(self.rows, self.tables, strict=True))

    def to_frame(self) -> pd.DataFrame:
        """Return one row per point and average; see `ImprovementDifference` and `AverageDifference`."""
        names = ["point", "method", "baseline", "metric", "paired", "n_a", "n_b", "failed_a", "failed_b"]
        names += ["superiority_a", "superiority_b", "verdict", "level"]
        rows = []
        for row in self.rows:
            for each in row.averages or (AverageDifference("", *[Estimate(math.nan)] * 3),):
                found = {name: getattr(row, name) for name in names} | {"average": each.average}
                for name in ("in_a", "in_b", "difference", "ratio"):
                    found |= zip((name, f"{name}_low", f"{name}_high"), getattr(each, name), strict=True)
                rows.append(found)
        return data_frame(columns_of(rows, [*rows[0]]))

    def __repr__(self) -> str:
        return f"<ImprovementComparison of {' and '.join(self.names)}: {len(self.rows)} points>"

    def __str__(self) -> str:
        parts = [[f"{letter}  {name}" for letter, name in zip("AB", self.names, strict=True)]]
        parts += [["settings that differ", *(f"  {each}" for each in self.settings)]] if self.settings else []
        for row, sentence in zip(self.rows, self.sentences, strict=True):
            parts.append([sentence, *(f"  {line}" for line in self._details(row))])
        parts += [[f"The two experiments define {self.info.name} differently."]] if self.redefined else []
        first, pairing = self.rows[0], "Run i of A is paired with run i of B: equal seeds draw the same quantile of "
        pairing += "every random quantity."
        if not first.paired:
            a, b = self.tables[0]
            why = "The seeds differ, so the runs" if a.seed != b.seed else "The runs"
            pairing = f"{why} of A and B are not paired, and the intervals are Welch's."
        larger = f"the improvement of {first.method} on {first.baseline} is larger in A"
        parts.append([f"{pairing} Differences are A minus B; where they are above 0, {larger}."])
        return "\n\n".join("\n".join(lines) for lines in parts)

    def _sentence(self, row: ImprovementDifference, tables: tuple[Trials, Trials]) -> str:
        head, name = f"{row.point}: " if row.point else "", name_of_distance(self.info)
        first, second = (f"with {name}" for name in self.names)
        if 0 < len(self.settings) <= FEW_SETTINGS:
            first = "with " + ", ".join(f"{each.path} = {each.a}" for each in self.settings)
            second = "with " + ", ".join(f"{each.path} = {each.b}" for each in self.settings)
        signed = bool(row.averages) and row.averages[0].average == "difference"
        word = f": {_verdict(row, margin_of(tables[0], self.info, signed=signed))}" if row.verdict else ""
        if not row.averages:
            in_a, in_b, gap = _shares(row)
            text = f"{row.method} is better than {row.baseline} in {name} in {in_a} of the runs {first} and in {in_b} "
            text += f"{second} (ties count half): the difference is {gap}"
            return f"{head}{text} ({_basis(row, tables)}){word}."
        each = row.averages[0]
        (verb, in_a), (other, in_b) = (
            verb_and_size(one, self.info.unit if signed else "%") for one in (each.in_a, each.in_b)
        )
        gap = _estimate(each.difference, 1, self.info.unit if signed else "percentage points")
        text = f"{row.method} {verb} {name} against {row.baseline} by {in_a} {first} and "
        text += f"{other} it " * (verb != other)
        average = SHORT_AVERAGES.get(each.average, "mean differences")
        if any(table.unpaired for table in tables):
            average = average.replace(" of the paired ratios", "")
        text += f"by {in_b} {second}: the difference of the improvements is {gap}"
        text += "" if signed else f", the ratio of the ratios {interval_text(each.ratio)}"
        return f"{head}{text} ({average}, {_basis(row, tables)}){word}."

    def _details(self, row: ImprovementDifference) -> Iterator[str]:
        """Write the other average, superiority and failed runs."""
        for each in row.averages[1:]:
            in_a, in_b = (interval_text(one, "%", sign=True) for one in (each.in_a, each.in_b))
            gap = _estimate(each.difference, 1, "percentage points")
            yield f"{AVERAGES[each.average]}: {in_a} in A, {in_b} in B; difference {gap}"
        failed = f"failed runs of {row.method}: {row.failed_a} in A, {row.failed_b} in B"
        if math.isnan(row.superiority_a + row.superiority_b):
            yield from [f"{failed}; averages rest on finished runs"] * bool(row.failed_a + row.failed_b)
            return
        in_a, in_b, gap = _shares(row)
        yield f"better than {row.baseline} (ties count half): {in_a} of the runs in A, {in_b} in B; difference {gap}"
        if row.failed_a or row.failed_b:
            alone = f"{row.baseline} finished {row.alone_a} and {row.alone_b} of them"
            yield f"{failed} ({alone}); averages rest on runs that both finished"


def _verdict(row: ImprovementDifference, margin: str) -> str:
    """Write the verdict on the improvement in A against that in B."""
    if row.verdict != Verdict.INCONCLUSIVE:
        return VERDICTS[row.verdict].format(method=row.method, margin=margin)
    if row.alone_b > row.alone_a and row.averages and row.averages[0].difference.high < 0:
        return f"inconclusive, as {row.method} alone fails more in B"
    numbers = ((row.runs_for_direction, "a direction"), (row.runs_for_equivalence, "equivalence"))
    known = ", ".join(f"{about(n)} for {word}" for n, word in numbers if not math.isnan(n))
    return f"inconclusive (runs needed: {known})" if known else "inconclusive"


def _shares(row: ImprovementDifference) -> tuple[str, str, str]:
    """Write the shares of runs in which the method is better, in A and B, and their difference."""
    in_a, in_b = (f"{100 * share:.3g} %" for share in (row.superiority_a, row.superiority_b))
    return in_a, in_b, _estimate(row.superiority, 100, "percentage points")


def _estimate(each: Estimate, factor: float, unit: str) -> str:
    text = interval_text(Estimate(*(factor * end for end in each)), unit, sign=True)
    return f"{text}, without an interval" if math.isnan(each.low) and not math.isnan(each.value) else text


def _basis(row: ImprovementDifference, tables: tuple[Trials, Trials]) -> str:
    """Say what the numbers rest on: runs, pairing, level, and where the parameters of both methods come from."""
    table = tables[0]
    simultaneous = "simultaneous " if row.level > table.confidence else ""
    level = f"{simultaneous}{100 * table.confidence:g} % intervals"
    origins = [pair_text(each, row.method, row.baseline) for each in tables]
    origin = origins[0] if origins[0] == origins[1] else f"in A {origins[0] or '-'}; in B {origins[1] or '-'}"
    level += f"; {origin}" if origin else ""
    why = " with different seeds" * (table.seed != tables[1].seed)
    pairs = f"{row.n_a} paired runs" if row.paired else f"unpaired: {row.n_a} and {row.n_b} runs{why}"
    return f"{pairs}, {level}"
