"""Points of a sweep: which there are, how they are named, and the messages for a wrong sweep."""

import pytest
from small_experiment import KEYS, text, write

from rmpc_bench import load_config
from rmpc_bench.config.sweep import expand
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump, parse
from rmpc_bench.types import ConfigError
from rmpc_bench.types.sweep_points import relevant_paths

HP, HU, C = "controller.Hp", "controller.Hu", "methods.R-MPC.estimator.c"
HUNDRED = ", ".join(map(str, range(1, 102)))


def found(sweep, **keys):
    """Points of the small experiment with a sweep."""
    expanded = expand(parse(text(sweep=sweep, **keys), "tiny.yaml"), ())
    assert not expanded.problems
    return expanded.points


def names(sweep):
    """Texts of the values at every point, in order."""
    return [tuple(point.coordinates.values()) for point in found(sweep)]


def test_without_a_sweep_there_is_one_point_without_a_name():
    """And the tree is the configuration itself."""
    tree = parse(text(), "tiny.yaml")
    assert expand(tree, ()) == (tree, [({}, tree, "")], (), [])


def test_a_grid_combines_every_value_with_every_other():
    """The last path runs fastest; the paths stand in the order of the sweep."""
    sweep = f"{{grid: {{{HU}: [3, 2], {HP}: [10, 12, 11]}}}}"
    assert names(sweep) == [("3", "10"), ("3", "12"), ("3", "11"), ("2", "10"), ("2", "12"), ("2", "11")]
    assert {tuple(point.coordinates) for point in found(sweep)} == {(HU, HP)}


def test_the_paths_of_a_zip_go_hand_in_hand():
    """As one axis, beside those of a grid."""
    assert names(f"{{zip: {{{HP}: [10, 15], {HU}: [3, 8]}}}}") == [("10", "3"), ("15", "8")]
    both = names(f"{{grid: {{{C}: [1, 2]}}, zip: {{{HP}: [10, 15], {HU}: [3, 8]}}}}")
    assert both == [("1", "10", "3"), ("1", "15", "8"), ("2", "10", "3"), ("2", "15", "8")]


@pytest.mark.parametrize(
    ("exclude", "left"),
    [
        (f"[{{{HP}: 10, {HU}: 3}}]", [("10", "2"), ("12", "3"), ("12", "2")]),
        (f"[{{{HP}: 10}}]", [("12", "3"), ("12", "2")]),
        (f"[{{{HP}: 10.0, {HU}: 3}}, {{{HU}: 2}}]", [("12", "3")]),
        (f"[{{{HP}: 10}}, {{{HU}: 2}}]", [("12", "3")]),
        ("[]", [("10", "3"), ("10", "2"), ("12", "3"), ("12", "2")]),
    ],
)
def test_exclude_takes_out_the_points_that_have_all_its_values(exclude, left):
    """Paths that an entry does not name may have any value; the others keep their order."""
    assert names(f"{{grid: {{{HP}: [10, 12], {HU}: [3, 2]}}, exclude: {exclude}}}") == left


def test_a_point_is_the_configuration_with_its_values():
    """Nothing else changes, and the tree that was read stays as it is."""
    tree = parse(text(sweep=f"{{grid: {{{HP}: [10, 12], controller.limits.u.1: [220, 100]}}}}"), "tiny.yaml")
    before = plain(tree)
    last = plain(expand(tree, ()).points[-1].tree)
    assert plain(tree) == before
    assert last.pop("controller") == {**before["controller"], "Hp": 12, "limits": {"u": [-220, 100]}}
    assert last == {key: value for key, value in before.items() if key not in ("sweep", "controller")}


