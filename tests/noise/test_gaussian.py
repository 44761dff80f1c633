"""Noise and reference laws."""

import numpy as np
import pytest
from conftest import random_psd, within_stat

from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.simulation.reference import constant
from rmpc_bench.types import DesignError


@pytest.mark.parametrize("rank", [1, 3])
def test_gaussian_noise_has_its_mean_and_covariance(rank, rng):
    """Oracle: Monte Carlo, 40,000 samples, STAT on every entry; a singular covariance too."""
    cov = random_psd(rng, 3, 10.0, rank)
    samples = gaussian(3, mean=[1.0, -2.0, 0.5], cov=cov.tolist(), scale=2.0).draw(rng, 40_000)
    centred = samples - [1.0, -2.0, 0.5]
    assert within_stat(samples, [1.0, -2.0, 0.5])
    assert within_stat(centred[:, :, None] * centred[:, None, :], 4.0 * cov)  # `scale` multiplies the deviation


def test_gaussian_noise_is_white(rng):
    """Oracle: products of neighbouring samples average to 0 within STAT."""
    samples = gaussian(2, std=[1.0, 3.0]).draw(rng, 40_000)
    assert within_stat((samples[1:, :, None] * samples[:-1, None, :])[::2], 0.0)


@pytest.mark.parametrize("same", [{"std": 0.5}, {"std": [0.5, 0.5]}, {"cov": 0.25}, {"cov": [0.25, 0.25]}])
def test_short_forms_mean_the_same(same):
    """Oracle: product.md section 4, Numbers."""
    plain = np.random.default_rng(1).standard_normal((10, 2))
    np.testing.assert_allclose(gaussian(2, **same).draw(np.random.default_rng(1), 10), 0.5 * plain, atol=1e-15)


def test_noise_of_strength_zero_is_the_mean(rng):
    """Oracle: the definition."""
    for law in (
        gaussian(2, std=0.0, mean=3.0),
        gaussian(2, cov=0.0, mean=3.0),
        gaussian(2, std=1.0, scale=0.0, mean=3.0),
    ):
        np.testing.assert_array_equal(law.draw(rng, 4), np.full((4, 2), 3.0))


def test_a_longer_draw_begins_with_the_shorter_one():
    """Oracle: the protocol's promise."""
    law = gaussian(3, std=1.0)
    short, long = law.draw(np.random.default_rng(5), 7), law.draw(np.random.default_rng(5), 70)
    np.testing.assert_array_equal(short, long[:7])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "give one of std, cov and density"),
        ({"std": 1.0, "cov": 1.0}, "give one of std, cov and density"),
        ({"std": [1.0, 2.0, 3.0]}, "shape"),
        ({"cov": [[1.0, 2.0], [2.0, 1.0]]}, "semidefinite"),
        ({"std": 1.0, "mean": [1.0, 2.0, 3.0]}, "shape"),
    ],
)
def test_bad_parameters_are_design_errors(given, message):
    """Oracle: the docstring."""
    with pytest.raises(DesignError, match=message):
        gaussian(2, **given)


def test_a_constant_reference_is_constant():
    """Oracle: the definition."""
    np.testing.assert_array_equal(constant(2, value=3.0).sample(4), np.full((4, 2), 3.0))
    np.testing.assert_array_equal(constant(2, value=[1.0, 2.0]).sample(3), [[1.0, 2.0]] * 3)
    with pytest.raises(DesignError, match="shape") as caught:
        constant(2, value=[1.0, 2.0, 3.0])
    assert caught.value.parameter == "value"
