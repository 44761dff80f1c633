"""Finding parts by name."""

import inspect

import numpy as np
import pytest
import required_keys
from small_experiment import write
from uncertain_experiment import write_estimation

from rmpc_bench import Estimator, load_config, registry, single_run
from rmpc_bench.config_file import factories
from rmpc_bench.config_file.keys import PROVIDED, model_of
from rmpc_bench.extras import missing_for
from rmpc_bench.installed import InstalledComponent
from rmpc_bench.models.servo import ServoNoise
from rmpc_bench.types import ConfigError

PENDULUM = """
def rhs(x, u, p): return [x[1], -0.5 * x[1] - x[0] ** 3 + u[0]]
def out(x, p): return [x[0]]
"""
NONLINEAR = {
    "uncertainty": None,
    "plant": "{ode: 'own.py:rhs', output: 'own.py:out', states: [a, b], inputs: [f], outputs: [h]}",
    "model": "{nonlinear: plant, noise: {process: 1e-4, measurement: 1e-4}}",
    "initial": "{x: [0.1, 0], x_hat: [0.1, 0], P: 0.01}",
    "metrics": "[estimation_mse]",
}
OPEN = {"input": "{kind: sine, amplitude: 1, period: 5}", "controller": None, "reference": None}
LOOP = {"reference": "{kind: constant, value: 1}", "controller": None}
WEIGHTS = ", Q_x: 1, R_u: 1"
REQUIRED = {
    **{name: f"{WEIGHTS}, horizon: 5" for name in ("lqr", "game-gain", "minimax-lq")},
    "tube-mpc": f"{WEIGHTS}, horizon: 5, limits: {{u: [-9, 9]}}, W: 0.01",
    "control-lqr": WEIGHTS,
    "lqg": f"{WEIGHTS}, Q_i: 1",
    "mpc": ", Hp: 5, Hu: 2, Q: 1, R: 1",
    "gpc": ", Np: 5, Q_yw: 1, Q_u: 1",
    "pid": ", Kp: 1",
    **{kind: f", {required_keys.in_yaml(kind)}" for kind in required_keys.REQUIRED},
    "directional-kalman": ", q: 1",
    "robust-h-infinity": ", alpha: 90",
    "h-infinity": ", gamma: 10",
}
"""Keys that a component needs besides its kind."""
PARTS = [(group, name) for group in registry.BUILT_IN for name in registry.names(group)]


@pytest.fixture
def clean(monkeypatch):
    """Forget afterwards what a test registers."""
    monkeypatch.setattr(registry, "_REGISTERED", {group: {} for group in registry.BUILT_IN})


def design(model, n_steps, *, x0, P0, gain: float = 0.5):
    """Stand for a user's estimator."""


@pytest.mark.parametrize(("group", "name"), PARTS)
def test_every_name_leads_to_a_documented_design(group, name):
    """A registered part is callable, has a docstring, and its keys are keywords with annotations."""
    found = registry.get(group, name)
    assert callable(found) and inspect.getdoc(found)
    keys = [key for key in inspect.signature(found).parameters.values() if key.name not in PROVIDED[group]]
    assert all(key.kind is inspect.Parameter.KEYWORD_ONLY for key in keys)
    assert all(key.annotation is not inspect.Parameter.empty for key in keys)


@pytest.mark.parametrize(("group", "name"), PARTS)
def test_every_component_has_a_short_text(group, name):
    """At most 55 characters without a full stop; no other component of its group has the same."""
    text = registry.short(group, name)
    assert 0 < len(text) <= 55 and text == text.strip() and not text.endswith(".") and text.isascii()
    assert [each for _, each in registry.KINDS[group].values()].count(text) == 1


@pytest.mark.parametrize(("group", "name"), [part for part in PARTS if part[0] in registry.NONLINEAR])
def test_which_components_take_a_nonlinear_model(group, name, tmp_path):
    """Oracle: whether a configuration with a nonlinear model without an operating point is valid."""
    if missing_for(group, name):
        pytest.skip("needs an extra")
    (tmp_path / "own.py").write_text(PENDULUM, encoding="utf-8")
    component = f"{{kind: {name}{REQUIRED.get(name, '')}}}"
    methods = f"{{M: {{estimator: {component}}}}}"
    if group == "controllers":
        methods = f"{{M: {{estimator: {{kind: extended-kalman}}, controller: {component}}}}}"
    path = write(tmp_path, **NONLINEAR, methods=methods, **(LOOP if group == "controllers" else OPEN))
    if "both" in registry.tags(group, name):
        assert load_config(path).methods
        return
    assert "linear" in registry.tags(group, name)
    reasons = "needs a linear model|uncertain matrices|no uncertainty of A"
    with pytest.raises(ConfigError, match=reasons):
        load_config(path)


SETS = {
    "plant": "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], B: [[0], [1]], C: [[1, 0]]}",
    "model": "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], B: [[0], [1]], C: [[1, 0]], P_w: 1, P_v: 1, M_w: 1, M_v: 1}",
    "initial": "{x: [1, 0], x_hat: [1, 0], P: 1, M: 1}",
    "input": "{kind: sine, amplitude: 1, period: 5}",
}


