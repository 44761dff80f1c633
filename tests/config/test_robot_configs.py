"""The parallel robot in configurations: what comes from where, and how mistakes read."""

import numpy as np
import pytest
import required_keys
from small_experiment import cli, ran, write

from rmpc_bench import load_config, load_trials, registry
from rmpc_bench.plants.moving_slide import MovingSlide
from rmpc_bench.types import ConfigError

START = "[0.05657, 0.09239, 0, 0, 0, 0]"
ROWS = ", ".join("[" + ", ".join("0.01" if j == i + 3 else str(int(i == j)) for j in range(6)) + "]" for i in range(6))
INTEGRATORS = (
    f"{{kind: linear, A: [{ROWS}], B: [{', '.join(['[0, 0, 0, 0]'] * 6)}], "
    "C: [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0]], P_w: 1e-6, P_v: 1e-7}"
)
"""A model without inputs, so that every estimator takes it."""
KEYS = {
    "name": "robot",
    "runs": "4",
    "time": "{step: 0.01, steps: 40}",
    "uncertainty": "{eps: +-20%}",
    "plant": "{kind: moving-slide, perturb: {mass: 1 + eps}}",
    "model": INTEGRATORS,
    "noise": "{measurement: {uniform: {radius: 5e-4}}}",
    "initial": f"{{x: {START}, x_hat: {START}, P: 1e-6}}",
    "reference": "{kind: s-shape}",
    "controller": None,
    "methods": "{KF: {estimator: {kind: kalman}}}",
    "metrics": "[{kind: mse, of: estimate}]",
}


def write_robot(directory, **keys):
    """Write the robot with some keys replaced."""
    return write(directory, **(KEYS | keys))


def test_the_robot_is_built_from_its_keys(tmp_path):
    """Oracle: the keys; the reference is the S, a draw multiplies all masses and inertias and nothing else."""
    experiment = load_config(write_robot(tmp_path)).experiment
    plant = experiment.plant
    assert isinstance(plant, MovingSlide) and (plant.Ts, plant.substeps, plant.nominal["mass"]) == (0.01, 2, 1.0)
    np.testing.assert_allclose(experiment.scenario.reference.sample(1)[0], [0.0566, 0.0924, 0.0], atol=5e-5)
    delta = experiment.scenario.draw(plant, range(4), 40).delta
    factors = delta.numbers / [0.3, 0.08, 2.6, 0.04, 0.3, 0.03, 0.02, 0.5, 0.05, 0.5]
    masses, others = factors[:, 2:6], np.delete(factors, np.s_[2:6], axis=1)
    np.testing.assert_allclose(others, np.ones((4, 6)), rtol=1e-15)  # a division
    np.testing.assert_allclose(masses, np.tile(masses[:, :1], (1, 4)), rtol=1e-15)
    assert len(np.unique(masses[:, 0])) == 4 and (np.abs(masses - 1.0) <= 0.2).all()


def test_it_runs(tmp_path):
    """Oracle: every run reaches its last sample; blocks of one give the same file."""
    path = write_robot(tmp_path)
    single = write_robot(tmp_path, file="single.yaml", execution="{block: 1}")
    assert ran(path, tmp_path / "one") == ran(single, tmp_path / "other")
    assert (load_trials(tmp_path / "one").frame["status"] == "ok").all()


def test_a_filter_with_known_bursts_changes_only_after_they_begin(tmp_path):
    """Oracle: the reported covariance; until the burst begins it is that of the filter without bursts."""
    bursts = "{bursts: [{from: 0.2, to: 0.3, factor: 3}]}"
    methods = (
        f"{{KF: {{estimator: {{kind: kalman}}}}, known: {{estimator: {{kind: kalman}}, model: {{noise: {bursts}}}}}}}"
    )
    keys = {"model": "{kind: moving-slide}", "methods": methods}
    plain, known = (method.estimator for method in load_config(write_robot(tmp_path, **keys)).experiment.methods)
    y, u, P = np.zeros((1, 3)), np.zeros((1, 4)), []
    y[0] = [0.05657, 0.09239, 0.0]
    for filter_ in (plain, known):
        state = filter_.init(1)
        for k in range(41):
            state, estimate = filter_.correct(k, state, y)
            P.append(estimate.P[0, 0, 0])
            state = filter_.predict(k, state, u)
    without, with_ = np.array(P).reshape(2, 41)
    np.testing.assert_array_equal(with_[:20], without[:20])
    assert (with_[20:31] > without[20:31]).all()


