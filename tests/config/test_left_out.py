"""Claims, figures and settings that an override makes impossible are left out and named; mistakes are errors."""

from pathlib import Path

import pytest
from missing_libraries import skip_without_libraries
from small_experiment import cli, ran, write

from rmpc_bench import load_config, load_results
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load, one_line
from rmpc_bench.types import ConfigError

CONFIGS = Path(__file__).parents[2] / "configs"
CLAIMS = (
    "[{says: all, source: s, check: 'mean(mse[R-MPC]) < mean(mse[S-MPC])', finding: confirmed},"
    " {says: one, source: s, check: 'mean(input_power[S-MPC]) > 0', finding: confirmed}]"
)
STATISTICS = "{primary: mse, baseline: S-MPC, relevant: {mse: 2%, input_power: 3%}, requirement: [mse < 1]}"
FIGURES = "[boxplot, {kind: boxplot, metric: input_power}, signals]"
ONE = "methods={S-MPC: {estimator: {kind: kalman}}}"
OTHER = "methods={K: {estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.1}}}"


@pytest.fixture
def path(tmp_path):
    return write(
        tmp_path,
        claims=CLAIMS,
        statistics=STATISTICS,
        figures=FIGURES,
        record="{signals: [y], runs: 2}",
        report="{order: [R-MPC, S-MPC], metrics: [mse]}",
    )


def test_an_invalid_section_with_an_entry_that_is_left_out_is_an_error(tmp_path):
    path = write(tmp_path, report="{order: [S-MPC, NOPE], width: 1000in}")
    with pytest.raises(ConfigError, match="report: the width"):
        load_config(path, overrides=["runs=3"])


@pytest.mark.parametrize(
    ("override", "n_claims", "n_figures", "named"),
    [
        ("seed=8", 2, 3, ()),
        (
            ONE,
            1,
            3,
            ("1 of 2 claims (claims.0.check: 'R-MPC' is not a known method", "report.order.0"),
        ),
        (OTHER, 0, 3, ("2 of 2 claims", "statistics.baseline: S-MPC does not exist here; it is K", "report.order.1")),
        (
            "metrics=[iae]",
            0,
            2,
            (
                *("2 of 2 claims", "statistics.primary: mse does not exist here; it is iae instead"),
                *("statistics.relevant.mse", "statistics.requirement.0", "figure boxplot: ", "report.metrics.0"),
            ),
        ),
        ("sweep={grid: {controller.Hp: [5, 10]}}", 0, 3, ("2 of 2 claims (claims.0.check: mse[R-MPC] may be at any",)),
        ("time.steps=3", 2, 3, ()),
        ("record={runs: none}", 2, 2, ("figure signals: ",)),
    ],
)
def test_what_does_not_fit_an_override_is_left_out(path, override, n_claims, n_figures, named):
    """And named, with the reason; the resolved configuration has what is left."""
    config = load_config(path, overrides=[override])
    assert (len(config.claims), len(config.figures)) == (n_claims, n_figures)
    lines = "\n".join(config.left_out)
    assert all(text in lines for text in named), lines
    assert bool(named) == bool(config.left_out)
    assert (len(config.resolved["claims"]), len(config.resolved["figures"])) == (n_claims, n_figures)


def test_a_smaller_number_of_runs(path):
    """Keeps every claim and figure, as far as recorded runs exist."""
    assert load_config(path, runs=3).left_out == ()


@pytest.mark.parametrize(
    ("override", "place"),
    [
        ("figures=[{kind: boxplot, metric: msee}]", "figures.0.metric"),
        ("claims=[{says: a, source: b, check: 'mean(mse[R-NPC]) < 1'}]", "claims.0.check"),
        ("statistics.baseline=S-NPC", "statistics.baseline"),
        ("statistics.primary=msee", "statistics.primary"),
        ("methods.R-MPC.estimator.kind=robust-kalmann", "methods.R-MPC.estimator.kind"),
        ("metrics=[msee]", "metrics.0"),
        ("sweep={grid: {controller.Hq: [5]}}", "Hq"),
        ('methods.R-MPC.label="$c=${d}$"', "methods.R-MPC.label"),
    ],
)
def test_a_mistake_in_the_override_is_an_error(path, override, place):
    """With the nearest choice; nothing that it says is left out."""
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides=[override])
    assert any(place in problem.path and problem.file.startswith("-s ") for problem in caught.value.problems), (
        caught.value
    )


def test_without_an_override_the_same_is_an_error(tmp_path):
    """The file must fit itself."""
    path = write(tmp_path, claims=CLAIMS.replace("R-MPC", "R-NPC"))
    with pytest.raises(ConfigError, match="did you mean 'R-MPC'"):
        load_config(path)


