"""What reports need of an experiment, as plain data in its trial store.

`run` writes it (layout.py) as JSON, with the arrays beside it.  Reports, comparisons and `load_results` read nothing
else of the experiment: they build no design and load no code, and they need no configuration file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, get_args

from pydantic import TypeAdapter, ValidationError

import rmpc_bench
from rmpc_bench.analysis.levels import PlannedLook, planned_level, schedule
from rmpc_bench.claims.claim import Claim, usual_parameters
from rmpc_bench.config.identity import code_version, digest, key_of_trials
from rmpc_bench.config.report import ReportKeys
from rmpc_bench.received.names import wrong_experiment, wrong_label, wrong_method, wrong_metric
from rmpc_bench.received.plain_files import wrong_option
from rmpc_bench.received.store import FILE, MOST_RUNS, MissingError, damaged
from rmpc_bench.results.imported import ELSEWHERE, Imported
from rmpc_bench.simulation.scenario import Recording
from rmpc_bench.store.store import Store, StoredMethod, each_once
from rmpc_bench.types import MetricInfo
from rmpc_bench.types.metric import CalibrationKeys, ComparisonKeys, Direction, Requirement
from rmpc_bench.types.tuning import StoredTuning

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.config.stop import StopKeys


KEY = "layout"
WAY_OUT = "`rmpc-bench run` with its configuration adds it and computes nothing again"


@dataclass(frozen=True)
class PointMethod:
    """A method at one point of the sweep."""

    definition: str  # hash of what the configuration determines of its trials
    code: Mapping[str, Any]  # what identifies the code that computed them
    is_oracle: bool = False  # whether its estimator is an oracle
    signals: tuple[str, ...] = ()  # signals that are recorded of it
    # recorded signal that the method reports itself -> shape of an entry
    shapes: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    series_key: str = ""  # what its series depend on; methods with equal keys have the same series
    # series of its design -> name of the array, axis 0 = k; empty where nothing of the method is computed
    series: Mapping[str, str] = field(default_factory=dict)
    # names of the arrays of the exact mean and covariance of (x, x_hat); None where there are none
    moments: tuple[str, str] | None = None
    holds: bool = False  # whether a component of the method holds a failed step
    optimises: bool = False  # whether its controller goes on after a step whose optimisation failed
    # component of a signal -> its limits in the controller, such as ``u.0``; ``u`` for all components
    limits: Mapping[str, tuple[float | None, float | None]] = field(default_factory=dict)
    P_is: Literal["covariance", "bound"] = "covariance"  # whether its P is meant as an upper bound

    @property
    def stored(self) -> StoredMethod:
        """What its trials are stored under, in tables of the arithmetic (NUMERICS) of this program only."""
        code = self.code if self.code == ELSEWHERE else {**self.code, **code_version()}
        return StoredMethod(key_of_trials(self.definition, code), self.definition, code)

    @property
    def key(self) -> str:
        """Hash under which its trials are stored."""
        return self.stored.key


@dataclass(frozen=True)
class StoredPoint:
    """An experiment at one point of its sweep; without a sweep there is one point."""

    coordinates: Mapping[str, str]  # swept path -> text of its value
    title: str  # the point in words
    seed: int  # seed of the random numbers
    Ts: float  # sampling time [s]; 0 where time is counted in samples
    nx: int  # number of states of the plant
    n_steps: int  # number of control periods of a run
    # signal -> unit, such as y -> rad; of a component with a unit of its own y.2 -> rad, of the time t -> min unless
    # it is s
    units: Mapping[str, str]
    metrics: tuple[MetricInfo, ...]  # columns of the metrics
    metric_keys: Mapping[str, str]  # metric -> hash under which its values are stored
    methods: Mapping[str, PointMethod]  # method -> its record, in the order of the configuration
    n_recorded: int  # number of runs whose signals are recorded, from the first one on
    has_ensemble: bool  # whether mean and covariance over the runs are stored
    reference: str | None  # name of the array of r(k), (samples, ny); None where nothing is recorded
    uncertainty_key: str  # hash under which the values of the uncertain quantities are stored
    uncertainty: tuple[str, ...]  # names of these quantities, in the order of the configuration
    names: Mapping[str, str] = field(default_factory=dict)  # component of a signal, such as y.0 -> its name
    # what is random in a run besides the uncertain quantities, in words; None where it is not known, as an earlier
    # version wrote the record
    random_besides: tuple[str, ...] | None = None
    limitations: tuple[str, ...] = ()  # what a comparison with this plant cannot show
    angles: Mapping[str, float] = field(default_factory=dict)  # component that is an angle, such as x.0 -> its period
    # uncertain quantity with a law of its own -> keys of the law, its scale applied
    laws: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def recording(self, method: str) -> Recording:
        """Return what is kept of the runs of a method."""
        return Recording(self.methods[method].signals, self.n_recorded, self.has_ensemble)


@dataclass(frozen=True)
class StoredExperiment(ComparisonKeys):
    """An experiment as its reports see it: names, keys of the stored numbers, settings, figures and claims."""

    name: str  # name, paper, title: as in the configuration
    paper: str | None
    title: str
    hash: str  # the experiment hash
    n_runs: int  # number of runs
    has_runs: bool  # whether single runs are evaluated; otherwise only exact moments are
    axes: tuple[tuple[str, ...], ...]  # swept paths; the paths of a zip, which change together, are one axis
    labels: Mapping[str, str]  # method -> text for tables and figures
    primary: str  # name of the metric that the screen and the figures show
    baseline: str  # name of the method that all others are compared with
    confidence: float  # confidence, relevant, margins, average, headline: settings of the comparison, see `Trials`
    relevant: float
    margins: Mapping[str, float]
    average: str
    headline: str
    max_failures: int  # number of failed trials that is accepted; with more of them the exit code is 3
    alike: bool  # whether the methods are the same at all points of the sweep
    overrides: tuple[str, ...]  # options that changed the configuration, such as ``--smoke``
    figures: tuple[Mapping[str, Any], ...]  # keys of the figures to draw; of a figure from a user's file only ``file``
    claims: tuple[Claim, ...]  # statements to check
    points: tuple[StoredPoint, ...]  # points of the sweep
    # method -> check of `rmpc_bench.conformance` that its own components are meant to fail -> reason
    expected_failures: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    report: ReportKeys = field(default_factory=ReportKeys)  # what tables and figures show, and how figures are written
    requirements: tuple[Requirement, ...] = ()  # what the metric of a run must keep
    # method that the command line has added -> its text; it stays in the directory when the option is left out
    added: Mapping[str, str] = field(default_factory=dict)
    stop: StoredStop | None = None  # the stopping rule with its looks; None where the number of runs is given
    # method -> where its parameters come from: ``default``, ``as published`` or ``tuned (..)``; empty where a version
    # without tuning has written the record
    parameters: Mapping[str, str] = field(default_factory=dict)
    tuning: StoredTuning | None = None  # what identifies the searches of tuned methods; None where nothing is tuned
    calibration: CalibrationKeys | None = None  # how reported covariances are compared with the errors
    imported: Imported | None = None  # where the runs come from, if they were made elsewhere

    @property
    def origins(self) -> dict[str, str]:
        """Where the parameters of every method come from; an earlier version has tuned none."""
        if self.imported is not None:
            return dict(self.parameters)
        return {name: self.parameters.get(name) or usual_parameters(self.paper) for name in self.methods}

    @property
    def shown_metrics(self) -> list[str] | None:
        """Metrics of page and tables: those of the report, else all but the shares that have a table of their own."""
        if self.report.metrics or self.calibration is None:
            return self.report.metrics
        starts = tuple(self.calibration.name(level) for level in self.calibration.levels)
        return [info.name for info in self.points[0].metrics if not info.name.startswith(starts)]

    @property
    def level(self) -> float:
        """Level of each interval; that of the experiment where a rule does not share it out among its looks."""
        return self.confidence if self.stop is None else self.stop.level

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods in the order of the configuration."""
        return tuple(self.points[0].methods)

    @property
    def paths(self) -> tuple[str, ...]:
        """The swept paths."""
        return tuple(path for axis in self.axes for path in axis)

    @property
    def is_smoke(self) -> bool:
        """Whether it is a smoke run, whose comparisons have no verdict."""
        return "--smoke" in self.overrides

    @property
    def n_wanted(self) -> int:
        """Number of runs that the store of a finished experiment has of every method."""
        return self.n_runs if self.has_runs else 0

    @property
    def stored_methods(self) -> tuple[StoredMethod, ...]:
        """What identifies the trials of all methods at all points of the sweep, each once."""
        points = self.points
        found = (each.stored._replace(name=name) for point in points for name, each in point.methods.items())
        return tuple(each_once(found)) if self.has_runs else ()


