"""Imports and first calls of own components before any run: what a user sees, and what they leave behind."""

import os
import signal
import subprocess
import threading
import time

import forked_commands
import numpy as np
import pytest
from small_experiment import write

from rmpc_bench import load_config
from rmpc_bench.components import user_code
from rmpc_bench.types import ConfigError

FILTERS = '''
import functools
import os
import random
import sys
import time
import warnings
import numpy as np
from rmpc_bench import single_run, SolverError, Estimator


class Base:
    def start(self, x0):
        self.x = x0

    def update(self, y):
        return self.x


@single_run
class Good(Base):
    def update(self, y, k):
        # The true initial angle is 0.5 rad, so that y(0) of the nominal plant is not 0.
        assert k > 0 or y[0] == 0.5
        return self.x


@single_run
class Raises(Base):
    def update(self, y):
        raise ValueError("negative level")


@single_run
class Long(Base):
    def update(self, y):
        return np.zeros(3)


@single_run
class Later(Base):
    def update(self, y, k):
        return self.x if k == 0 else None


@single_run
class Exits(Base):
    def update(self, y):
        os._exit(3)


@single_run
class Endless(Base):
    def update(self, y):
        while True:
            time.sleep(0.01)


@single_run
class Catches(Base):
    def update(self, y):
        try:
            time.sleep(20.0)
        except BaseException:
            return self.x


@single_run
class Crashes(Base):
    def update(self, y):
        import ctypes
        return ctypes.string_at(0)


@single_run
class Untidy(Base):
    @classmethod
    def prepare(cls, model):
        warnings.warn("prepared")

    def update(self, y):
        print("printed", file=sys.stdout), print("printed", file=sys.stderr)
        random.random(), np.random.rand()
        os.chdir("/")
        np.einsum, os.environ["OMP_NUM_THREADS"] = functools.partial(np.einsum), "17"
        return self.x


@single_run
class Solver(Base):
    def update(self, y):
        raise SolverError("infeasible at the start", infeasible=True)


@single_run
class WithP(Base):
    def update(self, y, k):
        time.sleep(0.02 if k else 1.0)
        return self.x, np.eye(2)


class Batch(Estimator):
    """A batch class that divides by the number of runs at k = 1."""

    def __init__(self, model):
        self.model = model

    def init(self, n_runs):
        return np.zeros((n_runs, 2))

    def correct(self, k, state, y):
        return state, {}["k"] if k else state[:, : self.model.nx]

    def predict(self, k, state, u):
        return state
'''
LAWS = """
from rmpc_bench import single_run


@single_run
class Law:
    def control(self, x_hat):
        return x_hat
"""
LAST = 1 + next(i for i, line in enumerate(FILTERS.splitlines()) if '{}["k"]' in line)
SYSTEM = "kind: linear, A: [[1, 0.1], [0, 0.9]], B: [[0], [0.1]], C: [[1, 0]]"
LINEAR = {
    "plant": f"{{{SYSTEM}}}",
    "model": f"{{{SYSTEM}, P_w: 0.1, P_v: 0.1}}",
    "initial": "{x: [0.5, 0], x_hat: 0, P: process}",
    "reference": "{kind: constant, value: 1}",
    "uncertainty": None,
}
CASES = {
    "Good": "",
    "Solver": "",
    "Raises": "filters.py:31: ValueError: negative level",
    "Long": "update returned 3 numbers; the model has 2 states",
    "Later": "update returned nothing; the model has 2 states (k = 1)",
    "Batch": f"filters.py:{LAST}: KeyError: 'k'",
}
"""Class -> what is wrong with it."""


@pytest.fixture(scope="module")
def problems(tmp_path_factory):
    """Return the messages of one configuration with every class, by the path of the component."""
    directory = tmp_path_factory.mktemp("probe")
    (directory / "filters.py").write_text(FILTERS, encoding="utf-8")
    (directory / "laws.py").write_text(LAWS, encoding="utf-8")
    methods = [f"{name}: {{estimator: {{file: filters.py:{name}}}}}" for name in CASES]
    methods.append("Law: {estimator: {kind: kalman}, controller: {file: laws.py:Law}}")
    path = write(directory, **LINEAR, methods=f"{{{', '.join(methods)}}}")
    with pytest.raises(ConfigError) as error:
        load_config(path)
    return {each.path: each for each in error.value.problems}


def test_components_are_called_with_plausible_numbers(problems):
    """Oracle: the table; y(0) of the nominal plant at its initial state is not 0; an infeasible problem is no error."""
    expected = {f"methods.{name}.estimator": message for name, message in CASES.items() if message}
    expected["methods.Law.controller"] = "control returned 2 numbers; the model has 1 input (k = 0)"
    assert set(problems) == set(expected)
    for path, message in expected.items():
        assert problems[path].message.startswith(message), problems[path]
        assert problems[path].file.endswith("tiny.yaml") and problems[path].line == 12


