"""Two tables of trials, entry by entry."""

import numpy as np
import pytest
from comparison_tables import table

from rmpc_bench.analysis.trial_differences import trial_differences

VALUES = {"A": [1.0, 2.0, 4.0, np.nan], "B": [1.0, np.inf, 3.0, 5.0]}


def changed(method, run, value):
    values = {name: list(column) for name, column in VALUES.items()}
    values[method][run] = value
    return table(values)


def test_a_table_equals_itself():
    """Failed runs and values that are inf in both are equal."""
    found = trial_differences(table(VALUES), table(VALUES))
    assert found.equal and not found.differing
    assert (found.n_trials, found.n_values) == (8, 7)


@pytest.mark.parametrize(
    ("value", "tolerance", "equal"), [(4.0 + 4e-9, 0.0, False), (4.0 + 3e-9, 1e-9, True), (4.0 + 5e-9, 1e-9, False)]
)
def test_values_are_equal_up_to_the_tolerance(value, tolerance, equal):
    """Relative to the larger of the two; the run is named."""
    found = trial_differences(table(VALUES), changed("A", 2, value), tolerance)
    assert found.equal is equal
    [only] = [each for each in found.values if each.method == "A"]
    assert (only.relative.run, only.relative.a, only.relative.b) == (2, 4.0, value)
    assert only.relative.size == pytest.approx((value - 4) / value) and only.absolute.size == value - 4


@pytest.mark.parametrize(("run", "value"), [(0, np.inf), (1, 2.0), (1, -np.inf)])
def test_a_value_that_is_infinite_in_one_differs_for_every_tolerance(run, value):
    """It is counted apart, since its difference has no size."""
    found = trial_differences(table(VALUES), changed("B", run, value), 10.0)
    [only] = found.differing
    assert (only.n_apart, only.apart.run, only.relative.size) == (1, run, 0.0)


def test_a_status_that_differs():
    """The value of a run that failed in one of the two is not compared a second time."""
    found = trial_differences(table(VALUES), changed("A", 1, np.nan))
    [only] = found.statuses
    assert (only.method, only.run, only.a, only.b) == ("A", 1, "ok", "diverged")
    assert not found.differing and not found.equal


def test_what_only_one_has():
    """Methods, metrics and runs; the others are compared."""
    short = table({"B": VALUES["B"][:2], "C": [1.0, 1.0]})
    found = trial_differences(table(VALUES), short)
    assert found.methods == (("A",), ("C",)) and found.metrics == ((), ())
    [runs] = found.runs
    assert (runs.method, runs.runs_a, runs.runs_b) == ("B", (2, 3), ())
    assert found.n_trials == 2 and not found.equal
    assert trial_differences(table(VALUES), table(VALUES, metric="other")).metrics == (("m",), ("other",))
    assert not trial_differences(table(VALUES), table(VALUES, metric="other")).equal


def test_runs_are_paired_by_their_index():
    """Not by their place in the table."""
    found = trial_differences(table(VALUES), table({name: column[1:] for name, column in VALUES.items()}, first=1))
    assert not found.differing
    assert {each.runs_a for each in found.runs} == {(0,)}


def test_two_tables_without_a_common_trial_are_not_equal():
    """However few they have."""
    assert not trial_differences(table({"A": [1.0]}), table({"B": [1.0]})).equal