def test_a_singular_pose_ends_a_run(tmp_path):
    """Oracle: acos(0.08/0.30) = 1.3009 in the middle, which 1 rad/s reaches; the table counts the runs by status."""
    start = "{x: [0, 0, 1.2, 0, 0, 1], x_hat: 0, P: 1}"
    assert cli("run", write_robot(tmp_path, initial=start), "-o", tmp_path / "out").exit_code == 3
    assert set(load_trials(tmp_path / "out").frame["status"]) == {"singular"}


@pytest.mark.parametrize(
    ("keys", "place", "message"),
    [
        ({"reference": "{kind: constant, value: [0.23, 0, 0]}"}, "reference", "at 0 s arm 2 would be 0.5009 m long"),
        ({"reference": "{kind: s-shape, width: 0.2, duration: 0.4}"}, "reference", "s arm 4 would be 0.5"),
        ({"reference": "{kind: constant, value: [0, 0, 74.53*pi/180]}"}, "reference", "is singular: the torques"),
        ({"initial": "{x: [0, 0, 0], x_hat: 0, P: 1}"}, "initial.x", "shape (3,) does not fit"),
        ({"initial": "{x: [0, 0, 1.3009, 0, 0, 0], x_hat: 0, P: 1}"}, "initial.x", "is singular: the torques"),
        ({"plant": "{kind: moving-slide, perturb: {m_a: 1 + eps}}"}, "plant.perturb.m_a", "'m_a' is not a known"),
        ({"plant": "{kind: moving-slide, l_min: 0.6}"}, "plant.l_min", "must be below the length of an arm"),
        ({"plant": "{kind: moving-slide, mass: 0}"}, "plant.mass", "must be > 0"),
        ({"model": "{kind: moving-slide, noise: {measurement: [1, 2]}}"}, "model.noise.measurement", "3 numbers"),
        (
            {"model": "{kind: moving-slide, noise: {bursts: [{from: 0.3, to: 0.2, factor: 2}]}}"},
            "model.noise.bursts.0.to",
            "must not be before from",
        ),
        (
            {
                "model": "{kind: moving-slide, noise: {bursts: [{from: 0.2, to: 0.3, factor: 2}]}}",
                "noise": "{measurement: same}",
            },
            "noise",
            "measurement noise of the design model changes with k",
        ),
        ({"plant": "{kind: servo}", "initial": "{x: 0, x_hat: 0, P: 1}"}, "reference.kind", "has 1 outputs"),
        (
            {"model": "{kind: moving-slide}", "methods": "{R: {estimator: {kind: robust-kalman, c: 0.1}}}"},
            "methods.R.estimator.kind",
            "the model depends on the state",
        ),
    ],
    ids=["far", "hook", "singular", "initial", "start", "name", "l_min", "mass", "noise", "burst", "same", "outputs",
         "estimator"],
)  # fmt: skip
def test_mistakes(tmp_path, keys, place, message):
    """Oracle: a line at the key to blame."""
    with pytest.raises(ConfigError) as caught:
        load_config(write_robot(tmp_path, **keys))
    found = [each for each in caught.value.problems if each.path == place and message in each.message]
    assert found, caught.value


ESTIMATORS, CONTROLLERS = (
    {kind: required_keys.in_yaml(kind) for kind in registry.names(group)} for group in ("estimators", "controllers")
)
CONTROLLERS["pid"] += ", on: estimate"
TAKERS = ("gpc", "kalman", "lp-window")
"""Kinds that linearise at the estimate."""


@pytest.mark.parametrize("kind", [*ESTIMATORS, *CONTROLLERS])
def test_every_estimator_and_controller_takes_the_robot_s_model_or_explains_why_not(tmp_path, kind):
    """Oracle: the registry; what is refused is the kind, not anything else that the part has, and nothing else raises.

    The oracle reports the whole component: it supports neither this model nor this plant.
    """
    estimator = f"{{kind: {kind}, {ESTIMATORS[kind]}}}" if kind in ESTIMATORS else "{kind: kalman}"
    controller = (
        f"{{kind: {kind}, {CONTROLLERS[kind]}}}" if kind in CONTROLLERS else f"{{kind: gpc, {CONTROLLERS['gpc']}}}"
    )
    start = f"{{x: {START}, x_hat: {START}, P: 1e-6, M: 1e-6}}"
    methods = f"{{m: {{estimator: {estimator}, controller: {controller}}}}}"
    path = write_robot(tmp_path, model="{kind: moving-slide}", initial=start, methods=methods)
    if kind in TAKERS:
        assert [method.name for method in load_config(path).experiment.methods] == ["m"]
        return
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    place = f"methods.m.{'estimator' if kind in ESTIMATORS else 'controller'}"
    assert [each.path for each in caught.value.problems] == [place if kind == "oracle" else f"{place}.kind"]
