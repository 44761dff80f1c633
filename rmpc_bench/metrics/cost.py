"""The cost that a quadratic controller wants to be small, as the run has paid it.

J = sum over k of x(k+1)' Q_x x(k+1) + u(k)' R_u u(k), ma2025 (36): a state counts together with the input that led to
it, so that x(0), which no input can change, does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.metrics.tracking import Bound, SampleMetric, Units, Window, window_of
from rmpc_bench.numerics.linalg import as_covariance, mv
from rmpc_bench.types import Array, DesignError, Matrix, MetricInfo, Record


@dataclass(frozen=True)
class Cost:
    """Parameters of `cost`."""

    Q_x: Matrix
    R_u: Matrix

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Sum over the window."""
        next_x, u = record.x[:, window.first + 1 : window.last + 2], record.u[:, window.slice]
        Q, R = _weight("Q_x", self.Q_x, record.x.shape[2]), _weight("R_u", self.R_u, record.u.shape[2])
        return _weighted(Q, next_x) + _weighted(R, u)  # (36)


def cost(
    units: Units, *, name: str = "cost", Q_x: Matrix, R_u: Matrix, from_: Bound = None, to: Bound = None
) -> SampleMetric:
    """Quadratic cost of a run: the sum over k = 0..N-1 of x(k+1)' Q_x x(k+1) + u(k)' R_u u(k), not its mean.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    Q_x : weight of the true state
    R_u : weight of the applied input
    from_ : first k (seconds or samples, as `time`)
    to : last k, included, whose x(k+1) is the last one that counts
    """
    if units.plant is not None:
        _weight("Q_x", Q_x, units.plant.nx)
        _weight("R_u", R_u, units.plant.nu)
    last = units.n_steps - 1  # no input is applied at k = N
    return SampleMetric(MetricInfo(name, "", "lower"), window_of(units, from_, to, last, last), Cost(Q_x, R_u))


def _weight(parameter: str, value: Matrix, n: int) -> Float[Array, "n n"]:
    try:
        return as_covariance(value, n)
    except ValueError as error:
        raise DesignError(str(error), parameter) from None


def _weighted(W: Float[Array, "n n"], values: Float[Array, "runs window n"]) -> Float[Array, " runs"]:
    """Sum of z' W z over time, row by row on contiguous memory: the bits do not depend on the other rows."""
    rows = np.ascontiguousarray(values).reshape(-1, len(W))
    products = np.ascontiguousarray((mv(W, rows) * rows).reshape(len(values), -1))
    total: Array = products.sum(axis=1)
    return total
