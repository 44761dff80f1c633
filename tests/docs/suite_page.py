"""Tables of docs/suite.md, from the kept comparisons.csv of suite-1.

`docs.pages` (``make docs``) writes each of them into the page, between the markers with its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from docs.markdown import DOCS, ROOT, table
from scipy import stats

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load

PAGE = DOCS / "suite.md"
KEPT = ROOT / "results" / "suite" / "suite-1"
SET = ROOT / "configs" / "suite" / "suite-1.yaml"
BASELINE = "KF-R"
ONE_PLANT = ("sayed2001", "wkf2018", "wang2021", "wang2021-fixed")
"""Rows that are one plant, with entries of different size and law of the uncertainty."""
NOT_APPLICABLE = {"Sayed": ("simon-motor", "kothare1996", "compleib-ac5", "compleib-he2", "compleib-mfp")}
"""Method -> rows in which it is the Kalman filter KF: no H_A is given, or C H_A = 0."""
DIRECTION = ("KF-dir", "Sayed")
"""Methods that know the directions of the uncertainty."""
MOST = 4.0
"""Largest ratio that the clipped averages count."""
NO_EFFECT = 1e-3
"""Relative difference to KF below which a filter has no effect."""
LEFT_OUT = (
    (),
    ("wang2021",),
    ("wang2021-fixed",),
    ("wkf2018",),
    ("simon-motor",),
    ("wkf2018", "wang2021", "wang2021-fixed"),
    NOT_APPLICABLE["Sayed"],
)
TITLES = {(): "nothing", NOT_APPLICABLE["Sayed"]: "the five rows in which `Sayed` is `KF`"}
"""Rows that are left out -> their name on the page."""


def row_logs(compared: pd.DataFrame) -> pd.DataFrame:
    """Logarithms of the ratios to the baseline: a row per row of the set, the mean over its noise worlds."""
    logs = compared.assign(log=np.log1p(compared["geometric_pct"] / 100))
    return logs.pivot_table(index="name", columns="method", values="log", sort=False).assign(**{BASELINE: 0.0})


def over_systems(compared: pd.DataFrame) -> pd.DataFrame:
    """Ratios to the baseline per method, with intervals over rows and over plants, from a table comparisons.csv.

    `ratio` is that of these rows; `rows`, `plants`, `clipped` and `next` have a 95 % t interval (`.._low`, `.._high`):
    of the mean over rows, over plants, over plants with clipped ratios, and of the clipped ratio on another plant.
    `won` counts the rows with a ratio below 1, `effect` those in which the filter is another one than KF.
    """
    logs = row_logs(compared)
    plant = ["one plant" if name in ONE_PLANT else name for name in logs.index]
    plants, clipped = (frame.groupby(plant).mean() for frame in (logs, logs.clip(-math.log(MOST), math.log(MOST))))
    found = pd.DataFrame({"ratio": np.exp(logs.mean()), "median": np.exp(logs.median())})
    for name, frame, extra in (("rows", logs, 0), ("plants", plants, 0), ("clipped", clipped, 0), ("next", clipped, 1)):
        n = len(frame)
        half = stats.t.ppf(0.975, n - 1) * frame.std(ddof=1) * math.sqrt(1 / n + extra)
        for column, value in ((name, 0), (f"{name}_low", -half), (f"{name}_high", half)):
            found[column] = np.exp(frame.mean() + value)
    return found.assign(won=(logs < 0).sum(), n_rows=len(logs), n_plants=len(plants), effect=_effect(compared))


def _effect(compared: pd.DataFrame) -> pd.Series:
    """Rows in which a method differs from KF in at least one noise world; the baseline has a row of zeros."""
    factors = 1 + compared.pivot_table(index=["noise", "name"], columns="method", values="geometric_pct") / 100
    factors[BASELINE] = 1.0
    differs = factors.div(factors["KF"], axis=0).sub(1).abs() >= NO_EFFECT
    return differs.groupby("name").any().sum()


def without(compared: pd.DataFrame, rows: Sequence[str]) -> pd.Series:
    """Return the ratios without some rows, the smallest first."""
    return over_systems(compared[~compared["name"].isin(rows)])["ratio"].sort_values()


def kept(name: str = "comparisons.csv") -> pd.DataFrame:
    """Return a kept table of the set."""
    return pd.read_csv(KEPT / name)


def short(value: float) -> str:
    """Two decimals; three digits from 10 on.

    Examples
    --------
    >>> short(0.576), short(12.15), short(45953.8)
    ('0.58', '12.2', '46,000')
    """
    return f"{value:.2f}" if value < 10 else f"{float(f'{value:.3g}'):,g}"


def interval(row: pd.Series, name: str, *, with_mean: bool = True) -> str:
    """Write the interval of a name, behind its mean; the baseline has none."""
    ends = f"[{short(row[f'{name}_low'])}, {short(row[f'{name}_high'])}]"
    return "1" if row.name == BASELINE else f"{short(row[name])} {ends}" if with_mean else ends


def classes(methods: Iterable[str]) -> tuple[list[str], list[str]]:
    """Divide methods by what they know: the model and its noise, and the directions of the uncertainty, too."""
    methods = [*methods]
    return [each for each in methods if each not in DIRECTION], [each for each in methods if each in DIRECTION]


def systems_table() -> str:
    """Ratios with intervals over rows and plants; methods that know more than the others come last."""
    found = over_systems(kept()).sort_values("ratio")
    ranks = kept("ranks.csv")
    ends = ranks[ranks["axis"].isna()].set_index("method")
    rows = []
    for number, methods in enumerate(classes(found.index)):
        for method in methods:
            row = found.loc[method]
            printed = f"{row.ratio:.3f} [{ends.ratio_low[method]:.3f}, {ends.ratio_high[method]:.3f}]"
            numbers = [interval(row, name, with_mean=name != "next") for name in ("rows", "plants", "clipped", "next")]
            won = "-" if method == BASELINE else f"{row.won:.0f}"
            effect = "-" if method == "KF" else f"{row.effect:.0f}"
            ratio, over = "1" if method == BASELINE else printed, numbers[0].partition(" ")[2] or "1"
            cells = (effect, ratio, over, f"{row['median']:.3f}", won)
            rows.append((method, ("none", "direction")[number], *cells, *numbers[1:]))
    n, plants = int(found.n_rows.iloc[0]), int(found.n_plants.iloc[0])
    heads = [
        "method",
        "information",
        "has an effect",
        f"ratio on these {n} rows",
        f"over {n} rows",
        "median row",
        "won",
    ]
    more = (f"one vote per plant ({plants})", f"clipped to 1/{MOST:g}..{MOST:g}, per plant", "next plant")
    return table([*heads, *more], rows)


def rows_table() -> str:
    """The ratio of every method in every row of the set, over its noise worlds."""
    logs = row_logs(kept())
    methods = [method for part in classes(over_systems(kept())["ratio"].sort_values().index) for method in part]
    rows = []
    for row in plain(load(SET))["sweep"]["zip"]:
        name = row["name"]
        cells = (
            "not applicable" if name in NOT_APPLICABLE.get(method, ()) else _three(math.exp(logs[method][name]))
            for method in methods
        )
        rows.append((name, *cells))
    return table(["row", *methods], rows)


def _three(value: float) -> str:
    """Three decimals; three digits below 0.1 and from 10 on."""
    return "1" if value == 1 else short(value) if value >= 10 else f"{value:.3f}" if value >= 0.1 else f"{value:.3g}"


def left_out_table() -> str:
    """Place of the baseline and all ratios when some rows are left out."""
    compared = kept()
    methods = [method for part in classes(without(compared, ()).index) for method in part]
    rows = []
    for names in LEFT_OUT:
        found = without(compared, names)
        place = [*found.index].index(BASELINE) + 1
        title = TITLES.get(names, ", ".join(names))
        rows.append((title, f"{place}", *("1" if each == BASELINE else f"{found[each]:.3f}" for each in methods)))
    return table(["left out", f"place of {BASELINE}", *methods], rows)


TABLES: Mapping[str, Callable[[], str]] = {"systems": systems_table, "rows": rows_table, "left-out": left_out_table}
