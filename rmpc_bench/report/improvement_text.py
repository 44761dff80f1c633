"""The difference of two improvements as text: a sentence that can be quoted, and the table behind it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import pandas as pd

from rmpc_bench.analysis.comparison_text import about, margin_of
from rmpc_bench.analysis.improvement_difference import AverageDifference, Estimate, ImprovementDifference
from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.parameter_text import pair_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.verdict import Verdict
from rmpc_bench.report.comparison_table import AVERAGES
from rmpc_bench.report.results_text import Setting
from rmpc_bench.types import MetricInfo

FEW_SETTINGS = 2
"""Differing settings that the sentence names itself."""


@dataclass(frozen=True, eq=False)
class ImprovementComparison:
    """How much the improvement of a method differs between two experiments.

    Parameters
    ----------
    rows : one record per common point of the sweeps
    info : the metric
    names : the two experiments
    settings : what differs in the systems, the method and its baseline
    tables : the tables of A and B at these points
    redefined : whether the two define the metric differently
    """

    rows: tuple[ImprovementDifference, ...]
    info: MetricInfo
    names: tuple[str, str]
    settings: tuple[Setting, ...]
    tables: tuple[tuple[Trials, Trials], ...]
    redefined: bool = False

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence per point that can be quoted as it stands."""
        return tuple(self._sentence(row, pair) for row, pair in zip(self.rows, self.tables, strict=True))

    def to_frame(self) -> pd.DataFrame:
        """Return one row per point and average; see `ImprovementDifference` and `AverageDifference`."""
        rows = []
        for row in self.rows:
            for each in row.averages or (AverageDifference("", *[Estimate(math.nan)] * 3),):
                found: dict[str, object] = {
                    name: getattr(row, name)
                    for name in (
                        *("point", "method", "baseline", "metric", "paired", "n_a", "n_b", "failed_a", "failed_b"),
                        *("superiority_a", "superiority_b", "verdict", "level"),
                    )
                }
                found["average"] = each.average
                for name in ("in_a", "in_b", "difference", "ratio"):
                    value = getattr(each, name)
                    found |= {name: value.value, f"{name}_low": value.low, f"{name}_high": value.high}
                rows.append(found)
        return pd.DataFrame(rows)

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        for letter, name in zip("AB", self.names, strict=True):
            yield f"{letter}  {name}"
        if self.settings:
            yield from (
                "",
                "settings that differ",
                *(f"  {each.path}: A {each.a}, B {each.b}" for each in self.settings),
            )
        for row, pair in zip(self.rows, self.tables, strict=True):
            yield ""
            yield self._sentence(row, pair)
            yield from (f"  {line}" for line in self._details(row))
        if self.redefined:
            yield ""
            yield f"The two experiments define {self.info.name} differently."
        yield ""
        yield _explanation(self.rows[0])

    def _sentence(self, row: ImprovementDifference, tables: tuple[Trials, Trials]) -> str:
        head = f"{row.point}: " if row.point else ""
        name = name_of_distance(self.info)
        first, second = (f"with {text}" for text in self._experiments())
        word = self._word(row, tables[0])
        if not row.averages:
            shares = [f"{100 * share:.3g} %" for share in (row.superiority_a, row.superiority_b)]
            gap = _estimate(row.superiority, 100, "percentage points")
            text = f"{row.method} is better than {row.baseline} in {name} in {shares[0]} of the runs {first} and in "
            text += f"{shares[1]} {second} (ties count half): the difference is {gap}"
            return f"{head}{text} ({_basis(row, tables)}){word}."
        each = row.averages[0]
        unit = self.info.unit if each.average == "difference" else "percentage points"
        gap, texts = (
            _estimate(each.difference, 1, unit),
            [_changed(one, each, self.info) for one in (each.in_a, each.in_b)],
        )
        text = f"{row.method} {_verb(each.in_a)} {name} against {row.baseline} by {texts[0]} {first} and "
        verb = "" if _verb(each.in_a) == _verb(each.in_b) else f"{_verb(each.in_b)} it "
        text += f"{verb}by {texts[1]} {second}: the difference of the improvements is {gap}"
        if each.average != "difference":
            text += f", the ratio of the ratios {interval_text(*each.ratio, sign=False)}"
        return f"{head}{text} ({_average(each)}, {_basis(row, tables)}){word}."

    def _experiments(self) -> list[str]:
        """Name the two experiments by what differs, or by their directories."""
        if not 0 < len(self.settings) <= FEW_SETTINGS:
            return list(self.names)
        return [", ".join(f"{each.path} = {getattr(each, side)}" for each in self.settings) for side in ("a", "b")]

    def _details(self, row: ImprovementDifference) -> Iterator[str]:
        """Write the other average, superiority and failed runs."""
        for each in row.averages[1:]:
            texts = [_changed(one, each, self.info, sign=True) for one in (each.in_a, each.in_b)]
            gap = _estimate(each.difference, 1, "percentage points")
            yield f"{AVERAGES[each.average]}: {texts[0]} in A, {texts[1]} in B; difference {gap}"
        shares = [f"{100 * share:.3g} %" for share in (row.superiority_a, row.superiority_b)]
        gap = _estimate(row.superiority, 100, "percentage points")
        of_runs = f"{shares[0]} of the runs in A, {shares[1]} in B; difference {gap}"
        yield f"better than {row.baseline} (ties count half): {of_runs}"
        if row.failed_a or row.failed_b:
            failed = f"{row.failed_a} in A, {row.failed_b} in B"
            alone = f"{row.baseline} finished {row.alone_a} and {row.alone_b} of them"
            yield f"failed runs of {row.method}: {failed} ({alone}); averages rest on runs that both finished"

    def _word(self, row: ImprovementDifference, table: Trials) -> str:
        if not row.verdict:
            return ""
        signed = bool(row.averages) and row.averages[0].average == "difference"
        return ": " + _verdict(row, margin_of(table, self.info, signed=signed))