def write_experiment(store: Store, experiment: StoredExperiment, arrays: Mapping[str, Any]) -> None:
    """Store what reports need of an experiment in place of what is there, with the arrays that it names."""
    store.set_layout(KEY, json.dumps(asdict(experiment)), arrays)


def added_methods(store: Store) -> dict[str, str]:
    """Return the methods that the command line has added to an experiment -> their texts."""
    found = store.data(KEY).get("added", {})
    return {str(name): str(method) for name, method in found.items()} if isinstance(found, dict) else {}


def read_experiment(store: Store) -> StoredExperiment:
    """Read what reports need of the experiment that a store belongs to.

    `MissingError` where it is missing, because an earlier version wrote the store, or because the writer never came to
    it; `DamagedError` where a name or a number is none that a configuration may have.
    """
    data = store.data(KEY)
    if not data:
        raise MissingError(f"{store.directory}: an earlier version wrote it without what a report needs; {WAY_OUT}")
    try:
        found = _adapter().validate_python(data)
    except (ValidationError, ValueError, RecursionError) as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else {"loc": (), "msg": str(error)}
        where = f"layout.{'.'.join(map(str, first['loc']))}: {first['msg']}"[:200]
        text = f"{store.directory / FILE}: another version has written what a report needs ({where})"
        raise MissingError(f"{text}; {WAY_OUT}") from None
    if wrong := next(_wrong(found), ""):
        raise damaged(store.directory, f"layout.{wrong}")
    return _with_looks(found, store)


