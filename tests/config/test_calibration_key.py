"""The key `calibration`: what it adds, what identifies trials, and what is refused."""

from pathlib import Path

import pytest
from calibrated_experiment import keys, write

from rmpc_bench import load_config
from rmpc_bench.config_file.yaml import load
from rmpc_bench.types import ConfigError
from rmpc_bench.types.metric import CalibrationKeys

NAMES = [f"coverage_{p}{of}" for of in ("", "_x_0", "_x_1") for p in (50, 90, 95)]


def names(config):
    """Names of the metrics of a configuration."""
    return [metric.name for metric in config.experiment.metrics]


def test_it_adds_shares_of_all_states_and_of_each(tmp_path):
    """Oracle: inference.md, C1; a configuration without the key has none of them and no such key."""
    config = load_config(write(tmp_path))
    assert names(config) == ["estimation_mse", *NAMES] and config.primary == "estimation_mse"
    assert [each["kind"] for each in config.resolved["metrics"]] == ["estimation_mse"]
    assert config.resolved["calibration"] == {"levels": [0.5, 0.9, 0.95], "verdict": 0.9, "margin": 0.1}
    assert config.calibration == CalibrationKeys()
    for without in (None, False):
        plain = load_config(keys(calibration=without))
        assert names(plain) == ["estimation_mse"] and "calibration" not in plain.resolved
        assert plain.hash == config.hash and plain.points[0].method_keys == config.points[0].method_keys
        assert plain.points[0].metric_keys.items() <= config.points[0].metric_keys.items()


def test_the_set_of_the_suite_has_no_calibration_and_takes_it():
    """Oracle: the command in docs/suite.md."""
    place = Path(__file__).parents[2]
    assert "calibration" not in load(place / "configs/suite/suite-1.yaml")
    assert "suite-1.yaml -s calibration=true" in (place / "docs/suite.md").read_text(encoding="utf-8")
    overrides = ["methods={KF: {estimator: {kind: kalman}}}", "statistics={}", "calibration=true"]
    overrides.append("sweep={zip: [{name: one, plant.from: ../benchmarks/sayed2001.yaml}]}")
    assert load_config(place / "configs/suite/suite-1.yaml", overrides=overrides).calibration is not None


def test_the_resolved_configuration_loads_to_an_equal_one():
    """Oracle: the rule of every key; a smoke run cuts the start."""
    given = {"levels": ["50%", "80%"], "verdict": "80%", "margin": "20%", "from": 10}
    config = load_config(keys(calibration=given))
    again = load_config(dict(config.resolved))
    assert again.calibration == config.calibration == CalibrationKeys([0.5, 0.8], 0.8, 0.2, 10)
    assert names(again) == names(config) and names(config)[1:3] == ["coverage_50", "coverage_80"]
    assert again.points[0].metric_keys == config.points[0].metric_keys
    window = config.experiment.metrics[1].window(config.experiment.metric_layout)
    assert (window.first, window.last) == (10, 59)
    smoke = load_config(keys(calibration={"from": 50}), smoke=True)
    assert smoke.resolved["calibration"]["from"] == 19
    assert load_config(dict(smoke.resolved)).points[0].metric_keys == smoke.points[0].metric_keys


def test_only_what_is_computed_in_the_run_identifies_it():
    """Oracle: verdict and margin change no key of a metric; levels and start do."""

    def found(**given):
        return load_config(keys(calibration=given)).points[0].metric_keys

    first = found()
    assert found(verdict="95%", margin="5%") == first
    assert found(levels=["90%"]).items() < first.items()
    assert set(found(**{"from": 5}).values()).isdisjoint({first[name] for name in NAMES})


def test_one_state_has_no_shares_of_its_own():
    """Oracle: the share of all states is that of the only one."""
    one = {"kind": "linear", "A": [[0.9]], "B": [[1.0]], "C": [[1.0]]}
    config = load_config(
        keys(
            plant=one,
            model={**one, "P_w": 0.1, "P_v": 0.1},
            methods={"KF": {"estimator": {"kind": "kalman"}}},
        )
    )
    assert names(config)[1:] == ["coverage_50", "coverage_90", "coverage_95"]


WITHOUT = {"none": {"estimator": {"kind": "h-infinity", "theta": 0.01}}}


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"calibration": {"verdict": "80%"}}, "calibration.verdict: 80% is not among levels [50%, 90%, 95%]"),
        ({"methods": WITHOUT}, "calibration: no method reports a covariance P"),
        ({"calibration": {"levels": ["90%", "0.9"]}}, "calibration.levels: must name each level once (got [90%, 90%])"),
        ({"evaluate": "moments"}, "calibration: counts errors of runs, but no runs are evaluated"),
        ({"calibration": {"from": 60}}, "calibration: the window from 60 to 59 (samples)"),
        ({"calibration": {"level": "90%"}}, "calibration.level: 'level' is not a known key; did you mean 'levels'?"),
        ({"calibration": {"levels": []}}, "calibration.levels: "),
        ({"calibration": {"levels": [1.5], "verdict": 1.5}}, "calibration.levels.0: "),
        ({"calibration": {"margin": 0}}, "calibration.margin: "),
        ({"calibration": "yes"}, "calibration: "),
        (
            {"metrics": ["mse", {"kind": "coverage", "name": "coverage_90"}]},
            "calibration: 'coverage_90' is given twice",
        ),
        ({"metrics": [{"kind": "crps", "of": "x.7"}]}, "metrics.0.of: there is no x.7: choose x.0 to x.1"),
        (
            {"plant": {"kind": "linear", "A": [[1.0]], "B": [[1.0]], "C": [[1.0]]}, "noise": "none", "initial": {}},
            "calibration: x_hat of method 'KF' has 2 components and x of the plant 1",
        ),
    ],
)
def test_what_is_refused(tmp_path, others, message):
    """Oracle: inference.md, E, and the rules of keys; each error once, with its place."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, **others))
    found = [f"{problem.path}: {problem.message}" for problem in caught.value.problems]
    assert len([text for text in found if text.startswith(message)]) == 1, found
    assert all(problem.line > 1 or "calibration" not in problem.path for problem in caught.value.problems)


def test_estimators_with_a_bound_say_so():
    """Oracle: the docstrings of the filters; their P is an upper bound for any F, that of the others is not."""
    methods = {
        "KF": {"estimator": {"kind": "kalman-predictor", "R": 1.0}},
        "ERP": {"estimator": {"kind": "enhanced-robust", "rule": "error", "eps": 0.1}},
        "robust-H": {"estimator": {"kind": "robust-h-infinity", "theta": 1e-4, "alpha": 20}},
        "Sayed": {"estimator": {"kind": "sayed-bdu", "R": 1.0, "form": "predictor"}},
    }
    uncertain = {
        **{"kind": "uncertain-linear", "A": [[0.5, 0.1], [0.0, 0.6]], "Bw": 1, "C": [[1, 0]], "Dv": 1},
        **{"H_A": [[0.1], [0.0]], "G_x": [[0, 1]], "uncertainty": {"law": "uniform"}},
    }
    given = {"plant": uncertain, "model": {"from": "plant", "W": 1.0, "V": 1.0}, "methods": methods}
    found = {each.name: each.estimator.P_is for each in load_config(keys(**given)).experiment.methods}
    assert found == {"KF": "covariance", "ERP": "bound", "robust-H": "bound", "Sayed": "covariance"}
