"""Laws of uncertain quantities against scipy.stats."""

import numpy as np
import pytest
from conftest import ROUND, SOLVER
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats

from rmpc_bench.noise.distributions import (
    Choice,
    ChoiceGroup,
    Fixed,
    Lognormal,
    Normal,
    NormalGroup,
    Triangular,
    Uniform,
)

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


LIMITED = [(-0.5, None), (None, 0.3), (-1.0, 2.0), (3.0, None), (None, -9.0), (5.0, 5.5), (-30.0, 0.0)]


@pytest.mark.parametrize(("low", "high"), LIMITED)
@pytest.mark.parametrize("p", P)
def test_the_quantile_of_a_normal_law_between_limits(p, low, high):
    """Oracle: scipy.stats.truncnorm, also where the limits lie far from the mean."""
    ends = (-np.inf if low is None else low, np.inf if high is None else high)
    limits = {name: 1.0 + 2.0 * z for name, z in (("low", low), ("high", high)) if z is not None}
    ours = Normal(std=2.0, mean=1.0, **limits).quantile(p)
    low_end, high_end = (1.0 + 2.0 * each for each in ends)
    assert low_end <= ours <= high_end and np.isfinite(ours)
    if p:
        np.testing.assert_allclose(
            ours, stats.truncnorm(*ends, 1.0, 2.0).ppf(p), rtol=1e-8, atol=1e-9
        )  # that of truncnorm


def moments(law):
    """Mean and variance by integrals of the quantile over the shares."""
    mean = integrate.quad(law.quantile, 0.0, 1.0 - 1e-16, limit=500)[0]
    return mean, integrate.quad(lambda p: (law.quantile(p) - mean) ** 2, 0.0, 1.0 - 1e-16, limit=500)[0]


def test_moments_in_closed_form():
    """Oracle: the textbook formulas, whose values are written out."""
    lognormal = Lognormal(2.0, 1.5)
    np.testing.assert_allclose(lognormal.quantile(0.05), 1.026563100, rtol=1e-9)
    np.testing.assert_allclose(moments(lognormal)[0], 2.171347967, **SOLVER)
    np.testing.assert_allclose(2.171347967, 2.0 * np.exp(0.5 * np.log(1.5) ** 2), rtol=1e-9)
    np.testing.assert_allclose(moments(Normal(1.0, low=-0.5)), (0.509160434, 0.486175436), **SOLVER)
    np.testing.assert_allclose(moments(Triangular(-1.0, 0.0, 2.0)), (1 / 3, 7 / 18), **SOLVER)


@pytest.mark.parametrize("p", P)
def test_the_triangular_quantile(p):
    """Oracle: scipy.stats.triang, also with the mode at an end."""
    for low, mode, high in [(-1.0, 0.0, 2.0), (1.0, 1.0, 2.0), (1.0, 2.0, 2.0)]:
        theirs = stats.triang((mode - low) / (high - low), low, high - low)
        np.testing.assert_allclose(Triangular(low, mode, high).quantile(p), theirs.ppf(p), rtol=1e-9, atol=1e-12)
    assert Triangular(1.0, 1.0, 1.0).quantile(p) == 1.0


def test_scales_of_further_laws():
    """Oracle: ln(factor), distances from the mean or the mode, and the covariance grow; the same draw of a run."""
    for p in (0.03, 0.4, 0.98):
        one, three = Lognormal(2.0, 1.5).quantile(p), Lognormal(2.0, 1.5).scaled(3.0).quantile(p)
        np.testing.assert_allclose(np.log(three / 2.0), 3.0 * np.log(one / 2.0), **ROUND)
        for law, centre in [(Normal(2.0, 1.0, low=0.5, high=4.0), 1.0), (Triangular(0.0, 1.0, 4.0), 1.0)]:
            moved = law.scaled(3.0).quantile(p) - centre
            np.testing.assert_allclose(moved, 3.0 * (law.quantile(p) - centre), **ROUND)
            assert law.scaled(0.0).quantile(p) == centre and law.scaled(1) == law
    group = NormalGroup(("a", "b"), (1.0, 2.0), ((4.0, 1.0), (1.0, 2.0)))
    assert group.scaled(3.0).cov == ((36.0, 9.0), (9.0, 18.0))
    rows = ChoiceGroup(("a", "b"), ((0.0, 1.0), (4.0, 5.0)), (0.25, 0.75)).scaled(2.0)
    np.testing.assert_allclose(rows.values, [(-3.0, -2.0), (5.0, 6.0)], **ROUND)
    chosen = Choice((0.0, 4.0), (0.25, 0.75)).scaled(2.0)
    np.testing.assert_allclose(chosen.values, (-3.0, 5.0), **ROUND)


def test_a_choice_with_probabilities():
    """Oracle: by hand; a value of probability 0 is never chosen."""
    law = Choice((3.0, 1.0, 2.0, 7.0), (0.5, 0.0, 0.5, 0.0))
    assert [law.quantile(p) for p in (0.0, 0.49, 0.5, np.nextafter(1.0, 0.0))] == [3, 3, 2, 2]
    thirds = Choice((1.0, 2.0, 3.0), (1 / 3, 1 / 3, 1 / 3))
    assert thirds.quantile(np.nextafter(1.0, 0.0)) == 3.0


def test_a_normal_group():
    """Oracle: of a diagonal covariance the laws of single quantities; else z' = S z has the covariance S S."""
    p = [0.1, 0.7]
    apart = [Normal(2.0, 1.0).quantile(p[0]), Normal(0.5, -1.0).quantile(p[1])]
    diagonal = NormalGroup(("a", "b"), (1.0, -1.0), ((4.0, 0.0), (0.0, 0.25)))
    np.testing.assert_allclose(diagonal.draw(p), apart, **ROUND)
    assert diagonal.streams("g") == ("a", "b") and ChoiceGroup(("a",), ((1.0,),)).streams("g") == ("g",)
    cov = np.array([[4.0, 2.0], [2.0, 1.0]])  # singular
    group = NormalGroup(("a", "b"), (0.0, 0.0), tuple(map(tuple, cov)))
    S = np.transpose([group.draw(stats.norm.cdf(unit).tolist()) for unit in np.eye(2)])
    np.testing.assert_allclose(S @ S.T, cov, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Normal(1.0, truncate=1.0, low=0.0), "give `truncate`, or `low` and `high`"),
        (lambda: Normal(1.0, low=1.0, high=-1.0), "no value lies between"),
        (lambda: Normal(1.0, low=50.0), "no value lies between"),
        (lambda: Triangular(0.0, 3.0, 2.0), "low <= mode <= high does not hold"),
        (lambda: Choice((1.0, 2.0), (0.5, 0.6)), "add to 1.1, not to 1"),
        (lambda: Choice((1.0, 2.0), (1.0,)), "2 values and 1 probabilities"),
        (lambda: NormalGroup(("a",), (0.0,), ((-1.0,),)), "cov: must be positive semidefinite"),
        (lambda: NormalGroup(("a", "b"), (0.0, 0.0), ((1.0,),)), "cov: "),
        (lambda: NormalGroup(("a", "b"), (0.0,), ((1.0, 0.0), (0.0, 1.0))), "2 names and 1 means"),
        (lambda: ChoiceGroup(("a", "b"), ((1.0, 2.0), (1.0,))), "row 2 has 1 values"),
    ],
)
def test_nonsense_of_further_laws(make, message):
    """Oracle: the messages say what is wrong."""
    with pytest.raises(ValueError, match=message):
        make()
