"""A grid of methods: the methods that it writes out, what is merged into them, and its errors with their places."""

import pytest
import yaml
from jsonschema import Draft7Validator
from small_experiment import KEYS, text, write

from rmpc_bench import load_config
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.schema.json_schema import json_schema
from rmpc_bench.types import ConfigError

KF, RF, FF = "KF: {kind: kalman}", "RF: {kind: robust-kalman, c: 0.1}", "FF: {kind: fading-kalman, alpha: 1.05}"
LQG, MPC, PI = "LQG: {kind: lqg, Q_i: 1, Q_x: 1, R_u: 1}", "MPC: {Hp: 12}", "PI: {kind: pid, Kp: 2, Ki: 1}"
ESTIMATORS, CONTROLLERS = f"{{{KF}, {RF}, {FF}}}", f"{{{MPC}, {PI}}}"
GRID = f"grid: {{estimator: {ESTIMATORS}, controller: {CONTROLLERS}}}"
BESIDE = "alone: {estimator: {kind: kalman}}"


def loaded(tmp_path, methods, *overrides, **keys):
    """Load the small experiment with some methods."""
    return load_config(write(tmp_path, methods=f"{{{methods}}}", **keys), overrides=overrides)


def problems(tmp_path, methods, *overrides, **keys):
    """Return line, column, path and message of every error."""
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, methods, *overrides, **keys)
    return [(each.line, each.column, each.path, each.message) for each in caught.value.problems]


def test_a_grid_is_the_methods_that_are_written_out(tmp_path):
    """Oracle: the same methods by hand, with the same hashes; the first axis is slowest, methods beside it are last."""
    found = loaded(
        tmp_path, f"{BESIDE}, {GRID}, exclude: [{{estimator: FF, controller: PI}}], KF+PI: {{controller: {{Kp: 3}}}}"
    )
    by_hand = loaded(
        tmp_path,
        "KF+MPC: {estimator: {kind: kalman}, controller: {Hp: 12}},"
        "KF+PI: {estimator: {kind: kalman}, controller: {kind: pid, Kp: 3, Ki: 1}},"
        "RF+MPC: {estimator: {kind: robust-kalman, c: 0.1}, controller: {Hp: 12}},"
        "RF+PI: {estimator: {kind: robust-kalman, c: 0.1}, controller: {kind: pid, Kp: 2, Ki: 1}},"
        f"FF+MPC: {{estimator: {{kind: fading-kalman, alpha: 1.05}}, controller: {{Hp: 12}}}}, {BESIDE}",
        statistics="{two_way: {estimator: [KF, RF, FF], controller: [MPC, PI]}}",
    )
    assert [*found.methods] == ["KF+MPC", "KF+PI", "RF+MPC", "RF+PI", "FF+MPC", "alone"]
    assert found.points[0].method_keys == by_hand.points[0].method_keys and found.hash == by_hand.hash
    assert found.resolved == by_hand.resolved and found.labels == by_hand.labels
    # The default of all methods has a horizon of 10.
    assert found.resolved["methods"]["alone"]["controller"]["Hp"] == 10


def test_the_resolved_configuration_has_the_same_grid_again(tmp_path):
    """Its methods are ordinary ones, so that an override of one of them works there, too."""
    found = loaded(tmp_path, GRID)
    again = tmp_path / "again.yaml"
    again.write_text(dump(found.resolved), encoding="utf-8")
    assert load_config(again).resolved == found.resolved
    assert (
        load_config(again, overrides=["methods.RF+PI.estimator.c=2"]).resolved["methods"]["RF+PI"]["estimator"]["c"]
        == 2
    )
    assert "two_way" not in load_config(write(tmp_path)).resolved["statistics"]


def test_an_entry_without_keys_is_the_default_of_all_methods(tmp_path):
    """Oracle: the same key written out."""
    found, by_hand = (
        loaded(tmp_path, f"grid: {{estimator: {{{KF}}}, controller: {{A: {a}}}}}") for a in ("{}", "{Hp: 10}")
    )
    assert found.hash == by_hand.hash


