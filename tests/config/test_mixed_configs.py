"""Linear plants and models with bounded noises in configurations: what comes from where, and how mistakes read."""

import numpy as np
import pytest
from small_experiment import cli, ran
from uncertain_experiment import write_estimation

from rmpc_bench import load_config, load_trials
from rmpc_bench.estimators.mixed import design as mixed
from rmpc_bench.types import ConfigError

WAVE = "(1 + 0.1*sin(k))"
PLANT = (
    f'{{kind: linear, A: [["0.6*{WAVE}", "0.7*{WAVE}"], ["0.25*{WAVE}", "0.5*{WAVE}"]], B: [[1], [0.3]], '
    "C: [[0.2, 1]]}"
)
MODEL = "{from: plant, P_w: 0.25, M_w: [[5, 2], [2, 5]], P_v: 0.25, M_v: 5}"
KEYS = {
    "plant": PLANT,
    "model": MODEL,
    "initial": "{x: [60, -45], x_hat: [60, -45], P: 100, M: 400}",
    "noise": "{process: {gaussian: {cov: 0.25}}, measurement: {gaussian: {std: 0.5}}}",
    "methods": """{
  MIX: {estimator: {kind: mixed}},
  ESM: {estimator: {kind: set-membership}},
  MN: {estimator: {kind: set-membership, update: maksarov-norton, level: 99.99%}},
  KF: {estimator: {kind: kalman, noise: matched}},
  KD: {estimator: {kind: kalman-disturbance, drift: 0.01}}}""",
}


def write_mixed(directory, **keys):
    """Write the system of ma2025 with some keys replaced."""
    return write_estimation(directory, **(KEYS | keys))


def test_the_model_comes_from_the_plant(tmp_path):
    """Oracle: (72)-(75) of ma2025 at a few k, one beyond the last step, and the design made by hand."""
    experiment = load_config(write_mixed(tmp_path)).experiment
    estimator = next(method.estimator for method in experiment.methods if method.name == "MIX")
    model = estimator.sets.model
    for k in (0, 7, 40):
        A = (1.0 + 0.1 * np.sin(k)) * np.array([[0.6, 0.7], [0.25, 0.5]])
        np.testing.assert_allclose(model.at(k).A, A, rtol=1e-15)  # the order of two products
        np.testing.assert_array_equal(model.at(k).Q_w, 0.25 * np.eye(2))
        np.testing.assert_array_equal(model.M_w(k), [[5.0, 2.0], [2.0, 5.0]])
        np.testing.assert_array_equal(model.M_v(k), [[5.0]])
    np.testing.assert_array_equal(experiment.plant.system.at(3).A, model.at(3).A)
    by_hand = mixed(model, 12, x0=np.array([60.0, -45.0]), P0=100.0 * np.eye(2), M0=400.0 * np.eye(2))
    np.testing.assert_array_equal(estimator.M, by_hand.M)


def test_all_estimators_run(tmp_path):
    """Oracle: every run reaches its last sample, in one worker as in two."""
    path = write_mixed(tmp_path)
    assert ran(path, tmp_path / "one") == ran(path, tmp_path / "two", jobs=2)
    trials = load_trials(tmp_path / "one").frame
    assert (trials["status"] == "ok").all() and set(trials["method"]) == {"MIX", "ESM", "MN", "KF", "KD"}
    assert np.isfinite(trials["estimation_mse"]).all()


def test_an_empty_set_ends_a_run(tmp_path):
    """Oracle: measurement noise of 1000 in a set of 5; the table counts it under its name, the others go on."""
    noise = "{process: none, measurement: {gaussian: {std: 1000}}}"
    methods = "{MN: {estimator: {kind: set-membership, update: maksarov-norton}}, MIX: {estimator: {kind: mixed}}}"
    assert cli("run", write_mixed(tmp_path, noise=noise, methods=methods), "-o", tmp_path / "out").exit_code != 0
    trials = load_trials(tmp_path / "out").frame
    assert set(trials["status"][trials["method"] == "MN"]) == {"empty-set"}
    assert set(trials["status"][trials["method"] == "MIX"]) == {"ok"}


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"model": "{from: plant, M_w: -1}"}, "model.M_w: must be positive semidefinite"),
        (
            {"model": "{from: plant, M_w: 1, M_v: [1, 2]}"},
            "model.M_v: is a diagonal: it has the shape 2 x 2; 1 x 1 fits",
        ),
        ({"model": '{from: plant, P_w: "sqrt(5 - k)", P_v: 1}'}, "model.P_w: has no value at k = 6"),
        ({"model": "{from: plant, Q_w: 1}"}, "model.Q_w: 'Q_w' is not a known key"),
        ({"methods": "{E: {estimator: {kind: mixed, q: twice}}}"}, "methods.E.estimator.q: must be"),
        ({"methods": "{E: {estimator: {kind: set-membership, level: 1}}}"}, "methods.E.estimator.level: must be < 1"),
        ({"methods": "{E: {estimator: {kind: kalman-disturbance, drift: -1}}}"}, "estimator.drift: must be >= 0"),
        ({"plant": "{kind: linear, A: 0.5}", "model": MODEL}, "plant: 'C' is missing"),
    ],
)
def test_mistakes(tmp_path, keys, message):
    """Oracle: a line at the key to blame."""
    path = write_mixed(tmp_path, **keys)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert any(message in str(problem) for problem in caught.value.problems), caught.value


CONTROLLED = {
    "controller": "{kind: minimax-lq, horizon: 5, Q_x: 1, R_u: 1}",
    "methods": "{MIX: {estimator: {kind: mixed}}}",
    "metrics": "[mse]",
}


@pytest.mark.parametrize(
    ("keys", "place", "message"),
    [
        ({"methods": "{MIX: {estimator: {kind: mixed, q: lagg}}}"}, "methods.MIX.estimator.q", "lag"),
        ({"reference": "{kind: constant, value: 1}"}, "reference", "regulates the state to 0"),
        (
            {"plant": '{kind: linear, A: [["1/(k - 15)"]], B: [[1]], C: [[1]]}',
             "model": "{from: plant, P_w: 1, P_v: 1}", "initial": "{x: 0, x_hat: 0, P: 1}"},
            "controller.horizon",
            "reaches k = 15, where the model's A has no value",
        ),
        (
            {"methods": "{MN: {estimator: {kind: set-membership, update: maksarov-norton}}}",
             "metrics": "[{kind: certificate, at: 1}]"},
            "metrics.0",
            "sets that do not depend on the data",
        ),
    ],
    ids=["estimator", "reference", "beyond-the-end", "certificate"],
)  # fmt: skip
def test_an_error_beside_a_controller_is_reported_once(tmp_path, keys, place, message):
    """Oracle: the one thing that is wrong, at its place; a law without its estimator is not blamed as well."""
    with pytest.raises(ConfigError) as refused:
        load_config(write_mixed(tmp_path, **(CONTROLLED | keys)))
    assert [problem.path for problem in refused.value.problems] == [place]
    assert message in refused.value.problems[0].message
