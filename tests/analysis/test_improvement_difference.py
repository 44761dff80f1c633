"""Difference of two paired improvements against closed forms, a bootstrap and simulated experiments."""

import numpy as np
import pytest
from comparison_tables import table
from conftest import ROUND
from scipy import stats

from rmpc_bench.analysis.improvement_difference import improvement_differences

N = 40


def compared(a, b, *, paired=True, is_primary=True, **keys):
    """Compare the improvement of method M on its baseline S in two experiments."""
    tables = [table(values, **keys) for values in (a, b)]
    [found] = improvement_differences([tuple(tables)], "M", tables[0].metrics[0], paired=paired, is_primary=is_primary)
    return found


def lognormal(rng, shift, noise, base):
    """Values of baseline and method whose log ratios are `shift` plus numbers of mean 0 and given size."""
    deviations = rng.standard_normal(len(base))
    return {"S": base, "M": base * np.exp(shift + noise * (deviations - deviations.mean()))}


def test_geometric_means_have_the_closed_form(rng):
    """Logs are a normal sample: Student's interval of their mean difference, and the delta method for the points."""
    base = np.exp(rng.standard_normal(N))
    a, b = lognormal(rng, -0.2, 0.1, base), lognormal(rng, -0.1, 0.1, base)
    each = compared(a, b).averages[0]
    assert each.average == "geometric"
    logs_a, logs_b = (np.log(x["M"] / x["S"]) for x in (a, b))
    reach = stats.t.ppf(0.975, N - 1) * stats.sem(logs_a - logs_b)
    np.testing.assert_allclose(each.ratio, np.exp([-0.1, -0.1 - reach, -0.1 + reach]), rtol=1e-9)
    np.testing.assert_allclose([each.in_a.value, each.in_b.value], 100 * np.expm1([-0.2, -0.1]), rtol=1e-9)
    gain = np.exp(-0.1) - np.exp(-0.2)
    linear = np.exp(-0.1) * logs_b - np.exp(-0.2) * logs_a
    reach = stats.t.ppf(0.975, N - 1) * stats.sem(linear)
    np.testing.assert_allclose(each.difference, 100 * np.array([gain, gain - reach, gain + reach]), rtol=1e-9)


def test_with_other_seeds_the_interval_is_that_of_welch(rng):
    """SciPy's, for samples of different sizes."""
    a = lognormal(rng, -0.2, 0.1, np.exp(rng.standard_normal(N)))
    b = lognormal(rng, -0.1, 0.3, np.exp(rng.standard_normal(2 * N)))
    found = compared(a, b, paired=False)
    assert (found.n_a, found.n_b, found.paired) == (N, 2 * N, False)
    logs_a, logs_b = (np.log(x["M"] / x["S"]) for x in (a, b))
    expected = stats.ttest_ind(logs_a, logs_b, equal_var=False).confidence_interval(0.95)
    np.testing.assert_allclose(found.averages[0].ratio[1:], np.exp(expected), rtol=1e-9)


def test_pairing_narrows_the_interval(rng):
    """What both experiments share in a run cancels."""
    base, common = np.exp(rng.standard_normal(N)), 0.3 * rng.standard_normal(N)
    a, b = ({"S": base, "M": base * np.exp(shift + common + 0.01 * rng.standard_normal(N))} for shift in (-0.2, -0.1))
    paired, unpaired = compared(a, b).averages[0], compared(a, b, paired=False).averages[0]
    assert paired.ratio.value == pytest.approx(unpaired.ratio.value, **{"rel": ROUND["rtol"]})
    widths = [each.difference.high - each.difference.low for each in (paired, unpaired)]
    assert widths[0] < widths[1] / 10


def test_an_equal_baseline_leaves_the_paired_comparison_of_the_method(rng):
    """The limit: with one baseline the ratio of ratios is the ratio of the method in A to the method in B."""
    base = np.exp(rng.standard_normal(N))
    a, b = lognormal(rng, -0.2, 0.1, base), lognormal(rng, -0.1, 0.1, base)
    each = compared(a, b).averages[0]
    assert each.ratio.value == pytest.approx(stats.gmean(a["M"] / b["M"]), rel=1e-12)


