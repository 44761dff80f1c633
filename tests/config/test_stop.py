"""The section `stop`: its errors, its defaults, and the number of runs that follows from it."""

import pytest
from small_experiment import write

from rmpc_bench import load_config
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.types import ConfigError

CLAIM = '[{says: s, source: additional result, check: "mean(mse[R-MPC]) < mean(mse[S-MPC])"}]'


@pytest.mark.parametrize(
    ("stop", "message"),
    [
        ("{max_runs: 50}", "stop: give either resolve (a relative half width) or decide (claims)"),
        ("{resolve: 2%, decide: claims, max_runs: 50}", "stop: give either resolve"),
        ("{resolve: 2%}", "stop: 'max_runs' is missing"),
        ("{resolve: 0, max_runs: 50}", "stop.resolve: must be > 0 (got 0)"),
        ("{decide: verdicts, max_runs: 50}", "stop.decide: must be 'claims' (got 'verdicts')"),
        ("{decide: claims, every: 50, max_runs: 50}", "stop: every belongs to resolve"),
        ("{decide: claims, max_runs: 50}", "stop.decide: this configuration has no claim with a check"),
        ("{resolve: 2%, max_runs: 5}", "at the first look, runs: 6 (got 5)"),
        ("{resolve: 2%, min_runs: 9, max_runs: 8}", "at the first look, min_runs: 9 (got 8)"),
        ("{resolve: 2%, max_run: 8}", "did you mean 'max_runs'?"),
    ],
)
def test_errors(tmp_path, stop, message):
    """Each at its place."""
    with pytest.raises(ConfigError) as error:
        load_config(write(tmp_path, stop=stop))
    assert message in str(error.value) and "tiny.yaml:16:" in str(error.value)


def test_exact_moments_need_no_rule(tmp_path):
    """Nothing is computed run by run."""
    path = write(tmp_path, stop="{resolve: 2%, max_runs: 50}", evaluate="moments")
    with pytest.raises(ConfigError, match="nothing is computed run by run here"):
        load_config(path)


@pytest.mark.parametrize("stop", ["{resolve: 2%, max_runs: 50}", "{decide: claims, min_runs: 9, max_runs: 50}"])
def test_the_resolved_configuration_has_the_same_rule(tmp_path, stop):
    """Its defaults are filled in, and it names the runs at the first look."""
    config = load_config(write(tmp_path, stop=stop, claims=CLAIM))
    resolved = tmp_path / "resolved.yaml"
    resolved.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(resolved)
    assert again.stop == config.stop and again.experiment.n_runs == config.experiment.n_runs == 50
    assert config.resolved["runs"] == config.stop.first_look == (6 if "resolve" in stop else 9)


def test_the_rule_is_no_part_of_the_experiment(tmp_path):
    """Trials are kept where a rule is added or changed."""
    without, with_rule = (
        write(tmp_path, file="a.yaml"),
        write(tmp_path, file="b.yaml", stop="{resolve: 2%, max_runs: 9}"),
    )
    assert load_config(without).full_hash == load_config(with_rule).full_hash


def test_a_given_number_of_runs_has_no_rule(tmp_path):
    """Of --runs and --smoke."""
    path = write(tmp_path, stop="{resolve: 2%, max_runs: 50}")
    by_hand, smoke = load_config(path, runs=7), load_config(path, smoke=True)
    assert (by_hand.stop, by_hand.experiment.n_runs) == (None, 7)
    assert (smoke.stop, smoke.experiment.n_runs) == (None, 4)
