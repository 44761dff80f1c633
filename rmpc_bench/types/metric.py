"""Base class of metrics, what they read, requirements such as settling_time < 20, and keys of comparisons."""

from __future__ import annotations

import math
import operator
import re
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
from annotated_types import Gt, Len, Lt
from jaxtyping import Bool, Float

from rmpc_bench.types.basics import Array, NonNegative, attribute
from rmpc_bench.types.controller import Controller, Method
from rmpc_bench.types.errors import DesignError, Issue, issues_of
from rmpc_bench.types.plant import Plant
from rmpc_bench.types.records import Estimate
from rmpc_bench.types.run_info import RunInfo

Bound: TypeAlias = NonNegative | Literal["N"] | None
"""End of a window in seconds or samples, as the experiment's `time` is given; N is the last sample."""
Axis: TypeAlias = Literal["model", "estimator", "controller"]
Direction: TypeAlias = Literal["lower", "higher", "zero", "one"]
"""Which value is better: a lower or a higher one, the one closest to 0 (signed), the one closest to 1 (a ratio)."""


ON_SAMPLE = 1e-9
"""Distance from a sample, in samples, up to which a time is the one of the sample."""
ACRONYMS = frozenset(("mse", "rmse", "mae", "nees", "nis", "iae", "ise", "qp", "crps"))
"""Words of the names of metrics that are written in capitals."""


class MetricInfo(NamedTuple):
    """Name, unit and direction of the column of a metric."""

    name: str
    """Name of the column, also used in claims."""
    unit: str
    """In the plant's units, such as ``rad^2``; empty where it has none."""
    direction: str
    """Which value is better, see `Direction`."""
    may_not_occur: bool = False
    """Whether the measured event may not occur in a run (inf); such a metric has a share and a median but no mean."""
    label: str = ""
    """Words for figures, tables and captions; made from the name if empty."""

    @property
    def words(self) -> str:
        """What a reader sees in place of the name: the label, else the name with blanks, such as ``settling time``.

        Examples
        --------
        >>> [MetricInfo(name, "", "lower").words for name in ("settling_time", "estimation_mse", "x_0", "mse")]
        ['settling time', 'estimation MSE', '$x_0$', 'MSE']
        """
        if self.label:
            return self.label
        if re.fullmatch(r"[A-Za-z]_\d", self.name):
            return f"${self.name}$"
        return " ".join(word.upper() if word in ACRONYMS else word for word in self.name.split("_"))


class SampleWindow(NamedTuple):
    """Samples first..last, both included."""

    first: int
    last: int

    @property
    def slice(self) -> slice:
        """The same samples for indexing."""
        return slice(self.first, self.last + 1)

    @property
    def length(self) -> int:
        """Number of samples."""
        return self.last - self.first + 1


class MetricLayout(NamedTuple):
    """Sizes, units and components of an experiment, as far as metrics depend on them."""

    n_steps: int
    """Number of control periods N; samples are k = 0..N."""
    tick: float = 1.0
    """Length of one sample in the unit in which windows are given: Ts with seconds, 1 with samples."""
    y_unit: str = ""
    u_unit: str = ""
    cut: bool = False
    """Whether a window that reaches beyond the last sample ends there (a smoke run is short)."""
    plant: Plant | None = None
    """None if it is not known; a metric then omits the checks that depend on the plant."""
    methods: tuple[Method, ...] = ()
    """Known methods; a metric checks each of them."""
    bursts: bool | None = None
    """Whether the measurement noise has bursts; None where it is not known."""
    first_estimates: Mapping[str, Estimate | None] = {}
    """Method with components of the user -> its estimate at k = 0 of a nominal run; None where there is none."""
    r: Float[Array, "samples ny"] | None = None
    """Reference at k = 0..N, known before the runs; None where it is not."""
    time_unit: str = "s"
    angles: Mapping[str, float] = {}
    """Place of a component that is an angle, such as x.0 or y.0 -> its period."""

    def around(self, bound: float) -> tuple[int, int]:
        """Return the last sample that is not after a time and the first that is not before it, equal on a sample.

        The time is in seconds or samples, as the experiment's `time` is given.
        """
        number = float(bound) / self.tick
        return math.floor(number + ON_SAMPLE), math.ceil(number - ON_SAMPLE)

    def sample(self, bound: float, key: str) -> int:
        """Return the sample at a time, the value of `key`; a DesignError if it is between two samples."""
        before, after = self.around(bound)
        if before != after:
            unit = (
                "`time` is given in steps" if self.tick == 1.0 else f"samples are {self.tick:g} {self.time_unit} apart"
            )
            raise DesignError(f"{bound:g} is between the samples {before} and {after}, as {unit}", key)
        return before


