"""Pass rates against counts by hand, the closed form of the score interval and a restricted likelihood."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND
from data_frames import pass_frame
from scipy import optimize, stats

from rmpc_bench.analysis.superiority import shares_interval
from rmpc_bench.types.metric import Limit, Requirement

INF = np.inf
SETTLES = Requirement("t < 20", "t", (Limit("<", 20.0),))


@pytest.fixture
def rates(make_trials):
    """Return a function from values per method to method -> row; None is a failed run."""

    def make(requirement, **values):
        trials = replace(make_trials({"t": values}), requirements=(requirement,))
        return pass_frame(trials).set_index("method").to_dict("index")

    return make


def test_runs_are_counted_and_paired(rates):
    """A failed run and an event that did not occur do not pass; the limit itself does not with <."""
    found = rates(SETTLES, new=[1, 2, 3, 20, INF, None], old=[1, 25, INF, 4, 5, None])
    new, old = found["new"], found["old"]
    assert (new["n"], new["n_failed"], new["passed"]) == (6, 1, 3)
    assert (old["n"], old["n_failed"], old["passed"]) == (6, 1, 3)
    assert (new["n_pairs"], new["method_only"], new["baseline_only"]) == (6, 2, 2)
    assert new["difference_pct"] == 0
    assert np.isnan(old["difference_pct"])


def test_limits_on_both_sides_and_of_the_size(rates):
    """-1 < t <= 1 and abs(t) > 1."""
    both = Requirement("", "t", (Limit(">", -1.0), Limit("<=", 1.0)))
    values = [-2.0, -1.0, 0.0, 1.0, 2.0]
    assert rates(both, new=values, old=values)["new"]["passed"] == 2
    outside = Requirement("", "t", (Limit(">", 1.0),), absolute=True)
    assert rates(outside, new=values, old=values)["new"]["passed"] == 2


@pytest.mark.parametrize(("k", "n"), [(0, 10), (3, 10), (10, 10), (37, 200)])
def test_the_share_has_the_score_interval(rates, k, n):
    """Its ends solve (k/n - p)^2 = z^2 p (1 - p) / n, a quadratic equation in p."""
    row = rates(SETTLES, new=[1] * k + [30] * (n - k), old=[1] * n)["new"]
    z2 = stats.norm.ppf(0.975) ** 2
    ends = np.sort(np.roots([1 + z2 / n, -(2 * k / n + z2 / n), (k / n) ** 2]).real)
    np.testing.assert_allclose([row["pass_low"] / 100, row["pass_high"] / 100], ends, rtol=1e-7, atol=1e-9)  # roots
    assert row["miss_upper"] == pytest.approx(100 * (stats.beta.ppf(0.95, n - k + 1, k) if k else 1.0))


@pytest.mark.parametrize(("method_only", "baseline_only", "n"), [(15, 2, 40), (12, 0, 60), (40, 20, 160)])
def test_the_ends_of_the_difference_solve_the_score_equation(method_only, baseline_only, n):
    """Tango 1998 by brute force: the restricted likelihood is maximised numerically, and its score is z at the ends.

    The exact test rejects equal shares in all three cases, so that the interval is the score interval itself.
    """
    b, c = method_only, baseline_only
    z = stats.norm.ppf(0.975)
    for end, expected in zip(shares_interval(b, c, n, 0.95), (z, -z), strict=True):
        low, high = max(0.0, -end), (1 - end) / 2

        def unlikely(p, end=end):
            return -(b * np.log(p + end) + c * np.log(max(p, 1e-300)) + (n - b - c) * np.log(1 - 2 * p - end))

        p = optimize.minimize_scalar(unlikely, bounds=(low, high), method="bounded", options={"xatol": 1e-12}).x
        score = (b - c - n * end) / np.sqrt(n * (2 * p + end - end**2))
        np.testing.assert_allclose(score, expected, rtol=1e-4)  # the numerical maximum is flat


def test_the_difference_is_in_percentage_points(rates):
    """15 of 20 runs pass with the new method alone, none with the old one alone."""
    row = rates(SETTLES, new=[1] * 20, old=[1] * 5 + [30] * 15)["new"]
    ends = shares_interval(15, 0, 20, 0.95)
    found = [row["difference_pct"], row["difference_low"], row["difference_high"]]
    np.testing.assert_allclose(found, 100 * np.array([0.75, *ends]), **ROUND)
