"""Noise laws in configurations: keys, mistakes at their place, what a law excludes, and trials of any block size."""

import numpy as np
import pandas as pd
import pytest
from required_keys import REQUIRED, sampled
from small_experiment import cli, ran, write
from uncertain_experiment import write_estimation

from rmpc_bench import estimator, load_config, registry
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.noise import correlated, measurement
from rmpc_bench.noise.bounded import corners, ellipsoid
from rmpc_bench.noise.gaussian import gaussian, outliers, student_t
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import ConfigError

BURSTS = [Burst(0.2, 0.5, 3.0)]
AS_YAML = "bursts: [{from: 0.2, to: 0.5, factor: 3}]"
LAWS = [
    ("{student-t: {dof: 3, scale: 10}}", student_t(1, dof=3.0, scale=10.0)),
    (
        "{outliers: {std: 10, probability: 10%, factor: 10}}",
        outliers(1, std=10.0, probability=0.1, factor=10.0),
    ),
    ("{drift: {std: 0.1, start: 2}}", correlated.drift(1, std=0.1, start=2.0)),
    ("{coloured: {std: 0.1, time: 0.5}}", correlated.coloured(1, 0.1, std=0.1, time=0.5)),
    ("{coloured: {std: 0.1, pole: 0.9}}", correlated.coloured(1, 0.1, std=0.1, pole=0.9)),
    ("{quantised: {step: 2*pi/4096}}", measurement.quantised(1, step=2 * np.pi / 4096)),
    ("{missing: {probability: 20%, gap: 3}}", measurement.missing(1, probability=0.2, gap=3.0)),
    (f"{{gaussian: {{std: 2, {AS_YAML}}}}}", gaussian(1, 0.1, std=2.0, bursts=BURSTS)),
    (f"{{corners: {{radius: 2, {AS_YAML}}}}}", corners(1, 0.1, radius=2.0, bursts=BURSTS)),
    (f"{{ellipsoid: {{shape: 2, {AS_YAML}}}}}", ellipsoid(1, 0.1, shape=2.0, bursts=BURSTS)),
    (f"{{drift: {{std: 2, {AS_YAML}}}}}", correlated.drift(1, 0.1, std=2.0, bursts=BURSTS)),
    (f"{{coloured: {{std: 2, pole: 0.5, {AS_YAML}}}}}", correlated.coloured(1, 0.1, std=2.0, pole=0.5, bursts=BURSTS)),
    (
        f"{{student-t: {{dof: 3, scale: 2, {AS_YAML}}}}}",
        student_t(1, 0.1, dof=3.0, scale=2.0, bursts=BURSTS),
    ),
]


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the small experiment with some keys replaced."""
    return lambda **keys: load_config(write(tmp_path, **keys))


def problems(load, **keys):
    """Return what is wrong with a configuration, each without its file."""
    with pytest.raises(ConfigError) as caught:
        load(**keys)
    return [f"{problem.line}:{problem.column}: {problem.path}: {problem.message}" for problem in caught.value.problems]


@pytest.mark.parametrize(("yaml", "law"), LAWS, ids=[yaml for yaml, _ in LAWS])
def test_laws_as_a_configuration_writes_them(load, yaml, law):
    """Oracle: the law made by hand; what is written back loads to the same data and hash."""
    config = load(noise=f"{{measurement: {yaml}}}")
    [made] = config.experiment.scenario.measurement
    for seed in range(2):
        np.testing.assert_array_equal(*(each.draw(np.random.default_rng(seed), 11) for each in (made, law)))
    assert (made.alters_output, made.omits_measurements) == (law.alters_output, law.omits_measurements)
    copy = config.path.with_name("config.resolved.yaml")
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert again.resolved == config.resolved and again.hash == config.hash


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ("{outliers: {std: 1, probability: 1.2, factor: 2}}", "outliers.probability: must be <= 1 (got 1.2)"),
        ("{outliers: {std: 1, probability: 0.1}}", "outliers: 'factor' is missing"),
        ("{outliers: {probability: 0.1, factor: 2}}", "outliers: give either std or cov"),
        ("{student-t: {dof: 0.5, scale: 1}}", "student-t.dof: must be >= 1 (got 0.5)"),
        ("{student-t: {dof: 3, std: 1}}", "student-t.std: 'std' is not a known key"),
        ("{student-t: {dof: 3}}", "student-t: give either scale or scale_matrix"),
        ("{coloured: {std: 1, pole: 1}}", "coloured.pole: must be < 1 (got 1)"),
        ("{coloured: {std: 1}}", "coloured: give either time or pole"),
        ("{drift: {std: -1}}", "drift.std: must be >= 0 (got -1)"),
        ("{quantised: {step: 0}}", "quantised.step: must be > 0 (got 0)"),
        ("{gaussian: {density: null}}", "gaussian: give one of std, cov and density"),
        ("{missing: {every: 10000000000000000000000000}}", "missing.every: must be <= 1000000000 (got 1"),
        ("{missing: {every: 4, first: 1000000000000}}", "missing.first: must be less than `every`"),
        ("{missing: {probability: -1%}}", "missing.probability: must be >= 0 (got '-1%')"),
        ("{missing: {probability: 0.9, gap: 2}}", "missing.gap: with the probability 0.9 the mean gap is at least 9"),
        ("{missing: {probability: 0.9, gap: 0.5}}", "missing.gap: must be >= 1 (got 0.5)"),
        ("{student: {dof: 3, scale: 1}}", "did you mean 'student-t'?"),
    ],
)
def test_mistakes(load, law, message):
    """Oracle: one mistake each, at its place in the file."""
    [found] = problems(load, noise=f"{{measurement: {law}}}")
    assert message in found and found.startswith("9:")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"noise": "{process: {quantised: {step: 1}}}"}, "process.quantised: 'quantised' alters a signal; put it"),
        ({"noise": "{process: {sum: [{missing: {probability: 0.1}}]}}"}, "process.sum.0.missing: 'missing' alters a"),
        ({"initial": "{x: {quantised: {step: 1}}}"}, "initial.x.quantised: 'quantised' alters a signal"),
        ({"initial": "{x: {drift: {std: 1}}}"}, "initial.x.drift: an initial state is a single sample"),
        ({"initial": "{x: {coloured: {std: 1, pole: 0.5}}}"}, "initial.x.coloured: an initial state is a single"),
        (
            {"initial": "{x: {gaussian: {std: 1, bursts: [{from: 0, to: 1, factor: 2}]}}}"},
            "initial.x.gaussian.bursts: an initial state has no bursts",
        ),
    ],
)
def test_laws_that_do_not_fit_a_channel(load, keys, message):
    """Oracle: one mistake each, at the law."""
    [found] = problems(load, **keys)
    assert message in found


def test_estimators_that_do_not_bridge_are_named(load):
    """Oracle: the method whose lam is searched with all outputs, and not the others."""
    methods = "{KF: {estimator: {kind: kalman}}, SM: {estimator: {kind: sayed-bdu, lam: search}}}"
    [found] = problems(load, noise="{measurement: {missing: {probability: 0.1}}}", methods=methods)
    assert "noise.measurement: omits measurements, and the estimator of 'SM' cannot predict" in found
    assert found.startswith("9:") and "'KF'" not in found and "robust-kalman" in found


def test_every_kind_that_the_message_names_bridges():
    """Oracle: the designs of these kinds, as far as a linear model has no further keys."""
    assert set(registry.BRIDGING) <= set(registry.names("estimators"))
    model = LinearModel(np.array([[0.9]]), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)))
    keys = REQUIRED | dict.fromkeys(("mixed", "set-membership"), {"M0": np.eye(1)})
    start = {"x0": np.zeros(1), "P0": np.eye(1)}
    for kind in set(registry.BRIDGING) - {"oracle", "lmmse", "lp-window", "control-lqe"}:
        assert estimator(kind, model, n_steps=3, **start, **sampled(kind), **keys.get(kind, {})).bridges_missing, kind


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        ("{coloured: {std: 1, pole: 0.9}}", "a law of noise is correlated over time, so it is not white"),
        ("{drift: {std: 1}}", "a law of noise is correlated over time, so it is not white"),
        ("{sum: [{gaussian: {std: 1}}, {quantised: {step: 1}}]}", "a law alters the measurements"),
        ("{student-t: {dof: 2, scale: 1}}", "the moments of a law of noise are not known"),
    ],
)
def test_exact_moments_are_refused(tmp_path, law, reason):
    """Oracle: they need white noise with a mean and a covariance."""
    noise = f"{{process: {{gaussian: {{std: 1}}}}, measurement: {law}}}"
    result = cli("check", write_estimation(tmp_path, noise=noise, evaluate="moments"))
    assert result.exit_code == 2 and reason in result.stderr


def test_exact_moments_of_heavy_tails_are_those_of_normal_noise(tmp_path):
    """Oracle: normal noise of the same covariance."""
    laws = ("{outliers: {std: 1, probability: 0.2, factor: 3}}", "{student-t: {dof: 4, scale: 2}}")
    for law, power in zip(laws, (0.8 + 0.2 * 9.0, 8.0), strict=True):
        noise = f"{{process: {{gaussian: {{std: 1}}}}, measurement: {law}}}"
        scenario = load_config(write_estimation(tmp_path, noise=noise, evaluate="moments")).experiment.scenario
        mean, cov = scenario.noise_laws(1, 1)
        np.testing.assert_allclose(cov, np.diag([1.0, power]), rtol=1e-12)
        np.testing.assert_array_equal(mean, 0.0)


ALL = (
    "{process: {sum: [{drift: {std: 0.001}}, {coloured: {std: 0.01, time: 0.3}}]}, measurement: {sum: "
    "[{student-t: {dof: 3, scale: 0.01}}, {outliers: {std: 0.01, probability: 0.1, factor: 10, bursts: "
    "{within: [[0, 0.5]], duration: 0.2, factor: [2, 3]}}}, {quantised: {step: 0.001}}, "
    "{missing: {probability: 0.2}}]}}"
)


def test_trials_do_not_depend_on_blocks_workers_and_shards(tmp_path):
    """Oracle: the bytes of one worker and one block."""
    one = ran(write(tmp_path, noise=ALL), tmp_path / "one")
    path = write(tmp_path, noise=ALL, execution="{block: 2}")
    assert ran(path, tmp_path / "two", jobs=2) == one
    for number in (1, 2):
        options = ("--progress", "none", "--shard", f"{number}/2")
        assert cli("run", path, "-o", tmp_path / "shards", "-j", 1, *options).exit_code == 0
    assert cli("merge", tmp_path / "shards").exit_code == 0
    assert (tmp_path / "shards" / "trials.csv").read_bytes() == one
    table = pd.read_csv(tmp_path / "one" / "trials.csv")
    assert (table["status"] == "ok").all() and len(table) == 12


def test_a_run_can_be_shown(tmp_path):
    """Oracle: the metrics that are stored of it."""
    path = write(tmp_path, noise=ALL)
    ran(path, tmp_path / "out")
    result = cli("show", tmp_path / "out", "--run", 2, "--method", "R-MPC")
    assert result.exit_code == 0, result.output
    stored = pd.read_csv(tmp_path / "out" / "trials.csv").query("run == 2 and method == 'R-MPC'")["mse"].item()
    assert f"{stored:.4g}" in result.stdout


def test_laws_that_alter_measurements_have_the_size_of_y(tmp_path):
    """Oracle: a plant with one output and two measurement noises."""
    plant = "{kind: uncertain-linear, A: [[0.9, 0.2], [0, 0.7]], Bw: [[1], [0.5]], C: [[1, 0]], Dv: [[1, 0.5]]}"
    noise = "{measurement: {sum: [{gaussian: {std: 1}}, {quantised: {step: [0.5]}}, {missing: {probability: 0.1}}]}}"
    path = write_estimation(tmp_path, plant=plant, noise=noise, methods="{KF: {estimator: {kind: kalman-predictor}}}")
    experiment = load_config(path).experiment
    draws = experiment.scenario.draw(experiment.plant, range(2), 4)
    assert draws.v.shape == (2, 5, 2) and [each.drawn.shape for each in draws.alterations] == [(2, 5, 1)] * 2
