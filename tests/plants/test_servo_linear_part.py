"""The linear part of the servomechanism against the simulated plant without dry friction."""

import numpy as np
import pytest

from rmpc_bench.models.servo import TABLE_1, continuous
from rmpc_bench.numerics.linalg import discretise
from rmpc_bench.plants.servo import design, design_linear, linear_between
from rmpc_bench.types import Status

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


def test_the_linear_plants_of_a_block(rng):
    """Oracle: run by run, bit for bit; a run that is not admissible has the nominal matrices."""
    plant, n = design_linear(0.1), 40
    parameters = {name: value * rng.uniform(0.2, 3.0, n) for name, value in plant.nominal.items()}
    parameters["beta_l"][3] = parameters["beta_m"][3] = parameters["k_theta"][4] = parameters["K_t"][5] = 0.0
    parameters["J_m"][6], parameters["R"][7], parameters["beta_l"][8] = -1.0, np.nan, -0.1
    delta = plant.draw(parameters, [], 1)
    assert np.flatnonzero(delta.status == Status.OUT_OF_RANGE).tolist() == [6, 7, 8] and delta.status.dtype == np.int8
    x, u = rng.standard_normal((n, 3, 4)), rng.standard_normal((n, 3, 1))
    between = plant.between(delta, x, u, 5)
    for i in range(n):
        p = plant.nominal if delta.status[i] else {name: float(values[i]) for name, values in parameters.items()}
        E, G = discretise(*continuous(p), 0.1)
        np.testing.assert_array_equal(delta.E[i], E)
        np.testing.assert_array_equal(delta.G[i], G)
        part = (matrix[None] for matrix in discretise(*continuous(p), 0.1 / 5))
        np.testing.assert_array_equal(between[i], linear_between(*part, x[i][None], u[i][None], 5)[0])
        assert {name: values[i] for name, values in delta.parameters.items()} == dict(p)


@pytest.mark.parametrize("extreme", [{"K_t": 1e200}, {"J_m": 1e-320}, {"R": 1e-200, "J_m": 1e-200}])
def test_parameters_that_overflow_concern_their_run_only(extreme):
    """Without a warning; the run has matrices that are not finite, and diverges."""
    plant = design_linear(0.1)
    parameters = {name: np.full(3, value) for name, value in plant.nominal.items()}
    for name, value in extreme.items():
        parameters[name][1] = value
    delta, usual = plant.draw(parameters, [], 1), plant.draw({n: values[:1] for n, values in parameters.items()}, [], 1)
    assert not np.isfinite(delta.E[1]).all()
    np.testing.assert_array_equal(delta.E[[0, 2]], usual.E[[0, 0]])
