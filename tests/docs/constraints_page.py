"""Tables of docs/servo-constrained.md, from the kept results of the configurations.

`docs.pages` (``make docs``) writes each of them into the page, between the markers with its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import pandas as pd
from docs.markdown import DOCS, ROOT, filled, table

from rmpc_bench.analysis.intervals import wilson

PAGE = DOCS / "servo-constrained.md"
SERVO, PLACEMENT = "servo-constrained", "model.disturbance"
FILTERS = {
    "S": "S",
    "R1": "R1",
    "RS": "RS",
    "R-c3": "R, c = 3",
    "S-process": "S, 100 times the process covariance",
    "S+input": "S + input",
}
"""Method -> its name on the page."""
RIVALS = {
    "S-MPC": "S, untuned",
    "R-MPC1": "R1, untuned",
    "R-tuned": "R",
    "RS-tuned": "RS",
    "S-process": "S, process noise",
    "S-input": "S + input disturbance",
    "S-load": "S + load disturbance",
    "R-input": "R1 + input disturbance",
}
BASELINES = {
    "S-MPC": "S, untuned",
    "R-MPC1": "R1, untuned",
    "S-tuned": "S, weight of the input tuned",
    "R1-tuned": "R1, weight of the input tuned",
    "S-input": "S + input, weight of the input tuned",
    "PID": "PID, time constant of the rule tuned",
    "LQG": "LQG, weight of the integral tuned",
}


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


def runaways(frame: pd.DataFrame, **point: str) -> str:
    """Return the number of runaways with the interval of their share."""
    n, share = int(number_of(frame, "runaway", "n", **point)), number_of(frame, "runaway", **point)
    count = round(n * share)
    low, high = wilson(count, n, 0.95)
    return f"{count} of {n} [{100 * low:.1f}, {100 * high:.1f}] %"


def percent(value: float) -> str:
    """Return a share in per cent; a dash where the method has no such share."""
    return "-" if math.isnan(value) else f"{100 * value:.2f} %"


def limits_table() -> str:
    """Clipping, the quadratic program, and two penalties of the torque limit."""
    frame, rows = kept(SERVO, "clip-against-qp"), []
    for method in ("S", "R1", "RS", "S+input"):
        for controller in ("clip", "qp", "light", "exact"):
            mine = frame[frame["method"] == f"{method} {controller}"]
            mse = (f"{number_of(mine, 'mse', column):.4f}" for column in ("mean", "median"))
            torque = percent(number_of(mine, "above")), f"{number_of(mine, 'torque', 'max'):.0f}"
            shares = (percent(number_of(mine, name)) for name in ("qp_skipped", "qp_softened"))
            rows.append((FILTERS[method], controller, *mse, *torque, runaways(mine), *shares))
    torque_heads = ("samples above", "largest [N m]", "runaways", "skipped", "softened")
    return table(["filter", "controller", "mean MSE [rad^2]", "median MSE [rad^2]", *torque_heads], rows)


def placement_table() -> str:
    """Runaways of every filter with every disturbance model."""
    frame = kept(SERVO, "placement")
    methods = [*dict.fromkeys(frame["method"])]
    rows = [
        (point, *(runaways(frame, method=method, **{PLACEMENT: point}) for method in methods))
        for point in dict.fromkeys(frame[PLACEMENT])
    ]
    return table(["disturbance model", *(FILTERS[method] for method in methods)], rows)


def rivals_table() -> str:
    """Mean MSE of all filters for every noise, each tuned at its own noise."""
    frame = kept("zenere2018", "rivals")
    names = [*dict.fromkeys(frame["name"])]
    rows = [
        (title, *(f"{number_of(frame, 'mse', method=method, name=name):.4f}" for name in names))
        for method, title in RIVALS.items()
    ]
    return table(["filter", *names], rows)


def baselines_table() -> str:
    """PID and LQG beside predictive control, without noise and with a tenth of it."""
    frame, rows = kept(SERVO, "baselines"), []
    for method, title in BASELINES.items():
        quiet, noisy = (frame[(frame["method"] == method) & (frame["name"] == name)] for name in ("s=0", "s=0.1"))
        mse = (f"{number_of(quiet, 'mse', column):.4f}" for column in ("mean", "median"))
        rough, noisy_rough = (f"{number_of(each, 'input_roughness'):.1f}" for each in (quiet, noisy))
        rows.append(
            (title, *mse, rough, percent(number_of(quiet, "above")), f"{number_of(noisy, 'mse'):.4f}", noisy_rough)
        )
    heads = ["controller", "mean MSE [rad^2]", "median MSE [rad^2]", "roughness [V]", "samples above"]
    return table([*heads, "mean MSE, s = 0.1 [rad^2]", "roughness, s = 0.1 [V]"], rows)


TABLES: Mapping[str, Callable[[], str]] = {
    "limits": limits_table,
    "placement": placement_table,
    "rivals": rivals_table,
    "baselines": baselines_table,
}


def generated() -> str:
    """Return the text of the page."""
    return filled(PAGE.read_text(encoding="utf-8"), TABLES)