def test_a_value_may_be_a_whole_component():
    """It takes the place of the old one; its text shows all of it."""
    kalman, robust = found("{grid: {methods.R-MPC.estimator: [{kind: kalman}, {kind: robust-kalman, c: 1.0}]}}")
    assert plain(kalman.tree["methods"]["R-MPC"]) == {"estimator": {"kind": "kalman"}}
    assert plain(robust.tree["methods"]["R-MPC"]) == {"estimator": {"kind": "robust-kalman", "c": 1.0}}
    assert [*kalman.coordinates.values()] == ["{kind: kalman}"]
    assert [*robust.coordinates.values()] == ["{kind: robust-kalman, c: 1}"]


def test_rows_of_a_zip_leave_what_they_do_not_name():
    """Oracle: the same sweep as lists."""
    rows = found("{zip: [{name: ours}, {name: late, controller.Hp: 12, seed: 3}, {name: early, seed: 4}]}")
    assert [point.title for point in rows] == ["ours", "late", "early"]
    assert [list(point.coordinates) for point in rows] == [["name", "controller.Hp", "seed"]] * 3
    assert [point.coordinates["controller.Hp"] for point in rows] == ["10", "12", "10"]
    assert [point.tree["seed"] for point in rows] == [7, 3, 4]
    assert [point.tree["controller"]["Hp"] for point in rows] == [10, 12, 10]
    lists = found("{zip: {name: [ours, late, early], controller.Hp: [10, 12, 10], seed: [7, 3, 4]}}")
    assert [plain(point.tree) for point in lists] == [plain(point.tree) for point in rows]
    assert [point.coordinates for point in lists] == [point.coordinates for point in rows]


def test_values_given_as_a_mapping_have_names():
    """Tables and claims show the names; an exclusion takes them, too."""
    sweep = "{grid: {reference.value: {left: -1, right: 1}, initial: {there: {x: 1}, nothing: {}}}, exclude: [%s]}"
    points_left = found(sweep % "{reference.value: left, initial: there}")
    assert [tuple(each.coordinates.values()) for each in points_left] == [
        ("left", "nothing"),
        ("right", "there"),
        ("right", "nothing"),
    ]
    assert [each.tree["reference"]["value"] for each in points_left] == [-1, 1, 1]
    assert [plain(each.tree["initial"]) for each in points_left] == [{}, {"x": 1}, {}]


def test_a_zip_may_have_names():
    """They stand beside its paths, name the points in words, and change nothing."""
    zipped = f"zip: {{name: [short, long], {HP}: [10, 15], {HU}: [3, 8]}}"
    there = found(f"{{grid: {{seed: [1, 2]}}, {zipped}, exclude: [{{seed: 2, name: long}}]}}")
    assert [point.title for point in there] == ["seed=1, short", "seed=1, long", "seed=2, short"]
    assert there[1].coordinates == {"seed": "1", "name": "long", HP: "15", HU: "8"}
    assert there[1].tree["name"] == "tiny" and there[1].tree["controller"]["Hu"] == 8
    assert [point.title for point in found(f"{{grid: {{{HP}: [9], seed: {{a: 1}}}}}}")] == [f"{HP}=9, seed=a"]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ("10", "10"), ("10.0", "10"), ("1e1", "10"), ("0.001", "0.001"), ("1e-3", "0.001"), ("-2.50", "-2.5"),
        ("1e300", "1e+300"), ("2*pi", "2*pi"), ("1 + 5%", "1 + 5%"), ("'10'", "10"), ("yes", "yes"),
        ("true", "true"), ("null", "null"), ("[0, 1.0]", "[0, 1]"), ("{a: 1.0, b: [x, null]}", "{a: 1, b: [x, null]}"),
    ],
)  # fmt: skip
def test_the_text_of_a_value(value, shown):
    """The shortest way to write a number, whatever way it was given; a text as it is."""
    assert names(f"{{grid: {{reference.value: [{value}, other]}}}}") == [(shown,), ("other",)]


