"""Random walk and coloured noise: covariance functions, the white limit, SciPy's filter, bursts."""

import math

import numpy as np
import pytest
from conftest import ROUND, within_stat
from scipy.signal import lfilter

from rmpc_bench.noise.correlated import coloured, drift
from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import DesignError

COV = np.array([[4.0, 1.0], [1.0, 2.0]])


def fresh(seed=1):
    """Generator of a run."""
    return np.random.default_rng(seed)


def runs(law, n_runs=2500, n_samples=9):
    """Draws of many runs, (runs, samples, n)."""
    return np.array([law.draw(np.random.default_rng((5, run)), n_samples) for run in range(n_runs)])


@pytest.mark.parametrize("pole", [0.8, -0.5, 0.0])
def test_covariance_function_of_coloured_noise(pole):
    """Oracle: a^|j - k| cov, from the first sample on; Monte Carlo over runs."""
    law = coloured(2, cov=COV.tolist(), pole=pole, mean=[1.0, -2.0])
    c = runs(law) - [1.0, -2.0]
    assert within_stat(c, 0.0)
    for j, k in ((0, 0), (8, 8), (0, 1), (3, 5), (2, 8)):
        assert within_stat(np.einsum("ri,rj->rij", c[:, j], c[:, k]), pole ** abs(j - k) * COV)
    np.testing.assert_allclose(law.cov, COV, **ROUND)
    assert not law.is_white


def test_coloured_noise_is_filtered_white_noise():
    """Oracle: SciPy's lfilter on the normal noise of the same stream; the correlation time gives the pole."""
    white = gaussian(2, std=[1.0, 3.0]).draw(fresh(), 300)
    a = math.exp(-0.1 / 0.4)
    driven = math.sqrt(1.0 - a * a) * white
    driven[0] = white[0]
    expected = lfilter([1.0], [1.0, -a], driven, axis=0)
    found = coloured(2, 0.1, std=[1.0, 3.0], time=0.4).draw(fresh(), 300)
    np.testing.assert_allclose(found, expected, atol=1e-12, **ROUND)


def test_the_white_limit():
    """Oracle: the normal law with the same stream, bit for bit; and without any increments the start."""
    np.testing.assert_array_equal(
        coloured(2, std=2.0, mean=1.0, pole=0.0).draw(fresh(), 50), gaussian(2, std=2.0, mean=1.0).draw(fresh(), 50)
    )
    np.testing.assert_array_equal(drift(2, std=1.0, scale=0.0, start=[1.0, 2.0]).draw(fresh(), 5), [[1.0, 2.0]] * 5)


def test_covariance_function_of_a_random_walk():
    """Oracle: min(j, k) D, and the start at k = 0 in every run; Monte Carlo over runs."""
    law = drift(2, cov=COV.tolist(), start=[5.0, -5.0])
    d = runs(law) - [5.0, -5.0]
    np.testing.assert_array_equal(d[:, 0], 0.0)
    assert within_stat(d[:, 1:], 0.0)
    for j, k in ((1, 1), (8, 8), (1, 2), (3, 7)):
        assert within_stat(np.einsum("ri,rj->rij", d[:, j], d[:, k]), min(j, k) * COV)
    assert law.cov is None and not law.is_white
    np.testing.assert_array_equal(law.mean, [5.0, -5.0])


def test_increments_of_a_random_walk_are_normal():
    """Oracle: the normal law with the same stream, whose first sample is not used; sums of rounded numbers."""
    increments = np.diff(drift(2, std=[1.0, 2.0]).draw(fresh(), 60), axis=0)
    np.testing.assert_allclose(increments, gaussian(2, std=[1.0, 2.0]).draw(fresh(), 60)[1:], atol=1e-12)  # of sums


def test_bursts_enlarge_increments_of_a_walk_and_deviations_of_coloured_noise():
    """Oracle: by hand from the draws without bursts."""
    bursts = [Burst(0.5, 1.0, 3.0)]
    walk, steady = drift(1, 0.1, std=1.0, start=2.0, bursts=bursts), drift(1, 0.1, std=1.0, start=2.0)
    steps, loud = np.diff(steady.draw(fresh(), 20), axis=0), np.diff(walk.draw(fresh(), 20), axis=0)
    gain = np.where((np.arange(1, 20) >= 5) & (np.arange(1, 20) <= 10), 3.0, 1.0)[:, None]
    np.testing.assert_allclose(loud, gain * steps, atol=1e-12)  # of sums
    keys = {"std": 1.0, "pole": 0.9, "mean": 2.0}
    c, quiet = coloured(1, 0.1, **keys, bursts=bursts), coloured(1, 0.1, **keys)
    inside = c.in_burst(fresh(), 20)
    found, expected = c.draw(fresh(), 20) - 2.0, quiet.draw(fresh(), 20) - 2.0
    np.testing.assert_allclose(found, np.where(inside[:, None], 3.0, 1.0) * expected, atol=1e-12)  # of sums
    assert not walk.is_white and not c.is_white and c.cov is None


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: coloured(1, std=1.0), "either time or pole"),
        (lambda: coloured(1, std=1.0, time=1.0, pole=0.5), "either time or pole"),
        (lambda: coloured(1, pole=0.5), "either std or cov"),
        (lambda: drift(2, std=[1.0, 2.0, 3.0]), "2 numbers"),
        (lambda: drift(2, std=1.0, start=[1.0]), "2 numbers"),
    ],
)
def test_bad_laws_are_design_errors(make, message):
    """Oracle: the docstrings."""
    with pytest.raises(DesignError, match=message):
        make()
