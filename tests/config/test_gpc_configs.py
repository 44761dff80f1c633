"""Predictive control with tuned penalties in configurations: keys of two kinds, merging, overrides and round trips."""

import pytest
from small_experiment import cli, ran, write

from rmpc_bench import load_config
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.controllers.noise_tuning import LpNoise
from rmpc_bench.types import ConfigError

PLANT = "{kind: linear, A: [[1, 0.1], [0, 1]], B: [[0.005], [0.1]], C: [[1, 0]]}"
KEYS = {
    "uncertainty": "{}",
    "plant": PLANT,
    "model": "{from: plant, P_w: 1e-4, P_v: 1e-4}",
    "noise": "{measurement: {uniform: {radius: 1e-2}}}",
    "initial": "{x: 0, x_hat: 0, P: 1e-4}",
    "reference": "{kind: constant, value: 1}",
    "time": "{step: 0.1, steps: 12}",
    "controller": "{kind: gpc, Np: 5, Q_yw: 2, Q_u: 1%}",
}
METHODS = "{{constant: {{estimator: {{kind: kalman}}}}, tuned: {{estimator: {{kind: kalman}}, controller: {{{own}}}}}}}"
TUNED = "tuning: {kind: lp-noise, Ne2: 4, kp: 3e-5}"


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the small experiment with keys of the second method's controller."""

    def call(own=TUNED, overrides=(), **keys):
        return load_config(write(tmp_path, **KEYS | {"methods": METHODS.format(own=own)} | keys), overrides=overrides)

    return call


def controller(config, method="tuned"):
    """Controller of a method."""
    return config.experiment.method(method).controller


def test_a_method_s_tuning_is_merged_over_the_default(load):
    """Oracle: what is written; the rest of the controller is the default's."""
    made = controller(load())
    assert made.noise.keys == LpNoise(Ne2=4, kp=3e-5) and made.Np == 5 and made.Q_yw.tolist() == [[2.0]]
    assert made.noise.start == 4  # a Kalman filter has no window
    assert not hasattr(controller(load(), "constant"), "noise")


def test_tunings_of_the_same_kind_are_merged_deep(load):
    """Oracle: keys of both, the method's before the default's; another kind replaces the default whole."""
    default = "{kind: gpc, Np: 5, Q_yw: 2, Q_u: 1%, tuning: {kind: lp-noise, Ne2: 4, kp: 1e-5}}"
    assert controller(load("tuning: {kp: 2e-5}", controller=default)).noise.keys == LpNoise(Ne2=4, kp=2e-5)
    assert controller(load("tuning: {kind: lp-noise, kp: 2e-5}", controller=default)).noise.keys.Ne2 == 4
    assert not hasattr(controller(load("tuning: {kind: constant}", controller=default)), "noise")


def test_an_override_reaches_into_the_tuning(load):
    """Oracle: -s controller.tuning.kp."""
    default = f"{{kind: gpc, Np: 5, Q_yw: 2, Q_u: 1%, {TUNED}}}"
    made = load("tuning: {form: printed}", ["controller.tuning.kp=2e-7", "controller.tuning.bounds=[1, 2]"],
                controller=default)  # fmt: skip
    assert controller(made).noise.keys == LpNoise(Ne2=4, kp=2e-7, bounds=(1.0, 2.0), form="printed")
    assert controller(made, "constant").noise.keys.kp == 2e-7


def test_the_resolved_configuration_loads_to_itself(load, tmp_path):
    """Oracle: the keys, defaults filled in, and both hashes."""
    config = load()
    tuning = config.methods["tuned"]["controller"]["tuning"]
    assert tuning == {
        "kind": "lp-noise", "Ne2": 4, "kp": 3e-5, "bounds": [0.5, 4.0], "form": "corrected", "on": "output",
        "weight": "root", "floor": 1e-6, "state_rows": True,
    }  # fmt: skip
    assert config.methods["constant"]["controller"]["tuning"] == {"kind": "constant"}
    path = tmp_path / "resolved.yaml"
    path.write_text(dump(config.resolved), encoding="utf-8")
    again = load_config(path)
    assert again.resolved == config.resolved and again.methods == config.methods
    assert controller(again).noise.keys == controller(config).noise.keys


@pytest.mark.parametrize(
    ("own", "path", "message"),
    [
        ("tuning: {kp: 1}", "tuning", "'kind' is missing; known kinds: constant, lp-noise"),
        ("tuning: {kind: lp-nose}", "tuning.kind", "'lp-nose' is not a known kind; did you mean 'lp-noise'?"),
        ("tuning: {kind: constant, kp: 1}", "tuning.kp", "'kp' is not a known key; known: kind"),
        ("tuning: {kind: lp-noise, kp: 0}", "tuning.kp", "must be > 0 (got 0)"),
        ("tuning: {kind: lp-noise, form: right}", "tuning.form", "must be 'corrected' or 'printed' (got 'right')"),
        ("tuning: {kind: lp-noise, bounds: [-1, 4]}", "tuning.bounds.0", "must be >= 0 (got -1)"),
        (
            "tuning: {kind: lp-noise, bounds: [4, 0.5]}",
            "tuning.bounds",
            "the lower bound 4 must not exceed the upper bound 0.5",
        ),
    ],
)
def test_an_error_is_reported_once_at_its_place(load, own, path, message):
    """Oracle: the path of the key and words of the YAML."""
    with pytest.raises(ConfigError) as caught:
        load(own)
    assert [(each.path, each.message) for each in caught.value.problems] == [
        (f"methods.tuned.controller.{path}", message)
    ]


def test_it_runs_and_blocks_do_not_matter(tmp_path):
    """Oracle: trials.csv of blocks of two runs, byte for byte; penalties change the inputs."""
    methods = METHODS.format(own=TUNED)
    path = write(tmp_path, **KEYS, methods=methods)
    other = write(tmp_path, file="other.yaml", **KEYS, methods=methods, execution="{block: 2}")
    whole = ran(path, tmp_path / "a")
    assert whole == ran(other, tmp_path / "b")
    rows = [line.split(",") for line in whole.decode().splitlines()]
    assert all(row[2] == "ok" for row in rows[1:]) and len(rows) == 13
    assert rows[1][3:] != rows[7][3:]


def test_describe_shows_the_keys_of_both_kinds():
    """Oracle: the fields of the dataclasses."""
    shown = cli("describe", "controllers/gpc").stdout
    assert "tuning  (default {kind: constant})" in shown
    for key in ("kind : `constant`", "kind : `lp-noise`", "Ne2 : ", "kp : ", "bounds : ", "form : ", "state_rows : "):
        assert f"\n        {key}" in shown