def test_one_and_three_axes(tmp_path):
    """They have no table of two axes."""
    one = loaded(tmp_path, f"grid: {{estimator: {ESTIMATORS}}}")
    assert [*one.methods] == ["KF", "RF", "FF"] and one.statistics.two_way is None
    servo = "{kind: servo-linear, noise: {process: %d, measurement: 1}}"
    model = f"{{a: {servo % 1}, b: {servo % 2}}}"
    three = loaded(tmp_path, f"grid: {{controller: {{{LQG}}}, model: {model}, estimator: {{{KF}, {RF}}}}}", model=None)
    assert [*three.methods] == ["LQG+a+KF", "LQG+a+RF", "LQG+b+KF", "LQG+b+RF"] and three.statistics.two_way is None
    assert three.resolved["methods"]["LQG+b+RF"]["model"]["noise"]["process"] == 2


def test_overrides_of_an_entry_and_of_a_method(tmp_path):
    """An entry changes all of its methods, a method one of them; another kind replaces the whole component."""
    found = loaded(tmp_path, GRID, "methods.grid.estimator.RF.c=7", "methods.KF+MPC.controller.Hp=20").resolved[
        "methods"
    ]
    assert [found[f"RF+{name}"]["estimator"]["c"] for name in ("MPC", "PI")] == [7, 7]
    assert [found[f"{name}+MPC"]["controller"]["Hp"] for name in ("KF", "RF", "FF")] == [20, 12, 12]
    found = loaded(tmp_path, GRID, "methods.KF+PI={controller: {kind: lqg, Q_i: 1, Q_x: 1, R_u: 1}}").resolved[
        "methods"
    ]["KF+PI"]
    assert found["controller"]["kind"] == "lqg" and "Kp" not in found["controller"]


def test_a_file_that_extends_one_with_a_grid(tmp_path):
    """Keys of an entry are merged, one of another kind replaces it, and an entry can be deleted."""
    write(tmp_path, file="base.yaml", methods=f"{{{GRID}}}")
    path = tmp_path / "own.yaml"
    estimators = "{RF: {c: 3}, FF: {kind: huber-kalman, k: 1.5}, KF: !delete}"
    methods = f"{{grid: {{estimator: {estimators}}}, RF+PI: {{controller: {{Kp: 9}}}}}}"
    path.write_text(f"extends: base.yaml\nname: own\nmethods: {methods}\n", encoding="utf-8")
    found = load_config(path).resolved["methods"]
    assert [*found] == ["RF+MPC", "RF+PI", "FF+MPC", "FF+PI"]
    assert found["RF+PI"]["estimator"] | {"c": 3} == found["RF+MPC"]["estimator"]
    assert found["FF+PI"]["estimator"]["kind"] == "huber-kalman" and "alpha" not in found["FF+PI"]["estimator"]
    assert found["RF+PI"]["controller"]["Kp"] == 9 and found["FF+PI"]["controller"]["Kp"] == 2


def test_labels_are_joined_and_ranges_are_inside_the_component(tmp_path):
    """Every method of a tuned entry has its own search."""
    entries = (
        "{KF: {kind: kalman}, RF: {kind: robust-kalman, c: 0.1, label: '$c = ${estimator.c}$', tune: {c: [0.01, 1]}}}, "
        "controller: {MPC: {Hp: 12}, PI: {kind: pid, Kp: 2, label: proportional, tune: {Kp: [1, 3], Kd: [0.1, 1]}}}"
    )
    found = loaded(tmp_path, f"grid: {{estimator: {entries}}}", tune="{budget: 2, runs: 2}")
    assert found.labels == {
        **{"KF+MPC": "KF+MPC", "KF+PI": "KF + proportional"},
        **{"RF+MPC": "$c = 10^{-1}$ + MPC", "RF+PI": "$c = 10^{-1}$ + proportional"},
    }
    searches = {each.method: [parameter.path for parameter in each.parameters] for each in found.tuning.searches}
    of_pid = ["controller.Kp", "controller.Kd"]
    assert searches == {"KF+PI": of_pid, "RF+MPC": ["estimator.c"], "RF+PI": ["estimator.c", *of_pid]}


