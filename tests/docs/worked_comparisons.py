"""Ten worked comparisons: runs with fixed values, evaluated and printed as those of a run.

`docs.pages` (``make docs``) writes three of them into docs/statistics.md, between its markers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from statistics import NormalDist
from textwrap import fill
from typing import NamedTuple

import numpy as np
import pandas as pd
from data_frames import arrays
from docs.markdown import DOCS
from scipy import stats

from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.analysis.result_rows import ResultTable, result_table
from rmpc_bench.analysis.statistics import summary
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.columns import columns_of
from rmpc_bench.report.point_tables import markdown_table
from rmpc_bench.report.screen import WIDTH
from rmpc_bench.report.screen_tables import ran_lines, row_lines
from rmpc_bench.report.summary import sentence
from rmpc_bench.types import Array, MetricInfo

PAGE = DOCS / "statistics.md"
MSE = MetricInfo("mse", "rad^2", "lower")
SETTLING = MetricInfo("settling_time", "s", "lower", may_not_occur=True)


class Case(NamedTuple):
    """Runs of a baseline A and of a method B, both in the order of the runs; NaN where a run failed."""

    a: Array
    b: Array
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
    return Case(a, a * (1 - gain))


def worse() -> Case:
    """The method is unstable, and no range was given in which its states must stay."""
    a = 0.1 * np.exp(0.1 * normal(40, 7))
    return Case(a, 1e61 * np.exp(13.6 * normal(40, 11)))


def better_size_uncertain() -> Case:
    """The interval excludes 0 and reaches into the margin."""
    a = 0.2 * np.exp(0.3 * normal(101, 13))
    return Case(a, a * np.exp(logs(-9.0, -0.8, normal(101, 17))))


def worse_size_uncertain() -> Case:
    """The ratio is lower where the values are large, so that the means show another direction."""
    shape = normal(101, 13)
    a = 0.264 * np.exp(0.52 * shape)
    ratios = np.exp(logs(0.9, 8.2, normal(101, 17) - 1.16 * shape))
    return Case(a, a * ratios)


def equivalent() -> Case:
    """Equal up to 0.0005 per cent."""
    a = 0.3 * np.exp(0.4 * normal(60, 7))
    return Case(a, a * np.exp(logs(-0.00012, 0.00019, normal(60, 11))))


def inconclusive() -> Case:
    """The interval contains 0 and leaves the margin."""
    a = 0.2 * np.exp(0.3 * normal(101, 13))
    return Case(a, a * np.exp(logs(-7.6, 0.04, normal(101, 17))))


def fails_more() -> Case:
    """Better by 5 per cent where it finishes; it fails on the hardest tenth of the plants."""
    a = 0.2 * np.exp(0.3 * normal(200, 7))
    b = a * np.exp(logs(-5.6, -4.4, normal(200, 11)))
    b[a >= np.sort(a)[-20]] = math.nan
    return Case(a, b)


def depends_on_average() -> Case:
    """Worse in most runs, better in the few with large values; after souto2011/comparison."""
    shape = normal(1000, 7)
    a = 5.0 * np.exp(1.2 * shape)
    ratios = np.exp(logs(16.0, 25.0, normal(1000, 11) - 1.76 * shape))
    return Case(a, a * ratios)


def counts_of_an_event() -> Case:
    """Settling times, inf where a run did not settle."""
    values = np.concatenate([np.full(12, 3.4), np.linspace(17.2, 20.0, 24), np.full(4, math.inf)])
    a = values[np.arange(40) * 7 % 40]
    b = np.where(np.arange(40) % 3 == 0, a, 0.9 * a)
    b[np.isinf(a)] = [19.0, 20.0, math.inf, math.inf]
    return Case(a, b, SETTLING)


def few_runs() -> Case:
    """Eight runs, all of them better."""
    a = np.array([0.1030, 0.1080, 0.1118, 0.1020, 0.1166, 0.1037, 0.1140, 0.1170])
    b = a * np.array([0.93, 0.96, 0.95, 0.94, 0.92, 0.95, 0.96, 0.93])
    return Case(a, b)


def smoke() -> Case:
    """A smoke run ends before the reference has its first step."""
    return Case(np.zeros(4), np.zeros(4), with_verdicts=False)


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
SHOWN: dict[Callable[[], Case], str] = {
    fails_more: "Averages rest on the 180 runs that both finished. A failed run loses; the failures decide.",
    depends_on_average: "Both intervals exclude 0, with opposite signs: the question must name the average.",
    counts_of_an_event: "There is no mean, so counts decide. A run that did not settle loses against one that did.",
}
"""Those of the page, with what they show."""


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


def screen_of(case: Case) -> str:
    """Return the table of a case as a run prints it."""
    trials = trials_of(case)
    if not trials.with_verdicts:
        return "\n".join(ran_lines(trials, WIDTH))
    return "\n".join(row_lines(result_table(trials, summary(trials), comparisons(trials), case.info), WIDTH))


def worked() -> str:
    """Return the part of the page."""
    tables = [table_of(make()) for make in SHOWN]
    rows = [row_of_comparison(found) for found in tables]
    columns = {head: [row[head] or "-" for row in rows] for head in rows[0]}
    numbers = [str(number) for number in range(1, len(rows) + 1)]
    remarks = [f"{number}. {remark}" for number, remark in enumerate(SHOWN.values(), 1)]
    compared = tables[0].rows[1].compared
    assert compared
    words = fill(sentence(compared, MSE, tables[0].trials), WIDTH)
    parts = [
        markdown_table({"": numbers, **columns}),
        "\n".join(remarks),
        "Number 1 on the screen and as a sentence of `rmpc_bench.compare`:",
        f"```text\n{screen_of(fails_more())}\n\n{words}\n```",
    ]
    return "\n\n".join(parts)


TABLES: Mapping[str, Callable[[], str]] = {"worked": worked}
"""Marker -> part of the page."""