CASES = [
    # the sweep, the text whose place is shown, path, message
    ("[1]", "[1]", "sweep", "must be a mapping (got [1])"),
    ("{}", "{}", "sweep", "needs a grid or a zip with at least one path"),
    ("{grid: {}}", "{grid", "sweep", "needs a grid or a zip with at least one path"),
    ("{gird: {seed: [1, 2]}}", "gird", "sweep.gird", "'gird' is not a known key; did you mean 'grid'?"),
    ("{grid: [seed]}", "[seed]", "sweep.grid", "must be a mapping from paths to lists of values"),
    ("{grid: {seed: []}}", "[]", "sweep.grid.seed", "must be a list of values"),
    ("{grid: {seed: {}}}", "{}}}", "sweep.grid.seed", "must be a list of values"),
    ("{grid: {seed: 3}}", "3", "sweep.grid.seed", "must be a list of values"),
    ("{grid: {seed: [1, 2, 1.0]}}", "[1", "sweep.grid.seed", "a value is given twice"),
    ("{zip: {seed: [1, 2, 1], initial.x: [2, 2, 2.0]}}", "{seed", "sweep.zip", "values 3 of all paths are given twice"),
    ("{grid: {runs: [1, 2]}}", "runs", "sweep.grid.runs", "'runs' is not a known key that can be swept"),
    ("{grid: {time.steps: [5, 6]}}", "time", 'sweep.grid."time.steps"',
     "of the time only its step can be swept: time.step"),
    ("{grid: {controler.Hp: [9, 8]}}", "contr", 'sweep.grid."controler.Hp"', "did you mean 'controller'?"),
    ("{grid: {a..b: [1]}}", "a..b", "", "'a..b' is not a path such as plant.kind"),
    ("{grid: {methods: [1]}}", "methods", "sweep.grid.methods", "name a method and one of its"),
    ("{grid: {methods.R-MPC: [1]}}", "methods", 'sweep.grid."methods.R-MPC"', "and one of its components, such as"),
    ("{grid: {methods.R-MPC.label: [a, b]}}", "methods", 'sweep.grid."methods.R-MPC.label"',
     "'label' is not a known component of a method that can be swept"),
    ("{zip: {methods.R-MCP.estimator.c: [1]}}", "methods", 'sweep.zip."methods.R-MCP.estimator.c"',
     "'R-MCP' is not a known method; did you mean 'R-MPC'?"),
    ("{zip: {seed: [1, 2], initial.x: [1, 2, 3]}}", "{seed", "sweep.zip",
     "all paths must have the same number of values (seed has 2, initial.x has 3)"),
    ("{grid: {seed: [1]}, zip: {seed: [3]}}", "seed: [3]", "sweep.zip.seed", "seed changes what seed changes, too"),
    ("{grid: {seed: [1, 2]}, exclude: [{seed: 3}]}", "{seed: 3", "sweep.exclude.0", "excludes no point"),
    ("{grid: {seed: [1, 2]}, exclude: [{seed: 1}, {seed: 2}]}", "[{", "sweep.exclude", "excludes every point"),
    ("{grid: {seed: [1, 2]}, exclude: [{sead: 1}]}", "sead", "sweep.exclude.0.sead",
     "'sead' is not a known path of this sweep; did you mean 'seed'?"),
    ("{grid: {seed: [1, 2]}, exclude: [3]}", "3", "sweep.exclude.0", "must be a mapping from paths to values"),
    ("{grid: {seed: [1, 2]}, exclude: {seed: 1}}", "{seed: 1}", "sweep.exclude", "must be a list of mappings"),
    (f"{{grid: {{controller.Q: &a [{HUNDRED}], controller.R: *a}}}}", "{grid", "sweep",
     "there must be at most 10,000 points (got 10,201)"),
    # an invalid value of a point: at the value, under its own path, once
    ("{grid: {controller.Hu: [3, 11, 4]}}", "11", "controller.Hu", "must be at most Hp = 10 (got 11)"),
    ("{grid: {plant.kind: [servo-linear, sevro]}}", "sevro", "plant.kind", "did you mean 'servo'?"),
    ("{grid: {plant.perturb.R: [1, 1 + epz]}}", "1 + epz", "plant.perturb.R", "did you mean 'eps'?"),
    ("{grid: {methods.R-MPC.estimator.c: [1, -1]}}", "-1", "methods.R-MPC.estimator.c", "must be > 0 (got -1)"),
    ("{grid: {reference: {a: {kind: constant, value: 1}, b: {kind: square, values: [0, 1], period: 1, dury: 1}}}}",
     "dury", None,
     "did you mean 'duty'?"),
    ("{grid: {noise.measurement.gaussian.std: [1, .inf]}}", ".inf", "noise.measurement.gaussian.std",
     "numbers here are finite"),
    ("{grid: {controller.Hp: {ten: 10, minus: -1}}}", "-1", "controller.Hp", "must be >= 1 (got -1)"),
    # a typo inside a path is a mistake of the path, at the key, once
    ("{grid: {controller.Hq: [3, 4]}}", "controller", None, "'Hq' is not a known key; did you mean 'H"),
    ("{grid: {plant.perturb.J_x: [1, 2]}}", "plant", None, "did you mean 'J_m'?"),
    ("{grid: {methods.R-MPC.estimater.c: [3, 4]}}", "methods", None, "did you mean 'estimator'?"),
    # the names of a zip are no path, and need one
    ("{grid: {name: [a, b]}}", "name", "sweep.grid.name", "'name' is not a known key that can be swept"),
    ("{zip: {name: [a, b]}}", "{name", "sweep.zip", "names nothing: give it at least one path"),
    ("{zip: {name: [a, a], seed: [1, 2]}}", "{name", "sweep.zip", "two points have the same name"),
    ("{zip: {name: [a, [b]], seed: [1, 2]}}", "{name", "sweep.zip", "a name is a text"),
    ("{zip: [{name: a}, {name: a, seed: 3}]}", "[{name", "sweep.zip", "two points have the same name"),
    ("{zip: [{name: a}, {seed: 3}]}", "[{name", "sweep.zip", "either all rows have a name or none has"),
    ("{zip: [{seed: 3}, 4]}", "4", "sweep.zip.1", "must be a mapping from paths to values (got 4)"),
    ("{zip: [{seed: 3}, {seed: 3}]}", "[{seed", "sweep.zip", "values 2 of all paths are given twice"),
    ("{zip: [{name: a}, {name: b, sead: 3}]}", "sead", "sweep.zip.1.sead", "did you mean 'seed'?"),
    ("{zip: [{name: a}, {name: b, controller.Hq: 3}]}", "controller.Hq", "controller.Hq", "did you mean"),
    ("{zip: [{name: a}, {name: b, controller.Hp: 0}]}", "0}", "controller.Hp", "must be >= 1 (got 0)"),
    ("{zip: []}", "[]", "sweep.zip", "must not be empty"),
    ("{zip: [{name: a}]}", "[{name", "sweep.zip", "names nothing"),
    ("{zip: {name: [a, b, c], seed: [1, 2]}}", "{name", "sweep.zip", "(name has 3, seed has 2)"),
    # two paths that set the same thing would name points that are not there
    ("{grid: {controller.Hp: [9], controller: [{kind: mpc, Hp: 5, Hu: 2, Q: 1, R: 1}]}}", "controller: [", None,
     "changes what controller.Hp changes, too; sweep one of them"),
    ("{grid: {seed: [1, 2], '\"seed\"': [3]}}", "'\"seed\"'", None, "changes what seed changes, too"),
    ("{grid: {initial.x: [1, 2]}, zip: {initial: [{x: 1}]}}", "initial: [", "sweep.zip.initial", "initial.x"),
]  # fmt: skip


