"""What identifies an experiment and a method, and the configuration that is written back."""

import pytest
import tuned_experiment
from small_experiment import write

from rmpc_bench import load_config
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump

CLAIM = "[{says: a, check: 'mean(mse[S-MPC]) < 1', finding: confirmed}]"
SHARED = {
    "seed": "8",
    "plant": "{kind: servo-linear, J_l: 24, perturb: {J_l: 1 + eps}}",
    "noise": "none",
    "time": "{step: 0.1, steps: 11}",
    "initial": "{x: 1}",
    "uncertainty": "{eps: +-30%}",
    "reference": "{kind: constant, value: 1}",
}
NOT_SHARED = {
    "name": "other",
    "title": "Another title",
    "summary": "Something else was found.",
    "runs": "7",
    "methods": "{other: {estimator: {kind: kalman}, label: text}}",
    "controller": "{kind: mpc, Hp: 5, Hu: 2, Q: 1, R: 1}",
    "model": "{kind: servo-linear, noise: {process: 2.0, measurement: 1.0}}",
    "metrics": "[mae]",
    "figures": "[boxplot]",
    "claims": CLAIM,
    "statistics": "{confidence: 90%, baseline: R-MPC}",
    "execution": "{workers: 1, block: 3, max_failures: 2}",
    "smoke": "{runs: 1, steps: 2}",
    "record": "{runs: all}",
}


def method_key(config, name):
    return config.points[0].method_keys[name]


