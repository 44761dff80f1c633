"""A pilot: the first runs of an experiment, computed and reported in a process of their own to measure time and memory.

Nothing of it is kept.  Time is that of all processors [s], which another program on the machine changes little.
"""

from __future__ import annotations

import json
import math
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.analysis.columns import Columns, rows_at, stacked
from rmpc_bench.engines.blocks import SECONDS, tuning_seconds
from rmpc_bench.simulation.ensemble import SIZE

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.results.results import Results


FIRST = 2
"""Runs of the first measurement, which has what is done once: imports, compiled kernels, tables of controllers."""
ENOUGH = 0.6
"""Time of the last runs of a pilot [s]; with less of it twice as many runs are added."""
BUDGET = 6.0
"""Time of all runs of a pilot [s], after which no more are added."""
LEAST_PARTS = 3
"""Groups of runs that a pilot computes one after the other, each larger than the one before."""
SMALLEST_SHARE = 0.2
"""Smallest share of the time of a group of runs that grows with their number."""
MOST_POINTS = 6
"""Points of a sweep that a pilot computes, spread evenly; the time of the others is that of these on average."""
REPORTED = 20_000
"""Most runs for which the report is made; of more runs the time of the report grows in proportion."""
WORKER = 1.2
"""Time of starting a worker process [s]."""


@dataclass(frozen=True)
class Pilot:
    """Measured time and memory of an experiment."""

    n_runs: int  # runs of the experiment
    n_pilot: int  # runs that were computed for the measurement
    # time until the first run: imports, design, compiled kernels, tables, and the estimated time of tuning [s]
    start: float
    per_run: float  # time of one run with all methods at all points [s]
    report: float  # time of tables, figures and claims of all runs [s]
    megabytes: float  # largest memory of the process [MB]

    @property
    def total(self) -> float:
        """Time of the whole experiment on one process [s]."""
        return self.start + self.n_runs * self.per_run + self.report

    def elapsed(self, workers: int) -> float:
        """Return the time that passes with so many processes that have a processor each [s]."""
        simulated = self.n_runs * self.per_run
        if workers > 1:
            simulated = min(simulated, simulated / workers + WORKER)
        return self.start + simulated + self.report

    def of_shard(self, shards: int) -> float:
        """Return the time that one of so many shards takes on one process [s]; it has no report."""
        return replace(self, n_runs=runs_of_shard(self.n_runs, shards), report=0.0).total


def runs_of_shard(n_runs: int, shards: int) -> int:
    """Return the number of runs of the largest shard: whole groups of 50 runs where there are enough of them.

    Examples
    --------
    >>> runs_of_shard(1000, 3), runs_of_shard(200, 7)
    (350, 29)
    """
    groups = math.ceil(n_runs / SIZE)
    return min(n_runs, math.ceil(groups / shards) * SIZE) if groups >= shards else math.ceil(n_runs / shards)


class PilotError(Exception):
    """A pilot that did not end."""


