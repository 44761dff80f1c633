"""Top-level keys of a configuration, and the sections that are not components (time, statistics, claims ...)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

from annotated_types import Ge, Gt, Le, Len, Lt
from pydantic import Field

from rmpc_bench.claims.claim import CLOSE, FINDINGS, MAX_QUOTED_WORDS
from rmpc_bench.claims.exact import printed_number
from rmpc_bench.expressions.quantity import number
from rmpc_bench.expressions.units import n_bytes, seconds
from rmpc_bench.types import Count, NonNegative, Positive

MAX_STEPS = 1_000_000
MAX_RUNS = 10_000_000
"""Larger numbers are out of the supported range: their arrays would not fit into memory."""

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
Text = Annotated[str, Len(1)]


@dataclass(frozen=True)
class Time:
    """Sampling and length: `step` and `duration` in seconds, or a number of `steps`."""

    step: Positive = 1.0
    duration: Positive | None = None
    steps: Count | None = None

    def __post_init__(self) -> None:
        """Refuse a length that is given twice, not at all, or not in whole steps."""
        if (self.duration is None) == (self.steps is None):
            raise ValueError("give either duration (seconds) or steps")
        if self.duration is not None and self.duration > MAX_STEPS * self.step:
            raise ValueError(f"there must be 1 to {MAX_STEPS:,} steps")
        if self.duration is not None and abs(self.duration / self.step - round(self.duration / self.step)) > 1e-9:
            raise ValueError(f"duration {self.duration:g} is not a whole number of steps of {self.step:g}")
        if not 1 <= self.n_steps <= MAX_STEPS:
            raise ValueError(f"there must be 1 to {MAX_STEPS:,} steps (got {self.n_steps:,})")

    @property
    def n_steps(self) -> int:
        """Number of control periods N."""
        return self.steps if self.steps is not None else round((self.duration or 0.0) / self.step)

    @property
    def tick(self) -> float:
        """Length of a step in the unit of the windows of metrics: seconds, or samples."""
        return self.step if self.duration is not None else 1.0


DEFAULT_RELEVANT = 0.01
Relevant: Any = Annotated[float, Ge(0), Lt(1)] | dict[str, NonNegative]


@dataclass(frozen=True)
class Statistics:
    """Comparison of the methods; `primary` and `baseline` default to the first metric and the first method.

    `relevant` is the smallest difference that matters: a relative change for all metrics, or a number per metric.  A
    signed metric, for which 0 is best or which has negative values, takes a number in its unit; without one, none of
    its differences is too small to matter.  `average` says which averages of the paired runs are computed.
    """

    primary: Text | None = None
    baseline: Text | None = None
    confidence: Annotated[float, Gt(0), Lt(1)] = 0.95
    relevant: Relevant = DEFAULT_RELEVANT
    average: Literal["geometric", "mean", "both"] = "both"

    @property
    def relevant_change(self) -> float:
        """The smallest relative change that matters in a metric without a margin of its own."""
        return DEFAULT_RELEVANT if isinstance(self.relevant, dict) else self.relevant

    @property
    def margins(self) -> dict[str, float]:
        """Metric -> margin of its own."""
        return self.relevant if isinstance(self.relevant, dict) else {}


@dataclass(frozen=True)
class Timeout:
    """Longest time of a run and of one of its steps, as numbers of seconds or texts such as ``200 ms``.

    A run that takes longer has the status `timeout`.  The first step may take ten times as long, since it may compile.
    """

    step: Positive | Text | None = None
    run: Positive | Text | None = None

    def __post_init__(self) -> None:
        """Convert to seconds."""
        for name in ("step", "run"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else seconds(value))


@dataclass(frozen=True)
class Execution:
    """Settings of the computation; none of them changes the numbers of a run that ends well.

    With the engine `joblib` the runs are computed in worker processes; `serial` computes them in this process.  Unless
    it is given, one worker is this process where all components are built in.  `memory` is the largest memory of a
    worker process, such as ``2 GB``; a run that needs more has the status `crashed`.
    """

    workers: Count = 2
    block: Annotated[int, Ge(1), Le(MAX_RUNS)] = 50
    max_failures: Annotated[int, Ge(0)] = 0
    engine: Literal["joblib", "serial"] | None = None
    timeout: Timeout | None = None
    memory: Text | None = None

    def __post_init__(self) -> None:
        """Refuse a size without a known unit."""
        _ = self.memory_limit

    @property
    def memory_limit(self) -> int | None:
        """Largest memory of a worker process [bytes]; None without a limit."""
        return None if self.memory is None else n_bytes(self.memory)


Evaluation = Literal["runs", "ensemble", "moments"]
Evaluate: Any = Evaluation | Annotated[list[Evaluation], Len(1)]
"""What to compute: single runs, exact moments over all runs, or both.  With `moments` or `ensemble` besides `runs`, the
mean and the covariance over the runs are computed too."""


@dataclass(frozen=True)
class RecordKeys:
    """Trajectories to keep: of no run, of the first N runs, or of all.

    A signal is y, u, x, x_hat or one that a method reports, such as Q_yw.  Bursts of the noise are kept with them.
    """

    runs: Literal["none", "all"] | Count = "none"
    signals: Annotated[list[Text], Len(1)] = field(default_factory=lambda: ["y", "u"])


@dataclass(frozen=True)
class Smoke:
    """Size of a run with --smoke."""

    runs: Count = 4
    steps: Count = 20


@dataclass(frozen=True)
class StatedKeys:
    """A number of the paper, which the expression `of` computes.

    With a `tolerance` (absolute) it is a size of effect.  Without one it is a number without Monte Carlo error: `value`
    is then a text with the digits that the paper prints, such as '58.20', and the finding is ``equal``, ``close``
    (relative difference up to `close`) or ``different``.
    """

    of: Text
    value: float | Text
    tolerance: NonNegative | None = None
    text: str = ""
    close: Annotated[float, Gt(0), Lt(1)] = CLOSE

    def __post_init__(self) -> None:
        """Refuse a number whose digits are not known, and words in place of one."""
        if self.tolerance is not None:
            object.__setattr__(self, "value", number(self.value))
        elif not isinstance(self.value, str):
            raise ValueError(f"without a tolerance value is the printed text, such as '{self.value:g}' in quotes")
        else:
            printed_number(self.value)


@dataclass(frozen=True)
class ClaimKeys:
    """One statement of a paper."""

    says: Text
    source: str = ""
    id: Name | None = None
    quote: Text | None = None
    check: Text | list[Text] | None = None
    holds_for: Literal["all", "most", "any"] = "all"
    at: Any = None
    grounds: dict[str, Text] = field(default_factory=dict)
    finding: Literal[FINDINGS] | None = None  # type: ignore[valid-type]
    stated: Text | StatedKeys | list[StatedKeys] | None = None
    assumptions: list[Text] = field(default_factory=list)
    elsewhere: dict[Name, Literal[FINDINGS]] | None = None  # type: ignore[valid-type]

    def __post_init__(self) -> None:
        """Refuse a quotation that is longer than what may be quoted."""
        n_words = len((self.quote or "").split())
        if n_words > MAX_QUOTED_WORDS:
            raise ValueError(f"quote must have at most {MAX_QUOTED_WORDS} words (got {n_words})")


class Section(NamedTuple):
    """Annotation, default and meaning of a top-level key; ``...`` marks a required one."""

    annotation: Any
    default: Any
    meaning: str


SECTIONS: dict[str, Section] = {
    "version": Section(Literal[1], ..., "Version of this format; always 1."),
    "name": Section(
        Name, ..., "Name of the experiment; letters, digits, _, - and a point. It names the results directory."
    ),
    "paper": Section(Name | None, None, "Key of the paper that is reproduced, such as zenere2018."),
    "title": Section(str, "", "One line that says what is compared."),
    "seed": Section(Annotated[int, Ge(0), Le(2**63 - 1)], 0, "Seed of all random streams."),
    "runs": Section(
        Annotated[int, Ge(1), Le(MAX_RUNS)], ..., "Number of runs; it may be raised later, finished runs are kept."
    ),
    "time": Section(
        Time, ..., "Sampling time `step` [s] with `duration` [s] or a number of `steps`; samples are k = 0..N."
    ),
    "uncertainty": Section(
        dict[str, Any], {}, "Random quantities, one value per run, the same for every method: +-10% or {dist: .., ..}."
    ),
    "plant": Section(dict[str, Any], ..., "The true system."),
    "model": Section(dict[str, Any], ..., "Design model of estimators and controllers; the default of all methods."),
    "noise": Section(Any, "none", "Noise of the true system: none, same, or laws for `process` and `measurement`."),
    "initial": Section(
        dict[str, Any], {}, "True initial state `x`, and initial estimate `x_hat` with covariance `P` and set `M`."
    ),
    "reference": Section(dict[str, Any], {"kind": "constant", "value": 0.0}, "What the output follows."),
    "input": Section(dict[str, Any], {}, "Input of the plant in open loop, in place of a controller."),
    "estimator": Section(dict[str, Any], {}, "Default estimator of all methods."),
    "controller": Section(dict[str, Any], {}, "Default controller of all methods."),
    "methods": Section(dict[str, Any], ..., "The pairs to compare: name -> model, estimator, controller and label."),
    "sweep": Section(
        dict[str, Any], {}, "Values of some paths: {grid: {PATH: [..]}}, {zip: {PATH: [..]}}, {exclude: [..]}."
    ),
    "metrics": Section(list[Any], ["mse"], "Numbers to keep of every run."),
    "statistics": Section(Statistics, Statistics(), "How methods are compared."),
    "evaluate": Section(
        Evaluate, ["runs"], "What to compute: single runs, exact moments over all runs, or the ensemble."
    ),
    "record": Section(RecordKeys, RecordKeys(), "Trajectories to keep."),
    "figures": Section(list[Any], ["boxplot"], "Figures to draw."),
    "claims": Section(list[Any], [], "Statements of a paper to check."),
    "plugins": Section(list[Text], [], "Python files whose code registers components; their names are then kinds."),
    "execution": Section(Execution, Execution(), "Settings of the computation; none of them changes a result."),
    "smoke": Section(Smoke, Smoke(), "Size of a run with --smoke."),
}
