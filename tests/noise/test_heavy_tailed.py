"""Student's t noise and outliers against SciPy's laws, closed forms and the normal limit."""

import numpy as np
import pytest
from conftest import ROUND, within_stat
from scipy import stats

from rmpc_bench.noise.bursts import RandomBursts
from rmpc_bench.noise.gaussian import gaussian, outliers, student_t
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import DesignError

SHAPE = [[4.0, 1.0], [1.0, 2.0]]


def fresh(seed=1):
    """Generator of a run."""
    return np.random.default_rng(seed)


@pytest.mark.parametrize("dof", [1.0, 3.0, 30.0])
def test_shares_are_those_of_the_t_law(dof):
    """Oracle: the distribution function of SciPy at five quantiles, in both coordinates, about the mean."""
    law, p = student_t(2, dof=dof, scale=[2.0, 5.0], mean=[1.0, -1.0]), np.array([0.02, 0.2, 0.5, 0.8, 0.98])
    t = (law.draw(fresh(), 20_000) - [1.0, -1.0]) / [2.0, 5.0]
    assert within_stat(t[:, :, None] <= stats.t.ppf(p, dof), p)


def test_joint_coordinates_are_large_together():
    """Oracle: shares of the Mahalanobis distance, n F(n, dof) of SciPy; of independent ones the product of two laws."""
    p = np.array([0.1, 0.5, 0.9, 0.99])
    both = student_t(2, dof=3.0, scale_matrix=SHAPE, joint=True).draw(fresh(), 20_000)
    distance = np.einsum("ki,ij,kj->k", both, np.linalg.inv(SHAPE), both)
    assert within_stat(distance[:, None] <= 2.0 * stats.f.ppf(p, 2, 3), p)
    apart = student_t(2, dof=3.0, scale=1.0).draw(fresh(), 20_000)
    assert within_stat((np.abs(apart) > stats.t.ppf(0.95, 3)).all(axis=1), 0.01)
    joint = student_t(2, dof=3.0, scale=1.0, joint=True).draw(fresh(), 20_000)
    assert (np.abs(joint) > stats.t.ppf(0.95, 3)).all(axis=1).mean() > 0.02


def test_moments_of_the_t_law():
    """Oracle: dof / (dof - 2) times the scale matrix, of SciPy's multivariate t; none where they do not exist."""
    law = student_t(2, dof=6.0, scale_matrix=SHAPE, mean=[1.0, 2.0], joint=True)
    np.testing.assert_allclose(law.cov, 1.5 * np.array(SHAPE), **ROUND)
    np.testing.assert_array_equal(law.mean, [1.0, 2.0])
    assert student_t(1, dof=2.0, scale=1.0).cov is None and student_t(1, dof=2.0, scale=1.0).mean is not None
    assert student_t(1, dof=1.0, scale=1.0).mean is None
    table_b = student_t(1, dof=3.0, scale=10.0)
    np.testing.assert_allclose(table_b.cov, [[300.0]], **ROUND)


@pytest.mark.parametrize(
    "law",
    [
        outliers(2, cov=SHAPE, probability=0.3, factor=0.0, mean=1.0, scale=0.5),
        outliers(2, std=[1.0, 3.0], probability=0.1, factor=10.0),
        student_t(2, dof=12.0, scale_matrix=SHAPE),
    ],
)
def test_moments_are_those_of_the_draws(law):
    """Oracle: Monte Carlo, 20,000 samples; samples of different k are independent."""
    w = law.draw(fresh(), 20_000)
    centred = w - law.mean
    assert within_stat(w, law.mean)
    assert within_stat(centred[:, :, None] * centred[:, None, :], law.cov)
    assert within_stat((np.abs(centred[1:]) * np.abs(centred[:-1]))[::2], np.abs(centred).mean(axis=0) ** 2)


def test_outliers_are_samples_of_the_normal_law_times_a_factor():
    """Oracle: the normal law with the same stream, bit for bit; the share and its nesting in the probability."""
    quiet = gaussian(2, std=[1.0, 2.0], mean=3.0).draw(fresh(), 20_000)
    keys = {"std": [1.0, 2.0], "mean": 3.0, "factor": 8.0}
    few, many = (outliers(2, probability=p, **keys).draw(fresh(), 20_000) for p in (0.1, 0.4))
    inside = [(each != quiet).any(axis=1) for each in (few, many)]
    assert (inside[0] <= inside[1]).all()
    for share, each, drawn in zip((0.1, 0.4), inside, (few, many), strict=True):
        assert within_stat(each, share)
        np.testing.assert_array_equal(drawn[~each], quiet[~each])
        np.testing.assert_allclose(drawn[each] - 3.0, 8.0 * (quiet[each] - 3.0), atol=1e-12, **ROUND)


def test_the_normal_limit():
    """Oracle: the normal law with the same stream: p = 0 and factor 1 bit for bit, many degrees of freedom closely."""
    normal = gaussian(2, std=2.0, mean=1.0).draw(fresh(), 200)
    for keys in ({"probability": 0.0, "factor": 9.0}, {"probability": 1.0, "factor": 1.0}):
        np.testing.assert_array_equal(outliers(2, std=2.0, mean=1.0, **keys).draw(fresh(), 200), normal)
    t = student_t(2, dof=1e12, scale=2.0, mean=1.0).draw(fresh(), 200)
    np.testing.assert_allclose(t, normal, atol=1e-4)  # c / dof is 1 up to its standard deviation sqrt(2 / dof)


@pytest.mark.parametrize("bursts", [[Burst(1.0, 3.0, 4.0)], RandomBursts([(0.5, 4.5)], (1.0, 2.0), (2.0, 3.0))])
@pytest.mark.parametrize("design", [student_t, outliers])
def test_bursts_leave_the_law_without_them(design, bursts):
    """Oracle: the law without bursts, times the factor inside and bit for bit outside."""
    keys = {"dof": 3.0, "scale": 1.0} if design is student_t else {"std": 1.0, "probability": 0.2, "factor": 5.0}
    law, steady = design(2, 0.1, **keys, mean=1.0, bursts=bursts), design(2, 0.1, **keys, mean=1.0)
    inside = law.in_burst(fresh(), 60)
    loud, quiet = law.draw(fresh(), 60), steady.draw(fresh(), 60)
    np.testing.assert_array_equal(loud[~inside], quiet[~inside])
    factor = 4.0 if isinstance(bursts, list) else law.burst_values(fresh())["burst_factor"]
    np.testing.assert_allclose(loud[inside] - 1.0, factor * (quiet[inside] - 1.0), atol=1e-12, **ROUND)
    assert inside.any() and law.mean is None and law.cov is None


@pytest.mark.parametrize(
    ("make", "parameter"),
    [
        (lambda: student_t(2, dof=3.0), ""),
        (lambda: student_t(2, dof=3.0, scale=1.0, scale_matrix=1.0), ""),
        (lambda: student_t(2, dof=3.0, scale=[1.0, 2.0, 3.0]), "scale"),
        (lambda: student_t(2, dof=3.0, scale_matrix=[[1.0, 2.0], [2.0, 1.0]]), "scale_matrix"),
        (lambda: outliers(2, probability=0.1, factor=2.0), ""),
        (lambda: outliers(2, probability=0.1, factor=2.0, std=1.0, mean=[1.0]), "mean"),
    ],
)
def test_bad_laws_are_design_errors(make, parameter):
    """Oracle: the docstrings; the parameter to blame is named."""
    with pytest.raises(DesignError) as caught:
        make()
    assert caught.value.parameter == parameter
