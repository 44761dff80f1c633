"""Lengths of blocks: about half a second of work, known from the blocks that are finished.

Results do not depend on the lengths.  A short block costs time between blocks, and a long one is lost as a whole when
the experiment is interrupted.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence

from rmpc_bench.execution.engines.tasks import Done, has_own_code
from rmpc_bench.simulation.ensemble import SIZE
from rmpc_bench.simulation.scenario import Experiment

SECONDS = 0.5
"""Time of a block of the slowest method [s]."""
FIRST = 0.1
"""The same before anything is measured [s]; the time is then estimated."""
LEAST = 0.1
"""Shorter blocks are not made to keep all workers busy until the end [s]."""
GROWTH = 8
"""Factor by which a block may be longer than the longest one of its method that is finished."""
MEGABYTES = 32.0
"""Largest memory of the trajectories of a block [MB]."""
STEP_OF_A_BLOCK, STEP_OF_A_RUN = 5e-5, 2.5e-6
"""Time of a step, per block and per run [s], to the second of which slow designs add their `cost_per_step`."""
STEP_OF_OWN_CODE = 1e-4
"""Time of a step of a run [s] with a component of the user that states no `cost_per_step`."""
OVERHEAD = 5e-4
"""Time of a step of a block of built-in components besides that of its runs [s], at most."""
REMEMBERED = 3
"""Blocks of a method whose shortest time of a run counts."""
_MEGABYTES_PER_NUMBER = 8e-6

Pair = tuple[int, str]
"""Index of a point of the sweep, and name of a method."""


def estimated_seconds(experiment: Experiment, method: str) -> float:
    """Estimate the time of a run in a long block [s]."""
    pair = experiment.method(method)
    cost = sum(design.cost_per_step for design in (experiment.plant, pair.estimator, pair.controller))
    if not cost and has_own_code(experiment, pair):
        cost = STEP_OF_OWN_CODE
    return experiment.n_steps * (STEP_OF_A_RUN + cost)


def megabytes_of_a_run(experiment: Experiment) -> float:
    """Return the memory of a run in a block [MB]: twice the trajectories x, x_hat, w, v, y and u."""
    plant = experiment.plant
    width = 2 * plant.nx + plant.nw + plant.nv + plant.ny + plant.nu
    return 2 * _MEGABYTES_PER_NUMBER * experiment.n_steps * width


def usual_length(experiment: Experiment, method: str, fixed: int | None = None) -> int:
    """Return the number of runs of a long block of a method, before anything is measured."""
    if fixed is not None:
        return fixed
    longest = min(SECONDS / estimated_seconds(experiment, method), MEGABYTES / megabytes_of_a_run(experiment))
    return min(max(1, math.floor(longest)), experiment.n_runs)


class BlockLengths:
    """Lengths of the next blocks.

    Parameters
    ----------
    experiments : one per point of the sweep
    fixed : number of runs of every block; None to choose it by time
    """

    def __init__(self, experiments: Sequence[Experiment], fixed: int | None = None) -> None:
        self.seconds = SECONDS
        """Time of a block of the slowest method [s]."""
        self._experiments, self._fixed = experiments, fixed
        self._times: dict[Pair, deque[float]] = {}
        self._measured: dict[Pair, float] = {}
        self._longest: dict[Pair, int] = {}
        self._estimated: dict[Pair, float] = {}
        # Measured by estimated time of what is measured.
        self._correction: float | None = 1.0

    def note(self, done: Done) -> None:
        """Note how long a task, or a part of one, has taken."""
        pair, n = (done.task.point, done.task.method), len(done.task.runs)
        # A run that has failed outside of the simulation has no time.
        if done.seconds > 0.0 and n:
            times = self._times.setdefault(pair, deque(maxlen=REMEMBERED))
            times.append(done.seconds / n)
            # The first block of a process loads compiled code, and other programs delay a block: both only add time.
            self._measured[pair] = min(times)
            self._longest[pair] = max(n, self._longest.get(pair, 0))
            self._correction = None

    def is_measured(self, pair: Pair) -> bool:
        """Whether a block of a method is finished."""
        return pair in self._measured

    def seconds_of_a_run(self, pair: Pair) -> float:
        """Return the time of a run [s]: measured, or estimated and corrected by what is measured of others."""
        if pair in self._measured:
            return self._measured[pair]
        if self._correction is None:
            self._correction = sum(self._measured.values()) / sum(map(self._estimate, self._measured))
        return self._estimate(pair) * self._correction

    def stop(self, first: int, pairs: Collection[Pair], seconds_left: float, workers: int) -> int:
        """Return the end of the block that begins with a run, from the time of all runs that are not handed out [s]."""
        if self._fixed is not None:
            return (first // self._fixed + 1) * self._fixed
        times = [max(self.seconds_of_a_run(pair), 1e-9) for pair in pairs]
        seconds = self.seconds
        if workers > 1:
            # Towards the end the blocks become shorter, so that all workers end at the same time.
            seconds = min(seconds, max(seconds_left / (2 * workers) * max(times) / sum(times), LEAST))
        lengths = [seconds / max(times), *(self._bound(pair) for pair in pairs)]
        stop = first + max(1, math.floor(min(lengths)), min(map(self._least, pairs)))
        # Groups of runs whose moments are kept are whole in long blocks.
        return stop - stop % SIZE if stop - first >= SIZE else stop

    def _least(self, pair: Pair) -> int:
        """Return the number of runs below which a block is hardly faster, because its steps cost most of the time.

        Without it, blocks that take too long only because of their number of steps would shrink to single runs.
        """
        experiment = self._experiments[pair[0]]
        if has_own_code(experiment, experiment.method(pair[1])):
            return 1
        runs = OVERHEAD * experiment.n_steps / max(self._estimate(pair), 1e-9)
        return math.floor(min(runs, SIZE, MEGABYTES / max(megabytes_of_a_run(experiment), 1e-9)))

    def _bound(self, pair: Pair) -> float:
        """Return the largest number of runs that memory and experience allow."""
        memory = MEGABYTES / max(megabytes_of_a_run(self._experiments[pair[0]]), 1e-9)
        if pair in self._longest:
            return min(memory, GROWTH * self._longest[pair])
        return min(memory, FIRST / max(self.seconds_of_a_run(pair), 1e-9))

    def _estimate(self, pair: Pair) -> float:
        if pair not in self._estimated:
            self._estimated[pair] = estimated_seconds(self._experiments[pair[0]], pair[1])
        return self._estimated[pair]
