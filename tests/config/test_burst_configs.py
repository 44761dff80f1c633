"""Bursts in configurations: their keys, what identifies them, what is stored of them, and metrics that need them."""

import numpy as np
import pandas as pd
import pytest
from small_experiment import cli, ran, write
from uncertain_experiment import write_estimation

from rmpc_bench import load_config
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.noise.bounded import uniform
from rmpc_bench.noise.bursts import RandomBursts
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import ConfigError

FIXED = "[{from: 0.2, to: 3*0.1, factor: 200%}, {from: 0.7, to: 5, factor: 3}]"
RANDOM = "{within: [[0, 0.4], [0.5, 1]], duration: [0.1, 0.3], factor: [1.5, 3]}"
STEADY = "{uniform: {radius: 0.01}}"
METRICS = (
    "[mse, {kind: tracking, during: bursts, memory: 0.1, unit: mrad}, {kind: departures, smooth: 0.1, apart: 0.2}]"
)


def noise(bursts, channel="measurement"):
    """Noise with bursts, as YAML."""
    return f"{{{channel}: {{uniform: {{radius: 0.01, bursts: {bursts}}}}}}}"


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the small experiment with some keys replaced."""
    return lambda **keys: load_config(write(tmp_path, **keys))


def problems(load, **keys):
    """Return what is wrong with a configuration, each without its file."""
    with pytest.raises(ConfigError) as caught:
        load(**keys)
    return [f"{problem.line}:{problem.column}: {problem.path}: {problem.message}" for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("yaml", "bursts"),
    [
        (FIXED, [Burst(0.2, 0.3, 2.0), Burst(0.7, 5.0, 3.0)]),
        (RANDOM, RandomBursts([(0.0, 0.4), (0.5, 1.0)], (0.1, 0.3), (1.5, 3.0))),
        ("{within: [[0, 0.4]], duration: 0.2, factor: 2}", RandomBursts([(0.0, 0.4)], 0.2, 2.0)),
    ],
)
def test_bursts_as_a_configuration_writes_them(load, yaml, bursts):
    """Oracle: the law made by hand, with the step of the experiment; they load again as they are written back."""
    config = load(noise=noise(yaml))
    scenario, law = config.experiment.scenario, uniform(1, 0.1, radius=0.01, bursts=bursts)
    for seed in range(3):
        made, by_hand = (each.draw(np.random.default_rng(seed), 11) for each in (*scenario.measurement, law))
        np.testing.assert_array_equal(made, by_hand)
    copy = config.path.with_name("config.resolved.yaml")
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert again.resolved == config.resolved and again.hash == config.hash


def test_every_word_of_bursts_is_in_the_hash(load):
    """Oracle: another number, another experiment; keys that are not given leave the hash of stored trials."""
    texts = [FIXED, FIXED.replace("0.7", "0.6"), FIXED.replace("200%", "2.5"), FIXED.replace("5", "6"), RANDOM]
    texts += [RANDOM.replace("0.3", "0.2"), RANDOM.replace("[1.5, 3]", "2"), RANDOM.replace("[0, ", "[0.1, ")]
    steady = load(noise=f"{{measurement: {STEADY}}}")
    hashes = {load(noise=noise(text)).hash for text in texts} | {steady.hash}
    hashes |= {load(noise="{measurement: {uniform: {radius: 0.01, mix: 2}}}").hash}
    assert len(hashes) == len(texts) + 2
    assert steady.points[0].shared["noise"]["measurement"] == {"uniform": {"radius": 0.01, "center": 0.0}}


def test_where_stored_values_of_bursts_belong(load):
    """Oracle: to the noise and the step where something is drawn, else to the seed and the named quantities alone."""

    def key(**keys):
        return load(**keys).points[0].uncertainty_key

    assert key() == key(noise=noise(FIXED)) == key(noise="none")
    drawn = {"noise": noise(RANDOM)}
    other = {"noise": noise(RANDOM.replace("0.4", "0.3"))}
    assert len({key(), key(**drawn), key(**other), key(**drawn, time="{step: 0.05, steps: 20}")}) == 4


def test_random_bursts_are_stored(tmp_path):
    """Oracle: the scenario's own values, run by run, beside the named quantities; any number of workers."""
    path = write(tmp_path, noise=noise(RANDOM), metrics=METRICS, execution="{block: 4}")
    one, two = (ran(path, tmp_path / f"j{jobs}", jobs=jobs) for jobs in (1, 2))
    assert one == two
    # pandas below 3.1 reads numbers with a rounding error in the last digit.
    table = pd.read_csv(tmp_path / "j1" / "uncertainty.csv", dtype=str).astype(float).astype({"run": int})
    scenario = load_config(path).experiment.scenario
    assert [*table.columns] == ["run", "eps", *sorted(scenario.burst_names)]
    for run, row in table.set_index("run").iterrows():
        expected = scenario.named_values(run) | scenario.burst_values(run)
        assert row.to_dict() == expected
    trials = pd.read_csv(tmp_path / "j1" / "trials.csv")
    assert len(trials) == 12 and trials["tracking"].notna().all() and (trials["status"] == "ok").all()


