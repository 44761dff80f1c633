"""First calls of own components before any run: in a process of their own, with a limit of time."""

import signal
import time

import pytest
from small_experiment import write

from rmpc_bench import load_config
from rmpc_bench.components import probe
from rmpc_bench.types import ConfigError

FILTERS = '''
import os
import time
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
    "Raises": "filters.py:27: ValueError: negative level",
    "Long": "update returned 3 numbers; the model has 2 states",
    "Later": "update returned nothing; the model has 2 states (k = 1)",
    "Exits": "its first call ends the process (exit code 3)",
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


def test_an_endless_first_call_is_a_warning(tmp_path, monkeypatch):
    """Oracle: the configuration loads soon after the limit, with a warning at the component."""
    monkeypatch.setattr(probe, "LIMIT", 1.5)
    (tmp_path / "filters.py").write_text(FILTERS, encoding="utf-8")
    path = write(tmp_path, **LINEAR, methods="{M: {estimator: {file: filters.py:Endless}}}")
    start = time.monotonic()
    config = load_config(path)
    # Half a minute is far below an endless loop, and far above the time of a busy machine.
    assert time.monotonic() - start < 30.0
    assert config.experiment.methods[0].estimator.cost_per_step == 3e-5
    (warning,) = [each for each in config.warnings if "first call" in each.message]
    assert warning.path == "methods.M.estimator"
    assert warning.message.startswith("its first call takes longer than 1.5 s")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import os; os._exit(7)", "filters.py: its import ends the process (exit code 7)"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "ends the process (signal SIGKILL)"),
        ("import time\nwhile True: time.sleep(0.01)", "filters.py: its import takes longer than 1 s"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("raise SystemExit(3)", "SystemExit: 3"),
    ],
)
def test_an_import_that_does_not_end_well_is_a_problem(tmp_path, monkeypatch, text, message):
    """Oracle: the sentences; this process goes on."""
    monkeypatch.setattr(probe, "LIMIT", 1.0)
    (tmp_path / "filters.py").write_text(f"{text}\n", encoding="utf-8")
    path = write(tmp_path, **LINEAR, methods="{M: {estimator: {file: filters.py:Any}}}")
    with pytest.raises(ConfigError) as error:
        load_config(path)
    assert message in str(error.value)


def test_the_process_is_started_again_where_it_was_ended():
    """Oracle: an answer after the process was killed from outside."""
    probe.close()
    assert probe.ask({"imports": __file__}).outcome == "done"
    probe._process[0].kill()
    assert probe.ask({"imports": __file__}).outcome == "done"


def test_an_interrupted_request_leaves_no_answer_behind(tmp_path, monkeypatch):
    """Trap: after Ctrl-C in a notebook the next request takes the answer of the one before for its own."""
    slow, ends = tmp_path / "slow.py", tmp_path / "ends.py"
    slow.write_text("import time\ntime.sleep(1.0)\n", encoding="utf-8")
    ends.write_text("import os; os._exit(4)\n", encoding="utf-8")
    assert probe.ask({"imports": __file__}).outcome == "done"
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        with pytest.raises(KeyboardInterrupt):
            probe.ask({"imports": str(slow)})
    finally:
        signal.signal(signal.SIGALRM, before)
    assert probe.ask({"imports": str(ends)}).outcome == "died"


def test_files_of_the_current_directory_replace_no_standard_modules(tmp_path, monkeypatch):
    """Trap: Python looks for `select` in the current directory first, which nobody has agreed to."""
    for name in ("select", "struct", "random"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('not this one')", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    probe.close()
    assert probe.ask({"imports": __file__}).outcome == "done"


def test_built_in_components_start_no_process(tmp_path):
    """Oracle: no process after loading a configuration without files."""
    probe.close()
    load_config(write(tmp_path))
    assert not probe._process


def test_metrics_and_times_use_the_first_call(tmp_path):
    """Oracle: `nees` needs P, which one class returns and the other does not."""
    (tmp_path / "filters.py").write_text(FILTERS, encoding="utf-8")
    keys = {**LINEAR, "metrics": "[nees]"}
    config = load_config(write(tmp_path, **keys, methods="{M: {estimator: {file: filters.py:WithP}}}"))
    # Its step sleeps for 20 ms, and the first one for a second.
    assert 0.02 <= config.experiment.methods[0].estimator.cost_per_step < 1.0
    with pytest.raises(ConfigError, match=r"metrics.0: needs the covariance P .* of .M. does not give"):
        load_config(write(tmp_path, **keys, methods="{M: {estimator: {file: filters.py:Good}}}"))
