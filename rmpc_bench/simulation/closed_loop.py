"""The simulation loop: measure, correct, control, simulate the plant over one period, predict."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.simulation.angles import turned_calls
from rmpc_bench.simulation.block_times import BlockTimes
from rmpc_bench.simulation.checked_calls import checked_calls, metric_values, signals_read
from rmpc_bench.simulation.ensemble import Group, groups
from rmpc_bench.simulation.input_channel import ActingInput, Feedthrough, InputChannel
from rmpc_bench.simulation.late_measurements import Arrivals
from rmpc_bench.simulation.linear_loop import applies, compiled_loop
from rmpc_bench.simulation.open_loop import OpenLoop
from rmpc_bench.simulation.recording import BURSTS, COVARIANCE, SIGNALS, Recorder
from rmpc_bench.simulation.run_start import RunStart, RunState
from rmpc_bench.simulation.scenario import Draws, Experiment
from rmpc_bench.simulation.state_range import DEFAULT_RANGE, OK, RunLimits, StateRange
from rmpc_bench.types import (
    NO_WATCH,
    Ahead,
    Array,
    Command,
    Controller,
    Estimate,
    Journal,
    Method,
    Plant,
    Record,
    RunInfo,
    Statuses,
    Watch,
    as_command,
    as_estimate,
    as_motion,
    without_disturbances,
)
from rmpc_bench.types.angles import period_of, places, wrapped

_WITH_CODE = re.compile(r"(?!rmpc_bench\.)|rmpc_bench\.(components|adapters)\.")
"""Modules of designs that run code of a user or of another library."""


class Block(NamedTuple):
    """Results of a block of runs."""

    status: Statuses
    metrics: Float[Array, "metrics runs"]
    """NaN where the run failed."""
    traces: Mapping[str, Float[Array, "recorded samples n"]]
    """Signal -> trajectories of the first runs of the block, as many as are to be recorded; empty where the simulation
    did not reach its end."""
    ensemble: Sequence[Group]
    """Mean and covariance of (x, x_hat) over groups of runs, where they are to be kept."""
    journal: Journal
    """Failures, held and failed steps, durations and warnings of the components."""


def simulate_block(
    experiment: Experiment, method: Method, runs: range, draws: Draws | None = None, watch: Watch = NO_WATCH
) -> Block:
    """Simulate the runs of these indices with one method and reduce them to their metrics; draw what is not given."""
    plant, n_steps, recording = experiment.plant, experiment.n_steps, experiment.recording
    if draws is None:
        draws = experiment.scenario.draw(plant, runs, n_steps)
    r = experiment.scenario.reference.sample(n_steps + 1 + method.preview)
    P, M = any(metric.needs_P for metric in experiment.metrics), any(metric.needs_M for metric in experiment.metrics)
    info = {name for metric in experiment.metrics for name in metric.needs_info}
    n_recorded = max(0, min(len(runs), recording.n_runs - runs.start))
    P = P or (n_recorded > 0 and COVARIANCE in recording.signals)
    info |= set(recording.signals) - set(SIGNALS) if n_recorded else set()
    start = RunStart(experiment.scenario.seed, tuple(runs), Journal(), watch)
    options: dict[str, Any] = {"with_P": P, "with_M": M, "info": info, "state_range": experiment.state_range}
    simulated: tuple[Record, Statuses] | None = None
    # A limit of time holds for single steps.
    if not watch.has_limits and applies(experiment, method):
        watch.step(0)
        whole = n_recorded > 0 or recording.ensemble
        needed = SIGNALS if whole else {name for metric in experiment.metrics for name in signals_read(metric)}
        simulated = compiled_loop(plant, method, draws, r, n_steps, start=start, needed=needed, **options)
    record, status = simulated or simulate(plant, method, draws, r, n_steps, start=start, **options)
    evaluated = RunInfo(start.runs, (), status == OK, start.journal)
    record = record._replace(experiment=experiment.metric_layout, runs=evaluated, shared={})
    # Failed runs may overflow; their values are replaced by NaN.
    with np.errstate(over="ignore", invalid="ignore"):
        found = [metric_values(metric, record) for metric in experiment.metrics]
    status = np.where(status == OK, evaluated.failed, status)
    ok = status == OK
    values = [np.where(ok, each, np.nan) for each in found]
    traces = {
        name: trace[:n_recorded]
        for name in recording.signals
        if n_recorded and (trace := _signal(record, name, plant)) is not None
    }
    ensemble = groups(record.x, _nearest(record), ok, runs) if recording.ensemble else ()
    return Block(status, np.array(values).reshape(len(values), len(ok)), traces, ensemble, start.journal)


def _nearest(record: Record) -> Array:
    """Return x_hat with the turns of x in angles, since moments of x_hat - x are computed from those of both."""
    period = period_of(record.layout.angles, places("x", record.x.shape[2]))
    if period is None or record.x.shape != record.x_hat.shape:
        return record.x_hat
    return record.x + wrapped(record.x_hat - record.x, period)


def metric_remarks(experiment: Experiment) -> list[str]:
    """Return what metrics remark on the first run of the first method without code of a user or another library."""
    layout = experiment.metric_layout
    metrics = [metric for metric in experiment.metrics if metric.remark(None, layout)]
    if not metrics:
        return []
    plant, n_steps, info = experiment.plant, experiment.n_steps, {name for each in metrics for name in each.needs_info}
    built_in = (
        each
        for each in experiment.methods
        if not any(_WITH_CODE.match(type(design).__module__) for design in (plant, each.estimator, each.controller))
    )
    record = None
    if (method := next(built_in, None)) is not None:
        draws = experiment.scenario.draw(plant, range(1), n_steps)
        r = experiment.scenario.reference.sample(n_steps + 1 + method.preview)
        start, limits = RunStart(experiment.scenario.seed, (0,), Journal()), experiment.state_range
        run, status = simulate(plant, method, draws, r, n_steps, info=info, state_range=limits, start=start)
        record = run._replace(experiment=layout) if status[0] == OK else None
    return [metric.remark(record, layout) for metric in metrics]


def simulate(
    plant: Plant,
    method: Method,
    draws: Draws,
    r: Float[Array, "known ny"],
    n_steps: int,
    *,
    with_P: bool = False,
    with_M: bool = False,
    info: Collection[str] = (),
    state_range: StateRange = DEFAULT_RANGE,
    start: RunStart | None = None,
    last: int | None = None,
) -> tuple[Record, Statuses]:
    """Simulate all runs of ``draws`` over samples k = 0..n_steps and return their trajectories.

    A run whose status leaves `Status.OK` is frozen: it keeps its last state.  The other runs are not affected.
    Estimator and controller get y as it is measured, with NaN where it is missing, and late values when they arrive; y
    of the record has no noise.
    u is what acts: the input of the controller after the laws of the input and within the bounds of the plant.
    Estimator and controller get what the method knows of it (input_channel.py).
    Every array that a component returns is copied at once, so that it may use the same memory again.  r has at least
    n_steps + the controller's preview samples.  What trajectories hold for samples after `last` has no meaning.

    Examples
    --------
    >>> import rmpc_bench
    >>> given = rmpc_bench.load_config("quickstart").experiment
    >>> method, draws = given.methods[0], given.scenario.draw(given.plant, range(3), given.n_steps)
    >>> r = given.scenario.reference.sample(given.n_steps + method.preview)
    >>> record, status = simulate(given.plant, method, draws, r, given.n_steps)
    >>> record.x.shape, status.tolist()
    ((3, 201, 5), [0, 0, 0])
    """
    n_runs, nd, preview = len(draws.x0), method.n_disturbances, method.preview
    start, known = start or RunStart(0, tuple(range(n_runs)), Journal()), r[: n_steps + 1].copy()
    loop = Loop(plant, method, draws, known, n_steps, start, state_range, method.controller)
    outputs, inputs = Recorder(n_steps + 1, n_runs if loop.own_matrices else None), Recorder(n_steps)
    changes_inputs = plant.limits_inputs or bool(draws.inputs)
    # Overflow is expected here: the run gets status `diverged`.
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(n_steps + 1):
            y_true, y, given = loop.measured(k)
            estimate = loop.corrected(k, given)
            of_x = without_disturbances(estimate, nd)
            outputs.at(k, x=loop.x, y=y_true, x_hat=of_x.x_hat, **_wanted(of_x.info, info))
            outputs.matrix_at(k, "P", of_x.P if with_P else None)
            outputs.matrix_at(k, "M", of_x.M if with_M else None)
            if k == n_steps:
                break
            command, (u, u_m, _) = loop.controlled(k, y, estimate, r[k : k + preview])
            inputs.at(k, u=u, **({"u_command": command.u} if changes_inputs else {}), **_wanted(command.info, info))
            loop.moved(k, u, u_m)
            if k == last:
                break
    loop.timed.note(start.journal, n_runs, n_steps)
    record = _recorded(outputs, inputs, plant.Ts, known, method.controller)
    return record._replace(bursts=draws.bursts, delta=loop.draws.delta), loop.status


class Loop:
    """The samples of a block of runs: what is measured and estimated at k, and what an input makes of the plant.

    An `Episode` has no law.
    """

    # What a description of a run that an exception has ended names; None before the first sample.
    k: int | None = None
    y: Array | None = None  # as the estimator and the controller get it
    x_hat: Array | None = None
    u: Array | None = None  # that acted last

    def __init__(
        self,
        plant: Plant,
        method: Method,
        draws: Draws,
        r: Float[Array, "samples ny"],
        n_steps: int,
        start: RunStart,
        state_range: StateRange,
        law: Controller | None = None,
    ) -> None:
        n_runs = len(draws.x0)
        self._plant, self._method, self._start, self._last = plant, method, start, n_steps - 1
        self._runs = runs = RunState.of(n_runs)
        delta = start.plant(plant, draws.delta, draws.x0, runs)
        self.draws, self.x = draws._replace(delta=delta), np.array(plant.first_state(delta, draws.x0))
        self._w, self._v = plant.mix(delta, draws.w, draws.v) if plant.mixes_noise else (draws.w, draws.v)
        self._no_noise = np.zeros_like(self._v[:, 0])
        self._e = start.estimator(method.estimator, n_runs, delta, runs)
        self._c = None if law is None else start.controller(law, n_runs, runs)
        self._moving, estimator, controller = checked_calls(plant, method, runs.alive, start.journal)
        counted = RunInfo(start.runs, (), runs.alive, start.journal)
        self._channel = InputChannel(plant, draws.inputs, method.delay, method.u_before, counted)
        signal = partial(law.signal.sample, start.runs) if isinstance(law, OpenLoop) else None
        self.fed = Feedthrough(plant, self._channel, method.estimator, signal, n_steps)
        filter_, called = turned_calls(method, self.fed.used_by(estimator), controller)
        self._arrivals = Arrivals(draws, method.delay)
        self.timed = BlockTimes(self._arrivals.used_by(filter_), called)
        # In every block alike: sums differ in the last bits otherwise.
        recorded = plant.recorded is not None and bool(plant.recorded.gaps)
        self.own_matrices = draws.omits_measurements or bool(self._arrivals.D) or recorded
        """Whether every run has matrices of its own, whether or not it has a gap."""
        self._limits = RunLimits(state_range, self.x, r)
        with np.errstate(over="ignore", invalid="ignore"):
            self.status = runs.after(self._limits.of_state(np.full(n_runs, OK), runs.failed, self.x))

    def measured(self, k: int) -> tuple[Array, Array, Any]:
        """Return y(k) without noise, y(k) as it is measured and arrives, and what the estimator gets."""
        self.k = k
        self._start.watch.step(k)
        acting, delta = self.fed.at(k, len(self.x)), self.draws.delta
        y_true = np.array(self._moving.output(k, delta, self.x, self._no_noise, *acting))
        v, mixes = self._v[:, k], self._plant.mixes_noise
        y = y_true + v if mixes else np.array(self._moving.output(k, delta, self.x, v, *acting))
        self.y, given = self._arrivals.at(k, self.draws.altered(k, y))
        self.status = self._runs.with_reported(self.status)
        return y_true, self.y, given

    def corrected(self, k: int, given: Any) -> Estimate:
        """Call the estimator."""
        self._e, answer = self.timed.correct(k, self._e, given)
        estimate = as_estimate(answer)
        estimate = estimate._replace(x_hat=np.array(estimate.x_hat))
        found = estimate.status, estimate.x_hat, self._method.n_disturbances
        self.status = self._runs.after(self._limits.of_estimate(self.status, *found))
        self.x_hat = estimate.x_hat
        return estimate

    def controlled(self, k: int, y: Array, estimate: Estimate, r: Array) -> tuple[Command, ActingInput]:
        """Call the controller; return its command and the input that acts."""
        estimate, *ahead = self._ahead(k, estimate)
        if ahead:
            self._c, chosen = self.timed.control_ahead(k, self._c, y, estimate, r, *ahead)
        else:
            self._c, chosen = self.timed.control(k, self._c, y, estimate, r[: self._method.controller.preview])
        command = as_command(chosen)
        command = command._replace(u=np.array(command.u))
        acting = self.acting(k, command.u, command.status)
        self._start.note_steps(command.step_status, self._runs)
        own = acting.known if self._method.controller.takes_acting_input else acting.sent
        self._c = self.timed.applied(k, self._c, own.copy())
        self.u = acting.u
        return command, acting

    def acting(self, k: int, u: Float[Array, "runs nu"], reported: Statuses) -> ActingInput:
        """Return the input that acts at k, with the statuses that come with what was chosen."""
        self.status = self._runs.after(self._limits.of_input(self.status, reported, u))
        return self._channel.step(k, u)

    def moved(self, k: int, u: Float[Array, "runs nu"], known: Float[Array, "runs nu"]) -> None:
        """Move the plant to k+1 by the input that acts, and predict by what the method knows of it."""
        motion = as_motion(self._moving.step(k, self.draws.delta, self.x.copy(), u.copy(), self._w[:, k]))
        self.status = self._runs.after(self._limits.of_state(self.status, motion.status, motion.x))
        alive = self._runs.alive
        self.x = np.array(motion.x) if alive.all() else np.where(alive[:, None], motion.x, self.x)
        self._e = self.timed.predict(k, self._e, self._method.controller.known_inputs(known.copy()))

    def _ahead(self, k: int, estimate: Estimate) -> tuple[Any, ...]:
        """Predict the estimate over the delay of the input, for a law that uses it; also return what it takes then."""
        method = self._method
        if method.flow is None:
            return (estimate,)
        x, y_hat = estimate.x_hat, []
        for i, u in enumerate(self._channel.on_way):
            now = min(k + i, self._last)
            y_hat.append(method.flow.measure(now, x, *([u] if method.estimator.fed is not None else [])))
            x = method.flow.advance(now, x, u)
            # The mean of the process noise is held over the horizon of a law, too.
            x = x + estimate.info["w_mean"] if method.estimator.estimates_mean else x
        predicted = estimate._replace(x_hat=x, P=None, M=None)
        return predicted, Ahead(np.array(y_hat), min(k + len(y_hat), self._last))


def _recorded(
    outputs: Recorder, inputs: Recorder, Ts: float, r: Float[Array, "samples ny"], controller: Controller
) -> Record:
    """Return what was recorded."""
    signals = {**outputs.all(), **inputs.all()}
    x, y, x_hat, u = (signals.pop(name) for name in ("x", "y", "x_hat", "u"))
    record = Record(Ts, x, y, x_hat, u, r, outputs.matrix("P"), outputs.matrix("M"), controller)
    gappy_P = outputs.matrix("P", gappy=True)
    return record._replace(command=signals.pop("u_command", None), info=signals, gappy_P=gappy_P)


def _wanted(info: Mapping[str, Array], names: Collection[str]) -> dict[str, Float[Array, "runs _"]]:
    """Entries to record of what a component reports, one row per run."""
    return {name: value.reshape(len(value), -1) for name, value in info.items() if name in names}


def _signal(record: Record, name: str, plant: Plant) -> Float[Array, "runs _ _"] | None:
    """Trajectories of a signal; None where the method does not report it."""
    if name in plant.extra_signals:
        return plant.extra_signal(name, record.delta, record.x)[:, :, None]
    if name == BURSTS:
        return None if record.bursts is None else record.bursts[:, :, None].astype(float)
    if name == COVARIANCE and name not in record.info:
        return covariances(record)
    return getattr(record, name) if name in SIGNALS else record.info.get(name)


def covariances(record: Record) -> Float[Array, "runs samples nn"]:
    """Reported covariances of every run, row by row; NaN where the method reports none."""
    runs, samples, n = record.x_hat.shape
    if record.P is None:
        return np.full((runs, samples, n * n), np.nan)
    return np.broadcast_to(record.P, (runs, samples, n, n)).reshape(runs, samples, n * n)
