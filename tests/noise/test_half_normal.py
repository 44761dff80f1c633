"""Half-normal noise: its law, its moments, its bursts and its errors."""

import numpy as np
import pytest
from conftest import ROUND, within_stat
from scipy import stats

from rmpc_bench.noise.gaussian import gaussian, half_normal
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import DesignError


def drawn(law, n_samples=40_000, seed=1):
    return law.draw(np.random.default_rng(seed), n_samples)


def test_law_and_moments_are_those_of_scipy():
    """Oracle: scipy.stats.halfnorm; its distribution function at nine points, its mean and variance."""
    std, center = np.array([2.0, 0.5]), np.array([1.0, -3.0])
    law = half_normal(2, std=std.tolist(), center=center.tolist())
    w = drawn(law)
    for i in range(2):
        exact = stats.halfnorm(center[i], std[i])
        np.testing.assert_allclose(law.mean[i], exact.mean(), **ROUND)
        np.testing.assert_allclose(law.cov[i, i], exact.var(), **ROUND)
        share = np.arange(1, 10) / 10
        assert within_stat(w[:, i, None] <= exact.ppf(share), share)
    assert (w >= center).all()
    assert within_stat(w, law.mean)
    assert within_stat((w - law.mean)[:, :, None] * (w - law.mean)[:, None], law.cov)


def test_it_is_the_absolute_value_of_normal_noise():
    """Oracle: `gaussian` with the same stream; a coordinate with std = 0 is a constant."""
    w, z = drawn(half_normal(2, std=[1.0, 0.0], center=[0.0, 0.7], scale=3.0), 50), drawn(gaussian(2, std=1.0), 50)
    np.testing.assert_array_equal(w, np.column_stack([3.0 * np.abs(z[:, 0]), np.full(50, 0.7)]))


def test_bursts_enlarge_the_distance_from_the_center():
    """Oracle: by hand, samples 2 to 5 of ten times the distance; a law with bursts has no moments."""
    plain = half_normal(1, 0.1, std=1.0, center=2.0)
    law = half_normal(1, 0.1, std=1.0, center=2.0, bursts=[Burst(0.2, 0.5, 10.0)])
    gain = np.where((np.arange(20) >= 2) & (np.arange(20) <= 5), 10.0, 1.0)[:, None]
    np.testing.assert_allclose(drawn(law, 20) - 2.0, gain * (drawn(plain, 20) - 2.0), **ROUND)
    assert law.mean is None and law.cov is None


@pytest.mark.parametrize("key", ["std", "center"])
def test_a_size_that_does_not_fit_names_its_key(key):
    """Oracle: three numbers for two coordinates."""
    with pytest.raises(DesignError, match="2 numbers") as caught:
        half_normal(2, **{"std": 1.0, key: [1.0, 2.0, 3.0]})
    assert caught.value.parameter == key