@cache
def _adapter() -> TypeAdapter[StoredExperiment]:
    # Made where the first record is read, and kept: it takes longer than reading a record.
    return TypeAdapter(StoredExperiment)


def _wrong(found: StoredExperiment) -> Iterator[str]:
    """Say what no configuration could have: names that are not fit for files, unknown names, numbers out of range."""
    for key, text in (("name", found.name), ("paper", found.paper)):
        if text is not None and wrong_experiment(text):
            yield f"{key} {wrong_experiment(text)} (got {text[:60]!r})"
    if not found.points or not found.points[0].methods or not found.points[0].metrics:
        yield "points: there must be a point with a method and a metric"
        return
    for number, point in enumerate(found.points):
        yield from (f"points.{number}.{text}" for text in _wrong_point(found, point))
    # A page recommends the command of the run.
    yield from (f"overrides: {wrong_option(text)}" for text in found.overrides if wrong_option(text))
    for name, label in found.labels.items():
        if wrong_label(label):
            yield f"labels: that of {name[:60]!r} {wrong_label(label)}"
    methods, metrics = found.methods, [metric.name for metric in found.points[0].metrics]
    for key, names, known in (
        ("baseline", [found.baseline], methods),
        ("primary", [found.primary], metrics),
        ("report.order", found.report.order or [], methods),
        ("report.metrics", found.report.metrics or [], metrics),
        ("requirements", [each.metric for each in found.requirements], metrics),
        ("average", [found.average], ("geometric", "mean", "both")),
        ("headline", [found.headline], ("geometric", "mean")),
    ):
        for name in names:
            if name not in known:
                yield f"{key} names {name[:60]!r}, which is none of {', '.join(known)[:200]}"
    for number, keys in enumerate(found.figures):
        if not all(isinstance(keys.get(key, ""), str) for key in ("kind", "file")) or not {"kind", "file"} & {*keys}:
            yield f"figures.{number} has no kind"
    numbers = {"n_runs": found.n_runs - 1, "max_failures": found.max_failures}
    if not (0 < found.confidence < 1 and 0 <= found.relevant < math.inf):
        yield f"confidence or relevant is out of range (got {found.confidence}, {found.relevant})"
    if found.stop is not None:
        numbers |= {"stop.max_runs": found.stop.max_runs, "stop.looks.wanted": found.stop.looks.wanted}
    yield from _out_of_range(numbers)
    if found.imported is not None and len(found.imported.names) not in (0, found.n_runs):
        yield f"imported.names: there are {len(found.imported.names)} names of {found.n_runs} runs"
    if (asked := found.calibration) is not None:
        wanted = {*map(asked.name, asked.levels)}
        if asked.verdict not in asked.levels or any(wanted - {info.name for info in p.metrics} for p in found.points):
            yield "calibration: has levels without a metric, or a verdict at none of them"


