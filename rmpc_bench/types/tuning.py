"""What tuning has tried and chosen: its protocol, and the record of the search of every tuned method."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Len
from jaxtyping import Float

from rmpc_bench.types.basics import Array

AS_PUBLISHED, DEFAULT = "as published", "default"
"""What is said of the parameters of a method that is not tuned."""
MOST_PARAMETERS = 10
"""Largest number of parameters of a method that are chosen together: a budget of this bench says little of more."""
OTHER_SETTINGS = "tuned for other settings"
"""What is said of a method whose values come from the search of another experiment, method, range or protocol."""
NOTHING_TUNED = "(nothing could be tuned)"
"""Stands behind the source of the values that a method keeps where none has a finite objective."""
_QUANTILE = re.compile(r"quantile\s+([0-9]+(?:\.[0-9]+)?)\s*%")


@dataclass(frozen=True, eq=False)
class TuningProtocol:
    """How parameters are chosen; the same for all methods of an experiment."""

    budget: int  # number of values that are tried for each method
    runs: int  # number of runs for each value; their random numbers are never those of the experiment
    metric: str  # name of the metric
    statistic: str = "mean"  # ``mean``, ``median`` or a quantile such as ``quantile 90%`` over the tuning runs
    penalty: float = 10.0  # weight of the share of failed runs
    seed: int = 0  # number of the tuning stream
    search: str = "auto"  # ``auto``, ``grid-golden``, ``nelder-mead`` or ``quasi-random``

    @property
    def words(self) -> str:
        """What is said of a tuned method, such as ``tuned (budget 16, 40 runs)``."""
        return f"tuned (budget {self.budget}, {self.runs} run{'s' * (self.runs > 1)})"

    def objective(self, values: Float[Array, "... runs"]) -> Float[Array, ...]:
        """Return what the search minimises: the statistic of the finished runs with a penalty on failed ones.

        The objective is s + penalty * share * ``|s|``, where s is the statistic and share that of failed runs.

        Parameters
        ----------
        values : metric of every run; NaN or infinite where the run has failed

        Returns
        -------
        one number for each set of runs; infinite where all runs have failed

        Examples
        --------
        >>> TuningProtocol(16, 4, "mse").objective(np.array([[1.0, 2.0, 3.0, np.nan], [np.nan] * 4])).tolist()
        [7.0, inf]
        """
        kept = np.isfinite(values)
        rows, good = np.atleast_2d(values).reshape(-1, values.shape[-1]), kept.reshape(-1, values.shape[-1])
        found = [_statistic(row[use], self.statistic) for row, use in zip(rows, good, strict=True)]
        statistic, failed = np.reshape(found, values.shape[:-1]), 1.0 - kept.mean(axis=-1)
        with np.errstate(invalid="ignore"):
            return np.where(kept.any(axis=-1), statistic + self.penalty * failed * np.abs(statistic), np.inf)


def level_of(statistic: str) -> float | None:
    """Return the level of a quantile, 0.5 for the median, None for the mean.

    Examples
    --------
    >>> level_of("quantile 90%"), level_of("mean")
    (0.9, None)
    """
    if statistic in ("mean", "median"):
        return None if statistic == "mean" else 0.5
    found = _QUANTILE.fullmatch(statistic.strip())
    level = float(found[1]) / 100 if found else 0.0
    if not 0 < level < 1:
        raise ValueError(f"the statistic must be mean, median or a quantile such as 'quantile 90%' (got {statistic!r})")
    return level


def _statistic(values: Float[Array, " finished"], statistic: str) -> float:
    if not len(values):
        return np.inf
    level = level_of(statistic)
    return float(np.mean(values) if level is None else np.quantile(values, level))


@dataclass(frozen=True, eq=False)
class TunedParameter:
    """A parameter that tuning chooses."""

    path: str  # where it stands in the method, such as ``estimator.radius``
    low: float  # low, high: ends of its range
    high: float
    # ``log`` or ``linear``: whether the search takes equal steps of the logarithm of (value - offset) or of the
    # value; on the logarithmic scale ``low`` and ``high`` do not contain the offset
    scale: Literal["log", "linear"] = "log"
    offset: float = 0.0  # added to what is searched: the value is offset + number in the range
    integer: bool = False  # whether only integers are tried

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest value of the parameter, the offset added."""
        return self.low + self.offset, self.high + self.offset

    def text(self, value: float) -> str:
        """Write a value with four digits of what is searched: 1.00001 with the offset 1 stays 1.00001."""
        return f"{self.offset + float(f'{value - self.offset:.4g}'):.12g}" if self.offset else f"{value:.4g}"


