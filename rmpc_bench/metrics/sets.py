"""Metric of the set that an estimator reports: whether it contains the true state.

The set is E(x_hat, S) = {x : (x - x_hat)' S^-1 (x - x_hat) <= 1}.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.metrics.estimate_checks import ReportedMatrix, check_reported, check_state_lengths, squared_size
from rmpc_bench.metrics.norms import time_mean
from rmpc_bench.numerics.ellipsoid import confidence, sum_shape
from rmpc_bench.types import Array, Direction, Issue, MetricLayout, Record, SampleWindow, WindowMetric

EQUATION = r"""\frac{1}{N}
\mathrm{number\ of\ } \left\lbrace k \lt N : (x_k - \hat x_k)^\top S_k^{-1} (x_k - \hat x_k) \le 1 \right\rbrace"""
ReportedSet: TypeAlias = Literal["set", "gaussian", "sum"]
READS: dict[ReportedSet | None, tuple[ReportedMatrix, ...]] = {
    "set": ("M",),
    "gaussian": ("P",),
    "sum": ("P", "M"),
    None: ("P", "M"),
}
"""Matrices of the estimate that a set is made of; one of them is enough."""
EDGE = 1e-9
"""Tolerance of the boundary of a set: the rounding error of a state on the boundary."""


@dataclass(frozen=True, kw_only=True)
class Inside(WindowMetric):
    """Share of the samples k = 0..N-1 at which the true state lies in the set that the estimator reports.

    Higher is better, up to 1 for a set that bounds the error and up to the level for a confidence ellipsoid.  A
    conservative estimator has the value 1, too: compare the size of the matrices in series.csv.

    If S is singular, an error outside its range is outside the set.  A method that does not report the matrices of S is
    an error of the configuration; one that reports them at some samples only has no value.

    Parameters
    ----------
    of : `set` is the reported M, `gaussian` the confidence ellipsoid of P (for a Gaussian error), `sum` the smallest
        ellipsoid that contains the sum of both, or the one that is reported; M, else that of P, if not given
    level : probability of the confidence ellipsoid of P

    Examples
    --------
    Errors 1 and 3 with the reported set |x_hat - x| <= 2, whose shape is M = 4.

    >>> record = Record.of_run(x=[0.0, 0.0, 0.0], x_hat=[1.0, 3.0, 9.0])
    >>> Inside(of="set").evaluate(record._replace(M=np.full((3, 1, 1), 4.0))).item()
    0.5
    """

    name: str = "inside"
    of: ReportedSet | None = None
    level: Annotated[float, Gt(0), Lt(1)] = 0.95

    better: ClassVar[Direction] = "higher"
    bounds: ClassVar[tuple[float, float]] = (0.0, 1.0)

    @property
    def needs_P(self) -> bool:
        """Whether the set is made of P."""
        return "P" in READS[self.of]

    @property
    def needs_M(self) -> bool:
        """Whether the set is made of M."""
        return "M" in READS[self.of]

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, estimates of another length than the state, and estimators without the set."""
        key = "of" if self.of else ""
        yield from super().check(layout)
        yield from check_state_lengths(layout, key)
        yield from check_reported(layout, *READS[self.of], key=key)

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Count the samples at which x lies in the set."""
        window = self.samples(record)
        S = self._shape(record, window)
        if S is None:
            return np.full(len(record.x), np.nan)
        # Failed runs overflow here; their values are not used.
        with np.errstate(all="ignore"):
            size = squared_size(record, window.slice, S).values
        share = time_mean((size <= 1.0 + EDGE)[:, :, None].astype(float))
        return np.where(np.isnan(size).any(axis=1), np.nan, share)

    def _shape(self, record: Record, window: SampleWindow) -> Array | None:
        """Return S at the samples of the window, shared by the runs or one for each; None where nothing is known."""
        P = record.P if self.needs_P else None
        M = record.M[..., window.slice, :, :] if self.needs_M and record.M is not None else None
        if P is None or (self.of is None and M is not None):
            return M
        with np.errstate(all="ignore"):
            gaussian: Array = confidence(self.level, P.shape[-1]) * P[..., window.slice, :, :]
            return gaussian if M is None else sum_shapes(M, gaussian)


def sum_shapes(M: Float[Array, "*k n n"], N: Float[Array, "*k n n"]) -> Float[Array, "*k n n"]:
    """Return the shapes of the smallest ellipsoids around the sums of pairs of ellipsoids, one by one."""
    shape = np.broadcast_shapes(M.shape, N.shape)
    pairs = zip(*(np.broadcast_to(each, shape).reshape(-1, *shape[-2:]) for each in (M, N)), strict=True)
    return np.array([sum_shape(*pair) for pair in pairs]).reshape(shape)