@pytest.mark.parametrize(
    ("bursts", "message"),
    [
        ("[{from: 0.5, to: 0.2, factor: 2}]", "noise.measurement.uniform.bursts.0.to: must not be before from, 0.5"),
        ("[{from: 0, to: 1, factor: -2}]", "noise.measurement.uniform.bursts.0.factor: must be >= 0 (got -2)"),
        ("[{from: 0, to: 1, factor: 2}, {from: 0, factor: 1}]", "noise.measurement.uniform.bursts.1: 'to' is missing"),
        (
            "[{from: 0, to: 1, factor: 2, fctor: 2}]",
            "bursts.0.fctor: 'fctor' is not a known key; did you mean 'factor'?",
        ),
        ("{within: [[0, 0.2]], duration: [0.1, 0.3], factor: 2}", "bursts.within.0: from 0 to 0.2 there is no room"),
        ("{within: [[0, 0.2, 3]], duration: 0, factor: 2}", "bursts.within.0: "),
        ("{within: [[0, 0.2]], duration: [0.2, 0.1], factor: 2}", "bursts.duration: the range must begin with its"),
        ("{within: [], duration: 0, factor: 2}", "bursts.within: contains no window"),
        ("{within: [[0, 0.2]], duration: 0, factor: [1, -1]}", "bursts.factor.1: must be >= 0 (got -1)"),
        ("{within: [[0, 0.2]], duration: 0}", "noise.measurement.uniform.bursts: 'factor' is missing"),
        ("3", "noise.measurement.uniform.bursts: expected a list or a mapping (got 3)"),
    ],
)
def test_mistakes_of_bursts(load, bursts, message):
    """Oracle: one mistake each, at its place in the file."""
    [found] = [line for line in problems(load, noise=noise(bursts)) if "bursts" in line]
    assert message in found and found.startswith("9:")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"metrics": METRICS}, "metrics.1.during: 'bursts' needs bursts of the measurement noise"),
        ({"metrics": METRICS, "noise": noise(FIXED, "process")}, "metrics.1.during: 'bursts' needs bursts"),
        ({"metrics": "[{kind: tracking, unit: mm}]"}, "metrics.0.unit: must be rad or mrad, a thousandth of it"),
        ({"metrics": "[{kind: tracking, only: [1]}]"}, "metrics.0.only: there is no y.1: the plant has 1"),
        ({"metrics": "[{kind: reported, of: Q_yw}]"}, "metrics.0.of: 'Q_yw' is not reported by 'S-MPC' (which reports"),
        ({"metrics": "[near_singular]"}, "metrics.0: needs a plant with singular poses"),
        ({"initial": "{x: {uniform: {radius: 1, bursts: [{from: 0, to: 1, factor: 2}]}}}"},
         "initial.x.uniform.bursts: an initial state has no bursts"),
        ({"noise": noise(RANDOM), "uncertainty": "{eps: +-20%, burst_1_to: +-1%}"},
         "uncertainty.burst_1_to: 'burst_1_to' is the name of a quantity of the random bursts"),
    ],
)  # fmt: skip
def test_mistakes_around_bursts(load, keys, message):
    """Oracle: one mistake each, at the key to blame."""
    [found] = problems(load, **keys)
    assert message in found


def test_a_wrong_noise_is_one_mistake(load):
    """A metric does not complain of bursts that are there but wrong."""
    [found] = problems(load, metrics=METRICS, noise=noise("[{from: 0.5, to: 0.2, factor: 2}]"))
    assert "must not be before from" in found


def test_a_smoke_run_may_be_too_short_for_its_bursts(tmp_path):
    """Oracle: no value, and no failure."""
    late = noise("[{from: 7, to: 8, factor: 2}]")
    path = write(tmp_path, noise=late, metrics=METRICS, time="{step: 0.1, duration: 9}", smoke="{runs: 2, steps: 5}")
    ran(path, tmp_path / "out", "--smoke")
    table = pd.read_csv(tmp_path / "out" / "trials.csv")
    assert table["tracking"].isna().all() and table["mse"].notna().all() and (table["status"] == "ok").all()


def test_bursts_have_no_exact_moments(tmp_path):
    """Oracle: the moments of the law depend on k, so there is nothing to compute them from."""
    bursty = "{uniform: {radius: 1, bursts: [{from: 1, to: 2, factor: 2}]}}"
    keys = {"noise": f"{{process: {{gaussian: {{std: 1}}}}, measurement: {bursty}}}", "initial": "{x: 0, P: 1}"}
    assert load_config(write_estimation(tmp_path, **keys)).experiment.scenario.noise_laws(1, 1) is None
    result = cli("check", write_estimation(tmp_path, **keys, evaluate="moments"))
    assert result.exit_code == 2 and "the moments of a law of noise are not known" in result.stderr
