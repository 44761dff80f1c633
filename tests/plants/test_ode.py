"""Plants given by a differential equation: against closed forms, alone and in blocks."""

import numpy as np
import pytest
from plants import tanks
from scipy.linalg import expm

from rmpc_bench.plants.ode import design
from rmpc_bench.plants.ode_stepping import Solver

A, B = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.0], [1.0]])
TS = 0.1


def oscillator(x, u, p):
    """A linear oscillator, by products of matrices."""
    return A @ x + p.k * (B @ u)


def linear(**keys):
    """Return the oscillator as a plant."""
    return design(TS, 20, ode=oscillator, states=["a", "b"], inputs=["f"], parameters={"k": 1.0}, **keys)


def drawn(plant, n_runs, **values):
    """Record of a plant with nominal parameters, or with given ones."""
    every = {name: np.full(n_runs, value) for name, value in plant.nominal.items()}
    return plant.draw({**every, **values}, [np.random.default_rng(i) for i in range(n_runs)], 20)


def test_a_linear_equation_has_its_exponential(rng):
    """Oracle: the matrix exponential; the error of Runge-Kutta falls with the fourth power of the step."""
    x, u = rng.standard_normal((9, 2)), rng.standard_normal((9, 1))
    M = expm(np.block([[A, B], [np.zeros((1, 3))]]) * TS)
    exact = x @ M[:2, :2].T + u @ M[:2, 2:].T
    errors = []
    for substeps in (1, 2, 4):
        plant = linear(solver=Solver(substeps=substeps))
        found = plant.step(0, drawn(plant, 9), x, u, np.zeros((9, 2))).x
        errors.append(np.abs(found - exact).max())
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    # Of the leading term; the next one is smaller by the step, 0.1.
    assert (np.abs(order - 4.0) < 0.1).all()


@pytest.mark.parametrize("n_runs", [1, 2, 7, 8, 13, 50])
def test_a_product_of_matrices_has_the_same_bits_in_any_block(rng, n_runs):
    """Oracle: the block of 50; BLAS adds up a single column in another order than several."""
    plant = linear(solver=Solver(substeps=5))
    x, u, w = rng.standard_normal((50, 2)), rng.standard_normal((50, 1)), rng.standard_normal((50, 2))
    whole = plant.step(3, drawn(plant, 50), x, u, w).x
    part = slice(50 - n_runs, 50)
    found = plant.step(3, drawn(plant, n_runs), x[part], u[part], w[part]).x
    np.testing.assert_array_equal(found, whole[part])


def test_the_steady_state_of_two_tanks_stays():
    """Oracle: the closed form of the levels."""
    plant = design(1.0, 20, ode=tanks.rhs, output=tanks.output, states=tanks.STATES, inputs=tanks.INPUTS,
                   outputs=tanks.OUTPUTS, parameters=tanks.PARAMETERS,
                   x0=tanks.steady_state(8.0, tanks.PARAMETERS))  # fmt: skip
    x = np.array([tanks.steady_state(8.0, tanks.PARAMETERS)])
    found = plant.step(0, drawn(plant, 1), x, np.full((1, 1), 8.0), np.zeros((1, 2))).x
    np.testing.assert_allclose(found, x, rtol=1e-12)
    np.testing.assert_array_equal(plant.output(0, drawn(plant, 1), x, np.zeros((1, 1))), x[:, 1:])
