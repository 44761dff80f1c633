"""Ranks as intervals: against paired t tests, limits, failed runs, and their coverage by simulation."""

from itertools import permutations

import numpy as np
import pytest
from conftest import ROUND
from scipy import stats

from rmpc_bench.analysis.ranks import Losses, group_intervals, interval_of, ranks


def losses(logs, failed=None):
    """Make losses of methods A, B, ... from (points, methods, runs) logarithms."""
    logs = np.asarray(logs, dtype=float)
    failed = np.zeros(logs.shape, dtype=bool) if failed is None else failed
    names = tuple("ABCDEFGH"[: logs.shape[1]])
    return Losses(names, np.where(failed, np.nan, logs), failed)


def drawn(shifts, *, points=4, runs=80, seed=1, spread=0.1):
    """Draw logarithms: what a point and a run have in common, a shift per method, and a normal rest."""
    rng = np.random.default_rng(seed)
    common = rng.normal(size=(points, 1, runs)) + rng.normal(size=(points, 1, 1))
    shape = (points, len(shifts), runs)
    return losses(common + np.asarray(shifts)[:, None] + spread * rng.normal(size=shape))


def ends(found):
    """Return the intervals of the ranks."""
    return list(zip(found.low.tolist(), found.high.tolist(), strict=True))


def test_well_separated_methods_have_one_rank_each():
    """Whatever their order; the ranks move with the methods."""
    for shifts in permutations([0.0, 1.0, 2.0]):
        found = ranks(drawn(shifts), 0.95, seed=1)
        assert ends(found) == [(int(shift) + 1,) * 2 for shift in shifts]


def test_equal_methods_share_all_ranks():
    """Copies of one method differ in nothing, a rounding error included."""
    logs = np.repeat(np.random.default_rng(2).normal(size=(3, 1, 40)), 4, axis=1)
    logs[:, 1] += 1e-13
    assert ends(ranks(losses(logs), 0.95, seed=1)) == [(1, 4)] * 4


def test_two_methods_are_the_paired_t_test():
    """Oracle: scipy's t test of the means over the points of every run, at levels on both sides of its p value."""
    there = drawn([0.0, 0.02], runs=30, seed=2)
    means = there.logs.mean(axis=0)
    p = stats.ttest_rel(means[0], means[1]).pvalue
    assert 1e-6 < p < 0.5
    sign = means[0].mean() < means[1].mean()
    resolved = ranks(there, 1 - 1.01 * p, seed=1)
    assert ends(resolved) == ([(1, 1), (2, 2)] if sign else [(2, 2), (1, 1)])
    assert ends(ranks(there, 1 - 0.99 * p, seed=1)) == [(1, 2), (1, 2)]


def test_ranks_are_counts_of_simultaneous_intervals():
    """Oracle: a plain loop over all ordered pairs with t intervals of scipy at the level that is reported."""
    there = drawn([0.0, 0.01, 0.02, 0.05, 0.05, 0.3], runs=60, seed=3)
    found = ranks(there, 0.9, seed=5)
    assert 0.9 < found.level < 1 - 0.1 / 15 + 1e-12  # between the level of one interval and that of Bonferroni
    means = there.logs.mean(axis=0)
    for j in range(6):
        n_better = n_worse = 0
        for k in range(6):
            interval = stats.ttest_1samp(means[j] - means[k], 0).confidence_interval(found.level) if j != k else (0, 0)
            n_better += interval[0] > 0
            n_worse += interval[1] < 0
        assert (found.low[j], found.high[j]) == (1 + n_better, 6 - n_worse)


def test_every_point_has_the_same_weight():
    """Oracle: means of plain loops, where runs of some points failed and a point has none of a method."""
    rng = np.random.default_rng(4)
    failed = rng.random((5, 2, 30)) < [[[0.0]], [[0.1]], [[0.4]], [[0.0]], [[0.2]]]
    failed[3, 1] = True
    there = losses(rng.normal(size=(5, 2, 30)) + np.arange(5)[:, None, None] * [[0], [1]], failed)
    means = []
    for point in (0, 1, 2, 4):
        both = ~failed[point].any(axis=0)
        means.append(np.mean(there.logs[point, 0, both] - there.logs[point, 1, both]))
    found = there.difference(0, 1)
    np.testing.assert_allclose(found.per_run.mean(), np.mean(means), **ROUND)
    assert found.n_points == 4
    assert found.n_pairs == int((~failed.any(axis=1)).sum())
    single = there.difference(0, 1, [2])
    both = ~failed[2].any(axis=0)
    gaps = there.logs[2, 0, both] - there.logs[2, 1, both]
    # The standard error that the numbers of all runs give is that of the runs that both finished, up to n - 1 for n.
    np.testing.assert_allclose(single.per_run.std() / np.sqrt(30), gaps.std() / np.sqrt(len(gaps)), **ROUND)


def test_failures_come_before_accuracy():
    """A method that loses a third of its runs is last, however accurate the others of its runs are."""
    there = drawn([0.0, 1.0, 2.0])
    failed = there.failed.copy()
    failed[:, 0, ::3] = True
    assert ends(ranks(losses(there.logs, failed), 0.95, seed=1)) == [(3, 3), (1, 1), (2, 2)]
    # Failures that all methods have in common decide nothing.
    failed[:, :, ::3] = True
    assert ends(ranks(losses(there.logs, failed), 0.95, seed=1)) == [(1, 1), (2, 2), (3, 3)]


