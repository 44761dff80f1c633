"""Tables of docs/choose-an-estimator.md, from the kept comparisons.csv of configs/estimators.

`docs.pages` (``make docs``) writes each of them into the page, between the markers with its name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import pandas as pd
from docs.markdown import DOCS, ROOT, table

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load

PAGE = DOCS / "choose-an-estimator.md"
SHOWN = ("outliers", "friction-tuned", "drift", "bounds")
"""Configurations below configs/estimators with a table on the page."""
LARGE = 1e4
"""From this size on a number has a power of ten."""


def kept(name: str) -> pd.DataFrame:
    """Return the kept comparisons of the primary metric; one without a sweep has a single point without a name.

    Parameters
    ----------
    name : of a configuration, as ``estimators/outliers``
    """
    compared = pd.read_csv(ROOT / "results" / name / "comparisons.csv")
    found = compared[compared["metric"] == compared["metric"].iloc[0]]
    return found if "name" in found else found.assign(name="")


def changes(name: str) -> str:
    """Return the table of a configuration: a row per method, a column per point of its sweep."""
    compared = kept(f"estimators/{name}")
    methods = plain(load(ROOT / "configs" / "estimators" / f"{name}.yaml"))["methods"]
    points = [*dict.fromkeys(compared["name"])]
    cells = {(row.method, row.name): _cell(row) for row in compared.itertuples(index=False)}
    keys = dict.fromkeys(compared["method"])
    rows = [(_linked(methods[key]), *(cells[key, each] for each in points)) for key in keys]
    return table(("estimator", *(each or "change" for each in points)), rows)


def _linked(method: Mapping[str, Any]) -> str:
    """Name of a method with a link to its estimator, and whether it is tuned."""
    kind = method["estimator"]["kind"]
    return f"[{method.get('label', kind)}](components/estimators/{kind}.md){', tuned' if 'tune' in method else ''}"


def _cell(row: Any) -> str:
    return f"{_number(row.change_pct, 1)} [{_number(row.ci_low, 2)}, {_number(row.ci_high, 2)}]"


def _number(value: float, decimals: int) -> str:
    return f"{value:.0e}".replace("e+0", "e").replace("e+", "e") if abs(value) >= LARGE else f"{value:.{decimals}f}"


TABLES: Mapping[str, Callable[[], str]] = {name: partial(changes, name) for name in SHOWN}
"""Marker -> table."""
