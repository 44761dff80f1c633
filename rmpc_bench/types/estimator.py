"""Base class of state estimators."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Literal

from jaxtyping import Float

from rmpc_bench.types.basics import Array, Design, attribute
from rmpc_bench.types.records import CompiledFilter, Estimate, GainSchedule


class Estimator(Design):
    """A filter: a frozen design, shared by all runs.

    A subclass gives the methods `init`, `correct` and `predict`.  Everything else has a default.

    Examples
    --------
    >>> import rmpc_bench
    >>> class Last(Estimator):
    ...     def init(self, n_runs): return None
    ...     def correct(self, k, state, y): return state, Estimate(y)
    ...     def predict(self, k, state, u): return state
    >>> rmpc_bench.filter_data(Last(), [[1.0], [2.0]], [[0.0]]).x_hat.tolist()
    [[1.0], [2.0]]
    """

    @attribute
    def starts_runs(self) -> bool:
        """Whether `init` takes the runs of the block, as ``init(n_runs, runs=RunInfo(...))``."""
        return False

    @attribute
    def knows_uncertainty(self) -> bool:
        """Whether this is an oracle estimator; `init` then takes the uncertain quantities of the runs as well."""
        return False

    @attribute
    def estimates_mean(self) -> bool:
        """Whether the info of every estimate has the mean of the process noise, `w_mean` (runs, nx)."""
        return False

    @attribute
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """Entries of `info` that metrics, figures and records may name, with the shape of the entry of one run."""
        return {}

    @attribute
    def Ne(self) -> int:
        """Length of a moving window: the estimate uses y(k - Ne)..y(k); 0 without a window."""
        return 0

    @attribute
    def bridges_missing(self) -> bool:
        """Whether a missing measurement (NaN) is replaced by its prediction; otherwise the run diverges there."""
        return False

    @attribute
    def repeats(self) -> bool:
        """Whether steps can be repeated from a state that `copied` has returned, as late measurements need it."""
        return True

    @attribute
    def takes_input(self) -> bool:
        """Whether `correct` takes u(k) as well, for h(x, u) of its flow; otherwise it gets y(k) - D u(k)."""
        return bool(getattr(getattr(self, "flow", None), "fed", False))

    @attribute
    def fed(self) -> Any:
        """Design model with feedthrough, whose D u(k) is taken from y(k) for `correct`; None without."""
        return None

    @attribute
    def form(self) -> Literal["filter", "predictor"] | None:
        """Whether x_hat(k) uses y(k) (`filter`) or not (`predictor`); None where it is not declared."""
        return None

    @attribute
    def x0(self) -> Float[Array, " nx"] | None:
        """Prediction of x(0), the same for all runs; None where it is not declared."""
        return None

    @attribute
    def P(self) -> Float[Array, "k nx nx"] | None:
        """Reported covariance of x_hat - x over k; None where it depends on the data or is not reported."""
        return None

    @attribute
    def P_is(self) -> Literal["covariance", "bound"]:
        """Whether P is meant as the covariance of x_hat - x or as an upper bound of it."""
        return "covariance"

    @attribute
    def M(self) -> Float[Array, "k nx nx"] | None:
        """Shape of the reported set of x_hat - x over k; None where it depends on the data or is not reported."""
        return None

    @attribute
    def sets(self) -> Any:
        """Sets of the noises that P or M count with (`models.noise_sets.NoiseSets`); None for those of the model."""
        return None

    @attribute
    def estimates_set(self) -> bool:
        """Whether every estimate has the set `M` of its error, also where it depends on the data."""
        return self.M is not None

    @attribute
    def uncertainty_scale(self) -> float | None:
        """Factor of the uncertainty of the model, F' F <= I, that the design guards against; None if it does not."""
        return None

    @attribute
    def gain_schedule(self) -> GainSchedule | None:
        """The filter as a linear one with given gains; None where its gains depend on the data."""
        return None

    @attribute
    def has_compiled_form(self) -> bool:
        """Whether `compiled_form` gives the filter as arrays for the compiled simulation."""
        return False

    def compiled_form(self) -> CompiledFilter:
        """Return the arrays with which the compiled simulation repeats `correct` and `predict`, bit for bit."""
        raise NotImplementedError("compiled_form")

    @abstractmethod
    def init(self, n_runs: int) -> Any:
        """Return the state before the first measurement.

        With `knows_uncertainty` it is called as ``init(n_runs, delta)``, where ``delta`` is the record that the plant
        has drawn.
        """
        raise NotImplementedError("init")

    @abstractmethod
    def correct(self, k: int, state: Any, y: Float[Array, "runs ny"]) -> tuple[Any, Estimate]:
        """Use y(k)."""
        raise NotImplementedError("correct")

    @abstractmethod
    def predict(self, k: int, state: Any, u: Float[Array, "runs nu"]) -> Any:
        """Go to k+1 with u(k) as the method knows it: the input that acts, without noise and with the known delay."""
        raise NotImplementedError("predict")

    def copied(self, state: Any) -> Any:
        """Return a copy of a state; by default the state itself, which `correct` and `predict` leave as it is."""
        return state

    def series(self) -> Mapping[str, Array]:
        """Series of the design over k (axis 0), such as gains and covariances; they are stored in series.csv."""
        return {}
