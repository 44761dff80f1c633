"""Metrics, and the record of a block of runs that they read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol, runtime_checkable

from jaxtyping import Bool, Float

from rmpc_bench.types.basics import Array
from rmpc_bench.types.controller import Controller


class MetricInfo(NamedTuple):
    """What a reader must know of a metric's column."""

    name: str
    """The column, and the word claims use."""
    unit: str
    """In the plant's units, such as ``rad^2``; empty when it has none."""
    direction: str
    """Which value is better: ``lower``, ``higher``, ``zero`` (signed, best at 0) or ``one`` (a ratio, best at 1)."""
    may_be_never: bool = False
    """Whether a run may have no value at all (inf); such a metric has a share and a median, no mean."""


class Record(NamedTuple):
    """The trajectories of a block, which metrics read; samples k = 0..N."""

    Ts: float
    x: Float[Array, "runs samples nx"]
    y: Float[Array, "runs samples ny"]
    """True output, without measurement noise."""
    x_hat: Float[Array, "runs samples nx_hat"]
    u: Float[Array, "runs steps nu"]
    """Applied input; there is none at k = N."""
    r: Float[Array, "samples ny"]
    P: Float[Array, "samples nx_hat nx_hat"] | Float[Array, "runs samples nx_hat nx_hat"] | None = None
    """Reported covariance of x_hat - x; None unless a metric has ``needs_P`` and every k one."""
    M: Float[Array, "samples nx_hat nx_hat"] | Float[Array, "runs samples nx_hat nx_hat"] | None = None
    """Shape matrix of the reported set of x_hat - x; None as P is, with ``needs_M``."""
    controller: Controller | None = None
    """The method's controller, for a metric that reads its certificate; None where it is not known."""
    info: Mapping[str, Float[Array, "runs _ _"]] = {}
    """What estimator (k = 0..N) and controller (k = 0..N-1) report, entries of a matrix row by row; only what a metric
    names in ``needs_info`` or is recorded, and only if the method reports it."""
    bursts: Bool[Array, "runs samples"] | None = None
    """Whether measurement noise is in a burst; None where no law of it has bursts."""


@runtime_checkable
class Metric(Protocol):
    """A number per run, made from its trajectories."""

    @property
    def info(self) -> MetricInfo: ...

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """One value per run; inf stands for *never*."""
