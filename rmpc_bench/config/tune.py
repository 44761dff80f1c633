"""Keys of the section `tune` and of a range: how parameters are chosen, and between which values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le, Len
from pydantic import AfterValidator

from rmpc_bench.types import Count, NonNegative
from rmpc_bench.types.basics import Text
from rmpc_bench.types.tuning import TunedParameter, TuningProtocol, ValueRow, level_of


def _statistic(text: str) -> str:
    """Return the text; raise a ValueError if it is no statistic."""
    level_of(text)
    return text


Statistic = Annotated[Text, AfterValidator(_statistic)]
SMOKE_BUDGET = 3  # values that a smoke run tries for each method


Chosen = Mapping[tuple[str, str], Mapping[str, float]]
"""Title of a point and name of a method -> path inside the method -> value that tuning has chosen."""


@dataclass(frozen=True)
class TuneKeys:
    """How the parameters under `tune` of the methods are chosen, with the same budget for each.

    The tuning runs are the experiment with another seed; the experiment never uses their random numbers.

    Parameters
    ----------
    budget : number of values that are tried for each method
    runs : number of runs for each value
    metric : name of the metric; the primary one if not given
    statistic : mean, median or a quantile such as `quantile 90%` over the finished tuning runs
    penalty : weight of failed runs: the objective is the statistic times 1 + penalty x share of failed runs
    seed : number of the tuning stream; another one gives other tuning runs
    search : `grid-golden` is a grid, then golden section, for one parameter; `nelder-mead` is a quasi-random half of
        the budget, then the simplex of Nelder and Mead; `quasi-random` spends all on such points; `auto` is the first
        for one parameter and the second for more
    regret : whether all values are also computed on the runs of the experiment, for the regret
    values : values that were chosen earlier; such a method is not tuned again
    """

    budget: Annotated[int, Ge(1), Le(10_000)] = 16
    runs: Count = 40
    metric: Text | None = None
    statistic: Statistic = "mean"
    penalty: NonNegative = 10.0
    seed: Annotated[int, Ge(0), Le(2**32 - 1)] = 0
    search: Literal["auto", "grid-golden", "nelder-mead", "quasi-random"] = "auto"
    regret: bool = True
    values: list[ValueRow] = field(default_factory=list)

    def protocol(self, metric: str) -> TuningProtocol:
        """Return the protocol with the name of its metric."""
        return TuningProtocol(
            self.budget, self.runs, metric, self.statistic, float(self.penalty), self.seed, self.search
        )


@dataclass(frozen=True)
class RangeKeys:
    """Range of a parameter.

    Parameters
    ----------
    range : smallest and largest value, without the offset
    scale : `log` searches in equal steps of the logarithm, `linear` in equal steps of the value
    offset : is added to what is searched, such as 1 for a factor close to 1
    integer : whether only integers are tried
    """

    range: Annotated[list[float], Len(2, 2)]
    scale: Literal["log", "linear"] = "log"
    offset: float = 0.0
    integer: bool = False


Range: Any = Annotated[list[float], Len(2, 2)] | RangeKeys
"""A range as [low, high] on a logarithmic scale, or with further keys."""


def parameter_of(path: str, given: list[float] | RangeKeys) -> TunedParameter:
    """Return a parameter to tune, at a path inside the method such as ``estimator.radius``.

    Raises a ValueError if there is nothing between the ends, or the scale or the integers do not fit them.

    >>> parameter_of("estimator.radius", [0.01, 10.0]).scale
    'log'
    """
    keys = given if isinstance(given, RangeKeys) else RangeKeys(list(given))
    low, high = map(float, keys.range)
    if not low < high:
        raise ValueError(f"the first number of a range must be smaller than the second (got [{low:g}, {high:g}])")
    if keys.scale == "log" and low <= 0:
        way_out = f"{{range: [{low:g}, {high:g}], scale: linear}}"
        message = f"a range on a logarithmic scale must begin above 0 (got {low:g})"
        raise ValueError(f"{message}; for other values write {way_out}")
    if keys.integer and any(number != int(number) for number in (low, high, keys.offset)):
        raise ValueError("the ends and the offset of a range with `integer: true` must be integers")
    return TunedParameter(path, low, high, keys.scale, float(keys.offset), keys.integer)
