"""A plant parameter that `perturb` or `set` changes from run to run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from jaxtyping import Float

from rmpc_bench.expressions.quantity import Expression, QuantityError
from rmpc_bench.simulation.scenario import RunParameter
from rmpc_bench.types import Array


@dataclass(frozen=True)
class UncertainParameter(RunParameter):
    """A plant parameter as a function of the named uncertain values of a run."""

    expression: Expression
    factor: float

    def __call__(self, values: Mapping[str, float]) -> float:
        """Return the parameter; NaN where the arithmetic fails, which makes the run `out-of-range`."""
        try:
            return self.factor * self.expression(values)
        except QuantityError:
            return math.nan

    def of_runs(self, columns: Mapping[str, Array], n_runs: int) -> Float[Array, " runs"]:
        """Return the parameters of many runs; run by run where the arithmetic of a run fails."""
        values = self.expression.of_columns(columns, n_runs)
        return super().of_runs(columns, n_runs) if values is None else self.factor * values
