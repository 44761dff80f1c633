"""The scale of the uncertainty: laws, identity, pairing and messages."""

import numpy as np
import pytest
from conftest import ROUND
from small_experiment import write

from rmpc_bench import load_config
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.noise.distributions import Choice, Fixed, Normal, Uniform
from rmpc_bench.types import ConfigError

LAWS = (
    (Uniform(-0.1, 0.3), 0.1),
    (Normal(0.2, 1.0, truncate=2.0), 1.0),
    (Choice((1.0, 2.0, 6.0)), 3.0),
    (Fixed(0.4), 0.4),
)


def loaded(tmp_path, uncertainty, **keys):
    """A small configuration with these uncertain quantities; a key that is None is as in the small experiment."""
    given = {name: value for name, value in keys.items() if value is not None}
    return load_config(write(tmp_path, uncertainty=uncertainty, **given))


@pytest.mark.parametrize(("law", "centre"), LAWS)
@pytest.mark.parametrize("factor", [0.0, 0.5, 1.0, 3.0])
def test_every_quantile_moves_about_the_centre(law, centre, factor):
    """The same uniform number gives the centre plus the factor times the deviation, so that points are paired."""
    p = np.array([0.0, 0.1, 0.3, 0.5, 0.77, 0.999])
    expected = centre + factor * (np.array([law.quantile(each) for each in p]) - centre)
    np.testing.assert_allclose([law.scaled(factor).quantile(each) for each in p], expected, **ROUND, atol=1e-15)
    assert law.scaled(1.0) == law


def test_scale_one_changes_nothing(tmp_path):
    """Neither the identity of the experiment nor what is written."""
    plain_one, one = loaded(tmp_path, "{eps: +-20%}"), loaded(tmp_path, "{eps: +-20%, scale: 1}")
    assert (one.hash, one.resolved) == (plain_one.hash, plain_one.resolved)
    assert loaded(tmp_path, "{eps: +-20%, scale: 2}").hash != one.hash


def test_a_scaled_range_is_the_same_experiment_as_the_wider_one(tmp_path):
    """20 % at scale 2 has the values of 40 %, and they share their trials."""
    scaled, wider = loaded(tmp_path, "{eps: +-20%, scale: 2}"), loaded(tmp_path, "{eps: +-40%}")
    assert scaled.hash == wider.hash
    values = [config.experiment.scenario.named_values(3)["eps"] for config in (scaled, wider)]
    assert values[0] == values[1] != 0


def test_what_is_written_loads_as_the_same_experiment(tmp_path):
    """The scale stands beside the laws as they were given."""
    config = loaded(tmp_path, "{eps: +-20%, scale: 1.5}")
    assert config.resolved["uncertainty"]["scale"] == 1.5
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    assert load_config(copy).hash == config.hash


def test_a_sweep_over_the_scale(tmp_path):
    """Runs of all points are paired; the written sweep loads as the same experiment."""
    config = loaded(tmp_path, "{eps: +-20%}", sweep="{grid: {uncertainty.scale: [0.5, 1, 2]}}")
    values = [point.experiment.scenario.named_values(0)["eps"] for point in config.points]
    np.testing.assert_allclose(values, np.array([0.5, 1, 2]) * values[1], **ROUND)
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert [point.experiment.scenario.uncertainty for point in again.points] == [
        point.experiment.scenario.uncertainty for point in config.points
    ]


@pytest.mark.parametrize(
    ("uncertainty", "words"),
    [
        ("{eps: +-20%, scale: +-10%}", "choose another name for a quantity"),
        ("{eps: +-20%, scale: {dist: normal, std: 1}}", "choose another name for a quantity"),
        ("{eps: +-20%, scale: -1}", "a number >= 0 (got -1)"),
        ("{scale: 2}", "no uncertain quantity is named"),
    ],
)
def test_what_is_refused(tmp_path, uncertainty, words):
    """With the place of the key."""
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, uncertainty, plant=None if "eps" in uncertainty else "{kind: servo-linear}")
    (problem,) = caught.value.problems
    assert problem.path == "uncertainty.scale"
    assert words in problem.message


def test_the_scale_is_no_name_in_expressions(tmp_path):
    """It is not a quantity that a parameter may depend on."""
    with pytest.raises(ConfigError, match="unknown name 'scale'"):
        loaded(tmp_path, "{eps: +-20%, scale: 2}", plant="{kind: servo-linear, perturb: {J_l: 1 + scale}}")
