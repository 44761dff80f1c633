"""Regret and ranks of searches whose objectives are known by construction."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, rankdata
from tuned_searches import PROTOCOL, constant, search, tuning

from rmpc_bench.analysis.tuning import COLUMNS, objectives, outcome, tuning_rows
from rmpc_bench.analysis.tuning_ranks import SETS, budgets_of, ranked, tuning_ranks
from rmpc_bench.types.tuning import TuningProtocol


def test_regret_is_the_loss_against_the_best_value_that_was_tried():
    """By hand: the second value is chosen (2 on the tuning runs) and has 1.5 on the test; the third has 1.2."""
    found = outcome(search("A", constant([4, 2, 3]), constant([5, 1.5, 1.2, 1.8])))
    assert (found.objective, found.test_default, found.test_tuned, found.test_best) == (2.0, 1.8, 1.5, 1.2)
    assert found.best == 2 and found.regret == pytest.approx(25.0, rel=1e-12)


def test_the_default_counts_among_the_values_that_were_tried():
    found = outcome(search("A", constant([4, 2]), constant([5, 3.0, 2.0]), default=0.7))
    assert found.best == 2 and found.best_values == (0.7,) and found.regret == pytest.approx(50.0, rel=1e-12)


@pytest.mark.parametrize(("scale", "regret"), [(1.0, 0.0), (1 + 1e-13, 0.0)])
def test_the_best_value_has_no_regret(scale, regret):
    """Also where another one is better by a rounding error only."""
    found = outcome(search("A", constant([2, 4]), constant([1.0 * scale, 1.0, 3.0])))
    assert found.best == 0 and found.regret == regret


def test_failed_runs_are_counted_and_cost_the_penalty():
    """One of 4 runs failed: mean 2 x (1 + 10 / 4) = 7, as the example of the protocol says."""
    failed = [[1.0, 2.0, 3.0, math.nan], [8.0, 8.0, 8.0, 8.0]]
    found = outcome(search("A", failed, [*failed, [math.nan] * 4]))
    assert found.objective == 7.0 and found.failed == found.test_failed == 0.25
    assert found.test_failed_default == 1.0 and found.test_default == math.inf and found.regret == 0.0


def test_a_search_in_which_everything_has_failed():
    found = outcome(search("A", [[math.nan] * 3] * 2, [[math.nan] * 3] * 3))
    assert found.objective == math.inf and math.isnan(found.regret)
    found = outcome(search("A", constant([1, 2]), [[math.inf] * 3, [1.0] * 3, [1.0] * 3]))
    assert found.regret == math.inf


def test_a_search_without_a_finite_objective_has_no_value_no_end_of_range_and_no_ranks():
    """The default stays: its objective on the test runs is known, no other is."""
    nothing = search("A", [[math.nan] * 3] * 2, constant([1, 2, 5]), values=[0.01, 10.0])
    found = outcome(nothing)
    assert nothing.chosen is None and nothing.values == {} and nothing.at_end == (False,)
    assert (found.objective, found.failed, found.test_default) == (math.inf, 1.0, 5.0)
    assert math.isnan(found.test_tuned) and math.isnan(found.test_best) and math.isnan(found.regret)
    frame = pd.DataFrame(tuning_rows(tuning(nothing)))
    assert math.isnan(frame["tuned"][0]) and frame["default"][0] == 0.1 and not frame["end_of_range"][0]
    assert tuning_ranks(PROTOCOL, [nothing], {"B": np.ones(3)}) is None


def test_methods_that_all_fail_on_the_test_runs_have_no_ranks():
    failing = search("A", constant([1, 2]), [[math.nan] * 3] * 3)
    assert tuning_ranks(PROTOCOL, [failing], {"B": np.full(3, np.nan)}) is None
    assert tuning_ranks(PROTOCOL, [failing], {"B": np.ones(3)}).ranks.tolist() == [[2, 1]]


def test_a_set_of_runs_in_which_nothing_finished_keeps_the_default():
    """One of 4 runs is finished: a set without it, probability .75^4, has the default (3), which loses to B (2)."""
    first = search("A", [[math.nan] * 3 + [1.0]], constant([1, 3], 4))
    found = tuning_ranks(PROTOCOL, [first], {"B": np.full(4, 2.0)})
    p = 0.75**4
    assert found.ranks.tolist() == [[1, 2]]
    assert abs(found.same_order - (1 - p)) < 5 * math.sqrt(p * (1 - p) / SETS)


def test_a_budget_in_which_nothing_finished_keeps_the_default():
    first = search("A", [[math.nan] * 3, [1.0] * 3], constant([1, 1, 3]), stages=["grid", "golden"])
    found = tuning_ranks(PROTOCOL, [first], {"B": np.full(3, 2.0)})
    assert found.budgets == (1, 2) and found.ranks.tolist() == [[2, 1], [1, 2]]


def test_without_test_runs_there_is_no_regret():
    found = outcome(search("A", constant([2, 4])))
    assert found.best == -1 and math.isnan(found.regret) and math.isnan(found.test_failed)
    assert found.best_values == (None,)


@pytest.mark.parametrize("statistic", ["mean", "median", "quantile 90%"])
def test_quick_objectives_are_those_of_the_protocol(statistic, rng):
    """Oracle: the protocol, one row at a time; with and without failed runs."""
    values = rng.lognormal(size=(5, 7, 11))
    values[2, :, 3] = np.nan
    values[4, 1] = np.inf
    protocol = TuningProtocol(5, 11, "mse", statistic)
    expected = [[float(protocol.objective(row)) for row in rows] for rows in values]
    np.testing.assert_allclose(objectives(protocol, values), expected, rtol=1e-8)  # nine digits are kept


def test_the_table_has_a_row_per_parameter_and_marks_the_end_of_a_range():
    at_end = search("A", constant([3, 2, 1]), constant([3, 2, 1, 4]), values=[0.1, 1.0, 10.0])
    inside = search("B", constant([3, 1, 2]), None, default=None)
    frame = pd.DataFrame(tuning_rows(tuning(at_end, inside)))
    assert tuple(frame.columns) == COLUMNS and frame["method"].tolist() == ["A", "B"]
    assert frame["end_of_range"].tolist() == [True, False] and frame["tuned"].tolist()[0] == 10.0
    assert frame["test_default"][0] == 4.0 and math.isnan(frame["default"][1]) and math.isnan(frame["regret_pct"][1])


def test_ranks_are_those_of_scipy(rng):
    values = rng.integers(0, 4, (50, 6)).astype(float)
    np.testing.assert_array_equal(ranked(values), rankdata(values, method="min", axis=1))


def test_budgets_are_the_grid_half_of_the_rest_and_all():
    of_16 = search("A", constant(range(16)), stages=["grid"] * 9 + ["golden"] * 7)
    assert budgets_of([of_16]) == (9, 12, 16)
    assert budgets_of([search("A", constant(range(4)))]) == (4,)


def test_ranks_after_each_budget_follow_from_the_values_tried_so_far():
    """A is second after its grid (3 against 2) and first after one more value (1); C is not tuned and stays last."""
    first = search("A", constant([4, 3, 1]), constant([4, 3, 1, 9]), stages=["grid", "grid", "golden"])
    second = search("B", constant([2, 5, 5]), constant([2, 5, 5, 9]), stages=["grid", "grid", "golden"])
    found = tuning_ranks(PROTOCOL, [first, second], {"C": np.full(3, 7.0)}, order=["C", "B", "A"])
    assert found.methods == ("C", "B", "A") and found.tuned == ("A", "B") and found.budgets == (2, 3)
    assert found.ranks.tolist() == [[3, 1, 2], [3, 2, 1]]
    assert found.changing == {"B": [1, 2], "A": [2, 1]}
    # Runs that are all alike: every bootstrap set is the same.
    assert found.same_order == found.same_winner == 1.0 and found.can_change == []


def test_the_share_of_sets_is_that_of_the_binomial_distribution():
    """A chooses its second value if the run with 9 is drawn often enough, and then loses to B.

    Value 1 has 1 in every run, value 2 has 0 in three runs and 9 in the fourth.  Its mean in a set with j copies of the
    fourth run is 9 j / 4, below 1 for j = 0 only.
    """
    first = search("A", [[1, 1, 1, 1], [0, 0, 0, 9]], constant([1, 3, 9], 4))
    second = search("B", constant([2, 2], 4), constant([2, 2, 9], 4))
    found = tuning_ranks(PROTOCOL, [first, second], {})
    p = binom.pmf(0, 4, 1 / 4)
    assert found.ranks.tolist() == [[1, 2]]
    assert abs(found.same_order - (1 - p)) < 5 * math.sqrt(p * (1 - p) / SETS)
    assert found.same_winner == found.same_order
    assert found.smallest.tolist() == [[1, 1]] and found.largest.tolist() == [[2, 2]]
    assert found.can_change == ["A", "B"]


def test_the_same_runs_are_drawn_for_all_methods():
    """Oracle: two methods whose values differ by a factor choose alike in every set, so their order never changes."""
    rng = np.random.default_rng(5)
    values = rng.lognormal(sigma=2.0, size=(6, 4))
    tests = np.vstack([np.arange(1.0, 7.0)[:, None] * np.ones(4), np.full(4, 99.0)])
    found = tuning_ranks(PROTOCOL, [search("A", values, tests), search("B", 1.01 * values, 1.01 * tests)], {})
    assert found.same_order == 1.0
    other = search("B", rng.lognormal(sigma=2.0, size=(6, 4)), 1.01 * tests)
    assert tuning_ranks(PROTOCOL, [search("A", values, tests), other], {}).same_order < 1.0


def test_there_are_no_ranks_without_test_runs_or_without_a_second_method():
    alone = search("A", constant([1, 2]), constant([1, 2, 3]))
    assert tuning_ranks(PROTOCOL, [alone], {}) is None
    assert tuning_ranks(PROTOCOL, [alone, search("B", constant([1, 2]))], {}) is None
    assert tuning_ranks(PROTOCOL, [alone], {"B": np.ones(3)}).ranks.tolist() == [[1, 1]]
    assert tuning_ranks(PROTOCOL, [], {"B": np.ones(3), "C": np.ones(3)}) is None


def test_a_method_with_fewer_values_keeps_its_choice():
    """Values that are equal after rounding are tried once, so a search may be shorter than the budget."""
    short = search("A", constant([2, 1]), constant([2, 1, 9]))
    long = search("B", constant([5, 4, 3, 0]), constant([5, 4, 3, 0.5, 9]), stages=["grid"] * 2 + ["golden"] * 2)
    found = tuning_ranks(PROTOCOL, [short, replace(long)], {})
    assert found.budgets == (2, 3, 4) and found.ranks.tolist() == [[1, 2], [1, 2], [2, 1]]
