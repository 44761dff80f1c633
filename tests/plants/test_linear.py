"""The linear plant against the recursion written out."""

import numpy as np
import pytest
from conftest import random_psd

from rmpc_bench.plants.linear import design
from rmpc_bench.types import DesignError


@pytest.mark.parametrize("varies", [False, True])
def test_it_is_the_recursion(varies, rng):
    """Oracle: x+ = A_k x + B u + w and y = C x + v with @, run by run."""
    n_steps, runs = 6, 4
    A, B, C = rng.standard_normal((n_steps + 1, 3, 3)), rng.standard_normal((3, 2)), rng.standard_normal((2, 3))
    A = A if varies else A[:1]
    plant = design(0.1, n_steps, A=A, B=B, C=C)
    assert (plant.nx, plant.nu, plant.ny, plant.nw, plant.nv) == (3, 2, 2, 3, 2) and plant.Ts == 0.1
    assert plant.mixes_noise and not plant.remarks and not plant.nominal
    x, u = rng.standard_normal((runs, 3)), rng.standard_normal((runs, n_steps, 2))
    w, v = rng.standard_normal((runs, n_steps + 1, 3)), rng.standard_normal((runs, n_steps + 1, 2))
    delta = plant.draw({}, [np.random.default_rng(i) for i in range(runs)], n_steps)
    mixed = plant.mix(delta, w, v)
    np.testing.assert_array_equal(mixed[0], w)
    np.testing.assert_array_equal(mixed[1], v)
    twin = x.copy()
    for k in range(n_steps):
        np.testing.assert_allclose(plant.output(k, delta, x, v[:, k]), twin @ C.T + v[:, k], atol=1e-12)
        x = plant.step(k, delta, x, u[:, k], w[:, k]).x
        twin = twin @ A[k if varies else 0].T + u[:, k] @ B.T + w[:, k]
        np.testing.assert_allclose(x, twin, atol=1e-10)


def test_a_block_costs_no_random_numbers():
    """Oracle: the generator, which another plant would have moved."""
    rng = np.random.default_rng(1)
    design(0.1, 5, A=0.9, C=1.0).draw({}, [rng], 5)
    assert rng.random() == np.random.default_rng(1).random()


def test_moments_are_exact():
    """Oracle: the period of a linear system, [x+; y] = [A I 0; C 0 I] [x; w; v] + [B u; 0]."""
    A, C = random_psd(np.random.default_rng(2), 2), np.array([[1.0, 2.0]])
    period = design(0.1, 5, A=A, B=[[1.0], [0.0]], C=C).period(3)
    np.testing.assert_array_equal(period.M, np.block([[A, np.eye(2), np.zeros((2, 1))], [C, np.zeros((1, 2)), 1.0]]))
    assert all(channel.variance == 0.0 and not channel.mean.any() for channel in period.channels)


def test_numbers_are_enough_and_sizes_must_fit():
    """Oracle: one state; the parameter to blame."""
    plant = design(0.1, 5, A=0.9, C=1.0)
    assert (plant.nx, plant.nu, plant.ny) == (1, 1, 1)
    with pytest.raises(DesignError, match="fits the other matrices") as caught:
        design(0.1, 5, A=[[0.9, 0.0], [0.0, 0.9]], C=[[1.0, 0.0, 0.0]])
    assert caught.value.parameter == "C"
