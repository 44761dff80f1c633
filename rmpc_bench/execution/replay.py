"""One run, or its first samples, simulated again with all signals, and compared with what is stored of it."""

from __future__ import annotations

import pdb
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.analysis.columns import data_frame
from rmpc_bench.analysis.traces import last_new_sample
from rmpc_bench.components.user_code import user_entry
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.identity import SweepPoint, chosen_point
from rmpc_bench.config.load import load_config
from rmpc_bench.engines.tasks import failure_of, named_values
from rmpc_bench.received.store import FILE, MissingError
from rmpc_bench.results.imported import refuse_imported
from rmpc_bench.simulation.checked_calls import metric_values
from rmpc_bench.simulation.closed_loop import covariances, simulate
from rmpc_bench.simulation.recording import COVARIANCE, SIGNALS
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.simulation.state_range import OK
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.store.store import Store
from rmpc_bench.types import (
    STATUS_WORDS,
    Array,
    DesignError,
    InvalidReturnValue,
    Journal,
    PassedOn,
    Plant,
    Record,
    RunFailure,
    RunInfo,
    Status,
    Statuses,
)
from rmpc_bench.types.errors import check_arguments, unknown
from rmpc_bench.types.result_layout import RESOLVED
from rmpc_bench.types.run_info import passed_on

if TYPE_CHECKING:
    import pandas as pd

Call = Callable[[str, int | None, Callable[..., Any], Sequence[Any]], Any]
"""Calls a method of a component written for one run: role, sample (None before the first), function, arguments."""