def test_a_label_that_names_what_is_swept(tmp_path):
    """It is made of the name and what differs, as without a template."""
    methods = (
        "{S-MPC: {estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.1}, label: 'R, $c=${c}$'}}"
    )
    path = write(tmp_path, methods=methods)
    assert load_config(path).labels["R-MPC"] == "R, $c=10^{-1}$"
    config = load_config(path, overrides=["sweep={grid: {methods.R-MPC.estimator.c: [0.1, 0.2]}}"])
    assert config.labels["R-MPC"] == "R-MPC"
    assert config.left_out[0].startswith("label of R-MPC: ")


def test_metrics_behind_the_end_of_a_shorter_run(tmp_path):
    """They are left out at all points; one that the override gives is an error, and so is a file without any left."""
    window = "{kind: mse, name: late, from: 6, to: 9}"
    path = write(tmp_path, metrics=f"[{window}, mse]", sweep="{grid: {seed: [1, 2]}}")
    config = load_config(path, overrides=["time.steps=4"])
    assert [[info.name for info in point.experiment.metric_infos] for point in config.points] == [["mse"], ["mse"]]
    [line] = config.left_out
    assert line.startswith("metric metrics.0: the window from 6 to 9")
    for overrides in (["time.steps=4", f"metrics=[{window}, mse]"], ["time.steps=4", f"metrics=[{window}]"]):
        with pytest.raises(ConfigError, match="the window from 6 to 9"):
            load_config(path, overrides=overrides)
    alone = write(tmp_path, file="alone.yaml", metrics=f"[{window}]")
    with pytest.raises(ConfigError, match="the window from 6 to 9"):
        load_config(alone, overrides=["time.steps=4"])


@pytest.mark.parametrize(
    ("sweep", "n_points"),
    [
        ("{grid: {methods.R-MPC.estimator.c: [0.1, 0.2], seed: [1, 2]}}", 2),
        ("{zip: [{name: a}, {name: b, methods.R-MPC.estimator.c: 0.2}, {name: c, seed: 5}]}", 3),
        ("{zip: {methods.R-MPC.estimator.c: [0.1, 0.2], seed: [1, 2]}}", 2),
    ],
)
def test_paths_of_the_sweep_into_a_method_that_is_gone(tmp_path, sweep, n_points):
    """They are left out; the other paths stay."""
    path = write(tmp_path, sweep=sweep)
    config = load_config(path, overrides=[ONE])
    assert len(config.points) == n_points
    assert config.left_out == ("paths of the sweep into methods that do not exist here: methods.R-MPC.estimator.c",)
    with pytest.raises(ConfigError, match="is not a known method"):
        load_config(path, overrides=[ONE, "sweep={grid: {methods.R-MPC.estimator.c: [0.1]}}"])


def test_the_command_line_says_what_is_left_out(path, tmp_path):
    """One line each on stderr; the run and its report work."""
    found = cli("run", path, "-s", ONE, "-o", tmp_path / "out", "-j", 1, "--progress", "none")
    assert found.exit_code == 0, found.output
    assert "left out: 1 of 2 claims" in found.stderr and "left out: report.order.0" in found.stderr
    assert " claims: not evaluated, the configuration was overridden" in found.stdout
    assert not load_results(tmp_path / "out").is_final
    ran(tmp_path / "out" / "config.resolved.yaml", tmp_path / "again")


def _overrides(tree):
    """Yield overrides of the kinds that users make, for one configuration."""
    methods = tree["methods"]
    names = [*methods]
    if len(names) > 1:
        yield "methods=" + one_line({name: methods[name] for name in names[1:]})
        yield "methods=" + one_line({name: methods[name] for name in names[:-1]})
    yield "methods=" + one_line({f"{name} new" if name == names[0] else name: methods[name] for name in names})
    yield "metrics=[iae]"
    yield "sweep={grid: {seed: [1, 2]}}"
    length = "duration" if "duration" in tree["time"] else "steps"
    yield f"time.{length}={tree['time'][length] / 2 if length == 'duration' else max(1, tree['time'][length] // 2)}"
    yield "record={runs: none}"


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted(CONFIGS.rglob("*.yaml")), ids=lambda file: f"{file.parent.name}-{file.stem}")
def test_overrides_of_every_configuration(file):
    """No error is about a claim, a figure or a setting of the comparison of the file itself."""
    skip_without_libraries(file)
    tree = plain(load(file))
    if "time" not in tree or "methods" not in tree:
        pytest.skip("takes these from another file")
    for override in _overrides(tree):
        try:
            load_config(file, overrides=[override], smoke=True)
        except ConfigError as error:
            sections = {problem.path.split(".")[0] for problem in error.problems}
            assert not sections & {"claims", "figures", "statistics", "report"}, f"{override}\n{error}"
