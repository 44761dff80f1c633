"""A configuration as a mapping: the same hash and bytes as a file, key paths in errors, classes, paths of files."""

import importlib
import os
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from small_experiment import text, write

import rmpc_bench
from rmpc_bench import load_config, publish, run, single_run
from rmpc_bench.config_file.mapping import canonical_text
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import parse
from rmpc_bench.received.archive import ArchiveError
from rmpc_bench.types import ConfigError

MODULE = """
def decay(t, x, u):
    return [-x[0] + u[0]]
"""
CELL = """
from rmpc_bench import Metric


class Cell(Metric):
    name = "cell"

    def evaluate(self, record):
        return record.y[:, 0, 0]
"""
FILES = ("trials.csv", "summary.csv", "comparisons.csv", "config.resolved.yaml")


def mapping(**keys):
    """The small experiment as plain data with some top-level keys replaced."""
    return {**plain(parse(text(), "tiny.yaml")), **keys}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_mapping_has_the_hash_and_the_bytes_of_a_file(here):
    of_file = run(write(here), directory="file", jobs=1)
    of_mapping = run(mapping(), directory="mapping", jobs=1)
    assert of_file.experiment.hash == of_mapping.experiment.hash
    for results in (of_file, of_mapping):
        publish(results)
    tables = [path.relative_to("file").as_posix() for path in Path("file", "tables").glob("*.tex")]
    assert tables
    for name in (*FILES, *tables):
        assert Path("file", name).exists() and Path("file", name).read_bytes() == Path("mapping", name).read_bytes()
    assert load_config("mapping/config.yaml").full_hash == load_config("tiny.yaml").full_hash


def test_a_file_may_extend_what_a_mapping_extends(here):
    write(here)
    config = load_config({"extends": "tiny.yaml", "name": "more", "methods": {"R-MPC": {"estimator": {"c": 0.2}}}})
    assert config.name == "more" and config.resolved["methods"]["R-MPC"]["estimator"]["c"] == 0.2


def test_values_of_numpy_tuples_and_paths(here):
    np.savez("system.npz", A=np.array([[0.9]]))
    given = {"runs": np.int64(3), "x": (np.float32(0.5), 1), "A": np.eye(2), "u": range(2), "file": Path("system.npz")}
    expected = "runs: 3\nx: [0.5, 1]\nA: [[1.0, 0.0], [0.0, 1.0]]\nu: [0, 1]\nfile: system.npz\n"
    assert canonical_text(given) == expected
    Path("y.csv").write_text("y\n0\n0.1\n0.2\n")
    silent = {
        "plant": {"data": Path("y.csv"), "columns": {"y": ("y",)}},
        "model": {"kind": "linear", "A": {"file": Path("system.npz")}, "C": np.eye(1), "P_w": 0.1, "P_v": 0.1},
        "methods": {"KF": {"estimator": {"kind": "kalman"}}},
    }
    head = {"version": 1, "name": "silent", "runs": 1, "time": {"step": 0.1, "steps": np.int32(2)}}
    config = load_config({**head, **silent, "initial": {"x_hat": 0, "P": 1}, "metrics": ["innovation_mse"]})
    assert config.resolved["model"]["A"] == [[0.9]] and config.resolved["plant"]["data"] == "y.csv"


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"runs": -1}, "runs: must be >= 1 (got -1)"),
        ({"metrics": ["mse", object()]}, "metrics.1: must be a number, a text, a list, a mapping or a class (got obj"),
        ({"methods": {"A": {"estimator": {"kind": "kalmann"}}}}, "methods.A.estimator.kind: 'kalmann' is not a known"),
        ({"methods": {"v1.2": {"label": 1j}}}, 'methods."v1.2".label: must be a number, a text'),
        ({"methods": {None: {}}}, "methods: a key must be text (got None)"),
        ({"metrics": [lambda record: 0.0]}, "metrics.0: "),
        ({"methods": {1: {}, "1": {}}}, "methods: two keys have the same text"),
        ({"title": "\ud800"}, "title: 'utf-8' codec can't encode character '\\ud800' in position 0: surrogates not"),
    ],
)
def test_errors_name_the_path_of_a_key(keys, message):
    with pytest.raises(ConfigError) as caught:
        load_config(mapping(**keys))
    lines = str(caught.value).splitlines()
    assert any(message in line for line in lines), lines
    assert all("(mapping)" not in line and ":1:" not in line for line in lines)


def test_a_mapping_that_contains_itself_is_refused():
    """At its first repetition: twice itself at each of 50 levels has no end.  One list at two places is no mistake."""
    given, endless = mapping(), [[]]
    given["plant"] |= {"again": given["plant"], "twice": given["plant"]}
    endless[0] += [endless, endless]
    with pytest.raises(ConfigError, match=r"(?s)plant.again: contains itself.*plant.twice: contains itself"):
        load_config(given)
    with pytest.raises(ConfigError, match=r"runs.0.1: contains itself"):
        load_config(mapping(runs=endless))
    deep = [1]
    for _ in range(51):
        deep = [deep]
    with pytest.raises(ConfigError, match="nested deeper than 50 levels"):
        load_config(mapping(runs=deep))
    both = [1.0, 2.0]
    assert canonical_text({"a": both, "b": both}) == "a: [1.0, 2.0]\nb: [1.0, 2.0]\n"


