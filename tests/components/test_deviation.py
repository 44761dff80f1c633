"""Components for one run in deviations from an operating point: the same numbers as the built-in ones around it."""

import numpy as np
import pytest
from components.one_run import Textbook
from conftest import random_model

from rmpc_bench.components.single_run import design_function, single_run
from rmpc_bench.controllers.state_feedback import lqr
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.linearised import LinearisedModel
from rmpc_bench.types import Estimate, OperatingPoint, PlantInfo
from rmpc_bench.types.plant import SignalLimits

STEPS = 10
SHIFTED = {"rtol": 0.0, "atol": 1e-11}
"""Rounding of numbers of about 5, the size of the operating point."""


@pytest.fixture(scope="module")
def model():
    """Return a model around an operating point of size 5."""
    rng = np.random.default_rng(8)
    m = random_model(rng, 3, 2, 2, 0.9)
    point = OperatingPoint(*(5.0 * rng.standard_normal(n) for n in (3, 2, 2)))
    return LinearisedModel(m.A, m.B, m.C, m.Q_w, m.R_v, point=point)


@single_run
class Around(Textbook):
    """The textbook filter, which knows no constant parts."""

    deviation = True


def test_a_filter_without_constant_parts(model, rng):
    """Oracle: `kalman` with the offsets; the same class without `deviation` is wrong."""
    start = {"x0": model.x_op + 0.1, "P0": np.eye(3)}
    make = design_function("estimators", Around)
    own = make(model, Ts=0.1, n_steps=STEPS, **start)
    expected = kalman(model, STEPS, **start)
    states = [own.init(4), expected.init(4)]
    for k in range(STEPS):
        y, u = model.y_op + rng.standard_normal((4, 2)), model.u_op + rng.standard_normal((4, 2))
        found = []
        for i, each in enumerate((own, expected)):
            states[i], estimate = each.correct(k, states[i], y)
            states[i] = each.predict(k, states[i], u)
            found.append(estimate)
        np.testing.assert_allclose(found[0].x_hat, found[1].x_hat, **SHIFTED)
        np.testing.assert_allclose(found[0].P[0], found[1].P, **SHIFTED)


@single_run
class Gain:
    """A state feedback that adds the reference and keeps what it has seen."""

    deviation = True
    seen = []

    def __init__(self, model, limits):
        self.model, self.limits = model, limits

    def control(self, x_hat, r, y, u_previous):
        """Return -x_hat[:2] + r."""
        Gain.seen.append((self.model, self.limits.u, y, u_previous))
        return r - x_hat[:2]


def test_a_law_sees_and_returns_deviations(model, rng):
    """Oracle: the formula in physical coordinates."""
    Gain.seen.clear()
    free = SignalLimits((np.zeros(2), np.full(2, 9.0)), (np.zeros(3), np.ones(3)))
    info = PlantInfo(3, 2, 2, 0.1, (), (), (), {}, {}, free)
    law = design_function("controllers", Gain)(model, Ts=0.1, n_steps=STEPS, plant_info=info)
    x_hat, y, r = (rng.standard_normal((1, n)) for n in (3, 2, 2))
    state = law.init(1)
    inputs = []
    for k in range(2):
        estimate = Estimate(model.x_op + x_hat, None, None, np.zeros(1, dtype=np.int8), {})
        state, command = law.control(k, state, model.y_op + y, estimate, model.y_op + r)
        inputs.append(command.u)
    np.testing.assert_allclose(inputs[0], model.u_op + r - x_hat[:, :2], **SHIFTED)
    (given, limits, seen_y, before), (*_, previous) = Gain.seen
    assert before is None
    assert not given.f0.any()
    np.testing.assert_allclose(limits[1], 9.0 - model.u_op, **SHIFTED)
    np.testing.assert_allclose(seen_y, y[0], **SHIFTED)
    np.testing.assert_allclose(previous, (r - x_hat[:, :2])[0], **SHIFTED)


def test_the_deviation_of_a_model_without_an_operating_point_is_itself(rng):
    """The same class then works in physical coordinates, and `lqr` regulates to 0."""
    m = random_model(rng, 3, 2, 2, 0.9)
    start = {"x0": np.ones(3), "P0": np.eye(3)}
    own = design_function("estimators", Around)(m, Ts=0.1, n_steps=STEPS, **start)
    y = rng.standard_normal((2, 2))
    expected = kalman(m, STEPS, **start)
    found = [each.correct(0, each.init(2), y)[1].x_hat for each in (own, expected)]
    np.testing.assert_allclose(found[0], found[1], **SHIFTED)
    assert lqr(m, STEPS, expected, horizon=3, Q_x=1.0, R_u=1.0).regulates_to is None
