"""Mean and covariance over runs in groups: any blocks give those of NumPy, and the same bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rmpc_bench.simulation.ensemble import SIZE, groups, joined

RUNS, SAMPLES = 173, 5


@pytest.fixture
def trajectories(rng):
    """States and estimates of many runs far from zero, of which some failed with wild numbers."""
    x = 100.0 + rng.standard_normal((RUNS, SAMPLES, 2)) * [1.0, 30.0]
    x_hat = -5.0 + rng.standard_normal((RUNS, SAMPLES, 3))
    ok = rng.random(RUNS) > 0.1
    x[~ok], x_hat[~ok] = np.nan, np.inf
    return x, x_hat, ok


def split(parts, trajectories):
    """Gather the runs in blocks with these ends."""
    x, x_hat, ok = trajectories
    found = []
    for start, stop in zip([0, *parts], [*parts, RUNS], strict=True):
        found += groups(x[start:stop], x_hat[start:stop], ok[start:stop], range(start, stop))
    return found


def close(ours, trajectories):
    """Compare with NumPy over all good runs: rounding is 1e-16 of the squares, (100)^2, over variances near 1."""
    x, x_hat, ok = trajectories
    z = np.concatenate([x, x_hat], axis=2)[ok]
    n, mean, cov = ours
    assert n == ok.sum()
    np.testing.assert_allclose(mean, z.mean(axis=0), rtol=1e-12)
    for k in range(SAMPLES):
        np.testing.assert_allclose(cov[k], np.cov(z[:, k].T), rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("parts", [[], [50, 100, 150], [1], [7, 8, 60, 130], [49, 51], list(range(1, RUNS)), [100]])
def test_any_blocks_give_the_mean_and_covariance_of_all_runs(parts, trajectories):
    """Oracle: numpy mean and cov of the good runs."""
    close(joined(split(parts, trajectories)), trajectories)


@given(
    parts=st.sets(st.integers(1, RUNS - 1)).map(sorted),
    seed=st.integers(0, 2**32 - 1),
    failing=st.sampled_from([0.0, 0.1, 0.9, 1.0]),
    widths=st.tuples(st.integers(1, 4), st.integers(1, 3)),
)
def test_any_blocks_give_the_same_bytes(parts, seed, failing, widths):
    """Oracle: one block, bit for bit."""
    rng = np.random.default_rng(seed)
    x, x_hat = (10.0 ** rng.integers(-3, 4) * rng.standard_normal((RUNS, SAMPLES, nx)) for nx in widths)
    case = x, x_hat, rng.random(RUNS) >= failing
    for a, b in zip(joined(split([], case)), joined(split(parts, case)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_groups_are_fixed_ranges_of_runs(trajectories):
    """Oracle: multiples of 50; the runs of a group that a block cuts come one by one; how many ended well."""
    _, _, ok = trajectories
    found = split([60], trajectories)
    assert SIZE == 50
    singles = [(run, run + 1) for run in (*range(50, 100), *range(150, RUNS))]
    assert [(part.first, part.stop) for part in found] == sorted([(0, 50), (100, 150), *singles])
    assert [part.n for part in found] == [int(ok[part.first : part.stop].sum()) for part in found]


@pytest.mark.parametrize("good", [[], [4], [60], [4, 60], [0, 172]])
def test_few_good_runs(good, trajectories):
    """Oracle: no run has no mean (zero) and no covariance; one run is its own mean; two have a covariance."""
    x, x_hat, _ = trajectories
    x, x_hat = np.nan_to_num(x), np.nan_to_num(x_hat, posinf=0.0)
    ok = np.isin(np.arange(RUNS), good)
    n, mean, cov = joined(groups(x, x_hat, ok, range(RUNS)))
    z = np.concatenate([x, x_hat], axis=2)[ok]
    assert n == len(good)
    np.testing.assert_allclose(mean, z.mean(axis=0) if good else np.zeros((SAMPLES, 5)), rtol=1e-12)
    assert np.isnan(cov).all() if n < 2 else np.allclose(cov[2], np.cov(z[:, 2].T), rtol=1e-12)


def test_runs_that_agree_have_no_covariance():
    """Oracle: zero, exactly: the mean of equal binary fractions is one of them."""
    x = np.full((120, 3, 1), 0.375)
    n, mean, cov = joined(groups(x, x, np.ones(120, dtype=bool), range(120)))
    assert n == 120
    np.testing.assert_array_equal(mean, np.full((3, 2), 0.375))
    np.testing.assert_array_equal(cov, np.zeros((3, 2, 2)))


def test_a_large_mean_does_not_swamp_a_small_spread(rng):
    """Oracle: covariance of the deviations, which are known; squares of 1e8 would leave no digit of 1e-1."""
    deviation = 2.0 ** np.round(rng.uniform(-8, -1, (200, 2, 1)))
    n, _, cov = joined(groups(1e8 + deviation, -deviation, np.ones(200, dtype=bool), range(200)))
    expected = np.cov(np.hstack([deviation[:, 0], -deviation[:, 0]]).T)
    # A mean near 1e8 is known to 1e-8, which is what remains in a deviation of 1e-1.
    np.testing.assert_allclose(cov[0], expected, rtol=1e-6)
