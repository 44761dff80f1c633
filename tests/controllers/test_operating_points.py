"""Models with an operating point in every estimator and controller: the loop in deviation variables, shifted back."""

import inspect
from typing import NamedTuple

import numpy as np
import pytest
from conftest import random_model
from required_keys import REQUIRED

from rmpc_bench import registry
from rmpc_bench.controllers import mpc
from rmpc_bench.controllers.limits import Limits
from rmpc_bench.controllers.mpc import Scale
from rmpc_bench.controllers.mpc_law import MpcState
from rmpc_bench.controllers.noise_tuning import LpNoise
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.linearised import LinearisedModel
from rmpc_bench.plants.linear import design as linear_plant
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.moments import Laws, exact_moments
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.simulation.scenario import Draws
from rmpc_bench.types import Controller, DesignError, Method, Motion, OperatingPoint, Plant, Status

RUNS, STEPS = 5, 15
SHIFTED = {"rtol": 0.0, "atol": 1e-11}
"""Rounding of numbers of about 5, the size of the operating point, over a loop of 15 samples."""
ITERATED = {"rtol": 0.0, "atol": 1e-7}
"""A gain that minimises a size is found to the root of the rounding only, since the minimum is flat."""
START = {"x0": np.zeros(3), "P0": np.eye(3)}

REFUSE = {"oracle": "uncertain matrices"}
"""Estimators that refuse such a model, with a part of the reason."""
ESTIMATORS = {kind: [REQUIRED.get(kind, {})] for kind in registry.names("estimators") if kind not in REFUSE} | {
    "kalman": [{}, {"form": "predictor"}],
    "kalman-predictor": [{}, {"gain": "steady"}],
    "lp-window": [{}, {"Ne": 2, "start": "anchored"}],
    "mixed": [{"M0": np.eye(3)}],
    "set-membership": [{"M0": np.eye(3)}, {"M0": np.eye(3), "update": "maksarov-norton", "level": 0.9999}],
    "moving-horizon": [{"window": 3}],
    "nonlinear-moving-horizon": [{"window": 3}],
}
"""Parameters of the estimators that support an operating point."""
CONTROLLERS = {kind: [REQUIRED.get(kind, {})] for kind in registry.names("controllers")} | {
    "gpc": [
        {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1},
        {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1, "tuning": LpNoise(Ne2=4, kp=0.3)},
        {"Np": 4, "Q_yw": 1.0, "Q_u": 0.1, "of": "kalman-disturbance"},
    ],
    "mpc": [
        {"Hp": 6, "Hu": 2, "Q": 1.0, "R": 0.1, "limits": Limits(u=(-0.3, 0.3))},
        {"Hp": 6, "Hu": 2, "Q": 1.0, "R": 0.1, "scale": Scale(u=2.0, y=3.0)},
        {"Hp": 4, "Hu": 2, "Q": 1.0, "R": 0.1, "law": "printed"},
        {"Hp": 6, "Hu": 2, "Q": 1.0, "R": 0.1, "of": "kalman-disturbance"},
    ],
    "lqr": [{"horizon": 7, "Q_x": 1.0, "R_u": 0.1}, {"horizon": 7, "Q_x": 1.0, "R_u": 0.1, "of": "kalman-disturbance"}],
    "game-gain": [{"horizon": 7, "Q_x": 1.0, "R_u": 0.1, "ratio": 1.5}],
    "lqg": [
        {"Q_x": 1.0, "Q_i": 0.1, "R_u": 0.1},
        {"Q_y": 1.0, "Q_i": 0.1, "R_u": 0.1, "feedforward": "none", "on": "estimate"},
        {"Q_x": 1.0, "Q_i": 0.0, "R_u": 0.1, "of": "kalman-disturbance"},
    ],
    "pid": [
        {"Kp": 0.02, "Ki": 0.05, "Kd": 0.001, "b": 0.5, "c": 0.3},
        {"Kp": 0.02, "Ki": 0.05, "on": "estimate", "start": "bumpless"},
    ],
    # Its limits name signals, which test_tube_mpc.py shifts.
    "tube-mpc": [],
}
"""Parameters of the controllers, `of` an estimator other than `kalman`."""


class Nothing(NamedTuple):
    """Record of a plant without parameters."""


class Affine(Plant):
    """The model as a plant: nothing is uncertain."""

    Ts = 0.1

    def __init__(self, model):
        self.model, self.nx, self.nu, self.ny = model, model.nx, model.nu, model.ny

    def draw(self, parameters, rngs, n_steps):
        """There is nothing to draw."""
        return Nothing()

    def step(self, k, delta, x, u, w):
        """Move."""
        m = self.model
        x = x @ m.A.T + u @ m.B.T + m.f0 + w
        return Motion(x, np.full(len(x), np.int8(Status.OK)))

    def output(self, k, delta, x, v):
        """Measure."""
        return x @ self.model.C.T + self.model.d0 + v


