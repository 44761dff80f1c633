"""Claims about moments over the runs at every k: intervals and simultaneous bands from groups of runs."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND
from data_frames import series as series_of
from scipy import stats

from rmpc_bench.analysis.traces import RunGroups, Traces
from rmpc_bench.claims.claim import Claim
from rmpc_bench.claims.decision import band
from rmpc_bench.claims.verdict import judge

N_RUNS, N = 60, 40


def paths(rng, *, n_runs=N_RUNS, shift=0.0):
    """Trajectories (runs, samples, 2) of two correlated states that wander."""
    steps = rng.normal(0, 1, (n_runs, N, 2)) @ np.array([[1.0, 0.5], [0.0, 1.0]])
    walk = np.empty_like(steps)
    walk[:, 0] = steps[:, 0]
    for k in range(1, N):
        walk[:, k] = 0.8 * walk[:, k - 1] + steps[:, k]
    return walk + shift


def direct(x, x_hat, quantity):
    """Moments from the trajectories, by definition."""
    z = {"x": x, "x_hat": x_hat, "e": x - x_hat}[quantity[quantity.index("(") + 1 : -1]]
    if quantity.startswith("mean"):
        return z.mean(axis=0)
    return np.array([np.cov(z[:, k].T) for k in range(z.shape[1])])


@pytest.fixture
def ensemble(make_trials):
    """Return a function that makes Trials with recorded trajectories of methods, and their ensemble series."""

    def make(trajectories, *, recorded=True):
        n_runs = len(next(iter(trajectories.values())))
        rows = [
            (method, quantity, ",".join(map(str, index)), k, n_runs, float(values[index]))
            for method, x in trajectories.items()
            for quantity in ("mean(x)", "cov(x)")
            for k, values in enumerate(direct(x, 0 * x, quantity))
            for index in np.ndindex(values.shape)
        ]
        trials = make_trials({"mse": {method: [1.0] * n_runs for method in trajectories}}, rows)
        r = np.zeros((N, 1))
        traces = {method: Traces(np.arange(n_runs), {"x": x}, r) for method, x in trajectories.items()}
        return replace(trials, traces=traces if recorded else {})

    return make


def comparison(trials, check):
    """Judge one check."""
    [found] = judge(Claim("s", "", (check,)), trials).comparisons
    return found


@pytest.mark.parametrize("quantity", [f"{what}({of})" for what in ("mean", "cov") for of in ("x", "x_hat", "e")])
@pytest.mark.parametrize("size", [1, 7])
def test_moments_without_a_group(quantity, size):
    """Oracle: the definition, on the trajectories of the other runs."""
    rng = np.random.default_rng(1)
    x, x_hat, runs = paths(rng), paths(rng, shift=3.0), np.arange(N_RUNS)
    groups = RunGroups.of_trajectories(runs, x, x_hat)
    if size > 1:
        parts = np.array_split(runs, size)
        z = np.concatenate([x, x_hat], axis=2)
        means = np.array([z[part].mean(axis=0) for part in parts])
        second = np.array(
            [sum(np.einsum("ki,kj->kij", d, d) for d in z[part] - z[part].mean(axis=0)) for part in parts]
        )
        groups = RunGroups(tuple(parts), np.array([len(part) for part in parts]), means, second, 2)
    np.testing.assert_allclose(groups.series(quantity), direct(x, x_hat, quantity), **ROUND)
    left = np.setdiff1d(runs, groups.runs[3])
    np.testing.assert_allclose(groups.series(quantity, 3), direct(x[left], x_hat[left], quantity), **ROUND)
    assert groups.has(quantity)


def test_what_is_not_recorded_has_no_groups():
    """Without the estimate only moments of the state; series of a design have none at all."""
    groups = RunGroups.of_trajectories(np.arange(5), paths(np.random.default_rng(1), n_runs=5), None)
    assert [groups.has(name) for name in ("mean(x)", "cov(x)", "mean(e)", "cov(x_hat)", "P")] == [
        True,
        True,
        *[False] * 3,
    ]


def test_a_mean_over_k_is_that_of_the_runs(ensemble):
    """Oracle: Student's paired interval of every run's own mean, which is linear in the moments."""
    rng = np.random.default_rng(2)
    a, b = paths(rng), paths(rng, shift=-0.1)
    found = comparison(ensemble({"A": a, "B": b}), "mean(entry(mean(x[A]), 0)) < mean(entry(mean(x[B]), 0))")
    expected = stats.ttest_rel(a[:, :, 0].mean(axis=1), b[:, :, 0].mean(axis=1)).confidence_interval(0.95)
    assert found.interval == pytest.approx((expected.low, expected.high), rel=1e-9)
    assert found.holds is None and found.n == N_RUNS and found.n_deciding > N_RUNS


def test_a_spread_is_resampled_runs(ensemble):
    """Oracle: scipy's bootstrap of whole runs, up to the error of two approximations."""
    a = paths(np.random.default_rng(3))

    def spread(rows):
        return a[rows, :, 1].std(axis=0, ddof=1).mean()

    found = comparison(ensemble({"A": a}), "mean(entry(std(x[A]), 1)) < 5")
    ends = stats.bootstrap(
        (np.arange(N_RUNS),), spread, vectorized=False, n_resamples=2000, method="percentile", rng=5
    ).confidence_interval
    width = ends.high - ends.low
    assert found.interval == pytest.approx((ends.low - 5, ends.high - 5), abs=0.3 * width)


