"""The unit of work, one method over a range of runs; a run in which a component raises has failed and ends no other."""

from __future__ import annotations

import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import PurePath
from types import FrameType
from typing import Any, NamedTuple, TextIO

import numpy as np

from rmpc_bench.components.reference import CodeError
from rmpc_bench.components.transport import inside, recipe_of
from rmpc_bench.components.user_code import last_user_frame, one_line, untouched, user_trace
from rmpc_bench.simulation.checked_calls import CheckedController, CheckedEstimator, CheckedPlant, is_own
from rmpc_bench.simulation.closed_loop import Block, Loop, simulate_block
from rmpc_bench.simulation.ensemble import Group
from rmpc_bench.simulation.scenario import Draws, Experiment, own_draws
from rmpc_bench.types import (
    NO_WATCH,
    Array,
    Controller,
    Estimator,
    InvalidReturnValue,
    Journal,
    Method,
    Metric,
    Plant,
    RunFailure,
    Status,
    TimeLimit,
    Watch,
)
from rmpc_bench.types.basics import Design

MAX_FRAMES = 30
"""Frames of the bench that are kept, the innermost ones: a recursion without end has a thousand."""
WAITS = 0.1
"""Least share of computing in the time of a block; with less, a component waits for a device, and waiting counts."""
_ROLES: dict[str, tuple[type, ...]] = {
    "estimator": (Estimator, CheckedEstimator),
    "controller": (Controller, CheckedController),
    "plant": (Plant, CheckedPlant),
    "metric": (Metric,),
}


class Task(NamedTuple):
    """One method over a range of runs, at one point of a sweep."""

    method: str
    first: int
    stop: int
    point: int = 0

    @property
    def runs(self) -> range:
        """Indices of the runs."""
        return range(self.first, self.stop)


class Done(NamedTuple):
    """A finished task, or a finished part of a task."""

    task: Task
    block: Block
    uncertainty: Mapping[str, Array]  # name of an uncertain quantity -> (runs,) values
    seconds: float = 0.0  # time that the computation has taken, without waiting for a processor [s]
    loads: bool = False  # whether it is the first of its method in a process, whose time includes that of loading code


def work(experiments: Sequence[Experiment], task: Task, watch: Watch = NO_WATCH) -> Done:
    """Do one task; what its components replace for others is put back, and fails the runs of a built-in method."""
    experiment = experiments[task.point]
    method = experiment.method(task.method)
    counts, own = Counter[str](), has_own_code(experiment, method)
    started, computed = time.monotonic(), time.process_time()
    watch.start(len(task.runs))
    replaced = set[str]()
    with untouched() if own else nullcontext(replaced) as replaced, _counted_warnings(counts) if own else nullcontext():
        draws = _drawn(experiment, task.runs)
        # The plant may write into its record, and a component into its arguments, so every method gets copies.
        copies = own_draws(experiment.scenario, experiment.plant, task.runs, experiment.n_steps, draws)
        block = simulate_block(experiment, method, task.runs, copies, watch)
        values = _uncertain_values(experiment, task.runs, draws)
    watch.end()
    if replaced:
        text = f"{', '.join(sorted(replaced))} is replaced during a run, and other components use it too"
        if is_built_in(method.estimator) and is_built_in(method.controller):
            parts = [recipe for part in components_of(experiment) if (recipe := recipe_of(part)) is not None]
            names = [each.text for recipe in parts for each in inside([recipe.code, recipe.parameters])]
            raise CodeError(f"{text}, by {' or '.join(names) or 'a registered component'}")
        counts[text] += len(task.runs)
    block.journal.warnings.update(counts + Counter(dict.fromkeys(method.remarks, len(task.runs))))
    passed, computed = time.monotonic() - started, time.process_time() - computed
    return Done(task, block, values, computed if computed > WAITS * passed else passed)


def has_own_code(experiment: Experiment, method: Method) -> bool:
    """Whether a component that takes part in the runs of a method is not built in."""
    return not all(map(is_built_in, components_of(experiment, method)))


def is_built_in(part: Any) -> bool:
    """Whether a component runs no code but that of the bench."""
    return not is_own(part) and recipe_of(part) is None


def components_of(experiment: Experiment, *methods: Method) -> list[Any]:
    """Return everything whose code runs when methods are simulated."""
    scenario = experiment.scenario
    noises = (*scenario.x0_noise, *scenario.process, *scenario.measurement, *scenario.input)
    pairs = [part for method in methods for part in (method.estimator, method.controller)]
    return [experiment.plant, *pairs, scenario.reference, *noises, *experiment.metrics]


def parts_of(experiments: Sequence[Experiment]) -> list[Any]:
    """Return everything whose code runs when all methods of experiments are simulated."""
    return [part for experiment in experiments for part in components_of(experiment, *experiment.methods)]


def warm_up_own(experiments: Sequence[Experiment]) -> None:
    """Let components that are not built in prepare themselves, once in every process that simulates them."""
    for part in {id(part): part for part in parts_of(experiments)}.values():
        if isinstance(part, Design) and not is_built_in(part):
            part.warm_up()