@pytest.fixture(scope="module")
def model():
    """Return a model around an operating point of size 5 with a steady state."""
    rng = np.random.default_rng(5)
    m = random_model(rng, 3, 2, 2, 0.9)
    point = OperatingPoint(*(5.0 * rng.standard_normal(n) for n in (3, 2, 2)))
    return LinearisedModel(m.A, m.B, m.C, 1e-2 * m.Q_w, 1e-2 * m.R_v, point=point)


def draws(shift):
    """Return random inputs of a few runs, with the initial state moved."""
    rng = np.random.default_rng(6)
    x0, w, v = (0.3 * rng.standard_normal(shape) for shape in ((RUNS, 3), (RUNS, STEPS + 1, 3), (RUNS, STEPS + 1, 2)))
    return Draws(Nothing(), x0 + shift, 0.1 * w, 0.1 * v)


def reference(method, shift):
    """Return a reference that changes, or 0 for a regulator; moved."""
    r = np.random.default_rng(7).standard_normal((STEPS + 1 + method.controller.preview, 2))
    return (0.0 if method.controller.regulates else r) + np.broadcast_to(shift, r.shape)


def designed(model, estimator, controller, shift):
    """Return a method of two (kind, parameters) for a model; the start of the estimator is moved."""
    make, own = registry.get("estimators", estimator[0]), dict(estimator[1])
    start = {**START, "x0": START["x0"] + shift, "Ts": Affine.Ts}
    given = {name: value for name, value in start.items() if name in inspect.signature(make).parameters}
    filter_ = make(model, STEPS, **given, **own)
    law, keys = registry.get("controllers", controller[0]), dict(controller[1])
    given = {"n_steps": STEPS, "estimator": filter_, "Ts": Affine.Ts}
    given = {name: value for name, value in given.items() if name in inspect.signature(law).parameters}
    return Method("m", filter_, law(model, **given, **keys))


def loops(model, estimator, controller, moved=None):
    """Simulate in physical coordinates and in deviation variables; `moved` is the controller in deviation variables."""
    point, deviation = model.operating_point, model.deviation
    physical = designed(model, estimator, controller, point.x)
    record, status = simulate(Affine(model), physical, draws(point.x), reference(physical, point.y), STEPS)
    moved = designed(deviation, estimator, moved or controller, 0.0)
    expected, expected_status = simulate(Affine(deviation), moved, draws(0.0), reference(moved, 0.0), STEPS)
    np.testing.assert_array_equal(status, expected_status)
    assert (status == Status.OK).all()
    return record, expected


def assert_shifted(model, record, expected, tolerance=SHIFTED):
    """The physical loop is the other one, moved by the operating point."""
    point = model.operating_point
    np.testing.assert_allclose(record.x, expected.x + point.x, **tolerance)
    np.testing.assert_allclose(record.u, expected.u + point.u, **tolerance)
    np.testing.assert_allclose(record.y, expected.y + point.y, **tolerance)
    np.testing.assert_allclose(record.x_hat, expected.x_hat + point.x, **tolerance)


@pytest.mark.parametrize(
    ("kind", "number"), [(kind, number) for kind in ESTIMATORS for number in range(len(ESTIMATORS[kind]))]
)
def test_every_estimator_uses_the_offsets(model, kind, number):
    """Oracle: the loop in deviation variables."""
    law, keys = ("mpc", CONTROLLERS["mpc"][1]), ESTIMATORS[kind][number]
    tolerance = ITERATED if keys.get("update") == "maksarov-norton" else SHIFTED
    assert_shifted(model, *loops(model, (kind, keys), law), tolerance)


@pytest.mark.parametrize("kind", REFUSE)
def test_an_estimator_without_offsets_refuses_the_model(model, kind):
    """A model with an operating point has no uncertain matrices."""
    with pytest.raises(DesignError, match=REFUSE[kind]):
        registry.get("estimators", kind)(model, STEPS, Affine(model), **START)


@pytest.mark.parametrize(
    ("kind", "number"), [(kind, number) for kind in CONTROLLERS for number in range(len(CONTROLLERS[kind]))]
)
def test_every_controller_uses_the_offsets(model, kind, number):
    """Oracle: the loop in deviation variables; limits are physical ones."""
    keys = dict(CONTROLLERS[kind][number])
    estimator = (keys.pop("of", "kalman"), {})
    moved = dict(keys)
    if "limits" in keys:
        u = model.u_op
        keys["limits"] = Limits(u=(u.min() - 0.3, u.max() + 0.3))
        bounds = [(keys["limits"].u[0] - each, keys["limits"].u[1] - each) for each in u]
        low, high = np.array(bounds).T
        record, _ = loops_with_limits(model, estimator, (kind, keys), low, high)
        assert (record.u >= keys["limits"].u[0]).all()
        assert (record.u <= keys["limits"].u[1]).all()
        return
    assert_shifted(model, *loops(model, estimator, (kind, keys), (kind, moved)))


