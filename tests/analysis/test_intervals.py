"""Intervals against definitions and direct calls."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from rmpc_bench.analysis.intervals import (
    difference,
    holm,
    quantile,
    quantiles,
    signed_rank_p,
    student,
    wilson,
)
from rmpc_bench.analysis.pairs import relative_change

ROUND = 1e-12
FINITE = st.floats(-1e6, 1e6)


def test_student_by_hand():
    """1, 2, 3: mean 2, se 1/sqrt(3), and with two degrees of freedom t = p sqrt(2 / (1 - p^2)) for level p."""
    low, high = student(np.array([1.0, 2.0, 3.0]), 0.95)
    reach = 0.95 * math.sqrt(2 / (1 - 0.95**2)) / math.sqrt(3)
    assert (low, high) == pytest.approx((2 - reach, 2 + reach), rel=1e-10)
    assert all(math.isnan(end) for end in student(np.array([1.0]), 0.95))
    assert all(math.isnan(end) for end in student(np.array([1.0, np.inf]), 0.95))


@given(st.integers(0, 40), st.integers(1, 40), st.sampled_from([0.9, 0.95]))
def test_wilson_by_its_formula(k, n, confidence):
    """The closed form of the score interval."""
    k = min(k, n)
    z = stats.norm.ppf((1 + confidence) / 2)
    centre = (k + z**2 / 2) / (n + z**2)
    reach = z / (n + z**2) * math.sqrt(k * (n - k) / n + z**2 / 4)
    assert wilson(k, n, confidence) == pytest.approx((centre - reach, centre + reach), abs=1e-9)


@given(st.lists(FINITE, min_size=1, max_size=30), st.floats(0, 1))
def test_quantile_of_finite_values_is_numpys(values, q):
    """Linear interpolation between order statistics."""
    assert float(quantile(np.array(values), q)) == pytest.approx(float(np.quantile(values, q)), rel=1e-9, abs=1e-9)


def test_quantile_with_inf():
    """Between two infs there is inf, not NaN."""
    values = np.array([1.0, np.inf, np.inf, 2.0])
    assert [float(quantile(values, q)) for q in (0.0, 1 / 3, 0.5, 0.9)] == [1, 2, math.inf, math.inf]
    assert math.isnan(quantile(np.array([]), 0.5))


def test_quantile_of_columns(rng):
    """Along axis 0: every column by itself."""
    values = rng.normal(size=(9, 3))
    values[rng.random((9, 3)) < 0.2] = np.inf
    for q in (0, 0.3, 0.5, 1):
        np.testing.assert_array_equal(quantile(values, q), [float(quantile(column, q)) for column in values.T])


def test_quantiles_together(rng):
    """Several at once are those one by one."""
    values, levels = rng.normal(size=101), [1.0, 0.25, 0.0, 0.5, 0.333]
    assert [float(each) for each in quantiles(values, levels)] == [float(quantile(values, q)) for q in levels]


def test_no_heavy_import():
    """Plain check evaluates claims and must not pay for SciPy's statistics."""
    code = "import sys, rmpc_bench.claims.comparison; assert 'scipy.stats' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(filter(None, sys.path))})


def test_difference_of_infs_is_0():
    """A run that neither method settles is a tie."""
    a, b = np.array([np.inf, 1.0, np.inf]), np.array([np.inf, np.inf, 2.0])
    assert difference(a, b).tolist() == [0, -math.inf, math.inf]


@pytest.mark.parametrize("n", range(2, 15))
def test_signed_rank_p_of_few_runs_counts_all_signs(n, rng):
    """Oracle: scipy.stats.wilcoxon, which calls its statistic for every choice of signs."""
    for x in (rng.standard_normal(n), rng.integers(-3, 4, n) + 0.0, np.r_[np.inf, rng.integers(-1, 2, n - 1)]):
        with np.errstate(invalid="ignore"):
            assert signed_rank_p(x) == stats.wilcoxon(x).pvalue, x


@pytest.mark.parametrize("n", range(14, 51))
def test_signed_rank_p_of_fewer_than_51_runs(n, rng):
    """Oracle: scipy.stats.wilcoxon, to the last bit: without ties, all of one sign, with ties, with 0, with inf."""
    plain, signs = rng.standard_normal(n), rng.choice([-1, 1], n)
    tied, some_zero = rng.integers(1, 9, n) * signs + 0.0, np.r_[0.0, plain[1:]]
    for x in (
        plain,
        plain + 0.3,
        np.abs(plain),
        tied,
        some_zero,
        np.r_[np.inf, plain[1:]],
        np.r_[np.inf, -np.inf, tied[2:]],
    ):
        with np.errstate(invalid="ignore"):
            assert signed_rank_p(x) == stats.wilcoxon(x).pvalue, x


def test_signed_rank_p_does_not_load_scipy_stats():
    """Its import takes half a second, for one number of the quickstart."""
    code = (
        "import sys, numpy as np; from rmpc_bench.analysis.intervals import signed_rank_p\n"
        "for x in (np.arange(1.0, 51), np.ones(20), np.arange(60.0)): signed_rank_p(x)\n"
        "assert 'scipy.stats' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(filter(None, sys.path))})


def test_signed_rank_p():
    """Direct calls, and the two samples that have no test."""
    x = np.array([1.0, -2.0, 3.0, 4.0, 5.5])
    assert signed_rank_p(x) == stats.wilcoxon(x).pvalue
    assert signed_rank_p(np.zeros(5)) == 1.0
    assert math.isnan(signed_rank_p(np.zeros(0)))
    assert 0 < signed_rank_p(np.array([np.inf, -1.0, -np.inf, 0.0])) <= 1


def test_holm_known_example():
    """The worked example of R's p.adjust; a missing test is not in the family."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02], rel=ROUND)
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    adjusted = holm([0.04, math.nan, 0.01])
    assert [adjusted[0], adjusted[2]] == pytest.approx([0.04, 0.02], rel=ROUND)
    assert math.isnan(adjusted[1])


@pytest.mark.parametrize("digits", [0, 1, 8])
def test_signed_rank_p_of_many_runs(digits):
    """Oracle: SciPy with the same law; with ties, zeros and runs in which an event did not occur."""
    rng = np.random.default_rng(5)
    for n in (51, 52, 200, 999):
        x = np.round(rng.normal(0.1, 1.0, n), digits)
        assert signed_rank_p(x) == pytest.approx(stats.wilcoxon(x).pvalue, rel=ROUND)
        x[:7], x[8] = np.inf, -np.inf
        assert signed_rank_p(x) == pytest.approx(stats.wilcoxon(x).pvalue, rel=ROUND)
    assert math.isnan(signed_rank_p(np.full(60, np.nan)))


def test_the_change_of_a_ratio():
    """A logarithm that no ratio of numbers of the machine has is infinite, and no error."""
    assert relative_change(math.log(1.25)) == pytest.approx(0.25, rel=1e-12) and relative_change(0.0) == 0.0
    assert (
        relative_change(-800.0) == -1.0 and relative_change(800.0) == math.inf and math.isnan(relative_change(math.nan))
    )