@single_run
class Damped:
    """Observer with a constant gain."""

    def __init__(self, model, gain: float = 0.4):
        self.model, self.gain = model, gain

    def start(self, x0):
        self.x_pred = x0

    def update(self, y, u_previous):
        return self.x_pred * (1 - self.gain)


def test_a_class_is_registered_under_its_qualified_name(here):
    kind = {"kind": Damped, "gain": np.float64(0.25)}
    config = load_config(mapping(methods={"KF": {"estimator": {"kind": "kalman"}}, "own": {"estimator": kind}}))
    resolved = config.resolved["methods"]["own"]["estimator"]
    assert (resolved["kind"], resolved["gain"]) == ("Damped", 0.25)
    assert run(config, directory="own", jobs=1).trials.methods == ("KF", "own")


def factory(gain):
    @single_run
    class Made:
        def __init__(self, model):
            self.model = model

        def update(self, y, u_previous):
            return gain * self.model.C.T @ y

    return Made


def test_two_classes_of_one_name_are_refused(here):
    methods = {name: {"estimator": {"kind": factory(gain)}} for name, gain in (("a", 0.1), ("b", 0.9))}
    with pytest.raises(
        ConfigError, match=r"^methods\.b\.estimator\.kind: another class .* register them under two names$"
    ):
        load_config(mapping(methods=methods))


def test_values_that_a_class_of_a_program_uses_are_a_part_of_its_identity(here, monkeypatch):
    """Otherwise a loop over them would find the trials of its first pass."""
    (here / "program.py").write_text(CELL)
    module = types.ModuleType("__main__")
    module.__file__ = str(here / "program.py")
    monkeypatch.setitem(sys.modules, "__main__", module)
    exec(CELL.replace("return ", "return GAIN * "), vars(module))
    found = []
    for module.GAIN in (1.0, 2.0, 1.0):
        results = run(mapping(metrics=["mse", {"kind": module.Cell}], runs=2), directory="kept", jobs=1)
        found.append(results.trials.frame["cell"].to_numpy())
    np.testing.assert_array_equal(found[1], 2.0 * found[0])
    np.testing.assert_array_equal(found[2], found[0])


def test_overrides_take_the_values_of_a_mapping(here):
    config = load_config(mapping(), overrides={"runs": np.int64(3), "statistics.confidence": np.float64(0.9)})
    assert config.experiment.n_runs == 3
    with pytest.raises(ConfigError, match="runs: must be a number, a text"):
        load_config(mapping(), overrides={"runs": object()})


def test_a_function_under_another_key_is_named_by_its_file(here, monkeypatch):
    (here / "decaying.py").write_text(MODULE)
    monkeypatch.syspath_prepend(here)
    module = importlib.import_module("decaying")
    assert parse(canonical_text({"plant": {"ode": module.decay}}), "")["plant"]["ode"] == f"{here}/decaying.py:decay"
    module.__name__ = module.decay.__module__ = "__main__"
    with pytest.raises(ConfigError, match=r"^plant\.ode: decay stands in no module .* give 'FILE.py:NAME'$"):
        canonical_text({"plant": {"ode": module.decay}})


@pytest.mark.parametrize("file", [None, "program.py"], ids=["notebook", "program"])
def test_pack_refuses_a_class_that_no_other_process_can_register(file, here, monkeypatch):
    module = types.ModuleType("__main__" if file else "notebook")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    if file:
        (here / file).write_text(CELL)
        module.__file__ = str(here / file)
    exec(CELL, vars(module))
    results = run(mapping(metrics=["mse", {"kind": module.Cell}], runs=2), directory="cell", jobs=1)
    publish(results)
    with pytest.raises(ArchiveError, match="metric 'Cell' stands in a program or a notebook"):
        rmpc_bench.pack("cell", "cell.zip")


def test_commands_name_the_directory_of_the_trials(here):
    """Also where the tables are written elsewhere; the file in the results is the same experiment."""
    results = run(mapping(runs=2), directory="kept", jobs=1)
    written = publish(results, to="paper")
    assert load_config("kept/config.yaml").hash == results.experiment.hash
    assert "rmpc-bench show kept --run" in written.summary() and "show paper" not in written.summary()


def test_trials_of_a_mapping_are_kept_in_a_temporary_store(here):
    first = run(mapping(runs=2), jobs=1)
    again = run(mapping(runs=4), jobs=1)
    assert not [*here.iterdir()]
    assert first.directory == again.directory and len(first.trials.runs) == 2 and len(again.trials.runs) == 4
    assert run(mapping(seed=8, runs=2), jobs=1).directory != first.directory


def test_the_current_directory_may_change_after_loading(here):
    (here / "elsewhere").mkdir()
    (here / "mine.py").write_text(
        "from rmpc_bench import single_run\n"
        "@single_run\nclass Law:\n    def __init__(self, K: float = 1.0):\n        self.K = K\n"
        "    def control(self, x_hat, r):\n        return self.K * r\n"
    )
    write(here, controller="{file: mine.py:Law}")
    config = load_config("tiny.yaml")
    tuned = "tune={budget: 2, runs: 2}", "methods.R-MPC.tune={estimator.c: [0.01, 1]}"
    searched = load_config("tiny.yaml", overrides=tuned)
    os.chdir("elsewhere")
    results = run(config, directory="here", jobs=1)
    assert results.directory == here / "elsewhere" / "here" == rmpc_bench.load_results("here").directory
    assert (results.directory / "config.yaml").read_text() == (here / "tiny.yaml").read_text()
    assert run(searched, directory="searched", jobs=1).tuning is not None
