"""Components that misbehave in some runs, on the toy plant; the other runs are those of the toy estimator."""

import ctypes
import itertools
import os
import signal
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from simulation.toy import Halfway, Proportional, Walk

from rmpc_bench.engines.tasks import Task
from rmpc_bench.metrics.tracking import Mse
from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Experiment, Recording, Scenario
from rmpc_bench.types import Method, Metric

BAD = (7, 23)
"""Runs in which a component misbehaves."""
K_BAD = 3
"""Sample at which it does."""
STEPS = 6


class Seen(NamedTuple):
    """State of the filter: its prediction, and the indices of the runs."""

    x_pred: np.ndarray
    index: tuple


class Misbehaving(Halfway):
    """The toy estimator, which calls a function at one sample of a block that has a bad run."""

    starts_runs = True

    def __init__(self, act):
        self.act = act

    def init(self, n_runs, runs):
        """Keep the indices of the runs."""
        return Seen(super().init(n_runs).x_pred, runs.index)

    def correct(self, k, state, y):
        """Estimate as the toy does, then misbehave."""
        _, estimate = super().correct(k, state, y)
        seen = Seen(estimate.x_hat, state.index)
        if k == K_BAD and set(BAD) & set(state.index):
            estimate = self.act(estimate, state.index)
        return seen, estimate

    def predict(self, k, state, u):
        """Go on as the toy does."""
        return Seen(super().predict(k, state, u).x_pred, state.index)


def raise_value_error(estimate, index):
    """Raise what a wrong argument raises."""
    raise ValueError("negative level")


def exit_by_sys(estimate, index):
    """Call sys.exit."""
    raise SystemExit(0)


def interrupt(estimate, index):
    """Raise what Ctrl-C raises, without a signal."""
    raise KeyboardInterrupt


def fail_to_open(estimate, index):
    """Open a file that is not there."""
    with open("/nowhere/table.csv") as file:
        return file


def return_wide(estimate, index):
    """Return an estimate with too many states."""
    return estimate._replace(x_hat=np.hstack([estimate.x_hat, estimate.x_hat]))


def return_list(estimate, index):
    """Return an estimate that is no array."""
    return estimate._replace(x_hat=estimate.x_hat.tolist())


def return_text(estimate, index):
    """Return an estimate of a wrong dtype."""
    return estimate._replace(x_hat=estimate.x_hat.astype(str))


def return_bad_status(estimate, index):
    """Return a status that does not exist, in the rows of the bad runs."""
    return estimate._replace(status=np.where(np.isin(index, BAD), 77, 0))


def return_nothing(estimate, index):
    """Return no estimate at all."""
    return None


def do_nothing(estimate, index):
    """Return the estimate."""
    return estimate


@dataclass(frozen=True, kw_only=True)
class Level(Metric):
    """The first state, and an exception where it is that of a bad run."""

    name: str = "level"
    refused: tuple = ()

    def evaluate(self, record):
        """Return the first state."""
        if set(record.x[:, 0, 0]) & set(self.refused):
            raise ArithmeticError("no level")
        return record.x[:, 0, 0]


RECORDING = Recording(("y", "x_hat"), 30, ensemble=True)


def experiment(acts, n_runs=50, *, metrics=(), recording=RECORDING):
    """Return an experiment with one method per misbehaviour, named after its function."""
    noise = gaussian(1, std=0.1)
    scenario = Scenario(1, {}, {}, np.ones(1), (noise,), (noise,), (noise,), constant(1, value=0.5))
    methods = tuple(Method(act.__name__, Misbehaving(act), Proportional()) for act in acts)
    return Experiment(Walk(), methods, scenario, (Mse(), *metrics), n_runs, STEPS, recording)


def tasks_of(made, block):
    """Return the tasks of an experiment in blocks."""
    starts = range(0, made.n_runs, block)
    return [Task(method.name, first, min(first + block, made.n_runs)) for first in starts for method in made.methods]


def exit_at_once(estimate, index):
    """End the process without clean-up."""
    os._exit(3)


def kill_itself(estimate, index):
    """End the process as the system does when memory runs out."""
    os.kill(os.getpid(), signal.SIGKILL)


def fault(estimate, index):
    """Read from address 0."""
    ctypes.string_at(0)


def sleep(estimate, index):
    """Wait for a signal that never arrives."""
    time.sleep(1000.0)


def loop(estimate, index):
    """Compute without end in Python, and catch every error."""
    while True:
        try:
            sum(range(1000))
        except Exception:  # noqa: S110
            pass


def loop_that_catches_all(estimate, index):
    """Go on without end in Python, and catch whatever is raised; `loop` computes all the time."""
    while True:
        try:
            time.sleep(0.01)
        except BaseException:  # noqa: S110
            pass


def loop_in_compiled_code(estimate, index):
    """Compute without end where no signal is seen: one call that holds the interpreter."""
    return sum(itertools.repeat(1))


def fill_memory(estimate, index):
    """Allocate and write 4 GB."""
    return np.ones(500_000_000)
