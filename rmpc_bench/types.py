"""Protocols and records that every other module speaks.

Axis 0 of every array is the run; ``k`` is the time index.  A design is frozen and shared by all runs, a state is a
NamedTuple of arrays, a step is pure.  The only imports are NumPy, jaxtyping and the constraint marks of
annotated-types (which pydantic brings along and reads).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any, NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt
from annotated_types import Ge, Gt, Le
from jaxtyping import Float, Int8

Array: TypeAlias = npt.NDArray[Any]
Matrix: TypeAlias = float | list[float] | list[list[float]]
"""A number stands for that number times the identity, a list for its diagonal."""

Positive: TypeAlias = Annotated[float, Gt(0)]
NonNegative: TypeAlias = Annotated[float, Ge(0)]
Count: TypeAlias = Annotated[int, Ge(1)]
Horizon: TypeAlias = Annotated[int, Ge(1), Le(1000)]
"""Samples ahead; the matrices of a prediction grow with its square."""


class Status(IntEnum):
    """What became of a run; the text of a member is shown wherever a failure is counted."""

    explanation: str

    def __new__(cls, value: int, explanation: str) -> Status:
        """Attach the explanation to the number."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.explanation = explanation
        return member

    OK = 0, "the run reached its last sample"
    DIVERGED = 1, "a state, an estimate or an input grew beyond 1e100 or stopped being a number"
    OUT_OF_RANGE = 2, "a drawn parameter lies where the model has no meaning (a mass that is not positive, say)"
    TOO_MANY_EVENTS = 3, "friction stopped and released a body more often in one sample than can be followed"

    @property
    def word(self) -> str:
        """The status as tables and files spell it: lower case with hyphens."""
        return self.name.lower().replace("_", "-")


Statuses: TypeAlias = Int8[Array, " runs"]


@dataclass(frozen=True, order=True)
class Problem:
    """One thing wrong with a configuration, at a place a text editor can open."""

    file: str
    line: int
    column: int
    path: str
    message: str

    def __str__(self) -> str:
        """Render as ``file:line:column: path: message``."""
        where = f"{self.file}:{self.line}:{self.column}: "
        return where + (f"{self.path}: {self.message}" if self.path else self.message)


class ConfigError(Exception):
    """Everything that is wrong with a configuration, sorted by place, at once."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(sorted(set(problems)))
        super().__init__("\n".join(str(problem) for problem in self.problems))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the problems, so that the error survives a worker process."""
        return type(self), (self.problems,)


class DesignError(Exception):
    """A design that cannot be made from its parameters; raised before any run.

    Parameters
    ----------
    message : what is wrong and the way out
    parameter : the parameter to blame, with dots inside a nested one, so that the message can point at its place
    """

    def __init__(self, message: str, parameter: str = "") -> None:
        self.parameter = parameter
        super().__init__(message)


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
    """Which value is better: ``lower``, ``higher`` or ``zero`` (signed, best at 0)."""
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


@runtime_checkable
class Metric(Protocol):
    """A number per run, made from its trajectories."""

    @property
    def info(self) -> MetricInfo: ...

    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """One value per run; inf stands for *never*."""


class Line(NamedTuple):
    """A curve of a part's picture."""

    label: str
    x: Float[Array, " points"]
    y: Float[Array, " points"]
    """NaN makes a gap."""


class Panel(NamedTuple):
    """A picture of a part itself, such as its friction; a design may have ``portrait() -> tuple[Panel, ...]``."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]


class Outlook(NamedTuple):
    """What the results of an experiment will have, as far as that is known before it runs."""

    signals: Mapping[str, int | None]
    """Recorded signal -> number of its components, None where that is not known."""
    end: float
    """Last time [s]; 0 in a smoke run, which is shorter than its figures ask for."""
    series: Mapping[str, tuple[int, ...]]
    """Series of the designs -> shape of an entry."""
    n_points: int
    """Points of the sweep."""
