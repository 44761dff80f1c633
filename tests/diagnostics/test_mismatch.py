"""What `check --deep` finds in a configuration."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND, servo_model
from small_experiment import write

from rmpc_bench.config.load import load_config
from rmpc_bench.config_file.component import build_component
from rmpc_bench.diagnostics import mismatch
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.types import Noise, Plant

CONTROLLER = "{kind: mpc, Hp: 10, Hu: 3, Q: 0.1, R: 0.1, scale: {u: 440, y: 2*pi}}"
TIME = "{step: 0.1, steps: 40}"


def found(tmp_path, **keys):
    """Mismatch of the small experiment with some keys changed."""
    return of(load_config(write(tmp_path, **keys)))


def of(config, known=None):
    """Mismatch at the first point of a configuration."""
    point = config.points[0]
    return mismatch.model_mismatch(
        point.experiment,
        point.methods,
        plant=point.shared["plant"]["kind"],
        baseline=config.baseline,
        build=build_component,
        known=known,
    )


def test_divergence_of_every_method(tmp_path):
    """Configured c, both parts for every plant; without noise no scale of it."""
    all_of_it = found(tmp_path, time=TIME, noise="none")
    assert (all_of_it.n_plants, all_of_it.n_steps, list(all_of_it.methods)) == (6, 40, ["S-MPC", "R-MPC"])
    for each, c in zip(all_of_it.methods.values(), (None, 0.1), strict=True):
        assert each.c == c and each.noise == (None, "none")
        assert all(part.shape == (6,) and (part > 0.0).all() for part in each.divergence)


def test_scale_of_the_noise(tmp_path):
    """Taken from the measurement noise, else from the process noise, relative to the model's."""
    model = "{kind: servo-linear, noise: {process: 3.0, measurement: 0.5}}"
    for noise, s, channel in (
        ("{measurement: {same: {scale: 0.02}}}", 0.02, "measurement"),
        ("{measurement: {gaussian: {std: 0.01}}}", 0.02, "measurement"),
        ("{process: {same: {scale: 0.3}}}", 0.3, "process"),
        ("{process: {same: {scale: 0.3}}, measurement: {same: {scale: 0.02}}}", 0.02, "measurement"),
        ("{process: {same: {scale: 0}}, measurement: {same: {scale: 0}}}", None, "none"),
    ):
        each = found(tmp_path, noise=noise, model=model, uncertainty="{eps: {dist: fixed, value: 10%}}")
        each = each.methods["S-MPC"]
        assert each.noise == (s if s is None else pytest.approx(s, rel=1e-12), channel)
        if s is not None:
            expected = each.divergence.mismatch / s**2 + each.divergence.noise
            np.testing.assert_allclose(each.divergence.at(each.noise.scale), expected, **ROUND)


def test_a_noise_law_of_unknown_size(tmp_path):
    """There is noise, but no scale of it."""

    class Law(Noise):
        def draw(self, rng, n_samples):
            """Is not called."""

    scenario = replace(load_config(write(tmp_path)).experiment.scenario, measurement=(Law(),))
    assert mismatch._noise_scale(scenario, servo_model()) == (None, "unknown")


def test_scale_of_the_noise_by_every_methods_own_model(tmp_path):
    """A design model with ten times the noise gives a tenth of the scale."""
    other = "{kind: servo-linear, noise: {process: 3.0, measurement: 5.0}}"
    methods = f"{{S-MPC: {{estimator: {{kind: kalman}}}}, other: {{model: {other}, estimator: {{kind: kalman}}}}}}"
    model = "{kind: servo-linear, noise: {process: 3.0, measurement: 0.5}}"
    noise = "{measurement: {gaussian: {std: 0.01}}}"
    scales = [each.noise.scale for each in found(tmp_path, noise=noise, model=model, methods=methods).methods.values()]
    np.testing.assert_allclose(scales, [0.02, 0.002], rtol=1e-12)


def test_a_plant_that_is_the_model(tmp_path):
    """Nothing is uncertain: one plant, which does not diverge."""
    all_of_it = found(tmp_path, plant="{kind: servo-linear}", uncertainty="{}", noise="none")
    assert (all_of_it.n_plants, all_of_it.n_steps) == (1, 10)
    np.testing.assert_allclose(all_of_it.methods["R-MPC"].divergence, 0.0, atol=1e-12)  # rounding


def test_the_tolerance_of_the_actual_model(tmp_path):
    """Table 2 of zenere2018 for 200 steps, as in simulation/test_tolerance.py."""
    factors = {name: 1.05 for name in ("R", "rho", "k_theta")} | {"J_l": 0.9}
    factors |= dict.fromkeys(("J_m", "beta_m", "K_t", "beta_l"), 1.1)
    perturb = "{" + ", ".join(f"{name}: {factor}" for name, factor in factors.items()) + "}"
    plant, time = f"{{kind: servo, perturb: {perturb}}}", "{step: 0.1, steps: 200}"
    each = found(tmp_path, plant=plant, uncertainty="{}", noise="none", time=time).methods["S-MPC"]
    parts = [float(part[0]) for part in each.divergence]
    assert parts == [pytest.approx(0.0775, abs=5e-5), pytest.approx(0.448, abs=5e-4), pytest.approx(0.24, abs=5e-3)]


