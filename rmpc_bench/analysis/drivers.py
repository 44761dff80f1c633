"""Drivers: which uncertain quantity explains how much of the spread of a method's result over the runs.

The shares, the response and the regions where a method does worst are those of `rmpc_bench.analysis.responses`.  A
share is resolved where its interval excludes 0, the share of a quantity without effect, or lies below `SMALL`: the
quantity then explains about nothing.  That a quantity explains nothing is not resolved if it is correlated with another
one, which may explain in its place.  Below `FEWEST` runs nothing is resolved.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import Rows, rows_at
from rmpc_bench.analysis.responses import (
    Region,
    RegionMean,
    Response,
    Shares,
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


@dataclass(frozen=True, kw_only=True)
class Driver:
    """What one uncertain quantity does to one method; a row of drivers.csv.

    Parameters
    ----------
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

    method: str
    metric: str
    response: str
    quantity: str
    share: float = math.nan
    share_low: float = math.nan
    share_high: float = math.nan
    resolved: bool = False
    n: int
    n_failed: int
    surface: str = ""
    unit: str = ""
    worst_part: str = ""
    worst_from: float = math.nan
    worst_to: float = math.nan
    worst_n: int = 0
    worst: float = math.nan
    worst_low: float = math.nan
    worst_high: float = math.nan
    overall: float = math.nan
    differs: bool = False


COLUMNS = [field.name for field in fields(Driver)]


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


def drivers(trials: Trials, info: MetricInfo | None = None, *, with_regions: bool = True) -> Rows:
    """Compute the drivers of every method: a row per quantity, one for the rest, one that says where it fails."""
    metric, found = info or trials.primary_info, inputs(trials)
    rows: list[Driver] = []
    if metric is not None and found.values:
        responses = [response_of(trials, method, metric) for method in trials.methods]
        computed = _computed(trials, responses, found)
        inside: dict[bytes, _Varied] = {}
        for response in responses:
            fit = computed.get(response.method)
            worst: dict[str, RegionMean] = {}
            shared: set[str] = set()
            if fit is not None:
                known = response.known
                # Methods with responses in the same runs have the same regions.
                varied = inside.setdefault(known.tobytes(), _Varied(found, known))
                shared = varied.shared
                worst = varied.worst(response, metric, trials.confidence) if with_regions else {}
            failed = trials.failed(response.method) | trials.failed(trials.baseline)
            rows += _rows(response, metric, found, fit, worst, shared, int(failed.sum()))
            rows += _failure_row(trials, response, metric, found) if with_regions else ()
    return [asdict(row) for row in rows]


@dataclass(frozen=True)
class _Fit:
    """Shares of one method: (quantities + 1,) arrays."""

    form: str
    value: Array
    low: Array
    high: Array


def _computed(trials: Trials, responses: Sequence[Response], found: Inputs) -> dict[str, _Fit]:
    """Compute the shares of all methods; those with responses in the same runs together."""
    groups: dict[bytes, list[Response]] = {}
    for response in responses:
        if response.has_spread and response.known.sum() >= FEWEST:
            groups.setdefault(response.known.tobytes(), []).append(response)
    fits: dict[str, _Fit] = {}
    for group in groups.values():
        known = group[0].known
        columns = [column[known] for column in found.values.values()]
        varying = [place for place, column in enumerate(columns) if not _is_constant(column)]
        values = standardised(np.column_stack([columns[place] for place in varying]))
        surface = surface_for(values)
        if surface is None:
            continue
        matrix = np.column_stack([response.values[known] for response in group])
        of = shares(values, matrix, surface, trials.confidence, trials.seed)
        places = [*varying, len(columns)]
        for number, response in enumerate(group):
            fits[response.method] = _Fit(surface.form, *_placed(of, number, places, len(columns) + 1))
    return fits


def _placed(of: Shares, number: int, places: Sequence[int], length: int) -> Iterator[Array]:
    """Yield value, low and high of one response, 0 for quantities that are constant in the runs that are left."""
    for part in of:
        column = np.zeros(length)
        column[list(places)] = [without_noise(float(entry), 1.0) for entry in part[number]]
        yield column


class _Varied:
    """The uncertain quantities in the runs that have a response; what is found of them once for several methods."""

    def __init__(self, found: Inputs, known: Array) -> None:
        self._found, self._known = found, known

    @cached_property
    def _values(self) -> dict[str, Array]:
        return {name: column[self._known] for name, column in self._found.values.items()}

    @cached_property
    def _regions(self) -> list[Region]:
        return list(regions(self._values))

    @cached_property
    def shared(self) -> set[str]:
        """Quantities that are correlated with another one."""
        return {name for pair in _correlated(self._values) for name in pair}

    def worst(self, response: Response, info: MetricInfo, confidence: float) -> dict[str, RegionMean]:
        """Find where a response is worst; quantity -> region."""
        higher, numbers = info.direction == "higher", response.values[self._known]
        return worst_means(
            self._values, numbers, confidence, higher=higher, interval=response.interval, parts=self._regions
        )


def _rows(
    response: Response,
    info: MetricInfo,
    found: Inputs,
    fit: _Fit | None,
    worst: Mapping[str, RegionMean],
    shared: Set[str],
    n_failed: int,
) -> Iterator[Driver]:
    known = response.known
    n = int(known.sum())
    for place, name in enumerate([*found.values, REST]):
        row = Driver(
            method=response.method,
            metric=info.name,
            response=response.kind,
            quantity=name,
            n=n,
            n_failed=n_failed,
            unit=response.unit(info),
        )
        changes: dict[str, object] = {}
        if fit is not None:
            low, high = float(fit.low[place]), float(fit.high[place])
            resolved = low > 0 or (high < SMALL and name not in shared)
            changes |= {"share": float(fit.value[place]), "share_low": low, "share_high": high, "resolved": resolved}
            changes["surface"] = fit.form
        if name in worst:
            changes |= _region(worst[name], response)
        yield Driver(**{**asdict(row), **changes})


def _region(found: RegionMean, response: Response) -> dict[str, object]:
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


def _failure_row(trials: Trials, response: Response, info: MetricInfo, found: Inputs) -> Iterator[Driver]:
    """Yield the row that says where a method fails."""
    failed = trials.failed(response.method)
    worst = most_failures(found.values, failed, trials.confidence)
    if worst is None:
        return
    indicator = Response(response.method, "not occurring", failed.astype(float))
    row = Driver(
        method=response.method,
        metric=info.name,
        response=FAILED,
        quantity=worst.region.quantity,
        n=len(failed),
        n_failed=int(failed.sum()),
        unit="%",
    )
    yield Driver(**{**asdict(row), **_region(worst, indicator)})


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