def _wrong_point(found: StoredExperiment, point: StoredPoint) -> Iterator[str]:
    yield from _out_of_range({"nx": point.nx, "n_steps": point.n_steps - 1, "n_recorded": point.n_recorded})
    if not 0 <= point.Ts < math.inf or not 0 <= point.seed < 2**63:
        yield f"Ts or seed is out of range (got {point.Ts}, {str(point.seed)[:60]})"
    for metric in point.metrics:
        if wrong_metric(metric.name):
            yield f"metrics: a metric has no valid name: {wrong_metric(metric.name)} (got {metric.name[:60]!r})"
        if metric.direction not in get_args(Direction) or metric.name not in point.metric_keys:
            yield f"metrics.{metric.name}: has no direction, or no key"
    for name in point.methods:
        if wrong_method(name):
            yield f"methods: {wrong_method(name)} (got {name[:60]!r})"
    if not {*point.coordinates} >= {*found.paths} or (found.alike and [*point.methods] != [*found.methods]):
        yield "coordinates or methods differ from those of the experiment"


def _out_of_range(numbers: Mapping[str, int]) -> Iterator[str]:
    for key, number in numbers.items():
        if not 0 <= number <= MOST_RUNS:
            yield f"{key} is out of range (up to {MOST_RUNS})"


def _with_looks(experiment: StoredExperiment, store: Store) -> StoredExperiment:
    """Add the looks of a stopping rule, which say how many runs the experiment has."""
    if experiment.stop is None:
        return experiment
    found = read_looks(store)
    looks = found if found is not None and found.key == experiment.stop.looks.key else experiment.stop.looks
    points = tuple(replace(point, n_recorded=min(point.n_recorded, looks.wanted)) for point in experiment.points)
    return replace(experiment, stop=replace(experiment.stop, looks=looks), n_runs=looks.wanted, points=points)


LOOKS = "stop"
"""Name under which the looks are stored."""


@dataclass(frozen=True)
class Looks:
    """The looks of a rule that have taken place; written after each of them."""

    key: str  # hash of what the decisions depend on; looks of another key do not count
    runs: tuple[int, ...] = ()  # number of runs at each look
    wanted: int = 0  # number of runs that the experiment has or will have: that of the next look, or of the last one
    is_met: bool = False  # whether the rule was met at the last look
    open: tuple[str, ...] = ()  # what was not decided or resolved at the last look, in words


