"""Keys `bounds` and `diverged` of every plant, and what becomes of an unstable system."""

import csv

import numpy as np
import pytest
from small_experiment import cli, ran, write

from rmpc_bench import load_config, registry
from rmpc_bench.config.plant import RANGE_KEYS
from rmpc_bench.config_file.keys import PROVIDED, model_of
from rmpc_bench.simulation.state_range import StateRange
from rmpc_bench.types import ConfigError

UNSTABLE = {
    "uncertainty": None,
    "controller": None,
    "plant": "{kind: linear, A: 1.5, B: 1, C: 1}",
    "model": "{kind: linear, A: 1.5, B: 1, C: 1, P_w: 0.01, P_v: 0.01}",
    "noise": "same",
    "initial": "{x: 0, x_hat: 0, P: 1}",
    "reference": None,
    "time": "{steps: 200}",
    "methods": "{K: {estimator: {kind: kalman}}, P: {estimator: {kind: kalman-predictor}}}",
    "metrics": "[{kind: mse, of: state}]",
}


def ranges(tmp_path, plant, **keys):
    """Limits of the small experiment's plant, with some keys of the plant."""
    path = write(tmp_path, plant="{kind: servo-linear, perturb: {J_l: 1 + eps}, " + plant + "}", **keys)
    return load_config(path).experiment.state_range


def mistakes(tmp_path, plant, **keys):
    """Messages for the small experiment with some keys of the plant."""
    with pytest.raises(ConfigError) as caught:
        ranges(tmp_path, plant, **keys)
    return [f"{each.path}: {each.message}" for each in caught.value.problems]


def test_no_plant_has_a_parameter_of_these_names():
    """Oracle: the registry; the keys are those of every plant."""
    for kind in registry.names("plants"):
        assert not {*RANGE_KEYS} & {*model_of("plants", kind).model_fields}
    # A plant may ask for its bounds and angles; they are validated as those of every plant.
    assert {*RANGE_KEYS} & PROVIDED["plants"] <= {"angles", "bounds"}


def test_limits_of_single_states_and_of_all(tmp_path):
    """Oracle: the numbers of the file, later entries over earlier ones."""
    low, high, largest, _ = ranges(tmp_path, "bounds: {x: [-2*pi, 1e3], x.2: [null, 5]}, diverged: [1, 2, 3, 4e9]")
    np.testing.assert_array_equal(low, [-2 * np.pi, -2 * np.pi, -np.inf, -2 * np.pi])
    np.testing.assert_array_equal(high, [1e3, 1e3, 5.0, 1e3])
    np.testing.assert_array_equal(largest, [1.0, 2.0, 3.0, 4e9])
    assert ranges(tmp_path, "diverged: 7").largest.tolist() == [7.0] * 4
    assert ranges(tmp_path, "J_m: 0.5") == StateRange()


@pytest.mark.parametrize(
    ("keys", "path", "message"),
    [
        ("bounds: {x.4: [0, 1]}", 'plant.bounds."x.4"', "its states are x.0 to x.3, and x stands for all of them"),
        ("bounds: {h: [0, 1]}", "plant.bounds.h", "'h' is not a state of this plant"),
        ("bounds: {x.1: [1, 1]}", 'plant.bounds."x.1"', "the lower bound 1 must be below the upper bound 1"),
        ("bounds: {x.1: [1]}", 'plant.bounds."x.1"', "has too few entries"),
        ("bounds: [0, 1]", "plant.bounds", "must be a mapping"),
        ("bounds: {x.0: [1, 2]}", "initial.x", "x.0 starts at 0, outside its plant.bounds [1, 2]"),
        ("diverged: -1", "plant.diverged", "must be > 0 (got -1)"),
        ("diverged: 1e101", "plant.diverged", "must be < 1e+100"),
        ("diverged: [1, 2]", "plant.diverged", "has 2 entries; give one number, or one for each of the 4 states"),
    ],
)
def test_mistakes_name_the_key(keys, path, message, tmp_path):
    """Oracle: the key to blame and the way out."""
    assert any(text.startswith(f"{path}: ") and message in text for text in mistakes(tmp_path, keys)), keys


def test_an_initial_state_beyond_the_limit_is_refused(tmp_path):
    """Oracle: initial.x = 3 with a limit of 2."""
    found = mistakes(tmp_path, "diverged: 2", initial="{x: [0, 3, 0, 0], x_hat: 0, P: process}")
    assert found == ["initial.x: x.1 starts at 3, beyond plant.diverged = 2"]


def test_a_section_that_is_no_mapping_has_no_start(tmp_path):
    """Oracle: the section `initial` has the only error, although 0 would be outside the bounds."""
    assert mistakes(tmp_path, "bounds: {x.0: [1, 2]}", initial="3") == ["initial: must be a mapping (got 3)"]


def test_the_keys_are_part_of_the_experiment(tmp_path):
    """Oracle: the hash and the resolved configuration; without them nothing changes."""
    plain = load_config(write(tmp_path, file="plain.yaml"))
    given = "{kind: servo-linear, perturb: {J_l: 1 + eps}, bounds: {x.0: [-9, 9]}, diverged: 1e4}"
    limited = load_config(write(tmp_path, file="limited.yaml", plant=given))
    assert limited.hash != plain.hash
    assert limited.resolved["plant"]["bounds"] == {"x.0": [-9.0, 9.0]}
    assert limited.resolved["plant"]["diverged"] == 1e4
    assert not {*RANGE_KEYS} & {*plain.resolved["plant"]}


def trials(directory):
    """Rows of trials.csv."""
    with (directory / "trials.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def statuses(directory):
    """Statuses of all trials."""
    return [row["status"] for row in trials(directory)]


def test_an_unstable_system_without_control_fails(tmp_path):
    """Oracle: 1.5^200 = 1.6e35; all runs were `ok` with an MSE of 1e69, and the exit code was 0."""
    path = write(tmp_path, **UNSTABLE)
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none")
    assert result.exit_code == 3, result.output
    assert statuses(tmp_path / "out") == ["diverged"] * 12
    assert {row["mse"] for row in trials(tmp_path / "out")} == {""}
    assert "12 failed" in result.output and "is better" not in result.output


def test_a_larger_limit_keeps_the_runs_of_an_unstable_system(tmp_path):
    """Oracle: the same runs with a limit above 1.5^200; exit 0."""
    plant = "{kind: linear, A: 1.5, B: 1, C: 1, diverged: 1e60}"
    ran(write(tmp_path, **UNSTABLE | {"plant": plant}), tmp_path / "out")
    assert statuses(tmp_path / "out") == ["ok"] * 12


def test_runs_that_leave_the_bounds_are_out_of_range(tmp_path):
    """Oracle: the load angle of pi/2 is out of bounds for every run."""
    plant = "{kind: servo-linear, perturb: {J_l: 1 + eps}, bounds: {x.0: [-1, 1]}}"
    path = write(tmp_path, plant=plant, time="{step: 0.1, steps: 100}")
    assert cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none").exit_code == 3
    assert statuses(tmp_path / "out") == ["out-of-range"] * 12
