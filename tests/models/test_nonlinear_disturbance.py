"""Nonlinear models with disturbances, also linearised along the trajectory: the tanks with an offset of the pump."""

import numpy as np
import pytest
from models.test_nonlinear import NOISE, STEPS, TS, two_tanks

from rmpc_bench.components.single_estimator import advanced
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.disturbance import Disturbance, DisturbanceGains
from rmpc_bench.models.disturbed import with_disturbance
from rmpc_bench.models.linearised import design as linearise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.models.operating_point import At
from rmpc_bench.types import DesignError

X0 = np.array([0.2, 0.1])
AT = At(u=[8.0], guess=[0.2, 0.1])


def disturbed(model, at="input", x0=X0):
    return with_disturbance(model, Disturbance(at=at, drift=0.01), STEPS, x0)


def test_functions_of_a_nonlinear_model(rng):
    """Oracle: the model of x at the input u + d, and differences for the Jacobians."""
    model = nonlinear(TS, two_tanks(), noise=NOISE)
    both = disturbed(model)
    x, d, u = np.array([0.2, 0.15]), np.array([1.5]), np.array([8.0])
    z = np.concatenate([x, d])
    np.testing.assert_allclose(both.f(z, u), np.concatenate([model.f(x, u + d), d]), rtol=1e-14)
    np.testing.assert_allclose(both.f(np.array([z, z]), u)[1], both.f(z, u), rtol=1e-14)
    np.testing.assert_allclose(both.h(z), model.h(x), rtol=1e-14)
    F = both.F(z, u)
    np.testing.assert_allclose(F[:2, :2], model.F(x, u + d), rtol=1e-6, atol=1e-9)
    step = 1e-4
    slope = (model.f(x, u + d + step) - model.f(x, u + d - step)) / (2 * step)
    np.testing.assert_allclose(F[:2, 2], slope, rtol=1e-5)
    np.testing.assert_allclose(F[2], [0.0, 0.0, 1.0], atol=1e-12)
    assert both.limits[1].shape == (3,) and np.isinf(both.limits[1][2])
    x_next, P_next = advanced(both, 0, z, np.eye(3), u)
    np.testing.assert_allclose(x_next, both.f(z, u), rtol=1e-12)
    np.testing.assert_allclose(P_next, F @ F.T + both.Q_w, rtol=1e-6)


def test_a_linearisation_along_the_trajectory(rng):
    """Oracle: the linearisation of x at the input u + d."""
    model = linearise(TS, two_tanks(), at="trajectory", noise=NOISE)
    both = disturbed(model)
    x, d, u = np.array([[0.2, 0.15], [0.3, 0.1]]), np.array([[1.5], [-0.5]]), np.full((2, 1), 8.0)
    z = np.hstack([x, d])
    now, plain = both.around(0, z, u), model.around(0, x, u + d)
    np.testing.assert_array_equal(now.A[:, :2, :2], plain.A)
    np.testing.assert_array_equal(now.A[:, :2, 2:], plain.B)
    np.testing.assert_array_equal(now.C[:, :, :2], plain.C)
    np.testing.assert_array_equal(both.measure(z), model.measure(x))
    moved = both.advance(0, z, u)
    np.testing.assert_array_equal(moved, np.hstack([model.advance(0, x, u + d), d]))
    # The tangent touches the model at the point where it is taken.
    tangent = np.einsum("rij,rj->ri", now.A, z) + np.einsum("rij,rj->ri", now.B, u) + now.f
    np.testing.assert_allclose(tangent, moved, atol=2e-3)


def test_the_extended_filter_finds_the_offset_of_the_pump():
    """Oracle: the true offset, which the filter without disturbance puts into the levels."""
    model = linearise(TS, two_tanks(), at="trajectory", noise=NOISE)
    both = disturbed(model)
    given = both.start(X0, 1e-4 * np.eye(2), np.zeros((2, 2)))
    filter_ = kalman(both, 150, x0=given["x0"], P0=given["P0"])
    state, x, u, d = filter_.init(1), X0[None], np.full((1, 1), 8.0), 1.5
    for k in range(150):
        state, estimate = filter_.correct(k, state, model.measure(x))
        state, x = filter_.predict(k, state, u), model.advance(k, x, u + d)
    np.testing.assert_allclose(estimate.x_hat[0, 2], d, rtol=0.02)


def test_an_operating_point_has_no_disturbance():
    """Oracle: the model of deviations, augmented."""
    model = linearise(TS, two_tanks(), at=AT, noise=NOISE)
    both = disturbed(model)
    np.testing.assert_array_equal(both.x_op, np.append(model.x_op, 0.0))
    np.testing.assert_array_equal(both.y_op, model.y_op)
    np.testing.assert_array_equal(both.deviation.A, both.A)
    np.testing.assert_array_equal(both.deviation.f0, np.append(model.drift, 0.0))
    assert ("disturbance", "at input, drift 0.01, detectable: rank 3 of 3") in both.facts()
    of_functions = disturbed(nonlinear(TS, two_tanks(), noise=NOISE, at=AT))
    np.testing.assert_allclose(of_functions.at(0).A, both.A, rtol=1e-12)
    np.testing.assert_allclose(of_functions.deviation.A, both.A, rtol=1e-12)


@pytest.mark.parametrize("kind", ["trajectory", "nonlinear"])
def test_ranks_are_those_at_the_initial_estimate(kind):
    """Two disturbances and one output: refused at the place of the key."""
    plant = two_tanks()
    model = (
        linearise(TS, plant, at="trajectory", noise=NOISE)
        if kind == "trajectory"
        else nonlinear(TS, plant, noise=NOISE)
    )
    ny = model.ny
    at = ["input", DisturbanceGains(B_d=[[1.0], [0.0]]), DisturbanceGains(B_d=[[0.0], [1.0]])][: ny + 1]
    with pytest.raises(DesignError, match=f"{ny + 1} disturbances, but {ny} output") as error:
        disturbed(model, at)
    assert error.value.parameter == "at"
