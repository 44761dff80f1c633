"""Base class of controllers, and the pair of an estimator and a controller."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxtyping import Float

from rmpc_bench.types.basics import Array, Design, attribute
from rmpc_bench.types.estimator import Estimator
from rmpc_bench.types.model import Model
from rmpc_bench.types.records import DISTURBANCES, Command, CompiledLaw, Estimate, LinearLaw


class Ahead(NamedTuple):
    """What a law gets besides where its input acts d samples later."""

    y_hat: Float[Array, "d runs ny"]
    """Predicted outputs at k..k+d-1."""
    acts: int
    """k + d, at most N - 1."""


class Controller(Design):
    """A control law: a frozen design, shared by all runs.

    A subclass gives the methods `init` and `control`.  Everything else has a default.

    Examples
    --------
    >>> class Proportional(Controller):
    ...     def init(self, n_runs): return None
    ...     def control(self, k, state, y, estimate, r): return state, Command(2.0 * (r - y))
    >>> Proportional().control(0, None, 1.0, None, 3.0)[1].u
    4.0
    """

    @attribute
    def starts_runs(self) -> bool:
        """Whether `init` takes the runs of the block, as ``init(n_runs, runs=RunInfo(...))``."""
        return False

    @attribute
    def preview(self) -> int:
        """Number of samples of the reference that `control` takes, r(k) included."""
        return 1

    @attribute
    def compares_estimate(self) -> bool:
        """Whether the law compares the reference with the output of the estimate, so that angles need equal turns."""
        return False

    @attribute
    def regulates(self) -> bool:
        """Whether the law drives the state to 0, or to an operating point, and does not use the reference."""
        return False

    @attribute
    def regulates_to(self) -> Float[Array, " ny"] | None:
        """Output at the operating point to which a law with `regulates` drives the plant; None for 0."""
        return None

    @attribute
    def uses_estimate(self) -> bool:
        """Whether u(k) depends on the estimate, which then is predicted over a delay of the input."""
        return True

    @attribute
    def takes_acting_input(self) -> bool:
        """Whether `applied` gets the input that acts at k, as far as the method knows it, delays included."""
        return False

    @attribute
    def allows_delay(self) -> bool:
        """Whether the design model may have a delay of the input."""
        return True

    @attribute
    def allows_late_outputs(self) -> bool:
        """Whether the estimator may know late measurements: error bounds of its design are those without delay."""
        return True

    @attribute
    def input_limits(self) -> tuple[float | Float[Array, " nu"], float | Float[Array, " nu"]] | None:
        """Lower and upper limit, a number for all inputs or one per input; None where there are none."""
        return None

    @attribute
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """Entries of `info` that metrics, figures and records may name, with the shape of the entry of one run."""
        return {}

    @attribute
    def optimises(self) -> bool:
        """Whether it optimises at every sample and goes on after a failed one, which `Command.step_status` counts."""
        return "qp" in self.reports

    @attribute
    def certifies(self) -> bool:
        """Whether this design bounds the effect of the bounded noise, so that `certificate` is defined."""
        return False

    @attribute
    def has_compiled_form(self) -> bool:
        """Whether `compiled_form` gives the law as arrays for the compiled simulation."""
        return False

    def compiled_form(self, r: Float[Array, "known ny"], n_steps: int, runs: Sequence[int]) -> CompiledLaw:
        """Return the arrays with which the compiled simulation repeats `control`, bit for bit.

        Parameters
        ----------
        r : reference from k = 0 on
        n_steps : number of control periods N
        runs : indices of the runs
        """
        raise NotImplementedError("compiled_form")

    @abstractmethod
    def init(self, n_runs: int) -> Any:
        """Return the state before the first sample."""
        raise NotImplementedError("init")

    @abstractmethod
    def control(
        self, k: int, state: Any, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[Any, Command]:
        """Choose u(k)."""
        raise NotImplementedError("control")

    def control_ahead(
        self, k: int, state: Any, y: Array, estimate: Estimate, r: Array, ahead: Ahead
    ) -> tuple[Any, Command]:
        """Choose u(k), which acts at k + d, by default as `control` would choose it there.

        The estimate is the prediction of x(k+d), without P and M, and r begins at k.
        """
        return self.control(ahead.acts, state, y, estimate, r[len(ahead.y_hat) :])

    def applied(self, k: int, state: Any, u: Float[Array, "runs nu"]) -> Any:
        """Return the state that `control` has returned at k, with what becomes of its u(k).

        The simulation calls it after the input was limited to the bounds of the plant, rounded or held, as far as the
        method knows, and before any delay.  A law with a memory of its input, such as u(k-1) or an integral with
        anti-windup, replaces that in its state.  By default nothing changes.
        """
        return state

    def with_period(self, period: Float[Array, " ny"]) -> Controller:
        """Return the law for outputs of which some are angles; a law that does not compare them stays as it is."""
        return self

    def known_inputs(self, u: Float[Array, "runs nu"]) -> Float[Array, "runs nu"]:
        """Return the u(k) that the estimator of the method gets."""
        return u

    def linear_law(self) -> LinearLaw | None:
        """Return the gains of a law that is linear apart from limits of the input; None of any other law."""
        return None

    def certificate(
        self, k: int, x_hat: Float[Array, "runs nx"], starts: int, *, shared: bool = False
    ) -> tuple[Float[Array, " runs"], Float[Array, " runs"]]:
        """Return rho and the worst cost of every run: costs from k on, beyond the least one without bounded noise.

        rho is the bound that the controller certifies.  The worst cost is the largest one that a local search over
        allowed noise finds from ``starts`` starting points, hence a lower bound of the true worst case.  With
        ``shared`` the noises of all samples are in one set, and not each in its own.
        """
        raise NotImplementedError("certificate")

    def series(self) -> Mapping[str, Array]:
        """Series of the design over k (axis 0), such as its gains, for programs; series.csv has those of estimators."""
        return {}


class KnownDelay(NamedTuple):
    """Delays that the design model of a method knows [samples]."""

    input: int = 0
    measurement: tuple[int, ...] | None = ()
    """Of every output, empty where none is late; None where every measurement comes with its time."""


class Method(NamedTuple):
    """An estimator-controller pair under the name the user gave it.

    Examples
    --------
    >>> import rmpc_bench
    >>> rmpc_bench.load_config("quickstart").experiment.methods[1].name
    'R-MPC'
    """

    name: str
    estimator: Estimator
    controller: Controller
    n_disturbances: int = 0
    """Number of disturbances that the design model has as its last states; see `types.estimate_of_x`."""
    remarks: tuple[str, ...] = ()
    """Sentences about the pair, which warnings and tables show."""
    delay: KnownDelay = KnownDelay()
    flow: Any = None
    """Design model as maps of many states (`models.flow.Flow`), for predictions over the delay of the input."""
    u_before: tuple[float, ...] = ()
    """Input before k = 0, that of the operating point of the design model; empty for 0."""
    period: Float[Array, " ny"] | None = None
    """Period of every output, 0 of one that is no angle; None where none is."""
    model: Model | None = None
    """Design model, for the output of an estimate, where outputs are angles."""

    @property
    def preview(self) -> int:
        """Number of samples of the reference that are known at k, r(k) included."""
        return self.controller.preview + self.delay.input

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """Entries of `info` of the estimator and of the controller: name -> shape of the entry of one run."""
        disturbances = {DISTURBANCES: (self.n_disturbances,)} if self.n_disturbances else {}
        reported = (*disturbances.items(), *self.estimator.reports.items(), *self.controller.reports.items())
        return {name: tuple(shape) for name, shape in reported}