def metric_keys(config):
    return config.points[0].metric_keys


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the small experiment with some keys replaced."""
    return lambda **keys: load_config(write(tmp_path, **keys))


@pytest.mark.parametrize("key", SHARED)
def test_what_all_methods_share_is_in_the_hash(load, key):
    """Plant, random inputs, length and seed are in the hash."""
    assert load(**{key: SHARED[key]}).hash != load().hash


def test_step_and_single_values_are_in_the_hash(load):
    """A perturbation, a plant parameter at its default, a mean of the noise."""
    hashes = {
        load(time="{step: 0.05, steps: 10}").hash,
        load(plant="{kind: servo-linear, perturb: {J_l: 1 - eps}}").hash,
        load(plant="{kind: servo-linear, set: {J_l: 1 + eps}}").hash,
        load(noise="{measurement: {gaussian: {std: 0.01, mean: 0.1}}}").hash,
        load(noise="{process: {gaussian: {std: 0.01}}}").hash,
        load(initial="{x: {gaussian: {std: 0.01}}}").hash,
        load().hash,
    }
    assert len(hashes) == 7
    assert load(plant="{kind: servo-linear, J_l: 25.0, perturb: {J_l: 1 + eps}}").hash == load().hash


@pytest.mark.parametrize("key", NOT_SHARED)
def test_what_may_grow_in_place_is_not_in_the_hash(load, key):
    """Runs, methods, metrics, labels, figures, claims and execution may change in a directory."""
    assert load(**{key: NOT_SHARED[key]}).hash == load().hash


def test_the_model_counts_where_the_noise_follows_it(load):
    """`noise: same` makes the noise of the plant depend on the design model."""
    model = NOT_SHARED["model"]
    for noise in ("same", "{measurement: {same: {scale: 0.1}}}"):
        assert load(noise=noise, model=model).hash != load(noise=noise).hash


def test_hash_of_a_method_is_what_it_is(load):
    """Not its name, label or place, but its parts and where its estimator starts."""
    one = load(methods="{a: {estimator: {kind: kalman}}, b: {estimator: {kind: robust-kalman, c: 0.1}}}")
    two = load(methods="{x: {estimator: {kind: robust-kalman, c: 10%}, label: X}, y: {estimator: {kind: kalman}}}")
    assert method_key(one, "a") == method_key(two, "y") != method_key(one, "b") == method_key(two, "x")
    for key, value in (("controller", NOT_SHARED["controller"]), ("initial", "{P: 2}"), ("initial", "{x_hat: 1}")):
        assert method_key(load(**{key: value}), "S-MPC") != method_key(load(), "S-MPC")
    assert method_key(load(model=NOT_SHARED["model"]), "S-MPC") != method_key(load(), "S-MPC")


def test_full_hash_covers_the_methods_too(load):
    """And nothing that does not change a trial."""
    assert load(controller=NOT_SHARED["controller"]).full_hash != load().full_hash
    for key in ("name", "title", "runs", "metrics", "figures", "claims", "statistics", "execution", "smoke"):
        assert load(**{key: NOT_SHARED[key]}).full_hash == load().full_hash


def test_hash_of_a_metric_is_what_it_measures(load):
    """A new name alone is no new metric; a window is."""
    keys = metric_keys(load(metrics="[mse, {kind: mse, name: same}, {kind: mse, name: late, from: 5}]"))
    assert keys["mse"] == keys["same"] != keys["late"]


def test_a_window_in_seconds_is_not_one_in_samples(load):
    """The same number means another window when the unit of `time` changes, so nothing stored may be taken for it."""
    metrics = "[{kind: mse, to: 1}]"
    samples = load(metrics=metrics, time="{step: 0.1, steps: 10}")
    seconds = load(metrics=metrics, time="{step: 0.1, duration: 1}")
    assert samples.experiment.metrics[0].window != seconds.experiment.metrics[0].window
    assert (samples.hash, metric_keys(samples)) != (seconds.hash, metric_keys(seconds))


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"time": "{step: 0.1, duration: 1}", "metrics": "[{kind: mse, from: 0.5, to: N}, settling_time]"},
        {"noise": "same", "initial": "{x: {gaussian: {std: [1, 2, 3, 4]}}, x_hat: [1, 2, 3, 4], P: [1, 2, 3, 4]}"},
        {"noise": "{process: {same: {scale: 1/3}}, measurement: none}", "plant": "{kind: servo, set: {J_l: 20 + eps}}"},
        {"uncertainty": "{eps: {dist: choice, values: [1, 1/3]}, b: {dist: normal, std: 1, truncate: 2}}"},
        {"plant": "{kind: servo-linear, perturb: {J_l: 2, R: 1e-1, rho: '1+eps'}}"},
        {"methods": "{'a.b: c': {estimator: {kind: kalman}, label: '$c$ ä \"'}, 12: {estimator: {kind: kalman}}}"},
        {"estimator": "{kind: robust-kalman, c: 0.1}", "methods": "{a: , b: {model: {J_l: 5}, controller: {Hu: 1}}}"},
        {"figures": "[boxplot, {kind: boxplot, metric: mse, log: true, order: [R-MPC, S-MPC]}]"},
        {
            "claims": CLAIM.replace(
                "finding",
                "stated: {of: 'mean(mse[S-MPC])', value: 1%, tolerance: 1/3}, assumptions: ['a: b # c'], finding",
            )
        },
        {"paper": "p", "title": "'yes'", "statistics": "{primary: input_power, relevant: {mse: 2%}}"},
        {"seed": "9007199254740993"},
    ],
)
def test_the_resolved_configuration_loads_to_the_same(load, tmp_path, keys):
    """The same hashes of everything, the same data, and again the same when it is resolved once more."""
    config = load(**keys)
    copy = tmp_path / "config.resolved.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert again.resolved == config.resolved
    assert (again.hash, again.full_hash) == (config.hash, config.full_hash)
    assert metric_keys(again) == metric_keys(config)
    assert list(again.methods) == list(config.methods) and again.labels == config.labels
    assert again.claims == config.claims and again.statistics == config.statistics
    assert dump(plain(again.resolved)) == copy.read_text(encoding="utf-8")


def test_the_resolved_smoke_configuration_loads_to_the_same(tmp_path):
    """Windows that the short run cuts are no mistake when it is read again."""
    path = write(tmp_path, time="{step: 0.1, duration: 5}", metrics="[mse, {kind: mse, name: late, from: 1, to: 4}]")
    config = load_config(path, smoke=True)
    copy = tmp_path / "config.resolved.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert again.full_hash == config.full_hash and metric_keys(again) == metric_keys(config)
    windows = [each.experiment.metrics[1].window(each.experiment.metric_layout) for each in (again, config)]
    assert windows[0] == windows[1]


@pytest.mark.parametrize("seed", [2**53 + 1, 2**63 - 1])
def test_a_large_seed_is_kept_to_the_last_digit(load, seed):
    """Seeds do not go through floating point."""
    assert load(seed=seed).experiment.scenario.seed == seed


def test_a_default_that_was_added_to_one_kind_is_left_out_of_the_hash(tmp_path):
    """`lmmse` is a predictor by default, other filters use the latest measurement; stored trials name neither."""
    plant = "{kind: uncertain-linear, A: 0.9, C: 1, Bw: 1, Dv: 1, H_A: 0.1, G_x: 1}"
    keys = {"plant": plant, "model": "{from: plant, W: 1, V: 1}", "noise": "same", "tune": None}
    kinds = "lmmse: {estimator: {kind: lmmse%s}}, KF: {estimator: {kind: kalman%s}}"
    points = {}
    for form in ("", ", form: predictor", ", form: filter"):
        path = tuned_experiment.write(tmp_path, **keys, methods=f"{{{kinds % (form, form)}}}")
        points[form] = load_config(path).points[0]
    keys_of = {name: {form: point.method_keys[name] for form, point in points.items()} for name in ("lmmse", "KF")}
    assert keys_of["lmmse"][""] == keys_of["lmmse"][", form: predictor"] != keys_of["lmmse"][", form: filter"]
    assert keys_of["KF"][""] == keys_of["KF"][", form: filter"] != keys_of["KF"][", form: predictor"]
    estimators = [points[""].methods[name]["estimator"] for name in ("lmmse", "KF")]
    assert not any("form" in each for each in estimators)
    assert "scale" not in points[""].shared["model"] and "scale" not in points[""].methods["KF"]["model"]