def own(directory, name):
    """Write a configuration with a class of the file."""
    (directory / "filters.py").write_text(FILTERS, encoding="utf-8")
    return write(directory, **LINEAR, methods=f"{{M: {{estimator: {{file: filters.py:{name}}}}}}}")


@pytest.mark.parametrize("name", ["Endless", "Catches"])
def test_an_endless_first_call_is_a_warning(tmp_path, monkeypatch, name):
    """Oracle: the configuration loads soon after the limit, with a warning at the component."""
    monkeypatch.setattr(user_code, "LIMIT", 1.5)
    start = time.monotonic()
    config = load_config(own(tmp_path, name))
    # Half a minute is far below an endless loop, and far above the time of a busy machine.
    assert time.monotonic() - start < 30.0
    assert config.experiment.methods[0].estimator.cost_per_step == 3e-5
    (warning,) = [each for each in config.warnings if "first call" in each.message]
    assert warning.path == "methods.M.estimator"
    assert warning.message.startswith("its first call takes longer than 1.5 s")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import time\nwhile True: time.sleep(0.01)", "filters.py: its import takes longer than 1 s"),
        ("import time\ntry: time.sleep(9)\nexcept BaseException: pass", "filters.py: its import takes longer than 1 s"),
        ("1 / 0", "filters.py:1:1: ZeroDivisionError: division by zero"),
        ("raise SystemExit(3)", "filters.py:1:1: SystemExit: 3"),
        ("raise KeyboardInterrupt", "filters.py:1:1: KeyboardInterrupt"),
    ],
)
def test_an_import_that_does_not_end_well_is_a_problem(tmp_path, monkeypatch, text, message):
    """Oracle: the sentences; this process goes on."""
    monkeypatch.setattr(user_code, "LIMIT", 1.0)
    (tmp_path / "filters.py").write_text(f"{text}\n", encoding="utf-8")
    path = write(tmp_path, **LINEAR, methods="{M: {estimator: {file: filters.py:Any}}}")
    with pytest.raises(ConfigError) as error:
        load_config(path)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("text", "code"),
    [("import os; os._exit(7)", 7), ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL)],
)
def test_an_import_that_ends_the_process_ends_the_command(tmp_path, text, code):
    """Oracle: the exit code; the file was named before."""
    (tmp_path / "filters.py").write_text(f"{text}\n", encoding="utf-8")
    path = write(tmp_path, **LINEAR, methods="{M: {estimator: {file: filters.py:Any}}}")
    done = forked_commands.run(["check", path], tmp_path)
    assert done.returncode == code
    assert done.stderr.startswith("code  filters.py (sha ") and "Traceback" not in done.stderr


def test_a_first_call_that_exits_ends_the_command(tmp_path):
    """Oracle: its exit code."""
    assert forked_commands.run(["check", own(tmp_path, "Exits")], tmp_path).returncode == 3


def test_a_crash_of_a_first_call_says_where(tmp_path):
    """Oracle: the frame of the user's file after the signal."""
    done = forked_commands.run(["check", own(tmp_path, "Crashes")], tmp_path)
    assert done.returncode == -signal.SIGSEGV
    line = 1 + FILTERS.splitlines().index("        return ctypes.string_at(0)")
    assert "Segmentation fault" in done.stderr and f'filters.py", line {line} in update' in done.stderr


def test_ctrl_c_ends_an_import_and_the_next_one_works(tmp_path):
    """Trap: what was imported in part is taken for the whole file; a signal is taken for an exception of the file."""
    path = own(tmp_path, "Good")
    (tmp_path / "filters.py").write_text(f"{FILTERS}\nif not os.path.exists(__file__ + 'x'): time.sleep(20.0)\n")
    timer = threading.Timer(0.5, os.kill, [os.getpid(), signal.SIGINT])
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        load_config(path)
    timer.join()
    (tmp_path / "filters.pyx").touch()
    assert load_config(path).experiment.methods[0].name == "M"


def test_ctrl_c_ends_a_first_call(tmp_path):
    """Trap: it is taken for an exception of the component."""
    timer = threading.Timer(2.0, os.kill, [os.getpid(), signal.SIGINT])
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        load_config(own(tmp_path, "Endless"))
    timer.join()


