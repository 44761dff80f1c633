"""What makes a sweep another experiment and what does not, and that one look at a file shows all its mistakes."""

import pytest
from small_experiment import cli, ran, spied, write
from stored_rows import forget

from rmpc_bench import load_config, load_trials
from rmpc_bench.types import ConfigError

STD = "noise.measurement.gaussian.std"
NAMED = f"{{grid: {{{STD}: {{quiet: 0.01, loud: 0.02}}}}}}"


@pytest.mark.parametrize(
    "after",
    [
        f"{{grid: {{{STD}: {{low: 0.01, high: 0.02}}}}}}",
        f"{{grid: {{{STD}: {{loud: 0.02, quiet: 0.01}}}}}}",
        f"{{grid: {{{STD}: [0.01, 0.02]}}}}",
        f"{{zip: [{{name: a, {STD}: 0.01}}, {{name: b, {STD}: 0.02}}]}}",
    ],
    ids=["renamed", "reordered", "without names", "row by row"],
)
@pytest.mark.long
def test_names_and_order_of_truths_are_not_the_experiment(tmp_path, monkeypatch, after):
    """The same truths: the directory is taken and nothing is computed again."""
    ran(write(tmp_path, sweep=NAMED), tmp_path / "a")
    blocks = spied(monkeypatch)
    result = cli("run", write(tmp_path, sweep=after), "-o", tmp_path / "a", "-j", 1)
    assert result.exit_code == 0 and not blocks


def test_points_with_different_methods_keep_their_series_apart(tmp_path):
    """Two methods with one estimator, of which an interrupted sweep has stored one at each point."""
    methods = "{a: {estimator: {kind: kalman}}, b: {estimator: {kind: kalman}, controller: {Hu: 2}}}"
    path = write(tmp_path, methods=methods, sweep=f"{{grid: {{{STD}: [0.01, 0.02]}}}}")
    ran(path, tmp_path / "a")
    first, second = load_config(path).points
    for key in (first.method_keys["b"], second.method_keys["a"]):
        forget(tmp_path / "a", key)
    trials = load_trials(tmp_path / "a")
    assert [point.methods for point in trials.points] == [("a",), ("b",)]
    assert [set(point.series["method"]) for point in trials.points] == [{"a"}, {"b"}]


@pytest.mark.parametrize("name", ["seed", "name"])
def test_a_metric_called_like_a_column(tmp_path, name):
    """Two columns of a table cannot have one name."""
    with pytest.raises(ConfigError, match=f"'{name}' is a column of the sweep already"):
        load_config(
            write(tmp_path, metrics=f"[{{kind: mse, name: {name}}}]", sweep="{zip: [{name: a}, {name: b, seed: 3}]}")
        )


def test_all_mistakes_at_once(tmp_path):
    """A wrong sweep hides neither the values of its right paths nor what is wrong elsewhere."""
    grid = "{controler.Hp: [9], methods.R-MPC.estimator.c: [0.1, -1], controller.Hu: [3, 99]}"
    sweep = f"{{grid: {grid}, exclude: [{{sead: 1}}]}}"
    claims = "[{says: a, source: b, check: 'mean(mse[X-MPC]) < 1'}, {says: c, source: d, check: 'mean(mse[S-MPC]'}]"
    figures = "[{kind: boxplot, metric: mes}]"
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, sweep=sweep, claims=claims, figures=figures, runs="-4"))
    said = "\n".join(map(str, caught.value.problems))
    for words in (
        "'controler' is not a known key that can be swept; did you mean 'controller'?",
        "estimator.c: must be > 0 (got -1)",
        "controller.Hu: must be at most Hp = 10 (got 99)",
        "'sead' is not a known path of this sweep",
        "'X-MPC' is not a known method",
        "claims.1.check: column",
        "figures.0.metric: 'mes' is not a known metric of this configuration; did you mean 'mse'?",
        "runs: must be >= 1 (got -4)",
    ):
        assert words in said
    assert len(caught.value.problems) == 8
