"""Engines, which compute tasks: in this process, or in worker processes of joblib.

Results arrive in any order, and they do not depend on the engine.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Generator, Sequence
from multiprocessing import resource_tracker as multiprocessing_tracker
from typing import NamedTuple

from rmpc_bench.components.transport import dumps, loads
from rmpc_bench.execution.interrupts import held
from rmpc_bench.simulation.closed_loop import Block, simulate_block
from rmpc_bench.simulation.own_draws import own_draws
from rmpc_bench.simulation.scenario import Draws, Experiment
from rmpc_bench.simulation.threads import single_thread


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
    """A finished task."""

    task: Task
    block: Block
    uncertainty: list[dict[str, float]]


def work(experiments: Sequence[Experiment], task: Task) -> Done:
    """Do one task.

    Parameters
    ----------
    experiments : one per point of the sweep
    task : what to do
    """
    experiment = experiments[task.point]
    draws = _drawn(experiment, task.runs)
    # The plant may write into its record, and a component into its arguments, so every method gets copies.
    own = own_draws(experiment.scenario, experiment.plant, task.runs, experiment.n_steps, draws)
    block = simulate_block(experiment, experiment.method(task.method), task.runs, own)
    return Done(task, block, _uncertain_values(experiment, task.runs, draws))


def _uncertain_values(experiment: Experiment, runs: range, draws: Draws) -> list[dict[str, float]]:
    """Values that are constant during a run: named quantities, times of bursts, and constants that the plant draws."""
    plant = experiment.plant
    drawn = plant.drawn(draws.delta)
    scenario = experiment.scenario
    return [
        scenario.named_values(run)
        | scenario.burst_values(run)
        | {name: float(values[row]) for name, values in drawn.items()}
        for row, run in enumerate(runs)
    ]


_last_draw: list[tuple[Experiment, range, Draws]] = []
"""One-entry cache of the last random draw in this process: the methods of a block follow each other and get copies."""


def _drawn(experiment: Experiment, runs: range) -> Draws:
    if not (_last_draw and _last_draw[0][0] is experiment and _last_draw[0][1] == runs):
        _last_draw[:] = [(experiment, runs, experiment.scenario.draw(experiment.plant, runs, experiment.n_steps))]
    return _last_draw[0][2]


def serial(experiments: Sequence[Experiment], tasks: Sequence[Task]) -> Generator[Done]:
    """Do the tasks in this process, one after the other."""
    try:
        with single_thread():
            for task in tasks:
                yield work(experiments, task)
    finally:
        _last_draw.clear()


def processes(experiments: Sequence[Experiment], tasks: Sequence[Task], workers: int) -> Generator[Done]:
    """Do the tasks in worker processes; closing the generator ends them."""
    from joblib import Parallel, delayed
    from joblib.externals.loky import get_reusable_executor
    from joblib.externals.loky.backend import resource_tracker

    for tracker in (resource_tracker, multiprocessing_tracker):
        # A tracker unblocks signals when it starts, so it must not start while they are held back below.
        tracker.ensure_running()
    parallel = Parallel(
        n_jobs=workers,
        backend="loky",
        return_as="generator_unordered",
        batch_size=1,
        inner_max_num_threads=1,
        initializer=_start_worker,
        initargs=(dumps(experiments),),
    )
    results = None
    try:
        # A pool that is interrupted while it starts cannot be shut down.
        with held():
            results = parallel(delayed(_work_here)(task) for task in tasks)
        for done in results:  # noqa: UP028 - `yield from` would close the results before the warnings are off
            yield done
    finally:
        with held(), warnings.catch_warnings():
            # joblib warns of finished tasks that were not used, which is normal after an interruption.
            warnings.simplefilter("ignore")
            if results is not None:
                results.close()
            get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)


_here: list[Experiment] = []
"""The experiments of this worker process, sent once when it started."""


def _start_worker(experiments: bytes) -> None:
    # Ctrl-C in a terminal reaches every process of the group; only the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    threading.Thread(target=_follow, args=(os.getppid(),), daemon=True).start()
    # The returned context is not entered, so that the limit stays for the life of the worker.
    single_thread()
    _here[:] = loads(experiments)


def _follow(parent: int) -> None:
    """End this worker when its parent has been killed; loky alone would keep it waiting for minutes."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _work_here(task: Task) -> Done:
    return work(_here, task)
