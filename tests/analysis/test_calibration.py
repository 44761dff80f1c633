"""Calibration: factor and margin against scipy.stats, intervals, words and their errors in populations."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import coverage_trials, errors, of_squares, shares
from conftest import ROUND, SOLVER
from scipy import stats

from rmpc_bench.analysis.calibration import Region, calibrations, runs_needed, share_interval, word
from rmpc_bench.analysis.columns import Series
from rmpc_bench.analysis.traces import Traces
from rmpc_bench.types.metric import CalibrationKeys


def first(trials):
    """Rows for all states at the level of the verdict, by method."""
    rows = [row for _, found in calibrations(trials) for row in found]
    return {row["method"]: row for row in rows if row["of"] == "joint" and row["level"] == 0.9}


@pytest.mark.parametrize("n", [1, 2, 4])
def test_factor_and_margin_are_those_of_chi_square(n):
    """Oracle: scipy.stats; s^2 P covers 1 - (1 - p)^(s^2) with two states, and f = 1/s."""
    for p in (0.5, 0.9, 0.95):
        region = Region(p, n)
        for c in (0.1, 0.712, 0.904):
            wanted = np.sqrt(stats.chi2.ppf(p, n) / stats.chi2.ppf(c, n))
            np.testing.assert_allclose(region.factor(c), wanted, **SOLVER)
        wanted = stats.chi2.cdf(stats.chi2.ppf(p, n) / np.array([1.1, 1 / 1.1]) ** 2, n)
        np.testing.assert_allclose(region.margin(0.1), wanted, **SOLVER)
    for s in (0.5, 1.0, 1.5):
        np.testing.assert_allclose(Region(0.9, 2).factor(1 - 0.1**s**2), 1 / s, **ROUND)


def test_the_margins_of_the_page():
    """Oracle: inference.md, C1; that of one state is printed as [0.8652, 0.9296], which is f in [1/1.1, 1.1]."""
    wanted = {1: (0.8652, 0.9296), 2: (0.8509, 0.9383), 4: (0.8307, 0.9484)}
    for n, ends in wanted.items():
        np.testing.assert_allclose(Region(0.9, n).margin(0.1), ends, atol=5e-5)


def test_the_interval_is_student_t_or_wilson():
    """Oracle: scipy.stats, and the quadratic equation of Wilson with n runs."""
    rng = np.random.default_rng(3)
    values = rng.beta(8, 2, 40)
    wanted = stats.t.interval(0.95, 39, values.mean(), stats.sem(values))
    np.testing.assert_allclose(share_interval(values, 0.95), wanted, **SOLVER)
    few = np.ones(40)
    few[:9] = 0.5
    z2, n, c = stats.norm.ppf(0.975) ** 2, 40, few.mean()
    ends = np.sort(np.roots([1 + z2 / n, -(2 * c + z2 / n), c**2]).real)
    np.testing.assert_allclose(share_interval(few, 0.95), ends, rtol=1e-7)  # roots of a quadratic equation
    np.testing.assert_allclose(share_interval(1 - few, 0.95), 1 - ends[::-1], rtol=1e-7)
    few[:10] = 0.5
    assert share_interval(few, 0.95)[1] == pytest.approx(stats.t.interval(0.95, 39, few.mean(), stats.sem(few))[1])
    assert share_interval(np.ones(3), 0.95)[1] == 1.0 and np.isnan(share_interval(np.ones(0), 0.95)).all()


@pytest.mark.parametrize(
    ("interval", "wanted"),
    [
        ((0.87, 0.93), "calibrated"),
        ((0.86, 0.89), "calibrated"),
        ((0.5, 0.84), "overconfident"),
        ((0.95, 0.99), "conservative"),
        ((0.84, 0.89), "overconfident, size uncertain"),
        ((0.91, 0.95), "conservative, size uncertain"),
        ((0.84, 0.92), "inconclusive"),
        ((0.3, 1.0), "inconclusive"),
    ],
)
def test_words(interval, wanted):
    """Oracle: the table of inference.md, C1, with two states."""
    assert word(interval, 0.9, Region(0.9, 2).margin(0.1)) == wanted


def test_the_number_of_runs_that_decide():
    """Oracle: by simulation, with so many runs the word is another one in 80 % of experiments; more with two ways."""
    margin = Region(0.9, 2).margin(0.1)
    for c, most in ((0.84, 0.88), (0.88, 1.0), (0.9, 1.0)):
        rng = np.random.default_rng(5)
        sample = c + 0.1 * stats.norm.ppf((np.arange(16) + 0.5) / 16)
        n = int(runs_needed(sample, 0.9, margin, 0.95))
        found = [word(share_interval(rng.normal(c, sample.std(ddof=1), n), 0.95), 0.9, margin) for _ in range(400)]
        assert 0.72 < np.mean([each != "inconclusive" for each in found]) <= most, c
    assert np.isnan(runs_needed(np.full(20, 0.9), 0.9, margin, 0.95))


def test_rows_of_a_table():
    """Oracle: numbers by hand; the other levels and states have no word."""
    rng = np.random.default_rng(11)
    squares = errors(rng, 200)
    found = of_squares(squares, 1 / 1.5)
    found |= {"coverage_90_x_0": rng.beta(9, 1, 200), "coverage_90_x_1": rng.beta(9, 1, 200)}
    found |= {f"coverage_{p}_x_{i}": rng.beta(5, 1, 200) for p in (50, 95) for i in (0, 1)}
    [(_, rows)] = calibrations(coverage_trials({"KF": found}))
    assert [(row["of"], row["level"]) for row in rows] == [
        (of, p) for of in ("joint", "x.0", "x.1") for p in (0.5, 0.9, 0.95)
    ]
    assert [row["verdict"] for row in rows] == ["", "overconfident", *[""] * 7]
    row = rows[1]
    assert row["n"] == 200 and row["factor_low"] < 1.5 < row["factor_high"]
    np.testing.assert_allclose(row["covered"], found["coverage_90"].mean(), **ROUND)
    np.testing.assert_allclose(
        rows[4]["factor"], np.sqrt(stats.chi2.ppf(0.9, 1) / stats.chi2.ppf(rows[4]["covered"], 1)), **SOLVER
    )


def test_methods_without_a_covariance_failed_runs_and_bounds():
    """Oracle: by hand."""
    rng = np.random.default_rng(2)
    wide = of_squares(errors(rng, 40, rho=0.0), 1.3)
    none = dict.fromkeys(wide, np.full(40, np.nan))
    some = {name: np.where(np.arange(40) < 3, np.nan, values) for name, values in wide.items()}
    trials = coverage_trials({"KF": wide, "none": none, "failed": none, "bound": some}, bounds=frozenset({"bound"}))
    trials.columns["status"][80:120] = "diverged"
    trials.columns["status"][120:123] = "diverged"
    found = first(trials)
    words = {name: row["verdict"] for name, row in found.items()}
    assert words == {
        "KF": "conservative",
        "none": "reports no covariance",
        "failed": "no finished run",
        "bound": "conservative (reports a bound)",
    }
    assert found["bound"]["n"] == 37 and found["none"]["n"] == 0 and np.isnan(found["none"]["covered"])
    smoke = replace(trials, with_verdicts=False)
    assert {row["verdict"] for row in first(smoke).values()} == {"", "reports no covariance", "no finished run"}


def test_a_bound_that_is_overconfident_is_called_so():
    """Oracle: the word of a bound replaces that of a conservative covariance only."""
    squares = errors(np.random.default_rng(4), 60)
    trials = coverage_trials(
        {"R": of_squares(squares, 0.5), "S": of_squares(squares, 1.0)}, bounds=frozenset({"R", "S"})
    )
    assert {row["verdict"] for row in first(trials).values()} == {"overconfident", "calibrated (within 10 %)"}


def test_the_rank_of_a_constant_covariance_counts():
    """Oracle: a covariance of rank 1 in two states has the factor of one degree of freedom."""
    rng = np.random.default_rng(8)
    values = {name: rng.beta(9, 1, 30) for name in ("coverage_50", "coverage_90", "coverage_95")}
    values |= {f"{name}_x_{i}": each for name, each in values.items() for i in (0, 1)}
    flat = Series("KF", "P", np.tile(np.ones((2, 2)), (5, 1, 1)))
    row = first(coverage_trials({"KF": values}, over_time=(flat,)))["KF"]
    np.testing.assert_allclose(row["factor"], Region(0.9, 1).factor(row["covered"]), **ROUND)
    full = first(coverage_trials({"KF": values}))["KF"]
    np.testing.assert_allclose(full["factor"], Region(0.9, 2).factor(row["covered"]), **ROUND)


def test_the_rank_of_the_covariances_of_recorded_runs_counts():
    """Oracle: scipy.stats; two of three runs have a covariance of rank 1, one has none at half of its samples."""
    rng = np.random.default_rng(8)
    values = {f"coverage_{p}{of}": rng.beta(9, 1, 30) for p in (50, 90, 95) for of in ("", "_x_0", "_x_1")}
    directions = np.array([[1.0, 2.0], [3.0, -1.0]])
    P = np.stack([*(np.outer(each, each) for each in directions), np.eye(2)]).reshape(3, 1, 4).repeat(6, axis=1)
    P[2, 3:] = np.nan
    x = rng.standard_normal((3, 6, 2))
    traces = {"KF": Traces(np.arange(3), {"x": x, "x_hat": x + 1.0, "P": P}, np.zeros((6, 1)))}
    row = first(coverage_trials({"KF": values}, traces=traces))["KF"]
    wanted = np.sqrt(stats.chi2.ppf(0.9, 1) / stats.chi2.ppf(row["covered"], 1))
    np.testing.assert_allclose(row["factor"], wanted, **SOLVER)


def test_verdicts_hold_together():
    """Oracle: eight independent methods that are right have a wider interval than one of them alone."""
    rng = np.random.default_rng(9)
    of = {f"m{i}": of_squares(errors(rng, 50, rho=0.0), 1.0) for i in range(8)}
    alone, together = (first(coverage_trials(each))["m0"] for each in ({"m0": of["m0"]}, of))
    plain = stats.t.interval(0.95, 49, of["m0"]["coverage_90"].mean(), stats.sem(of["m0"]["coverage_90"]))
    np.testing.assert_allclose((alone["low"], alone["high"]), plain, **SOLVER)
    sidak = stats.t.ppf((1 + 0.95 ** (1 / 8)) / 2, 49) / stats.t.ppf(0.975, 49)
    ratio = (together["high"] - together["low"]) / (alone["high"] - alone["low"])
    assert abs(ratio / sidak - 1) < 0.1  # of the sign flips


CASES = {
    # name -> (factor on the reported standard deviation, degrees of freedom of Student's t)
    "right": (1.0, None),
    "halved": (0.5, None),
    "times 1.5": (1.5, None),
    "border": (1 / 1.1, None),
}


def study(name, sets, seed=1, runs=50, rho=0.9):
    """Return the share of every word, and the share of intervals that contain the true coverage."""
    s, dof = CASES[name]
    rng = np.random.default_rng(seed)
    margin, true = Region(0.9, 2).margin(0.1), 1 - 0.1**s**2
    found, covered = [], 0
    for _ in range(sets):
        ends = share_interval(shares(errors(rng, runs, rho=rho, dof=dof), s), 0.95)
        found.append(word(ends, 0.9, margin))
        covered += ends[0] <= true <= ends[1]
    return {each: found.count(each) / sets for each in {*found}}, covered / sets


@pytest.mark.parametrize(
    ("name", "rho", "wanted", "least"),
    [
        ("right", 0.5, "calibrated", 0.99),
        ("halved", 0.5, "overconfident", 0.99),
        ("times 1.5", 0.5, "conservative", 0.99),
    ],
)
def test_words_of_the_page(name, rho, wanted, least):
    """Oracle: inference.md, C2 (two states, 100 samples, 50 runs); 300 sets, three Monte Carlo errors."""
    words, coverage = study(name, 300, rho=rho)
    assert words.get(wanted, 0.0) >= least
    if name == "right":
        assert abs(coverage - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 300) + 0.01


def test_at_the_border_few_are_called_calibrated():
    """Oracle: inference.md, C2: 2 %; the two-sided interval at 95 % is wrong on one side."""
    words, _ = study("border", 600)
    assert words.get("calibrated", 0.0) < 0.025 + 3 * np.sqrt(0.025 * 0.975 / 600)


def test_heavy_tails_are_said():
    """Oracle: inference.md, C2: Student's t with 3 degrees of freedom."""
    rng, said = np.random.default_rng(6), 0
    for _ in range(30):
        squares = errors(rng, 50, rho=0.0, dof=3)
        said += first(coverage_trials({"KF": of_squares(squares, 1.0)}))["KF"]["verdict"].endswith(", heavy tails")
    assert said == 30
    light = 1.5 * np.sqrt(errors(rng, 50, rho=0.0))
    assert first(coverage_trials({"KF": of_squares(light, 1.0)}))["KF"]["verdict"].endswith(", light tails")
    normal = first(coverage_trials({"KF": of_squares(errors(rng, 50), 1.0)}))["KF"]["verdict"]
    assert "tails" not in normal


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_words_of_nulls(rho):
    """Oracle: of right covariances at most 5 % have a word that denies it; 20,000 sets had 0.0, 0.0 and 2.9 %."""
    words, _ = study("right", 400, seed=2, rho=rho)
    wrong = sum(share for each, share in words.items() if each not in ("calibrated", "inconclusive"))
    assert wrong < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)


def test_names_of_the_metrics():
    """Oracle: by hand; names are those of columns."""
    assert CalibrationKeys.name(0.9) == "coverage_90" and CalibrationKeys.name(0.999, "x.10") == "coverage_99_9_x_10"