def measure(path: Path, allow_code: Sequence[Path] = (), modules: Sequence[str] = ()) -> Pilot:
    """Measure time and memory of an experiment in a process of its own; `PilotError` where it does not end well."""
    with TemporaryDirectory() as temporary:
        request, answer = Path(temporary) / "request.json", Path(temporary) / "answer.json"
        texts = {"path": str(path), "allow_code": [str(each) for each in allow_code], "modules": list(modules)}
        request.write_text(json.dumps(texts), encoding="utf-8")
        code = "from rmpc_bench.execution.pilot import answered; answered()"
        command = [sys.executable, "-P", "-c", code, str(request), str(answer)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode or not answer.exists():
            last = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
            raise PilotError(last[0])
        return Pilot(**json.loads(answer.read_text(encoding="utf-8")))


def answered() -> None:
    """Run a pilot and write what it measures; the files are the arguments of the process."""
    from importlib import import_module

    request = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    for name in request["modules"]:
        import_module(name)
    from rmpc_bench.config.load import load_config

    config = load_config(request["path"], allow_code=request["allow_code"])
    Path(sys.argv[2]).write_text(json.dumps(asdict(_measured(config))), encoding="utf-8")


def _measured(config: ExperimentConfig) -> Pilot:
    from rmpc_bench.publishing.publish import publish

    part = _points(config)
    scale = _n_methods(config) / max(1, _n_methods(part))
    n_runs = config.experiment.n_runs
    with TemporaryDirectory() as temporary:
        loaded = _cpu()
        first, per_run, n, results = _simulated(part, Path(temporary) / "pilot")
        before, published = _cpu(), min(n_runs, REPORTED)
        publish(enlarged(results, published), to=Path(temporary) / "report")
        report = (_cpu() - before) * n_runs / published
    memory = _megabytes() + _megabytes_of_rows(config, n_runs - published)
    start = loaded + max(0.0, first - min(FIRST, n_runs) * per_run)
    return Pilot(n_runs, n, start + tuning_seconds(config), per_run * scale, report * scale, memory)


def _simulated(config: ExperimentConfig, place: Path) -> tuple[float, float, int, Results]:
    """Compute more and more runs; return the time of the first call and of a run [s], their number, and results."""
    from rmpc_bench.engines.choice import ComputeOptions
    from rmpc_bench.execution.run import filled

    def computed(n: int) -> tuple[float, Results]:
        before = _cpu()
        found = filled(_with_runs(config, n), place, ComputeOptions(workers=1))
        return _cpu() - before, found

    n_runs = config.experiment.n_runs
    n = min(FIRST, n_runs)
    first, _ = computed(n)
    # The same without a run: what a call costs by itself.
    again, results = computed(n)
    parts: list[tuple[int, float]] = []
    while n < n_runs and not _is_enough(parts):
        new = min(n_runs, 3 * n + FIRST)
        took, results = computed(new)
        parts.append((new - n, max(1e-6, took - again)))
        n = new
    simulated = _extrapolated(parts, n_runs - n) if parts else max(0.0, first - again)
    return first, simulated / n_runs, n, results


def _is_enough(parts: Sequence[tuple[int, float]]) -> bool:
    """Whether the last parts of a pilot, runs and time [s] each, have taken long enough."""
    times = [time for _, time in parts]
    return len(parts) >= LEAST_PARTS and (times[-1] > ENOUGH or sum(times) > BUDGET) or sum(times) > 2 * BUDGET


def _extrapolated(parts: Sequence[tuple[int, float]], n_left: int) -> float:
    """Return the time of all runs [s]: that of the measured parts, and of the others from the last two of these.

    A block takes a time that does not depend on its runs, and a time per run.

    Examples
    --------
    >>> round(_extrapolated([(10, 1.0), (30, 2.0)], 0), 2), round(_extrapolated([(10, 1.0), (30, 2.0)], 10), 2)
    (3.0, 4.0)
    """
    n, time = parts[-1]
    earlier, before = parts[-2] if len(parts) > 1 else (0, 0.0)
    per_run = (time - before) / (n - earlier) if n > earlier else time / n
    per_run = min(max(per_run, SMALLEST_SHARE * time / n), time / n)
    n_blocks = math.ceil(n_left * per_run / SECONDS)
    return sum(each for _, each in parts) + n_left * per_run + n_blocks * (time - n * per_run)


def _cpu() -> float:
    """Return the time of this process and of those that it has waited for [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _megabytes() -> float:
    """Return the largest memory of this process [MB]; on Linux `getrusage` includes that of the one that started it."""
    if sys.platform == "linux":
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) * 1.024e-3
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3


def _megabytes_of_rows(config: ExperimentConfig, n_runs: int) -> float:
    """Return the memory of further rows, at their largest when the report is made [MB]."""
    numbers = len(config.experiment.metrics) + len(config.experiment.scenario.quantities) + 4
    return 8e-6 * 3 * numbers * n_runs * _n_methods(config)


def _n_methods(config: ExperimentConfig) -> int:
    """Count the methods at all points; what points share counts once."""
    return len({key for point in config.points for key in point.method_keys.values()})


def _points(config: ExperimentConfig) -> ExperimentConfig:
    """Return an experiment at some points of its sweep, without the claims, which may need the others."""
    n = len(config.points)
    if n <= MOST_POINTS:
        return config
    chosen = tuple(config.points[i * (n - 1) // (MOST_POINTS - 1)] for i in range(MOST_POINTS))
    return replace(config, points=chosen, claims=(), figures=())


def _with_runs(config: ExperimentConfig, n_runs: int) -> ExperimentConfig:
    """Return an experiment with so many runs, without what asks for more of them: a stopping rule and tuning."""
    # Tuning would load the experiment again at its full size, with the values that it has found.
    points = tuple(replace(point, experiment=replace(point.experiment, n_runs=n_runs)) for point in config.points)
    return replace(config, points=points, stop=None, tuning=None, origin=None)


def enlarged(results: Results, n_runs: int) -> Results:
    """Repeat the rows of the first runs up to a number of runs, to measure what a report of so many costs."""
    trials = results.stored
    n = max((len(table.runs) for table in trials.each), default=0)
    if not n or n >= n_runs:
        return results

    def repeated(table: Trials) -> Trials:
        columns = _sorted(_repeated(table.columns, n, n_runs), trials.methods, trials.paths)
        points = tuple(map(repeated, table.points))
        return replace(table, columns=columns, quantities=_repeated(table.quantities, n, n_runs), points=points)

    return replace(results, stored=repeated(trials), quantities=_repeated(results.quantities, n, n_runs))


def _repeated(columns: Columns, n: int, n_runs: int) -> Columns:
    """Put copies of a table with runs 0 to n - 1 below each other, with the next indices of runs."""
    if "run" not in columns:
        return columns
    table = stacked([{**columns, "run": columns["run"] + i * n} for i in range(math.ceil(n_runs / n))])
    return rows_at(table, table["run"] < n_runs)


def _sorted(columns: Columns, methods: Sequence[str], paths: Sequence[str]) -> Columns:
    """Sort rows by point, method and run, as `Trials` needs them."""
    order = [methods.index(name) for name in columns["method"]]
    points = [*zip(*(columns[path] for path in paths if path in columns), strict=True)] or [()] * len(order)
    number = {point: place for place, point in enumerate(dict.fromkeys(points))}
    return rows_at(columns, np.lexsort((columns["run"], order, [number[point] for point in points])))
