"""Missing measurements: an output that is always missing is one that the plant does not have."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import random_model, random_psd

from rmpc_bench.estimators import kalman, kalman_disturbance, oracle, robust_kalman, set_membership
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.plants import uncertain_linear as plants
from rmpc_bench.plants.uncertain_linear import Uncertainty

STEPS = 8
OTHER = {"rtol": 1e-9, "atol": 1e-12}
"""A matrix of two outputs is inverted in another order than a number."""


def estimates(design, y, *delta):
    """Estimates of all runs, (runs, samples, nx), and the covariances that are reported, (runs, samples, nx, nx)."""
    state, x_hat, P = design.init(len(y), *delta), [], []
    for k in range(y.shape[1]):
        state, estimate = design.correct(k, state, y[:, k])
        assert not np.any(estimate.status)
        x_hat.append(estimate.x_hat)
        matrix = estimate.M if estimate.P is None else estimate.P
        P.append(np.broadcast_to(matrix, (len(y), *matrix.shape[-2:])))
        state = design.predict(k, state, np.zeros((len(y), 1)))
    return np.stack(x_hat, axis=1), np.stack(P, axis=1)


def without(model, output):
    """Return a linear model without one of its outputs."""
    C, R_v = np.delete(model.C, output, axis=0), np.delete(np.delete(model.R_v, output, axis=0), output, axis=1)
    return LinearModel(model.A, model.B, C, model.Q_w, R_v)


@pytest.mark.parametrize("design", [kalman.design, kalman_disturbance.design])
def test_kalman_filters(design, rng):
    """Oracle: the filter of the model without that output."""
    model, start = random_model(rng, 3, 1, 2), {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3)}
    y = rng.standard_normal((4, STEPS + 1, 2))
    for output in (0, 1):
        broken = y.copy()
        broken[1:, :, output] = np.nan
        found = estimates(design(model, STEPS, **start), broken)
        expected = estimates(design(without(model, output), STEPS, **start), np.delete(y, output, axis=2))
        whole = estimates(design(model, STEPS, **start), y)
        for one, other, all_ in zip(found, expected, whole, strict=True):
            np.testing.assert_allclose(one[1:], other[1:], **OTHER)
            np.testing.assert_array_equal(one[0], all_[0])


@pytest.mark.parametrize("form", ["filter", "predictor"])
def test_the_oracle(form, rng):
    """Oracle: the oracle of the plant without that output, with correlated noises and the same F in every run."""
    models, given = _uncertain(rng)
    plant = plants.design(0.1, STEPS, **given, uncertainty=Uncertainty())
    fewer = {name: M[1:] if name in ("C", "Dv", "H_C") else M for name, M in given.items()}
    other = plants.design(0.1, STEPS, **fewer, uncertainty=Uncertainty())
    start = {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3), "form": form}
    nominal = {name: np.full(3, value) for name, value in plant.nominal.items()}
    delta = plant.draw(nominal, [np.random.default_rng(i) for i in range(3)], STEPS)
    y = rng.standard_normal((3, STEPS + 1, 2))
    broken = y.copy()
    broken[1:, :, 0] = np.nan
    both = zip(models, (plant, other), strict=True)
    made = [oracle.design(model, STEPS, each, **start) for model, each in both]
    found, expected = estimates(made[0], broken, delta), estimates(made[1], y[:, :, 1:], delta)
    for one, two, whole in zip(found, expected, estimates(made[0], y, delta), strict=True):
        np.testing.assert_allclose(one[1:], two[1:], **OTHER)
        np.testing.assert_array_equal(one[0], whole[0])


def _uncertain(rng):
    """Return the models with and without the first output, and the matrices of the plant."""
    shapes = {"A": (3, 3), "B": (3, 1), "Bw": (3, 2), "C": (2, 3), "Dv": (2, 2)}
    shapes |= {"H_A": (3, 1), "G_x": (1, 3), "H_C": (2, 1)}
    given = {name: 0.4 * rng.standard_normal(shape) for name, shape in shapes.items()}
    noises = {"W": random_psd(rng, 2).tolist(), "V": random_psd(rng, 2).tolist(), "wbar": [0.3, -0.2]}
    fewer = {name: M[1:] if name in ("C", "Dv", "H_C") else M for name, M in given.items()}
    return (uncertain_model(STEPS, **given, **noises), uncertain_model(STEPS, **fewer, **noises)), given


def test_a_filter_without_a_recursion_does_not_bridge(rng):
    """A gain schedule alone says nothing about the gains after a gap."""
    schedule = robust_kalman.design(random_model(rng, 2, 1, 1), STEPS, x0=np.zeros(2), P0=np.eye(2), c=0.1)
    alone = replace(schedule, recursion=None)
    assert schedule.bridges_missing and not alone.bridges_missing
    y = np.array([[[1.0], [np.nan], [1.0]]])
    state = alone.init(1)
    for k in range(3):
        state, estimate = alone.correct(k, state, y[:, k])
        state = alone.predict(k, state, np.zeros((1, 1)))
    assert np.isnan(estimate.x_hat).all()


def test_an_intersection_of_sets_is_left_out(rng):
    """Oracle: the predicted set without a correction; the state stays inside through gaps of all lengths."""
    A, C = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0]])
    keys = {"A": A.tolist(), "B": [[0.0], [0.0]], "C": C.tolist(), "M_w": 0.1, "M_v": 0.2}
    model = mixed_model(60, **keys)
    start = {"x0": np.zeros(2), "P0": np.zeros((2, 2)), "M0": np.eye(2)}
    design = set_membership.design(model, 60, **start, update="maksarov-norton", inflate=False)
    assert design.bridges_missing
    n_runs = 20
    x, state = 0.7 * rng.uniform(-1.0, 1.0, (n_runs, 2)), design.init(n_runs)
    for k in range(60):
        y = np.einsum("ij,rj->ri", C, x) + np.sqrt(0.2) * rng.uniform(-1.0, 1.0, (n_runs, 1))
        lost = rng.random(n_runs) < 0.5
        y[lost] = np.nan
        before = state
        state, estimate = design.correct(k, state, y)
        assert not np.any(estimate.status)
        for now, then in zip(state, before, strict=True):
            np.testing.assert_array_equal(now[lost], then[lost])
        e = x - estimate.x_hat
        assert (np.einsum("ri,rij,rj->r", e, np.linalg.inv(estimate.M), e) <= 1.0 + 1e-9).all()  # inverse of M
        state = design.predict(k, state, np.zeros((n_runs, 1)))
        w = rng.standard_normal((n_runs, 2))
        w *= np.sqrt(0.1) * np.sqrt(rng.random((n_runs, 1))) / np.linalg.norm(w, axis=1, keepdims=True)
        x = np.einsum("ij,rj->ri", A, x) + w