@contextmanager
def _counted_warnings(counts: Counter[str]) -> Iterator[None]:
    """Count warnings by their text and line, instead of printing them."""

    def count(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        counts[f"{category.__name__}: {message} ({PurePath(filename).name}:{lineno})"] += 1

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = count
        yield


def _uncertain_values(experiment: Experiment, runs: range, draws: Draws) -> dict[str, Array]:
    """Values that are constant during a run: named quantities, times of bursts, and constants that the plant draws."""
    scenario = experiment.scenario
    bursts = [scenario.burst_values(run) for run in runs] if scenario.burst_names else []
    found = scenario.named_columns(runs)
    found |= {name: np.array([each[name] for each in bursts]) for name in (bursts[0] if bursts else ())}
    return found | {name: np.array(values, dtype=float) for name, values in experiment.plant.drawn(draws.delta).items()}


def named_values(experiment: Experiment, run: int) -> dict[str, float]:
    """Draw the named uncertain quantities and the times of random bursts of one run, without the plant."""
    return experiment.scenario.named_values(run) | experiment.scenario.burst_values(run)


_last_draw: list[tuple[Experiment, range, Draws]] = []
"""One-entry cache of the last random draw in this process: the methods of a block follow each other and get copies."""


def _drawn(experiment: Experiment, runs: range) -> Draws:
    if not (_last_draw and _last_draw[0][0] is experiment and _last_draw[0][1] == runs):
        _last_draw[:] = [(experiment, runs, experiment.scenario.draw(experiment.plant, runs, experiment.n_steps))]
    return _last_draw[0][2]


def forget_draws() -> None:
    """Empty the cache of the last random draw."""
    _last_draw.clear()


def failed(experiments: Sequence[Experiment], task: Task, failure: RunFailure) -> Done:
    """Return the result of a task of one run that has failed outside of the simulation loop.

    It has no metrics and no trajectories.
    """
    experiment = experiments[task.point]
    journal = Journal()
    journal.fail(failure)
    # The width of the estimate is not known; the moments of a group leave out a run that has failed.
    group = Group(task.first, task.stop, 0, np.zeros((1, 1)), np.empty((0, 1, 1)))
    ensemble = (group,) if experiment.recording.ensemble else ()
    values = np.full((len(experiment.metrics), 1), np.nan)
    block = Block(np.array([failure.status], dtype=np.int8), values, {}, ensemble, journal)
    uncertainty = {name: np.array([value]) for name, value in named_values(experiment, task.first).items()}
    return Done(task, block, uncertainty)


def failure_of(error: BaseException, experiment: Experiment, run: int) -> RunFailure:
    """Describe the exception that ended a run which was simulated alone."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    # By the type itself: `isinstance` asks a proxy of the user for its class, which may raise.
    loop = next((each for frame in frames for each in frame.f_locals.values() if type(each) is Loop), None)
    signals = {} if loop is None else {"y": loop.y, "u_previous": loop.u, "x_hat": loop.x_hat}
    known = {name: value for name, signal in signals.items() if (value := _last(signal)) is not None}
    return RunFailure(
        run,
        int(Status.TIMEOUT if isinstance(error, TimeLimit) else Status.CRASHED),
        _role(frames),
        None if loop is None else loop.k,
        str(error) if isinstance(error, InvalidReturnValue | TimeLimit) else one_line(error),
        _trace(error),
        {**known, "parameters": named_values(experiment, run)},
    )


def _trace(error: BaseException) -> str:
    """Return the frames of the component's own code; those of the bench where there are no others."""
    if last_user_frame(error):
        return user_trace(error)
    return "".join(traceback.format_exception(error, limit=-MAX_FRAMES))


def _role(frames: Sequence[FrameType]) -> str:
    """Name the component whose method was called first."""
    for frame in frames:
        owner = frame.f_locals.get("self", frame.f_locals.get("metric"))
        for role, classes in _ROLES.items():
            if isinstance(owner, classes):
                return role
    return ""


def _last(signal: Array | None) -> list[Any] | None:
    """Return the signal of the only run; None where it is not known."""
    return signal[0].tolist() if signal is not None and len(signal) == 1 else None


def contained(
    experiments: Sequence[Experiment],
    task: Task,
    is_fatal: Callable[[BaseException], bool],
    watch: Watch = NO_WATCH,
) -> Iterator[Done]:
    """Do one task; if a component raises, repeat its halves until each run that raises is alone (bisection).

    The runs of a block must not depend on each other; a repeated run then has the same numbers.
    """
    try:
        done = work(experiments, task, watch)
    except BaseException as error:
        watch.end()
        if is_fatal(error):
            raise
        failure = failure_of(error, experiments[task.point], task.first) if len(task.runs) <= 1 else None
    else:
        yield done
        return
    # Outside of the handler: the exception keeps the arrays of the block alive.
    if failure is not None:
        yield failed(experiments, task, failure)
        return
    middle = (task.first + task.stop) // 2
    for part in (task._replace(stop=middle), task._replace(first=middle)):
        yield from contained(experiments, part, is_fatal, watch)