@dataclass(frozen=True, eq=False, repr=False)
class Replay:
    """A run of one method.

    Parameters
    ----------
    run, method, point : index of the run, name of the method, point of the sweep in words
    status : word of its status
    failed_steps : word of a status -> number of steps whose optimisation failed so
    failure : why it has failed; None where it has not, or where there is no description
    Ts : sampling time [s]
    signals : signal -> (samples, components), up to the last sample or the failure; u and what the controller reports
        have one sample less where the run reached its end; u_command only where the plant has bounds of its inputs; P,
        row by row, of `run_one` only
    r : (samples, ny) reference
    units : signal -> unit, and of single components, such as ``y.2``; t is the time
    uncertainty : named uncertain quantity -> value in this run
    metrics : metric -> value; empty for a part of a run and for a failed one
    stored : metric -> value in the trial store; empty where the run is not stored
    stored_status : word of the stored status; empty where the run is not stored
    error : the exception of a component, for a debugger; None where there is none
    """

    run: int
    method: str
    point: str
    status: str
    failure: RunFailure | None
    Ts: float
    signals: Mapping[str, Array]
    r: Array
    units: Mapping[str, str]
    uncertainty: Mapping[str, float]
    metrics: Mapping[str, float]
    stored: Mapping[str, float]
    stored_status: str
    error: BaseException | None = None
    failed_steps: Mapping[str, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<run {self.run} of {self.method!r}: {self.status}, {len(self.x)} samples>"

    @property
    def x(self) -> Float[Array, "samples nx"]:
        """True state."""
        return self.signals["x"]

    @property
    def y(self) -> Float[Array, "samples ny"]:
        """Output without noise."""
        return self.signals["y"]

    @property
    def u(self) -> Float[Array, "steps nu"]:
        """Applied input."""
        return self.signals["u"]

    @property
    def x_hat(self) -> Float[Array, "samples n"]:
        """Estimate."""
        return self.signals["x_hat"]

    @property
    def P(self) -> Float[Array, "samples n n"]:
        """Reported covariance of x_hat - x, NaN where there is none; of `run_one` only."""
        return self.signals["P"].reshape(*self.x_hat.shape, -1)

    @property
    def differing(self) -> dict[str, tuple[float, float]]:
        """Metric -> value here and in the store, where they are not the same number."""
        both = {name: (value, self.stored[name]) for name, value in self.metrics.items() if name in self.stored}
        return {name: pair for name, pair in both.items() if not np.array_equal(*pair, equal_nan=True)}

    def to_frame(self) -> pd.DataFrame:
        """Return the trace as a table: k, t and a column per component of a signal; empty where there is no value."""
        n = len(self.signals["x"])
        columns: dict[str, Array] = {"k": np.arange(n), "t": np.round(self.Ts * np.arange(n), 12)}
        for name, values in {"r": self.r[:n], **self.signals}.items():
            padded = np.full((n, values.shape[1]), np.nan)
            padded[: len(values)] = values
            columns |= {f"{name}.{i}" if values.shape[1] > 1 else name: padded[:, i] for i in range(values.shape[1])}
        return data_frame(columns)


def replay(
    directory: str | Path,
    run: int,
    method: str,
    *,
    until: int | None = None,
    at: Mapping[str, str] | None = None,
    call: Call | None = None,
) -> Replay:
    """Simulate one stored run again, from the configuration and the code that lie beside the trials.

    Parameters
    ----------
    directory : where `run` or the command line has stored trials
    run : index of the run
    method : name of the method
    until : last sample, its input and the step of the plant included; the whole run unless given
    at : path of the sweep -> value, for one of its points; the first point unless given
    call : calls the methods of components written for one run, for a debugger

    Returns
    -------
    the run with its trace; its metrics are compared with the stored ones

    Raises
    ------
    MissingError
        If there is no experiment in the directory.
    ConfigError
        If the configuration there cannot be built.
    DesignError
        If there is no such run, method, sample or point.

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> again = rmpc_bench.replay(results.directory, 2, "R-MPC")
    >>> again.status, again.differing
    ('ok', {})
    """
    check_arguments(replay, locals())
    place = Path(directory)
    refuse_imported(place)
    if not (place / FILE).exists() or not (place / RESOLVED).exists():
        raise MissingError(f"{place}: there is no experiment; fill the directory with `rmpc-bench run`")
    point = _point(load_config(place / RESOLVED), method, run, at)
    experiment = point.experiment
    if until is not None and not 0 <= until <= experiment.n_steps:
        raise DesignError(f"there is no sample {until}; they count from 0 to {experiment.n_steps}", "until")
    with single_thread():
        found = _simulated(point, method, run, until, call)
    status, stored = _stored(place, point, method, run)
    signals = {name: values for name, values in found.signals.items() if name != COVARIANCE}
    return replace(found, signals=signals, stored=stored, stored_status=status)


def run_one(
    config: ExperimentConfig | str | Path | Mapping[str, Any],
    method: str,
    run: int = 0,
    *,
    at: Mapping[str, str] | None = None,
    debug: bool = False,
) -> Replay:
    """Simulate one run of a configuration, with the numbers of the experiment; nothing is stored.

    Parameters
    ----------
    config : from `load_config`, or what it takes
    method : name of the method
    run : index of the run
    at : path of the sweep -> value, for one of its points; the first point unless given
    debug : whether the debugger of Python opens where a component has raised an exception

    Returns
    -------
    the run with y, x, u, x_hat, P, status and more, and `to_frame()`

    Raises
    ------
    Exception
        What a component has raised in a run that `run` would count as `crashed`.
    DesignError
        If there is no such run, method or point.

    Examples
    --------
    >>> import rmpc_bench
    >>> one = rmpc_bench.run_one("configs/quickstart.yaml", "R-MPC", run=34)
    >>> one.status, one.x_hat.shape, one.P.shape
    ('ok', (201, 4), (201, 4, 4))
    """
    check_arguments(run_one, locals())
    config = config if isinstance(config, ExperimentConfig) else load_config(config)
    point = _point(config, method, run, at)
    with single_thread():
        found = _simulated(point, method, run)
        if found.status == Status.CRASHED.word and found.error is None:
            # Once more, so that the exception of a component written for one run is at hand.
            found = _simulated(point, method, run, call=passed_on)
    error = found.error
    if error is None and found.status == Status.CRASHED.word:
        assert found.failure is not None
        error = InvalidReturnValue(found.failure.message)
    if error is None:
        return found
    if debug and error.__traceback__ is not None:
        pdb.post_mortem(user_entry(error))
    raise error


def _point(config: ExperimentConfig, method: str, run: int, at: Mapping[str, str] | None) -> SweepPoint:
    """Return a point of a sweep; a DesignError if there is no such point, or no such method or run at it."""
    point = chosen_point(config.points, at or {})
    if method not in config.methods:
        raise DesignError(unknown(method, config.methods, "method"), "method")
    if not 0 <= run < point.experiment.n_runs:
        raise DesignError(f"there is no run {run}; they count from 0 to {point.experiment.n_runs - 1}", "run")
    return point


def _simulated(point: SweepPoint, name: str, run: int, until: int | None = None, call: Call | None = None) -> Replay:
    """Simulate a run, with nothing of what is stored of it."""
    experiment, method = point.experiment, point.experiment.method(name)
    plant, n_steps = experiment.plant, experiment.n_steps if until is None else until
    for design in (plant, method.estimator, method.controller):
        design.warm_up()
    draws = experiment.scenario.draw(plant, range(run, run + 1), experiment.n_steps)
    r = experiment.scenario.reference.sample(experiment.n_steps + 1 + method.preview)
    start = RunStart(experiment.scenario.seed, (run,), Journal(call=call))
    info = {*method.reports, *(name for metric in experiment.metrics for name in metric.needs_info)}
    units = {**dict.fromkeys(("u", "u_command"), plant.u_unit), "y": plant.y_unit, **plant.units, **plant.extra_signals}
    replayed = partial(
        Replay,
        run,
        name,
        point.title,
        Ts=plant.Ts,
        r=r[: n_steps + 1],
        units={**units, "t": experiment.time_unit},
        uncertainty=named_values(experiment, run),
        stored={},
        stored_status="",
    )
    keywords: dict[str, Any] = {"info": info, "state_range": experiment.state_range, "start": start, "last": until}
    try:
        record, status = simulate(plant, method, draws, r, experiment.n_steps, with_P=True, with_M=True, **keywords)
    except (PassedOn, Exception) as caught:
        error = caught.error if isinstance(caught, PassedOn) else caught
        ended, empty = failure_of(error, experiment, run), np.zeros((0, 1))
        signals = dict.fromkeys((*SIGNALS, COVARIANCE), empty)
        return replayed(status=STATUS_WORDS[ended.status], failure=ended, signals=signals, metrics={}, error=error)
    whole = until is None
    code, metrics = _evaluated(experiment, record, status, start) if whole else (int(status[0]), {})
    failure = start.journal.failures.get(run)
    last = n_steps if failure is None or failure.k is None else failure.k
    if status[0] != OK and (failure is None or failure.k is None):
        last = last_new_sample(record.x[0, : n_steps + 1])
    signals = _signals(plant, record, last)
    steps = {STATUS_WORDS[step]: n for (_, step), n in sorted(start.journal.failed_steps.items())}
    return replayed(status=STATUS_WORDS[code], failure=failure, signals=signals, metrics=metrics, failed_steps=steps)


def _signals(plant: Plant, record: Record, last: int) -> dict[str, Array]:
    """Return the signals of the only run of a record, up to its last sample."""
    named = {name: getattr(record, name) for name in SIGNALS} | dict(record.info)
    if record.command is None:
        del named["u_command"]
    named |= {name: plant.extra_signal(name, record.delta, record.x)[:, :, None] for name in plant.extra_signals}
    named[COVARIANCE] = covariances(record)
    return {name: values[0, : last + 1] for name, values in named.items()}


def _evaluated(
    experiment: Experiment, record: Record, status: Statuses, start: RunStart
) -> tuple[int, dict[str, float]]:
    """Return the status of a whole run after its metrics, and these; a failed run has none."""
    evaluated = RunInfo(start.runs, (), status == OK, start.journal)
    record = record._replace(experiment=experiment.metric_layout, runs=evaluated)
    with np.errstate(over="ignore", invalid="ignore"):
        metrics = {metric.name: float(metric_values(metric, record)[0]) for metric in experiment.metrics}
    code = int(np.where(status == OK, evaluated.failed, status)[0])
    return code, metrics if code == OK else {}


def _stored(directory: Path, point: SweepPoint, method: str, run: int) -> tuple[str, dict[str, float]]:
    """Return the stored status of a run, and its metrics; both empty where it is not stored."""
    key = point.method_keys[method]
    with Store(directory, writable=False) as store:
        runs, words = store.column(key, run + 1)
        if run not in runs:
            return "", {}
        word = words[runs.index(run)]
        values = {name: float(store.values(key, each, [run])[0]) for name, each in point.metric_keys.items()}
    return word, values if word == Status.OK.word else {}
