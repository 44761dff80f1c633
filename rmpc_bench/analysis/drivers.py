"""Drivers: which uncertain quantity explains how much of the spread of a method's result over the runs.

The shares, the response and the regions where a method does worst are those of `rmpc_bench.analysis.responses`.  A
share is resolved where its interval excludes 0, the share of a quantity without effect, or lies below `SMALL`: the
quantity then explains about nothing.  That a quantity explains nothing is not resolved if it is correlated with another
one, which may explain in its place.  Below `FEWEST` runs nothing is resolved.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import Rows, rows_at
from rmpc_bench.analysis.responses import (
    SHARE,
    RegionMean,
    Response,
    most_failures,
    regions,
    response_of,
    shares,
    standardised,
    surface_for,
    worst_means,
)
from rmpc_bench.analysis.rounding import NEGLIGIBLE, decimal_text, without_noise
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array, MetricInfo

FEWEST = 50
"""Runs below which no share is resolved."""
SMALL = 0.05
"""A share whose interval lies below it is about nothing."""
REST = "(rest)"
"""Row of the variance that no quantity explains."""
FAILED = "failed"


COLUMNS = (
    "method metric response quantity share share_low share_high resolved n n_failed surface unit worst_part worst_from "
    "worst_to worst_n worst worst_low worst_high overall differs"
).split()
"""Columns of drivers.csv, a row of which says what one uncertain quantity does to one method.

method, metric : names
response : what is explained, such as ``log ratio``; ``failed`` in the row of the failed runs
quantity : name of the uncertain quantity; ``(rest)`` for what no quantity explains
share, share_low, share_high : share of the variance of the response with its interval; NaN where it is not computed
resolved : whether the interval excludes 0, or lies below 5 % without another quantity that is correlated, from at
    least 50 runs
n, n_failed : runs with a response, and runs in which the method or its baseline failed
surface : terms of the response surface: ``quadratic``, ``without interactions``, ``linear``; empty for none
unit : of `worst` and `overall`: % for ratios and shares, percentage points for differences of shares, else that of
    the metric
