"""Components that end their process, never return or use too much memory: they cost their own runs."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from engines import misbehaving
from engines.misbehaving import BAD, do_nothing, experiment, tasks_of
from engines.test_contained import stored, stores
from small_experiment import cli, write

from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.choice import serial
from rmpc_bench.engines.pool import processes
from rmpc_bench.engines.watch import Limits
from rmpc_bench.store.store import Store
from rmpc_bench.types.errors import WorkerError

N_RUNS = 30
STEP = "a step took longer than 1 s (execution.timeout.step)"
ENDS = {
    "exit_at_once": ("crashed", "the worker process ended with exit code 3"),
    "kill_itself": ("crashed", "the worker process was ended by SIGKILL"),
    "fault": ("crashed", "the worker process was ended by SIGSEGV"),
    "sleep": ("timeout", STEP),
    "loop": ("timeout", STEP),
    "loop_that_catches_all": ("timeout", STEP),
    "loop_in_compiled_code": ("timeout", STEP),
    "fill_memory": ("crashed", "MemoryError: Unable to allocate 3.73 GiB for an array"),
    "raise_value_error": ("crashed", "ValueError: negative level"),
    "exit_by_sys": ("crashed", "SystemExit: 0"),
    "interrupt": ("crashed", "KeyboardInterrupt"),
    "fail_to_open": ("crashed", "FileNotFoundError: "),
    "return_wide": ("crashed", "correct returned x_hat as an array"),
    "return_bad_status": ("crashed", "correct returned the status 77"),
}
"""What a component does -> status and begin of the message."""
WITH_ONE = ("exit_at_once", "loop_in_compiled_code", "fill_memory", "return_bad_status")
"""Those that are also tried with one worker, in one block of all runs."""
LIMITS = Limits(step=1.0, memory=1_000_000_000, memory_text="1 GB")
CASES = [(2, 4, act) for act in ENDS] + [(1, 50, act) for act in WITH_ONE]


@pytest.fixture(scope="module")
def store_of(tmp_path_factory):
    """Compute with so many workers, in blocks of so many runs."""

    def compute(made, workers, block):
        return processes([made], TaskQueue(tasks_of(made, block)), workers, LIMITS)

    with stores(compute, N_RUNS, tmp_path_factory) as found:
        yield found


@pytest.mark.parametrize(("workers", "block", "act"), CASES)
def test_only_the_bad_runs_fail(store_of, workers, block, act):
    """The other runs have the numbers of the same estimator without the misbehaviour, bit for bit."""
    store, (status, message) = store_of(act, workers, block), ENDS[act]
    (runs, words), (_, fine) = store.column(act, N_RUNS), store.column("do_nothing", N_RUNS)
    assert fine == ["ok"] * N_RUNS
    assert words == [status if run in BAD else "ok" for run in runs]
    good = [run for run in runs if run not in BAD]
    np.testing.assert_array_equal(store.values(act, "mse", good), store.values("do_nothing", "mse", good))
    for signal_name in ("y", "x_hat"):
        recorded, traces = store.traces(act, signal_name, N_RUNS)
        assert recorded == good
        np.testing.assert_array_equal(traces, store.traces("do_nothing", signal_name, N_RUNS)[1][recorded])
    failures = store.failures(act, N_RUNS)
    assert [failure.run for failure in failures] == [*BAD]
    assert {failure.k for failure in failures} == {misbehaving.K_BAD}
    assert all(failure.message.startswith(message) for failure in failures)
    assert store.finished(act, ["mse"], misbehaving.RECORDING, N_RUNS).tolist() == [*range(N_RUNS)]


@pytest.mark.long
@pytest.mark.parametrize(("workers", "block", "acts"), [(2, 4, [*ENDS]), (1, 50, WITH_ONE)])
def test_misbehaviours_of_one_experiment_cost_their_own_runs(tmp_path, workers, block, acts):
    """Worker processes are shared by all of them."""
    made = experiment([getattr(misbehaving, act) for act in ("do_nothing", *acts)], N_RUNS)
    with stored(made, processes([made], TaskQueue(tasks_of(made, block)), workers, LIMITS), tmp_path) as store:
        assert store.column("do_nothing", N_RUNS)[1] == ["ok"] * N_RUNS
        for act in acts:
            runs, words = store.column(act, N_RUNS)
            assert words == [ENDS[act][0] if run in BAD else "ok" for run in runs]
            good = [run for run in runs if run not in BAD]
            np.testing.assert_array_equal(store.values(act, "mse", good), store.values("do_nothing", "mse", good))


@pytest.mark.parametrize("act", ["fault", "sleep", "loop_in_compiled_code", "fill_memory"])
@pytest.mark.long
def test_the_frames_of_the_component_are_stored(store_of, act):
    """Also where the process ends inside compiled code."""
    for failure in store_of(act, 2, 4).failures(act, N_RUNS):
        assert f"in {act}" in failure.trace and "closed_loop" not in failure.trace


@pytest.mark.parametrize(("workers", "block"), [(2, 4), (1, 50)])
def test_the_workers_have_the_results_of_this_process(store_of, workers, block):
    """Oracle: the same methods in this process."""
    here = experiment([do_nothing], N_RUNS)
    values = np.concatenate([done.block.metrics[0] for done in serial([here], TaskQueue(tasks_of(here, 9)))])
    found = store_of("exit_at_once", workers, block).values("do_nothing", "mse", range(N_RUNS))
    np.testing.assert_array_equal(found, values)


OWN = """
import os, time
from rmpc_bench import single_run

