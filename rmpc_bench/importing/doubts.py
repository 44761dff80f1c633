"""What looks wrong with the runs of a table as a whole: laws, pairs with nothing in common, rows that are sorted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rmpc_bench.importing.roles import is_text
from rmpc_bench.importing.runs import Reader, Runs
from rmpc_bench.importing.settings import Options, Settings
from rmpc_bench.noise.distributions import Choice, Distribution, Lognormal, Normal
from rmpc_bench.received.run_table import Table, read_table
from rmpc_bench.types import Array, ConfigError, Problem

ROUNDED = 1e-9
"""Relative error of numbers that a text rounds."""
FEW_SORTED, FEW_PAIRED = 10, 20
"""Runs from which on an order, and a correlation, are no accident."""


def read_runs(source: object, settings: Settings, options: Options) -> tuple[Table, Runs]:
    """Read a table and check it; a ConfigError has all that is wrong with the settings and the table."""
    table = read_table(source, options.form, options.max_rows, is_text(settings, options))
    reader = Reader(table, settings, options)
    runs = reader.runs()
    _check_laws(reader.table, runs, settings)
    if options.unpaired:
        settings.refuse_pairs()
    settings.finish(runs.methods, runs.infos, runs.points)
    problems = [*reader.problems, *settings.draft.problems]
    if not problems:
        statistics = settings.draft.values["statistics"]
        metric, baseline = statistics.primary or runs.infos[0].name, statistics.baseline or runs.methods[0]
        values = _of_first_point(runs, metric)
        if not options.unpaired:
            problems += [] if reader.roles.run else [*_sorted(reader.table, values, metric)]
            runs.warnings = [*_unpaired(values, baseline)]
    if problems:
        raise ConfigError(problems)
    return table, runs


def _check_laws(table: Table, found: Runs, settings: Settings) -> None:
    """Refuse values of a parameter that its law cannot have."""
    for name, law in settings.draft.uncertainty.items():
        if name not in found.parameters or not isinstance(law, Distribution):
            continue
        (outside,) = np.nonzero(_is_outside(law, found.parameters[name]))
        outside = outside[np.unique(found.group[outside], return_index=True)[1]]
        if len(outside):
            lines = sorted(table.lines(found.row[outside[:10]]))
            shown = ", ".join(map(str, lines)) + (", .." if len(outside) > 10 else "")
            values = "1 value of the table lies" if len(outside) == 1 else f"{len(outside)} values of the table lie"
            text = f"{values} outside of {settings.law_text(name)} (line{'s' * (len(lines) > 1)} {shown})"
            settings.draft.note(["uncertainty", name], f"{text}: the law is not that of these runs")


def _is_outside(law: Distribution, values: Array) -> Array:
    """Return which values a law cannot have, up to the rounding of their texts."""
    if isinstance(law, Choice):
        low = high = np.array(sorted(law.values))
        nearest = np.argmin(np.abs(values[:, None] - low), axis=1)
        low = high = low[nearest]
    else:
        # The quantiles of an unbounded law end where its digits do.
        is_open = isinstance(law, Normal | Lognormal) and getattr(law, "truncate", None) is None
        low = np.array(-np.inf if is_open and getattr(law, "low", None) is None else law.quantile(0.0))
        high = np.array(np.inf if is_open and getattr(law, "high", None) is None else law.quantile(1.0 - 2**-53))
    slack = ROUNDED * np.maximum(np.abs(np.nan_to_num(low, neginf=0.0)), np.abs(np.nan_to_num(high, posinf=0.0)))
    return np.asarray((values < low - slack) | (values > high + slack))


def _of_first_point(runs: Runs, metric: str) -> dict[str, tuple[Array, Array]]:
    """Return method -> its runs at the first point, and their values of a metric."""
    found = {}
    for number, name in enumerate(runs.methods):
        (here,) = np.nonzero((runs.method == number) & (runs.point == 0))
        found[name] = runs.run[here], runs.metrics[metric][here]
    return found


def _sorted(table: Table, values: dict[str, tuple[Array, Array]], metric: str) -> Iterator[Problem]:
    """Yield a problem where the values of two methods both rise or both fall from row to row."""
    for sign, word in ((1.0, "rises"), (-1.0, "falls")):
        steps = {name: sign * np.diff(cells) for name, (_, cells) in values.items() if len(cells) >= FEW_SORTED}
        alike = [name for name, each in steps.items() if (each >= 0).all() and each.any()]
        if len(alike) > 1:
            text = f"{metric} {word} from row to row for {alike[0]} and {alike[1]}: the rows look sorted, so that"
            way = "give a column 'run' (--columns), or --unpaired"
            yield table.problem(f"{text} intervals would be far too narrow; {way}")


def _unpaired(values: dict[str, tuple[Array, Array]], baseline: str) -> Iterator[str]:
    """Yield methods whose runs have nothing in common with those of the baseline (Spearman's rho)."""
    import pandas as pd

    for name in values:
        _, i, j = np.intersect1d(values[name][0], values[baseline][0], return_indices=True)
        pair = np.stack([values[name][1][i], values[baseline][1][j]])
        pair = pair[:, ~np.isnan(pair).any(axis=0)]
        n = pair.shape[1]
        if name == baseline or n < FEW_PAIRED or (pair == pair[:, :1]).all(axis=1).any():
            continue
        rho = float(np.corrcoef(pd.DataFrame(pair.T).rank().to_numpy().T)[0, 1])
        if rho < 1.645 / np.sqrt(n - 1):
            text = f"run i of {name} has nothing in common with run i of {baseline} (rank correlation {rho:.2f})"
            yield f"{text}: did both have the same draws?"
