"""`run` and `load_config` in a program: overrides, methods, workers, progress, and warnings of runs that failed."""

import os
import re
import warnings

import pytest
from own_experiment import CONFIG, write_own
from small_experiment import write

import rmpc_bench
from rmpc_bench.execution import run as module
from rmpc_bench.execution.progress import Bar, Plain, Progress


@pytest.fixture
def config(tmp_path):
    """Return a configuration of two methods and two runs."""
    return rmpc_bench.load_config(write(tmp_path), runs=2)


def test_one_text_is_one_override(tmp_path):
    """A mapping and a list of texts say the same; the hash is that of the command line."""
    path = write(tmp_path)
    given = ("runs=3", ["runs=3"], {"runs": 3}, ("runs=3",))
    loaded = [rmpc_bench.load_config(path, overrides=each) for each in given]
    assert [each.experiment.n_runs for each in loaded] == [3] * 4
    assert len({each.hash for each in loaded}) == 1
    nested = {"plant.perturb": {"J_l": "1 + 2*eps"}, "methods.S-MPC.label": "a: b"}
    texts = ["plant.perturb={J_l: 1 + 2*eps}", "methods.S-MPC.label='a: b'"]
    by_path, by_text = (rmpc_bench.load_config(path, overrides=each) for each in (nested, texts))
    assert by_path.hash == by_text.hash != rmpc_bench.load_config(path).hash


def test_one_text_is_one_added_method(tmp_path):
    """As the option of the command line."""
    made = rmpc_bench.load_config(write(tmp_path), add_methods="KF: {estimator: {kind: kalman}}")
    assert [*made.methods] == ["S-MPC", "R-MPC", "KF"]


def test_only_takes_whole_names(tmp_path, config):
    """One name, or a list; a part of a name is none."""
    for only, methods in (("R-MPC", ("R-MPC",)), (["S-MPC", "R-MPC"], ("S-MPC", "R-MPC"))):
        found = rmpc_bench.run(config, directory=tmp_path / f"{len(methods)}", jobs=1, only=only)
        assert found.trials.methods == methods
    with pytest.raises(ValueError, match="only: 'MPC' is not a known method; did you mean '.-MPC'"):
        rmpc_bench.run(config, directory=tmp_path / "none", jobs=1, only="MPC")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("jobs", ["auto", -1])
def test_all_cores(monkeypatch, jobs):
    """Those that this process may use."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 2, 5}, raising=False)
    assert module._workers(jobs) == 3
    assert module._workers(2) == 2 and module._workers(None) is None


def test_progress_is_a_function(tmp_path, config):
    """It gets finished trials, all trials and the name; what is stored already counts as finished."""
    calls = []
    for _ in range(2):
        rmpc_bench.run(config, directory=tmp_path / "out", jobs=1, progress=lambda *each: calls.append(each))
    assert calls[0] == (0, 4, "tiny") and calls[-1] == (4, 4, "tiny")
    assert [done for done, *_ in calls] == sorted(done for done, *_ in calls[:-1]) + [4]


@pytest.mark.parametrize(("given", "kind"), [(None, Progress), (False, Progress), (True, Plain)])
def test_progress_is_true_or_false(given, kind):
    """A bar on a terminal, lines elsewhere, or messages only."""
    assert type(module._display(given)) is kind
    display = Progress()
    assert module._display(display) is display


def test_progress_is_a_bar_on_a_terminal(monkeypatch):
    """As on the command line."""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert isinstance(module._display(True), Bar)


def test_a_file_is_a_configuration(tmp_path):
    """By its path, as text or not."""
    path = write(tmp_path, runs=2)
    for each in (path, str(path)):
        assert len(rmpc_bench.run(each, directory=tmp_path / "out", jobs=1).trials.runs) == 2


def test_failed_runs_are_warnings(tmp_path):
    """Crashes, held and failed steps and warnings of components: a warning each, with the call that shows a crash."""
    place, path = tmp_path / "out", write_own(tmp_path)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        rmpc_bench.run(path, directory=place, jobs=1)
    texts = [str(each.message) for each in found if each.category is RuntimeWarning]
    assert {each.filename for each in found} == {__file__}
    [crash] = [text for text in texts if "crashed" in text]
    call = f"rmpc_bench.replay({str(place)!r}, 2, 'raises')"
    assert crash == f"2 of 8 runs of 'raises' crashed: ValueError: negative level -1.0; {call} simulates run 2 again"
    again = eval(re.search(r"rmpc_bench\.replay\([^)]*\)", crash)[0])
    assert again.status == "crashed" and again.failure.message == "ValueError: negative level -1.0"
    for method in ("holds", "warns"):
        assert any(method in text for text in texts), texts
    assert not any("good" in text or "KF" in text for text in texts)


def test_runs_without_failures_warn_of_nothing(tmp_path):
    """Oracle: warnings are errors."""
    methods = "  KF: {estimator: {kind: kalman}}\n  good: {estimator: {file: mine.py:Filter}}\n"
    start, end = CONFIG.index("  KF:"), CONFIG.index("metrics:")
    path = write_own(tmp_path, config=CONFIG[:start] + methods + CONFIG[end:])
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        rmpc_bench.run(path, directory=tmp_path / "out", jobs=1)