class Record(NamedTuple):
    """The trajectories of a block of runs, which metrics read; samples k = 0..N."""

    Ts: float
    x: Float[Array, "runs samples nx"]
    y: Float[Array, "runs samples ny"]
    """True output, without measurement noise."""
    x_hat: Float[Array, "runs samples nx_hat"]
    u: Float[Array, "runs steps nu"]
    """Input that acts, after all laws and within the bounds of the plant; there is none at k = N."""
    r: Float[Array, "samples ny"]
    P: Float[Array, "samples nx_hat nx_hat"] | Float[Array, "runs samples nx_hat nx_hat"] | None = None
    """Reported covariance of x_hat - x; None unless a metric has `needs_P` and the estimator gives one at every k."""
    M: Float[Array, "samples nx_hat nx_hat"] | Float[Array, "runs samples nx_hat nx_hat"] | None = None
    """Shape matrix of the reported set of x_hat - x; None as P is, with `needs_M`."""
    controller: Controller | None = None
    """The method's controller, for a metric that evaluates its certificate; None where it is not known."""
    info: Mapping[str, Float[Array, "runs _ _"]] = {}
    """What estimator (k = 0..N) and controller (k = 0..N-1) report, entries of a matrix row by row; only what a metric
    names in `needs_info` or is recorded, and only if the method reports it."""
    bursts: Bool[Array, "runs samples"] | None = None
    """Whether measurement noise is in a burst; None where no law of it has bursts."""
    experiment: MetricLayout | None = None
    """What is known about the experiment; None for trajectories from elsewhere."""
    runs: RunInfo | None = None
    """The runs of the block, for a metric that works run by run: it leaves out runs that are not `alive`."""
    delta: Any = None
    """What the plant has drawn for the runs, with which it computes its extra signals; None where it is not known."""

    command: Float[Array, "runs steps nu"] | None = None
    """What the controller has returned, where bounds of the plant or laws of the input may change it; else None."""
    gappy_P: Float[Array, "samples nx_hat nx_hat"] | Float[Array, "runs samples nx_hat nx_hat"] | None = None
    """Reported covariance of an estimator that gives one at some k only, NaN at the others; else None."""
    shared: dict[Any, Any] | None = None
    """What several metrics compute from the record, see `once`; None: each computes it itself."""

    @property
    def u_command(self) -> Float[Array, "runs steps nu"]:
        """Input that the controller has returned, or the section `input`, before laws and bounds of the input."""
        return self.u if self.command is None else self.command

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return what `make` computes, once for all metrics of the record."""
        if self.shared is None:
            return make()
        if key not in self.shared:
            self.shared[key] = make()
        return self.shared[key]

    @property
    def layout(self) -> MetricLayout:
        """The layout of the experiment; without one, windows are given in samples and nothing has a unit."""
        return self.experiment or MetricLayout(self.u.shape[1])

    @classmethod
    def of_run(
        cls, *, y: Any = None, r: Any = 0.0, x: Any = None, x_hat: Any = None, u: Any = None, Ts: float = 1.0
    ) -> Record:
        """Make the record of one run from lists; signals that are not given are 0.

        Parameters
        ----------
        y, r, x, x_hat : a number for all samples k = 0..N, or one entry per sample: a number or a list of coordinates
        u : the same for k = 0..N-1
        Ts : sampling time [s]

        Examples
        --------
        >>> record = Record.of_run(y=[0.0, 2.0, 4.0], u=[1.0, 3.0])
        >>> record.y.shape, record.u.shape, record.r.shape
        ((1, 3, 1), (1, 2, 1), (3, 1))
        """
        lengths = [len(each) for each in (y, r, x, x_hat) if np.ndim(each) > 0]
        n_samples = lengths[0] if lengths else len(u) + 1
        x, y, x_hat, r = (_column(values, n_samples) for values in (x, y, x_hat, r))
        return cls(Ts, x[None], y[None], x_hat[None], _column(u, n_samples - 1)[None], r)


def _column(values: Any, n: int) -> Float[Array, "samples coordinates"]:
    """Return a signal with axis 0 = k; None is 0."""
    array = np.asarray(0.0 if values is None else values, dtype=float)
    return np.array(np.broadcast_to(array, (n,)) if array.ndim == 0 else array).reshape(n, -1)


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A number per run, computed from the trajectories of the run.

    A metric is a frozen dataclass that derives from this class.  Its fields are its YAML keys, and their annotations
    define the accepted values.  `evaluate` computes the metric.  The attributes below have defaults.  A derived class
    replaces those that differ: by a class constant, or by a property if the value depends on a key.

    Parameters
    ----------
    name : name of the column in tables and in claims
    label : words for figures and tables (default: the name with blanks)

    Examples
    --------
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Peak(Metric):
    ...     def evaluate(self, record): return record.y.max((1, 2))
    >>> Peak(name="peak").evaluate(Record.of_run(y=[1.0, 3.0, 2.0])).tolist()
    [3.0]
    """

    name: str
    label: str | None = None

    bounds: ClassVar[tuple[float, float]] = (-math.inf, math.inf)
    """Smallest and largest possible value."""
    may_not_occur: ClassVar[bool] = False
    """Whether the measured event may not occur in a run; the value is then inf."""

    @attribute
    def better(self) -> Direction:
        """Which value is better."""
        return "lower"

    @attribute
    def of_innovation(self) -> bool:
        """Whether it needs the innovation of the estimator only, and neither a state nor a reference."""
        return False

    @attribute
    def needs_P(self) -> bool:
        """Whether it reads `Record.P`, which is not kept for other metrics."""
        return False

    @attribute
    def needs_M(self) -> bool:
        """Whether it reads `Record.M`, which is not kept for other metrics."""
        return False

    @attribute
    def reads(self) -> tuple[str, ...]:
        """Signals of `Record` that it reads; of x, x_hat and u the simulation may keep only those.

        A class of the user inherits none: it reads all unless it says itself what it reads.
        """
        return ("y", "x", "x_hat", "u")

    @attribute
    def needs_info(self) -> tuple[str, ...]:
        """Names of the entries of `Record.info` that it reads; others are not kept."""
        return ()

    def unit(self, layout: MetricLayout) -> str:
        """Return the unit of the value; empty where it has none."""
        return ""

    def info(self, layout: MetricLayout) -> MetricInfo:
        """Describe the column of the metric."""
        return MetricInfo(self.name, self.unit(layout), self.better, self.may_not_occur, self.label or "")

    def window(self, layout: MetricLayout) -> SampleWindow:
        """Return the samples that it reads: all of them."""
        return SampleWindow(0, layout.n_steps)

    def samples(self, record: Record) -> SampleWindow:
        """Return the samples of a record that it reads."""
        return self.window(record.layout)

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find every reason for which the metric cannot be computed, before any run."""
        yield from issues_of(self.window, layout)

    def remark(self, record: Record | None, layout: MetricLayout) -> str:
        """Return a sentence on the value in one run (None: not known) for check and tables; empty where it is usual."""
        return ""

    @abstractmethod
    def evaluate(self, record: Record) -> Float[Array, " runs"]:
        """Return one value per run: inf where the event does not occur, NaN where there is no value."""
        raise NotImplementedError("evaluate")


@dataclass(frozen=True, kw_only=True)
class WindowMetric(Metric):
    """A metric over the samples between `from` and `to`, both included; a bound need not be at a sample.

    Parameters
    ----------
    from_ : first sample, in seconds or samples as `time` of the experiment; k = 0 if not given
    to : last sample, included, `N` for the last of the experiment; that of the default window if not given
    """

    from_: Bound = None
    to: Bound = None

    input_only: ClassVar[bool] = False
    """Whether the window ends at k = N-1 at the latest, because no input is applied at k = N."""
    to_the_end: ClassVar[bool] = False
    """Whether the window ends at k = N unless `to` is given; otherwise it ends at k = N-1."""

    def last_sample(self, layout: MetricLayout) -> int:
        """Return the last sample that a window may contain."""
        return layout.n_steps - 1 if self.input_only else layout.n_steps

    def window(self, layout: MetricLayout) -> SampleWindow:
        """Return the samples between the bounds.

        Raises
        ------
        DesignError
            If a bound is outside the experiment or the window contains no sample.
        """
        limit = self.last_sample(layout)
        default_last = layout.n_steps if self.to_the_end else layout.n_steps - 1
        first, last = (
            limit if bound == "N" else default if bound is None else layout.around(bound)[inside]
            for bound, default, inside in ((self.from_, 0, 1), (self.to, default_last, 0))
        )
        if layout.cut:
            first = min(first, limit)
            last = max(first, min(last, limit))
        if not 0 <= first <= last <= limit:
            word = "seconds" if layout.time_unit == "s" else layout.time_unit
            lasts = f"{word}, and the experiment lasts {layout.n_steps * layout.tick:g} {layout.time_unit}"
            unit = f"from and to are in {'samples' if layout.tick == 1.0 else lasts}"
            raise DesignError(
                f"the window from {first} to {last} (samples) must lie in 0..{limit} and contain at least one sample; "
                f"{unit}"
            )
        return SampleWindow(first, last)


OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


@dataclass(frozen=True)
class Limit:
    """A comparison of the metric with a number, the metric on the left."""

    operator: str
    number: float


@dataclass(frozen=True)
class Requirement:
    """Limits that the metric of a run must keep.

    Parameters
    ----------
    text : as written in the configuration
    metric : name of the metric
    limits : all of them must hold
    absolute : whether the absolute value of the metric is meant
    """

    text: str
    metric: str
    limits: tuple[Limit, ...] = field(default=())
    absolute: bool = False

    def passed(self, values: Array) -> Array:
        """Return which runs meet the requirement."""
        shown = np.abs(values) if self.absolute else values
        found = ~np.isnan(values)
        for limit in self.limits:
            found &= OPERATORS[limit.operator](shown, limit.number)
        return np.asarray(found)


@dataclass(frozen=True)
class AdjustKeys:
    """Quantities that averages are adjusted for.

    Parameters
    ----------
    for_ : names of uncertain quantities; those with a known law that is not too wide if not given
    degree : largest degree of the polynomials, 1, 2 or 4
    """

    for_: list[Annotated[str, Len(1)]] | None = None
    degree: Literal[1, 2, 4] = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparisonKeys:
    """Keys of `statistics` that the configuration, the record and `Trials` have under one name with one value.

    A key that is added here, with its check as annotation, reaches the statistics by itself.
    Records that have these keys decide themselves whether they are compared by value (eq).

    Parameters
    ----------
    lost : factor, such as 10: a run is lost where it failed, or where its primary metric exceeds this factor times that
        of the baseline in the same run; tables have the share of lost runs beside the mean
    ranks : whether the methods are ranked over all points of the sweep by the primary metric, each rank as an interval
    two_way : two axes -> their entries, whose names a + joins in the name of a method: main effects and interactions
        of every metric; `methods.grid` sets it
    adjust : what average changes are adjusted for: `auto` for uncertain quantities of known law, `none`, their names,
        or `{for: [..], degree: 2}`
    """

    lost: Annotated[float, Gt(1)] | None = None
    ranks: bool = False
    two_way: dict[Axis, list[Annotated[str, Len(1)]]] | None = None
    adjust: Literal["auto", "none"] | list[Annotated[str, Len(1)]] | AdjustKeys = "auto"

    def comparison_keys(self) -> dict[str, Any]:
        """Return these keys and their values, for another record that has them."""
        return {each.name: getattr(self, each.name) for each in fields(ComparisonKeys)}


@dataclass(frozen=True)
class CalibrationKeys:
    """Whether reported covariances agree with the errors: shares of errors in the regions of P, and a word for each.

    Parameters
    ----------
    levels : levels of the regions, such as [50%, 90%]
    verdict : the level, one of them, whose share decides the word
    margin : factor on the standard deviation, less 1, within which a covariance counts as right
    from_ : first sample that counts, in seconds or samples as `time` of the experiment; k = 0 if not given
    """

    levels: Annotated[list[Annotated[float, Gt(0), Lt(1)]], Len(1)] = field(default_factory=lambda: [0.5, 0.9, 0.95])
    verdict: Annotated[float, Gt(0), Lt(1)] = 0.9
    margin: Annotated[float, Gt(0)] = 0.1
    from_: NonNegative | None = None

    @staticmethod
    def name(level: float, of: str = "joint") -> str:
        """Return the name of the metric of a share, such as coverage_99_5_x_1."""
        return re.sub(r"\W", "_", f"coverage_{100 * level:g}{'' if of == 'joint' else f'_{of}'}")