@pytest.fixture
def mistakes(tmp_path):
    """Return a function that gives (line, column, path, message) of all mistakes in the small experiment."""

    def load(**keys):
        path = write(tmp_path, **keys)
        with pytest.raises(ConfigError) as caught:
            load_config(path)
        assert {problem.file for problem in caught.value.problems} == {str(path)}
        return [(each.line, each.column, each.path, each.message) for each in caught.value.problems]

    return load


@pytest.mark.parametrize(("sweep", "where", "path", "message"), CASES, ids=[case[0][:60] for case in CASES])
def test_one_mistake_is_reported_once_at_its_place(mistakes, sweep, where, path, message):
    """Line, column, key path, reason and the nearest choice; nothing that only follows from it."""
    [(line, column, named, text_shown)] = mistakes(sweep=sweep)
    assert line == len(KEYS) + 1 and message in text_shown
    assert where is None or column == len("sweep: ") + 1 + sweep.rindex(where)
    assert path is None or named == path


def test_all_mistakes_of_a_sweep_at_once(mistakes):
    """Sorted by place."""
    sweep = "{grid: {runs: [1], seed: [1, 1]}, zip: {initial.x: [], seed: [2]}, exlude: []}"
    found_there = mistakes(sweep=sweep)
    assert [each[:2] for each in found_there] == sorted(each[:2] for each in found_there)
    assert [each[2] for each in found_there] == [
        *("sweep.grid.runs", "sweep.grid.seed", 'sweep.zip."initial.x"', "sweep.zip.seed", "sweep.exlude"),
    ]


