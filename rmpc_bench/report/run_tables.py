"""Tables beside those of the metrics: error at the end, worst runs, lost runs, and what drives the differences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from rmpc_bench.analysis.driver_text import share_text
from rmpc_bench.analysis.drivers import FEWEST, REST, drivers
from rmpc_bench.analysis.lost_runs import lost_runs
from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.analysis.pairs import distance_from_best, name_of_distance
from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.analysis.tails import tails
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import marked
from rmpc_bench.report.point_tables import columns_from, markdown_page, markdown_table, stacked_points
from rmpc_bench.report.run_notes import counted
from rmpc_bench.types import Array, MetricInfo
from rmpc_bench.types.texts import inert_markdown


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
        last: Array = trials.matrix_series(quantity, method)[-1]
    except KeyError:
        return None
    return last


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.4g}" for value in values)


def ensemble_markdown(trials: Trials) -> str:
    """Lay the table out as Markdown; empty where there is none."""
    rows = ensemble_rows(trials)
    if not rows:
        return ""
    title = f": {trials.title}" if trials.title else ""
    head = inert_markdown(f"## Ensemble of the error at the end{title}")
    return "\n".join([head, "", markdown_table(columns_from(rows)), "", "Bias, variance and P by component.", ""])


FEWEST_RUNS = 20  # runs below which the worst 5 % are less than one run


def worst_runs_columns(trials: Trials, metrics: Sequence[MetricInfo] | None = None) -> dict[str, list[str]]:
    """Return head -> cells at one point for some metrics or all; empty with few runs and where nothing is estimated."""
    if len(trials.runs) < FEWEST_RUNS or trials.alike or not trials.with_verdicts:
        return {}
    trials = trials if metrics is None else trials.with_numbers(trials.frame, metrics=tuple(metrics))
    infos = {info.name: info for info in trials.metrics}
    table = tails(trials).sort_values("metric", key=lambda names: names.map(list(infos).index), kind="stable")
    return columns_from(_cells(trials, row, infos[row["metric"]]) for row in table.to_dict("records"))


def worst_runs(trials: Trials, info: MetricInfo) -> dict[str, tuple[float, int]]:
    """Return method -> distance from the best value and index of its worst finished run, the first of equal ones."""
    found = {}
    for method in trials.methods:
        values = distance_from_best(trials.column(info.name, method), info.direction)
        if np.isnan(values).all():
            continue
        place = int(np.nanargmin(values) if info.direction == "higher" else np.nanargmax(values))
        found[method] = float(values[place]), int(trials.runs[place])
    return found


def _cells(trials: Trials, row: Mapping[Any, Any], info: MetricInfo) -> dict[str, str]:
    quantile = "5 %" if info.direction == "higher" else "95 %"
    unit = f" [{info.unit}]" if info.unit else ""
    worst = "-" if math.isnan(row["worst"]) else f"{row['worst']:.4g} (run {row['worst_run']})"
    return {
        "metric": name_of_distance(info) + unit,
        "method": marked(trials, row["method"]),
        "95 % quantile": _tail_text(row, "tail_quantile") + (f" ({quantile})" if quantile != "95 %" else ""),
        "mean of the worst 5 %": _tail_text(row, "cvar"),
        "worst finished run": worst,
    }


def _tail_text(row: Mapping[Any, Any], name: str) -> str:
    value = float(row[name])
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return interval_text(value, float(row[f"{name}_low"]), float(row[f"{name}_high"]), sign=False)


def lost_table(trials: Trials) -> pd.DataFrame:
    """Return the content of lost.csv: sweep columns, then one row per method; empty where no factor is given."""
    table = stacked_points([(point, lost_runs(point)) for point in trials.each])
    shares = ["lost_pct", "lost_low", "lost_high"]
    table[shares] = rounded(table[shares].to_numpy(dtype=float), 100.0)
    return table


MOST_POINTS = 12  # points of a sweep whose drivers stand in tables/drivers.md; drivers.csv has all
DRIVERS_NOTE = (
    "Share: what the adjusted R^2 of a quadratic response surface loses without all terms of a quantity. It is the "
    f"total effect of the quantity, interactions included, so that shares need not sum to 100 %. Brackets: interval "
    f"from a bootstrap of whole runs. No share (-): below {FEWEST} runs, an interval that contains 0 and reaches "
    "beyond 5 %, or a share of about 0 of a quantity that is correlated with another one."
)


@dataclass(frozen=True, eq=False)
class DriversTable:
    """Drivers of the primary metric."""

    points: Sequence[tuple[Trials, pd.DataFrame]]  # each with its drivers, see `rmpc_bench.analysis.drivers`

    @property
    def frame(self) -> pd.DataFrame:
        """Content of drivers.csv: sweep columns, then one row per method and quantity."""
        return stacked_points(list(self.points))

    def to_markdown(self) -> str:
        """Return a table for every point; empty where nothing is uncertain."""
        parts = []
        for trials, frame in self.points[:MOST_POINTS]:
            if len(frame):
                parts += [f"# {trials.title}"] * bool(trials.title) + [markdown_table(_columns(frame))]
        left = sum(len(frame) > 0 for _, frame in self.points[MOST_POINTS:])
        parts += [f"{counted(left, 'more point')} of the sweep: drivers.csv"] if left else []
        return markdown_page([*parts, DRIVERS_NOTE] if parts else [])

    def __str__(self) -> str:
        return self.to_markdown()


def drivers_table(trials: Trials) -> DriversTable:
    """Compute the drivers of the primary metric at every point of a sweep."""
    return DriversTable([(point, drivers(point)) for point in trials.each])


def _columns(frame: pd.DataFrame) -> dict[str, list[str]]:
    """Return head -> cells, a row per method."""
    found = []
    shares = frame[frame["response"] != "failed"]
    for method, rows in shares.groupby("method", sort=False):
        records = rows.to_dict("records")
        # Heads of two words cannot be names of quantities.
        cells = {"variance of": f"{method}: {records[0]['response']} of {records[0]['metric']}"}
        cells |= {"not explained" if row["quantity"] == REST else row["quantity"]: share_text(row) for row in records}
        cells |= {"number of runs": str(records[0]["n"]), "failed runs left out": str(records[0]["n_failed"])}
        found.append(cells)
    return columns_from(found)
