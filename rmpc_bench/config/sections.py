"""Top-level keys of a configuration, and the small sections that are not components (time, record, execution ...)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

from annotated_types import Ge, Le, Len
from pydantic import AfterValidator

from rmpc_bench.config.claim_keys import Name
from rmpc_bench.config.report import ReportKeys
from rmpc_bench.config.statistics import Statistics
from rmpc_bench.config.stop import StopKeys
from rmpc_bench.config.tune import TuneKeys
from rmpc_bench.expressions.units import n_bytes, seconds
from rmpc_bench.types import Count, Positive
from rmpc_bench.types.basics import MAX_STEPS, Text
from rmpc_bench.types.metric import CalibrationKeys

MAX_RUNS = 10_000_000  # a larger number is out of the supported range: its arrays would not fit into memory


def _unit(text: str) -> str:
    if not re.fullmatch(r"[^\W\d_]{1,12}", text):
        raise ValueError(f"must have 1 to 12 letters (got {text!r})")
    return text


@dataclass(frozen=True)
class Time:
    """Sampling and length: `step` and `duration`, or a number of `steps`.

    Parameters
    ----------
    step : sampling time [s]; windows of metrics are times with `duration`, numbers of samples with `steps`
    duration : length of a run [s], a whole number of steps; give either `duration` or `steps`
    steps : number N of control periods; samples are k = 0..N
    unit : unit of all times and rates of the file and of rhs, which texts of this program call s; it names the unit in
        tables, figures and messages, and no number is converted
    """

    step: Positive = 1.0
    duration: Positive | None = None
    steps: Count | None = None
    unit: Annotated[str, AfterValidator(_unit)] = "s"

    def __post_init__(self) -> None:
        """Refuse a length that is given twice, not at all, or not in whole steps."""
        if (self.duration is None) == (self.steps is None):
            raise ValueError("give either duration or steps")
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
        """Length of a step in the unit of the windows of metrics: that of the time, or samples."""
        return self.step if self.duration is not None else 1.0


@dataclass(frozen=True)
class Timeout:
    """Longest time of a run and of one of its steps, as numbers of seconds or texts such as ``200 ms``.

    A run that takes longer has the status `timeout`.  The first step may take ten times as long, since it may compile.

    Parameters
    ----------
    step : longest time of one step of a run [s]; no limit if not given
    run : longest time of a run [s]; no limit if not given
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
    """Settings of the computation; none of them changes the numbers of a finished run.

    Parameters
    ----------
    workers : largest number of worker processes
    block : runs that are computed together, or `auto` for about half a second of work; the results do not depend on it
    max_failures : number of failed runs that is accepted; with more of them the exit code is 3
    engine : `joblib` starts all workers, `serial` computes in this process, `dask` on a dask cluster; if not given,
        built-in components are computed in this process first, and a worker starts where that saves time
    timeout : longest times; a run that takes longer has the status `timeout`
    memory : largest memory of a worker process, such as ``2 GB``; a run that needs more has the status `crashed`
    """

    workers: Count = 2
    block: Literal["auto"] | Annotated[int, Ge(1), Le(MAX_RUNS)] = "auto"
    max_failures: Annotated[int, Ge(0)] = 0
    engine: Literal["joblib", "serial", "dask"] | None = None
    timeout: Timeout | None = None
    memory: Text | None = None

    def __post_init__(self) -> None:
        """Refuse a size without a known unit."""
        _ = self.memory_limit

    @property
    def fixed_block(self) -> int | None:
        """Number of runs that are computed together; None to choose it by time."""
        return None if self.block == "auto" else self.block

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
    """Trajectories to keep, in traces.npz; bursts of the noise are kept with them.

    Parameters
    ----------
    runs : `none`, `all`, or a number N for the first N runs
    signals : y, u (applied input), u_command (before the bounds of the plant), x, x_hat, P or signals that a method
        reports, such as Q_yw
    """

    runs: Literal["none", "all"] | Count = "none"
    signals: Annotated[list[Text], Len(1)] = field(default_factory=lambda: ["y", "u"])


@dataclass(frozen=True)
class Smoke:
    """Size of a run with --smoke.

    Parameters
    ----------
    runs : number of runs
    steps : number of control periods
    """

    runs: Count = 4
    steps: Count = 20


class Section(NamedTuple):
    """Annotation, default and meaning of a top-level key; ``...`` marks a required one."""

    annotation: Any
    default: Any
    meaning: str


def _key(annotation: Any, default: Any, meaning: str, *, absent: Any = None) -> Any:
    return field(default=absent, metadata={"section": Section(annotation, default, meaning)})


