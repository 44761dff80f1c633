"""servo-constrained/baselines: its values are those that baselines-tuning chose, on other plants, from nine each."""

import csv
from pathlib import Path

import numpy as np
import pytest

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.models.servo import TABLE_1

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "configs" / "servo-constrained"
TABLE, TUNING = (plain(load(FOLDER / f"{name}.yaml")) for name in ("baselines", "baselines-tuning"))
SCALARS = {"S-tuned": ["R"], "R1-tuned": ["R"], "S-input": ["R"], "PID": ["Kp", "Ki", "Kd"], "LQG": ["Q_i"]}


def key(method, name):
    """Return the coordinate of a key of the controller of a method."""
    return f"methods.{method}.controller.{name}"


def chosen(method, noise):
    """Values of the table at a noise."""
    point = next(each for each in TABLE["sweep"]["zip"] if each["name"] == noise)
    return [float(point[key(method, name)]) for name in SCALARS[method]]


@pytest.mark.parametrize("noise", ["s=0", "s=0.1"])
@pytest.mark.parametrize("method", SCALARS)
def test_the_values_are_the_best_of_nine(method, noise):
    """Oracle: the kept means of the tuning; the best value is not the first or the last one."""
    with (ROOT / "results" / "servo-constrained" / "baselines-tuning" / "summary.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if (row["method"], row["metric"]) == (method, "mse")]
    means = [float(row["mean"]) for row in rows if row["noise"] == noise]
    best = int(np.argmin(means))
    assert len(means) == 9
    assert 0 < best < 8
    candidates = [TUNING["sweep"]["zip"][key(method, name)][best] for name in SCALARS[method]]
    assert chosen(method, noise) == [float(each) for each in candidates]


def test_the_tuning_has_other_plants_of_the_same_law():
    """Oracle: the sections of both files."""
    assert TABLE["seed"] != TUNING["seed"]
    for section in ("uncertainty", "plant", "controller", "estimator", "time"):
        assert TABLE[section] == TUNING[section]
    for method in SCALARS:
        assert set(TABLE["methods"][method]["controller"] if "controller" in TABLE["methods"][method] else ()) == set(
            TUNING["methods"][method].get("controller", ())
        )


def test_gains_of_the_simc_rule():
    """Oracle: the rule for K / (s (T s + 1)) with the delay Ts / 2, in series form, and the nominal servomechanism."""
    p = TABLE_1
    damping = p["K_t"] ** 2 / p["R"] + p["beta_m"] + p["beta_l"] / p["rho"] ** 2
    K, T = p["K_t"] / p["R"] / damping / p["rho"], (p["J_m"] + p["J_l"] / p["rho"] ** 2) / damping
    found = np.array([[float(each) for each in TUNING["sweep"]["zip"][key("PID", name)]] for name in SCALARS["PID"]])
    closed_loop = np.array([0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.4, 1.7, 2.0]) + 0.05
    gain, integral = 1.0 / (K * closed_loop), 4.0 * closed_loop
    expected = [gain * (1.0 + T / integral), gain / integral, gain * T]
    np.testing.assert_allclose(found, expected, rtol=1e-3)  # four digits
    assert TUNING["methods"]["PID"]["controller"]["Tf"] == pytest.approx(T / 10.0, rel=1e-3)


def test_what_was_not_tuned_is_called_untuned():
    """Oracle: the labels, and the sentences that compare with these methods."""
    for method in {*TABLE["methods"]} - {*SCALARS}:
        assert "untuned" in TABLE["methods"][method]["label"]
    for claim in TABLE["claims"]:
        if "mse[S-MPC" in str(claim["check"]) or "mse[R-MPC1" in str(claim["check"]):
            assert "untuned" in claim["says"], claim["says"]
