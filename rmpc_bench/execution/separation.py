"""Methods with different files of users are computed in different processes, and built-in ones without any such file.

The designs of built-in methods are made again in a new process, as this one has loaded the files of all methods.  What
all share (plant, noise, reference, metrics) is loaded everywhere: where it comes from a file, a trial of every built-in
method is compared with one in a process that has loaded nothing else.
"""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from subprocess import DEVNULL, PIPE, TimeoutExpired
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from rmpc_bench.child_process import end_with, signal_name, start
from rmpc_bench.components.consent import CodeAccess
from rmpc_bench.components.transport import dumps, loads
from rmpc_bench.config.build import build
from rmpc_bench.config.draft import Inherited
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.identity import SweepPoint
from rmpc_bench.config.left_out import fitting_metrics
from rmpc_bench.config.own_code import FirstCalls, OwnCode
from rmpc_bench.config.plugins import load_plugins
from rmpc_bench.config.sweep import SweptTree
from rmpc_bench.config.tune import Chosen
from rmpc_bench.config.validate import validate_sections
from rmpc_bench.config_file.tree import Items, Map
from rmpc_bench.engines.blocks import Pair
from rmpc_bench.engines.choice import groups_of
from rmpc_bench.engines.tasks import Task, is_built_in, work
from rmpc_bench.execution.progress import Progress, said_if_slow
from rmpc_bench.numerics.code_cache import cache_remark
from rmpc_bench.simulation.linear_loop import warm_up
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.store.store import Store
from rmpc_bench.types import ConfigError, Status
from rmpc_bench.types.errors import WorkerError

Trials: TypeAlias = Mapping[Pair, Mapping[str, float]]
"""Method -> metrics of a run."""
LONGEST = 3600.0
"""Time for the designs of all built-in methods, or for one trial of each, on a busy machine [s]."""
_ONLY = "a process with the built-in methods only"
TOLERANCE = 1e-9
"""Relative difference of a trial to a stored one of an earlier session, which may be of another machine or block."""
_WITHOUT = ("claims", "statistics", "stop", "report", "smoke")


class _Reduced(NamedTuple):
    """The built-in methods of a configuration before validation; a new process makes an experiment of it."""

    points: list[SweptTree]
    chosen: Chosen
    access: CodeAccess
    smoke: bool
    is_shared: bool  # whether what all methods share comes from files, which may be those under `plugins`

    def made(self) -> list[SweepPoint]:
        """Build all points; a metric that needs a method with files of the user is left out."""
        if self.is_shared:
            load_plugins(self.points[0].tree, self.access)
        drafts = validate_sections(self.points, runs=None, smoke=False, access=self.access, chosen=self.chosen)
        calls = FirstCalls(left_out=True)
        found = [each.point for each in build(drafts, OwnCode(self.access), smoke=self.smoke, calls=calls)]
        if None in found:
            every = Inherited(Path(), is_changed=True)
            trees = [fitting_metrics(draft.tree, draft.problems, every)[0] for draft in drafts]
            points = [point._replace(tree=tree) for point, tree in zip(self.points, trees, strict=True)]
            drafts = validate_sections(points, runs=None, smoke=False, access=self.access, chosen=self.chosen)
            found = [each.point for each in build(drafts, OwnCode(self.access), smoke=self.smoke, calls=calls)]
        problems = [str(problem) for draft in drafts for problem in draft.problems]
        if None in found:
            raise WorkerError("; ".join(problems))
        return [point for point in found if point is not None]


def separated(
    config: ExperimentConfig, methods: Collection[str], progress: Progress, run: int = 0
) -> tuple[ExperimentConfig, dict[Pair, Mapping[str, float]]]:
    """Return a configuration whose built-in methods were designed without the files of the others, and trials to check.

    These are the metrics of a run of every built-in method, computed where only what all methods share was loaded.
    A WorkerError says that they are other methods there, or that their designs end the process.
    """
    groups, shared = groups_of(config.points), shared_of(config.points)
    pairs = groups.pop((), set())
    if not pairs or not (groups or shared):
        return config, {}
    with said_if_slow(progress, "Preparing built-in methods in a process without the files of the others ...", 5.0):
        answer = _asked(config.points, pairs, methods, range(run, run + 1), run)
    if isinstance(answer, str):
        components = f" and {' and '.join(shared)}" if shared else ""
        progress.say(f"built-in methods{components} cannot be separated from the other components: {answer}")
        return config, {}
    points, (keys, data, trials) = [*config.points], answer
    for number, found, clean in zip(_numbers(pairs), keys, loads(data), strict=True):
        point, names = points[number], {name for at, name in pairs if at == number}
        if other := [name for name in names if found[name] != point.method_keys[name]]:
            raise WorkerError(f"{other[0]} is another method without the files of others, which change the bench")
        both = tuple(clean.method(each.name) if each.name in names else each for each in point.experiment.methods)
        common = {"plant": clean.plant, "scenario": clean.scenario, "state_range": clean.state_range}
        points[number] = replace(point, experiment=replace(point.experiment, methods=both, **common))
    return replace(config, points=tuple(points)), trials


