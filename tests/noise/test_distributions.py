"""Laws of uncertain quantities against scipy.stats."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from rmpc_bench.noise.distributions import Choice, Fixed, Normal, Uniform

P = [0.0, 1e-12, 1e-3, 0.1, 0.25, 0.5, 0.77, 0.999, 1.0 - 1e-12]
NORMAL = Normal(std=0.3, mean=2.0)


@pytest.mark.parametrize("p", P)
def test_the_uniform_quantile(p):
    """Oracle: scipy.stats.uniform."""
    np.testing.assert_allclose(Uniform(-0.4, 1.2).quantile(p), stats.uniform(-0.4, 1.6).ppf(p), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("p", P[1:])
def test_the_normal_quantile(p):
    """Oracle: scipy.stats.norm."""
    np.testing.assert_allclose(NORMAL.quantile(p), stats.norm(2.0, 0.3).ppf(p), rtol=1e-12)


@pytest.mark.parametrize("truncate", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("p", P)
def test_the_truncated_normal_quantile(p, truncate):
    """Oracle: scipy.stats.truncnorm, whose bounds are in standard deviations, too."""
    ours = Normal(std=0.3, mean=2.0, truncate=truncate).quantile(p)
    np.testing.assert_allclose(ours, stats.truncnorm(-truncate, truncate, 2.0, 0.3).ppf(p), rtol=1e-9)
    assert abs(ours - 2.0) <= 0.3 * truncate * (1.0 + 1e-9)


def test_the_lowest_draw_of_a_normal_is_finite():
    """Oracle: p = 0 happens once in 2^53; half a draw is 2^-54."""
    np.testing.assert_allclose(NORMAL.quantile(0.0), stats.norm(2.0, 0.3).ppf(2.0**-54), rtol=1e-12)


def test_a_choice_is_uniform_over_its_values():
    """Oracle: by hand; the last value for the largest p below 1, too."""
    law = Choice((3.0, 1.0, 2.0))
    assert [law.quantile(p) for p in (0.0, 0.33, 0.34, 0.66, 0.67, np.nextafter(1.0, 0.0))] == [3, 3, 1, 1, 2, 2]


def test_a_fixed_value_is_fixed():
    """Oracle: the definition."""
    assert {Fixed(0.1).quantile(p) for p in P} == {0.1}


def test_nonsense_is_refused():
    """Oracle: the messages say what is wrong."""
    with pytest.raises(ValueError, match="must not exceed"):
        Uniform(1.0, -1.0)
    with pytest.raises(ValueError, match="empty"):
        Choice(())


LAWS = [Uniform(-1.0, 1.0), NORMAL, Normal(1.0, truncate=2.0), Choice((1.0, 2.0, 5.0))]


@pytest.mark.parametrize("law", LAWS)
@given(st.floats(0.0, 1.0, exclude_max=True), st.floats(0.0, 1.0, exclude_max=True))
def test_quantiles_do_not_decrease(law, p, q):
    """Oracle: a quantile is monotone (the choice lists its values in order)."""
    low, high = sorted((p, q))
    assert law.quantile(low) <= law.quantile(high)


@pytest.mark.parametrize("law", LAWS[:3])
def test_samples_follow_the_law(law, rng):
    """Oracle: Kolmogorov-Smirnov test of 5000 inverse transforms against scipy.stats; level of 5 sigma."""
    theirs = {
        Uniform(-1.0, 1.0): stats.uniform(-1.0, 2.0),
        NORMAL: stats.norm(2.0, 0.3),
        Normal(1.0, truncate=2.0): stats.truncnorm(-2.0, 2.0),
    }[law]
    samples = [law.quantile(p) for p in rng.random(5000)]
    assert stats.kstest(samples, theirs.cdf).pvalue > 2.0 * stats.norm.sf(5.0)
