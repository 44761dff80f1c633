"""Ranks of methods over all points of a sweep: the table for files, page and screen, and sentences to quote."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass
from statistics import fmean, median
from typing import Any

from rmpc_bench.analysis.calibration import calibrations
from rmpc_bench.analysis.columns import Columns, columns_of
from rmpc_bench.analysis.ranks import Ranking, RankRow, Ratio, ranking
from rmpc_bench.analysis.shown_numbers import Estimate, interval_text, number, short
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.tuning import parameter_cells, parameter_legend
from rmpc_bench.figures.labels import marked
from rmpc_bench.report.point_tables import FrameTable, markdown_page, markdown_table, rounded_columns
from rmpc_bench.report.run_notes import short_time

LIMITATIONS = (
    "A rank is that among these methods. Another method may widen or move it.",
    "The points of the sweep have equal weights. They are chosen, not sampled from a population of systems. The "
    "intervals do not hold for other systems.",
    "The intervals cover only the random variation between runs. Where parameters are tuned, another set of tuning "
    "runs may choose other values.",
    "Methods whose ranks overlap are not shown to be equal: the runs do not decide between them.",
)
_NUMBERS = ["ratio", "ratio_low", "ratio_high", "smallest", "largest"]
COLUMNS = [
    *("axis", "value", "method", "rank_low", "rank_high", "n", "n_failed", "n_points", "n_pairs"),
    *("ratio", "ratio_low", "ratio_high", "smallest", "smallest_at", "largest", "largest_at", "better", "worse"),
]  # of ranks.csv; those of ranks are empty in the rows of a part of the sweep
_WHOLE = ["rank_low", "rank_high", "n", "n_failed", "better", "worse"]


@dataclass(frozen=True, eq=False, repr=False)
class RanksTable(FrameTable):
    """The methods in the order of their ranks."""

    trials: Trials
    found: Ranking | None  # None where there are no ranks
    whole = _WHOLE

    @property
    def content(self) -> Columns:
        """Content of ranks.csv: a row per method, then a row per part of the sweep and method."""
        rows = [_record(row.ratio, row) for row in self.found.rows] if self.found else []
        rows += map(_record, self.found.ratios) if self.found else []
        return rounded_columns(columns_of(rows, COLUMNS), _NUMBERS, 1.0)

    @property
    def methods(self) -> tuple[str, ...]:
        """Names in the order of the ranks."""
        return () if self.found is None else tuple(row.method for row in self.found.rows)

    @property
    def columns(self) -> dict[str, list[str]]:
        """Head -> cells, a line per method; nothing without ranks."""
        if self.found is None:
            return {}
        rows, baseline = self.found.rows, self.trials.baseline
        columns = {"method": [marked(self.trials, row.method) for row in rows]}
        columns["rank"] = [f"{row.rank_low} to {row.rank_high}" for row in rows]
        # Failures come before accuracy.
        columns["n/n_failed"] = [f"{row.n}/{row.n_failed}" for row in rows]
        columns[f"ratio to {baseline}"] = [_interval(row.ratio) for row in rows]
        columns |= part_columns(self.found, baseline)
        columns |= self._coverage
        if words := parameter_cells(self.trials, [row.method for row in rows]):
            columns["parameters"] = words
        notes = [[point.notes.get(row.method) for point in self.trials.each] for row in rows]
        seconds = [[each.seconds_per_step for each in of if each and each.seconds_per_step is not None] for of in notes]
        # Median over the points of the time per run and step.
        times = [short_time(median(each)) if each else "-" for each in seconds]
        return columns | ({"time per step": times} if {*times} != {"-"} else {})

    @property
    def _coverage(self) -> dict[str, list[str]]:
        """Head -> cells on reported covariances: mean share over the points, median factor; no rank uses them."""
        keys, cells = self.trials.calibration, []
        if keys is None:
            return {}
        rows = [row for _, of in calibrations(self.trials) for row in of if row["of"] == "joint" and row["n"]]
        for name in self.methods:
            mine = [row for row in rows if row["method"] == name and row["level"] == keys.verdict]
            c, f = ([row[key] for row in mine] for key in ("covered", "factor"))
            cells.append(f"{100 * fmean(c):.0f} % ({number(median(f), 2)})" if mine else "-")
        return {f"covers {100 * keys.verdict:g} %": cells}

    @property
    def rest(self) -> str:
        """Say on how many points and runs the ratios rest where a run failed; empty where none did."""
        if self.found is None or not any(row.n_failed for row in self.found.rows):
            return ""
        parts = [
            f"{row.method} {row.ratio.n_pairs} of {row.n} runs at {row.ratio.n_points} points"
            for row in self.found.rows
            if row.method != self.trials.baseline
        ]
        return f"The ratios rest on the runs that both finished: {', '.join(parts)}."

    @property
    def legend(self) -> list[str]:
        """What the columns mean, as sentences."""
        if self.found is None:
            return []
        info, baseline = self.trials.primary_info, self.trials.baseline
        level = f"{100 * self.trials.confidence:g} %"
        points = f" over {len(self.trials.points)} points" * bool(self.trials.points)
        texts = [
            f"rank: interval from all pairs of methods, simultaneous at {level}; smaller is better",
            f"ratio: geometric mean of {info.words if info else 'the metric'} relative to {baseline}{points}, with the "
            "same simultaneous interval",
        ]
        what = "rank, ratio: of these points; the intervals cover the random variation between runs, not other systems"
        texts += [what] if points else []
        if self.trials.calibration is not None:
            texts.append(
                "covers: mean share of errors in this region of the reported covariance, median of the size of "
                "errors relative to its standard deviations; ranks do not use it"
            )
        if any(each.ratio for row in self.found.rows for each in row.by_value):
            texts.append("?: the simultaneous interval of the ratio contains 1")
        if self.found.n_values > 1:
            which = f"of the {self.found.n_values} values of {self.found.longest}"
            texts.append(f"smallest, largest, better/worse: {which}; by simultaneous intervals at {level}")
        if "-" in self.columns.get("time per step", ()):
            texts.append("time per step -: a linear filter runs in a compiled loop with the plant, which is not timed")
        return [*texts, *parameter_legend(self.trials), *filter(None, [self._cost, self.rest])]

    @property
    def _cost(self) -> str:
        """Say what tuning has cost; empty where nothing is tuned."""
        tuning = self.trials.tuning
        if tuning is None or not tuning.searches:
            return ""
        # Equal methods and points share a search.
        searches = {each.key or (each.point, each.method): each for each in tuning.searches}.values()
        seconds = sum(each.seconds for each in searches)
        time = f", {seconds:.0f} s" if seconds >= 0.5 else ""
        return f"tuning: {sum(each.tuning.size for each in searches):,} trials on other runs{time}"

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence per method that can be quoted as it stands."""
        return () if self.found is None else tuple(self._sentence(row, len(self.found.rows)) for row in self.found.rows)

    def _sentence(self, row: RankRow, n: int) -> str:
        failed = f"{row.n_failed} of {row.n} runs failed; " if row.n_failed else ""
        end = f" at these {len(self.trials.points)} points." if self.trials.points else "."
        level = f"{100 * self.trials.confidence:g} % simultaneous"
        ratio = f", ratio to {self.trials.baseline} {_interval(row.ratio)} ({level})"
        ratio = "" if row.method == self.trials.baseline or math.isnan(row.ratio.ratio) else ratio
        return f"{row.method}: {failed}rank {row.rank_low} to {row.rank_high} of {n}{ratio}{end}"

    def to_markdown(self) -> str:
        """Return the table with its legend; empty without ranks."""
        if not self.columns:
            return ""
        parts = [f"# {self.trials.name}: ranks", markdown_table(self.columns)]
        return markdown_page([*parts, "\n".join(f"- {text}" for text in self.legend)])

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def ranks_table(trials: Trials) -> RanksTable:
    """Rank the methods of an experiment whose configuration asks for it."""
    return RanksTable(trials, ranking(trials) if trials.with_verdicts else None)


