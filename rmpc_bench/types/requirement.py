"""A requirement on the metric of a run, such as settling_time < 20."""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rmpc_bench.types.basics import Array

OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


@dataclass(frozen=True)
class Limit:
    """A comparison of the metric with a number, the metric on the left."""

    operator: str
    number: float


@dataclass(frozen=True)
class Requirement:
    """Limits that the metric of a run must keep.

    Parameters
    ----------
    text : as written in the configuration
    metric : name of the metric
    limits : all of them must hold
    absolute : whether the absolute value of the metric is meant
    """

    text: str
    metric: str
    limits: tuple[Limit, ...] = field(default=())
    absolute: bool = False

    def passed(self, values: Array) -> Array:
        """Return which runs meet the requirement.

        Parameters
        ----------
        values : (n_runs,) values of the metric; inf where an event did not occur, NaN where the run failed

        Returns
        -------
        (n_runs,) true where all limits hold; a failed run does not meet them
        """
        shown = np.abs(values) if self.absolute else values
        found = ~np.isnan(values)
        for limit in self.limits:
            found &= OPERATORS[limit.operator](shown, limit.number)
        return np.asarray(found)
