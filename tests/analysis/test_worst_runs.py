"""The worst runs."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from data_frames import tail_frame
from scipy import stats

from rmpc_bench.analysis.intervals import _binomial_quantile
from rmpc_bench.analysis.worst_runs import cvar_interval, quantile_interval

INF = math.inf


def row_of(trials, method="A"):
    """Return the row of a method."""
    table = tail_frame(trials)
    return table[table["method"] == method].iloc[0]


def test_by_hand(make_trials):
    """1..100: the 95 % quantile between the 95th and the 96th, the mean of the five largest, run 99."""
    row = row_of(make_trials({"mse": {"A": np.arange(1.0, 101.0)}}))
    assert (row.n, row.tail_quantile, row.cvar, row.worst, row.worst_run) == (100, pytest.approx(95.05), 98, 100, 99)
    # Ranks of the binomial distribution with 100 and 0.95: 2.5 % lie at or below 90, 97.5 % at or below 99.
    assert (row.tail_quantile_low, row.tail_quantile_high) == (90, 100)
    assert row.cvar_low < 98 < row.cvar_high


def test_fraction_of_a_run(make_trials):
    """5 % of 90 runs are 4.5: the fifth counts half.  A failed run has no value."""
    row = row_of(make_trials({"mse": {"A": [*np.arange(1.0, 91.0), None]}}))
    assert (row.n, row.cvar) == (90, pytest.approx((90 + 89 + 88 + 87 + 0.5 * 86) / 4.5))


def test_few_runs_have_no_interval(make_trials):
    """0.95^71 > 0.025: all runs may lie below the quantile."""
    for n, has in ((71, False), (72, True)):
        row = row_of(make_trials({"mse": {"A": np.linspace(1, 2, n)}}))
        assert (
            np.isfinite([row.tail_quantile_low, row.tail_quantile_high, row.cvar_low, row.cvar_high]).tolist()
            == [has] * 4
        )
    assert row_of(make_trials({"mse": {"A": [2.0]}})).worst == 2.0
    row = row_of(make_trials({"mse": {"A": [None, None]}}))
    assert np.isnan([row.tail_quantile, row.cvar, row.worst]).all() and row.isna()["worst_run"]


@pytest.mark.parametrize(("direction", "worst_run"), [("lower", 1), ("higher", 0), ("zero", 2), ("one", 2)])
def test_direction(make_trials, direction, worst_run):
    """The largest, the smallest, the farthest from 0 and from 1."""
    values = [0.2, 3.0, -4.0 if direction == "zero" else 0.1]
    values = values if direction != "higher" else [0.05, 3.0, 0.1]
    assert row_of(make_trials({"m": {"A": values}}, directions={"m": direction})).worst_run == worst_run


def test_higher_is_better_mirrors(make_trials):
    """The tail of -x, with its ends exchanged."""
    x = np.random.default_rng(1).normal(size=120)
    low = row_of(make_trials({"m": {"A": x - 10}}, directions={"m": "higher"}))
    high = row_of(make_trials({"m": {"A": 10 - x}}))
    for name, other in (
        ("tail_quantile", "tail_quantile"),
        ("cvar", "cvar"),
        ("cvar_low", "cvar_high"),
        ("worst", "worst"),
    ):
        assert low[name] == pytest.approx(-high[other], rel=1e-12)


def test_an_event_that_does_not_occur(make_trials):
    """Its share with the interval of Wilson; the mean of the tail is inf without an interval."""
    row = row_of(make_trials({"t": {"A": [1.0] * 90 + [INF] * 10}}))
    assert (row.did_not_occur_share, row.tail_quantile, row.cvar) == (0.1, INF, INF)
    interval = stats.binomtest(10, 100).proportion_ci(0.95, method="wilson")
    assert (row.did_not_occur_low, row.did_not_occur_high) == pytest.approx((interval.low, interval.high))
    assert np.isnan([row.cvar_low, row.cvar_high]).all()


def test_same_seed_same_interval(make_trials):
    """And another one gives another; equal runs leave no doubt."""
    trials = make_trials({"mse": {"A": np.random.default_rng(2).gamma(2.0, size=100)}})
    assert tail_frame(trials).equals(tail_frame(trials))
    assert row_of(trials).cvar_low != row_of(replace(trials, seed=8)).cvar_low
    assert cvar_interval(np.full(100, 3.0), 0.95, seed=1) == (3.0, (3.0, 3.0))


def test_intervals_hold():
    """Oracle: 300 samples of 200 exponential numbers; the quantile is log 20 and the mean of the tail log 20 + 1."""
    rng, hits = np.random.default_rng(3), np.zeros(2)
    for _ in range(300):
        values = rng.exponential(size=200)
        low, high = quantile_interval(values, 0.95)
        hits[0] += low <= math.log(20) <= high
        low, high = cvar_interval(values, 0.95, seed=1)[1]
        hits[1] += low <= math.log(20) + 1 <= high
    # Three standard errors of 300 samples are 0.038; bootstrap-t holds with about 0.94.
    assert (hits / 300 >= 0.95 - 0.048).all()


LAWS = {
    "exponential": (lambda rng, n: rng.exponential(size=n), math.log(20) + 1),
    **{
        f"lognormal {sigma}": (
            lambda rng, n, sigma=sigma: rng.lognormal(sigma=sigma, size=n),
            math.exp(sigma**2 / 2) * stats.norm.cdf(sigma - stats.norm.ppf(0.95)) / 0.05,
        )
        for sigma in (0.3, 0.6, 1.1)
    },
}
"""Name -> draw, mean of the worst 5 %."""


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("n", [80, 95, 150])
def test_intervals_of_positive_metrics_are_positive_and_cover(name, n):
    """92 to 95 % of 1000 samples, up to three standard errors of such a share."""
    draw, truth = LAWS[name]
    rng = np.random.default_rng(n)
    found = np.array([cvar_interval(draw(rng, n), 0.95, seed=1)[1] for _ in range(1000)])
    covered = ((found[:, 0] <= truth) & (truth <= found[:, 1])).mean()
    print(f"{name}, {n} runs: {100 * covered:.1f} %, median width {np.median(found[:, 1] - found[:, 0]):.3g}")
    assert (found[:, 0] > 0).all()
    assert 0.92 - 3 * math.sqrt(0.92 * 0.08 / 1000) <= covered <= 0.95 + 3 * math.sqrt(0.95 * 0.05 / 1000)


@pytest.mark.parametrize("sign", [1, -1])
def test_an_interval_keeps_the_sign_of_the_values(sign):
    """Also with zeros, in few resamples or many; a sample with both signs has the interval of the number itself."""
    rng, n_below = np.random.default_rng(1), 0
    for n in (72, 95, 150, 25_000):
        values = rng.lognormal(sigma=1.1, size=n)
        low, high = cvar_interval(sign * values, 0.95, seed=1)[1]
        assert sign * low > 0 and sign * high > 0
        assert min(cvar_interval(sign * np.where(values > 1, values, 0.0), 0.95, seed=1)[1], key=abs) * sign >= 0
        low, high = cvar_interval(np.append(values, -1e-6), 0.95, seed=1)[1]
        n_below += low < 0
    assert n_below


def test_values_of_any_size_have_an_interval():
    """Ratios of 1e130 between two runs leave ends from 0 to inf, and no error."""
    low, high = cvar_interval(np.exp(np.linspace(-150, 150, 100)), 0.95, seed=1)[1]
    assert 0 <= low < high


def test_the_interval_of_a_positive_mean_by_its_formula():
    """c exp(-t s / c) with t = (ln c* - ln c) / (s* / c*) of every resample, replayed; s* / c* is bounded."""
    values, n_tail = np.random.default_rng(6).lognormal(size=100), 5

    def of(sample):
        tail = np.sort(sample)[::-1]
        c = tail[:n_tail].mean()
        influence = np.maximum(sample - tail[n_tail], 0) / 0.05
        return c, influence.std(ddof=1) / math.sqrt(len(sample))

    c, s = of(values)
    order = np.argsort(-values)
    drawn = np.random.Generator(np.random.PCG64(1)).integers(0, 100, (1999, 100), dtype=np.int32)
    found = [of(values[order[rows]]) for rows in drawn]
    t = [math.log(own / c) / max(error / own, 0.2 * s / c) for own, error in found if error > 0]
    low, high = np.quantile(t, [0.025, 0.975])
    expected = (c * math.exp(-high * s / c), c * math.exp(-low * s / c))
    assert cvar_interval(values, 0.95, seed=1) == (pytest.approx(c), pytest.approx(expected, rel=1e-9))


@pytest.mark.parametrize("n", [15_000, 1_000_000])
def test_memory_does_not_grow_with_all_draws(n):
    """All resamples of 100,000 runs would be 800 MB; the interval is that of the normal law of the mean."""
    values = np.random.default_rng(4).exponential(size=n)
    tracemalloc.start()
    mean, (low, high) = cvar_interval(values, 0.95, seed=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 150e6
    # Variance of the influence (x - q)+ / 0.05 with x - q exponential: (2 * 0.05 - 0.05^2) / 0.05^2.
    reach = stats.norm.ppf(0.975) * math.sqrt((0.1 - 0.0025) / 0.0025 / n)
    assert mean - low == pytest.approx(reach, rel=0.15) and high - mean == pytest.approx(reach, rel=0.15)


@pytest.mark.parametrize("n", [2, 19, 100, 1000, 12_345, 1_000_000])
def test_binomial_quantile(n):
    """Oracle: scipy.stats."""
    for p in (0.001, 0.025, 0.3, 0.975, 0.9999):
        for share in (0.05, 0.95):
            assert _binomial_quantile(p, n, share) == stats.binom.ppf(p, n, share)


def test_a_metric_that_is_mostly_0_has_both_ends_or_none():
    """Resamples whose tail is 0 have no logarithm."""
    for seed in range(3):
        for n_zero in (94, 95, 96, 97, 98, 99):
            values = np.zeros(100)
            values[n_zero:] = np.geomspace(1e-3, 5.0, 100 - n_zero)
            mean, ends = cvar_interval(values, 0.95, seed)
            assert np.isnan(ends).all() or (np.isfinite(ends).all() and 0 < ends[0] <= mean <= ends[1])