def _numbers(pairs: set[Pair]) -> list[int]:
    return sorted({number for number, _ in pairs})


def _asked(points: Sequence[SweepPoint], pairs: set[Pair], methods: Collection[str], runs: range, run: int) -> Any:
    """Return what `_remade` returns in a new process for a run in a block; text where methods cannot be built."""
    numbers = _numbers(pairs)
    drafts = [draft for number in numbers if (draft := points[number].draft) is not None]
    trees = [_tree(points[number], {name for at, name in pairs if at == number}) for number in numbers]
    chosen = {(draft.title, name): values for draft in drafts for name, values in draft.chosen.items()}
    access = replace(drafts[0].access, _loaded={})
    is_shared = bool(shared_of(points))
    reduced = _Reduced(trees, chosen, access, points[0].experiment.cut_windows, is_shared)
    ordered = [(numbers.index(number), name) for number, name in sorted(pairs) if name in methods]
    tasks = [Task(name, runs.start, runs.stop, place) for place, name in ordered]
    return _in_a_new_process((_remade, reduced, tasks, numbers, run))


def _in_a_new_process(call: tuple[Any, ...]) -> Any:
    """Call a function with arguments in a process that has loaded no file of a user.

    A ConfigError or WorkerError there is the answer, as text.  Any other exception is a WorkerError with its traceback.
    """
    # Ctrl-C in a terminal reaches every process of the group; only this one handles it.
    process = start(__name__, PIPE, PIPE, DEVNULL, given={"parent": os.getpid()}, session=True)
    with process:
        try:
            answer, _ = process.communicate(dumps(call), LONGEST)
        except TimeoutExpired:
            raise WorkerError(f"{_ONLY}: timeout") from None
        finally:
            process.kill()
    code = process.returncode
    if not answer:
        how = f"signal {signal_name(-code)}" if code < 0 else f"exit code {code}"
        raise WorkerError(f"{_ONLY}: died {how}")
    found, failed = pickle.loads(answer)
    if failed:
        raise WorkerError(f"{_ONLY}: failed\n{failed}")
    return found


def main(parent: int) -> None:
    """Answer the one request of `_in_a_new_process` from standard input."""
    end_with(parent)
    call = sys.stdin.buffer.read()
    # What code of the user prints must not get into the answer.
    answers, nowhere = os.fdopen(os.dup(1), "wb"), os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1):
        os.dup2(nowhere, descriptor)
    try:
        function, *arguments = loads(call)
        answer = pickle.dumps((function(*arguments), ""))
    except (ConfigError, WorkerError) as error:
        # What cannot be made here.
        answer = pickle.dumps((str(error), ""))
    except Exception:
        # A mistake of the bench or of a file: without a word the methods would be computed unseparated.
        answer = pickle.dumps((None, traceback.format_exc()))
    answers.write(answer)
    answers.flush()
    # Without the exit handlers of the user's libraries, which belong to a process that ends by itself.
    os._exit(0)


def _tree(point: SweepPoint, names: set[str]) -> SweptTree:
    """Return what a point was made from, with some of its methods and the size that it has now."""
    assert point.draft is not None
    tree, mark = point.draft.tree.copy(), point.draft.tree.mark
    for key in _WITHOUT:
        tree.pop(key, None)
    time, opponent = point.draft.time, point.experiment.plant.opponent
    length = {"duration": time.duration} if time.duration is not None else {"steps": time.steps}
    wanted = names | (set() if opponent is None else {opponent[0]})
    methods = Map({name: own for name, own in tree["methods"].items() if name in wanted}, mark=mark)
    changed = {"methods": methods, "figures": Items(mark=mark), "runs": point.draft.keys.runs}
    for key, value in {**changed, "time": Map({"step": time.step, **length}, mark=mark)}.items():
        tree.put(key, value, mark, mark)
    return SweptTree(dict(point.coordinates), tree, point.title)


