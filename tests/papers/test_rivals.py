"""zenere2018/rivals: its filters have the values that rivals-tuning chose, on other plants, from nine values each."""

import numpy as np
import pytest
from docs.constraints_page import RIVALS, candidates, tuned_values

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.estimators import kalman
from rmpc_bench.models.servo import ServoNoise
from rmpc_bench.models.servo import design as servo

TUNED = {method: path for method, (_, path) in RIVALS.items() if path is not None}
TABLE, TUNING = (plain(load(f"configs/zenere2018/{name}.yaml")) for name in ("rivals", "rivals-tuning"))


def number(text):
    """Value of a number, or of `sqrt(number)`."""
    inside = str(text).removeprefix("sqrt(").removesuffix(")")
    return float(inside) ** (0.5 if inside != str(text) else 1.0)


@pytest.mark.parametrize("noise", tuned_values())
@pytest.mark.parametrize("method", TUNED)
def test_the_value_of_the_table_is_the_best_one_of_the_kept_row(method, noise):
    row = candidates(noise, method)
    best = min(row, key=lambda value: row[value])
    assert number(tuned_values()[noise][method]) == pytest.approx(number(best))


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
        assert "untuned" in TABLE["methods"][method]["label"] and "untuned" in RIVALS[method][0]
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
