"""Tables of docs/servo-constrained.md, from the kept results of the configurations.

`docs.pages` (``make docs``) writes each of them into the page, between the markers with its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import pandas as pd
from docs.markdown import DOCS, ROOT, table

from rmpc_bench.analysis.intervals import wilson

PAGE = DOCS / "servo-constrained.md"
SERVO, PLACEMENT = "servo-constrained", "model.disturbance"


def kept(group: str, name: str) -> pd.DataFrame:
    """Return the kept summary of a configuration: one row per point of the sweep, method and metric."""
    path = ROOT / "results" / group / name / "summary.csv"
    return pd.read_csv(path, dtype={"name": str, "noise": str}, keep_default_na=False, na_values=[""])


def number_of(frame: pd.DataFrame, metric: str, column: str = "mean", **point: str) -> float:
    """Return a number of one method at one point, which is given by columns of the table or by the table."""
    row = frame[frame["metric"] == metric]
    for key, value in point.items():
        row = row[row[key] == value]
    assert len(row) == 1, (metric, point, len(row))
    return float(row[column].iloc[0])


def runaways(frame: pd.DataFrame) -> str:
    """Return the number of runaways with the interval of their share."""
    n, share = int(number_of(frame, "runaway", "n")), number_of(frame, "runaway")
    count = round(n * share)
    low, high = wilson(count, n, 0.95)
    return f"{count}/{n} [{100 * low:.1f}, {100 * high:.1f}] %"


def percent(value: float) -> str:
    """Return a share in per cent; a dash where the method has no such share."""
    return "-" if math.isnan(value) else f"{100 * value:.2f} %"


COLUMNS: Mapping[str, Callable[[pd.DataFrame], str]] = {
    "mean MSE [rad^2]": lambda frame: f"{number_of(frame, 'mse'):.4f}",
    "median MSE [rad^2]": lambda frame: f"{number_of(frame, 'mse', 'median'):.4f}",
    "roughness [V]": lambda frame: f"{number_of(frame, 'input_roughness'):.1f}",
    "samples above": lambda frame: percent(number_of(frame, "above")),
    "largest [N m]": lambda frame: f"{number_of(frame, 'torque', 'max'):.0f}",
    "runaways": runaways,
    "skipped": lambda frame: percent(number_of(frame, "qp_skipped")),
    "softened": lambda frame: percent(number_of(frame, "qp_softened")),
}


def limits_table() -> str:
    """Clipping, the quadratic program, and two penalties of the torque limit."""
    frame = kept(SERVO, "clip-against-qp")
    heads = [head for head in COLUMNS if head != "roughness [V]"]
    rows = [(method, *(COLUMNS[head](mine) for head in heads)) for method, mine in frame.groupby("method", sort=False)]
    return table(["method", *heads], rows)


def points_table(group: str, name: str, column: str, head: str) -> str:
    """Return a column of every method at every point of a sweep."""
    frame = kept(group, name)
    points = [*dict.fromkeys(frame[column])]
    rows = [
        (method, *(COLUMNS[head](mine[mine[column] == point]) for point in points))
        for method, mine in frame.groupby("method", sort=False)
    ]
    return table(["method", *points], rows)


def baselines_table() -> str:
    """PID and LQG beside predictive control, without noise and with a tenth of it."""
    frame = kept(SERVO, "baselines")
    cells: Sequence[tuple[str, str]] = [
        *(("s=0", head) for head in list(COLUMNS)[:4]),
        *(("s=0.1", head) for head in ("mean MSE [rad^2]", "roughness [V]")),
    ]
    rows = [
        (method, *(COLUMNS[head](mine[mine["name"] == point]) for point, head in cells))
        for method, mine in frame.groupby("method", sort=False)
    ]
    return table(["method", *(f"{head}, {point}" for point, head in cells)], rows)


TABLES: Mapping[str, Callable[[], str]] = {
    "limits": limits_table,
    "placement": lambda: points_table(SERVO, "placement", PLACEMENT, "runaways"),
    "rivals": lambda: points_table("zenere2018", "rivals", "name", "mean MSE [rad^2]"),
    "baselines": baselines_table,
}