@dataclass(frozen=True, eq=False)
class TuningSearch:
    """The search of one method at one point of the sweep.

    Parameters
    ----------
    point : title of the point; empty without a sweep
    method : name of the method
    parameters : what was tuned
    default : value of each parameter in the file, or the default of the component; None where it is no number
    candidates : values that were tried, in the order of evaluation, one column per parameter; offsets are added
    stages : part of the search of each candidate: ``grid``, ``golden``, ``quasi-random`` or ``nelder-mead``
    tuning : metric of each candidate and tuning run; NaN where the run has failed
    test : the same on the runs of the experiment, with the default in the last row; None where it was not computed
    chosen : index of the chosen candidate; None where no candidate has a finite objective, and the default stays
    protocol : how the parameters were chosen
    seconds : computing time of its trials [s]; 0 where it is not known
    key : what identifies the search
    """

    point: str
    method: str
    parameters: tuple[TunedParameter, ...]
    default: tuple[float | None, ...]
    candidates: Float[Array, "n p"]
    stages: tuple[str, ...]
    tuning: Float[Array, "n tuning_runs"]
    test: Float[Array, "n+1 test_runs"] | None
    chosen: int | None
    protocol: TuningProtocol
    seconds: float = 0.0
    key: str = ""

    @cached_property
    def objectives(self) -> Float[Array, " n"]:
        """Objective of each candidate on the tuning runs."""
        return self.protocol.objective(self.tuning)

    @cached_property
    def test_objectives(self) -> Float[Array, " rows"] | None:
        """Objective of each candidate and, last, of the default, on the runs of the experiment; None without them."""
        return None if self.test is None else self.protocol.objective(self.test)

    @property
    def values(self) -> dict[str, float | int]:
        """Path -> chosen value; empty where nothing could be tuned."""
        row = self.tuned_row
        pairs = () if row is None else zip(self.parameters, row, strict=True)
        return {each.path: int(value) if each.integer else float(value) for each, value in pairs}

    @property
    def tuned_row(self) -> Float[Array, " p"] | None:
        """Chosen value of every parameter; None where nothing could be tuned."""
        return None if self.chosen is None else self.candidates[self.chosen]

    @property
    def at_end(self) -> tuple[bool, ...]:
        """Whether the chosen value is an end of its range, for every parameter."""
        row = self.tuned_row
        if row is None:
            return (False,) * len(self.parameters)
        return tuple(float(value) in each.ends for each, value in zip(self.parameters, row, strict=True))


@dataclass(frozen=True)
class StoredTuning:
    """What the record of an experiment says of its tuning."""

    protocol: TuningProtocol  # how parameters are chosen
    searches: tuple[tuple[str, str, str], ...]  # point, method and key of each search


@dataclass(frozen=True, eq=False)
class Tuning:
    """How the parameters of an experiment were chosen.

    Parameters
    ----------
    protocol : the same for all methods
    searches : one for each tuned method and point of the sweep; points whose experiments and methods are equal have
        equal searches
    parameters : method -> where its parameters come from, such as ``tuned (budget 16, 40 runs)``, ``default`` or
        ``as published``
    """

    protocol: TuningProtocol
    searches: tuple[TuningSearch, ...]
    parameters: Mapping[str, str]

    def search(self, method: str, point: str = "") -> TuningSearch:
        """Return the search of a method at a point."""
        found = [each for each in self.searches if (each.method, each.point) == (method, point)]
        if not found:
            raise KeyError((method, point))
        return found[0]


@dataclass(frozen=True)
class ValueRow:
    """Tuned values of a method, as config.resolved.yaml has them.

    Parameters
    ----------
    method : name of the method
    values : path inside the method -> value; empty where nothing could be tuned
    at : title of the point of the sweep; empty without a sweep
    key : what identifies the search of these values; if this search is another one, they are "tuned for other settings"
    """

    method: Annotated[str, Len(1)]
    values: dict[str, float]
    at: str = ""
    key: str = ""
