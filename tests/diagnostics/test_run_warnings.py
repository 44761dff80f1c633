"""Warnings before any run: what they are about, the key and the way out; and that sound experiments have none."""

import numpy as np
import pytest
from loaded_configs import loaded
from small_experiment import cli, write

from rmpc_bench import load_config
from rmpc_bench.cli.config_text import warning_texts
from rmpc_bench.numerics.stability import hinf_peak

SYSTEM = "B: 1, C: 1, Bw: 1, Dv: 1"
ESTIMATION = {
    "uncertainty": None, "controller": None, "reference": None, "noise": "same", "initial": "{x: 0, x_hat: 0, P: 1}",
    "time": "{steps: 200}", "metrics": "[estimation_mse]", "methods": "{K: {estimator: {kind: kalman}}}",
}  # fmt: skip


def warned(tmp_path, **keys):
    """Warnings about the small experiment with some keys replaced, without those of the configuration itself."""
    config = load_config(write(tmp_path, **keys))
    return warning_texts(config)[len(config.warnings) :]


def linear(A, steps=200):
    """Keys of an estimation experiment with a linear plant."""
    model = f"{{kind: linear, A: {A}, B: 1, C: 1, P_w: 0.01, P_v: 0.01}}"
    return ESTIMATION | {
        "plant": f"{{kind: linear, A: {A}, B: 1, C: 1}}",
        "model": model,
        "time": f"{{steps: {steps}}}",
    }


def test_an_unstable_plant_without_control(tmp_path):
    """Oracle: 1.5^200 = 10^35.2; key and way out are in the line."""
    assert warned(tmp_path, **linear(1.5)) == [
        "plant: not stable (spectral radius of A 1.5), and there is no controller: the state grows by about "
        "10^35 in 200 steps; give a `controller`, fewer steps or a larger `plant.diverged`"
    ]


@pytest.mark.parametrize(("A", "steps"), [(0.9, 200), (1.0, 200), (1.001, 200), (1.5, 5)])
def test_no_warning_where_nothing_grows(A, steps, tmp_path):
    """Oracle: the growth over the run is below 10."""
    assert warned(tmp_path, **linear(A, steps)) == []


def test_no_warning_for_an_unstable_plant_with_a_controller(tmp_path):
    """Oracle: a loop with lqr."""
    keys = linear(1.5) | {"controller": "{kind: lqr, horizon: 10, Q_x: 1, R_u: 1}"}
    assert warned(tmp_path, **keys) == []


def uncertain(H_A, methods, **keys):
    """Keys of an estimation experiment whose A = 0.5 is uncertain by H_A F."""
    plant = f"{{kind: uncertain-linear, A: 0.5, {SYSTEM}, H_A: {H_A}, G_x: 1, uncertainty: {{low: -1, high: 1}}}}"
    return ESTIMATION | {"plant": plant, "model": "{from: plant, W: 1, V: 1}", "methods": methods} | keys


ROBUST = (
    "{ERP: {estimator: {kind: enhanced-robust}}, S: {estimator: {kind: sayed-bdu}}, K: {estimator: {kind: kalman}}}"
)


def test_robust_estimators_of_a_system_that_is_not_quadratically_stable(tmp_path):
    """Oracle: the norm of 0.8 / (z - 0.5) is 1.6; the Kalman filter has no such condition."""
    (line,) = warned(tmp_path, **uncertain(0.8, ROBUST))
    assert line.startswith("methods.ERP.estimator (and 1 more): the design model is not quadratically stable")
    assert "H_A 1.6, must be below 1" in line and "less than 0.625 times the uncertainty" in line
    assert "compare with it" in line
    np.testing.assert_allclose(hinf_peak(*(np.array([[each]]) for each in (0.5, 0.8, 1.0))).norm, 1.6, rtol=1e-9)


