"""Tables of docs/constraints.md, from the kept results of the configurations.

`docs.pages` (``make docs``) writes each of them into the page, between the markers with its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import pandas as pd
from docs.markdown import DOCS, ROOT, filled, table

from rmpc_bench.analysis.intervals import wilson
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load

PAGE = DOCS / "constraints.md"
SERVO, PLACEMENT = "servo-constrained", "model.disturbance"
CONFIDENCE = 0.95
FILTERS = {
    "S": "S",
    "R1": "R1",
    "RS": "RS",
    "R-c3": "R, c = 3",
    "S-process": "S, 100 times the process covariance",
    "S+input": "S + input",
}
"""Method -> its name on the page."""
MSE_HEADS = ("mean MSE [rad^2]", "median MSE [rad^2]")
TORQUE_HEADS = (
    *MSE_HEADS,
    "samples above",
    "largest [N m]",
    "runaways",
    "skipped",
    "softened",
)
RIVALS = {
    "S-MPC": ("S, as the paper has it (untuned)", None),
    "R-MPC1": ("R1, as the paper has it (untuned)", None),
    "R-tuned": ("R", "estimator.c"),
    "RS-tuned": ("RS", "estimator.theta_from.c"),
    "S-process": ("S, process noise", "model.noise.process"),
    "S-input": ("S + input disturbance", "model.disturbance.drift"),
    "S-load": ("S + load disturbance", "model.disturbance.drift"),
    "R-input": ("R1 + input disturbance", "model.disturbance.drift"),
}
"""Method -> its name on the page, and the path of its tuned scalar."""
BASELINES = {
    "S-MPC": "S, untuned",
    "R-MPC1": "R1, untuned",
    "S-tuned": "S, weight of the input tuned",
    "R1-tuned": "R1, weight of the input tuned",
    "S-input": "S + input, weight of the input tuned",
    "PID": "PID, time constant of the rule tuned",
    "LQG": "LQG, weight of the integral tuned",
}
"""Method of servo-constrained/baselines -> its name on the page."""


def kept(group: str, name: str) -> pd.DataFrame:
    """Return the kept summary of a configuration: one row per point of the sweep, method and metric."""
    return pd.read_csv(
        ROOT / "results" / group / name / "summary.csv",
        dtype={"name": str, "noise": str},
        keep_default_na=False,
        na_values=[""],
    )


def number_of(frame: pd.DataFrame, metric: str, column: str = "mean") -> float:
    """Return a number of one method at one point."""
    row = frame[frame["metric"] == metric]
    assert len(row) == 1, (metric, len(row))
    return float(row[column].iloc[0])


def runaways(frame: pd.DataFrame) -> str:
    """Return the number of runaways with the interval of their share."""
    n, share = int(number_of(frame, "runaway", "n")), number_of(frame, "runaway")
    count = round(n * share)
    low, high = wilson(count, n, CONFIDENCE)
    return f"{count} of {n} [{100 * low:.1f}, {100 * high:.1f}] %"


def percent(value: float) -> str:
    """Return a share in per cent; a dash where the method has no such share."""
    return "-" if math.isnan(value) else f"{100 * value:.2f} %"


def numbers_of(frame: pd.DataFrame) -> tuple[str, ...]:
    """Return the cells of one method at one point."""
    mse = f"{number_of(frame, 'mse'):.4f}", f"{number_of(frame, 'mse', 'median'):.4f}"
    torque = percent(number_of(frame, "above")), f"{number_of(frame, 'torque', 'max'):.0f}"
    shares = [percent(number_of(frame, name)) for name in ("qp_skipped", "qp_softened")]
    return (*mse, *torque, runaways(frame), *shares)


def limits_table() -> str:
    """Clipping, the quadratic program, and two penalties of the torque limit."""
    frame, rows = kept(SERVO, "clip-against-qp"), []
    for method in ("S", "R1", "RS", "S+input"):
        for controller in ("clip", "qp", "light", "exact"):
            mine = frame[frame["method"] == f"{method} {controller}"]
            rows.append((FILTERS[method], controller, *numbers_of(mine)))
    return table(["filter", "controller", *TORQUE_HEADS], rows)


def penalty_table() -> str:
    """All values of the linear penalty."""
    return _of_torque("penalty", "controller.soft.shaft_torque.linear", "`linear`")


def horizon_table() -> str:
    """Horizons of prediction and of the torque limit."""
    return _of_torque("horizon", "name", "horizons")


def _of_torque(name: str, column: str, head: str) -> str:
    frame, rows = kept(SERVO, name), []
    for method in ("S", "R1", "S+input"):
        for point in dict.fromkeys(frame[column]):
            mine = frame[(frame["method"] == method) & (frame[column] == point)]
            rows.append((FILTERS[method], f"{point}", *numbers_of(mine)))
    return table(["filter", head, *TORQUE_HEADS], rows)


def placement_table() -> str:
    """Runaways of every filter with every disturbance model."""
    frame = kept(SERVO, "placement")
    methods = [*dict.fromkeys(frame["method"])]
    rows = []
    for point in dict.fromkeys(frame[PLACEMENT]):
        mine = {method: frame[(frame[PLACEMENT] == point) & (frame["method"] == method)] for method in methods}
        rows.append((point, *(runaways(mine[method]) for method in methods)))
    return table(["disturbance model", *(FILTERS[method] for method in methods)], rows)


def noise_table() -> str:
    """Samples above the limit and runaways for every noise."""
    frame = kept(SERVO, "noise")
    rows = []
    for method in ("S", "R1", "S+input"):
        for noise in dict.fromkeys(frame["noise"]):
            here = frame[(frame["method"] == method) & (frame["noise"] == noise)]
            each = [here[here["controller"] == point] for point in ("qp", "torque 0.03")]
            shares = [percent(number_of(one, "above")) for one in each]
            rows.append((FILTERS[method], noise, *shares, *map(runaways, each)))
    heads = ["filter", "noise", "samples above, `qp`", "samples above, torque 0.03"]
    return table([*heads, "runaways, `qp`", "runaways, torque 0.03"], rows)


def tuned_values() -> Mapping[str, Mapping[str, str]]:
    """Noise -> method -> value that rivals.yaml uses."""
    data = plain(load(ROOT / "configs" / "zenere2018" / "rivals.yaml"))
    rows = data["sweep"]["zip"]
    paths = {method: path for method, (_, path) in RIVALS.items() if path is not None}
    return {
        row["name"]: {method: str(row[f"methods.{method}.{path}"]) for method, path in paths.items()} for row in rows
    }


def short(value: str) -> str:
    """Return a number as short as possible; an expression as it is.

    Examples
    --------
    >>> short("100000.0"), short("10000"), short("0.001"), short("sqrt(30)")
    ('1e5', '1e4', '0.001', 'sqrt(30)')
    """
    try:
        number = float(value)
    except ValueError:
        return value
    exponent = f"{number:.0e}".replace("e+0", "e")
    return exponent if number >= 1e4 and float(exponent) == number else f"{number:g}"


def rivals_table() -> str:
    """All filters without noise."""
    frame, values = kept("zenere2018", "rivals"), tuned_values()["s=0"]
    frame = frame[frame["name"] == "s=0"]
    rows = []
    for method, (title, path) in RIVALS.items():
        mine = frame[frame["method"] == method]
        chosen = "" if path is None else f"`{path.rpartition('.')[2]}: {short(values[method])}`"
        mse = f"{number_of(mine, 'mse'):.4f}", f"{number_of(mine, 'mse', 'median'):.4f}"
        rows.append((title, chosen, *mse, f"{number_of(mine, 'input_roughness'):.2f}"))
    return table(["filter", "tuned value", *MSE_HEADS, "mean roughness of the input [V]"], rows)


def rivals_noise_table() -> str:
    """Mean MSE of all filters for every noise, each tuned at its own noise."""
    frame, values = kept("zenere2018", "rivals"), tuned_values()
    heads = ["noise", *(title for title, _ in RIVALS.values())]
    rows = []
    for noise, chosen in values.items():
        cells = []
        for method in RIVALS:
            mine = frame[(frame["name"] == noise) & (frame["method"] == method)]
            value = f" ({short(chosen[method])})" if method in chosen else ""
            cells.append(f"{number_of(mine, 'mse'):.4f}{value}")
        rows.append((noise, *cells))
    return table(heads, rows)


def baselines_table() -> str:
    """PID and LQG beside predictive control, without noise and with a tenth of it."""
    frame = kept(SERVO, "baselines")
    quiet, noisy = (frame[frame["name"] == point] for point in ("s=0", "s=0.1"))
    rows = []
    for method, title in BASELINES.items():
        mine, other = quiet[quiet["method"] == method], noisy[noisy["method"] == method]
        mse = f"{number_of(mine, 'mse'):.4f}", f"{number_of(mine, 'mse', 'median'):.4f}"
        roughness = f"{number_of(mine, 'input_roughness'):.1f}", f"{number_of(other, 'input_roughness'):.1f}"
        above, noisy_mse = percent(number_of(mine, "above")), f"{number_of(other, 'mse'):.4f}"
        rows.append((title, *mse, roughness[0], above, noisy_mse, roughness[1]))
    heads = ["controller", *MSE_HEADS, "roughness [V]", "samples above"]
    return table([*heads, "mean MSE, s = 0.1 [rad^2]", "roughness, s = 0.1 [V]"], rows)


def tuning_table() -> str:
    """The whole row of candidates without noise, with the chosen one in bold."""
    rows = []
    for method, (title, path) in RIVALS.items():
        if path is not None:
            row = candidates("s=0", method)
            best = min(row, key=lambda value: row[value])
            cells = [f"{'**' if value == best else ''}{row[value]:.5f}{'**' if value == best else ''}" for value in row]
            rows.append((f"{title}: {', '.join(map(short, row))}", *cells))
    return table(["filter: values", *(f"{number}." for number in range(1, 10))], rows)


def candidates(noise: str, method: str) -> dict[str, float]:
    """Return value -> mean MSE on the plants of the tuning, in the order of the file."""
    frame = kept("zenere2018", "rivals-tuning")
    column = f"methods.{method}.{RIVALS[method][1]}"
    frame = pd.read_csv(ROOT / "results" / "zenere2018" / "rivals-tuning" / "summary.csv", dtype={column: str})
    mine = frame[(frame["noise"] == noise) & (frame["method"] == method) & (frame["metric"] == "mse")]
    return dict(zip(mine[column], mine["mean"], strict=True))


TABLES: Mapping[str, Callable[[], str]] = {
    "limits": limits_table,
    "penalty": penalty_table,
    "placement": placement_table,
    "horizon": horizon_table,
    "noise": noise_table,
    "rivals": rivals_table,
    "rivals-noise": rivals_noise_table,
    "tuning": tuning_table,
    "baselines": baselines_table,
}


def generated() -> str:
    """Return the text of the page."""
    return filled(Path(PAGE).read_text(encoding="utf-8"), TABLES)