def test_mistakes_at_several_points_at_once(mistakes):
    """Each at its value."""
    found_there = mistakes(sweep="{grid: {controller.Hu: [3, 11], controller.Hp: [-1, 10], seed: [-5, 1]}}")
    assert {each[2:] for each in found_there} >= {
        ("controller.Hu", "must be at most Hp = 10 (got 11)"),
        ("controller.Hp", "must be >= 1 (got -1)"),
        ("seed", "must be >= 0 (got -5)"),
    }
    assert len(found_there) == 3


def test_a_mistake_outside_the_sweep_is_reported_once(mistakes):
    """Not at every point."""
    found_there = mistakes(sweep=f"{{grid: {{{HP}: [10, 11, 12]}}}}", seed=-1, metrics="[msee]")
    assert [each[2] for each in found_there] == ["seed", "metrics.0"]


@pytest.mark.parametrize("sweep", ["{grid: {runs: [1, 2]}}", "{grid: {seed.x: [1, 2]}}"])
def test_a_mistake_in_the_sweep_hides_no_other(mistakes, sweep):
    """Everything that is wrong is shown at once."""
    paths = [each[2] for each in mistakes(sweep=sweep, title="[1]", metrics="[msee]")]
    assert "metrics.0" in paths and "title" in paths and len(paths) >= 3


def test_overrides_reach_into_the_sweep(tmp_path):
    """`-s` replaces values of a path, adds a path, or takes the sweep away."""
    path = write(tmp_path, sweep=f"{{grid: {{{HP}: [10, 12]}}}}")

    def titles(*overrides):
        return [point.title for point in load_config(path, overrides=overrides).points]

    assert titles('sweep.grid."controller.Hp"=[5, 6, 7]') == [f"{HP}={value}" for value in (5, 6, 7)]
    assert titles('sweep.grid."controller.Hp".1=9') == [f"{HP}=10", f"{HP}=9"]
    assert titles("sweep.grid.seed=[8]") == [f"{HP}=10, seed=8", f"{HP}=12, seed=8"]
    assert titles("sweep=") == [""]
    with pytest.raises(ConfigError, match=r"-s sweep.grid.seed=\[8, -1\]:1:21: seed: must be >= 0 \(got -1\)"):
        titles("sweep.grid.seed=[8, -1]")


