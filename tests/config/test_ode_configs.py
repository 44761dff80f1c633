"""Configurations with a differential equation: names, units, bounds, and what the screen and the results say."""

import csv
import json
import shutil
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from plants import tanks
from small_experiment import cli

from rmpc_bench import load_config, load_trials
from rmpc_bench.types import ConfigError

PLANT = """
  ode: tanks.py:rhs
  output: tanks.py:output
  states: {h1: m, h2: m}
  inputs: {pump: ml/s}
  outputs: {level: m}
  parameters: {a1: 7.1e-6, a2: 6.3e-6, k: 1}
"""
TEXT = """
version: 1
name: tanks
runs: 6
time: {{step: 5, duration: 100}}
uncertainty: {{eps: +-15%}}
plant:{plant}  bounds: {bounds}
  diverged: {diverged}
  perturb: {{a1: 1 + eps}}
model: {{linearise: plant, at: {{u: 8, guess: 0.1}}, noise: {{process: 4.0e-6, measurement: 4.0e-6}}}}
noise: {{process: {{gaussian: {{std: 1.0e-4}}}}, measurement: {{gaussian: {{std: 2.0e-3}}}}}}
initial: {{x: {x}, x_hat: [0.0647, 0.0822], P: 1.0e-4}}
reference: {{kind: constant, value: {r}}}
methods: {{KF: {{estimator: {{kind: kalman}}, controller: {{kind: mpc, Hp: 10, Hu: 3, Q: 1.0e+4, R: 0.001}}}}}}
metrics: [estimation_mse]
figures: [{{kind: signals, signals: [y, u, x.0]}}]
record: {{runs: 2, signals: [y, u, x]}}
"""
METHODS = next(
    line + "\n"
    for line in TEXT.format_map(dict.fromkeys(("plant", "bounds", "diverged", "x", "r"), "")).splitlines()
    if line.startswith("methods:")
)
USUAL = {
    "plant": PLANT, "bounds": "{h1: [0.0001 m, 0.6 m], pump: [0, 30 ml/s]}", "diverged": "{h2: 4}",
    "x": "[0.0647 m, 0.0822]", "r": 0.15,
}  # fmt: skip


