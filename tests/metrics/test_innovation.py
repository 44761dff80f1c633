"""Metrics of the innovation against closed forms and against the laws of a consistent filter."""

import re
from importlib import import_module

import numpy as np
import pytest
from conftest import ROUND, STAT
from uncertain_experiment import write_estimation

from rmpc_bench import load_config, registry, run
from rmpc_bench.metrics.innovation import InnovationMse, Nis, Whiteness
from rmpc_bench.types import ConfigError, Record, WindowMetric

PLANT = "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], B: [[0], [1]], C: [[1, 0]]}"
MODEL = "{from: plant, P_w: 0.04, P_v: 0.25}"
CONSISTENT = {
    "plant": PLANT,
    "model": MODEL,
    "noise": "{process: {gaussian: {cov: 0.04}}, measurement: {gaussian: {cov: 0.25}}}",
    "initial": "{x: {gaussian: {mean: [0, 0], cov: 1}}, P: 1}",
    "runs": "200",
    "time": "{steps: 200}",
    "metrics": "[nis, innovation_mse, whiteness]",
    "methods": "{KF: {estimator: {kind: kalman}}, slow: {estimator: {kind: kalman}, model: {P_w: 1e-4}}}",
}


def record(**info):
    n = len(next(iter(info.values()))[0])
    return Record.of_run(y=[0.0] * n)._replace(info={name: np.array(value) for name, value in info.items()})


def test_the_default_end_of_a_window_is_documented():
    """Every metric whose window ends at N says so itself, and no other one of its kind does."""
    metrics = [import_module(place.split(":")[0]) for place in registry.BUILT_IN["metrics"].values()]
    classes = {each for module in metrics for each in vars(module).values() if isinstance(each, type)}
    windows = {each for each in classes if issubclass(each, WindowMetric) and hasattr(each, "name")}
    says = {each.name for each in windows if re.search(r"0\.\.N(?!-)|N, the last one of the", each.__doc__)}
    assert says == {each.name for each in windows if each.to_the_end}


def test_nis_of_two_outputs_is_the_mean_mahalanobis_distance():
    rng = np.random.default_rng(3)
    e, root = rng.normal(size=(6, 2)), rng.normal(size=(6, 2, 2))
    S = root @ root.swapaxes(1, 2) + np.eye(2)
    expected = np.mean([row @ np.linalg.inv(matrix) @ row for row, matrix in zip(e, S, strict=True)]) / 2.0
    value = Nis().evaluate(record(e=e[None], S=S.reshape(1, 6, 4)))
    np.testing.assert_allclose(value, [expected], **ROUND)


def test_whiteness_of_one_output_is_hoskings_statistic():
    """A constant bias of the innovation has no effect."""
    e = np.random.default_rng(4).normal(size=80)
    centred = e - e.mean()
    r = [centred[lag:] @ centred[:-lag] / (centred @ centred) for lag in range(1, 6)]
    expected = [80**2 * np.sum(np.square(r) / (80 - np.arange(1, 6))) / 5]
    for bias in (0.0, 3.0):
        np.testing.assert_allclose(Whiteness(lags=5).evaluate(record(e=e[None, :, None] + bias)), expected, **ROUND)


@pytest.mark.parametrize("n", [40, 150])
def test_white_innovations_have_whiteness_1(n):
    """Mean over 400 runs of two outputs; without the divisor n - j it is 0.74 for 40 samples and 20 lags."""
    e = np.random.default_rng(5).normal(size=(400, n, 2)) @ np.array([[1.0, 0.4], [0.0, 2.0]])
    values = np.array([Whiteness(lags=20).evaluate(record(e=run[None])) for run in e])
    # The statistic itself has a bias of order 1/n.
    assert abs(values.mean() - 1.0) < STAT * values.std() / 20.0 + 0.5 / n


@pytest.mark.parametrize("metric", [InnovationMse(), Nis(), Whiteness(lags=2)], ids=lambda metric: metric.name)
def test_samples_without_a_measurement_are_left_out(metric):
    e, S = np.array([1.0, -2.0, 0.5, 3.0]), np.array([1.0, 2.0, 1.0, 4.0])
    gap = np.insert(e, 2, np.nan)
    with_gap = metric.evaluate(record(e=gap[None, :, None], S=np.insert(S, 2, 9.0)[None, :, None]))
    np.testing.assert_allclose(with_gap, metric.evaluate(record(e=e[None, :, None], S=S[None, :, None])), **ROUND)


def test_a_run_without_measurements_has_no_value():
    assert np.isnan(InnovationMse().evaluate(record(e=np.full((1, 3, 1), np.nan)))).all()


def test_a_consistent_filter_has_nis_1_white_innovations_and_the_mean_square_of_its_covariance(tmp_path):
    """Mean over 200 runs within 5 standard errors; a filter with too little process noise is overconfident."""
    config = load_config(write_estimation(tmp_path, **CONSISTENT))
    results = run(config, directory=tmp_path / "results", jobs=1)
    frame = results.trials.frame
    table = {name: group for name, group in frame.groupby("method")}
    consistent, slow = table["KF"], table["slow"]
    filter_ = config.experiment.method("KF").estimator
    for column, expected in (("nis", 1.0), ("innovation_mse", filter_.S.mean())):
        values = consistent[column]
        assert abs(values.mean() - expected) < STAT * values.std() / np.sqrt(len(values))
    assert abs(consistent["whiteness"].mean() - 1.0) < 0.1
    assert slow["nis"].mean() > 1.5
    assert slow["whiteness"].mean() > 2.0 * consistent["whiteness"].mean()


def test_estimators_that_are_the_kalman_filter_have_its_innovations(tmp_path):
    """Also where measurements are missing, and in the predictor, whose x_hat is the prediction."""
    kinds = {
        "KF": "kalman",
        "predictor": "kalman-predictor",
        "disturbance": "kalman-disturbance, D0: 0, drift: 0",
        "linear": "moving-horizon, window: 4",
        "nonlinear": "nonlinear-moving-horizon, window: 4",
    }
    methods = ", ".join(f"{name}: {{estimator: {{kind: {kind}}}}}" for name, kind in kinds.items())
    measured = "{sum: [{gaussian: {cov: 0.25}}, {missing: {probability: 10%}}]}"
    keys = {"methods": f"{{{methods}}}", "runs": "4", "time": "{steps: 60}",
            "noise": f"{{process: {{gaussian: {{cov: 0.04}}}}, measurement: {measured}}}"}  # fmt: skip
    config = load_config(write_estimation(tmp_path, **(CONSISTENT | keys)))
    frame = run(config, directory=tmp_path / "results", jobs=1).trials.frame
    table = {name: group[["nis", "innovation_mse", "whiteness"]].to_numpy() for name, group in frame.groupby("method")}
    assert np.isfinite(table["KF"]).all()
    for name in kinds:
        np.testing.assert_allclose(table[name], table["KF"], **ROUND, err_msg=name)


def test_an_estimator_that_reports_no_covariance_of_the_innovation_is_named(tmp_path):
    methods = "{ERP: {estimator: {kind: enhanced-robust, rule: state, gamma: 5}}}"
    with pytest.raises(ConfigError, match=r"needs the covariance S of the innovation, .* 'ERP' does not report"):
        load_config(write_estimation(tmp_path, metrics="[nis]", methods=methods))


def test_more_lags_than_samples_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"metrics.0.lags: must be smaller than the 13 samples"):
        keys = {"time": "{steps: 12}", "metrics": "[{kind: whiteness, lags: 13}]"}
        load_config(write_estimation(tmp_path, **(CONSISTENT | keys)))
