"""What looks wrong with the runs of a table as a whole: laws, pairs with nothing in common, rows that are sorted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.config_file.tree import plain
from rmpc_bench.importing.roles import is_text
from rmpc_bench.importing.runs import Reader, Runs
from rmpc_bench.importing.settings import Options, Settings
from rmpc_bench.noise.distributions import Choice, Distribution, Lognormal, Normal
from rmpc_bench.received.run_table import Table, read_table
from rmpc_bench.types import Array, ConfigError, Problem
from rmpc_bench.types.sweep_points import value_text

if TYPE_CHECKING:
    import pandas as pd

ROUNDED = 1e-9
"""Relative error of numbers that a text rounds."""
FEW_SORTED, FEW_PAIRED = 10, 20
"""Runs from which on an order, and a correlation, are no accident."""


def read_runs(source: object, settings: Settings, options: Options) -> tuple[Table, Runs]:
    """Read a table and check it; a ConfigError has all that is wrong with the settings and the table."""
    import pandas as pd

    is_text_column = is_text(settings, options)
    table = read_table(source, options.decimal, options.separator, options.max_rows, is_text_column)
    reader = Reader(table, settings, options)
    runs = reader.runs()
    _check_laws(reader.table, runs, settings)
    if options.unpaired:
        settings.refuse_pairs()
    settings.finish(runs.methods, runs.infos, runs.points)
    problems = [*reader.problems, *settings.draft.problems]
    if not problems:
        statistics = settings.statistics
        metric, baseline = statistics.primary or runs.infos[0].name, statistics.baseline or runs.methods[0]
        here = np.array(runs.methods, dtype=object)[runs.method], runs.run, runs.metrics[metric]
        first = pd.DataFrame(dict(zip(("method", "run", "value"), here, strict=True)))[runs.point == 0]
        values = dict(iter(first.set_index("run").groupby("method", sort=False)["value"]))
        if not options.unpaired:
            problems += [] if "run" in reader.roles else [*_sorted(reader.table, values, metric)]
            runs.warnings = [*_unpaired(values, baseline)]
    if problems:
        raise ConfigError(problems)
    return table, runs


def _check_laws(table: Table, found: Runs, settings: Settings) -> None:
    """Refuse values of a parameter that its law cannot have."""
    for name, law in settings.draft.uncertainty.scaled.items():
        if name not in found.parameters or not isinstance(law, Distribution):
            continue
        (outside,) = np.nonzero(_is_outside(law, found.parameters[name]))
        both = [found.point[outside], found.run[outside]]
        outside = outside[np.unique(both, axis=1, return_index=True)[1]]
        if n := len(outside):
            lines = sorted(table.lines(found.row[outside[:10]]))
            shown = ", ".join(map(str, lines)) + (", .." if n > 10 else "")
            written = value_text(plain(settings.draft.tree["uncertainty"].get(name)))
            values = "1 value of the table lies" if n == 1 else f"{n} values of the table lie"
            text = f"{values} outside of {written} (line{'s' * (len(lines) > 1)} {shown})"
            settings.draft.note(["uncertainty", name], f"{text}: the law is not that of these runs")


def _is_outside(law: Distribution, values: Array) -> Array:
    """Return which values a law cannot have, up to the rounding of their texts."""
    if isinstance(law, Choice):
        each = np.array(law.values)
        nearest = each[np.argmin(np.abs(values[:, None] - each), axis=1)]
        return np.asarray(np.abs(values - nearest) > ROUNDED * np.abs(nearest))
    # The quantiles of an unbounded law end where its digits do.
    is_open = isinstance(law, Normal | Lognormal) and getattr(law, "truncate", None) is None
    low = -np.inf if is_open and getattr(law, "low", None) is None else float(law.quantile(0.0))
    high = np.inf if is_open and getattr(law, "high", None) is None else float(law.quantile(1.0 - 2**-53))
    slack = ROUNDED * max(abs(each) for each in (low, high, 0.0) if np.isfinite(each))
    return np.asarray((values < low - slack) | (values > high + slack))


def _sorted(table: Table, values: dict[str, pd.Series], metric: str) -> Iterator[Problem]:
    """Yield a problem where the values of two methods both rise or both fall from row to row."""
    for sign, word in ((1.0, "rises"), (-1.0, "falls")):
        steps = {name: sign * np.diff(cells.to_numpy()) for name, cells in values.items() if len(cells) >= FEW_SORTED}
        alike = [name for name, each in steps.items() if (each >= 0).all() and each.any()]
        if len(alike) > 1:
            text = f"{metric} {word} from row to row for {alike[0]} and {alike[1]}: the rows look sorted, so that"
            way = "give a column 'run' (--columns), or --unpaired"
            yield table.problem(f"{text} intervals would be far too narrow; {way}")


def _unpaired(values: dict[str, pd.Series], baseline: str) -> Iterator[str]:
    """Yield methods whose runs have nothing in common with those of the baseline (Spearman's rho)."""
    import pandas as pd

    for name in values if baseline in values else ():
        pair = pd.concat([values[name], values[baseline]], axis=1, join="inner").dropna()
        n, rho = len(pair), float(pair.rank().corr().iloc[0, 1]) if len(pair) else np.nan
        if name != baseline and n >= FEW_PAIRED and rho < 1.645 / np.sqrt(n - 1):
            text = f"run i of {name} has nothing in common with run i of {baseline} (rank correlation {rho:.2f})"
            yield f"{text}: did both have the same draws?"
