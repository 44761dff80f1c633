"""zenere2018/rivals: its filters have the values that rivals-tuning chose, on other plants, from nine values each."""

import numpy as np
import pytest
from docs.constraints_page import kept

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.estimators import kalman
from rmpc_bench.models.servo import ServoNoise
from rmpc_bench.models.servo import design as servo

TUNED = {
    "R-tuned": "estimator.c",
    "RS-tuned": "estimator.theta_from.c",
    "S-process": "model.noise.process",
    "S-input": "model.disturbance.drift",
    "S-load": "model.disturbance.drift",
    "R-input": "model.disturbance.drift",
}
"""Method -> path of its tuned scalar."""
TABLE, TUNING = (plain(load(f"configs/zenere2018/{name}.yaml")) for name in ("rivals", "rivals-tuning"))


def number(text):
    """Value of a number, or of `sqrt(number)`."""
    inside = str(text).removeprefix("sqrt(").removesuffix(")")
    return float(inside) ** (0.5 if inside != str(text) else 1.0)


def candidates(noise, method):
    """Return value -> mean MSE on the plants of the tuning, in the order of the file."""
    frame = kept("zenere2018", "rivals-tuning")
    mine = frame[(frame["noise"] == noise) & (frame["method"] == method) & (frame["metric"] == "mse")]
    return dict(zip(mine[f"methods.{method}.{TUNED[method]}"].map(number), mine["mean"], strict=True))


@pytest.mark.parametrize("row", TABLE["sweep"]["zip"], ids=lambda row: row["name"])
@pytest.mark.parametrize("method", TUNED)
def test_the_value_of_the_table_is_the_best_one_of_the_kept_row(method, row):
    errors = candidates(row["name"], method)
    assert number(row[f"methods.{method}.{TUNED[method]}"]) == pytest.approx(min(errors, key=errors.get))


def test_values_at_the_end_of_their_range():
    """docs/servo-constrained.md: the last values gain little without noise; with it their drift is a wrong one."""
    for errors, first in ((candidates("s=0", "S-process"), 10.0), (candidates("s=0", "S-load"), 1e6)):
        assert min(errors, key=errors.get) == max(errors) and errors[first] < 1.003 * errors[max(errors)]
    drift = candidates("s=1", "S-input")
    assert (round(drift[1e5], 3), round(drift[0.1], 3)) == (0.547, 0.422)


def test_every_filter_has_nine_values_on_a_logarithmic_scale():
    for method, path in TUNED.items():
        values = [number(value) for value in TUNING["sweep"]["zip"][f"methods.{method}.{path}"]]
        assert len(values) == 9 and values == sorted(values)
        ratios = np.diff(np.log10(values))
        # 1, 3, 10 are half decades as they are usually written.
        assert ratios.max() < 1.1 * np.median(ratios) + 0.05 and len(candidates("s=0", method)) == 9


def test_the_tuning_has_other_plants_of_the_same_law():
    assert TABLE["seed"] != TUNING["seed"]
    for section in ("uncertainty", "plant", "controller", "time"):
        assert TABLE[section] == TUNING[section]
    assert [*TABLE["methods"]] == ["S-MPC", "R-MPC1", *TUNED] and [*TUNING["methods"]] == ["S-MPC", *TUNED]


def test_what_was_not_tuned_is_called_untuned():
    for method in {*TABLE["methods"]} - {*TUNED}:
        assert "untuned" in TABLE["methods"][method]["label"]
    for claim in TABLE["claims"]:
        compared = str(claim["check"])
        if "[S-MPC" in compared or "[R-MPC1" in compared:
            assert "untuned" in claim["says"], claim["says"]


@pytest.mark.parametrize("factor", [3.0, 10.0, 100.0])
def test_less_measurement_noise_is_more_process_noise(factor):
    """With P(0) = Q_w the gains depend on the ratio of the noises only, so R_v is no scalar of its own."""
    gains = []
    for noise in (ServoNoise(factor, 1.0), ServoNoise(1.0, 1.0 / factor)):
        model = servo(0.1, noise=noise)
        gains.append(kalman.design(model, 50, x0=np.zeros(4), P0=model.Q_w).L)
    np.testing.assert_allclose(gains[0], gains[1], rtol=1e-9, atol=1e-12)