def _interval(ratio: Ratio) -> str:
    return interval_text(Estimate(ratio.ratio, ratio.low, ratio.high))


def part_columns(found: Ranking, baseline: str) -> dict[str, list[str]]:
    """Return head -> cells on the parts of the sweep, a line per method; those of the baseline are empty."""
    parts: dict[tuple[str, str], dict[str, Ratio]] = {}
    for each in (ratio for row in found.rows for ratio in row.by_value):
        parts.setdefault((each.axis, each.value), {})[each.method] = each
    seen = Counter(value for _, value in parts)
    # Two paths may have the same value.
    heads = [value if seen[value] == 1 else f"{axis.rpartition('.')[2]}={value}" for axis, value in parts]
    cells = [[_factor(of.get(row.method)) for row in found.rows] for of in parts.values()]
    columns = dict(zip(heads, cells, strict=True))
    if found.n_values < 2:
        return columns
    others = [None if row.method == baseline else row for row in found.rows]
    for head in ("smallest", "largest"):
        columns[head] = [_factor(getattr(row, head, None), at=True) for row in others]
    return columns | {"better/worse": ["" if row is None else f"{row.better}/{row.worse}" for row in others]}


def _factor(ratio: Ratio | None, *, at: bool = False) -> str:
    """Write the ratio of a part of the sweep: with a mark where its interval contains 1, or with the part behind it."""
    if ratio is None or math.isnan(ratio.ratio):
        return ""
    mark = "" if ratio.high < 1 or ratio.low > 1 else " ?"
    return f"\u00d7{short(ratio.ratio)}{mark}{f' ({ratio.value})' * at}"


def _record(ratio: Ratio, row: RankRow | None = None) -> dict[str, Any]:
    """Return a row of ranks.csv: of a method, or of a part of the sweep."""
    found = dict.fromkeys(COLUMNS) | asdict(ratio)
    found |= {"ratio_low": found.pop("low"), "ratio_high": found.pop("high")}
    if row is None:
        return found
    for name, each in (("smallest", row.smallest), ("largest", row.largest)):
        found |= {name: each.ratio, f"{name}_at": each.value} if each else {name: math.nan, f"{name}_at": ""}
    return found | {name: getattr(row, name) for name in _WHOLE}