worst_part : fifth of the quantity with the worst mean response, such as ``lowest``; empty for a single value
worst_from, worst_to : smallest and largest value of the quantity in it
worst_n : its runs
worst, worst_low, worst_high : mean response in it, with its interval, simultaneous for all fifths
overall : mean response of all runs
differs : whether that interval lies on the worse side of the mean of all runs
"""
_UNKNOWN = {"resolved": False, "surface": "", "worst_part": "", "worst_n": 0, "differs": False}
_EMPTY: dict[str, Any] = dict.fromkeys(COLUMNS, math.nan) | _UNKNOWN
"""A row of which nothing is computed."""


@dataclass(frozen=True, eq=False)
class Inputs:
    """The uncertain quantities of a table, one row per run."""

    values: Mapping[str, Array]  # quantity -> (n_runs,) values in the order of `Trials.runs`
    constant: tuple[str, ...]  # quantities that have one value in all runs

    @property
    def correlated(self) -> tuple[tuple[str, str], ...]:
        """Pairs of quantities whose correlation exceeds 1/2, which share what they explain."""
        return _correlated(self.values)


def _correlated(values: Mapping[str, Array]) -> tuple[tuple[str, str], ...]:
    """Return the pairs of quantities whose correlation exceeds 1/2; a constant one is correlated with none."""
    names = [name for name, column in values.items() if not _is_constant(column)]
    if len(names) < 2:
        return ()
    found = np.abs(np.corrcoef(np.array([values[name] for name in names])))
    pairs = [(i, j) for i in range(len(names)) for j in range(i) if found[i, j] > 0.5]
    return tuple((names[j], names[i]) for i, j in pairs)


def inputs(trials: Trials) -> Inputs:
    """Collect the uncertain quantities that differ between the runs of a table."""
    table = trials.quantities
    if "run" not in table or not len(trials.runs) or not np.isin(trials.runs, table["run"]).all():
        return Inputs({}, ())
    rows = rows_at(table, np.searchsorted(table["run"], trials.runs))
    # At a point of a sweep where a quantity does not exist its column is empty.
    values = {name: column for name, column in rows.items() if name != "run" and np.isfinite(column).all()}
    constant = [name for name, column in values.items() if _is_constant(column)]
    return Inputs({name: column for name, column in values.items() if name not in constant}, tuple(constant))


def drivers(trials: Trials) -> Rows:
    """Compute the drivers of every method: a row per quantity, one for the rest, one that says where it fails."""
    info, found = trials.primary_info, inputs(trials)
    rows: list[dict[str, Any]] = []
    if info is None or not found.values:
        return rows
    responses = [response_of(trials, method, info) for method in trials.methods]
    computed = _computed(trials, info, responses, found)
    for response in responses:
        failed = trials.failed(response.method) | trials.failed(trials.baseline)
        row = _EMPTY | {
            "method": response.method,
            "metric": info.name,
            "response": response.kind,
            "n": int(response.known.sum()),
            "n_failed": int(failed.sum()),
            "unit": response.unit(info),
        }
        cells = computed.get(response.method, {})
        rows += [row | {"quantity": name} | cells.get(name, {}) for name in [*found.values, REST]]
        rows += _failure_row(trials, response.method, info, found)
    return rows


_Cells = dict[str, dict[str, dict[str, Any]]]
"""Method -> quantity -> cells of its share, and of the region where the method does worst."""


def _computed(trials: Trials, info: MetricInfo, responses: Sequence[Response], found: Inputs) -> _Cells:
    """Compute the cells of all methods; those with responses in the same runs together."""
    groups: dict[bytes, list[Response]] = {}
    for response in responses:
        if response.has_spread and response.known.sum() >= FEWEST:
            groups.setdefault(response.known.tobytes(), []).append(response)
    cells: _Cells = {}
    for group in groups.values():
        columns = {name: column[_selected(group[0])] for name, column in found.values.items()}
        cells |= _of_group(trials, info, group, columns)
    return cells


def _selected(response: Response) -> Array | slice:
    """Return what selects the runs with a response; for all runs a slice, since a mask would copy every column."""
    return slice(None) if response.known.all() else response.known


def _of_group(trials: Trials, info: MetricInfo, group: Sequence[Response], columns: Mapping[str, Array]) -> _Cells:
    varying = [name for name, column in columns.items() if not _is_constant(column)]
    values = standardised(np.column_stack([columns[name] for name in varying]))
    surface = surface_for(values)
    if surface is None:
        return {}
    numbers = [response.values[_selected(response)] for response in group]
    of = shares(values, np.column_stack(numbers), surface, trials.confidence, trials.seed)
    parts, shared = list(regions(columns)), {name for pair in _correlated(columns) for name in pair}
    places, cells = {name: place for place, name in enumerate([*varying, REST])}, _Cells()
    for number, response in enumerate(group):
        worst = worst_means(
            columns,
            numbers[number],
            trials.confidence,
            higher=info.direction == "higher",
            interval=response.interval,
            parts=parts,
        )
        own = cells[response.method] = {name: _region(each, response) for name, each in worst.items()}
        for name in [*columns, REST]:
            # Quantities that are constant in the runs that are left explain nothing.
            place = places.get(name)
            share, low, high = (0.0 if place is None else without_noise(float(part[number, place]), 1.0) for part in of)
            resolved = low > 0 or (high < SMALL and name not in shared)
            found = {"share": share, "share_low": low, "share_high": high, "resolved": resolved}
            own[name] = own.get(name, {}) | found | {"surface": surface.form}
    return cells


def _region(found: RegionMean, response: Response) -> dict[str, Any]:
    """Return the columns of a region, in the unit in which a response is written."""
    region = found.region
    numbers = (found.mean, *found.interval, found.overall)
    shown = [response.shown(without_noise(number, max(1.0, abs(found.overall)))) for number in numbers]
    return {
        "worst_part": region.name,
        "worst_from": region.low,
        "worst_to": region.high,
        "worst_n": int(region.inside.sum()),
        **dict(zip(("worst", "worst_low", "worst_high", "overall"), shown, strict=True)),
        "differs": found.differs,
    }


def _failure_row(trials: Trials, method: str, info: MetricInfo, found: Inputs) -> list[dict[str, Any]]:
    """Return the row that says where a method fails; none with too few failed runs."""
    failed = trials.failed(method)
    worst = most_failures(found.values, failed, trials.confidence)
    if worst is None:
        return []
    names = {"method": method, "metric": info.name, "response": FAILED, "quantity": worst.region.quantity, "unit": "%"}
    numbers = {"n": len(failed), "n_failed": int(failed.sum())}
    return [_EMPTY | names | numbers | _region(worst, Response(method, SHARE, failed.astype(float)))]


def _is_constant(column: Array) -> bool:
    return float(np.ptp(column)) <= NEGLIGIBLE * float(np.abs(column).max(initial=0.0))


LITTLE = "the uncertain quantities explain little of the change"
"""What is said where no quantity is named."""
MOST_OF = 0.5
"""Share from which on a quantity alone is named."""
MUCH_OF = 0.25
"""Share from which on two quantities are named."""


def share_text(row: Mapping[str, Any]) -> str:
    """Write a share of a row of `drivers` with its interval, such as ``79 % [67, 85]``; ``-`` for an unclear one."""
    if math.isnan(row["share"]):
        return "-"
    low, high = (per_cent(row[name]) for name in ("share_low", "share_high"))
    if not row["resolved"]:
        return f"- [{low}, {high}]"
    return f"{per_cent(row['share'])} % [{low}, {high}]"


def per_cent(share: float) -> str:
    """Write a share as a whole number of per cent between 0 and 100."""
    return decimal_text(min(100.0, max(0.0, 100 * float(share))), 0)


def gist(rows: Rows, baseline: str) -> str:
    """Say what drives the changes from the baseline, such as ``mostly eps``; empty where no share is resolved.

    The rows are those of `drivers` at one point.  A baseline that is alone is meant with its own metric.
    """
    of_each = [row for row in rows if row["quantity"] != REST and row["response"] != "failed"]
    of_each = [row for row in of_each if row["method"] != baseline] or of_each
    known = [row for row in of_each if row["resolved"] and row["n"] >= FEWEST]
    largest: dict[str, float] = {}
    for row in known:
        largest[str(row["quantity"])] = max(float(row["share"]), largest.get(str(row["quantity"]), 0.0))
    names = sorted(largest, key=lambda name: -largest[name])
    if not names:
        return ""
    if largest[names[0]] > MOST_OF:
        return f"mostly {names[0]}"
    if len(names) > 1 and largest[names[1]] > MUCH_OF:
        return f"{names[0]} and {names[1]}"
    return LITTLE
