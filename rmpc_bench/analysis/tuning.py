"""What tuning has gained, and where the parameters of methods come from: tuned, as published, or default.

Regret  How much worse the tuned value is on the runs of the experiment than the best value that was tried, the default
        included.  It is what a search with only these values loses because it uses other runs.
Equal   Objectives are compared with `DIGITS` digits, so that equal ones are equal on every CPU.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.types import Array
from rmpc_bench.types.tuning import NOTHING_TUNED, Tuning, TuningProtocol, TuningSearch, level_of

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials


DIGITS = 9
"""Significant digits with which objectives are compared."""
COLUMNS = (
    *("point", "method", "parameter", "low", "high", "default", "tuned", "best_on_test", "end_of_range"),
    *("n_values", "n_runs", "objective", "failed_pct", "test_default", "test_tuned", "test_best"),
    *("test_failed_default_pct", "test_failed_pct", "regret_pct"),
)
"""Columns of the table of tuned parameters."""


class Outcome(NamedTuple):
    """What a search has found.

    Objectives are infinite where all runs have failed, and NaN without runs on the experiment's own random numbers.
    """

    search: TuningSearch
    objective: float
    """Of the tuned value on the tuning runs."""
    failed: float
    """Share of the tuning runs that have failed with the tuned value; 1 where nothing could be tuned."""
    test_default: float
    test_tuned: float
    test_best: float
    """Objectives on the runs of the experiment: of the default, the tuned value, and the best one of all."""
    best: int
    """Index of the best candidate; the number of candidates for the default, -1 where it is not known."""
    test_failed_default: float
    test_failed: float
    """Shares of the runs of the experiment that have failed with the default and with the tuned value."""

    @property
    def regret(self) -> float:
        """Regret in per cent of the best objective; NaN where it is not known, infinite if all runs have failed."""
        if not math.isfinite(self.test_best):
            return math.nan
        gap = self.test_tuned - self.test_best
        if gap == 0:
            return 0.0
        return 100 * gap / abs(self.test_best) if self.test_best else math.inf

    @property
    def best_values(self) -> tuple[float | None, ...]:
        """Value of every parameter at the best candidate; None where it is not known."""
        if self.best < 0:
            return (None,) * len(self.search.parameters)
        if self.best == len(self.search.candidates):
            return self.search.default
        return tuple(float(value) for value in self.search.candidates[self.best])


def objectives(protocol: TuningProtocol, values: Array) -> Array:
    """Return `TuningProtocol.objective` of (..., runs) values with `DIGITS` digits, quickly for many sets of runs."""
    kept, level = np.isfinite(values), level_of(protocol.statistic)
    if level is None:
        return rounded(_of_mean(protocol, values, kept), digits=DIGITS)
    whole = kept.all(axis=-1)
    found = np.empty(values.shape[:-1])
    if whole.any():
        found[whole] = np.quantile(values[whole], level, axis=-1)
    if not whole.all():
        found[~whole] = protocol.objective(values[~whole])
    return rounded(found, digits=DIGITS)


def _of_mean(protocol: TuningProtocol, values: Array, kept: Array) -> Array:
    """Return objectives that are means, with the penalty on failed runs."""
    n = kept.sum(axis=-1)
    mean = np.where(kept, values, 0.0).sum(axis=-1) / np.maximum(n, 1)
    penalty = protocol.penalty * (1.0 - kept.mean(axis=-1)) * np.abs(mean)
    found: Array = np.where(n > 0, mean + penalty, np.inf)
    return found


def outcome(search: TuningSearch) -> Outcome:
    """Summarise the search of a method at a point."""
    if search.chosen is None:
        default = math.nan if search.test is None else float(objectives(search.protocol, search.test[-1]))
        failed = math.nan if search.test is None else _failed(search.test[-1])
        return Outcome(search, math.inf, 1.0, default, math.nan, math.nan, -1, failed, math.nan)
    tuned = search.tuning[search.chosen]
    known = float(objectives(search.protocol, tuned)), _failed(tuned)
    if search.test is None:
        return Outcome(search, *known, math.nan, math.nan, math.nan, -1, math.nan, math.nan)
    found, default = objectives(search.protocol, search.test), search.test[-1]
    best = int(np.argmin(found))
    # The tuned value is named where several are equally good.
    best = search.chosen if found[search.chosen] == found[best] else best
    tests = (float(found[-1]), float(found[search.chosen]), float(found[best]))
    return Outcome(search, *known, *tests, best, _failed(default), _failed(search.test[search.chosen]))


def tuning_rows(tuning: Tuning) -> list[dict[str, object]]:
    """Return a row of `COLUMNS` per point, method and tuned parameter; numbers in full precision."""
    return [row for search in tuning.searches for row in _rows(outcome(search))]


def _rows(found: Outcome) -> list[dict[str, object]]:
    search, row = found.search, found.search.tuned_row
    shared: dict[str, object] = {
        "n_values": len(search.candidates),
        "n_runs": search.tuning.shape[1],
        "objective": found.objective,
        "failed_pct": 100 * found.failed,
        "test_default": found.test_default,
        "test_tuned": found.test_tuned,
        "test_best": found.test_best,
        "test_failed_default_pct": 100 * found.test_failed_default,
        "test_failed_pct": 100 * found.test_failed,
        "regret_pct": found.regret,
    }
    return [
        {
            **{"point": search.point, "method": search.method, "parameter": each.path},
            **{"low": each.ends[0], "high": each.ends[1]},
            **{"default": _number(search.default[place]), "tuned": math.nan if row is None else float(row[place])},
            **{"best_on_test": _number(found.best_values[place]), "end_of_range": search.at_end[place]},
            **shared,
        }
        for place, each in enumerate(search.parameters)
    ]


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _failed(values: Array) -> float:
    return float(1.0 - np.isfinite(values).mean()) if values.size else math.nan


TUNED = "tuned"
"""First word of what is said of a tuned method, such as ``tuned (budget 16, 40 runs)``."""
_HERE = f"{TUNED} ("
"""How this begins where the tuning was for these settings."""


def is_tuned(trials: Trials, method: str) -> bool:
    """Whether the parameters of a method were tuned for this experiment."""
    return trials.parameters.get(method, "").startswith(_HERE)


def parameter_text(trials: Trials, method: str) -> str:
    """Say where the parameters of a method come from; empty where it is not known.

    Such as "as published, not tuned", "tuned (budget 16, 40 runs)" or "default (nothing could be tuned)".
    """
    word = trials.parameters.get(method, "")
    return word if not word or word.startswith(TUNED) or word.endswith(NOTHING_TUNED) else f"{word}, not tuned"


def untuned_text(trials: Trials, method: str) -> str:
    """Say where the parameters of a method come from if they were not tuned; empty for a tuned method."""
    return "" if is_tuned(trials, method) else parameter_text(trials, method)


def pair_text(trials: Trials, method: str, baseline: str) -> str:
    """Say where the parameters of two compared methods come from, once where both are alike.

    The text is such as "both default, not tuned" or "WKF: tuned (budget 16, 40 runs), S-MPC: default, not tuned"; empty
    where it is not known.
    """
    first, second = parameter_text(trials, method), parameter_text(trials, baseline)
    if not second:
        return ""
    if first == second:
        return f"both {second}"
    return ", ".join(f"{name}: {word}" for name, word in ((method, first), (baseline, second)) if word)


def parameter_groups(trials: Trials, methods: Sequence[str]) -> dict[str, list[str]]:
    """Return what is said of parameters -> its methods in their order; nothing is said of unknown parameters."""
    found: dict[str, list[str]] = {}
    for method in methods:
        if word := parameter_text(trials, method):
            found.setdefault(word, []).append(method)
    return found


def parameter_cells(trials: Trials, methods: Sequence[str]) -> list[str]:
    """Return ``tuned``, ``default`` or ``as published`` for every method; nothing where all methods are alike.

    Where methods were tuned with different budgets, each has its own, such as ``tuned (budget 9, 50 runs)``.
    """
    words = [trials.parameters.get(method, "-") for method in methods]
    if len(_tuned_words(trials)) == 1:
        words = [TUNED if word.startswith(_HERE) else word for word in words]
    return words if len(set(words)) > 1 else []


def parameter_legend(trials: Trials) -> list[str]:
    """Return the parts of the legend of a table of comparisons that say where parameters come from.

    One text where all methods are alike; else the protocol of the tuned ones, and the word of a baseline that is not
    tuned; nothing where it is not known.
    """
    groups = parameter_groups(trials, trials.methods)
    if len(groups) == 1:
        return [f"parameters: {word}" for word in groups]
    words = _tuned_words(trials)
    # Otherwise the column has each of them.
    tuned = [f"tuned = {word.removeprefix(TUNED).strip(' ()')}" for word in words] if len(words) == 1 else []
    baseline = untuned_text(trials, trials.baseline)
    return [*tuned, *([f"{trials.baseline}: {baseline}"] if baseline else [])]


def _tuned_words(trials: Trials) -> list[str]:
    """Return what is said of tuned methods, each word once."""
    words = [trials.parameters.get(method, "") for method in trials.methods]
    return list(dict.fromkeys(word for word in words if word.startswith(_HERE)))
