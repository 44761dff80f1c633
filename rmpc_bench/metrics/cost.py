"""The quadratic cost of a run.

J = sum over k of x(k+1)' Q_x x(k+1) + u(k)' R_u u(k), ma2025 (36).  The sum starts with x(1), because no input can
change x(0).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_covariance, mv
from rmpc_bench.types import Array, Issue, Matrix, MetricLayout, Record, WindowMetric, issues_of

EQUATION = r"\sum_{k=0}^{N-1} x_{k+1}^\top Q_x x_{k+1} + u_k^\top R_u u_k"


@dataclass(frozen=True, kw_only=True)
class Cost(WindowMetric):
    """Quadratic cost of a run: the sum over k = 0..N-1 of x(k+1)' Q_x x(k+1) + u(k)' R_u u(k); lower is better.

    The sum, no mean, starts with x(1), because no input can change x(0).

    Parameters
    ----------
    from_ : first k (seconds or samples, as `time`)
    to : last k, included; x(k+1) of it is the last state that counts
    Q_x : weight of the true state
    R_u : weight of the applied input

    Examples
    --------
    >>> record = Record.of_run(x=[7.0, 2.0, 3.0], u=[1.0, 5.0])
    >>> Cost(Q_x=10.0, R_u=2.0).evaluate(record).item()  # 10 (4 + 9) + 2 (1 + 25)
    182.0
    """

    name: str = "cost"
    Q_x: Matrix
    R_u: Matrix

    bounds: ClassVar[tuple[float, float]] = (0.0, np.inf)
    input_only: ClassVar[bool] = True

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, and weights that do not fit the plant."""
        yield from super().check(layout)
        if layout.plant is not None:
            yield from issues_of(as_covariance, self.Q_x, layout.plant.nx, "Q_x")
            yield from issues_of(as_covariance, self.R_u, layout.plant.nu, "R_u")

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Add up the weighted squares."""
        window = self.samples(record)
        next_x, u = record.x[:, window.first + 1 : window.last + 2], record.u[:, window.slice]
        Q, R = as_covariance(self.Q_x, record.x.shape[2], "Q_x"), as_covariance(self.R_u, record.u.shape[2], "R_u")
        return weighted_sum(Q, next_x) + weighted_sum(R, u)  # (36)


def weighted_sum(W: Float[Array, "n n"], values: Float[Array, "runs window n"]) -> Float[Array, " runs"]:
    """Sum of z' W z over time, row by row on contiguous memory: the bits do not depend on the other rows."""
    rows = np.ascontiguousarray(values).reshape(-1, len(W))
    products = np.ascontiguousarray((mv(W, rows) * rows).reshape(len(values), -1))
    total: Array = products.sum(axis=1)
    return total