def test_a_mapping_in_python(tmp_path):
    """The same configuration as that of the file; an error has the path."""
    data = yaml.safe_load(text(methods=f"{{{GRID}}}"))
    assert load_config(data).hash == loaded(tmp_path, GRID).hash
    data["methods"]["grid"]["estimator"]["RF"]["d"] = 1
    with pytest.raises(ConfigError, match=r"methods\.grid\.estimator\.RF\.d: 'd' is not a known key"):
        load_config(data)


LINE = [*KEYS].index("methods") + 1


@pytest.mark.parametrize(
    ("methods", "path", "message"),
    [
        (
            GRID.replace("controller:", "control:"),
            "grid.control",
            "'control' is not a known axis of methods.grid; did you mean 'controller'?; `grid`",
        ),
        (
            "grid: {estimator: {kind: kalman}}",
            "grid.estimator.kind",
            "must be a mapping (got 'kalman')",
        ),
        (GRID.replace("estimator:", "estimators:"), "grid.estimators", "did you mean 'estimator'?"),
        ("grid: {kind: kalman}", "grid.kind", "`grid` and `exclude` are no names of methods"),
        ("grid: 3", "grid", "must be a mapping (got 3); `grid` and"),
        ("grid: {estimator: kalman}", "grid.estimator", "must be a mapping (got 'kalman')"),
        (GRID.replace("KF", "K+F"), "grid.estimator.K+F", "must not be empty or contain '+'"),
        (f"grid: {{estimator: {{{KF[:-1]}, label: 3}}}}}}", "grid.estimator.KF.label", "must be text (got 3)"),
        (f"grid: {{estimator: {{{KF[:-1]}, tune: 3}}}}}}", "grid.estimator.KF.tune", "paths inside the component"),
        ("exclude: {estimator: {kind: kalman}}", "exclude", "expected a list (got a mapping)"),
        (
            f"{GRID}, exclude: {{estimator: {{kind: kalman}}}}",
            "exclude",
            "expected a list (got a mapping); `grid` and `exclude` are no",
        ),
        (f"{GRID}, exclude: [3]", "exclude.0", "must be a mapping (got 3)"),
        (f"{GRID}, exclude: [{{}}]", "exclude.0", "has too few entries"),
        (f"{GRID}, exclude: [{{estimatr: KF}}]", "exclude.0.estimatr", "did you mean 'estimator'?"),
        (f"{GRID}, exclude: [{{estimator: KG}}]", "exclude.0.estimator", "excludes no method: 'KG' is not a known"),
        (f"{GRID}, exclude: [{{controller: PI}}], KF+PI: {{}}", "KF+PI", "is left out by `methods.exclude`"),
        (f"{GRID}, KF+PI: 3", "KF+PI", "must be a mapping (got 3)"),
        (f"{GRID}, KF+PI: []", "KF+PI", "must be a mapping (got a list of 0)"),
        (f"{GRID}, KF+PI: 0", "KF+PI", "must be a mapping (got 0)"),
        (f"{GRID}, KF+PI: ''", "KF+PI", "must be a mapping (got '')"),
        (f"{GRID}, KF+PI: false", "KF+PI", "must be a mapping (got False)"),
        # What is wrong in an entry is said once, not for every method that has it.
        (GRID.replace("alpha", "alhpa"), "grid.estimator.FF.alhpa", "did you mean 'alpha'?"),
        (GRID.replace("c: 0.1", "c: -1"), "grid.estimator.RF.c", "must be"),
    ],
)
def test_errors_have_a_place(tmp_path, methods, path, message):
    """Oracle: the line by hand, the column by looking for the last step of the path in the text."""
    found = problems(tmp_path, methods)
    [(line, column, at, said)] = [each for each in found if each[2] == f"methods.{path}"]
    assert line == LINE and message in said
    last = path.split(".")[-1]
    at_key = text(methods=f"{{{methods}}}").splitlines()[LINE - 1].find(f"{last}:") + 1
    assert column >= at_key > 0 or last.isdigit()
    assert len(found) == 1 or "alhpa" in methods or path == "exclude"


