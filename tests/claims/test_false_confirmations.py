"""How often claims at the border of what is true are confirmed: exact probabilities, and simulated experiments."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from data_frames import arrays
from scipy import stats

from rmpc_bench.analysis.intervals import exact_share, order_ranks, wilson
from rmpc_bench.analysis.levels import planned_level, schedule
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims import decision
from rmpc_bench.claims.claim import Claim, Finding
from rmpc_bench.claims.verdict import judge
from rmpc_bench.types import MetricInfo

SEEDS = 500
MOST = 0.04
SIZES = (2, 5, 20, 60)
QUANTILES = (0.5, 0.75, 0.9, 0.95, 0.99)


def experiments(n, seeds=SEEDS):
    """Return trials whose metric i is that of experiment i: A and B are paired and have the same log-normal law."""
    rng = np.random.default_rng([20261128, n])
    common = rng.normal(size=(n, seeds))
    columns = {name: np.exp(0.6 * common + 0.8 * rng.normal(size=(n, seeds))) for name in "AB"}
    columns["C"] = (rng.random((n, seeds)) < 0.05).astype(float)
    columns["D"] = (rng.random((n, seeds)) < 0.05).astype(float)
    return of_columns(columns)


def of_columns(columns):
    """Return trials of the columns (run, experiment) of every method."""
    n, seeds = columns[next(iter(columns))].shape
    names = [f"m{i}" for i in range(seeds)]
    parts = [
        pd.DataFrame(values, columns=names).assign(method=method, run=np.arange(n), status="ok")
        for method, values in columns.items()
    ]
    return Trials(
        name="border",
        methods=tuple(columns),
        labels={},
        metrics=tuple(MetricInfo(name, "", "lower") for name in names),
        columns=arrays(pd.concat(parts)[["method", "run", "status", *names]]),
        over_time=(),
        baseline=list(columns)[-1],
        confidence=0.95,
        relevant=0.01,
        seed=7,
    )


def border(q):
    """Quantile of A, whose log has a standard deviation of 1."""
    return repr(float(np.exp(stats.norm.ppf(q))))


def few_valued(n, seeds):
    """Return trials like `experiments`, of laws with few values or with one that most runs have."""
    rng = np.random.default_rng([35, n])
    size = (n, seeds)
    base = np.exp(0.3 * rng.normal(size=size))
    columns = {
        "two": rng.choice([1.0, 2.0], size),
        "half": base * rng.choice([0.5, 2.0], size),
        "tripled": np.where(rng.random(size) < 0.02, 3 * base, base),
        "rare": (rng.random(size) < 0.05).astype(float),
        "skew": base + np.where(rng.random(size) < 0.1, 0.9, -0.1),
        "inflated": np.where(rng.random(size) < 0.05, 2 * rng.exponential(size=size), 0.0),
        "level": 0.1 + 0.001 * rng.normal(size=size),
        "base": base,
    }
    coin = rng.random(size) < 0.3
    columns |= {"coin": coin.astype(float), "raised": (coin | (rng.random(size) < 0.021 / 0.7)).astype(float)}
    return of_columns(columns)


FEW_VALUED = [
    "mean(x[two]) < 1.5",
    "mean(x[two]) > 1.5",
    "ratio(x[half], x[base]) < 1",
    "mean(x[tripled]) == mean(x[base])",
    "mean(x[tripled]) <= mean(x[base])",
    "mean(x[tripled]) ~ mean(x[base]) +- 1%",
    "mean(x[tripled]) / mean(x[base]) < 1.03",
    "ratio(x[tripled], x[base]) ~ 1 +- 0.5%",
    "median(x[tripled]) <= median(x[base])",
    "mean(100 * x[rare]) < 5",
    "mean(x[rare]) < 0.05",
    "mean(x[raised]) ~ mean(x[coin]) +- 0.021",
    "share(x[raised] > 0.5) - share(x[coin] > 0.5) < 0.021",
    "mean(x[raised]) <= mean(x[coin])",
    "mean(x[skew]) < mean(x[base])",
    "mean(x[inflated]) < 0.1",
    "mean(x[inflated]) < mean(x[level])",
    "mean(x[inflated]) / mean(x[level]) < 1",
]
"""None of them is true."""
SINGLE = [
    *(f"quantile(x[A], {q}) {sign} {border(q)}" for q in QUANTILES for sign in "<>"),
    f"quantile(x[A], 0.99) / 2 < {border(0.99)} / 2",
    f"1 - quantile(x[A], 0.99) > 1 - {border(0.99)}",
    f"max(x[A]) < {border(0.999)}",
    f"min(x[A]) > {border(0.001)}",
    f"all(x[A] < {border(0.999)})",
    f"x[A] > {border(0.001)}",
    *(f"share(x[A] < {border(p)}) {sign} {p}" for p in (0.01, 0.05, 0.5, 0.9, 0.99) for sign in "<>"),
    f"share(x[A] < {border(0.999)}) == 1",
    f"share(x[A] > {border(0.999)}) == 0",
    f"1 - share(x[A] < {border(0.99)}) < 0.01",
    "mean(x[C]) < 0.05",
    "ratio(x[A], x[B]) < 1",
    "1 - ratio(x[A], x[B]) > 0",
    "ratio(x[A], x[B]) ~ 1.05 +- 0.05",
    "ratio(x[A], x[B]) < 1 < ratio(x[A], x[B])",
    f"max(x[A]) < {border(0.999)} < max(x[B])",
    "mean(x[C]) < mean(x[D])",
    "mean(x[A]) / 0 > 1",
]
"""None of them is true."""
PAIRED = [
    *(f"quantile(x[A], {q}) < quantile(x[B], {q})" for q in QUANTILES),
    "quantile(x[A], 0.9) / quantile(x[B], 0.9) < 1",
    "quantile(x[A], 0.99) < 0.99 * quantile(x[B], 0.99)",
    "max(x[A]) < max(x[B])",
    "min(x[A]) > min(x[B])",
    "median(x[A]) < median(x[B]) < median(x[A])",
    "share(x[A] > 3) < share(x[B] > 3)",
    "share(x[A] > 8) < share(x[B] > 8)",
    "share(x[A] > 3) <= share(x[B] > 3) * 0.99999",
    "mean(x[A]) / mean(x[B]) < 1",
    "100 * mean(x[A]) / mean(x[B]) - 100 > 0",
    "std(x[A]) < std(x[B])",
    "abs(median(x[A]) - median(x[B])) > 0",
    "abs(mean(x[A]) / mean(x[B]) - 1) > 1e-5",
    "abs(share(x[A] < 1) - share(x[B] < 1)) > 0",
]
"""Those of several estimates, most of which are drawn again."""
OFTEN = [*SINGLE[::3], *PAIRED[1::3]]
LOOKED_AT = (
    f"quantile(x[A], 0.9) < {border(0.9)}",
    f"share(x[A] < {border(0.9)}) > 0.9",
    "ratio(x[A], x[B]) < 1",
    "mean(x[A]) / mean(x[B]) < 1",
    "median(x[A]) < median(x[B])",
    "share(x[A] > 3) < share(x[B] > 3)",
)


@pytest.fixture(autouse=True)
def _no_numbers_of_runs(monkeypatch):
    """How many runs would decide is most of the time, and no finding depends on it."""
    monkeypatch.setattr(decision, "n_deciding", lambda *_: None)


def of_every_experiment(check, trials):
    """Yield a claim of each experiment."""
    return (Claim("", "", (check.replace("x[", f"{info.name}["),)) for info in trials.metrics)


def falsely_confirmed(check, trials):
    """Share of the experiments in which a claim is confirmed."""
    verdicts = [judge(claim, trials) for claim in of_every_experiment(check, trials)]
    assert "/ 0" in check or not any(verdict.reason for verdict in verdicts)
    return np.mean([verdict.finding.is_confirmed for verdict in verdicts])


@pytest.mark.parametrize(("n", "check"), [*((20, check) for check in OFTEN), (2, SINGLE[0]), (5, SINGLE[7])])
def test_some_claims_at_the_border(n, check):
    """Confirmed in 4 % of the experiments at most; the slow tests have all of them."""
    assert falsely_confirmed(check, experiments(n, 250)) <= MOST


@pytest.mark.parametrize("n", [2, 20])
@pytest.mark.long
def test_few_values(n):
    """What few runs do not show confirms nothing; the slow tests have more runs and experiments."""
    trials = few_valued(n, 100)
    assert {check: share for check in FEW_VALUED if (share := falsely_confirmed(check, trials)) > 0.06} == {}


@pytest.mark.slow
@pytest.mark.parametrize("n", [*SIZES, 3, 10, 36])
def test_few_values_of_many_experiments(n):
    """Confirmed in 4 % of the experiments at most."""
    trials = few_valued(n, SEEDS)
    assert {check: share for check in FEW_VALUED if (share := falsely_confirmed(check, trials)) > MOST} == {}


@pytest.mark.slow
@pytest.mark.parametrize("n", SIZES)
def test_claims_at_the_border_of_one_estimate(n):
    """Confirmed in 4 % of the experiments at most."""
    trials = experiments(n)
    found = {check: falsely_confirmed(check, trials) for check in SINGLE}
    assert {check: share for check, share in found.items() if share > MOST} == {}


@pytest.mark.slow
@pytest.mark.parametrize("n", [*SIZES, 200])
def test_claims_at_the_border_of_several_estimates(n):
    """Confirmed in 4 % of the experiments at most."""
    trials = experiments(n)
    found = {check: falsely_confirmed(check, trials) for check in PAIRED}
    assert {check: share for check, share in found.items() if share > MOST} == {}


@pytest.mark.slow
@pytest.mark.parametrize(("first", "last"), [(2, 64), (25, 400)])
def test_all_looks_together(first, last):
    """At the border every decision is wrong in one of two directions: in 5 % of 1,000 experiments at most."""
    looks = schedule(first, last)
    whole = replace(experiments(last, 1000), confidence=planned_level(0.95, len(looks)))
    tables = [replace(whole, columns=arrays(whole.frame[whole.frame.run < n])) for n in looks]
    for check in LOOKED_AT:
        wrong = [
            any(judge(claim, table).finding is not Finding.INCONCLUSIVE for table in tables)
            for claim in of_every_experiment(check, whole)
        ]
        assert np.mean(wrong) <= 0.05, check


@pytest.mark.parametrize("q", [*QUANTILES, 0.1, 0.999])
def test_order_statistics_miss_a_quantile_by_their_binomial_law(q):
    """Each end is missed with 2.5 % at most, and the next order statistic would be missed more often."""
    for n in range(2, 400):
        low, high = order_ranks(n, q, 0.95)
        law = stats.binom(n, q)
        assert law.cdf(low - 1) <= 0.025 < law.cdf(low) and law.sf(high - 1) <= 0.025
        assert high == 1 or law.sf(high - 2) > 0.025
    assert order_ranks(367, 0.99, 0.95)[1] == 368 and order_ranks(368, 0.99, 0.95)[1] == 368


def test_shares_are_missed_in_2_5_percent_at_most():
    """The exact law of the number of hits; Wilson alone misses the share of a rare event in up to 17 %."""
    for n in (2, 5, 20, 60, 200):
        intervals = [(wilson(k, n, 0.95), exact_share(k, n, 0.95)) for k in range(n + 1)]
        lows, highs = ([pick(a[i], b[i]) for a, b in intervals] for i, pick in ((0, min), (1, max)))
        for p in np.linspace(0.001, 0.999, 999):
            weights = stats.binom(n, p).pmf(np.arange(n + 1))
            assert weights[np.array(lows) > p].sum() <= 0.025 + 1e-12
            assert weights[np.array(highs) < p].sum() <= 0.025 + 1e-12