@single_run
class Own:
    def __init__(self, model, act="none"):
        self.nx, self.act = model.nx, act
    def start(self, x0, run):
        self.x_hat, self.run = x0, run
    def update(self, y, k):
        if k == 2 and self.run in (7, 23):
            print("output of run", self.run)
            if self.act == "exit":
                os._exit(5)
            if self.act == "sleep":
                time.sleep(1000)
            if self.act == "fork":
                os.fork()
            if self.act == "catch":
                try:
                    time.sleep(1000)
                except BaseException:
                    return 0 * self.x_hat
            if self.act == "raise":
                raise OSError("no licence")
        return self.x_hat
"""


@pytest.fixture(scope="module")
def ran_file(tmp_path_factory):
    """Run an experiment of 200 runs whose estimators come from a file, with one worker."""
    directory = tmp_path_factory.mktemp("file")
    (directory / "own.py").write_text(OWN, encoding="utf-8")
    methods = ", ".join(f"{act}: {{estimator: {{file: own.py:Own, act: {act}}}}}" for act in ("none", "exit", "raise"))
    path = write(directory, methods=f"{{{methods}}}", runs=200, time="{step: 0.1, steps: 5}")
    return path, directory / "out", cli("run", path, "-o", directory / "out", "-j", 1, "--progress", "none")


@pytest.mark.long
def test_exit_codes_and_other_rows_of_a_component_from_a_file(ran_file):
    """198 of 200 runs are as without the misbehaviour; `max_failures` decides about the exit code."""
    path, out, result = ran_file
    assert result.exit_code == 3, result.output
    assert "please report" not in result.output and "cannot be written" not in result.output
    rows = [line.split(",") for line in (out / "trials.csv").read_text().splitlines()[1:]]
    by_method = {act: [row[1:] for row in rows if row[0] == act] for act in ("none", "exit", "raise")}
    good = [row for row in by_method["none"] if int(row[0]) not in BAD]
    for act in ("exit", "raise"):
        assert [row for row in by_method[act] if int(row[0]) not in BAD] == good and len(good) == 198
        assert [row[1] for row in by_method[act] if int(row[0]) in BAD] == ["crashed"] * 2
    again = cli("run", path, "-o", out, "-j", 1, "--progress", "none", "-s", "execution.max_failures=4")
    assert again.exit_code == 0, again.output


def test_output_of_components_goes_to_a_file(ran_file):
    """And not between the lines of the summary."""
    _, out, result = ran_file
    assert "output of run" not in result.output
    assert "output of run 7" in (out / "logs" / "worker-1.txt").read_text(encoding="utf-8")


def test_a_component_that_catches_the_end_of_its_time(tmp_path):
    """The run has timed out, although the component returned an estimate: when it does depends on the machine."""
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    methods = ", ".join(f"{act}: {{estimator: {{file: own.py:Own, act: {act}}}}}" for act in ("none", "fork", "catch"))
    path = write(tmp_path, methods=f"{{{methods}}}", runs=9)
    limit = "execution={timeout: {step: 0.2 s}}"
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none", "-s", limit)
    assert result.exit_code == 3, result.output
    rows = [line.split(",") for line in (tmp_path / "out" / "trials.csv").read_text().splitlines()[1:]]
    assert [row[:2] for row in rows if row[2] != "ok"] == [["catch", "7"]], rows
    assert [row[2] for row in rows if row[:2] == ["catch", "7"]] == ["timeout"]
    # A component may also leave a copy of the worker process behind.
    of = {act: [row[1:] for row in rows if row[0] == act] for act in ("none", "fork")}
    assert of["fork"] == of["none"]


def test_the_serial_engine_warns(tmp_path):
    """It contains exceptions, and says what it does not contain."""
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    path = write(tmp_path, methods="{A: {estimator: {file: own.py:Own, act: raise}}}", runs=9)
    result = cli("run", path, "-o", tmp_path / "out", "--engine", "serial", "--progress", "none")
    assert result.exit_code == 3, result.output
    assert "engine serial: a component that ends its process" in result.stderr
    with Store(tmp_path / "out", writable=False) as store:
        ((method,),) = store.file.read("SELECT DISTINCT key FROM failures JOIN keys ON number = method")
        assert [(each.run, each.message) for each in store.failures(method, 9)] == [(7, "OSError: no licence")]


class Stuck(misbehaving.Misbehaving):
    """Cannot be made in a worker."""

    def __reduce__(self):
        """Fail when it is loaded."""
        return int, ("no number",)


def test_an_experiment_that_a_worker_cannot_load():
    """One error with the reason, not a run after run that fails."""
    made = experiment([do_nothing], 4)
    broken = made.methods[0]._replace(estimator=Stuck(do_nothing))
    object.__setattr__(made, "methods", (broken,))
    with pytest.raises(WorkerError, match="cannot load the experiment: .*invalid literal"):
        list(processes([made], TaskQueue(tasks_of(made, 4)), 1))


def test_a_limit_of_memory_that_leaves_nothing():
    """It is refused, with the least one that would do."""
    made = experiment([do_nothing], 4)
    with pytest.raises(WorkerError, match=r"execution.memory is 20 MB; a worker process needs \d+ MB at least"):
        list(processes([made], TaskQueue(tasks_of(made, 4)), 1, Limits(memory=20_000_000, memory_text="20 MB")))


@pytest.mark.kill
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)])
def test_an_interruption_while_a_worker_hangs(tmp_path, number, code):
    """It ends at once, and no process stays."""
    (tmp_path / "own.py").write_text(OWN.replace("1000", "1000 if not print('hangs', flush=True) else 0"))
    path = write(tmp_path, methods="{A: {estimator: {file: own.py:Own, act: sleep}}}", runs=9)
    command = [Path(sys.executable).with_name("rmpc-bench"), "run", path, "-o", tmp_path / "out", "-j", "1"]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True)
    log, deadline = tmp_path / "out" / "logs" / "worker-1.txt", time.monotonic() + 60.0
    try:
        while time.monotonic() < deadline and not (log.exists() and "hangs" in log.read_text()):
            time.sleep(0.05)
        process.send_signal(number)
        _, err = process.communicate(timeout=30)
        assert process.returncode == code, err
        with pytest.raises(ProcessLookupError):
            for _ in range(100):
                os.killpg(process.pid, 0)
                time.sleep(0.05)
    finally:
        # The worker ends when its parent has been killed.
        process.kill()