def test_errors_beside_each_other(tmp_path):
    """All at once; those of the command line have its place."""
    found = problems(tmp_path, f"{GRID}, exclude: [{{estimator: KG}}]".replace("KF:", "K+F:"))
    assert [each[2] for each in found] == ["methods.grid.estimator.K+F", "methods.exclude.0.estimator"]
    taken = ["KF+PI: {estimator: {kind: kalman}}", "grid: {estimator: {kind: kalman}}"]
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, methods=f"{{{GRID}}}"), add_methods=taken)
    assert [each.path for each in caught.value.problems] == ["methods.KF+PI", "methods.grid"]
    entries = ", ".join(f"A{number}: {{kind: kalman}}" for number in range(71))
    many = f"grid: {{estimator: {{{entries}}}, controller: {{{entries}}}}}"
    assert problems(tmp_path, many)[0][2:] == ("methods.grid", "there must be at most 5,000 methods (got 5,041)")
    found = problems(tmp_path, f"{GRID}, exclude: [{{controller: PI}}, {{controller: MPC}}]")
    assert [each[2:] for each in found] == [("methods", "there must be at least one method")]
    found = problems(tmp_path, f"{GRID}, KF+: {{}}".replace("KF:", "'':"))
    assert found[0][2].startswith("methods.grid.estimator.") and "must not be empty" in found[0][3]
    found = problems(tmp_path, GRID, "methods.grid.estimator.Z.c=0.1")
    message = "'kind' is missing (rmpc-bench list estimators); entries: KF, RF, FF, Z"
    assert [each[2:] for each in found] == [("methods.grid.estimator.Z", message)]
    found = problems(tmp_path, BESIDE, statistics="{two_way: {estimator: [KF]}}")
    assert found[0][2:] == ("statistics.two_way", "must name two axes (got 1)")


def test_axes_of_the_table_are_those_of_the_names(tmp_path):
    """An entry that is in no name of a method is refused at its place; what `exclude` leaves out is no entry."""
    two_way = "{two_way: {estimator: [KF, RF, EKF], controller: [MPC, PI]}}"
    for methods, known in ((GRID, "KF, RF, FF"), (BESIDE, "none")):
        found = [each[2:] for each in problems(tmp_path, methods, statistics=two_way)]
        said = "'EKF' is not a known estimator in the names of methods; "
        assert len(found) == (1 if known != "none" else 5)
        [message] = [message for path, message in found if path == "statistics.two_way.estimator.2"]
        assert message.startswith(said) and ("did you mean" in message or message.endswith(known))
    config = loaded(tmp_path, f"{GRID}, exclude: [{{estimator: RF}}], KF+PI:")
    assert config.resolved["statistics"]["two_way"] == {"estimator": ["KF", "FF"], "controller": ["MPC", "PI"]}
    assert config.resolved["methods"] == loaded(tmp_path, f"{GRID}, exclude: [{{estimator: RF}}]").resolved["methods"]


def test_the_schema_of_editors_knows_it():
    """A label and ranges stand beside the keys of a component; unknown keys are refused."""
    validator = Draft7Validator(json_schema())
    entry = GRID.replace("c: 0.1", "c: 0.1, label: R, tune: {c: [0.1, 1]}")
    good = yaml.safe_load(text(methods=f"{{{entry}, exclude: [{{estimator: KF, controller: PI}}], KF+MPC: {{}}}}"))
    assert validator.is_valid(good)
    for wrong in (
        GRID.replace("alpha", "alhpa"),
        GRID.replace("controller:", "control:"),
        f"{GRID}, exclude: [{{a: KF}}]",
    ):
        assert not validator.is_valid(yaml.safe_load(text(methods=f"{{{wrong}}}")))
