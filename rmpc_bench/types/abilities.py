"""What a part may offer beyond its protocol; whoever wants it asks with isinstance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

from jaxtyping import Float

from rmpc_bench.types.basics import Array


@runtime_checkable
class WarmsUp(Protocol):
    """A design may offer this: costly work that is done once, before it goes to workers."""

    def warm_up(self) -> None:
        """Do it; doing it again costs nothing."""


@runtime_checkable
class HasRemarks(Protocol):
    """A plant or an estimator may offer this; ``check`` shows it."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a user should know of it."""


@runtime_checkable
class Informed(Protocol):
    """An estimator that is told what is uncertain: an oracle, marked in every table."""

    @property
    def informed(self) -> bool:
        """True."""

    def init(self, n_runs: int, delta: Any) -> Any:
        """State before the first measurement, given the plant's record of what was drawn."""


@runtime_checkable
class HasSets(Protocol):
    """A model that knows ellipsoids in which the bounded parts of the noises lie."""

    def at(self, k: int, /) -> Any:
        """The linear model at k."""

    def M_w(self, k: int, /) -> Float[Array, "nx nx"]:
        """Shape of that of the process noise at k."""

    def M_v(self, k: int, /) -> Float[Array, "ny ny"]:
        """Shape of that of the measurement noise at k."""


@runtime_checkable
class Regulates(Protocol):
    """A controller may offer this: it drives the state to 0 and looks at no reference."""

    @property
    def regulates(self) -> bool:
        """True."""


@runtime_checkable
class EstimatesMean(Protocol):
    """An estimator may offer this: the info of its estimates has the mean of the process noise, `w_mean` (runs, nx)."""

    @property
    def estimates_mean(self) -> bool:
        """True."""


@runtime_checkable
class HasOpponent(Protocol):
    """A plant whose uncertainty may be chosen by an adversary."""

    @property
    def opponent(self) -> tuple[str, float] | None:
        """Name of the method it works against and the largest norm of its F; None where there is no adversary."""

    def against(self, worst: tuple[Array, ...]) -> Any:
        """Return the plant with the sequences (samples, r, s) that the adversary has chosen."""


@runtime_checkable
class HasCertificate(Protocol):
    """A controller may offer this; a metric then compares what its bound says with what allowed noise can do."""

    @property
    def certifies(self) -> bool:
        """Whether this design has an answer."""

    def certificate(
        self, k: int, x_hat: Float[Array, "runs nx"], starts: int
    ) -> tuple[Float[Array, " runs"], Float[Array, " runs"]]:
        """Return rho and the worst of every run: costs from k on, beyond the least one without bounded noise.

        rho is what the controller certifies; the worst is the largest that a local search over allowed noise has found
        from so many starts, hence a lower bound of the true one.
        """


@runtime_checkable
class MixesNoise(Protocol):
    """A plant may offer this; its `step` and `output` then get what `mix` makes of the noises.

    Its output is the true one plus what `mix` has made of v.
    """

    def mix(
        self, delta: Any, w: Float[Array, "runs samples nw"], v: Float[Array, "runs samples nv"]
    ) -> tuple[Float[Array, "runs samples mw"], Float[Array, "runs samples mv"]]:
        """Pass w and v of all samples k = 0..N through the uncertain matrices of every run."""


@runtime_checkable
class HasDrawn(Protocol):
    """A plant may offer this; what it has drawn once for a run is then stored beside the named quantities."""

    def drawn(self, delta: Any) -> Mapping[str, Float[Array, " runs"]]:
        """Values by name."""


class Channel(NamedTuple):
    """Uncertainty H F G: the diagonal entries of F are white and independent, with one variance."""

    H: Float[Array, "nz r"]
    G: Float[Array, "s nq"]
    mean: Float[Array, "r s"]
    variance: float


class Period(NamedTuple):
    """One period of a linear plant: [x(k+1); y(k)] = (M + sum of H F G) [x; w; v] + [B u; 0]."""

    M: Float[Array, "nz nq"]
    B: Float[Array, "nx nu"]
    channels: tuple[Channel, ...]


@runtime_checkable
class HasPeriod(Protocol):
    """A plant may offer this; ensemble moments are then exact."""

    def period(self, k: int) -> Period | None:
        """The period at k; None where its uncertainty is not white."""


class LinearTruth(NamedTuple):
    """A plant without its nonlinear parts: x(k+1) = A x(k) + B u(k), y(k) = C x(k); a model's state is E x(k)."""

    A: Float[Array, "*runs n n"]
    B: Float[Array, "*runs n nu"]
    C: Float[Array, "*runs ny n"]
    E: Float[Array, "*runs nx n"]
    """Picks the states that a model knows out of the plant's."""


@runtime_checkable
class HasLinearPart(Protocol):
    """A plant may offer this; ``check --deep`` then measures how far it is from a model."""

    def linear(self, parameters: Mapping[str, float]) -> LinearTruth | None:
        """Drop what is not linear and sample the rest; None where the parameters of the run have no meaning."""


@runtime_checkable
class Reports(Protocol):
    """An estimator or a controller may offer this: entries of `info` that metrics, figures and records may name."""

    @property
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """Name -> shape of the entry of one run; () is a number."""


@runtime_checkable
class HasWindow(Protocol):
    """An estimator may offer this: it fits the last samples."""

    @property
    def Ne(self) -> int:
        """Length of its window: it uses y(k - Ne)..y(k)."""


@runtime_checkable
class HasUnits(Protocol):
    """A plant whose components have units of their own; `y_unit` and `u_unit` are empty where they differ."""

    @property
    def units(self) -> Mapping[str, str]:
        """Component, counted from 0, such as ``y.2`` -> unit."""


@runtime_checkable
class HasWorkspace(Protocol):
    """A plant may offer this; a reference that it cannot follow is then a mistake of the configuration."""

    def unreachable(self, r: Float[Array, "samples ny"]) -> str | None:
        """Say where a reference leaves the workspace or meets a singular pose, and how; None where it does not."""


@runtime_checkable
class HasSingularPoses(Protocol):
    """A plant may offer this; a metric then counts how often a run came close to one."""

    def manipulability(self, y: Float[Array, "poses ny"]) -> Float[Array, " poses"]:
        """Smallest singular value of what maps output velocities to those of the drives; 0 where a pose is singular."""


@runtime_checkable
class HasCost(Protocol):
    """A plant, an estimator or a controller may offer this where it takes more than a few microseconds; for `check`."""

    @property
    def cost_per_step(self) -> float:
        """About how long it takes per run and step, in a block of 50 runs [s]."""
