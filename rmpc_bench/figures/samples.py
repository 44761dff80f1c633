"""Values over the samples, exact or from runs, read from the stored series and cut to the window of a figure."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.figures.window import TimeWindow
from rmpc_bench.types import Array

if TYPE_CHECKING:
    import pandas as pd


class Curve(NamedTuple):
    """Values of one component over the samples."""

    k: Array
    values: Array

    def at(self, k: int) -> float:
        """Value at a sample, NaN where there is none; a constant has it at every sample."""
        found = self.values if len(self.k) == 1 else self.values[self.k == k]
        return float(found[0]) if len(found) else np.nan


class SeriesComponent(NamedTuple):
    """A component of a series: its exact values, those from runs, or both."""

    exact: Curve | None
    runs: Curve | None
    n_runs: frozenset[int] = frozenset()
    """Numbers of runs, more than one where it changes from sample to sample."""
    counts: Array | None = None
    """(samples,) numbers of runs at the samples of `runs`."""

    @property
    def best(self) -> Curve:
        """The exact values where they exist, else those from runs."""
        found = self.exact or self.runs
        assert found is not None, "made from at least one row"
        return found


def component_of(rows: pd.DataFrame) -> SeriesComponent:
    """Read one component of one method; of values from runs, those from most runs count at every sample."""
    rows = rows.sort_values(["k", "n"])
    exact, sampled = rows[rows["n"] == 0], rows[rows["n"] > 0].drop_duplicates("k", keep="last")
    counts = sampled["n"].to_numpy(dtype=np.int64)
    return SeriesComponent(_curve(exact), _curve(sampled), frozenset(map(int, counts)), counts)


def components(
    point_series: pd.DataFrame, quantity: str, methods: Iterable[str]
) -> dict[str, dict[str, SeriesComponent]]:
    """Read all components of a quantity by method and component, without the methods that do not have it."""
    table = point_series[point_series["quantity"] == quantity]
    found: dict[str, dict[str, SeriesComponent]] = {}
    for name in methods:
        own = table[table["method"] == name]
        if len(own):
            found[name] = {
                str(component): component_of(rows) for component, rows in own.groupby("component", sort=False)
            }
    return found


def cut(curve: Curve, window: TimeWindow) -> Curve | None:
    """Cut a curve to a window: a constant covers it; None if the curve ends before it."""
    if len(curve.k) == 1:
        return Curve(np.array([window.first, window.last]), np.repeat(curve.values, 2))
    inside = (curve.k >= window.first) & (curve.k <= window.last)
    return Curve(curve.k[inside], curve.values[inside]) if inside.any() else None


def _curve(rows: pd.DataFrame) -> Curve | None:
    return Curve(rows["k"].to_numpy(dtype=np.int64), rows["value"].to_numpy(dtype=float)) if len(rows) else None
