"""The unit of work: one method over a range of runs."""

from __future__ import annotations

import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import PurePath
from typing import Any, NamedTuple, TextIO

import numpy as np

from rmpc_bench.components.code import CodeError
from rmpc_bench.components.recipes import inside, recipe_of
from rmpc_bench.components.untouched import untouched
from rmpc_bench.execution.sampled_values import Sampled
from rmpc_bench.simulation.checked_calls import is_own
from rmpc_bench.simulation.closed_loop import Block, simulate_block
from rmpc_bench.simulation.scenario import Draws, Experiment, own_draws
from rmpc_bench.types import NO_WATCH, Array, Method, Watch
from rmpc_bench.types.basics import Design


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
    uncertainty: Sampled
    seconds: float = 0.0
    """Time that the computation has taken [s]."""


def work(experiments: Sequence[Experiment], task: Task, watch: Watch = NO_WATCH) -> Done:
    """Do one task; what its components replace for others is put back, and fails the runs of a built-in method."""
    experiment = experiments[task.point]
    method = experiment.method(task.method)
    counts, started, own = Counter[str](), time.monotonic(), has_own_code(experiment, method)
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
    return Done(task, block, values, time.monotonic() - started)


def has_own_code(experiment: Experiment, method: Method) -> bool:
    """Whether a component that takes part in the runs of a method is not built in."""
    return not all(map(is_built_in, components_of(experiment, method)))


def is_built_in(part: Any) -> bool:
    """Whether a component runs no code but that of the bench."""
    return not is_own(part) and recipe_of(part) is None


def components_of(experiment: Experiment, *methods: Method) -> list[Any]:
    """Return everything whose code runs when methods are simulated."""
    scenario = experiment.scenario
    noises = (*scenario.x0_noise, *scenario.process, *scenario.measurement)
    pairs = [part for method in methods for part in (method.estimator, method.controller)]
    return [experiment.plant, *pairs, scenario.reference, *noises, *experiment.metrics]


def warm_up_own(experiments: Sequence[Experiment]) -> None:
    """Let components that are not built in prepare themselves, once in every process that simulates them."""
    parts = [part for experiment in experiments for part in components_of(experiment, *experiment.methods)]
    for part in {id(part): part for part in parts}.values():
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