@dataclass(frozen=True)
class Keys:
    """Values of the top-level keys; None where one is wrong."""

    version: int | None = _key(Literal[1], ..., "Version of this format; always 1.")
    extends: str | None = _key(
        Text | None,
        None,
        "Configuration from which this one inherits: mappings are merged key by key, lists and scalars are "
        "replaced; `key: !delete` removes an inherited key (editors need "
        "the custom tag `!delete scalar`). The name and the claims are not inherited.",
    )
    name: str | None = _key(
        Name, ..., "Name of the experiment; letters, digits, _, - and a point. It names the results directory."
    )
    paper: str | None = _key(Name | None, None, "Key of the paper that is reproduced, such as zenere2018.")
    title: str | None = _key(str, "", "One line that says what is compared.")
    summary: str | None = _key(
        str, "", "What was found, in one to three sentences; shown in overviews of many experiments."
    )
    seed: int | None = _key(Annotated[int, Ge(0), Le(2**63 - 1)], 0, "Seed of all random streams.")
    runs: int | None = _key(
        Annotated[int, Ge(1), Le(MAX_RUNS)], ..., "Number of runs; it may be raised later, finished runs are kept."
    )
    stop: StopKeys | None = _key(
        StopKeys | None,
        None,
        "Rule that ends the experiment before its largest number of runs; `runs` is then the number at the first look.",
    )
    time: Time | None = _key(
        Time, ..., "Sampling time `step` [s] with `duration` [s] or a number of `steps`; samples are k = 0..N."
    )
    uncertainty: dict[str, Any] | None = _key(
        dict[str, Any],
        {},
        "Random quantities, one value per run, the same for every method: +-10% or {dist: .., ..}. The key `scale` is "
        "a factor on the spread of all of them.",
    )
    plant: dict[str, Any] | None = _key(dict[str, Any], ..., "The true system.")
    model: dict[str, Any] | None = _key(
        dict[str, Any], ..., "Design model of estimators and controllers; the default of all methods."
    )
    noise: Any = _key(Any, "none", "Noise of the true system: none, same, or laws for `process` and `measurement`.")
    initial: dict[str, Any] | None = _key(
        dict[str, Any], {}, "True initial state `x`, and initial estimate `x_hat` with covariance `P` and set `M`."
    )
    reference: dict[str, Any] | None = _key(
        dict[str, Any], {"kind": "constant", "value": 0.0}, "What the output follows."
    )
    input: dict[str, Any] | None = _key(
        dict[str, Any], {}, "Input of the plant in open loop, in place of a controller."
    )
    estimator: dict[str, Any] | None = _key(dict[str, Any], {}, "Default estimator of all methods.")
    controller: dict[str, Any] | None = _key(dict[str, Any], {}, "Default controller of all methods.")
    methods: dict[str, Any] | None = _key(
        dict[str, Any], ..., "The pairs to compare: name -> model, estimator, controller and label."
    )
    tune: TuneKeys | None = _key(
        TuneKeys | None,
        None,
        "How the parameters under `tune` of the methods are chosen: on other runs than those of the experiment, with "
        "the same budget for each method. With `tune: null` nothing is tuned.",
    )
    sweep: dict[str, Any] | None = _key(
        dict[str, Any],
        {},
        "Values of some keys, named by their paths: {grid: {PATH: [..]}}, {zip: {PATH: [..]}}, {exclude: [..]}.",
    )
    metrics: list[Any] | None = _key(list[Any], ["mse"], "Numbers to keep of every run.")
    calibration: CalibrationKeys | None = _key(
        bool | CalibrationKeys,
        False,
        "Whether the covariances that estimators report agree with their errors, in shares and words; `true` for the "
        "defaults.",
    )
    statistics: Statistics | None = _key(Statistics, Statistics(), "How methods are compared.")
    evaluate: Sequence[str] = _key(
        Evaluate, ["runs"], "What to compute: single runs, exact moments over all runs, or the ensemble.", absent=()
    )
    record: RecordKeys | None = _key(RecordKeys, RecordKeys(), "Trajectories to keep.")
    report: ReportKeys | None = _key(
        ReportKeys, ReportKeys(), "What tables and figures show, and how figures are written."
    )
    figures: list[Any] | None = _key(list[Any], ["boxplot"], "Figures to draw; of a sweep `sweep` if not given.")
    claims: list[Any] | None = _key(list[Any], [], "Statements of a paper to check.")
    plugins: list[str] | None = _key(
        list[Text], [], "Python files whose code registers components; their names are then kinds."
    )
    requires: list[str] | None = _key(
        list[Text],
        [],
        "Optional libraries that the components need, by the extras of pip that install them. This list and an "
        "inherited one are joined.",
    )
    execution: Execution | None = _key(
        Execution, Execution(), "Settings of the computation; none of them changes the numbers of a finished run."
    )
    smoke: Smoke | None = _key(Smoke, Smoke(), "Size of a run with --smoke.")

    @cached_property
    def with_controller(self) -> list[str]:
        """Names of the methods that have a controller of their own."""
        own = self.methods or {}
        return [name for name, method in own.items() if isinstance(method, Mapping) and "controller" in method]


SECTIONS: dict[str, Section] = {each.name: each.metadata["section"] for each in fields(Keys)}