@pytest.mark.parametrize(("group", "name"), [part for part in PARTS if part[0] in registry.NONLINEAR])
def test_every_method_takes_a_linear_model_and_bridges_as_its_tags_say(group, name, tmp_path):
    """Oracle: whether a configuration with a linear model, and one with missing measurements, is valid."""
    if missing_for(group, name):
        pytest.skip("needs an extra")
    component = f"{{kind: {name}{REQUIRED.get(name, '')}}}"
    if group == "controllers":
        law = f"{{M: {{estimator: {{kind: kalman}}, controller: {component}}}}}"
        keys = SETS | {"input": None, "reference": "{kind: constant, value: 0}", "methods": law}
        assert load_config(write_estimation(tmp_path, metrics="[input_power]", **keys)).methods
        return
    sets = SETS if name in ("mixed", "set-membership", "lp-window") or name.endswith("moving-horizon") else {}
    keys = sets | {"methods": f"{{M: {{estimator: {component}}}}}", "metrics": "[estimation_mse]"}
    assert load_config(write_estimation(tmp_path, **keys)).methods
    lost = write_estimation(tmp_path, **keys, noise="{measurement: {missing: {probability: 0.1}}}")
    if "gaps" in registry.tags(group, name):
        assert load_config(lost).methods
        return
    with pytest.raises(ConfigError, match="cannot predict without one"):
        load_config(lost)


@pytest.mark.parametrize(("group", "name"), PARTS)
def test_every_key_is_explained(group, name):
    """The docstring of a design explains each of its parameters; a class inherits keys with their docstrings."""
    found = registry.get(group, name)
    documented = found.__mro__ if inspect.isclass(found) else (found,)
    lines = [line for each in documented for line in (inspect.getdoc(each) or "").splitlines()]
    heads = [line.split(" : ")[0] for line in lines if " : " in line and not line.startswith(" ")]
    explained = {name for head in heads for name in head.split(", ")}
    keys = {key for key in inspect.signature(found).parameters if key not in PROVIDED[group]}
    assert keys <= explained


@pytest.mark.parametrize(("group", "name"), PARTS)
def test_kinds_follow_the_spelling_rule(group, name):
    """Kinds are lower case with hyphens; metrics are words of claims and have underscores."""
    separator = "_" if group == "metrics" else "-"
    assert all(part.isalnum() and part == part.lower() for part in name.split(separator))


def test_group_of_parts_built_by_name():
    """`plant`, `estimator` and `controller` call the design with what they are given."""
    plant = factories.plant("servo-linear", 0.1, J_l=20.0)
    assert (plant.Ts, plant.nominal["J_l"]) == (0.1, 20.0)


@pytest.mark.parametrize("group", ["estimator", "estimators"])
def test_register_takes_singular_and_plural(clean, group):
    """A registered part is found and listed, in order."""
    registry.register(group, "half", design)
    assert registry.get("estimators", "half") is design
    assert registry.names("estimators") == sorted([*registry.BUILT_IN["estimators"], "half"])


def test_register_the_same_design_twice(clean):
    """Running a notebook cell again is no mistake."""
    registry.register("estimator", "half", design)
    registry.register("estimator", "half", design)


def test_register_refuses_a_built_in_name(clean):
    """A configuration means the same everywhere."""
    with pytest.raises(ValueError, match="'kalman' is a built-in estimator; choose another name"):
        registry.register("estimator", "kalman", lambda: None)


def test_register_a_changed_design_replaces_it_with_a_line(clean, capsys):
    """After a cell of a notebook was edited, its class counts, and its keys are read again."""
    registry.register("estimator", "half", design)
    assert "gain" in model_of("estimators", "half").model_fields
    assert capsys.readouterr().err == ""

    def changed(model, n_steps, *, x0, P0, weight: float = 0.5): ...

    registry.register("estimator", "half", changed)
    assert capsys.readouterr().err == "estimator 'half': the new definition replaces the earlier one\n"
    assert registry.get("estimators", "half") is changed
    assert [*model_of("estimators", "half").model_fields] == ["weight"]


def test_register_refuses_an_unknown_group(clean):
    """The message lists the groups."""
    with pytest.raises(ValueError, match="'filter' is not a known group of .*; known: plants, models, estimators"):
        registry.register("filter", "half", design)


def test_an_unknown_name_has_a_way_out():
    """The message names the nearest part and where the others are."""
    with pytest.raises(KeyError, match="'kalmn' is not a known estimator; did you mean 'kalman'.*list estimators"):
        registry.get("estimators", "kalmn")


@pytest.mark.parametrize(
    ("name", "known", "message"),
    [
        ("mpx", ["mpc", "gpc"], "'mpx' is not a known thing; did you mean 'mpc'?"),
        ("zzzz", ["mpc", "gpc"], "'zzzz' is not a known thing; known: mpc, gpc"),
        ("zzzz", [], "'zzzz' is not a known thing; known: none"),
    ],
)
def test_unknown_names_the_nearest_or_all(name, known, message):
    """A near miss gets a suggestion, anything else the list."""
    assert registry.unknown(name, known, "thing") == message


def test_parts_of_installed_packages(monkeypatch):
    """An entry point adds a part without an import until it is asked for."""

    class Point:
        name, value, dist = "half", "my_package:design", None
        loaded = 0

        def load(self):
            Point.loaded += 1
            return design

    found = {"half": InstalledComponent("half", (Point(),))}
    monkeypatch.setattr(registry, "_entry_points", lambda group: found if group == "estimators" else {})
    assert "half" in registry.names("estimators") and "half" not in registry.names("plants")
    assert Point.loaded == 0
    assert registry.get("estimators", "half") is design


def test_a_registered_single_run_class_by_its_kind(clean):
    """The public functions make the design of the bench from the user's class."""

    @single_run
    class Hold:
        def update(self, y):
            return y

    registry.register("estimator", "hold", Hold)
    model = factories.model("servo-linear", 0.1, noise=ServoNoise(process=1.0, measurement=1.0))
    assert isinstance(factories.estimator("hold", model, n_steps=3, Ts=0.1, x0=np.zeros(4), P0=np.eye(4)), Estimator)
