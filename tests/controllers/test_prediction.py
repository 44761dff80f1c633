"""The condensed prediction against the model simulated sample by sample."""

import numpy as np
import pytest
from conftest import random_model
from controllers.predictions import predict_inputs, predict_moves


@pytest.mark.parametrize(("Hp", "Hu"), [(1, 1), (5, 2), (4, 4)])
@pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (3, 2, 1), (4, 1, 2), (2, 2, 2)])
def test_predictions_are_those_of_the_simulated_model(nx, nu, ny, Hp, Hu, rng):
    """Oracle: the model run for Hp samples from x with the moves added to u(k-1), held after the last one."""
    m = random_model(rng, nx, nu, ny)
    x0, u0, moves = rng.standard_normal(nx), rng.standard_normal(nu), rng.standard_normal((Hu, nu))
    Psi, Upsilon, Theta = predict_moves(m, Hp, Hu)
    assert (Psi.shape, Upsilon.shape, Theta.shape) == ((Hp * ny, nx), (Hp * ny, nu), (Hp * ny, Hu * nu))
    x, u, outputs = x0, u0, []
    for j in range(Hp):
        u = u + (moves[j] if j < Hu else 0.0)
        x = m.A @ x + m.B @ u
        outputs.append(m.C @ x)
    predicted = Psi @ x0 + Upsilon @ u0 + Theta @ moves.ravel()
    np.testing.assert_allclose(predicted, np.concatenate(outputs), atol=1e-11)


@pytest.mark.parametrize(("Hp", "Hu"), [(1, 1), (5, 2), (4, 4)])
@pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (3, 2, 1), (4, 1, 2), (2, 2, 2)])
def test_predictions_from_inputs_are_those_of_the_simulated_model(nx, nu, ny, Hp, Hu, rng):
    """Oracle: the model run for Hp samples from x under the inputs, the last of which is held."""
    m = random_model(rng, nx, nu, ny)
    x0, inputs = rng.standard_normal(nx), rng.standard_normal((Hu, nu))
    Psi, Theta = predict_inputs(m, Hp, Hu)
    assert (Psi.shape, Theta.shape) == ((Hp * ny, nx), (Hp * ny, Hu * nu))
    x, outputs = x0, []
    for j in range(Hp):
        x = m.A @ x + m.B @ inputs[min(j, Hu - 1)]
        outputs.append(m.C @ x)
    np.testing.assert_allclose(Psi @ x0 + Theta @ inputs.ravel(), np.concatenate(outputs), atol=1e-11)


def test_the_matrix_of_inputs_is_the_printed_one_but_for_its_last_column(rng):
    """Oracle: (4): CB on the diagonal, CAB below it, zeros above; the last column sums the printed entries."""
    m, Hp, Hu = random_model(rng, 3, 1, 1), 5, 3
    Theta = predict_inputs(m, Hp, Hu)[1]
    entry = [float((m.C @ np.linalg.matrix_power(m.A, i) @ m.B).item()) for i in range(Hp)]
    printed = np.array([[entry[i - j] if i >= j else 0.0 for j in range(Hu)] for i in range(Hp)])
    np.testing.assert_allclose(Theta[:, :-1], printed[:, :-1], atol=1e-12)
    np.testing.assert_allclose(Theta[:, -1], np.cumsum(printed[:, -1]), atol=1e-12)
