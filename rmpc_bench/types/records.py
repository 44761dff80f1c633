"""Records that plants, estimators and controllers exchange, statuses of a run, and components as arrays.

A component returns an array form for the compiled simulation of a whole period (`simulation.linear_loop`) only if that
gives the very numbers of its own methods.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int, Int8

from rmpc_bench.types.basics import Array


class Explained(IntEnum):
    """Outcomes as numbers, each with an explanation."""

    explanation: str

    def __new__(cls, value: int, explanation: str) -> Explained:
        """Attach the explanation to the number."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.explanation = explanation
        return member

    @property
    def word(self) -> str:
        """The outcome as tables and files spell it: lower case with hyphens."""
        return self.name.lower().replace("_", "-")


class Status(Explained):
    """What became of a run; the text of a member is shown wherever a failure is counted.

    Examples
    --------
    >>> Status(6).name, Status.INFEASIBLE.explanation
    ('INFEASIBLE', 'an optimiser reported that its constraints have no solution')
    """

    OK = 0, "the run reached its last sample"
    DIVERGED = 1, "a state or an estimate exceeded its limit (`plant.diverged`), or a value is not a number"
    OUT_OF_RANGE = (
        2,
        "a drawn parameter or a state left the range of the plant (a mass, the length of an arm, `plant.bounds`)",
    )
    TOO_MANY_EVENTS = 3, "friction stopped and released a body more often in one sample than can be followed"
    EMPTY_SET = 4, "the measurement and the predicted set have no state in common"
    SINGULAR = (
        5,
        "the mechanism came to a pose in which its drives cannot move it every way, or the covariance of a nonlinear "
        "filter was indefinite twice",
    )
    INFEASIBLE = 6, "an optimiser reported that its constraints have no solution"
    NOT_CONVERGED = 7, "a solver did not converge (`SolverError`)"
    TIMEOUT = 8, "a step or the run took longer than `execution.timeout`"
    CRASHED = 9, "a component raised an exception, returned an invalid value or ended its process"


STATUS_WORDS = {int(status): status.word for status in Status}
"""Word of every status, at its number."""
Statuses: TypeAlias = Int8[Array, " runs"]


DISTURBANCES = "d_hat"
"""Entry of the info of an estimate: the estimated disturbances of the design model."""
_ALL_OK = np.zeros((), dtype=np.int8)
"""Status of every run where a component gives none; `as_estimate` and its siblings repeat it for every run."""
_ALL_OK.setflags(write=False)
_NO_INFO: Mapping[str, Array] = MappingProxyType({})


class Estimate(NamedTuple):
    """Result of a correction at k."""

    x_hat: Float[Array, "runs nx"]
    P: Float[Array, "nx nx"] | Float[Array, "runs nx nx"] | None = None
    """Reported covariance of x_hat - x."""
    M: Float[Array, "nx nx"] | Float[Array, "runs nx nx"] | None = None
    """Shape matrix of the reported set of x_hat - x."""
    status: Statuses = _ALL_OK
    info: Mapping[str, Array] = _NO_INFO


def without_disturbances(estimate: Estimate, nd: int) -> Estimate:
    """Return the estimate of x from that of [x; d]; its info has d_hat as a further entry.

    Examples
    --------
    >>> found = without_disturbances(Estimate(np.array([[1.0, 2.0, 5.0]])), 1)
    >>> found.x_hat.tolist(), found.info["d_hat"].tolist()
    ([[1.0, 2.0]], [[5.0]])
    """
    if not nd:
        return estimate
    x_hat, P, M = estimate.x_hat, estimate.P, estimate.M
    return estimate._replace(
        x_hat=x_hat[:, :-nd],
        P=None if P is None else P[..., :-nd, :-nd],
        M=None if M is None else M[..., :-nd, :-nd],
        info={**estimate.info, DISTURBANCES: x_hat[:, -nd:]},
    )


class Command(NamedTuple):
    """Result of a control law at k."""

    u: Float[Array, "runs nu"]
    status: Statuses = _ALL_OK
    """A run whose status is not OK ends here."""
    info: Mapping[str, Array] = _NO_INFO
    step_status: Statuses | None = None
    """Status of the optimisation at k, where u comes from a fallback and the run goes on; None if all are OK."""


class OperatingPoint(NamedTuple):
    """A point of a plant in physical coordinates, around which a model is linear."""

    x: Float[Array, " nx"]
    u: Float[Array, " nu"]
    y: Float[Array, " ny"]


class Motion(NamedTuple):
    """State of a plant at k+1."""

    x: Float[Array, "runs nx"]
    status: Statuses = _ALL_OK


def as_estimate(answer: Any) -> Estimate:
    """Return the answer of a `correct` as an `Estimate` with one status per run.

    Parameters
    ----------
    answer : an `Estimate`, or only the array x_hat (runs, nx)

    Examples
    --------
    >>> as_estimate(np.zeros((2, 1))).status.tolist()
    [0, 0]
    """
    estimate = answer if isinstance(answer, Estimate) else Estimate(np.asarray(answer))
    return estimate if np.ndim(estimate.status) else estimate._replace(status=_repeated(estimate.x_hat))


def as_command(answer: Any) -> Command:
    """Return the answer of a `control` as a `Command`; it may be only the array u (runs, nu)."""
    command = answer if isinstance(answer, Command) else Command(np.asarray(answer))
    return command if np.ndim(command.status) else command._replace(status=_repeated(command.u))


def as_motion(answer: Any) -> Motion:
    """Return the answer of a `step` as a `Motion`; it may be only the array x(k+1) (runs, nx)."""
    motion = answer if isinstance(answer, Motion) else Motion(np.asarray(answer))
    return motion if np.ndim(motion.status) else motion._replace(status=_repeated(motion.x))