def test_every_estimator_for_uncertainty_of_norm_1_is_examined(tmp_path):
    """Oracle: the kinds that know H_A and G_x and are designed for every F of norm at most 1; no other kind is."""
    kinds = {
        "enhanced-robust": 1.0, "sayed-bdu": 1.0, "robust-h-infinity": 1.0, "kalman": None, "kalman-predictor": None,
        "robust-kalman": None, "lmmse": None, "oracle": None,
    }  # fmt: skip
    keys = {"robust-kalman": ", c: 0.1", "robust-h-infinity": ", alpha: 9"}
    methods = ", ".join(f"{kind}: {{estimator: {{kind: {kind}{keys.get(kind, '')}}}}}" for kind in kinds)
    some = uncertain(0.1, f"{{{methods}}}", time="{steps: 5}")
    # robust-h-infinity knows no inputs.
    config = load_config(write(tmp_path, **some | {"plant": some["plant"].replace("B: 1, ", "", 1)}))
    assert {each.name: each.estimator.uncertainty_scale for each in config.experiment.methods} == kinds


def test_a_smaller_design_scale_and_a_stable_system_have_no_warning(tmp_path):
    """Oracle: the norms 1.6 times 0.6 and 0.4 / 0.5 are below 1."""
    scaled = "{ERP: {estimator: {kind: enhanced-robust, design_scale: 0.6}}}"
    assert warned(tmp_path, **uncertain(0.8, scaled)) == []
    assert warned(tmp_path, **uncertain(0.4, ROBUST)) == []


def test_an_unstable_design_model_of_a_robust_estimator(tmp_path):
    """Oracle: the spectral radius 1.1; it is named before the norm."""
    keys = uncertain(0.1, ROBUST, time="{steps: 10}")
    keys["plant"] = keys["plant"].replace("A: 0.5", "A: 1.1", 1)
    (line,) = warned(tmp_path, **keys)
    assert "not quadratically stable (spectral radius of A 1.1, must be below 1)" in line


def test_a_reference_in_degrees_saturates_the_input(tmp_path):
    """Oracle: 90 rad are 14 turns; in 20 s at 220 V the servomechanism does not get there, pi/2 rad it does."""
    keys = {"time": "{step: 0.1, steps: 200}"}
    (line,) = warned(tmp_path, reference="{kind: constant, value: 90}", **keys)
    assert line.startswith("controller.limits: with the design model and without noise the input is on a limit")
    assert "[-220, 220] in 100 % of the samples" in line and "check the unit of `reference`" in line
    assert warned(tmp_path, **keys) == []


def test_a_reference_beyond_the_steady_state_of_the_limits(tmp_path):
    """Oracle: the steady state of x+ = 0.5 x + u with |u| <= 1 is at most 2."""
    model = "{kind: linear, A: 0.5, B: 1, C: 1, P_w: 0.01, P_v: 0.01}"
    controller = "{kind: mpc, Hp: 5, Hu: 2, Q: 1, R: 0.1, limits: {u: [-1, 1]}}"
    keys = ESTIMATION | {"plant": "{kind: linear, A: 0.5, B: 1, C: 1}", "model": model, "controller": controller}
    for value, count in ((3, 1), (1.9, 0)):
        assert len(warned(tmp_path, **keys | {"reference": f"{{kind: constant, value: {value}}}"})) == count
    only = "{A: {estimator: {kind: kalman}}, B: {estimator: {kind: kalman}, controller: {limits: {u: [-9, 9]}}}}"
    keys |= {"methods": only, "reference": "{kind: constant, value: 3}"}
    assert warned(tmp_path, **keys)[0].startswith("methods.A.controller.limits: ")


def test_points_of_a_sweep_share_a_line(tmp_path):
    """Oracle: two of three points are not stable enough."""
    keys = uncertain(0.8, ROBUST) | {"sweep": "{zip: [{name: a, plant.H_A: 0.8}, {name: b, plant.H_A: 0.1}]}"}
    (line,) = warned(tmp_path, **keys)
    assert line.endswith("(at a)")


@pytest.mark.parametrize(
    "name", ["quickstart", "zenere2018/fig7", "zenere2018/sim2", "belda2017/exp1", "benchmarks/ma2025"]
)
def test_sound_experiments_have_no_warning(name):
    """Oracle: their loops are stable and reach the reference."""
    assert warning_texts(loaded(name)) == []


def test_run_and_check_show_the_warning(tmp_path):
    """Oracle: one line on stderr before the run; the same text in the output of check."""
    path = write(tmp_path, **linear(1.5, 40))
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none")
    lines = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    assert len(lines) == 1 and lines[0] not in result.stdout
    assert result.stderr.splitlines()[0] == lines[0]
    assert lines[0] in " ".join(cli("check", path).stdout.split())
