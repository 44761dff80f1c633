"""Probability of superiority, failed runs, looks and planning."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize, stats

from rmpc_bench.analysis.intervals import exact_share, wilson
from rmpc_bench.analysis.levels import number_of_look, planned_level, schedule, unplanned_level
from rmpc_bench.analysis.pairs import worst_finished
from rmpc_bench.analysis.superiority import (
    _score_interval,
    runs_for_direction,
    runs_for_equivalence,
    shares_interval,
    superiority,
    superiority_interval,
)
from rmpc_bench.analysis.verdict import mcnemar

counts = st.integers(0, 60)


@given(st.integers(20, 60), st.integers(0, 60))
def test_without_ties_it_is_the_interval_of_wilson_or_wider(won, lost):
    """The wider of it and that of Clopper and Pearson where this contains 1/2; both in closed form."""
    low, high = wilson(won, won + lost, 0.9)
    exact = exact_share(won, won + lost, 0.9)
    if exact[0] <= 0.5 <= exact[1]:
        low, high = min(low, exact[0]), max(high, exact[1])
    assert superiority_interval(won, lost, 0, 0.9) == pytest.approx((low, high), abs=1e-9)


@pytest.mark.parametrize("n", [8, 20, 26, 36, 60, 200])
def test_a_fair_coin_is_seldom_called_unfair(n):
    """Exact, by enumeration; the interval of Wilson excludes 1/2 in 7.6 % at 26 runs and in 6.5 % at 36."""
    ends = [superiority_interval(won, n - won, 0, 0.95) for won in range(n + 1)]
    wrong = [won for won, (low, high) in enumerate(ends) if not low <= 0.5 <= high]
    assert stats.binom.pmf(wrong, n, 0.5).sum() <= 0.05


@given(counts, counts, counts)
def test_exchanged_methods_have_the_mirrored_interval(won, lost, tied):
    """About 1/2, which the estimate lies in."""
    if won + lost + tied:
        low, high = superiority_interval(won, lost, tied, 0.95)
        assert superiority_interval(lost, won, tied, 0.95) == pytest.approx((1 - high, 1 - low), abs=1e-9)
        assert low <= superiority(won, lost, tied) <= high


@pytest.mark.parametrize(("won", "lost", "tied"), [(30, 5, 10), (12, 12, 40), (25, 0, 25), (3, 30, 100)])
def test_score_by_its_definition(won, lost, tied):
    """Oracle: the variance at the end of the interval with the shares that maximise the likelihood there."""
    n, z = won + lost + tied, stats.norm.ppf(0.975)
    for difference, sign in zip(_score_interval(won, lost, n, 0.95), (1, -1), strict=True):

        def cost(share_lost, difference=difference):
            shares = (share_lost + difference, share_lost, 1 - 2 * share_lost - difference)
            return -sum(k * math.log(max(p, 1e-300)) for k, p in zip((won, lost, tied), shares, strict=True))

        lower, upper = max(0.0, -difference), (1 - difference) / 2
        share = optimize.minimize_scalar(cost, bounds=(lower, upper), method="bounded", options={"xatol": 1e-10}).x
        sd = math.sqrt((2 * share + difference - difference**2) / n)
        # The search for the maximum stops at 1e-10 of a share, which is 1e-5 of a standard deviation at most.
        assert ((won - lost) / n - difference) / sd == pytest.approx(sign * z, rel=1e-4)


@given(st.integers(0, 19), st.integers(0, 60))
def test_few_untied_runs_follow_the_sign_test(won, tied):
    """1/2 is left out only where the exact test rejects: five of five do not prove superiority."""
    lost = min(2, 19 - won)
    low, high = superiority_interval(won, lost, tied, 0.95)
    if won + lost and stats.binomtest(won, won + lost).pvalue > 0.05:
        assert low <= 0.5 <= high


def test_thirty_won_and_ten_tied():
    """A superiority of 100 % was printed; 87.5 % follows from the counts."""
    assert superiority(30, 0, 10) == 0.875
    low, high = superiority_interval(30, 0, 10, 0.95)
    assert 0.5 < low < 0.875 < high < 1
    assert math.isnan(superiority(0, 0, 0)) and np.isnan(superiority_interval(0, 0, 0, 0.95)).all()


@given(st.integers(0, 30), st.integers(0, 30))
def test_mcnemar_excludes_zero_where_the_exact_test_rejects(b, c):
    """Oracle: the exact test, twice the smaller tail of the binomial distribution."""
    low, high = mcnemar(b, c, 100, 0.95)
    m = b + c
    tail = sum(math.comb(m, k) for k in range(min(b, c) + 1)) / 2**m
    assert (low > 0 or high < 0) == (2 * tail < 0.05)
    assert low <= (b - c) / 100 <= high


def test_mcnemar_by_hand():
    """6 against 0 in 200 runs: p is at least 0.025^(1/6)."""
    low, high = mcnemar(6, 0, 200, 0.95)
    assert (low, high) == pytest.approx(((2 * 0.025 ** (1 / 6) - 1) * 6 / 200, 6 / 200), rel=1e-9)
    assert mcnemar(0, 0, 200, 0.95) == (0.0, 0.0) and np.isnan(mcnemar(0, 0, 0, 0.95)).all()


@pytest.mark.parametrize(("direction", "expected"), [("lower", 3.0), ("higher", 1.0)])
def test_worst_finished_run(make_trials, direction, expected):
    """Of all methods, in the direction of the metric; failed runs do not count."""
    trials = make_trials({"mse": {"A": [1.0, None], "B": [3.0, 2.0]}}, directions={"mse": direction})
    assert worst_finished(trials, trials.metrics[0]) == expected
    trials = make_trials({"mse": {"A": [None], "B": [None]}}, directions={"mse": direction})
    assert math.isnan(worst_finished(trials, trials.metrics[0]))


def test_runs_for_equivalence():
    """1051 at sd 0.10 and 1 %; with so many the interval lies inside the margin in 80 of 100 experiments."""
    assert runs_for_equivalence(0.10, 0.01, 0.95) == 1051
    # Oracle: a simulation of the mean and the spread of 1051 normal values; 3 se of 10,000 experiments are 0.012.
    rng = np.random.default_rng(9)
    mean, sd = rng.normal(0, 0.1 / math.sqrt(1051), 10_000), 0.1 * np.sqrt(rng.chisquare(1050, 10_000) / 1050)
    inside = np.abs(mean) + stats.t.ppf(0.975, 1050) * sd / math.sqrt(1051) <= 0.01
    assert inside.mean() == pytest.approx(0.8, abs=0.012)
    assert math.isnan(runs_for_equivalence(0.1, 0.0, 0.95)) and runs_for_equivalence(0.0, 0.01, 0.95) == 2


def test_runs_for_direction():
    """(1.960 + 0.842)^2 sd^2 / difference^2, as in every textbook on sample sizes."""
    assert runs_for_direction(-0.02, 0.10, 0.95) == math.ceil((1.959964 + 0.841621) ** 2 * 25)
    assert math.isnan(runs_for_direction(0.0, 0.1, 0.95)) and math.isnan(runs_for_direction(0.1, math.nan, 0.95))


def test_looks():
    """Planned ones share alpha; unplanned ones get alpha / (k (k + 1)), which sum up to alpha / 2 after the first."""
    assert schedule(100, 2000) == (100, 200, 400, 800, 1600, 2000) and schedule(50, 50) == (50,)
    assert planned_level(0.95, 5) == pytest.approx(0.99)
    spent = sum(1 - unplanned_level(0.95, look) for look in range(2, 2000))
    assert spent == pytest.approx(0.025, rel=1e-3) and unplanned_level(0.95, 1) == 0.95
    assert [number_of_look([200, 400], n) for n in (200, 400, 800)] == [1, 2, 3]


def test_unplanned_looks_are_seldom_wrong():
    """Eight doublings without an effect: some wrong direction in fewer than 1.5 alpha of 50,000 experiments."""
    rng, n = np.random.default_rng(10), 50_000
    # The looks are exact for known spread: sums of independent normal increments.
    sizes = 50 * 2 ** np.arange(8)
    steps = rng.normal(size=(n, 8)) * np.sqrt(np.diff(sizes, prepend=0))
    z = np.cumsum(steps, axis=1) / np.sqrt(sizes)
    limits = stats.norm.ppf([(1 + unplanned_level(0.95, look)) / 2 for look in range(1, 9)])
    wrong = (np.abs(z) > limits).any(axis=1).mean()
    assert wrong <= 0.075 and wrong == pytest.approx(0.06, abs=0.016)


@pytest.mark.parametrize("p", [(0.3, 0.0), (0.03, 0.0), (0.1, 0.05)])
@pytest.mark.parametrize("n", [50, 200])
def test_the_interval_of_a_difference_of_shares_covers(p, n):
    """Exact coverage by enumeration; the inverted exact test covers 0.44 where one method fails only."""
    first, second = p
    covered = 0.0
    for i in range(n + 1):
        for j in range(n + 1 - i) if second else [0]:
            weight = stats.multinomial.pmf([i, j, n - i - j], n, [first, second, 1 - first - second])
            if weight < 1e-7:
                continue
            low, high = shares_interval(i, j, n, 0.95)
            covered += weight * (low <= first - second <= high)
    assert covered > 0.93
    assert np.isnan(shares_interval(0, 0, 0, 0.95)).all()


def test_the_interval_of_a_difference_of_shares_contains_0_where_the_exact_test_does_not_reject():
    """Five of five: p is 0.0625, although the score interval excludes 0."""
    low, high = shares_interval(5, 0, 200, 0.95)
    assert low == 0 and high > 5 / 200
    assert shares_interval(6, 0, 200, 0.95)[0] > 0


@pytest.mark.parametrize(("b", "c"), [(1, 0), (0, 4), (3, 9), (200, 1)])
def test_mcnemar_is_the_exact_interval_of_a_share(b, c):
    """Oracle: `scipy.stats.binomtest`, which finds the ends by bisection to 2e-12."""
    exact = stats.binomtest(b, b + c).proportion_ci(0.95, method="exact")
    expected = [(2 * end - 1) * (b + c) / 300 for end in (exact.low, exact.high)]
    assert mcnemar(b, c, 300, 0.95) == pytest.approx(expected, abs=1e-11)
