"""Cost of the engines between blocks; nothing here asserts a time.

The budget of 600 blocks of one run of 10 ms on two workers is 1.1 times the ideal between the first and the last block,
and 5 s in all on a quiet machine.  A run waits in place of computing, so that other programs hardly matter.
"""

import time

import pytest
from small_experiment import write

from rmpc_bench import load_config
from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.choice import ComputeOptions
from rmpc_bench.execution.progress import Progress
from rmpc_bench.execution.runner import compute

pytestmark = pytest.mark.perf

RUNS, SECONDS, WORKERS = 600, 0.01, 2
OWN = """
import time
from rmpc_bench import single_run

@single_run
class Waiting:
    def __init__(self, model):
        self.nx = model.nx
    def start(self, x0):
        self.x_hat = x0
    def update(self, y, k):
        if k == 0:
            time.sleep(SECONDS)
        return self.x_hat
"""


class Times(Progress):
    """Keeps the times at which blocks were stored."""

    def __init__(self):
        self.seen, self.used = [], []

    def advance(self, n):
        """Note the time."""
        self.seen.append(time.monotonic())
        self.used.append(time.process_time())


@pytest.mark.parametrize("engine", ["joblib", "dask"])
def test_many_short_blocks(tmp_path, benchmark, monkeypatch, engine):
    """Time of the whole; the extra information has the ratio to the ideal between the first and the last block."""
    if engine == "dask":
        pytest.importorskip("distributed")
    (tmp_path / "own.py").write_text(OWN.replace("SECONDS", str(SECONDS)))
    keys = {"methods": "{A: {estimator: {file: own.py:Waiting}}}", "time": "{step: 0.1, steps: 1}"}
    config = load_config(write(tmp_path, **keys, runs=RUNS, execution="{block: 1}"))
    times, seconds, note = Times(), [], TaskQueue.note

    def noting(queue, done):
        seconds.append(done.seconds)
        note(queue, done)

    monkeypatch.setattr(TaskQueue, "note", noting)
    arguments = (config, tmp_path / "out")
    options = {"how": ComputeOptions(WORKERS, engine), "progress": times}
    benchmark.pedantic(compute, arguments, options, rounds=1)
    assert len(times.seen) == RUNS
    between = times.seen[-1] - times.seen[0]
    benchmark.extra_info["ideal [s]"] = SECONDS * (RUNS - 1) / WORKERS
    benchmark.extra_info["ratio to the ideal"] = between / (SECONDS * (RUNS - 1) / WORKERS)
    benchmark.extra_info["ratio to the time in the blocks"] = between / (sum(seconds[1:]) / WORKERS)
    benchmark.extra_info["processor time of this process per block [ms]"] = (
        1e3 * (times.used[-1] - times.used[0]) / RUNS
    )
    print({name: round(value, 3) for name, value in benchmark.extra_info.items()})
