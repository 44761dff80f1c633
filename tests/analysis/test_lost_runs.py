"""Lost runs against counts by hand, SciPy's Wilson interval and the pass rates of a requirement."""

import math
from dataclasses import replace

import numpy as np
import pytest
from comparison_tables import table
from conftest import ROUND
from data_frames import arrays, comparison_frame, lost_frame, pass_frame
from scipy import stats

from rmpc_bench.analysis.verdict import largest_share
from rmpc_bench.types.metric import Limit, Requirement

NAN, INF = np.nan, np.inf


def counts(made):
    return lost_frame(made).set_index("method")[["n", "n_failed", "n_lost"]].to_numpy().tolist()


def test_a_run_is_lost_where_it_failed_or_exceeds_the_factor():
    """The limit itself is not beyond it; NaN is a failed run."""
    made = table({"KF": [1.0, 2.0, 1.0, 1.0], "X": [10.0, 20.1, NAN, 9.0]}, lost=10.0)
    assert counts(made) == [[4, 0, 0], [4, 1, 2]]
    assert counts(replace(made, lost=9.5)) == [[4, 0, 0], [4, 1, 3]]
    assert lost_frame(replace(made, lost=None)).empty


def test_where_the_baseline_failed_only_the_own_failure_counts():
    """The same for a baseline below 0, of which ten times is less; the baseline is lost where it failed."""
    made = table({"KF": [NAN, NAN, -1.0, 0.0, 0.0], "X": [1e9, NAN, -0.5, 1e-9, 0.0]}, lost=10.0)
    assert counts(made) == [[5, 2, 2], [5, 1, 2]]


def test_an_event_that_did_not_occur_is_beyond_any_limit():
    """It is inf; where the baseline has none either, the run is not lost. Large numbers do not overflow to that."""
    made = table({"KF": [3.0, INF, 1e308], "X": [INF, INF, 1.7e308]}, lost=10.0)
    assert counts(made) == [[3, 0, 0], [3, 0, 1]]


@pytest.mark.parametrize(("k", "n", "printed"), [(0, 60, 4.8703), (0, 1000, 0.29912), (3, 200, 3.8310)])
def test_the_bound_has_the_printed_values(k, n, printed):
    assert 100 * largest_share(k, n) == pytest.approx(printed, abs=6e-5)


@pytest.mark.parametrize("n", [1, 4, 60])
def test_the_bound_is_where_so_few_lost_runs_have_a_chance_of_5_per_cent(n):
    """The tail of the binomial distribution, summed; with all runs lost any share is possible."""
    for k in range(n):
        p = largest_share(k, n)
        tail = math.fsum(math.comb(n, i) * p**i * (1 - p) ** (n - i) for i in range(k + 1))
        assert tail == pytest.approx(0.05, rel=1e-9)
    assert largest_share(0, n) == pytest.approx(1 - 0.05 ** (1 / n), rel=1e-12)
    assert largest_share(n, n) == 1 and math.isnan(largest_share(0, 0))


@pytest.mark.parametrize("direction", ["lower", "higher"])
def test_far_worse_runs_of_both_methods_stand_beside_the_verdict(direction):
    """Runs that failed, and those 10 times worse than the partner; the factor itself is not beyond."""
    a = np.array([1.0, 1, 1, 1, np.nan, np.nan, 11, 1])
    b = np.array([1.0, 10, 11, np.nan, 1, np.nan, 1, np.inf])
    made = table({"A": a, "B": b} if direction == "lower" else {"A": 1 / a, "B": 1 / b}, direction=direction)
    row = comparison_frame(made).iloc[0]
    assert (row.far_worse_runs, row.baseline_far_worse_runs) == (4, 3)
    assert (row.far_worse_upper, row.baseline_far_worse_upper) == (largest_share(4, 8), largest_share(3, 8))
    assert comparison_frame(replace(made, lost=20.0)).iloc[0].far_worse_runs == 3
    assert math.isnan(comparison_frame(replace(made, with_verdicts=False)).iloc[0].far_worse_upper)
    # Of a signed metric a factor says nothing.
    assert comparison_frame(table({"A": -a, "B": b})).iloc[0].far_worse_runs == 2


def test_a_rare_disaster_that_was_not_seen_is_named_as_possible():
    """One run in a hundred is twenty times worse; without such a run the word is equivalent, beside the bound."""
    n_missed = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        logs = rng.normal(-0.0005, 0.002, 100) + np.log(20) * (rng.random(100) < 0.01)
        base = np.exp(0.3 * rng.normal(size=100))
        row = comparison_frame(table({"A": base, "B": base * np.exp(logs)})).iloc[0]
        assert row.far_worse_runs == (logs > 2).sum() and row.far_worse_upper > 0.01
        n_missed += row.verdict == "equivalent" and not row.far_worse_runs
    assert n_missed > 3


def test_absent_runs_are_not_counted():
    made = table({"KF": [1.0, 1.0, 1.0], "X": [20.0, 1.0, 1.0]}, lost=10.0)
    fewer = replace(made, columns=arrays(made.frame.drop(index=4)))
    assert counts(fewer) == [[3, 0, 0], [2, 0, 1]]


def test_the_baseline_need_not_be_shown():
    """A table for a paper may leave it out; the runs are lost against it nevertheless."""
    made = table({"KF": [1.0, 1.0, 1.0], "X": [20.0, 1.0, 1.0]}, lost=10.0)
    assert counts(replace(made, methods=("X",))) == [[3, 0, 1]]


@pytest.mark.parametrize(("k", "n"), [(0, 10), (3, 10), (10, 10), (37, 200)])
def test_the_share_has_the_interval_of_wilson(k, n):
    made = table({"KF": [1.0] * n, "X": [11.0] * k + [1.0] * (n - k)}, lost=10.0)
    row = lost_frame(made).iloc[1]
    expected = stats.binomtest(k, n).proportion_ci(0.95, method="wilson")
    np.testing.assert_allclose([row["lost_low"], row["lost_high"]], 100 * np.array(expected), **ROUND)
    assert row["lost_pct"] == 100 * k / n


def test_with_a_baseline_of_one_value_it_is_the_opposite_of_a_requirement(rng):
    """Oracle: runs that do not meet metric <= 10, failures among them."""
    values = rng.lognormal(1.5, 1.5, 300)
    values[::17] = NAN
    limit = Requirement("m <= 10", "m", (Limit("<=", 10.0),))
    made = replace(table({"KF": np.ones(300), "X": values}, lost=10.0), requirements=(limit,))
    lost, passed = lost_frame(made).iloc[1], pass_frame(made).iloc[1]
    assert 0 < lost["n_failed"] < lost["n_lost"] == passed["n"] - passed["passed"] < 300
    np.testing.assert_allclose(lost["lost_pct"], 100 - passed["pass_pct"], **ROUND)