def _remade(
    reduced: _Reduced, tasks: list[Task], numbers: list[int], run: int
) -> tuple[list[Mapping[str, str]], bytes, Trials]:
    """Return the keys of the methods of every point, the experiments as bytes with designs finished, and trials."""
    points = reduced.made()
    experiments, trials = [point.experiment for point in points], dict[Pair, dict[str, float]]()
    warm_up_tasks(experiments, tasks, Progress())
    data = dumps(experiments)
    first = {task.method: task for task in reversed(tasks)} if reduced.is_shared else {}
    with single_thread():
        for task in first.values():
            experiment, method = experiments[task.point], experiments[task.point].method(task.method)
            if all(design.deterministic for design in (experiment.plant, method.estimator, method.controller)):
                try:
                    found = [float(row[run - task.first]) for row in work(experiments, task).block.metrics]
                except Exception:
                    # A stored run that ends well differs from one that fails here.
                    found = [np.nan] * len(experiment.metrics)
                names = [metric.name for metric in experiment.metrics]
                trials[numbers[task.point], task.method] = dict(zip(names, found, strict=True))
    return [point.method_keys for point in points], data, trials


def shared_of(points: Sequence[SweepPoint]) -> list[str]:
    """Name what all methods share and what does not come from the bench, such as ``plant tanks.py:rhs``."""
    found: dict[str, None] = {}
    for draft in (point.draft for point in points if point.draft is not None):
        for each in (draft.plant, draft.reference, draft.input, *draft.laws, *draft.metrics):
            if each is not None and not each.is_built_in:
                named = ", ".join(reference.text for reference in each.references())
                found[f"{each.group.removesuffix('s')} {named or each.kind}"] = None
    return [*found]


def check_shared(
    config: ExperimentConfig, store: Store, trials: Trials, blocks: Mapping[Pair, range], run: int
) -> None:
    """Compare stored trials of built-in methods with those of `separated`: the bits, where their blocks are known.

    A run alone may have other last bits than in a block, so it is then computed again with the others of its block.
    A WorkerError names the components from files that all methods share, and the method.
    """
    for pair, alone in trials.items():
        (number, name), values = pair, alone
        point, key = config.points[number], config.points[number].method_keys[name]
        runs, status = store.statuses(key, run + 1)
        if run not in runs[status == Status.OK] or run not in store.finished(key, point.metric_keys.values()):
            continue
        stored = {metric: float(store.values(key, point.metric_keys[metric], [run])[0]) for metric in alone}
        block = blocks.get(pair, range(0))
        tolerance = 0.0 if run in block else TOLERANCE
        if _different(alone, stored, tolerance) and not _different(alone, stored, TOLERANCE):
            answer = _asked(config.points, {pair}, [name], block, run)
            if isinstance(answer, str):
                raise WorkerError(f"{store.directory}: run {run} of {name} cannot be computed again: {answer}")
            values = answer[2][pair]
        for metric in _different(values, stored, tolerance):
            shared = " and ".join(shared_of(config.points))
            raise WorkerError(
                f"{store.directory}: do not use these results.  Run {run} of the built-in method {name} has "
                f"{metric} = {values[metric]!r} instead of {stored[metric]!r} where only {shared} was loaded: it "
                "changes other components, or keeps something from run to run; correct it, then run --fresh"
            )


def _different(values: Mapping[str, float], others: Mapping[str, float], tolerance: float) -> list[str]:
    """Name the metrics that differ by more than a relative tolerance."""
    pairs = ((name, value, others[name]) for name, value in values.items())
    return [name for name, a, b in pairs if not np.isclose(a, b, rtol=tolerance, atol=0.0, equal_nan=True)]


def warm_up_tasks(experiments: Sequence[Experiment], tasks: Sequence[Task], progress: Progress) -> None:
    """Compile, and finish the designs of the methods, once in this process and before any worker starts."""
    plants = {type(plant): plant for plant in (experiment.plant for experiment in experiments) if is_built_in(plant)}
    for plant in plants.values():
        with said_if_slow(progress, "Compiling (first run only) ..."):
            plant.warm_up()
    wanted = sorted({(task.point, task.method) for task in tasks})
    with said_if_slow(progress, "Compiling (first run only) ..."):
        for point, name in wanted:
            warm_up(experiments[point], experiments[point].method(name))
    methods = [experiments[point].method(name) for point, name in wanted]
    designs = [design for method in methods for design in (method.estimator, method.controller) if is_built_in(design)]
    text = "Preparing estimators and control laws (compiling on the first run only) ..."
    with said_if_slow(progress, text), single_thread():
        for design in {id(design): design for design in designs}.values():
            design.warm_up()
    if cache_remark():
        progress.say(cache_remark())