def written(folder, **keys):
    """File of the experiment, beside the functions of its plant."""
    shutil.copy(Path(tanks.__file__), folder / "tanks.py")
    path = folder / "tanks.yaml"
    path.write_text(TEXT.format(**{**USUAL, **keys}), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Directory of a finished experiment, and what `describe` and `check` print."""
    folder = tmp_path_factory.mktemp("tanks")
    path = written(folder)
    texts = [cli(each, str(path)).output for each in ("describe", "check")]
    assert cli("run", str(path), "-o", str(folder / "out"), "-j", "1").exit_code == 0
    return folder, texts


def test_describe_and_check_show_the_plant(finished):
    """Oracle: the names, the units and the solver of the file."""
    described, checked = finished[1]
    for text in (
        "x' = rhs(x, u, p)",
        "h1 [m] within [0.0001, 0.6], h2 [m]",
        "pump [ml/s] limited to [0, 30]",
        "level [m]",
        "rk4, error control to 1e-07",
        "all runs of a block at once",
    ):
        assert text in described
    assert "rk4 with error control:" in checked


def test_names_and_units_are_on_the_axes(finished):
    """Oracle: the names of the file, in the stored experiment and in the figure."""
    folder, _ = finished
    trials = load_trials(folder / "out")
    assert (trials.names["y.0"], trials.names["u.0"], trials.names["x.0"]) == ("level", "pump", "h1")
    assert (trials.units["y"], trials.units["u"], trials.units["x.0"]) == ("m", "ml/s", "m")
    from rmpc_bench.figures.labels import component_label

    assert component_label(trials, "y", 0, "") == "level [m]"
    assert component_label(trials, "x_hat", 0, "0") == r"$\hat{x}_0$"
    assert component_label(trials, "x", 1, "1") == "h2 [m]"


def test_bounds_and_limits_have_names(tmp_path):
    """Oracle: the numbers of the file; a state without a limit has the default one."""
    experiment = load_config(written(tmp_path)).experiment
    limits, plant = experiment.state_range, experiment.plant
    assert (limits.low.tolist(), limits.high.tolist()) == ([1e-4, -np.inf], [0.6, np.inf])
    np.testing.assert_array_equal(limits.largest, [np.nan, 4.0])
    assert dict(plant.ode.bounds) == {"h1": (1e-4, 0.6), "pump": (0.0, 30.0)}
    again = load_config(written(tmp_path, bounds="{x.0: [0.0001, 0.6], u.0: [0, 30]}")).experiment
    assert dict(again.plant.ode.bounds) == dict(plant.ode.bounds)
    assert again.state_range.low.tolist() == limits.low.tolist()


@pytest.mark.parametrize(
    ("keys", "path", "message"),
    [
        ({"bounds": "{h3: [0, 1]}"}, "plant.bounds.h3", "'h3' is not a known state or input of this plant; did you"),
        ({"diverged": "{pump: 3}"}, "plant.diverged.pump", "'pump' is not a known state of this plant"),
        ({"bounds": "{pump: [0, 30 l/s]}"}, "plant.bounds.pump", "pump is in ml/s (got l/s); units are compared by"),
        ({"bounds": "{h1: [0 mm, 1 m]}"}, "plant.bounds.h1", "h1 is in m (got mm)"),
        ({"bounds": "{pump: [30, 0]}"}, "plant.bounds.pump", "the lower bound 30 must be below the upper bound 0"),
        ({"bounds": "{h1: [0, one]}"}, "plant.bounds.h1", "unknown name 'one'"),
        ({"x": "[0.1, 0.1 mm]"}, "initial.x.1", "h2 is in m (got mm); units are compared by name"),
        ({"x": "[0.1, blue]"}, "initial.x.1", "unknown name 'blue'"),
        ({"x": "[0.7, 0.1]"}, "initial.x", "h1 starts at 0.7, outside its plant.bounds [0.0001, 0.6]"),
        ({"plant": PLANT.replace("a1: 7.1e-6, ", "")}, "plant.ode", "'a1' is not a known parameter"),
        ({"plant": PLANT + "  solver: {substeps: 4, rtol: 1e-3}\n"}, "plant.solver", "rtol has no effect beside"),
        ({"plant": PLANT + "  solver: {method: euler}\n"}, "plant.solver.method", "must be 'rk4', 'LSODA'"),
    ],
)  # fmt: skip
def test_a_mistake_has_a_place_and_a_way_out(tmp_path, keys, path, message):
    """Oracle: the key to blame."""
    with pytest.raises(ConfigError) as caught:
        load_config(written(tmp_path, **keys))
    found = [f"{each.path}: {each.message}" for each in caught.value.problems]
    assert any(each.startswith(path) and message in each for each in found), found
    assert all(each.line > 1 for each in caught.value.problems)


def test_any_block_gives_the_same_bytes(tmp_path, finished):
    """Oracle: the table of the run in one process with the default block."""
    folder, _ = finished
    path = written(tmp_path)
    arguments = ("run", str(path), "-j", "2", "--engine", "joblib", "-o", str(tmp_path / "out"))
    assert cli(*arguments, "-s", "execution.block=1").exit_code == 0
    first, second = ((each / "out" / "trials.csv").read_bytes() for each in (folder, tmp_path))
    assert first == second
    with (folder / "out" / "trials.csv").open(encoding="utf-8") as file:
        assert {row["status"] for row in csv.DictReader(file)} == {"ok"}


@pytest.mark.long
def test_filters_with_error_control_give_the_same_bytes_in_any_block(tmp_path):
    """Oracle: blocks of 50 in one process against single runs in two; every run has its own intervals."""
    tables = []
    for block, jobs in ((50, 1), (1, 2)):
        folder = tmp_path / str(block)
        folder.mkdir()
        text = written(folder).read_text(encoding="utf-8").replace("duration: 100", "duration: 500, step: 50")
        text = text.replace("step: 5, ", "").replace("linearise: plant, at", "nonlinear: plant, at")
        filters = "".join(
            f"  {kind}: {{estimator: {{kind: {kind}}}, controller: {{kind: pid, Kp: 100}}}}\n"
            for kind in ("extended-kalman", "unscented-kalman")
        )
        (folder / "tanks.yaml").write_text(f"{text}methods:\n{filters}".replace(METHODS, ""), encoding="utf-8")
        arguments = ("-j", str(jobs), "--engine", "joblib", "-o", str(folder / "out"), "-s", f"execution.block={block}")
        result = cli("run", str(folder / "tanks.yaml"), *arguments)
        assert result.exit_code == 0, result.output
        tables.append((folder / "out" / "trials.csv").read_bytes())
    assert tables[0] == tables[1]
    assert b"ok" in tables[0] and b"diverged" not in tables[0]


def test_a_run_that_leaves_its_bounds_has_a_reason(tmp_path):
    """Oracle: a level that the reference drives beyond its bound; the store keeps state and time."""
    import sqlite3

    path = written(tmp_path, bounds="{h2: [0.0001, 0.1], pump: [0, 30]}")
    cli("run", str(path), "-o", str(tmp_path / "out"), "-j", "1")
    with closing(sqlite3.connect(tmp_path / "out" / "trials.sqlite")) as store:
        texts = [row[0] for row in store.execute("SELECT failure FROM failures")]
    messages = [json.loads(each)["message"] for each in texts]
    assert messages and all(each.startswith("h2 left its bounds [0.0001, 0.1] m at ") for each in messages)