@dataclass(frozen=True)
class StoredStop:
    """A stopping rule and what it has decided."""

    rule: str  # the rule as the configuration writes it, such as ``decide: claims``
    max_runs: int  # largest number of runs
    n_looks: int  # number of planned looks at claims; 0 for a rule about widths, whose intervals do not depend on it
    level: float  # level of each interval
    confidence: float  # level that all looks have together
    looks: Looks  # the looks that have taken place

    @property
    def is_over(self) -> bool:
        """Whether no look follows."""
        return self.looks.is_met or bool(self.looks.runs) and self.looks.runs[-1] >= self.max_runs

    @property
    def is_unmet(self) -> bool:
        """Whether the largest number of runs is there and the rule is not met."""
        return self.is_over and not self.looks.is_met

    @property
    def planned(self) -> PlannedLook:
        """The look that the results rest on."""
        return PlannedLook(max(len(self.looks.runs), 1), self.n_looks, self.confidence)

    @property
    def text(self) -> str:
        """What the rule has decided, in words."""
        looks = self.looks
        of = f" of {self.n_looks}" if self.n_looks else ""
        look = f"look {len(looks.runs)}{of}, {looks.runs[-1]} runs" if looks.runs else "no look yet"
        if not self.is_over:
            return f"{self.rule}: not ended ({look}; the next one is at {looks.wanted} runs)"
        if looks.is_met:
            return f"{self.rule}: met at {look}"
        return f"{self.rule}: not met at {look}, the largest number; {'; '.join(looks.open)}"


def note_looks(store: Store, looks: Looks) -> None:
    """Store the looks in place of earlier ones."""
    store.set_meta(LOOKS, json.dumps(asdict(looks)))


def read_looks(store: Store) -> Looks | None:
    """Return the looks that a store has, of whatever rule; None where there is none."""
    data = store.data(LOOKS)
    try:
        return Looks(data["key"], tuple(data["runs"]), data["wanted"], data["is_met"], tuple(data["open"]))
    except KeyError:
        # Another version has written it; the looks are taken again.
        return None


def planned_looks(stop: StopKeys) -> tuple[int, ...]:
    """Return the numbers of runs of the looks at claims; empty for a rule about widths, which has any number."""
    return schedule(stop.first_look, stop.max_runs) if stop.decide else ()


def stop_of(config: ExperimentConfig, store: Store | None) -> StoredStop | None:
    """Return the rule of an experiment with the looks that its store has; None where there is none."""
    stop, confidence = config.stop, config.statistics.confidence
    if stop is None:
        return None
    key, planned = _key(config, stop), planned_looks(stop)
    found = None if store is None else read_looks(store)
    return StoredStop(
        rule=stop.text,
        max_runs=stop.max_runs,
        n_looks=len(planned),
        level=planned_level(confidence, len(planned)) if planned else confidence,
        confidence=confidence,
        looks=found if found is not None and found.key == key else Looks(key, wanted=stop.first_look),
    )


def _key(config: ExperimentConfig, stop: StopKeys) -> str:
    """Hash of everything that decisions depend on: the rule, the trials, and what is computed from them."""
    statistics = config.statistics
    trials = [[point.coordinates, point.method_keys, point.metric_keys] for point in config.points]
    claims = [[claim.check, claim.at, claim.pooled, claim.holds_for, claim.stated] for claim in config.claims]
    comparison = [config.primary, config.baseline, statistics.confidence, config.headline, statistics.average]
    comparison += [statistics.adjust]
    margins = [statistics.relevant_change, statistics.margins]
    of_rule = claims if stop.decide else comparison + margins
    data = [asdict(stop), trials, of_rule, statistics.confidence, rmpc_bench.__version__]
    return digest(json.loads(json.dumps(data, default=_plain)))


def _plain(value: Any) -> Any:
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else dict(value)
