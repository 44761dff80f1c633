"""Requirements in a configuration: what is read, and what is refused with its place."""

import pytest
from small_experiment import write

from rmpc_bench import load_config, publish, requirements, run
from rmpc_bench.config.statistics import read_requirement
from rmpc_bench.expressions.tokens import ExpressionError
from rmpc_bench.types import ConfigError
from rmpc_bench.types.metric import Limit

METRICS = ("mse", "settling_time", "error")


@pytest.mark.parametrize(
    ("text", "metric", "limits", "absolute"),
    [
        ("settling_time < 20", "settling_time", [("<", 20.0)], False),
        ("20 >= settling_time", "settling_time", [("<=", 20.0)], False),
        ("abs(error) <= 5%", "error", [("<=", 0.05)], True),
        ("-0.1 < error < 2*0.1", "error", [(">", -0.1), ("<", 0.2)], False),
        ("mse > sqrt(4)", "mse", [(">", 2.0)], False),
    ],
)
def test_what_is_read(text, metric, limits, absolute):
    """The metric stands on the left of every limit, whatever side it is written on."""
    found = read_requirement(text, METRICS)
    assert (found.text, found.metric, found.absolute) == (text, metric, absolute)
    assert found.limits == tuple(Limit(*limit) for limit in limits)


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("setling_time < 20", 1, "did you mean 'settling_time'"),
        ("settling_time", 14, "expected a comparison"),
        ("settling_time < mse", 15, "one metric, once"),
        ("1 < 2", 3, "one metric, once"),
        ("error < 1 < 2", 7, "one metric, once"),
        ("0 < 1 < error < 2", 3, "one metric, once"),
        ("2*error < 1", 1, "no arithmetic with a metric"),
        ("abs(2) < 1", 1, "abs takes the name of a metric"),
        ("error <", 8, "expected a number or the name of a metric"),
        ("error < 1 2", 11, "operator is missing"),
        ("error < 1/0", 9, "no arithmetic with a metric"),
    ],
)
def test_what_is_refused(text, column, words):
    """With the column, and the nearest choice for a metric."""
    with pytest.raises(ExpressionError) as caught:
        read_requirement(text, METRICS)
    assert (caught.value.column, words in caught.value.message) == (column, True)


@pytest.mark.parametrize(("value", "path"), [("mze < 1", "requirement"), ("[mse < 1, mze < 1]", "requirement.1")])
def test_an_error_has_its_place(tmp_path, value, path):
    """A text or an entry of the list."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, statistics=f"{{requirement: {value}}}"))
    (problem,) = caught.value.problems
    assert problem.path == f"statistics.{path}"
    assert "did you mean 'mse'" in problem.message


def test_they_are_counted_from_stored_trials_and_change_no_trial(tmp_path):
    """One is added to a finished directory; the identity of the experiment stays."""
    plain = load_config(write(tmp_path))
    config = load_config(write(tmp_path, statistics="{requirement: [mse < 1e9, mse < 0]}"))
    assert config.hash == plain.hash
    run(plain, directory=tmp_path / "out", jobs=1)
    results = run(config, directory=tmp_path / "out", jobs=1)
    assert requirements(results).frame["passed"].tolist() == [6, 6, 0, 0]
    paths = [path.name for path in publish(results, to=tmp_path / "published").paths]
    assert {"requirements.csv", "requirements.md"} <= set(paths)
    page = (tmp_path / "published" / "tables" / "summary.md").read_text(encoding="utf-8")
    assert "| `mse < 1e9` | S-MPC | 6 of 6 |" in page
