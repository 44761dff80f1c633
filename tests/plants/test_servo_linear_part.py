"""The linear part of the servomechanism against the simulated plant without dry friction."""

import numpy as np
import pytest

from rmpc_bench.models.servo import TABLE_1
from rmpc_bench.plants.servo import design, design_linear

FRICTIONLESS = dict.fromkeys(("alpha_l0", "alpha_l1", "alpha_m0", "alpha_m1"), 0.0)


def moved(plant, parameters, x, u):
    """One sample of the simulated plant."""
    delta = plant.draw({name: np.array([value]) for name, value in parameters.items()}, [], 1)
    return plant.step(0, delta, x[None], np.array([[u]]), np.zeros((1, 4))).x[0]


@pytest.mark.parametrize(("make", "nx"), [(design, 5), (design_linear, 4)])
def test_a_sample_without_friction(make, nx, rng):
    """Same state after a sample, same output, and the model's four states in front."""
    plant = make(0.1)
    changed = {name: value * rng.uniform(0.8, 1.2) for name, value in TABLE_1.items()}
    parameters = {**plant.nominal, **changed} | (FRICTIONLESS if nx == 5 else {})
    truth = plant.linear(parameters)
    x, u = rng.standard_normal(nx), 30.0
    # 1e-9: the plant may integrate in steps, with a tolerance of its own
    np.testing.assert_allclose(truth.A @ x + truth.B[:, 0] * u, moved(plant, parameters, x, u), rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(truth.C @ x, x[:1])
    np.testing.assert_array_equal(truth.E @ x, x[:4])


@pytest.mark.parametrize(("name", "value"), [("J_l", 0.0), ("R", -1.0), ("beta_m", -0.1), ("K_t", np.nan), ("L", 0.0)])
def test_parameters_without_meaning(name, value):
    """There is no linear part where the run would be out of range."""
    plant = design(0.1)
    assert plant.linear({**plant.nominal, name: value}) is None
