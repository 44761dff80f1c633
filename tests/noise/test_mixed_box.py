"""The uniform law with correlated coordinates."""

import numpy as np
import pytest
from conftest import ROUND, within_stat

from rmpc_bench.noise.bounded import uniform


def drawn(law, n_samples=40_000):
    """Noise of one run."""
    return law.draw(np.random.default_rng(1), n_samples)


def test_a_mixed_box():
    """Oracle: center + T u from the same draws of u, T = mix diag(radius); its covariance T T' / 3."""
    mix, radius, center = [[1.0, 0.0, 0.0], [0.8, 0.2, 0.0], [0.0, -1.0, 2.0]], [1.0, 2.0, 3.0], [1.0, 0.0, -1.0]
    law, u = uniform(3, radius=radius, center=center, mix=mix), drawn(uniform(3, radius=1.0))
    T = np.array(mix) * radius
    np.testing.assert_allclose(drawn(law), center + u @ T.T, rtol=1e-12, atol=1e-14)  # sums about 0
    np.testing.assert_allclose(law.cov, T @ T.T / 3.0, **ROUND)
    np.testing.assert_array_equal(law.mean, center)
    assert within_stat((drawn(law) - center)[:, :, None] * (drawn(law) - center)[:, None, :], T @ T.T / 3.0)


@pytest.mark.parametrize("mix", [None, 1.0, [1.0, 1.0], [[1.0, 0.0], [0.0, 1.0]]])
def test_a_box_that_is_not_mixed(mix):
    """Oracle: the law of the docstring, -radius + 2 radius u, bit for bit; a number and a diagonal stretch."""
    law, p = uniform(2, radius=[1.0, 3.0], mix=mix), np.random.default_rng(1).random((50, 2))
    np.testing.assert_array_equal(drawn(law, 50), (2.0 * p - 1.0) * [1.0, 3.0])
    np.testing.assert_array_equal(drawn(uniform(2, radius=[1.0, 3.0], mix=2.0), 50), 2.0 * drawn(law, 50))
    np.testing.assert_array_equal(drawn(uniform(2, radius=1.0, mix=[1.0, 3.0]), 50), drawn(law, 50))