def test_overrides_of_what_is_swept(tmp_path):
    """Refused where they would change nothing, with the way out; a component around a swept key is another matter."""
    references = "{a: {kind: constant, value: 1}, b: {kind: constant, value: 2}}"
    path = write(tmp_path, sweep=f"{{grid: {{{HP}: [10, 12], reference: {references}}}}}")
    for override in (f"{HP}=5", "reference.value=3"):
        with pytest.raises(ConfigError, match=r"is swept, so this has no effect; set 'sweep.grid.") as caught:
            load_config(path, overrides=[override])
        [problem] = caught.value.problems
        assert problem.file == f"-s {override}" and problem.column == override.index("=") + 2
    assert len(load_config(path, overrides=[f"{HU}=2"]).points) == 4
    assert len(load_config(path, overrides=[f"{HP}=5", "sweep="]).points) == 1
    whole = load_config(path, overrides=["controller={kind: mpc, Hp: 4, Hu: 2, Q: 7, R: 1}"])
    assert [each.methods["S-MPC"]["controller"]["Hp"] for each in whole.points] == [10, 10, 12, 12]
    assert {each.methods["S-MPC"]["controller"]["Q"] for each in whole.points} == {7}


SQUARE = [({"a": a, "b": b}, f"{a}{b}") for a in "12" for b in "12"]


@pytest.mark.parametrize(
    ("rows", "axes", "paths"),
    [
        (SQUARE, [("a",), ("b",)], ("a", "b")),
        ([(there, there["a"]) for there, _ in SQUARE], [("a",), ("b",)], ("a",)),
        ([(there, there["b"]) for there, _ in SQUARE], [("a",), ("b",)], ("b",)),
        ([(there, "") for there, _ in SQUARE], [("a",), ("b",)], ()),
        ([({"a": "1", "b": "1"}, "x"), ({"a": "2", "b": "2"}, "y")], [("a", "b")], ("a", "b")),
        ([({"a": "1", "b": "1"}, "x"), ({"a": "2", "b": "2"}, "x")], [("a", "b")], ()),
        (SQUARE[:1], [("a",), ("b",)], ()),
        ([({}, "x")], [], ()),
    ],
)
def test_depends_names_the_paths_that_make_a_difference(rows, axes, paths):
    """The paths of a zip as one; a path of one value makes none."""
    assert relevant_paths(rows, axes) == paths


def refused(path):
    """Messages of a configuration that is refused."""
    with pytest.raises(ConfigError) as error:
        load_config(path)
    return [(problem.path, problem.message) for problem in error.value.problems]


def test_a_plant_from_two_files_whose_keys_are_replaced_is_refused(tmp_path):
    """Both points would have the numbers of the own keys; without them the points differ."""
    for name, stiffness in (("one", 1280), ("two", 640)):
        write(tmp_path, file=f"{name}.yaml", plant=f"{{kind: servo-linear, k_theta: {stiffness}}}")
    swept = "{grid: {plant.from: [one.yaml, two.yaml]}}"
    [(path, message)] = refused(
        write(tmp_path, file="both.yaml", plant="{k_theta: 900, perturb: {J_l: 1 + eps}}", sweep=swept)
    )
    assert path == 'sweep.grid."plant.from"'
    assert message.startswith("has no effect: one.yaml and two.yaml give the same runs of every method")
    assert message.endswith("plant.k_theta, plant.perturb of this configuration replace it")
    kept = load_config(write(tmp_path, file="kept.yaml", plant="{perturb: {J_l: 1 + eps}}", sweep=swept))
    assert len({point.experiment_hash for point in kept.points}) == 2
    # The extending file has a sweep, the extended one has the keys.
    write(tmp_path, file="base.yaml", plant="{kind: servo-linear, k_theta: 900}")
    (tmp_path / "child.yaml").write_text(f"extends: base.yaml\nname: child\nsweep: {swept}\n")
    assert [path for path, _ in refused(tmp_path / "child.yaml")] == ['sweep.grid."plant.from"']


