"""Values over the samples, read from the series of a table, exact or from runs, and cut to what a picture shows."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pandas as pd

from rmpc_bench.figures.curves import Window
from rmpc_bench.types import Array


class Curve(NamedTuple):
    """Values of one component over the samples."""

    k: Array
    values: Array

    def at(self, k: int) -> float:
        """Value at a sample, NaN where there is none; a constant has it at every sample."""
        found = self.values if len(self.k) == 1 else self.values[self.k == k]
        return float(found[0]) if len(found) else np.nan


class Known(NamedTuple):
    """The same component, known exactly, from runs, or in both ways."""

    exact: Curve | None
    runs: Curve | None
    n_runs: frozenset[int] = frozenset()
    """Numbers of runs, more than one where it changes from sample to sample."""

    @property
    def best(self) -> Curve:
        """The exact values where they exist, else those from runs."""
        found = self.exact or self.runs
        assert found is not None, "made from at least one row"
        return found


def known(rows: pd.DataFrame) -> Known:
    """Read one component of one method; of values from runs those count, at every sample, that come from most runs.

    Parameters
    ----------
    rows : at least one row of `Trials.series`
    """
    rows = rows.sort_values(["k", "n"])
    exact, sampled = rows[rows["n"] == 0], rows[rows["n"] > 0].drop_duplicates("k", keep="last")
    return Known(_curve(exact), _curve(sampled), frozenset(map(int, sampled["n"])))


def components(point_series: pd.DataFrame, quantity: str, methods: Iterable[str]) -> dict[str, dict[str, Known]]:
    """Read all components of a quantity.

    Parameters
    ----------
    point_series : the series of a point, as `Trials.series` has them
    quantity : name of the quantity
    methods : the methods that count, in the order wanted

    Returns
    -------
    method -> component -> values; without the methods that do not have the quantity
    """
    table = point_series[point_series["quantity"] == quantity]
    found: dict[str, dict[str, Known]] = {}
    for name in methods:
        own = table[table["method"] == name]
        if len(own):
            found[name] = {str(component): known(rows) for component, rows in own.groupby("component", sort=False)}
    return found


def cut(curve: Curve, window: Window) -> Curve | None:
    """Cut a curve to a window; a constant goes through, of what ends before nothing is left.

    Parameters
    ----------
    curve : the curve
    window : the samples to show
    """
    if len(curve.k) == 1:
        return Curve(np.array([window.first, window.last]), np.repeat(curve.values, 2))
    inside = (curve.k >= window.first) & (curve.k <= window.last)
    return Curve(curve.k[inside], curve.values[inside]) if inside.any() else None


def _curve(rows: pd.DataFrame) -> Curve | None:
    return Curve(rows["k"].to_numpy(dtype=np.int64), rows["value"].to_numpy(dtype=float)) if len(rows) else None
