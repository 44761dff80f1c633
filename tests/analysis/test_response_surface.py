"""Shares against closed forms, brute-force least squares, permutations and simulated coverage."""

import tracemalloc

import numpy as np
import pytest
from conftest import STAT, within_stat

from rmpc_bench.analysis import responses
from rmpc_bench.analysis.responses import shares, standardised, surface_for


def uniform(n, n_quantities, seed=0):
    """(n, quantities) independent values, uniform on [-1, 1]."""
    return np.random.default_rng(seed).uniform(-1, 1, (n, n_quantities))


def response(z):
    """Y = 2 z0 + z1 + 3 z0 z1 + (z2^2 - 1/3), whose analysis of variance is known; z3 has no effect."""
    return 2 * z[:, 0] + z[:, 1] + 3 * z[:, 0] * z[:, 1] + z[:, 2] ** 2 - 1 / 3


# Variances of the terms for independent values uniform on [-1, 1]: 4/3, 1/3, 9/9 and 4/45.
VARIANCE = 4 / 3 + 1 / 3 + 1 + 4 / 45
TOTAL = np.array([4 / 3 + 1, 1 / 3 + 1, 4 / 45, 0.0]) / VARIANCE
"""Total Sobol indices of z0 to z3."""


def of(values, y, seed=0):
    """Shares of one response."""
    scaled = standardised(values)
    found = shares(scaled, y[:, None], surface_for(scaled), 0.95, seed)
    return [part[0] for part in found]


def adjusted(columns, y):
    """Adjusted R^2 by NumPy's least squares."""
    A = np.column_stack([np.ones(len(y)), *columns])
    left = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    return 1 - (left @ left) / (len(y) - A.shape[1]) / np.var(y, ddof=1)


@pytest.fixture
def few_resamples(monkeypatch):
    """Make the intervals worthless and fast, for tests of many shares."""
    monkeypatch.setattr(responses, "RESAMPLES", 2)


@pytest.mark.usefixtures("few_resamples")
def test_total_sobol_indices_in_closed_form():
    """The fit is exact, so that only the sample variances differ from the integrals."""
    found = np.array([of(z, response(z))[0] for z in (uniform(2000, 4, seed) for seed in range(20))])
    assert within_stat(found[:, :3], TOTAL[:3])
    np.testing.assert_allclose(found[:, 3:], 0.0, atol=1e-9)  # no residual but the ridge of 1e-10


@pytest.mark.usefixtures("few_resamples")
def test_noise_takes_its_share_and_a_quantity_without_effect_has_none_on_average():
    """With the variance s^2 of a noise the shares are those above times VARIANCE / (VARIANCE + s^2)."""
    found = []
    for seed in range(200):
        z = uniform(80, 4, seed)
        found.append(of(z, response(z) + 1.5 * np.random.default_rng(1000 + seed).standard_normal(80))[0])
    signal = VARIANCE / (VARIANCE + 1.5**2)
    # Ratios of variances have a bias of the order 1/n.
    bias = 1 / 80
    gap = np.abs(np.mean(found, axis=0) - np.append(TOTAL * signal, 1 - signal))
    assert (gap <= bias + STAT * np.std(found, axis=0, ddof=1) / np.sqrt(200)).all()
    assert within_stat(np.array(found)[:, 3], 0.0)


def test_brute_force_least_squares():
    """Each share is the adjusted R^2 of all terms minus that of the terms without the quantity."""
    z = uniform(90, 3)
    y = response(z) + np.random.default_rng(5).standard_normal(90)
    monomials = {(i,): z[:, i] for i in range(3)} | {(i, j): z[:, i] * z[:, j] for i in range(3) for j in range(i + 1)}
    whole = adjusted(monomials.values(), y)
    without = [adjusted([column for term, column in monomials.items() if i not in term], y) for i in range(3)]
    expected = [*(whole - each for each in without), 1 - whole]
    np.testing.assert_allclose(of(z, y)[0], expected, atol=1e-8)  # the ridge


def test_scale_and_order_of_quantities_and_size_of_the_response_do_not_matter():
    """Shares depend on the functions that the terms span."""
    z = uniform(100, 3)
    y = response(z) + np.random.default_rng(5).standard_normal(100)
    expected = of(z, y)[0]
    np.testing.assert_allclose(of(5 + 0.01 * z, 1e6 * y - 7)[0], expected, atol=1e-7)  # the ridge
    np.testing.assert_allclose(of(z[:, ::-1], y)[0][[2, 1, 0, 3]], expected, atol=1e-7)