@pytest.mark.parametrize(
    ("sweep", "keys", "reason"),
    [
        (
            "{grid: {model.k_theta: [1000, 1280]}}",
            {"methods": "{A: {estimator: {kind: kalman}, model: {kind: servo-linear, k_theta: 900}}}"},
            "every method has its own `model`",
        ),
        (
            "{grid: {estimator.c: [0.1, 0.2]}}",
            {
                "estimator": "{kind: robust-kalman}",
                "methods": "{A: {estimator: {c: 1}}, B: {estimator: {kind: kalman}}}",
            },
            "every method has its own `estimator`",
        ),
        ("{grid: {plant.perturb.J_l: [1 + eps, (1 + eps)]}}", {}, "nothing that is computed depends on it"),
        ("{zip: [{name: a, controller.Hp: 10}, {name: b, controller.Hp: 10}]}", {}, "nothing that is computed"),
    ],
)
def test_a_path_that_changes_nothing_is_refused_with_its_reason(tmp_path, sweep, keys, reason):
    [(path, message)] = refused(write(tmp_path, sweep=sweep, **keys))
    assert path.startswith("sweep.") and "has no effect" in message and reason in message


def test_a_path_may_have_an_effect_at_some_values_of_another_one_only(tmp_path):
    """The radius belongs to one of two estimators: its two values are told apart there."""
    sweep = "{grid: {methods.R-MPC.model.k_theta: [1280, 900], plant.perturb.J_l: [1 + eps, 1.0]}}"
    assert len(load_config(write(tmp_path, sweep=sweep)).points) == 4


ROWS = [
    "{plant.perturb: {R: 1 + eps}}",
    "{plant.perturb.R: 1 + 2*eps}",
    "{plant.R: 2}",
    "{uncertainty.eps: +-50%}",
    "{noise: none}",
    "{noise.measurement.gaussian.std: 0.5}",
    "{initial.x: 1}",
    "{initial: {x: 1, x_hat: 1, P: 2}}",
    "{reference.value: 0.5}",
    "{reference: {kind: square, values: [0, 1], period: 0.4}}",
    "{seed: 11}",
    "{time.step: 0.05}",
    "{model.noise.process: 2}",
    "{controller.Hp: 12}",
    "{methods.R-MPC.estimator.c: 0.2}",
]


@pytest.mark.parametrize(("row", "smoke"), [*((row, False) for row in ROWS), ("{time.step: 0.05}", True)])
@pytest.mark.parametrize("order", ["first", "last"])
def test_a_row_that_changes_what_another_leaves(tmp_path, row, order, smoke):
    """Whichever of the two comes first."""
    rows = [row[0] + "name: changed, " + row[1:], "{name: as given}"]
    path = write(
        tmp_path,
        sweep="{zip: [" + ", ".join(rows if order == "first" else rows[::-1]) + "]}",
        smoke="{runs: 2, steps: 5}",
    )
    config = load_config(path, smoke=smoke)
    again = tmp_path / "again.yaml"
    again.write_text(dump(plain(config.resolved)))
    loaded = load_config(again)
    assert [point.experiment_hash for point in loaded.points] == [point.experiment_hash for point in config.points]
    assert [point.method_keys for point in loaded.points] == [point.method_keys for point in config.points]
    assert loaded.resolved == config.resolved
    assert len({(point.experiment_hash, *point.method_keys.values()) for point in config.points}) == 2


def test_a_sweep_that_is_taken_away(tmp_path):
    """The resolved configuration has none either."""
    path = write(tmp_path, sweep="{zip: [{name: changed, seed: 3}, {name: as given}]}")
    config = load_config(path, overrides=["sweep=null"])
    (tmp_path / "again.yaml").write_text(dump(plain(config.resolved)))
    loaded = load_config(tmp_path / "again.yaml")
    assert [point.title for point in loaded.points] == [""]
    assert loaded.full_hash == config.full_hash