@pytest.mark.parametrize("average", ["geometric", "mean"])
def test_intervals_against_a_bootstrap_of_whole_runs(average):
    """Percentiles of 4000 resamples, with the statistic written out."""
    rng = np.random.default_rng(5)
    n = 200
    base = np.exp(0.3 * rng.standard_normal(n))
    a, b = lognormal(rng, -0.2, 0.1, base), lognormal(rng, -0.12, 0.1, base * np.exp(0.05 * rng.standard_normal(n)))
    found = {each.average: each for each in compared(a, b).averages}[average]

    def change(x, runs):
        if average == "mean":
            return x["M"][runs].mean() / x["S"][runs].mean() - 1
        return stats.gmean(x["M"][runs] / x["S"][runs]) - 1

    resamples = rng.integers(0, n, (4000, n))
    changes = np.array([(change(a, runs), change(b, runs)) for runs in resamples])
    points = 100 * (changes[:, 1] - changes[:, 0])
    ratios = (1 + changes[:, 0]) / (1 + changes[:, 1])
    for estimate, drawn in ((found.difference, points), (found.ratio, ratios)):
        width = estimate.high - estimate.low
        np.testing.assert_allclose(estimate[1:], np.quantile(drawn, [0.025, 0.975]), atol=0.06 * width)


def test_where_high_values_are_best_a_rise_is_an_improvement(rng):
    """So the difference is positive where the method rises more in A, and the verdict says so."""
    base = np.exp(rng.standard_normal(N))
    a, b = lognormal(rng, 0.3, 0.05, base), lognormal(rng, 0.1, 0.05, base)
    found = compared(a, b, direction="higher")
    assert found.averages[0].difference.value == pytest.approx(100 * (np.exp(0.3) - np.exp(0.1)))
    assert found.verdict == "better"
    assert compared(a, b).verdict == "worse" and compared(a, b).averages[0].difference.value < 0


@pytest.mark.parametrize(
    ("shift", "noise", "word"),
    [
        (-0.1, 0.01, "better"),
        (0.1, 0.01, "worse"),
        (0.0, 0.01, "equivalent"),
        (0.0, 0.3, "inconclusive"),
        (-0.02, 0.03, "better-size-uncertain"),
    ],
)
def test_verdicts_on_the_gains(shift, noise, word):
    """The words of a comparison with a baseline, for the ratio of ratios; only the primary metric has one."""
    rng = np.random.default_rng(3)
    base = np.exp(rng.standard_normal(N))
    a, b = lognormal(rng, -0.1 + shift, noise, base), lognormal(rng, -0.1, noise, base)
    assert compared(a, b).verdict == word
    assert compared(a, b, is_primary=False).verdict == ""


def test_a_signed_metric_is_compared_in_its_unit(rng):
    """Zero is best: the difference of the differences of absolute values."""
    base = 1 + np.abs(rng.standard_normal(N))
    a, b = {"S": base, "M": -(base - 0.5)}, {"S": base, "M": base - 0.2 + 0.01 * rng.standard_normal(N)}
    found = compared(a, b, direction="zero", unit="rad")
    [each] = found.averages
    assert each.average == "difference"
    assert each.difference.value == pytest.approx(0.5 - (base - np.abs(b["M"])).mean())
    assert np.isnan(each.ratio.value)


def test_failed_runs_are_counted_and_may_decide():
    """Averages rest on runs that all finished; a method that fails in A alone fails more."""
    rng = np.random.default_rng(3)
    base = np.exp(rng.standard_normal(N))
    a, b = lognormal(rng, -0.3, 0.01, base), lognormal(rng, -0.1, 0.01, base)
    a["M"][:12] = np.nan
    found = compared(a, b)
    assert (found.n_a, found.n_b, found.failed_a, found.failed_b) == (N - 12, N - 12, 12, 0)
    assert found.verdict == "fails-more"
    b["M"][:12] = np.nan
    assert compared(a, b).verdict == "better"
    unpaired = compared(a, {name: column.copy() for name, column in b.items()}, paired=False)
    assert (unpaired.n_a, unpaired.n_b, unpaired.verdict) == (N - 12, N - 12, "better")


