"""A plant parameter that `perturb` or `set` changes from run to run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from rmpc_bench.expressions.quantity import Expression, QuantityError


@dataclass(frozen=True)
class UncertainParameter:
    """A plant parameter as a function of the named uncertain values of a run."""

    expression: Expression
    factor: float

    def __call__(self, values: Mapping[str, float]) -> float:
        """Return the parameter; NaN where the arithmetic fails, which makes the run `out-of-range`."""
        try:
            return self.factor * self.expression(values)
        except QuantityError:
            return math.nan
