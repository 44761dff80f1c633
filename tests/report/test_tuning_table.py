"""Tables, sentences and lines on tuning, from searches whose numbers are known by hand."""

import io
from dataclasses import replace
from decimal import Decimal

import numpy as np
import pandas as pd
import pytest
from tuned_searches import constant, search, tuning

from rmpc_bench.report.point_tables import csv_lines
from rmpc_bench.report.run_notes import percent
from rmpc_bench.report.tuning_table import MOST_POINTS, TuningTable
from rmpc_bench.types.tuning import TunedParameter

STAGES = ["grid", "grid", "golden"]


@pytest.fixture
def trials(make_trials):
    """Return a table of two tuned methods and one that is not tuned, with three runs."""
    made = make_trials({"mse": {"C": [7.0] * 3, "A": [1.0] * 3, "B": [2.0] * 3}})
    return replace(made, parameters={"C": "as published"})


@pytest.fixture
def made(trials):
    """A is second after two values and first after three, at the end of its range; B has a regret of 25 %."""
    first = search("A", constant([4, 3, 1]), constant([4, 3, 1, 9]), stages=STAGES, values=[0.1, 1.0, 10.0])
    second = search("B", constant([2, 5, 5]), constant([2.5, 5, 2, 9]), stages=STAGES, values=[0.02, 0.3, 5.0])
    found = tuning(first, second)
    return TuningTable(replace(trials, parameters={**trials.parameters, **found.parameters}), found)


def test_numbers_of_the_file_and_sentences_on_the_ranks(made):
    frame = pd.read_csv(io.StringIO("".join(csv_lines(made.content))))
    assert "point" not in frame and frame["method"].tolist() == ["A", "B"]
    assert frame["tuned"].tolist() == [10.0, 0.02] and frame["end_of_range"].tolist() == [True, False]
    assert frame["regret_pct"].tolist() == [0.0, 25.0] and frame["best_on_test"].tolist() == [10.0, 5.0]
    assert frame["rank"].tolist() == [1, 2] and frame["ranks"].tolist() == ["2: 2, 3: 1", "2: 1, 3: 2"]
    assert frame["same_order_pct"].tolist() == [100.0, 100.0]
    assert made.sentences == (
        "Other tuning runs: the order is the same in 100 % of 200 bootstrap sets, the first rank in 100 %.",
        "Ranks that change with the budget (2, 3 values): A 2, 1; B 1, 2.",
    )


def test_markdown_has_the_values_and_the_ranks_of_all_methods(made):
    text = made.to_markdown()
    assert "| method | parameter | range | default | tuned | best on test | tuning: tuned |" in text
    tuned = "| A | estimator.radius | 0.01 to 10 | 0.1 | 10 (end of range) | 10 | 1 | 9 | 1 | 1 | 0 % | 0 % | 0 % |"
    assert tuned in text and "| C | as published, not tuned | 3 (3 to 3) | 3 (3 to 3) |" in text
    assert "| A | tuned (budget 4, 3 runs) | 2 (2 to 2) | 1 (1 to 1) |" in text
    assert "mean of mse over the finished runs x (1 + 10 x share of failed runs)" in text
    for block in text.split("\n\n"):
        assert len({row.count("|") for row in block.splitlines() if row.startswith("|")}) <= 1


def test_the_screen_has_a_line_and_says_where_a_search_found_nothing(made, trials):
    """No rank, no regret and no end of a range, although the first value of the list is one."""
    size = "budget 4, 3 runs (tables/tuning.md)"
    assert made.gist == f"tuned: A radius 10 (end of range), B radius 0.02; {size}"
    searches = [search(f"M{i}", constant([2, 1]), values=[0.01, 10.0]) for i in range(4)]
    many = TuningTable(trials, tuning(*searches, search("L", [[np.nan] * 3] * 2, values=[0.1, 1.0])))
    ends = ", ".join(f"M{i}" for i in range(4))
    size += "; no ranks: nothing could be tuned for L"
    assert many.gist == f"tuned: 4 methods; nothing found for L; at the end of its range: {ends}; {size}"
    nothing = search("A", [[np.nan] * 3] * 2, constant([1, 2, 5]), values=[0.01, 10.0])
    table = TuningTable(trials, tuning(nothing, search("B", constant([2, 5]), constant([2, 5, 9]))))
    assert not table.ranks
    assert table.limitations[0] == "Nothing could be tuned, so the defaults stay: A."
    assert table.sentences[-1] == "No ranks: nothing could be tuned for A."
    size = "budget 4, 3 runs (tables/tuning.md)"
    assert table.gist == f"tuned: A nothing found, B radius 0.02; {size}; no ranks: nothing could be tuned for A"
    assert "| A | estimator.radius | 0.01 to 10 | 0.1 | - | - | inf | 5 | - | - | - |" in table.to_markdown()