def _repeated(values: Array) -> Statuses:
    """Return the status OK for every row."""
    return np.zeros(len(values), dtype=np.int8)


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


class LinearPlant(NamedTuple):
    """Linear part of a plant: x(k+1) = A x(k) + B u(k), y(k) = C x(k); the state of the design model is E x(k)."""

    A: Float[Array, "*runs n n"]
    B: Float[Array, "*runs n nu"]
    C: Float[Array, "*runs ny n"]
    E: Float[Array, "*runs nx n"]
    """Selects the states of the design model from the states of the plant."""
    D: Float[Array, "*runs ny nu"] | float = 0.0
    """Feedthrough: y(k) has the further term D u(k)."""


class GainSchedule(NamedTuple):
    """A linear filter whose gains do not depend on the data; axis 0 of every matrix is k, of length 1 where constant.

    x_pred(k+1) = F x_pred + B u + f + K e,  x_hat = x_pred + L e,  e = y - C x_pred - d.
    """

    x0: Float[Array, " nx"]
    F: Float[Array, "kF nx nx"]
    B: Float[Array, "kB nx nu"]
    C: Float[Array, "kC ny nx"]
    K: Float[Array, "kK nx ny"]
    L: Float[Array, "kL nx ny"]
    f: Float[Array, "kf nx"] | None = None
    """None where it is zero."""
    d: Float[Array, "kd ny"] | None = None
    """None where it is zero."""


class LawState(NamedTuple):
    """State s of a linear control law, such as an integral of the control error, and what the law takes from y(k).

    u(k) has the further terms K_s s(k) + K_y y(k), and s(k+1) = A_s s(k) + B_x x_hat(k) + B_y y(k) without a reference.
    """

    K_s: Float[Array, "nu ns"]
    K_y: Float[Array, "nu ny"]
    A_s: Float[Array, "ns ns"]
    B_x: Float[Array, "ns nx"]
    B_y: Float[Array, "ns ny"]


class LinearLaw(NamedTuple):
    """Gains of the control law u(k) = u(k-1) - K_u u(k-1) + K_r [r(k+1); r(k+2); ..] - K_x x_hat(k)."""

    K_x: Float[Array, "nu nx"]
    K_u: Float[Array, "nu nu"]
    K_r: Float[Array, "nu rows"]
    state: LawState | None = None
    """State of the law besides u(k-1); None for a law that has none and does not use y(k)."""
    affine: bool = False
    """Whether the law has constant terms too, such as those of an operating point."""


class OptimisedStep(Explained):
    """How the moves of a sample were found; the entry `qp` of a command's info has its number."""

    SKIPPED = 0, "no limit acts: the closed form is the minimum"
    SOLVED = 1, "the quadratic program was solved, and no slack is in use"
    SOFTENED = 2, "the quadratic program was solved, and the slack of a soft limit is in use"
    INFEASIBLE = 3, "no moves satisfy the hard limits; the fallback was used"
    NOT_CONVERGED = 4, "the solver did not find the minimum; the fallback was used"

    @property
    def failed(self) -> bool:
        """Whether the fallback was used."""
        return self in (OptimisedStep.INFEASIBLE, OptimisedStep.NOT_CONVERGED)


class StepFunction(NamedTuple):
    """The step of a plant without a linear form, as a compiled function, see `numerics.linear_loop_kernel`."""

    advance: Any
    """Compiled function that writes x(k+1), w(k) included, and returns a status."""
    own: Float[Array, "runs rows own"]
    """Numbers of every run; those of one run are passed to the function."""
    shared: Float[Array, "rows shared"]
    """Numbers that all runs have in common."""
    sizes: Int[Array, " sizes"]
    """Numbers of rows and columns, for the function."""
    work: tuple[int, int]
    """Shape of the memory that the function writes into."""


class Term(NamedTuple):
    """A signal times matrices, of which the first is applied first; without any, the first coordinates of the signal.

    A matrix is (k, n, m), k = 1 where it is constant, or (runs, k, n, m) where every run has its own.
    """

    signal: Literal["x", "u", "w"]
    matrices: tuple[Array, ...] = ()


class CompiledPlant(NamedTuple):
    """A plant for the compiled simulation: x(k+1) and y(k) as sums of terms, which are added in this order."""

    step: tuple[Term, ...] | StepFunction
    """x(k+1), w(k) included."""
    output: tuple[Term, ...]
    """y(k) without measurement noise."""
    status: Statuses
    """What the plant reports at every step of a run, unless it is OK."""


class CompiledFilter(NamedTuple):
    """A linear filter with given gains, and what it reports; axis 0 of every array is k, of length 1 if constant."""

    schedule: GainSchedule
    S: Float[Array, "kS ny ny"] | None = None
    """Covariance of the innovation."""


class CompiledLaw(NamedTuple):
    """A linear control law; axis 0 of K_x and u_0 is k and has length 1 if they are constant.

    With K_u     u(k) = (u(k-1) - K_u u(k-1) + given(k) - K_x x_hat(k)) - u_0(k), limited to [low, high]
    without K_u  u(k) = u_op + (-K_x (x_hat(k) - x_op) - u_0(k)), with or without an operating point
    without K_x  u(k) = given(k)
    """

    given: Float[Array, "runs kgiven nu"]
    """Axis 0 has length 1 if it is the same for all runs, axis 1 if it is constant."""
    K_x: Float[Array, "kK nu nx"] | None = None
    K_u: Float[Array, "nu nu"] | None = None
    u_0: Float[Array, "k0 nu"] | None = None
    low: float = -float("inf")
    high: float = float("inf")
    start: Float[Array, " nu"] | None = None
    """Input before k = 0; None for 0."""
    point: OperatingPoint | None = None
