"""Summaries of the examples: their numbers are those of the kept comparisons."""

import pandas as pd
import pytest
from examples.example_files import FOLDER

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load

CASES = [
    ("two-tanks", "Huber", "Kalman", "estimation_mse", 0.924, "by 7.6 %"),
    ("two-tanks", "robust", "Kalman", "estimation_mse", 1.19, "by 19 %"),
    ("grid", "EKF+PI", "KF+PI", "estimation_mse", 0.40, "by 60 % with the PI"),
    ("grid", "EKF+MPC", "KF+MPC", "estimation_mse", 0.28, "by 72 % with MPC"),
    ("grid", "UKF+PI", "KF+PI", "mse", 1.03, "3 % worse with PI"),
    ("pendulum", "LQR-robust", "LQR-Kalman", "state_mse", 0.97, "of the state by 3 %"),
    ("pendulum", "LQR-robust", "LQR-Kalman", "estimation_mse", 1.03, "error is 3 % larger"),
    ("pendulum", "LQR-robust", "LQR-Kalman", "input_rms", 1.07, "7 % more force"),
    ("pendulum", "LQR-observer", "LQR-Kalman", "estimation_mse", 3.7, "3.7 times"),
    ("pendulum", "LQR-observer", "LQR-Kalman", "state_mse", 1.9, "1.9 times"),
    ("cstr", "KF+PI", "KF+MPC", "estimation_mse_CA", 1.12, "12 % larger"),
    ("turning-pendulum", "EKF+FB", "EKF+FF", "mse", 1.140, "14.0 % larger"),
    ("camera", "not known", "known", "estimation_mse_theta", 26, "26 times"),
]
"""Configuration, method, the one that it is compared with, metric, factor and its words."""


def change(name, method, metric):
    """Factor of the metric of a method on that of the baseline, 1 for the baseline itself."""
    rows = pd.read_csv(FOLDER.parents[1] / "results" / "examples" / name / "comparisons.csv")
    found = rows[(rows["method"] == method) & (rows["metric"] == metric)]["change_pct"]
    return 1 + found.iloc[0] / 100 if len(found) else 1.0


@pytest.mark.parametrize(("name", "method", "other", "metric", "factor", "words"), CASES)
def test_a_number_of_a_summary(name, method, other, metric, factor, words):
    assert words in " ".join(plain(load(FOLDER / f"{name}.yaml"))["summary"].split())
    digits = len(words.partition(".")[2].partition(" ")[0]) + 2 * ("%" in words)
    assert round(change(name, method, metric) / change(name, other, metric), digits) == factor