@pytest.mark.usefixtures("few_resamples")
def test_permuted_responses_have_no_share():
    """The level of chance is 0: the mean over permutations of the runs, whatever the number of terms."""
    z, rng = uniform(60, 3), np.random.default_rng(3)
    y = response(z)
    found = np.array([of(z, rng.permutation(y))[0] for _ in range(300)])
    assert within_stat(found[:, :3], 0.0)
    assert within_stat(found[:, 3], 1.0)


def test_fewer_terms_for_few_runs():
    """One term for five runs: 3 linear, 3 squares, 3 interactions; a quantity with two values has no square."""
    z = standardised(uniform(60, 3))
    assert [surface_for(z[:n]).form for n in (45, 44, 30, 29, 15)] == [
        "quadratic",
        *["without interactions"] * 2,
        *["linear"] * 2,
    ]
    assert surface_for(z[:14]) is None
    z[:, 0] = np.where(z[:, 0] > 0, 1.0, -1.0)
    assert (0, 0) not in surface_for(z).terms
    assert (0, 1) in surface_for(z).terms


def test_the_interval_of_many_runs_is_that_of_the_resamples(monkeypatch):
    """Beyond WORK the interval is normal; for a size that allows both they agree to a tenth of the width."""
    z = uniform(1500, 3)
    y = response(z) + np.random.default_rng(5).standard_normal(1500)
    resampled = of(z, y)
    monkeypatch.setattr(responses, "WORK", 0)
    normal = of(z, y)
    np.testing.assert_array_equal(normal[0], resampled[0])
    width = resampled[2] - resampled[1]
    assert (np.abs(np.array(normal) - resampled) <= 0.1 * width + 0.002).all()


def test_equal_seeds_give_equal_intervals_and_a_collinear_quantity_no_error():
    """A copy of a quantity explains nothing that the quantity does not."""
    z = uniform(100, 2)
    twice = np.column_stack([z, z[:, 0]])
    y = z[:, 0] + 0.1 * np.random.default_rng(5).standard_normal(100)
    found = of(twice, y, seed=4)
    for part, again in zip(found, of(twice, y, seed=4), strict=True):
        np.testing.assert_array_equal(part, again)
    np.testing.assert_allclose(found[0][[0, 2]], 0.0, atol=0.01)  # less than the noise explains by chance


@pytest.mark.slow
@pytest.mark.parametrize(("n", "noise"), [(60, 0.3), (200, 0.3), (200, 2.0)])
def test_intervals_cover(n, noise):
    """Intervals at 95 % contain the share of the law from 90 to 99.5 % of the time, for 400 samples."""
    expected = np.append(TOTAL[:3] * VARIANCE, noise**2) / (VARIANCE + noise**2)
    hits = []
    for seed in range(400):
        z = uniform(n, 3, seed)
        y = response(z) + noise * np.random.default_rng(10_000 + seed).standard_normal(n)
        _, low, high = of(z, y, seed)
        hits.append((low <= expected) & (expected <= high))
    share = np.mean(hits, axis=0)
    print(n, noise, share)
    assert (share >= 0.90).all()


def test_the_interval_of_the_rest_covers():
    """Nine terms and 60 runs: the fit makes the residuals smaller, and the interval still contains the rest."""
    hits = []
    for seed in range(100):
        z = uniform(60, 3, seed)
        y = z[:, 0] + z[:, 1] + 0.8 * np.random.default_rng(10_000 + seed).standard_normal(60)
        _, low, high = (part[-1] for part in of(z, y, seed))
        hits.append(low <= 0.64 / (2 / 3 + 0.64) <= high)
    assert np.mean(hits) >= 0.92


def test_resamples_by_groups_are_those_of_one_draw():
    """To the bit, and with little memory beside the counts."""
    n = 3000
    tracemalloc.start()
    counts = responses._resampled(n, 7)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    drawn = np.random.Generator(np.random.PCG64(7)).integers(0, n, (responses.RESAMPLES, n))
    for row, runs in zip(counts, drawn, strict=True):
        np.testing.assert_array_equal(row, np.bincount(runs, minlength=n))
    assert counts.nbytes == 8 * n * responses.RESAMPLES and peak < 1.5 * counts.nbytes


def test_blocks_of_runs_give_the_same_shares(monkeypatch):
    """Sums over the runs by blocks, the last one shorter, beside those over all runs at once."""
    monkeypatch.setattr(responses, "WORK", 0)
    z = uniform(1000, 4)
    whole = of(z, response(z))
    monkeypatch.setattr(responses, "ROWS", 300)
    for one, other in zip(of(z, response(z)), whole, strict=True):
        assert one == pytest.approx(other, abs=1e-9)