def test_a_first_call_leaves_nothing_behind(tmp_path, monkeypatch, capfd):
    """Oracle: output, global generators, directory, NumPy and environment as without it; warnings come again."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    einsum, drawn = np.einsum, np.random.RandomState(1).rand()
    np.random.seed(1)  # noqa: NPY002
    config = load_config(own(tmp_path, "Untidy"))
    assert np.einsum is einsum and os.environ["OMP_NUM_THREADS"] == "1" and os.getcwd() == str(tmp_path)
    assert np.random.rand() == drawn  # noqa: NPY002
    assert "printed" not in "".join(capfd.readouterr())
    estimator = config.experiment.methods[0].estimator
    assert estimator._prepared is None and any("prepared" in text for text in estimator.remarks)


def test_loading_starts_no_process(tmp_path, monkeypatch):
    """Neither for built-in components nor for files of the user."""

    def fail(*arguments, **keywords):
        raise AssertionError("a process is started")

    for owner, name in ((subprocess.Popen, "__init__"), (os, "fork"), (os, "posix_spawn")):
        monkeypatch.setattr(owner, name, fail)
    load_config(write(tmp_path))
    load_config(own(tmp_path, "Good"))


@pytest.mark.parametrize(
    ("seconds", "used", "goes_on"),
    [
        # Of 10 s the machine gave 2 s, then 0.1 s of the next second.
        ([10.0, 11.0], [2.0, 2.1], True),
        ([10.0, 11.0], [9.5, 10.5], False),
        # It waits for the network or for a lock: more time would not help.
        ([10.0], [0.0], False),
        ([10.0, 11.0], [2.0, 2.0], False),
        ([10.0, 59.0], [2.0, 8.0], True),
        ([10.0, 60.5], [2.0, 9.0], False),
    ],
)
def test_a_busy_machine_gives_more_time(monkeypatch, seconds, used, goes_on):
    """Up to six times the limit for what computes and has had less than the limit of a processor."""
    now = {"monotonic": 0.0, "process_time": 0.0}
    for name in now:
        monkeypatch.setattr(user_code.time, name, lambda name=name: now[name])
    alarm, ended = user_code._Alarm(), False
    for now["monotonic"], now["process_time"] in zip(seconds, used, strict=True):
        try:
            alarm.ring(signal.SIGALRM, None)
        except user_code.TooLong:
            ended = True
    assert ended is not goes_on


@pytest.mark.parametrize(("module", "goes_on"), [("numba.core.compiler_machinery", True), ("filters", False)])
def test_compilation_by_numba_does_not_count(monkeypatch, module, goes_on):
    """The same 12 s of a processor, in a frame of numba's compiler and in one of the user."""
    now = {"monotonic": 0.0, "process_time": 0.0}
    for name in now:
        monkeypatch.setattr(user_code.time, name, lambda name=name: now[name])
    alarm, ended = user_code._Alarm(), False
    now["monotonic"] = now["process_time"] = 12.0
    found = {"__name__": module}
    exec("import sys\ndef frame(): return sys._getframe()", found)
    try:
        alarm.ring(signal.SIGALRM, found["frame"]())
        # What comes after it has a limit of its own.
        now["monotonic"] = now["process_time"] = 21.0
        alarm.ring(signal.SIGALRM, None)
    except user_code.TooLong:
        ended = True
    assert ended is not goes_on
    now["monotonic"] = now["process_time"] = 22.5
    with pytest.raises(user_code.TooLong):
        alarm.ring(signal.SIGALRM, None)


def test_the_timer_and_the_handler_of_the_program_come_back():
    """A program may use the alarm itself, as limits of tests do."""

    def handler(*given):
        raise AssertionError

    before = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 500.0)
        with user_code.limited():
            assert signal.getsignal(signal.SIGALRM) is not handler
        assert signal.getsignal(signal.SIGALRM) is handler
        assert 400.0 < signal.setitimer(signal.ITIMER_REAL, 0.0)[0] <= 500.0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_a_thread_has_no_limit():
    """Python runs handlers of signals in the main thread only."""
    done = []

    def work():
        with user_code.limited():
            done.append(True)

    thread = threading.Thread(target=work)
    thread.start(), thread.join()
    assert done == [True]


def test_metrics_and_times_use_the_first_call(tmp_path):
    """Oracle: `nees` needs P, which one class returns and the other does not."""
    (tmp_path / "filters.py").write_text(FILTERS, encoding="utf-8")
    keys = {**LINEAR, "metrics": "[nees]"}
    config = load_config(write(tmp_path, **keys, methods="{M: {estimator: {file: filters.py:WithP}}}"))
    # Its step sleeps for 20 ms, and the first one for a second.
    assert 0.02 <= config.experiment.methods[0].estimator.cost_per_step < 1.0
    with pytest.raises(ConfigError, match=r"metrics.0: needs the covariance P .* of .M. does not give"):
        load_config(write(tmp_path, **keys, methods="{M: {estimator: {file: filters.py:Good}}}"))