@pytest.mark.parametrize("direction", ["lower", "zero"])
def test_a_failure_in_one_experiment_is_a_smaller_gain_than_in_the_other(direction):
    """M fails in A in the 2 runs in which it is worst in B, by more than a factor of 10, and gains 3 % elsewhere."""
    rng = np.random.default_rng(4)
    base = np.exp(0.1 * rng.standard_normal(100) + (0 if direction == "lower" else 2))
    a, b = lognormal(rng, -0.13, 0.02, base), lognormal(rng, -0.1, 0.02, base)
    b["M"][:2] *= 1e4
    a["M"][:2] = np.nan
    assert compared(a, b, direction=direction).verdict == "inconclusive"
    # The same failures in both experiments leave the gain of the other runs.
    b["M"][:2] = np.nan
    assert compared(a, b, direction=direction).verdict in ("better", "better-size-uncertain")


def test_runs_in_which_both_fail_are_no_failures_of_the_method(rng):
    """A harder plant that the baseline does not survive either says nothing about the gain of the method."""
    base = np.exp(rng.standard_normal(N))
    a, b = lognormal(rng, -0.3, 0.01, base.copy()), lognormal(rng, -0.1, 0.01, base)
    a = {name: column.copy() for name, column in a.items()}
    a["M"][:12] = np.nan
    a["S"][:12] = np.nan
    found = compared(a, b)
    assert (found.failed_a, found.alone_a, found.verdict) == (12, 0, "better")


def test_runs_that_all_agree_are_no_certainty():
    """M loses all runs in A and wins all in B: no run differs from another, and no interval of width 0 is given."""
    ones = np.ones(N)
    found = compared({"S": ones, "M": 2 * ones}, {"S": ones, "M": 0.5 * ones})
    assert found.superiority.value == -1
    assert np.isnan(found.superiority.low)


def test_only_common_runs_are_paired(rng):
    """A may have more runs than B."""
    base = np.exp(rng.standard_normal(2 * N))
    a, b = lognormal(rng, -0.3, 0.1, base), lognormal(rng, -0.1, 0.1, base)
    short = {name: column[:N] for name, column in b.items()}
    found = compared(a, short)
    assert found.n_a == N
    logs = np.log(a["M"][:N] / a["S"][:N]) - np.log(short["M"] / short["S"])
    assert found.averages[0].ratio.value == pytest.approx(np.exp(logs.mean()))


def test_a_metric_that_may_be_infinite_has_shares_only(rng):
    """Superiority in either experiment, their difference and its interval."""
    base = 5 + rng.random(N)
    a = {"S": base, "M": np.where(np.arange(N) < 30, base - 2, np.inf)}
    b = {"S": base, "M": np.where(np.arange(N) < 6, base - 2, base + 1)}
    found = compared(a, b, may_not_occur=True)
    assert found.averages == ()
    assert (found.superiority_a, found.superiority_b) == (0.75, 0.15)
    half = np.where(np.arange(N) < 30, 1, 0) - np.where(np.arange(N) < 6, 1, 0)
    reach = stats.t.ppf(0.975, N - 1) * stats.sem(half)
    np.testing.assert_allclose(found.superiority, [0.6, 0.6 - reach, 0.6 + reach], rtol=1e-12)
    assert found.verdict == "better"


def test_equal_experiments_are_equivalent(rng):
    """The same results twice."""
    a = lognormal(rng, -0.1, 0.1, np.exp(rng.standard_normal(N)))
    found = compared(a, a)
    assert found.averages[0].difference.value == 0 and found.averages[0].ratio.value == 1
    assert found.superiority.value == 0


def test_points_of_a_sweep_are_a_family(rng):
    """Intervals of the primary metric are wider with more points."""
    pairs = []
    for _ in range(4):
        base = np.exp(rng.standard_normal(N))
        pairs.append(tuple(table(lognormal(rng, shift, 0.1, base)) for shift in (-0.2, -0.1)))
    info = pairs[0][0].metrics[0]
    one = improvement_differences(pairs[:1], "M", info, paired=True, is_primary=True)
    four = improvement_differences(pairs, "M", info, paired=True, is_primary=True)
    assert 0.95 == one[0].level < four[0].level <= 1 - 0.05 / 4
    plain = improvement_differences(pairs, "M", info, paired=True, is_primary=False)
    assert {each.level for each in plain} == {0.95}


EXPERIMENTS = 1500