def _verdict(row: ImprovementDifference, margin: str) -> str:
    """Write the verdict on the improvement in A against that in B."""
    if row.verdict == Verdict.INCONCLUSIVE:
        numbers = ((row.runs_for_direction, "a direction"), (row.runs_for_equivalence, "equivalence"))
        known = ", ".join(f"{about(n)} for {word}" for n, word in numbers if not math.isnan(n))
        gap = row.averages[0].difference if row.averages else Estimate(math.nan)
        if row.alone_b > row.alone_a and gap.high < 0:
            return f"inconclusive, as {row.method} alone fails more in B"
        return f"inconclusive (runs needed: {known})" if known else "inconclusive"
    return {
        str(Verdict.FAILS_MORE): f"{row.method} alone fails more in A",
        str(Verdict.DEPENDS_ON_AVERAGE): "which improvement is larger depends on the average",
        str(Verdict.BETTER): "the improvement is larger in A",
        str(Verdict.WORSE): "the improvement is smaller in A",
        str(Verdict.BETTER_SIZE_UNCERTAIN): "the improvement is larger in A, size uncertain",
        str(Verdict.WORSE_SIZE_UNCERTAIN): "the improvement is smaller in A, size uncertain",
        str(Verdict.EQUIVALENT): f"the improvements are equivalent (within {margin})",
    }[row.verdict]


def _verb(change: Estimate) -> str:
    """Return the direction that the interval of a change supports."""
    if change.low <= 0 <= change.high or not change.value:
        return "changes"
    return "lowers" if change.value < 0 else "raises"


def _changed(change: Estimate, each: AverageDifference, info: MetricInfo, *, sign: bool = False) -> str:
    """Write a change; a reduction as a positive number unless signs are shown."""
    unit = info.unit if each.average == "difference" else "%"
    if sign or _verb(change) != "lowers":
        return interval_text(*change, unit=unit, sign=sign or _verb(change) == "changes")
    return interval_text(-change.value, -change.high, -change.low, unit=unit, sign=False)


def _estimate(each: Estimate, factor: float, unit: str) -> str:
    text = interval_text(*(factor * end for end in each), unit=unit)
    return f"{text}, without an interval" if math.isnan(each.low) and not math.isnan(each.value) else text


def _average(each: AverageDifference) -> str:
    return {"geometric": "geometric means of the paired ratios", "mean": "ratios of the means"}.get(
        each.average, "mean differences"
    )


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
