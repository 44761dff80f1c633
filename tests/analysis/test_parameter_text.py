"""Where parameters come from, in words: no method without its word, and none that is called tuned without being so."""

from dataclasses import replace

import pytest

from rmpc_bench.analysis.tuning import (
    is_tuned,
    pair_text,
    parameter_cells,
    parameter_legend,
    parameter_text,
    untuned_text,
)
from rmpc_bench.claims.claim import usual_parameters

TUNED = "tuned (budget 16, 40 runs)"


@pytest.fixture
def trials(make_trials):
    """Return a table with a tuned method, a default one and a published one."""
    table = make_trials({"mse": {"A": [1.0], "B": [1.0], "C": [1.0]}})
    return replace(table, baseline="A", parameters={"A": TUNED, "B": "default", "C": "as published"})


def test_only_a_tuned_method_is_called_tuned(trials):
    assert [parameter_text(trials, name) for name in "ABCD"] == [
        TUNED,
        "default, not tuned",
        "as published, not tuned",
        "",
    ]


def test_a_method_for_which_nothing_could_be_tuned_was_not_left_untuned(trials):
    word = "default (nothing could be tuned)"
    table = replace(trials, parameters=dict.fromkeys("ABC", word))
    assert untuned_text(table, "A") == parameter_text(table, "A") == word
    assert pair_text(table, "A", "B") == f"both {word}" and parameter_legend(table) == [f"parameters: {word}"]


def test_pairs_name_both_methods_unless_they_are_alike(trials):
    assert pair_text(trials, "A", "B") == f"A: {TUNED}, B: default, not tuned"
    assert pair_text(trials, "B", "A") == f"B: default, not tuned, A: {TUNED}"
    assert pair_text(replace(trials, parameters=dict.fromkeys("ABC", "default")), "A", "B") == "both default, not tuned"
    assert pair_text(replace(trials, parameters={}), "A", "B") == ""


def test_the_column_and_the_legend_of_methods_that_differ(trials):
    assert parameter_cells(trials, ["A", "B", "C"]) == ["tuned", "default", "as published"]
    assert parameter_legend(trials) == ["tuned = budget 16, 40 runs"]
    assert parameter_legend(replace(trials, baseline="C"))[1:] == ["C: as published, not tuned"]
    assert parameter_cells(replace(trials, parameters={}), ["A", "B"]) == []


def test_methods_that_were_tuned_with_different_budgets_have_each_its_own(trials):
    """One budget is in the legend, several are in the column."""
    elsewhere = "tuned (budget 9, 50 runs)"
    two = replace(trials, parameters={"A": TUNED, "B": elsewhere, "C": "as published"})
    assert parameter_cells(two, ["A", "B", "C"]) == [TUNED, elsewhere, "as published"]
    assert parameter_legend(two) == []
    one = replace(trials, parameters={"A": "default", "B": elsewhere, "C": elsewhere})
    assert parameter_cells(one, ["A", "B", "C"]) == ["default", "tuned", "tuned"]
    assert parameter_legend(one) == ["tuned = budget 9, 50 runs", "A: default, not tuned"]


@pytest.mark.parametrize(
    ("paper", "word"),
    [
        (None, "default"),
        ("zenere2018", "as published"),
        ("smith2020b", "as published"),
        ("servo-constrained", "default"),
    ],
)
def test_a_collection_of_configurations_is_no_publication(paper, word):
    assert usual_parameters(paper) == word


def test_values_of_other_settings_have_their_own_word_everywhere(trials):
    """Neither "tuned" in a column nor "not tuned" in a sentence."""
    other = "tuned for other settings"
    mixed = replace(trials, baseline="B", parameters={"A": TUNED, "B": other, "C": "default"})
    assert parameter_text(mixed, "B") == untuned_text(mixed, "B") == other and not is_tuned(mixed, "B")
    assert parameter_cells(mixed, ["A", "B", "C"]) == ["tuned", other, "default"]
    assert parameter_legend(mixed) == ["tuned = budget 16, 40 runs", f"B: {other}"]
    alike = replace(trials, parameters=dict.fromkeys("ABC", other))
    assert parameter_cells(alike, ["A", "B", "C"]) == [] and parameter_legend(alike) == [f"parameters: {other}"]
