"""Tables of the package as data frames, and tables of trials from data frames: short to write and to read in tests."""

import numpy as np
import pandas as pd

from rmpc_bench.analysis import comparison, drivers, lost_runs, statistics, worst_runs
from rmpc_bench.analysis.columns import Series, data_frame

LONG = ["method", "quantity", "component", "k", "n", "value"]


def arrays(frame):
    """Return the columns of a data frame as arrays."""
    return {name: np.array(frame[name]) for name in frame}


def series(frame):
    """Return series from a long table with the columns `LONG`; NaN where an entry is absent."""
    found = []
    for (method, quantity, n), rows in frame.groupby(["method", "quantity", "n"], sort=False):
        entries = [tuple(int(part) for part in text.split(",") if part) for text in rows["component"]]
        places = (rows["k"].to_numpy(dtype=int), *np.array(entries, dtype=int).T)
        values = np.full([each.max() + 1 for each in places], np.nan)
        values[places] = rows["value"]
        found.append(Series(method, quantity, values, int(n)))
    return found


def _frame(rows, names, whole=()):
    return data_frame(pd.DataFrame(list(rows), columns=list(names)), whole)


def comparison_frame(trials, of=None):
    return _frame(comparison.comparisons(trials, of), comparison.COLUMNS, comparison.WHOLE)


def driver_frame(trials):
    return _frame(drivers.drivers(trials), drivers.COLUMNS)


def lost_frame(trials):
    return _frame(lost_runs.lost_runs(trials), lost_runs.COLUMNS)


def pass_frame(trials):
    return _frame(statistics.pass_rates(trials), statistics.COLUMNS)


def summary_frame(trials):
    return _frame(statistics.summary(trials), statistics.SUMMARY)


def tail_frame(trials):
    return _frame(worst_runs.tail_rows(trials), worst_runs.COLUMNS, ["worst_run"])
