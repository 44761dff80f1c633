"""Ten worked comparisons for docs/statistics.md: runs with fixed values, evaluated and printed as those of a run.

`docs.pages` (``make docs``) writes them into the page, between its markers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import pandas as pd
from data_frames import arrays
from scipy import stats

from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.analysis.result_rows import ResultTable, result_table
from rmpc_bench.analysis.statistics import summary
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.columns import columns_of
from rmpc_bench.report.comparison_table import sentence
from rmpc_bench.report.point_tables import markdown_table
from rmpc_bench.report.screen import WIDTH
from rmpc_bench.report.screen_tables import ran_lines, row_lines
from rmpc_bench.types import Array, MetricInfo

PAGE = Path(__file__).parents[2] / "docs" / "statistics.md"
BEGIN, END = "<!-- begin of what `make docs` writes -->", "<!-- end of what `make docs` writes -->"
MSE = MetricInfo("mse", "rad^2", "lower")
SETTLING = MetricInfo("settling_time", "s", "lower", may_not_occur=True)


class Case(NamedTuple):
    """Runs of a baseline A and of a method B, both in the order of the runs; NaN where a run failed."""

    title: str
    a: Array
    b: Array
    remark: str
    info: MetricInfo = MSE
    with_verdicts: bool = True


def normal(n: int, step: int = 1) -> Array:
    """Return n quantiles of a standard normal law, every `step`-th one, which visits all where step and n are coprime.

    Two of them with different steps are nearly uncorrelated.
    """
    return np.array([NormalDist().inv_cdf((i * step % n + 0.5) / n) for i in range(n)])


def logs(low_pct: float, high_pct: float, pattern: Array) -> Array:
    """Return log ratios whose Student interval at 95 % has these ends, in per cent, with the shape of a pattern."""
    n = len(pattern)
    low, high = math.log1p(low_pct / 100), math.log1p(high_pct / 100)
    spread = (high - low) / 2 / float(stats.t.ppf(0.975, n - 1)) * math.sqrt(n)
    found: Array = (low + high) / 2 + spread * (pattern - pattern.mean()) / pattern.std(ddof=1)
    return found


def better() -> Case:
    """Thirty runs improve by 5 to 20 per cent, ten do not change."""
    a = 0.12 * np.exp(0.1 * normal(40, 7))
    gain = np.where(np.arange(40) % 4 == 3, 0.0, np.linspace(0.05, 0.20, 40))
    remark = "30 runs are won and 10 tied, so the superiority is (30 + 10/2)/40 and not 100 %."
    return Case("better", a, a * (1 - gain), remark)


def worse() -> Case:
    """The method is unstable, and no range was given in which its states must stay."""
    a = 0.1 * np.exp(0.1 * normal(40, 7))
    remark = (
        "Numbers that differ by powers of ten have an exponent each. With `plant.bounds` or `plant.diverged` such runs "
        "are failed runs."
    )
    return Case("worse", a, 1e61 * np.exp(13.6 * normal(40, 11)), remark)


def better_size_uncertain() -> Case:
    """The interval excludes 0 and reaches into the margin."""
    a = 0.2 * np.exp(0.3 * normal(101, 13))
    remark = "The change may be as small as 0.8 % or as large as 9 %: its size is not known to be small."
    return Case("better, size uncertain", a, a * np.exp(logs(-9.0, -0.8, normal(101, 17))), remark)


def worse_size_uncertain() -> Case:
    """The ratio is lower where the values are large, so that the means show another direction."""
    shape = normal(101, 13)
    a = 0.264 * np.exp(0.52 * shape)
    ratios = np.exp(logs(0.9, 8.2, normal(101, 17) - 1.16 * shape))
    remark = (
        "The mean of B is lower than that of A although the typical run is worse. Both averages are shown; the "
        "interval of the second contains 0, so it does not contradict the verdict."
    )
    return Case("worse, size uncertain", a, a * ratios, remark)


def equivalent() -> Case:
    """Equal up to 0.0005 per cent."""
    a = 0.3 * np.exp(0.4 * normal(60, 7))
    remark = "All runs are tied. The interval lies inside the margin: the change is shown to be irrelevant."
    return Case("equivalent", a, a * np.exp(logs(-0.00012, 0.00019, normal(60, 11))), remark)


def inconclusive() -> Case:
    """The interval contains 0 and leaves the margin."""
    a = 0.2 * np.exp(0.3 * normal(101, 13))
    remark = "The interval contains 0, if only just. The runs that would decide are estimated from the spread."
    return Case("inconclusive", a, a * np.exp(logs(-7.6, 0.04, normal(101, 17))), remark)


def fails_more() -> Case:
    """Better by 5 per cent where it finishes; it fails on the hardest tenth of the plants."""
    a = 0.2 * np.exp(0.3 * normal(200, 7))
    b = a * np.exp(logs(-5.6, -4.4, normal(200, 11)))
    b[a >= np.sort(a)[-20]] = math.nan
    remark = (
        "Averages rest on the 180 runs that both finished. A failed run loses, and the failures decide the verdict."
    )
    return Case("fails more", a, b, remark)


def depends_on_average() -> Case:
    """Worse in most runs, better in the few with large values; after souto2011/comparison."""
    shape = normal(1000, 7)
    a = 5.0 * np.exp(1.2 * shape)
    ratios = np.exp(logs(16.0, 25.0, normal(1000, 11) - 1.76 * shape))
    remark = "Both intervals exclude 0, with opposite signs: the question must name the average."
    return Case("depends on the average", a, a * ratios, remark)


def counts_of_an_event() -> Case:
    """Settling times, inf where a run did not settle."""
    values = np.concatenate([np.full(12, 3.4), np.linspace(17.2, 20.0, 24), np.full(4, math.inf)])
    a = values[np.arange(40) * 7 % 40]
    b = np.where(np.arange(40) % 3 == 0, a, 0.9 * a)
    b[np.isinf(a)] = [19.0, 20.0, math.inf, math.inf]
    remark = (
        "A run that did not settle has no settling time, so there is no mean and no change in per cent: counts decide. "
        "It loses against a run that settled."
    )
    return Case("did not settle", a, b, remark, SETTLING)


def few_runs() -> Case:
    """Eight runs, all of them better."""
    a = np.array([0.1030, 0.1080, 0.1118, 0.1020, 0.1166, 0.1037, 0.1140, 0.1170])
    b = a * np.array([0.93, 0.96, 0.95, 0.94, 0.92, 0.95, 0.96, 0.93])
    remark = (
        "With fewer than 20 untied runs counts decide, and eight of eight are enough; five of five are not. The "
        "quartiles have two digits of their spread, although the error of the median supports one."
    )
    return Case("few runs", a, b, remark)


def smoke() -> Case:
    """A smoke run ends before the reference has its first step."""
    return Case("smoke run", np.zeros(4), np.zeros(4), "", with_verdicts=False)


CASES: tuple[Callable[[], Case], ...] = (
    better,
    worse,
    better_size_uncertain,
    worse_size_uncertain,
    equivalent,
    inconclusive,
    fails_more,
    depends_on_average,
    counts_of_an_event,
    few_runs,
)


def trials_of(case: Case) -> Trials:
    """Return the table of trials of a case, with a margin of 1 % and intervals at 95 %."""
    rows = [
        {"method": method, "run": run, "status": "diverged" if math.isnan(value) else "ok", case.info.name: value}
        for method, values in (("A", case.a), ("B", case.b))
        for run, value in enumerate(values)
    ]
    return Trials(
        name="worked",
        methods=("A", "B"),
        labels={"A": "A", "B": "B"},
        metrics=(case.info,),
        columns=arrays(pd.DataFrame(rows)),
        over_time=(),
        baseline="A",
        confidence=0.95,
        relevant=0.01,
        seed=1,
        with_verdicts=case.with_verdicts,
    )


def table_of(case: Case) -> ResultTable:
    """Evaluate a case."""
    trials = trials_of(case)
    return result_table(trials, summary(trials), comparisons(trials), case.info)


def columns_of_cases(row_of: Callable[[ResultTable], dict[str, str]]) -> dict[str, list[str]]:
    """Return the columns of a table with a row for every case, head -> cells."""
    columns: dict[str, list[str]] = {}
    for number, make in enumerate(CASES, 1):
        for head, cell in ({"": str(number)} | row_of(table_of(make()))).items():
            columns.setdefault(head, []).append(cell or "-")
    return columns


def row_of_comparison(table: ResultTable) -> dict[str, str]:
    """Return means, changes, counts and verdict of a case, head -> cell."""
    found = columns_of(table)
    a, b = (f"settled: {mean}" if table.may_not_occur else mean for mean in found["mean"])
    row = table.rows[1]
    return {
        "mean of A": a,
        "mean of B": b,
        "geometric mean of the ratios": found.get("change", ["", ""])[1],
        "ratio of the means": found.get("other", ["", ""])[1],
        "won/lost/tied": row.counts,
        "superiority": found["superiority"][1] if "superiority" in found else "",
        "verdict": ", ".join(filter(None, [row.word, row.remark])),
    }


def row_of_runs(table: ResultTable) -> dict[str, str]:
    """Return medians and numbers of runs of a case, head -> cell."""
    found = columns_of(table)
    names = [row.method for row in table.rows]
    return {
        "metric": f"{table.info.name} [{table.info.unit}]",
        **{f"median of {name} (quartiles)": cell for name, cell in zip(names, found["median"], strict=True)},
        **{f"n/n_failed of {name}": cell for name, cell in zip(names, found["n"], strict=True)},
        "pairs": found.get("pairs", ["", ""])[1],
    }


def screen_of(case: Case) -> str:
    """Return the table of a case as a run prints it."""
    trials = trials_of(case)
    if not trials.with_verdicts:
        return "\n".join(ran_lines(trials, WIDTH))
    return "\n".join(row_lines(result_table(trials, summary(trials), comparisons(trials), case.info), WIDTH))


def generated() -> str:
    """Return what stands between the markers of the page."""
    sentences = []
    for number, make in enumerate(CASES, 1):
        case = make()
        table = table_of(case)
        row = table.rows[1].compared
        assert row
        sentences.append(f"{number}. {sentence(row, case.info, table.trials)} *{case.remark}*")
    parts = [
        markdown_table(columns_of_cases(row_of_comparison)),
        "The runs behind them:",
        markdown_table(columns_of_cases(row_of_runs)),
        "Each comparison in one sentence, as `rmpc_bench.compare` writes it, and what it shows:",
        "\n".join(sentences),
        "Number 7 on the screen, with the failed runs behind the verdict:",
        f"```text\n{screen_of(fails_more())}\n```",
        "A smoke run has no verdict and no averages, only what ran:",
        f"```text\n{screen_of(smoke())}\n```",
    ]
    return "\n\n".join(parts)


def updated(page: str) -> str:
    """Return a page with the part between its markers made again."""
    head, rest = page.split(BEGIN)
    return f"{head}{BEGIN}\n\n{generated()}\n\n{END}{rest.split(END)[1]}"