def loops_with_limits(model, estimator, controller, low, high):
    """As `loops`, with limits of the deviations, one per input, which no key gives."""
    point, deviation = model.operating_point, model.deviation
    physical = designed(model, estimator, controller, point.x)
    record, _ = simulate(Affine(model), physical, draws(point.x), reference(physical, point.y), STEPS)
    keys = {name: value for name, value in controller[1].items() if name != "limits"}
    moved = designed(deviation, estimator, (controller[0], keys), 0.0)
    clipped = Method("m", moved.estimator, Clipped(moved.controller, low, high))
    expected, _ = simulate(Affine(deviation), clipped, draws(0.0), reference(moved, 0.0), STEPS)
    assert_shifted(model, record, expected)
    assert (record.u == controller[1]["limits"].u[1]).any()
    return record, expected


class Clipped(Controller):
    """A controller whose inputs are clipped to limits of their own, before it remembers them."""

    def __init__(self, inner, low, high):
        self.inner, self.low, self.high = inner, low, high
        self.preview = inner.preview

    def init(self, n_runs):
        """Start as the inner one."""
        return self.inner.init(n_runs)

    def control(self, k, state, y, estimate, r):
        """Clip."""
        _, command = self.inner.control(k, state, y, estimate, r)
        u = np.clip(command.u, self.low, self.high)
        return MpcState(u), command._replace(u=u)


def test_the_input_before_the_start_is_that_of_the_operating_point(model):
    """With a heavy weight of moves and a reference of y_op the input stays at u_op; from 0 it would creep there."""
    point = model.operating_point
    law = mpc.design(model, Hp=6, Hu=2, Q=1.0, R=1e12)
    estimate = kalman(model, STEPS, x0=point.x, P0=np.eye(3)).correct(0, *start_at(model))[1]
    _, command = law.control(0, law.init(1), point.y[None], estimate, np.tile(point.y, (law.preview, 1)))
    np.testing.assert_allclose(command.u[0], point.u, **SHIFTED)


def start_at(model):
    """State of a filter at the operating point, and the output there."""
    return kalman(model, STEPS, x0=model.x_op, P0=np.eye(3)).init(1), model.y_op[None]


def test_a_regulator_needs_a_steady_state(model):
    """The drift of an operating point is compensated by lqr; the other regulators refuse it with the way out."""
    point = model.operating_point
    given = (model.A, model.B, model.C, model.Q_w, model.R_v)
    drifting = LinearisedModel(*given, point=point, drift=np.array([0.1, 0.0, 0.0]))
    assert_shifted(drifting, *loops(drifting, ("kalman", {}), ("lqr", CONTROLLERS["lqr"][0])))
    for kind in ("game-gain", "minimax-lq"):
        with pytest.raises(DesignError, match="steady state; use lqr"):
            designed(drifting, ("kalman", {}), (kind, CONTROLLERS[kind][0]), point.x)
    assert_shifted(drifting, *loops(drifting, ("kalman", {}), ("mpc", CONTROLLERS["mpc"][1])))


def test_exact_moments_use_the_offsets(model):
    """Oracle: the loop without noise, from the mean of the initial state, with u = 0."""
    A, B, C = (matrix.tolist() for matrix in (model.A, model.B, model.C))
    plant, x0 = linear_plant(0.1, STEPS, A=A, B=B, C=C), np.array([1.0, -2.0, 0.5])
    method = Method("m", kalman(model, STEPS, x0=model.x_op, P0=np.eye(3)), Rest(2))
    schedule = method.estimator.gain_schedule
    assert schedule is not None
    laws = Laws(x0, np.zeros((3, 3)), np.zeros(5), np.zeros((5, 5)))
    found = exact_moments(plant, schedule, laws, STEPS)
    w, v = (np.zeros((1, STEPS + 1, n)) for n in (3, 2))
    nothing = Draws(plant.draw({}, [np.random.default_rng(0)], STEPS), x0[None], w, v)
    record, _ = simulate(plant, method, nothing, np.zeros((STEPS + 2, 2)), STEPS)
    np.testing.assert_allclose(found.mean, np.hstack([record.x[0], record.x_hat[0]]), **SHIFTED)


def test_the_operating_point_is_a_steady_state_of_the_model(model):
    """Oracle: the equations of the model at x_op and u_op."""
    x, u, y = model.operating_point
    np.testing.assert_allclose(model.A @ x + model.B @ u + model.f0, x, rtol=1e-14)
    np.testing.assert_allclose(model.C @ x + model.d0, y, rtol=1e-14)
    assert not model.deviation.f0.any()
    np.testing.assert_array_equal(model.deviation.x_op, 0.0)
