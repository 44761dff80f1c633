"""The difference of two improvements as text: a sentence that can be quoted, and the table behind it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import pandas as pd

from rmpc_bench.analysis.comparison_text import about, margin_of
from rmpc_bench.analysis.improvement_difference import AverageDifference, ImprovementDifference
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.parameter_text import pair_text
from rmpc_bench.analysis.shown_numbers import Estimate, interval_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.verdict import Verdict
from rmpc_bench.report.comparison_table import AVERAGES
from rmpc_bench.report.results_text import Setting
from rmpc_bench.types import MetricInfo

VERDICTS = {
    str(Verdict.FAILS_MORE): "{method} alone fails more in A",
    str(Verdict.DEPENDS_ON_AVERAGE): "which improvement is larger depends on the average",
    str(Verdict.BETTER): "the improvement is larger in A",
    str(Verdict.WORSE): "the improvement is smaller in A",
    str(Verdict.BETTER_SIZE_UNCERTAIN): "the improvement is larger in A, size uncertain",
    str(Verdict.WORSE_SIZE_UNCERTAIN): "the improvement is smaller in A, size uncertain",
    str(Verdict.EQUIVALENT): "the improvements are equivalent (within {margin})",
}
"""On the improvement in A against that in B."""
SHORT_AVERAGES = {"geometric": "geometric means of the paired ratios", "mean": "ratios of the means"}
FEW_SETTINGS = 2  # differing settings that the sentence names itself


@dataclass(frozen=True, eq=False)
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
        return pd.DataFrame(rows)

    def __str__(self) -> str:
        parts = [[f"{letter}  {name}" for letter, name in zip("AB", self.names, strict=True)]]
        parts += [["settings that differ", *(f"  {each}" for each in self.settings)]] if self.settings else []
        for row, sentence in zip(self.rows, self.sentences, strict=True):
            parts.append([sentence, *(f"  {line}" for line in self._details(row))])
        parts += [[f"The two experiments define {self.info.name} differently."]] if self.redefined else []
        return "\n\n".join("\n".join(lines) for lines in [*parts, [_explanation(self.rows[0])]])

    def _sentence(self, row: ImprovementDifference, tables: tuple[Trials, Trials]) -> str:
        head = f"{row.point}: " if row.point else ""
        name = name_of_distance(self.info)
        first, second = (f"with {text}" for text in self._experiments())
        signed = bool(row.averages) and row.averages[0].average == "difference"
        word = f": {_verdict(row, margin_of(tables[0], self.info, signed=signed))}" if row.verdict else ""
        if not row.averages:
            in_a, in_b, gap = _shares(row)
            text = f"{row.method} is better than {row.baseline} in {name} in {in_a} of the runs {first} and in {in_b} "
            text += f"{second} (ties count half): the difference is {gap}"
            return f"{head}{text} ({_basis(row, tables)}){word}."
        each, verbs = row.averages[0], [_verb(row.averages[0].in_a), _verb(row.averages[0].in_b)]
        in_a, in_b = (_changed(one, each, self.info) for one in (each.in_a, each.in_b))
        gap = _estimate(each.difference, 1, self.info.unit if each.average == "difference" else "percentage points")
        text = f"{row.method} {verbs[0]} {name} against {row.baseline} by {in_a} {first} and "
        text += f"{verbs[1]} it " * (verbs[0] != verbs[1])
        average = SHORT_AVERAGES.get(each.average, "mean differences")
        text += f"by {in_b} {second}: the difference of the improvements is {gap}"
        if each.average != "difference":
            text += f", the ratio of the ratios {interval_text(each.ratio)}"
        return f"{head}{text} ({average}, {_basis(row, tables)}){word}."

    def _experiments(self) -> list[str]:
        """Name the two experiments by what differs, or by their directories."""
        if not 0 < len(self.settings) <= FEW_SETTINGS:
            return list(self.names)
        return [", ".join(f"{each.path} = {getattr(each, side)}" for each in self.settings) for side in ("a", "b")]

    def _details(self, row: ImprovementDifference) -> Iterator[str]:
        """Write the other average, superiority and failed runs."""
        for each in row.averages[1:]:
            in_a, in_b = (_changed(one, each, self.info, sign=True) for one in (each.in_a, each.in_b))
            gap = _estimate(each.difference, 1, "percentage points")
            yield f"{AVERAGES[each.average]}: {in_a} in A, {in_b} in B; difference {gap}"
        in_a, in_b, gap = _shares(row)
        yield f"better than {row.baseline} (ties count half): {in_a} of the runs in A, {in_b} in B; difference {gap}"
        if row.failed_a or row.failed_b:
            failed = f"{row.failed_a} in A, {row.failed_b} in B"
            alone = f"{row.baseline} finished {row.alone_a} and {row.alone_b} of them"
            yield f"failed runs of {row.method}: {failed} ({alone}); averages rest on runs that both finished"


def _verdict(row: ImprovementDifference, margin: str) -> str:
    """Write the verdict on the improvement in A against that in B."""
    if row.verdict == Verdict.INCONCLUSIVE:
        numbers = ((row.runs_for_direction, "a direction"), (row.runs_for_equivalence, "equivalence"))
        known = ", ".join(f"{about(n)} for {word}" for n, word in numbers if not math.isnan(n))
        gap = row.averages[0].difference if row.averages else Estimate(math.nan)
        if row.alone_b > row.alone_a and gap.high < 0:
            return f"inconclusive, as {row.method} alone fails more in B"
        return f"inconclusive (runs needed: {known})" if known else "inconclusive"
    return VERDICTS[row.verdict].format(method=row.method, margin=margin)


def _shares(row: ImprovementDifference) -> tuple[str, str, str]:
    """Write the shares of runs in which the method is better, in A and B, and their difference."""
    in_a, in_b = (f"{100 * share:.3g} %" for share in (row.superiority_a, row.superiority_b))
    return in_a, in_b, _estimate(row.superiority, 100, "percentage points")


def _verb(change: Estimate) -> str:
    """Return the direction that the interval of a change supports."""
    if change.low <= 0 <= change.high or not change.value:
        return "changes"
    return "lowers" if change.value < 0 else "raises"


def _changed(change: Estimate, each: AverageDifference, info: MetricInfo, *, sign: bool = False) -> str:
    """Write a change; a reduction as a positive number unless signs are shown."""
    unit = info.unit if each.average == "difference" else "%"
    if sign or _verb(change) != "lowers":
        return interval_text(change, unit, sign=sign or _verb(change) == "changes")
    return interval_text(Estimate(-change.value, -change.high, -change.low), unit)


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
    if row.paired:
        return f"{row.n_a} paired runs, {level}"
    return f"unpaired: {row.n_a} and {row.n_b} runs with different seeds, {level}"


def _explanation(row: ImprovementDifference) -> str:
    if row.paired:
        pairing = "Run i of A is paired with run i of B: equal seeds draw the same quantile of every random quantity."
    else:
        pairing = "The seeds differ, so the runs of A and B are not paired, and the intervals are Welch's."
    larger = f"the improvement of {row.method} on {row.baseline} is larger in A"
    return f"{pairing} Differences are A minus B; where they are above 0, {larger}."
