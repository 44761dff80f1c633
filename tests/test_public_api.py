"""The names a Python program uses."""

import inspect
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from small_experiment import write

import rmpc_bench
from rmpc_bench import registry

ROOT = Path(__file__).parents[1]
RUN = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["pytest"]["ini_options"]["testpaths"]
"""Files and folders whose examples `make test` runs."""
PATH = f"import sys; sys.path.append({str(Path(rmpc_bench.__file__).parents[1])!r});"


@pytest.mark.parametrize("name", rmpc_bench._PUBLIC)
def test_every_public_name_has_an_example_that_runs(name):
    """`from rmpc_bench import name` works, and pytest collects the docstring."""
    public = getattr(rmpc_bench, name)
    file = Path(inspect.getsourcefile(public)).relative_to(ROOT)
    assert ">>> " in public.__doc__ and any(file.is_relative_to(place) for place in RUN)


def test_public_names_are_the_documented_ones():
    """Data, verbs, extension; `model` is there because noise sets cannot be given from Python without it."""
    assert set(rmpc_bench._PUBLIC) == {
        *("LinearModel", "Scenario", "Experiment", "Method", "Status", "Trials", "Results"),
        *("simulate", "run", "run_one", "filter_data", "merge", "replay", "load_config", "load_results", "load_trials"),
        *("summarise", "compare", "drivers", "requirements", "ranks", "tuning"),
        *("import_runs", "judge", "figure", "publish", "pack", "verify"),
        *("compare_results", "compare_improvements"),
        *("register", "plant", "model", "estimator", "controller"),
        *("single_run", "SolverError", "Estimator", "Controller", "Plant", "Metric", "Figure"),
    }
    assert dir(rmpc_bench) == sorted([*rmpc_bench._PUBLIC, "NUMERICS", "__version__"])


def test_an_unknown_name_is_an_attribute_error():
    """As of any module."""
    with pytest.raises(AttributeError, match="has no attribute 'simulat'"):
        _ = rmpc_bench.simulat


def test_importing_the_package_imports_nothing():
    """What is heavy is imported at its first use."""
    code = (
        "import sys; import rmpc_bench; assert rmpc_bench.__version__;"
        "print(*[name for name in sys.modules if name.split('.')[0] not in sys.stdlib_module_names])"
    )
    done = subprocess.run([sys.executable, "-I", "-S", "-c", PATH + code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) <= {"rmpc_bench", "__main__"}


def test_from_configuration_to_trials(tmp_path):
    """`run` returns the table of trials with what is needed to read it."""
    config = rmpc_bench.load_config(write(tmp_path))
    trials = rmpc_bench.run(config, directory=tmp_path / "out", jobs=1).trials
    assert isinstance(trials, rmpc_bench.Trials)
    assert trials.methods == ("S-MPC", "R-MPC") and trials.baseline == "S-MPC"
    assert [info.name for info in trials.metrics] == ["mse", "input_power"]
    assert len(trials.frame) == 12 and set(trials.frame["status"]) == {"ok"}
    assert trials.seed == 7 and trials.name == "tiny"
    assert {"P", "L"} <= set(trials.series["quantity"])


def test_what_run_leaves_can_be_loaded(tmp_path):
    """A directory filled through Python is a directory like any other."""
    trials = rmpc_bench.run(rmpc_bench.load_config(write(tmp_path)), directory=tmp_path / "out", jobs=1).trials
    again = rmpc_bench.load_trials(tmp_path / "out")
    assert again.frame.equals(trials.frame)


def test_summarise_is_a_table(tmp_path):
    """Its Markdown has a line per method in the table of each metric."""
    trials = rmpc_bench.run(rmpc_bench.load_config(write(tmp_path)), directory=tmp_path / "out", jobs=1).trials
    lines = rmpc_bench.summarise(trials).to_markdown().splitlines()
    assert [line for line in lines if line.startswith("## ")] == [
        "## mse [rad^2], lower is better",
        "## input_power [V^2], lower is better",
    ]
    assert sum(line.startswith("| R-MPC") for line in lines) == 2


def test_only_named_methods_are_computed(tmp_path):
    """The others are absent from the trials."""
    config = rmpc_bench.load_config(write(tmp_path))
    trials = rmpc_bench.run(config, directory=tmp_path / "out", jobs=1, only=["R-MPC"]).trials
    assert trials.methods == ("R-MPC",) and trials.baseline == "R-MPC"


def test_a_registered_estimator_is_usable_in_a_configuration(tmp_path, monkeypatch):
    """Its keywords are keys, with their checks and defaults."""
    monkeypatch.setattr(registry, "_REGISTERED", {group: {} for group in registry.BUILT_IN})
    asked = []

    def inflated(model, n_steps, *, x0, P0, factor: rmpc_bench.types.Positive = 1.0):
        """Kalman filter from an inflated start."""
        asked.append(factor)
        return rmpc_bench.estimator("kalman", model, n_steps, x0=x0, P0=factor * P0)

    rmpc_bench.register("estimator", "inflated", inflated)
    methods = "{S-MPC: {estimator: {kind: kalman}}, own: {estimator: {kind: inflated, factor: 2*2}}}"
    config = rmpc_bench.load_config(write(tmp_path, methods=methods))
    trials = rmpc_bench.run(config, directory=tmp_path / "out", jobs=1).trials
    assert asked == [4.0]
    values = [trials.column("mse", method) for method in trials.methods]
    assert not np.array_equal(*values)
    with pytest.raises(rmpc_bench.types.ConfigError, match=r"methods\.own\.estimator\.factor: must be > 0 \(got 0\)"):
        rmpc_bench.load_config(write(tmp_path, methods=methods.replace("2*2", "0")))


def test_a_single_filter_is_a_batch_of_one():
    """The example of house.md, section 11."""
    eye = np.eye(2)
    model = rmpc_bench.LinearModel(0.9 * eye, eye[:, :1], eye[:1], 0.1 * eye, eye[:1, :1])
    filter_ = rmpc_bench.estimator("kalman", model, n_steps=5, x0=np.zeros(2), P0=eye)
    state, estimate = filter_.correct(0, filter_.init(n_runs=1), np.array([1.0])[None])
    assert estimate.x_hat.shape == (1, 2) and estimate.status.tolist() == [rmpc_bench.Status.OK]


def test_no_public_name_is_that_of_a_submodule():
    """After the first import of such a submodule the attribute of the package would be the module."""
    directory = Path(rmpc_bench.__file__).parent
    modules = {path.stem for path in directory.glob("*.py")} | {
        path.name for path in directory.iterdir() if path.is_dir()
    }
    assert not modules & set(rmpc_bench._PUBLIC)