def test_without_test_runs_or_without_tuning(trials):
    made = TuningTable(trials, tuning(search("A", constant([2, 1]), default=None)))
    why = "o ranks: the values were computed on no runs of the experiment, which has 3"
    assert made.sentences == (f"N{why}.",) and made.gist.endswith(f"n{why}")
    text = made.to_markdown()
    assert "| method | parameter | range | default | tuned | tuning: tuned | tuning: failed |" in text
    assert "| A | estimator.radius | 0.01 to 10 | - | 5 | 1 | 0 % |" in text
    assert made.frame["rank"].isna().all() and made.frame["ranks"].tolist() == [""]
    made = TuningTable(trials, None)
    assert made.gist == "" and made.to_markdown() == "" and made.sentences == () and made.frame.empty
    texts = {0.0: "0 %", 0.034: "0.034 %", 2.35: "2.4 %", 99.4: "99 %", 99.5: "100 %", 1234.0: "1234 %"}
    assert {value: percent(value) for value in texts} == texts


def test_two_parameters_have_two_rows_and_failed_runs_are_counted(trials):
    failed = [[1.0, 1.0, np.nan], [9.0, 9.0, 9.0]]
    base = search("A", failed, [[1.0] * 3, [9.0] * 3, [1.0] * 3])
    both = (base.parameters[0], replace(base.parameters[0], path="model.scale", low=1.0, high=4.0, integer=True))
    two = replace(base, parameters=both, default=(0.1, 2.0), candidates=np.array([[0.1, 3.0], [0.5, 2.0]]))
    made = TuningTable(trials, tuning(two))
    assert made.frame["parameter"].tolist() == ["estimator.radius", "model.scale"]
    assert "| A | model.scale | 1 to 4, whole numbers | 2 | 3 |" in made.to_markdown()
    assert "| 33 % | 0 % |" in made.to_markdown()


def test_a_sweep_has_a_table_per_point_and_a_line_on_the_screen(trials, make_sweep):
    names = [f"s={i}" for i in range(MOST_POINTS + 2)]
    sweep = make_sweep(*[({"s": name[2:]}, replace(trials, title=name)) for name in names])
    tests = [constant([1 + i / 100, 1.0 + i / 10, 9]) for i in range(len(names))]
    searches = [search("A", constant([2, 1]), test, point=name) for name, test in zip(names, tests, strict=True)]
    made = TuningTable(sweep, tuning(*searches))
    assert made.frame["point"].tolist() == names
    text = made.to_markdown()
    assert text.count("## s=") == MOST_POINTS and "2 more points of the sweep: tuning.csv" in text
    assert made.gist == "tuned: 1 method; budget 4, 3 runs (tables/tuning.md)"
    assert made.sentences[0].startswith("s=0: Other tuning runs") and len(made.ranks) == len(names)


def test_ranks_need_the_values_on_all_runs_of_the_experiment(made, make_trials):
    """Those of the first look, or of an experiment that goes on, would be ranks of other runs than the comparison."""
    other = make_trials({"mse": {"C": [0.1] * 5, "A": [1.0] * 5, "B": [2.0] * 5}})
    table = TuningTable(other, made.tuning)
    assert not table.ranks and made.ranks[""].methods == ("C", "A", "B")
    why = "No ranks: the values were computed on 3 runs of the experiment, which has 5."
    assert table.sentences[-1] == why and why[4:-1] in table.gist and f"- {why}" in table.to_markdown()


@pytest.mark.parametrize(
    ("tuning_runs", "test_runs", "why"),
    [
        (1, 3, "one tuning run does not show how they depend on the tuning runs"),
        (3, 1, "the values were computed on 1 run of the experiment, which has 1"),
        (3, 3, "every run of the experiment has failed"),
    ],
)
def test_one_run_gives_no_ranks_and_no_share_of_bootstrap_sets(make_trials, tuning_runs, test_runs, why):
    metric = np.nan if why.startswith("every") else 1.0
    table = make_trials({"mse": {"A": [metric] * test_runs, "B": [metric] * test_runs}})
    tests = metric * constant([2, 1, 3], test_runs)
    made = TuningTable(table, tuning(*(search(name, constant([2, 1], tuning_runs), tests) for name in "AB")))
    assert not made.ranks and made.sentences[-1] == f"No ranks: {why}."
    text = "\n".join([made.gist, *made.sentences])
    assert "bootstrap" not in text and "rank 1" not in text and made.frame["same_order_pct"].isna().all()


@pytest.mark.parametrize("tiny", [1e-5, 1.23e-9, 0.3])
def test_a_value_close_to_its_offset_keeps_its_digits(trials, tiny):
    keys = {"parameters": (TunedParameter("estimator.alpha", 1e-10, 1.0, offset=1.0),), "default": 1.01}
    found = search("A", constant([1, 2]), constant([1, 2, 3]), values=[1 + tiny, 2.0], **keys)
    table = TuningTable(trials, tuning(found))
    text = f"{Decimal(1) + Decimal(repr(tiny))}"
    assert f"| 1.0000000001 to 2 | 1.01 | {text} | {text} |" in table.to_markdown()
    assert table.frame["tuned"].tolist() == table.frame["best_on_test"].tolist() == [1 + tiny]
