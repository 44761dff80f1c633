"""The page docs/statistics.md: its worked comparisons are what the program computes, and cover every verdict."""

import numpy as np
import pytest
from docs.worked_comparisons import CASES, fails_more, screen_of, smoke, table_of

from rmpc_bench.analysis.verdict import Verdict

MADE = {make.__name__: table_of(make()) for make in CASES}


def compared(name):
    """Return the row of comparisons.csv of a case."""
    return MADE[name].rows[1].compared


def test_every_verdict_occurs():
    assert len(CASES) == 10
    assert {compared(name)["verdict"] for name in MADE} == {str(word) for word in Verdict}


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("better_size_uncertain", -9.0, -0.8),
        ("worse_size_uncertain", 0.9, 8.2),
        ("inconclusive", -7.6, 0.04),
        ("depends_on_average", 16.0, 25.0),
    ],
)
def test_the_runs_have_the_intervals_that_they_are_constructed_for(name, low, high):
    row = compared(name)
    np.testing.assert_allclose([row["geometric_low"], row["geometric_high"]], [low, high], rtol=1e-6)


def test_a_mean_below_the_other_beside_a_positive_change():
    """Both averages are shown."""
    table = MADE["worse_size_uncertain"]
    a, b = table.rows
    assert b.mean.value < a.mean.value
    assert b.compared["geometric_pct"] > 0 > b.compared["mean_pct"]


def test_superiority_counts_tied_runs_half():
    """By hand: 30 won and 10 tied of 40."""
    row = compared("better")
    assert (row["won"], row["lost"], row["tied"], row["superiority"]) == (30, 0, 10, 0.875)


def test_pairs_are_the_runs_that_both_finished():
    assert compared("fails_more")["n_pairs"] == 180 and screen_of(fails_more()).endswith("fails more 20/200")


def test_a_smoke_run_has_no_numbers_but_its_sizes():
    assert screen_of(smoke()).split() == ["A", "ran", "B", "ran"]