def test_a_plant_without_a_linear_part(tmp_path, monkeypatch):
    """Reported as such; the other results are there."""
    monkeypatch.setattr("rmpc_bench.plants.servo.ServoLinear.linear", Plant.linear)  # the default: there is none
    all_of_it = found(tmp_path, time=TIME)
    each = all_of_it.methods["S-MPC"]
    assert (all_of_it.plant, all_of_it.n_plants, len(each.plant_radii)) == ("servo-linear", 0, 0)
    assert each.divergence == "no linear plant" and each.model_radius > 0.0


def test_a_plant_out_of_range_is_left_out(tmp_path):
    """Parameters without meaning have no linear part."""
    uncertainty = "{eps: {dist: choice, values: [-2, 0.1]}}"
    assert 0 < found(tmp_path, uncertainty=uncertainty, runs=12).n_plants < 12


def test_a_controller_without_gains(tmp_path, monkeypatch):
    """No law, no divergence, no loop; the other methods are not touched."""
    config = load_config(write(tmp_path, time=TIME))
    hidden = config.experiment.methods[1]
    pair = mismatch.linear_pair
    monkeypatch.setattr(mismatch, "linear_pair", lambda e, c: None if e is hidden.estimator else pair(e, c))
    methods = of(config).methods
    without = methods["R-MPC"]
    assert without.divergence == without.gain.missing == "no linear law with known gains"
    assert without.model_radius is None and len(without.plant_radii) == 0
    assert not isinstance(methods["S-MPC"].divergence, str)


def test_a_model_without_noise(tmp_path):
    """A singular density of the model has no divergence."""
    model = "{kind: servo-linear, noise: {process: [0, 0, 0, 0], measurement: 1.0}}"
    methods = "{S-MPC: {estimator: {kind: kalman}}}"
    each = found(tmp_path, model=model, methods=methods).methods["S-MPC"]
    assert each.divergence == "the model's density is singular"


def test_gains_that_have_converged_and_gains_that_have_not(tmp_path):
    """Within ten seconds R has, S has not: its limit is found beyond the end of the experiment."""
    methods = found(tmp_path, time="{step: 0.1, duration: 10}").methods
    model = servo_model()
    gains = kalman(model, 2000, x0=np.zeros(4), P0=model.Q_w).L
    distance = np.linalg.norm(gains - gains[-1], axis=(1, 2)) / np.linalg.norm(gains[-1])
    after = 0.1 * (1 + np.flatnonzero(distance > 0.01)[-1])
    assert after == pytest.approx(11.1)
    late, early = methods["S-MPC"].gain, methods["R-MPC"].gain
    assert (late.after, late.off) == (pytest.approx(after), pytest.approx(distance[100], rel=0.01)) and late.off > 0.01
    assert early.after == pytest.approx(8.5) and early.off < 0.01
    assert not late.missing and not early.missing and min(late.until, early.until) >= 20.0


@pytest.mark.slow
def test_gains_of_the_risk_sensitive_filter(tmp_path, monkeypatch):
    """servo.md sections 1 and 3.4: 723.6 s until its gain is steady to 1e-3, in an experiment of 20 s."""
    monkeypatch.setattr(mismatch, "STEADY", 1e-3)
    methods = "{S-MPC: {estimator: {kind: risk-sensitive, theta_from: {c: 0.1}}}}"
    gain = found(tmp_path, methods=methods, time="{step: 0.1, duration: 20}").methods["S-MPC"].gain
    assert gain.after == pytest.approx(723.7) and gain.off == pytest.approx(0.87, abs=0.005)


def test_gains_that_do_not_converge(tmp_path, monkeypatch):
    """The search ends at a limit, which is reported."""
    monkeypatch.setattr(mismatch, "MAX_STEPS", 30)
    monkeypatch.setattr(mismatch, "LIMIT", 0.0)
    gain = found(tmp_path, controller=CONTROLLER).methods["S-MPC"].gain
    assert gain.after is None and gain.until == pytest.approx(2.0)


def test_unstable_loops(tmp_path):
    """A law that inverts one step of the model: its closed loop has the sampled zeros, one outside the unit circle."""
    controller = "{kind: mpc, Hp: 1, Hu: 1, Q: 1.0, R: 0}"
    each = found(tmp_path, controller=controller, time=TIME).methods["S-MPC"]
    model = servo_model()
    zeros = np.roots(np.poly(model.A - model.B @ model.C) - np.poly(model.A))  # of C adj(z - A) B
    assert each.model_radius == pytest.approx(np.abs(zeros).max(), rel=1e-6)
    assert each.model_radius > 1.0 and (each.plant_radii > 1.0).all() and len(each.plant_radii) == 6


def test_confounded_comparisons(tmp_path):
    """An estimator and its controller changed at once, against the baseline only."""
    methods = """{S-MPC: {estimator: {kind: kalman}},
      same: {estimator: {kind: robust-kalman, c: 0.1}},
      both: {estimator: {kind: robust-kalman, c: 0.1}, controller: {R: 0.2, scale: {u: 220}}},
      controller: {controller: {Q: 0.2}, estimator: {kind: kalman}}}"""
    methods = " ".join(methods.split())
    expected = {"both": ["controller.R", "controller.scale.u"]}
    assert found(tmp_path, methods=methods, time=TIME).confounded == expected


def test_points_share_the_convergence(tmp_path, monkeypatch):
    """A recursion is continued once for all points that agree on it."""
    config = load_config(write(tmp_path, time=TIME))
    known = {}
    first = of(config, known)
    monkeypatch.setattr(mismatch, "_convergence", None)
    second = of(config, known)
    assert [each.gain for each in second.methods.values()] == [each.gain for each in first.methods.values()]
