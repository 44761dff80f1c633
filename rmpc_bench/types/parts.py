"""The protocols that the simulation loop speaks, and the records that they exchange."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types.basics import Array, Statuses


class Estimate(NamedTuple):
    """What an estimator says at k."""

    x_hat: Float[Array, "runs nx"]
    P: Float[Array, "nx nx"] | Float[Array, "runs nx nx"] | None
    """Covariance of x_hat - x as the estimator believes it."""
    M: Float[Array, "nx nx"] | Float[Array, "runs nx nx"] | None
    """Shape matrix of the set that x_hat - x is believed to lie in."""
    status: Statuses
    info: Mapping[str, Array]


class Command(NamedTuple):
    """What a controller does at k."""

    u: Float[Array, "runs nu"]
    status: Statuses
    info: Mapping[str, Array]


class Motion(NamedTuple):
    """Where a plant is at k+1."""

    x: Float[Array, "runs nx"]
    status: Statuses


@runtime_checkable
class Plant(Protocol):
    """The truth: a design that moves the states of many runs."""

    @property
    def nx(self) -> int: ...
    @property
    def nu(self) -> int: ...
    @property
    def ny(self) -> int: ...
    @property
    def nw(self) -> int: ...
    @property
    def nv(self) -> int: ...
    @property
    def Ts(self) -> float:
        """Sampling time [s]."""

    @property
    def y_unit(self) -> str: ...
    @property
    def u_unit(self) -> str: ...
    @property
    def nominal(self) -> Mapping[str, float]:
        """The parameters that ``perturb`` and ``set`` may name, with their nominal values."""

    def draw(
        self, parameters: Mapping[str, Float[Array, " runs"]], rngs: Sequence[np.random.Generator], n_steps: int
    ) -> Any:
        """Fix what is uncertain for a block of runs.

        ``parameters`` has one row per run for every name in ``nominal``; ``rngs`` has one generator per run for what
        the configuration cannot name.  Returns the record ``delta`` (axis 0 = run) that ``step`` and ``output`` take.
        """

    def step(
        self, k: int, delta: Any, x: Float[Array, "runs nx"], u: Float[Array, "runs nu"], w: Float[Array, "runs nw"]
    ) -> Motion:
        """Move to x(k+1)."""

    def output(
        self, k: int, delta: Any, x: Float[Array, "runs nx"], v: Float[Array, "runs nv"]
    ) -> Float[Array, "runs ny"]:
        """Measure y(k)."""


@runtime_checkable
class Estimator(Protocol):
    """A filter: a frozen design, shared by all runs."""

    def init(self, n_runs: int) -> Any:
        """State before the first measurement."""

    def correct(self, k: int, state: Any, y: Float[Array, "runs ny"]) -> tuple[Any, Estimate]:
        """Use y(k)."""

    def predict(self, k: int, state: Any, u: Float[Array, "runs nu"]) -> Any:
        """Go to k+1 with the applied u(k)."""


@runtime_checkable
class Controller(Protocol):
    """A control law: a frozen design, shared by all runs."""

    @property
    def preview(self) -> int:
        """How many samples of the reference ``control`` sees, r(k) included."""

    def init(self, n_runs: int) -> Any:
        """State before the first sample."""

    def control(
        self, k: int, state: Any, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[Any, Command]:
        """Choose u(k)."""


class Method(NamedTuple):
    """An estimator-controller pair under the name the user gave it."""

    name: str
    estimator: Estimator
    controller: Controller


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
    """Covariance of x_hat - x as the estimator believes it; None unless a metric has ``needs_P`` and every k one."""
    M: Float[Array, "samples nx_hat nx_hat"] | Float[Array, "runs samples nx_hat nx_hat"] | None = None
    """Shape matrix of the set that x_hat - x is believed to lie in; None as P is, with ``needs_M``."""
    controller: Any = None
    """The method's controller, for a metric that asks it something; None where nobody knows."""
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
