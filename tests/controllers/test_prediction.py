"""The condensed prediction against the model simulated sample by sample."""

import numpy as np
import pytest
from conftest import random_model

from rmpc_bench.controllers.prediction import predict_moves


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