def test_few_failures_leave_open_what_they_would_change():
    """One failed run is no proof of failing more; a small advantage that it would undo is none either."""
    there = drawn([0.0, 0.05])
    assert ends(ranks(there, 0.95, seed=1)) == [(1, 1), (2, 2)]
    failed = there.failed.copy()
    failed[0, 0, 7] = True
    there.logs[0, 1, 9] = 300.0  # the worst finished run of the point, which stands for the failed one
    there.logs[0, 0, 9] = 300.0
    doubtful = losses(there.logs, failed)
    assert doubtful.difference(0, 1).per_run.mean() < 0 < doubtful.difference(0, 1, failed="worst").per_run.mean()
    assert ends(ranks(doubtful, 0.95, seed=1)) == [(1, 2), (1, 2)]
    # The other method's failed run makes the advantage larger.
    assert ends(ranks(losses(there.logs, failed[:, ::-1]), 0.95, seed=1)) == [(1, 1), (2, 2)]


def test_a_failed_run_is_no_tie_where_its_partner_is_the_worst():
    """It is worse by the factor 10 at least; both failed are tied."""
    logs = np.zeros((1, 2, 4))
    logs[0, :, 2] = 3.0
    failed = np.zeros(logs.shape, dtype=bool)
    failed[0, 0, [1, 2, 3]] = failed[0, 1, 3] = True
    per_run = losses(logs, failed).difference(0, 1, failed="worst").per_run
    assert per_run == pytest.approx([0, 3.0, np.log(10), 0])
    swapped = losses(logs[:, ::-1], failed[:, ::-1]).difference(0, 1, failed="worst").per_run
    assert swapped == pytest.approx(-per_run)


def test_no_common_run_decides_nothing():
    """Two methods that never finish together at any point: neither accuracy nor the share of failures differs."""
    there = drawn([0.0, 5.0], points=2, runs=20)
    failed = there.failed.copy()
    failed[:, 0, ::2] = failed[:, 1, 1::2] = True
    assert ends(ranks(losses(there.logs, failed), 0.95, seed=1)) == [(1, 2), (1, 2)]


def test_groups_of_points():
    """Oracle: the differences of a group are those of an experiment that has its points alone."""
    there = drawn([0.0, 0.1, 0.2], points=5)
    groups = [[0, 2], [1, 3, 4]]
    found = group_intervals(there, 2, groups, 0.95, seed=1)
    for points, row in zip(groups, found, strict=True):
        alone = losses(there.logs[points])
        for method in (0, 1):
            gap, (low, high) = row[method]
            np.testing.assert_array_equal(gap.per_run, alone.difference(method, 2).per_run)
            assert low < gap.per_run.mean() < high


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_interval_of_skewed_differences_contains_that_of_student(sign):
    """Oracle: scipy's t interval, to which the level of the family belongs; the bootstrap moves the end of the tail."""
    per_run = sign * np.random.default_rng(6).lognormal(size=40)
    low, high = interval_of(per_run, 0.99, seed=1)
    expected = stats.ttest_1samp(per_run, 0).confidence_interval(0.99)
    inner, outer = (low, high) if sign > 0 else (high, low)
    near, far = (expected.low, expected.high) if sign > 0 else (expected.high, expected.low)
    assert inner == pytest.approx(near, abs=1e-10)  # the digits that intervals keep
    assert abs(outer) > 1.02 * abs(far)


SETTINGS = {
    "eight equal": (np.zeros(8), "normal"),
    "eight equal, skewed": (np.zeros(8), "skewed"),
    "well separated": (np.arange(8) * 1.0, "normal"),
    "ties in pairs": (np.repeat(np.arange(4) * 0.08, 2), "normal"),
    "ties in pairs, skewed": (np.repeat(np.arange(4) * 0.08, 2), "skewed"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SETTINGS)
def test_coverage(name):
    """All true ranks lie in their intervals at once in 95 % of the experiments; a tied method has several ranks."""
    shifts, law = SETTINGS[name]
    n, covered, widths = 400, 0, []
    best = 1 + (shifts[:, None] > shifts).sum(axis=1)
    worst = len(shifts) - (shifts[:, None] < shifts).sum(axis=1)
    for seed in range(n):
        rng = np.random.default_rng([20261125, seed])
        shape = (3, len(shifts), 60)
        noise = rng.normal(size=shape) if law == "normal" else rng.lognormal(size=shape)
        found = ranks(losses(rng.normal(size=(3, 1, 60)) + shifts[:, None] + 0.1 * noise), 0.95, seed)
        covered += bool(((found.low <= best) & (worst <= found.high)).all())
        widths.append(np.mean(found.high - found.low))
    assert covered / n >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / n)
    if name == "well separated":
        assert covered == n and np.mean(widths) == 0
    if name == "eight equal":
        # Not everything is covered: intervals that always span all ranks would be.
        assert covered < n
