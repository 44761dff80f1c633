"""zenere2018, Fig. 7 at full size: 200 perturbed servomechanisms, four controllers."""

import numpy as np
import pytest

from rmpc_bench import load_config, run

pytestmark = pytest.mark.slow

CONFIG = "configs/zenere2018/fig7.yaml"
MEDIANS = {"S-MPC": 0.1126, "R-MPC3": 0.1119, "R-MPC2": 0.1053, "R-MPC1": 0.1020}
"""Of an independent study with other draws; over 24 seeds of 200 runs none of its medians was off by more than 5 %."""


@pytest.fixture
def trials(trials_of):
    """Return all trials of the experiment."""
    return trials_of("zenere2018/fig7")[1]


def test_medians_are_those_of_the_study(trials):
    """Oracle: a second implementation by other authors."""
    for method, median in MEDIANS.items():
        assert np.median(trials.column("mse", method)) == pytest.approx(median, rel=0.05)


def test_means_fall_with_the_radius(trials):
    """Paper: R-MPC1 < R-MPC2 < R-MPC3 < S-MPC; every step down by more than 5 standard errors of its pairs."""
    order = ["R-MPC1", "R-MPC2", "R-MPC3", "S-MPC"]
    for better, worse in zip(order, order[1:], strict=False):
        gain = trials.column("mse", worse) - trials.column("mse", better)
        assert gain.mean() > 5 * gain.std(ddof=1) / np.sqrt(len(gain))


def test_the_largest_radius_wins_nine_runs_in_ten(trials):
    """R-MPC1 against S-MPC, run by run on the same plants."""
    assert np.mean(trials.column("mse", "R-MPC1") < trials.column("mse", "S-MPC")) >= 0.9


@pytest.mark.parametrize("seed", [1, 2])
def test_the_order_does_not_hang_on_the_seed(tmp_path, seed):
    """Other plants, the same order of means."""
    trials = run(load_config(CONFIG, overrides=[f"seed={seed}"]), directory=tmp_path, jobs=2).trials
    means = [trials.column("mse", method).mean() for method in ("R-MPC1", "R-MPC2", "R-MPC3", "S-MPC")]
    assert means == sorted(means)
