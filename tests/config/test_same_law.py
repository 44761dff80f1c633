"""The law `same` with a departure from the design model: moments, streams, hashes and messages."""

import numpy as np
import pytest
from conftest import EXACT, ROUND, STAT
from uncertain_experiment import write_estimation

from rmpc_bench import load_config
from rmpc_bench.config.same_law import SameLaw, SameOutliers
from rmpc_bench.types import ConfigError

COV = np.array([[4.0, 1.0], [1.0, 9.0]])
MEAN = np.array([1.0, -2.0])
MODEL = "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], C: [[1, 0]], P_w: [[4, 1], [1, 9]], P_v: 0.25, w_mean: [1, -2]}"
PLANT = "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], C: [[1, 0]]}"


@pytest.fixture
def load(tmp_path):
    """Return a function that loads an estimation experiment with a law of the process noise."""

    def make(law, **keys):
        keys = {
            "plant": PLANT,
            "model": MODEL,
            "methods": "{KF: {estimator: {kind: kalman}}}",
            "initial": "{P: 1}",
        } | keys
        return load_config(write_estimation(tmp_path, noise=f"{{process: {law}, measurement: same}}", **keys))

    return make


def drawn(config, runs=400, steps=50):
    """Return the process noise of some runs, (runs * steps, 2)."""
    experiment = config.experiment
    return experiment.scenario.draw(experiment.plant, range(runs), steps).w.reshape(-1, 2)


@pytest.mark.parametrize(
    ("law", "mean", "cov"),
    [
        (SameLaw(), MEAN, COV),
        (SameLaw(scale=3.0), MEAN, 9 * COV),
        (SameLaw(bias=0.5), MEAN + [1.0, 1.5], COV),
        (SameLaw(scale=2.0, bias=-1.0), MEAN - [4.0, 6.0], 4 * COV),
        (SameLaw(outliers=SameOutliers(0.05, 10.0)), MEAN, (0.95 + 0.05 * 100) * COV),
        (SameLaw(dof=3.0), MEAN, COV),
        (SameLaw(dof=5.0, scale=2.0, bias=1.0), MEAN + [4.0, 6.0], 4 * COV),
    ],
)
def test_moments(law, mean, cov):
    """Oracle: closed forms.  Student's t has the covariance of the model, outliers have a larger one."""
    noise = law.noise(MEAN, COV)
    np.testing.assert_allclose(noise.mean, mean, **ROUND)
    np.testing.assert_allclose(noise.cov, cov, **ROUND)


def test_sample_of_a_configuration(load):
    """From the YAML to the numbers: share of outliers and mean, within STAT standard errors."""
    clean = drawn(load("same"))
    bad = drawn(load("{same: {outliers: {probability: 5%, factor: 10}, bias: 0.5}}"))
    shift = np.array([1.0, 1.5])
    hit = np.abs((bad - MEAN - shift) - (clean - MEAN)).max(axis=1) > 1e-9
    share = hit.mean()
    assert abs(share - 0.05) < STAT * np.sqrt(0.05 * 0.95 / len(bad))
    # The other samples are those of `same`, shifted.
    np.testing.assert_allclose((bad - shift)[~hit], clean[~hit], rtol=0, atol=1e-12)  # of numbers up to 15
    np.testing.assert_allclose((bad - shift - MEAN)[hit], 10 * (clean - MEAN)[hit], **ROUND, atol=1e-11)


def test_nothing_changes_without_a_key(load):
    """The short form, an empty mapping and keys at their defaults are one law with one hash."""
    configs = [load(law) for law in ("same", "{same: {}}", "{same: {scale: 1, bias: 0}}")]
    assert len({config.hash for config in configs}) == 1
    assert configs[0].first_point["noise"]["process"] == {"same": {"scale": 1.0}}
    np.testing.assert_allclose(drawn(configs[0]), drawn(configs[2]), **EXACT)


def test_departures_are_in_the_hash_and_in_the_resolved_file(load, tmp_path):
    """And the resolved file loads as the same experiment."""
    from rmpc_bench.config_file.yaml import dump

    configs = [
        load(f"{{same: {{{keys}}}}}") for keys in ("bias: 1", "dof: 4", "outliers: {probability: 0.1, factor: 5}")
    ]
    assert len({config.hash for config in [*configs, load("same")]}) == 4
    for number, config in enumerate(configs):
        file = tmp_path / f"resolved-{number}.yaml"
        file.write_text(dump(config.resolved))
        assert load_config(file).hash == config.hash


@pytest.mark.parametrize(
    ("law", "where", "message"),
    [
        ("{same: {dof: 2}}", "noise.process.same.dof", "must be > 2"),
        ("{same: {dof: 3, outliers: {probability: 0.1, factor: 2}}}", "noise.process.same", "give outliers or dof"),
        ("{same: {outliers: {probability: 2, factor: 2}}}", "noise.process.same.outliers.probability", "must be <= 1"),
        ("{same: {outliers: {probability: 0.1}}}", "noise.process.same.outliers", "factor"),
        ("{same: {bais: 1}}", "noise.process.same", "bais"),
    ],
)
def test_mistakes(load, law, where, message):
    """Each is reported at its place."""
    with pytest.raises(ConfigError) as caught:
        load(law)
    assert where in str(caught.value) and message in str(caught.value)