def test_a_band_covers_all_entries_together():
    """In 95 % of experiments; intervals of single instants would all cover in far fewer."""
    rng = np.random.default_rng(4)
    n_experiments, together, single = 300, 0, 0
    for seed in range(n_experiments):
        values = paths(rng, n_runs=30)
        found = band(values, 0.95, seed)
        together += bool(((found.low <= 0) & (found.high >= 0)).all())
        reach = stats.t.ppf(0.975, 29) * values.std(axis=0, ddof=1) / np.sqrt(30)
        single += bool((np.abs(values.mean(axis=0)) <= reach).all())
    # Four standard errors of a share of 95 % of 300.
    assert 0.95 - 0.05 <= together / n_experiments <= 1.0
    assert single / n_experiments < 0.5


@pytest.mark.parametrize(("n_groups", "size"), [(50, 1), (3, 40)])
def test_a_band_of_variances_covers_all_of_them(n_groups, size):
    """Of 100 ensembles; with random signs it covered 0.72 of the time for 50 runs and 0.31 for three groups of 40."""
    rng, hits, n_runs = np.random.default_rng(8), 0, n_groups * size
    for seed in range(100):
        x = rng.normal(size=(n_runs, 30, 1))
        for k in range(1, 30):
            x[:, k] = 0.9 * x[:, k - 1] + np.sqrt(1 - 0.81) * x[:, k]
        without = [
            np.var(np.delete(x[..., 0], np.s_[i * size : (i + 1) * size], 0), 0, ddof=1) for i in range(n_groups)
        ]
        values = n_groups * np.var(x[..., 0], axis=0, ddof=1) - (n_groups - 1) * np.array(without)
        found = band(values, 0.95, seed)
        hits += bool(((found.low <= 1) & (found.high >= 1)).all())
    # Three standard errors of 100 ensembles are 0.065.
    assert hits >= 95 - 6.5


@pytest.mark.parametrize(
    ("shift", "check", "holds"),
    [
        (3.0, "all(mean(x[A]) < mean(x[B]))", True),
        (0.0, "all(mean(x[A]) < mean(x[B]))", None),  # at some k the one is larger, at some the other
        (0.2, "all(mean(x[A]) < mean(x[B]))", None),
        (-3.0, "all(mean(x[A]) < mean(x[B]))", False),
        (0.0, "all(mean(x[A]) ~ mean(x[B]) +- 3)", True),
        (0.0, "all(mean(x[A]) ~ mean(x[B]) +- 0.3)", None),
        (3.0, "all(mean(x[A]) ~ mean(x[B]) +- 0.3)", False),
        (0.0, "all(since(std(x[A]), 10) < 5)", True),
        (0.0, "all(since(std(x[A]), 10) < 1)", False),
        (0.0, "last(mean(x[A])) < [5, 5]", True),
        (0.0, "last(mean(x[A])) < [5, 0.3]", None),
    ],
)
def test_series_are_judged_by_a_band(ensemble, shift, check, holds):
    """An order at every k holds where the whole band does, and fails where the band at some k does."""
    rng = np.random.default_rng(6)
    trials = ensemble({"A": paths(rng), "B": paths(rng, shift=shift)})
    found = comparison(trials, check)
    assert found.holds is holds and found.interval is not None
    if holds is None:
        assert found.interval[0] <= 0 <= found.interval[1] or "~" in check


def test_without_groups_nothing_is_known_of_the_error(ensemble):
    """Neither recorded runs nor stored groups: inconclusive, whatever the numbers are."""
    rng = np.random.default_rng(7)
    trials = ensemble({"A": paths(rng), "B": paths(rng, shift=9.0)}, recorded=False)
    for check in ("all(mean(x[A]) < mean(x[B]))", "mean(entry(mean(x[A]), 0)) < mean(entry(mean(x[B]), 0))"):
        found = comparison(trials, check)
        assert (found.holds, found.interval) == (None, (-np.inf, np.inf))


def test_exact_moments_have_no_error(ensemble):
    """Where a series is exact and from runs, too, the exact one decides, by its numbers."""
    rng = np.random.default_rng(8)
    trials = ensemble({"A": paths(rng), "B": paths(rng)})
    exact = trials.series.assign(n=0, value=trials.series["value"] * (trials.series["method"] == "B"))
    trials = replace(trials, over_time=[*trials.over_time, *series_of(exact)])
    found = comparison(trials, "all(cov(x[A]) ~ cov(x[B]) +- 0)")
    assert (found.holds, found.interval) == (False, None)


def test_vectors_of_means_over_runs(make_trials):
    """Entries of a vector from columns are compared together, too."""
    rng = np.random.default_rng(9)
    trials = make_trials({"a": {"A": rng.normal(0, 1, 50)}, "b": {"A": rng.normal(0.9, 1, 50)}})
    assert comparison(trials, "mean([a[A], b[A]]) < [1, 2]").holds is True
    assert comparison(trials, "mean([a[A], b[A]]) < [1, 1]").holds is None
    assert comparison(trials, "mean([a[A], b[A]]) < [1, 0]").holds is False
