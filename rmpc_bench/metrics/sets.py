"""Whether the true state lies in the set that an estimator believes.

The set is E(x_hat, S) = {x : (x - x_hat)' S^-1 (x - x_hat) <= 1}.  S is the estimator's own set M, its covariance P
blown up to the ellipsoid that holds a Gaussian error at some level, or the sum of both: what an estimator of mixed
noise believes altogether.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.metrics.error_size import squared_size
from rmpc_bench.metrics.estimates import Belief, refuse_other_states, refuse_without
from rmpc_bench.metrics.tracking import Bound, SampleMetric, Units, Window, time_mean, window_of
from rmpc_bench.numerics.ellipsoid import confidence, sum_shape
from rmpc_bench.types import Array, MetricInfo, Record

BelievedSet = Literal["set", "gaussian", "sum"]
READS: dict[BelievedSet | None, tuple[Belief, ...]] = {
    "set": ("M",),
    "gaussian": ("P",),
    "sum": ("P", "M"),
    None: ("P", "M"),
}
"""What is read of an estimate, of which one at least must be there."""
EDGE = 1e-9
"""How far beyond its edge a set still holds a state: the rounding of a state on the edge."""


@dataclass(frozen=True)
class Inside:
    """Parameters of `inside`."""

    of: BelievedSet | None
    level: float

    def __call__(self, record: Record, window: Window) -> Float[Array, " runs"]:
        """Share of the samples at which x lies in the set."""
        S = self.shape(record, window)
        if S is None:
            return np.full(len(record.x), np.nan)
        with np.errstate(all="ignore"):  # of failed runs
            size = squared_size(record, window.slice, S)
        share = time_mean((size <= 1.0 + EDGE)[:, :, None].astype(float))
        return np.where(np.isnan(size).any(axis=1), np.nan, share)

    def shape(self, record: Record, window: Window) -> Array | None:
        """Return S at the samples of the window, shared by the runs or one for each; None where nothing is known."""
        reads = READS[self.of]
        P, M = (getattr(record, name) if name in reads else None for name in ("P", "M"))
        M = None if M is None else M[..., window.slice, :, :]
        if P is None or (self.of is None and M is not None):
            return M
        with np.errstate(all="ignore"):
            gaussian: Array = confidence(self.level, P.shape[-1]) * P[..., window.slice, :, :]
            return gaussian if M is None else _sums(M, gaussian)


def _sums(M: Float[Array, "*k n n"], N: Float[Array, "*k n n"]) -> Float[Array, "*k n n"]:
    """Shapes of the smallest ellipsoids around the sums, one by one."""
    shape = np.broadcast_shapes(M.shape, N.shape)
    pairs = zip(*(np.broadcast_to(each, shape).reshape(-1, *shape[-2:]) for each in (M, N)), strict=True)
    return np.array([sum_shape(*pair) for pair in pairs]).reshape(shape)


def inside(
    units: Units,
    *,
    name: str = "inside",
    of: BelievedSet | None = None,
    level: Annotated[float, Gt(0), Lt(1)] = 0.95,
    from_: Bound = None,
    to: Bound = None,
) -> SampleMetric:
    """Share of the samples k = 0..N-1 at which the true state lies in the set that the estimator believes.

    More is better as far as the set promises: a set that bounds the error promises 1, a confidence ellipsoid its
    level.  An estimator that believes too little is found here; one that believes too much holds every state, and its
    matrices in series.csv show what that costs.

    Where S is singular, an error that leaves its range is outside.  A method is refused where the estimator does not
    give what S is made of; one that gives it at some samples only has no value.

    Parameters
    ----------
    units : what the metric must know of the experiment
    name : column of the tables
    of : the set is M; gaussian is the ellipsoid that holds an error of covariance P at the level; sum is the smallest
        ellipsoid around the sum of both, or the one that there is.  Unless given, every method has its own: M where
        its estimator has one, else the ellipsoid of P
    level : of the ellipsoid of P
    from_ : first sample (seconds or samples, as `time`)
    to : last sample, included; N is the last one of the experiment
    """
    reads = READS[of]
    refuse_other_states(units.plant, units.methods, "of" if of else "")
    refuse_without(units.plant, units.methods, *reads, parameter="of" if of else "")
    window = window_of(units, from_, to, units.n_steps - 1, units.n_steps)
    info = MetricInfo(name, "", "higher")
    return SampleMetric(info, window, Inside(of, level), needs_P="P" in reads, needs_M="M" in reads)
