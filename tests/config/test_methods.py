"""Labels follow the parameters: templates, and labels made of what differs between the methods."""

import cProfile

import numpy as np
import pytest
from comparison_tables import table
from small_experiment import text, write

from rmpc_bench import load_config
from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.config.methods import written
from rmpc_bench.types import ConfigError

TEMPLATE = '{R-MPC1: {estimator: {kind: robust-kalman, c: 1e-1}, label: "R-MPC1, $c=${c}$"}}'


def labels(tmp_path, *overrides, **keys):
    """Return the labels of the small experiment."""
    return dict(load_config(write(tmp_path, **keys), overrides=overrides).labels)


def problem(tmp_path, *overrides, **keys):
    """Return the only problem of the small experiment."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, **keys), overrides=overrides)
    (found,) = caught.value.problems
    return found


@pytest.mark.parametrize(
    ("overrides", "label"),
    [
        ((), "R-MPC1, $c=10^{-1}$"),
        (("methods.R-MPC1.estimator.c=0.03",), "R-MPC1, $c=0.03$"),
        (("methods.R-MPC1.estimator.c=1",), "R-MPC1, $c=1$"),
        (("methods.R-MPC1.estimator.c=15e-5",), r"R-MPC1, $c=1.5 \cdot 10^{-4}$"),
    ],
)
def test_an_override_changes_the_label(tmp_path, overrides, label):
    """Oracle: by hand; a fixed text used to say 10^{-1} for every c."""
    assert labels(tmp_path, *overrides, methods=TEMPLATE) == {"R-MPC1": label}


def test_the_resolved_configuration_keeps_the_template(tmp_path):
    """Oracle: the label of a resolved configuration follows an override, too."""
    from rmpc_bench.config_file.yaml import dump

    config = load_config(write(tmp_path, methods=TEMPLATE))
    again = tmp_path / "again.yaml"
    again.write_text(dump(config.resolved), encoding="utf-8")
    assert load_config(again).labels == config.labels
    assert load_config(again, overrides=["methods.R-MPC1.estimator.c=2"]).labels == {"R-MPC1": "R-MPC1, $c=2$"}


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        ("$${c}^2$", "$10^{-1}^2$"),
        ("c ${c}, $H_p = ${Hp}$", "c 0.1, $H_p = 10$"),
        ("${estimator.c} ${controller.Q} ${kl}", "0.1 0.1 printed"),
        (r"$\theta$ of ${c}", r"$\theta$ of 0.1"),
        (r"5 \$ and ${c}", r"5 \$ and 0.1"),
        ("${controller.limits.u}", "[-220, 220]"),
        (r"${\hat x}$", r"${\hat x}$"),
        ("no parameter", "no parameter"),
    ],
)
def test_parameters_and_formulas_in_one_label(tmp_path, label, expected):
    """Oracle: by hand; an odd number of dollar signs before a parameter means that it stands in a formula."""
    methods = f"{{E: {{estimator: {{kind: robust-kalman, c: 1e-1}}, label: '{label}'}}}}"
    assert labels(tmp_path, methods=methods) == {"E": expected}


@pytest.mark.parametrize(
    ("label", "message"),
    [
        ("R, $c=${d}$", "column 7 of 'R, $c=${d}$': 'd' is not a known parameter of E"),
        ("${estimatr.c}", "'estimatr.c' is not a known parameter of E; did you mean 'estimator.c'?"),
        ("${C}", "'C' is not a known parameter of E; did you mean 'c'?"),
        ("${R}", "'R' is ambiguous; write ${model.R} or ${controller.R}"),
        ("a ${c", "column 3 of 'a ${c': '${' is not closed"),
    ],
)
def test_a_wrong_parameter_is_an_error_at_the_label(tmp_path, label, message):
    """Oracle: the place of the label, the column in it and the nearest name."""
    methods = f"{{E: {{estimator: {{kind: robust-kalman, c: 1e-1}}, label: '{label}'}}}}"
    found = problem(tmp_path, methods=methods)
    line = [*text(methods=methods).splitlines()].index(f"methods: {methods}") + 1
    assert (found.line, found.column) == (line, len("methods: ") + methods.index(f"'{label}'") + 1)
    assert found.path == "methods.E.label" and message in found.message


def test_a_swept_parameter_has_no_place_in_a_label(tmp_path):
    """Oracle: one label would be wrong at all points but one."""
    sweep = "{grid: {methods.R-MPC1.estimator.c: [0.1, 1]}}"
    found = problem(tmp_path, methods=TEMPLATE, sweep=sweep)
    assert found.path == "methods.R-MPC1.label" and "'estimator.c' changes with the sweep" in found.message
    assert labels(tmp_path, methods=TEMPLATE, sweep="{grid: {controller.Hp: [10, 12]}}")


ROBUST = "{estimator: {kind: robust-kalman, c: %s}}"


@pytest.mark.parametrize(
    ("methods", "expected"),
    [
        # Other kinds: the names.
        ("{S: {estimator: {kind: kalman}}, R: {estimator: {kind: robust-kalman, c: 0.1}}}", ["S", "R"]),
        # The same kind: the parameters that differ.
        (f"{{A: {ROBUST % 0.1}, B: {ROBUST % '1e-2'}}}", ["A, $c=10^{-1}$", "B, $c=10^{-2}$"]),
        # A value that is part of the name is not repeated, until it is overridden.
        (f"{{c 0.1: {ROBUST % 0.1}, c 0.01: {ROBUST % 0.02}}}", ["c 0.1", "c 0.01, $c=0.02$"]),
        # Defaults are not repeated.
        ("{A: {estimator: {kind: kalman}}, B: {estimator: {kind: kalman, form: predictor}}}",
         ["A", "B, form = predictor"]),
        ("{A: {estimator: {kind: robust-kalman, c: 1, kl: half}}, B: {estimator: {kind: robust-kalman, c: 1}}}",
         ["A, kl = half", "B"]),
        # A list: the names.
        ("{A: {estimator: {kind: kalman}}, B: {estimator: {kind: kalman}, model: {noise: {process: [1, 2, 3, 4]}}}}",
         ["A", "B"]),
    ],
)  # fmt: skip
def test_a_method_without_label_shows_what_differs(tmp_path, methods, expected):
    """Oracle: by hand."""
    assert [*labels(tmp_path, methods=methods).values()] == expected


def test_a_swept_parameter_is_left_out_of_a_derived_label(tmp_path):
    """Oracle: the title of a panel names the point."""
    methods = f"{{A: {ROBUST % 0.1}, B: {ROBUST % 0.2}}}"
    found = labels(tmp_path, methods=methods, sweep="{grid: {methods.A.estimator.c: [0.1, 0.5]}}")
    assert found == {"A": "A", "B": "B, $c=0.2$"}


@pytest.mark.parametrize(
    ("value", "inside", "outside"),
    [
        (0.1, "10^{-1}", "0.1"),
        (1e-3, "10^{-3}", "$10^{-3}$"),
        (1.5e-4, r"1.5 \cdot 10^{-4}", r"$1.5 \cdot 10^{-4}$"),
        (1.0, "1", "1"),
        (440, "440", "440"),
        (1e9, "10^{9}", "$10^{9}$"),
        (-0.25, "-0.25", "-0.25"),
        (-1e-7, r"-1 \cdot 10^{-7}", r"$-1 \cdot 10^{-7}$"),
        (0.0, "0", "0"),
        (2 / 3, "0.666667", "0.666667"),
        ("lag", "lag", "lag"),
        (True, "true", "true"),
        (None, "none", "none"),
        ([0.5, 4.0], "[0.5, 4]", "[0.5, 4]"),
    ],
)
def test_values_as_papers_write_them(value, inside, outside):
    """Oracle: by hand."""
    assert (written(value, math=True), written(value, math=False)) == (inside, outside)


def n_calls(work, *arguments):
    """Count the function calls of some work, which do not depend on how fast this machine is."""
    profile = cProfile.Profile()
    profile.runcall(work, *arguments)
    return sum(entry.callcount for entry in profile.getstats())


def test_a_check(tmp_path):
    """Pairs of identical methods, whose labels show the value in which they differ from the others."""
    paths = []
    for n in (2, 40, 320):
        methods = ", ".join(f"m{i}: {{estimator: {{kind: robust-kalman, c: 0.1{i // 2:04}}}}}" for i in range(n))
        paths.append(write(tmp_path, file=f"{n}.yaml", methods=f"{{{methods}}}"))
    load_config(paths[0])  # what is found once in a process
    few, many = (n_calls(load_config, path) for path in paths[1:])
    assert many < 10 * few


def test_a_comparison():
    """Whether a metric has negative values is one question to the table, not one to every method."""
    rng = np.random.default_rng(3)
    tables = [table({f"m{i}": np.exp(rng.normal(size=10)) for i in range(n)}) for n in (50, 400)]
    comparisons(tables[0])
    few, many = (n_calls(comparisons, each) for each in tables)
    assert many < 10 * few


def test_methods_without_a_controller(tmp_path):
    """Whether another method has one is one question to the configuration."""
    found = []
    for n in (2, 100, 800):
        methods = ", ".join(f"m{i}: {{}}" for i in range(n))
        path = write(tmp_path, file=f"{n}.yaml", methods=f"{{{methods}}}", controller=None)

        def refused(path=path):
            with pytest.raises(ConfigError):
                load_config(path)

        found.append(n_calls(refused))
    _, few, many = found
    assert many < 10 * few


def test_most_methods(tmp_path):
    """A check of each takes about a millisecond."""
    methods = ", ".join(f"m{i}: {{}}" for i in range(5001))
    with pytest.raises(ConfigError, match=r"methods: there must be at most 5,000 methods \(got 5,001\)"):
        load_config(write(tmp_path, methods=f"{{{methods}}}"))


def test_most_problems(tmp_path):
    """A terminal shows the first, and how many more there are."""
    keys = ", ".join(f"k{i}: 1" for i in range(70))
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, plant=f"{{kind: servo, {keys}}}"))
    assert len(caught.value.problems) >= 70
    assert str(caught.value).splitlines()[50:] == [f".. and {len(caught.value.problems) - 50} more"]


def test_the_largest_file(tmp_path):
    """PyYAML reads about 1 MB in a second, and 100,000 numbers of 20 digits have room."""
    path = write(tmp_path)
    path.write_text("# " + "x" * 3_000_000 + "\n" + path.read_text())
    with pytest.raises(ConfigError, match="cannot be read: is larger than 3 MB"):
        load_config(path)
