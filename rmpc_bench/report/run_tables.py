"""Tables beside those of the metrics: requirements, drivers, worst runs, lost runs and the error at the end."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.columns import Columns, Rows
from rmpc_bench.analysis.comparison_text import per_cent
from rmpc_bench.analysis.drivers import COLUMNS as OF_DRIVERS
from rmpc_bench.analysis.drivers import FEWEST, REST, drivers, inputs
from rmpc_bench.analysis.drivers import share_text as driver_share
from rmpc_bench.analysis.lost_runs import COLUMNS as OF_LOST_RUNS
from rmpc_bench.analysis.lost_runs import lost_runs
from rmpc_bench.analysis.pairs import distance_from_best, name_of_distance
from rmpc_bench.analysis.result_rows import ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, interval_text
from rmpc_bench.analysis.statistics import COLUMNS as OF_PASS_RATES
from rmpc_bench.analysis.statistics import pass_rates
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.worst_runs import tail_rows
from rmpc_bench.figures.labels import marked, short_title
from rmpc_bench.report.point_tables import (
    FrameTable,
    columns_from,
    markdown_page,
    markdown_table,
    rounded_columns,
    stacked_points,
    titled_tables,
)
from rmpc_bench.report.run_notes import counted, show_command
from rmpc_bench.types import Array, MetricInfo


def ensemble_rows(trials: Trials) -> list[dict[str, str]]:
    """Return head -> cell of every method of one point; nothing where no moments were evaluated."""
    rows = []
    for method in trials.methods:
        mean, cov, P = (_last(trials, quantity, method) for quantity in ("mean(e)", "cov(e)", "P"))
        if mean is None or cov is None:
            continue
        variance, n = np.diagonal(cov), trials.n_of("cov(e)", method)
        rows.append(
            {
                "error at the end": marked(trials, method),
                "bias x - x_hat": _numbers(np.where(np.abs(mean) < 1e-9 * np.sqrt(variance.max()), 0.0, mean)),
                "variance": _numbers(variance),
                "mean square": f"{float(variance.sum() + mean @ mean):.4g}",
                "reported covariance": "-" if P is None else _numbers(np.diagonal(P)),
                "": f"from {n} runs" if n else "exact",
            }
        )
    return rows


def _last(trials: Trials, quantity: str, method: str) -> Array | None:
    try:
        return np.asarray(trials.matrix_series(quantity, method)[-1])
    except KeyError:
        return None


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.4g}" for value in values)


def ensemble_markdown(trials: Trials) -> str:
    """Lay the table out as Markdown; empty where there is none."""
    head = f"## Ensemble of the error at the end{f': {trials.title}' if trials.title else ''}"
    rows = ensemble_rows(trials)
    parts = [head, markdown_table(columns_from(rows)), "Bias, variance and P by component."] if rows else []
    return markdown_page(parts)


FEWEST_RUNS = 20  # runs below which the worst 5 % are less than one run


def tail_columns(trials: Trials, metrics: Sequence[MetricInfo] | None = None) -> dict[str, list[str]]:
    """Return head -> cells at one point for some metrics or all; empty with few runs and where nothing is estimated."""
    if len(trials.runs) < FEWEST_RUNS or trials.alike or not trials.with_verdicts:
        return {}
    trials = trials if metrics is None else trials.with_numbers(metrics=tuple(metrics))
    rows = tail_rows(trials)
    of_each = ((info, row) for info in trials.metrics for row in rows if row["metric"] == info.name)
    return columns_from(_cells(trials, row, info) for info, row in of_each)


class WorstRuns(NamedTuple):
    """The worst finished run of every method, over all points."""

    found: Mapping[str, tuple[float, int, Trials]]  # method -> distance from the best value, run, point
    method: str  # the one whose run is shown: the baseline where it has one
    gist: str

    def command(self, directory: object) -> str:
        """Return the command that shows the run."""
        _, run, trials = self.found[self.method]
        return show_command(trials, directory, self.method, run)


def worst_of(tables: Sequence[ResultTable]) -> WorstRuns | None:
    """Find the worst runs of points; None where no run is worse than the others."""
    points = [table.trials for table in tables if not table.trials.alike and len(table.trials.runs) > 1]
    sign = -1.0 if tables and tables[0].info.direction == "higher" else 1.0
    found: dict[str, tuple[float, int, Trials]] = {}
    for trials in points:
        for method, (value, run) in worst_runs(trials, tables[0].info).items():
            if method not in found or sign * value > sign * found[method][0]:
                found[method] = value, run, trials
    if not found:
        return None
    method = points[0].baseline if points[0].baseline in found else next(iter(found))
    value, run, trials = found[method]
    where = f" at {short_title(trials)}" if len(points) > 1 else ""
    of = "every method" if len({(each[1], each[2].title) for each in found.values()}) == 1 < len(found) else method
    # Runs without the event are equally bad; the first of them stands in the table.
    event = f"run {run}{where} has no {tables[0].quantity} with {of}"
    return WorstRuns(found, method, f"run {run}{where} is the worst of {of}" if math.isfinite(value) else event)


def worst_runs(trials: Trials, info: MetricInfo) -> dict[str, tuple[float, int]]:
    """Return method -> distance from the best value and index of its worst finished run, the first of equal ones.

    A method whose runs are all equally good has no worst one.
    """
    found = {}
    for method in trials.methods:
        values = distance_from_best(trials.column(info.name, method), info.direction)
        finished = values[~np.isnan(values)]
        if (finished == finished[:1]).all() and len(values) > 1:
            continue
        place = int(np.nanargmin(values) if info.direction == "higher" else np.nanargmax(values))
        found[method] = float(values[place]), int(trials.runs[place])
    return found


def _cells(trials: Trials, row: Mapping[str, Any], info: MetricInfo) -> dict[str, str]:
    return {
        "metric": name_of_distance(info) + (f" [{info.unit}]" if info.unit else ""),
        "method": marked(trials, row["method"]),
        "95 % quantile": _tail_text(row, "tail_quantile") + " (5 %)" * (info.direction == "higher"),
        "mean of the worst 5 %": _tail_text(row, "cvar"),
        "worst finished run": "-" if math.isnan(row["worst"]) else f"{row['worst']:.4g} (run {row['worst_run']})",
    }


def _tail_text(row: Mapping[str, Any], name: str) -> str:
    value, low, high = (float(row[key]) for key in (name, f"{name}_low", f"{name}_high"))
    return f"{value}" if math.isinf(value) else interval_text(Estimate(value, low, high))


def lost_table(trials: Trials) -> Columns:
    """Return the content of lost.csv: sweep columns, then one row per method; no row where no factor is given."""
    table = stacked_points([(point, lost_runs(point)) for point in trials.each], OF_LOST_RUNS)
    return rounded_columns(table, ["lost_pct", "lost_low", "lost_high"], 100.0)


MOST_POINTS = 12  # points of a sweep whose drivers stand in tables/drivers.md; drivers.csv has all
DRIVERS_NOTE = (
    "Share: what the adjusted R^2 of a quadratic response surface loses without all terms of a quantity. It is the "
    f"total effect of the quantity, interactions included, so that shares need not sum to 100 %. Brackets: interval "
    f"from a bootstrap of whole runs. No share (-): below {FEWEST} runs, an interval that contains 0 and reaches "
    "beyond 5 %, or a share of about 0 of a quantity that is correlated with another one."
)


@dataclass(frozen=True, eq=False, repr=False)
class DriversTable(FrameTable):
    """Drivers of the primary metric."""

    points: Sequence[tuple[Trials, Rows]]  # each with its drivers, see `rmpc_bench.analysis.drivers`

    @property
    def content(self) -> Columns:
        """Content of drivers.csv: sweep columns, then one row per method and quantity."""
        return stacked_points(self.points, OF_DRIVERS)

    def to_markdown(self) -> str:
        """Return a table for every point; empty where nothing is uncertain."""
        parts = titled_tables(self.points[:MOST_POINTS], _columns)
        left = sum(len(rows) > 0 for _, rows in self.points[MOST_POINTS:])
        parts += [f"{counted(left, 'more point')} of the sweep: drivers.csv"] if left else []
        correlated = correlated_text([trials for trials, _ in self.points])
        return markdown_page([*parts, *([correlated] if correlated else []), DRIVERS_NOTE] if parts else [])

    __str__ = to_markdown


def correlated_text(points: Sequence[Trials]) -> str:
    """Say which quantities are correlated at a point, so that their shares cannot be separated; empty for none."""
    pairs = dict.fromkeys(f"{a} with {b}" for trials in points for a, b in inputs(trials).correlated)
    return f"Correlated, |r| > 1/2: {', '.join(pairs)}. What one explains, the other may explain." if pairs else ""


def drivers_table(trials: Trials) -> DriversTable:
    """Compute the drivers of the primary metric at every point of a sweep."""
    return DriversTable([(point, drivers(point)) for point in trials.each])


def _columns(_: Trials, rows: Rows) -> dict[str, list[str]]:
    """Return head -> cells, a row per method."""
    found = []
    of_method: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["response"] != "failed":
            of_method.setdefault(row["method"], []).append(row)
    for method, records in of_method.items():
        # Heads of two words cannot be names of quantities.
        cells = {"variance of": f"{method}: {records[0]['response']} of {records[0]['metric']}"}
        cells |= {"not explained" if row["quantity"] == REST else row["quantity"]: driver_share(row) for row in records}
        cells |= {"number of runs": str(records[0]["n"]), "failed runs left out": str(records[0]["n_failed"])}
        found.append(cells)
    return columns_from(found)


REQUIREMENTS_NOTE = (
    "A failed run does not meet a requirement. Share: Wilson interval; difference in percentage points: paired score "
    "interval of Tango, which contains 0 where the exact McNemar test does not reject equal shares."
)


def requirement_columns(trials: Trials, rows: Rows, *, plain: bool = False) -> dict[str, list[str]]:
    """Return head -> cells by the pass rates of one point; a plain table has no backticks around requirements."""
    if not rows:
        return {}
    columns = {
        "requirement": [str(row["requirement"]) if plain else f"`{row['requirement']}`" for row in rows],
        "method": [row["method"] if plain else marked(trials, row["method"]) for row in rows],
        "runs that meet it": [f"{row['passed']} of {row['n']}" for row in rows],
        "share": [share_text(row) for row in rows],
        "miss it, at most (95 %)": [per_cent(row["miss_upper"]) for row in rows],
    }
    if len(trials.methods) > 1:
        columns[f"difference from {trials.baseline}"] = [difference_text(row) for row in rows]
        columns["met by the method only / by the baseline only"] = [
            "-" if row["method"] == row["baseline"] else f"{row['method_only']} / {row['baseline_only']}"
            for row in rows
        ]
    return columns


def share_text(row: Mapping[str, Any]) -> str:
    """Write the share of runs that meet a requirement with its interval."""
    return interval_text(Estimate(row["pass_pct"], row["pass_low"], row["pass_high"]), "%")


def difference_text(row: Mapping[str, Any]) -> str:
    """Write the paired difference from the baseline in percentage points; "-" for the baseline."""
    values = (row["difference_pct"], row["difference_low"], row["difference_high"])
    return interval_text(Estimate(*values), "points", sign=True)


MOST_NAMED = 4  # methods that the screen names
_SHARES = ["pass_pct", "pass_low", "pass_high", "miss_upper", "difference_pct", "difference_low", "difference_high"]


@dataclass(frozen=True, eq=False, repr=False)
class RequirementsTable(FrameTable):
    """Pass rates at every point of a sweep."""

    trials: Trials
    points: Sequence[tuple[Trials, Rows]]  # each with its pass rates, see `rmpc_bench.analysis.statistics`

    @property
    def content(self) -> Columns:
        """Content of requirements.csv: sweep columns, then one row per requirement and method."""
        return rounded_columns(stacked_points(self.points, OF_PASS_RATES), _SHARES, 100.0)

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence per requirement and method that can be quoted as it stands."""
        return tuple(_sentence(trials, row) for trials, rows in self.points for row in rows)

    @property
    def gist(self) -> str:
        """In how many runs each method meets the first requirement; empty without one, or with several points."""
        known = [rows for _, rows in self.points if rows]
        if len(known) != 1:
            return "requirements: tables/requirements.md" if known else ""
        first = known[0][0]["requirement"]
        rows = [row for row in known[0] if row["requirement"] == first][:MOST_NAMED]
        others = len(known[0]) > len(rows)
        met = ", ".join(f"{row['passed']} ({row['method']})" for row in rows)
        return f"{first} in {met} of {rows[0]['n']} runs{': tables/requirements.md' * others}"

    def to_markdown(self) -> str:
        """Return a table per point; empty without requirements."""
        parts = titled_tables(self.points, requirement_columns)
        return markdown_page([*parts, REQUIREMENTS_NOTE] if parts else [])

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def requirements_table(trials: Trials) -> RequirementsTable:
    """Count the runs that meet each requirement at every point of a sweep."""
    return RequirementsTable(trials, [(point, pass_rates(point)) for point in trials.each])


def _sentence(trials: Trials, row: Mapping[str, Any]) -> str:
    where = f"{trials.title}: " if trials.title else ""
    failed = f", {row['n_failed']} of them failed" if row["n_failed"] else ""
    met = f"meets {row['requirement']} in {row['passed']} of {row['n']} runs"
    start, gap = f"{where}{row['method']} {met} ({share_text(row)}{failed})", difference_text(row)
    return f"{start}." if gap == "-" else f"{start}: {gap} against {trials.baseline} ({row['n_pairs']} paired runs)."


REQUIREMENTS = "requirements"  # name of the table