@pytest.mark.slow
@pytest.mark.parametrize("paired", [True, False])
@pytest.mark.parametrize(("n", "skew"), [(50, 0.1), (50, 0.6), (200, 0.3)])
def test_intervals_cover(paired, n, skew):
    """95 % intervals of simulated experiments contain the true value in at least 93 %, with skewed values."""
    rng = np.random.default_rng([n, int(100 * skew), paired])
    true = {"geometric": np.exp(-0.1), "mean": np.exp(-0.1)}
    inside = {}
    for _ in range(EXPERIMENTS):
        base, shared = np.exp(skew * rng.standard_normal(n)), 0.1 * rng.standard_normal(n)
        other = base if paired else np.exp(skew * rng.standard_normal(n))
        common = shared if paired else 0.1 * rng.standard_normal(n)
        a = {"S": base, "M": base * np.exp(-0.2 + shared + 0.05 * rng.standard_normal(n))}
        b = {"S": other, "M": other * np.exp(-0.1 + common + 0.05 * rng.standard_normal(n))}
        for each in compared(a, b, paired=paired, is_primary=False).averages:
            # exp(s^2/2) of the log-normal ratios, independent of the baseline, cancels in the ratio of ratios.
            spread = np.exp((0.1**2 + 0.05**2) / 2) if each.average == "mean" else 1.0
            points = 100 * spread * (np.exp(-0.1) - np.exp(-0.2))
            found = inside.setdefault(each.average, [])
            found.append(
                (
                    each.ratio.low <= true[each.average] <= each.ratio.high,
                    each.difference.low <= points <= each.difference.high,
                )
            )
    shares = {name: np.mean(each, axis=0) for name, each in inside.items()}
    assert set(shares) == {"geometric", "mean"}
    assert all((each >= 0.93).all() for each in shares.values()), shares


def of_draws(rng, shift, slope, width, draws, random_besides=("noise",)):
    """Return the table of an experiment in which the gain depends on a uniform quantity within +-width."""
    u = width * draws
    base = np.exp(0.1 * u)
    keys = {"quantities": {"run": np.arange(len(u)), "eps": u}, "random_besides": random_besides}
    laws = {"eps": {"dist": "uniform", "low": -width, "high": width}}
    noise = np.exp(shift + slope * u + 0.01 * rng.standard_normal(len(u)))
    return table({"S": base, "M": base * noise}, laws=laws, **keys)


def test_each_experiment_is_adjusted_for_its_own_laws(rng):
    """Oracle: the difference of the two intercepts with HC3 of the difference of the residuals, df n - 3."""
    draws = rng.uniform(-1, 1, N)
    a, b = of_draws(rng, -0.2, 0.5, 0.4, draws), of_draws(rng, -0.1, 0.5, 0.8, draws)
    [found] = improvement_differences([(a, b)], "M", a.metrics[0], paired=True, is_primary=True)
    X = np.stack([np.ones(N), draws, 1.5 * draws**2 - 0.5], axis=1)
    inverse = np.linalg.inv(X.T @ X)
    logs = np.stack([np.log(t.column("m", "M") / t.column("m", "S")) for t in (a, b)], axis=1)
    beta, h = inverse @ X.T @ logs, np.einsum("ij,jk,ik->i", X, inverse, X)
    r = (logs - X @ beta) @ [1, -1] / (1 - h)
    moved = (X @ inverse)[:, 0] * r
    reach = stats.t.ppf(0.975, N - 3) * np.sqrt((N - 1) / N * np.sum((moved - moved.mean()) ** 2))
    gap = beta[0, 0] - beta[0, 1]
    np.testing.assert_allclose(found.averages[0].ratio, np.exp([gap, gap - reach, gap + reach]), rtol=1e-9)
    # In an experiment without uncertain quantities nothing is adjusted for.
    plain = table({name: b.column("m", name) for name in b.methods})
    [mixed] = improvement_differences([(a, plain)], "M", a.metrics[0], paired=True, is_primary=True)
    assert mixed.averages[0].in_b.value == pytest.approx(100 * np.expm1(logs[:, 1].mean()), rel=1e-9)
    assert mixed.averages[0].in_a.value == pytest.approx(100 * np.expm1(beta[0, 0]), rel=1e-9)
    [apart] = improvement_differences([(a, b)], "M", a.metrics[0], paired=False, is_primary=True)
    assert apart.averages[0].ratio.value == pytest.approx(np.exp(gap), rel=1e-9)
