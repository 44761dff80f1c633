"""Linear-quadratic control with integrals: limits, steady states, offsets, windup, disturbances."""

import numpy as np
import pytest
from conftest import random_model, servo_model
from loaded_configs import loaded
from scipy.linalg import solve_discrete_are

from rmpc_bench.controllers.limits import InputLimits
from rmpc_bench.controllers.lqg import design
from rmpc_bench.controllers.state_feedback import lqr
from rmpc_bench.diagnostics.stability import linear_pair, spectral_radius
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.disturbance import Disturbance, entry_of
from rmpc_bench.models.disturbed import DisturbedLinear
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.types import DesignError, Estimate, Estimator, LinearPlant, Method, Status

TS = 0.1
SERVO = {"Q_y": 1.0, "Q_i": 1e-2, "R_u": 1e-6}
SETTLED = {"rtol": 0.0, "atol": 1e-8}
"""Remainder of a transient that has decayed."""


def loop(law, A, B, C, n, r=1.0, d0=0.0, x0=None, known=True, filter_=None):
    """Outputs, inputs and states of the law over n samples on a linear plant; the state is known, or estimated."""
    x = np.zeros((1, len(A))) if x0 is None else np.array(x0, dtype=float)[None]
    state, filtered = law.init(1), None if known else filter_.init(1)
    y, u, q = [], [], []
    for k in range(n):
        now = x @ C.T + d0
        estimate = Estimate(x)
        if not known:
            filtered, estimate = filter_.correct(k, filtered, now)
        state, command = law.control(k, state, now, estimate, np.full((1, len(C)), r))
        if not known:
            filtered = filter_.predict(k, filtered, command.u)
        y.append(now[0])
        u.append(command.u[0])
        q.append(law.sums(state)[0])
        x = x @ A.T + command.u @ B.T
    return np.array(y), np.array(u), np.array(q)


def test_without_integrals_it_is_lqr():
    """Oracle: the stated limit, lqr with a long horizon; the reference is 0."""
    m = servo_model()
    filter_ = kalman(m, 3, x0=np.zeros(4), P0=m.Q_w)
    regulator = lqr(m, 3, filter_, horizon=1000, Q_x=[1.0, 0.1, 0.0, 0.0], R_u=1e-3)
    law = design(m, TS, filter_, Q_x=[1.0, 0.1, 0.0, 0.0], Q_i=0.0, R_u=1e-3)
    x_hat, zero = np.random.default_rng(1).standard_normal((5, 4)), np.zeros((1, 1))
    given = (np.zeros((5, 1)), Estimate(x_hat), zero)
    expected = regulator.control(0, regulator.init(5), *given)[1].u
    np.testing.assert_allclose(law.control(0, law.init(5), *given)[1].u, expected, rtol=1e-6)
    # The gain of the sums is of the order of the root of their weight.
    for Q_i in (1e-8, 1e-12):
        near = design(m, TS, filter_, Q_x=[1.0, 0.1, 0.0, 0.0], Q_i=Q_i, R_u=1e-3)
        assert np.abs(near.K_x - law.K_x).max() < 1e3 * np.sqrt(Q_i) * np.abs(law.K_x).max()
        assert np.abs(near.K_r - law.K_r).max() < 1e3 * np.sqrt(Q_i) * np.abs(law.K_r).max()


def test_gain_of_the_output_weight():
    """Oracle: scipy's Riccati solution of the augmented model with Q_x = C' Q_y C."""
    m = servo_model()
    law = design(m, TS, Estimator(), **SERVO)
    A = np.block([[m.A, np.zeros((4, 1))], [m.C, np.eye(1)]])
    B, Q = np.vstack([m.B, [[0.0]]]), np.diag([1.0, 0.0, 0.0, 0.0, 1e-2])
    P = solve_discrete_are(A, B, Q, [[1e-6]])
    K = np.linalg.solve(1e-6 + B.T @ P @ B, B.T @ P @ A)
    np.testing.assert_allclose(np.hstack([law.K_x, law.K_q]), K, rtol=1e-8)


@pytest.mark.parametrize("feedforward", ["optimal", "target", "none"])
@pytest.mark.parametrize("on", ["y", "estimate"])
def test_no_offset_with_a_wrong_plant_and_constant_parts(rng, feedforward, on):
    """Oracle: y = r on a plant that is not the model, with several inputs and outputs and an input disturbance."""
    m = random_model(rng, 3, 2, 2, 0.8)
    m = LinearModel(m.A, m.B, m.C, m.Q_w, m.R_v, f0=[0.2, -0.1, 0.3], d0=[0.4, -0.2])
    law = design(m, TS, Estimator(), Q_x=1.0, Q_i=1.0, R_u=0.01, feedforward=feedforward, on=on)
    A, B = m.A * 1.05, m.B * 0.9
    # The state is known, so that the output of the estimate is the measured one.
    y, _, _ = loop(law, A, B, m.C, 300, r=2.0, d0=m.d0)
    np.testing.assert_allclose(y[-1], 2.0, **SETTLED)


def test_sums_of_the_estimated_output_leave_its_offset(rng):
    """A Kalman filter with a wrong model has y_hat != y at rest: only the sums of y bring y to r."""
    m = random_model(rng, 3, 1, 1, 0.8)
    filter_ = kalman(m, 300, x0=np.zeros(3), P0=m.Q_w)
    ends = {}
    for on in ("y", "estimate"):
        law = design(m, TS, filter_, Q_y=1.0, Q_i=0.1, R_u=1.0, on=on)
        ends[on] = loop(law, 0.95 * m.A, m.B, m.C, 300, known=False, filter_=filter_)[0][-1, 0]
    np.testing.assert_allclose(ends["y"], 1.0, **SETTLED)
    assert abs(ends["estimate"] - 1.0) > 1e-3


def test_more_inputs_than_outputs(rng):
    """Oracle: y = r with the least u' R_u u, by Lagrange's conditions of the static map of a stable model."""
    m, R = random_model(rng, 3, 3, 1, 0.7), np.diag([1.0, 4.0, 9.0])
    law = design(m, TS, Estimator(), Q_x=1.0, Q_i=0.0, R_u=R.tolist())
    y, u, _ = loop(law, m.A, m.B, m.C, 300)
    static = m.C @ np.linalg.solve(np.eye(3) - m.A, m.B)
    weighed = np.linalg.solve(R, static.T)
    np.testing.assert_allclose(y[-1], 1.0, **SETTLED)
    np.testing.assert_allclose(u[-1], (weighed / (static @ weighed))[:, 0], rtol=1e-6)


def test_chosen_outputs_follow(rng):
    """One input cannot bring two outputs to their references: it is refused, and one of them is followed."""
    m = random_model(rng, 3, 1, 2, 0.7)
    with pytest.raises(DesignError, match="is 4 and must be 5") as found:
        design(m, TS, Estimator(), Q_x=1.0, Q_i=1.0, R_u=1.0)
    assert found.value.parameter == "outputs"
    law = design(m, TS, Estimator(), Q_x=1.0, Q_i=0.1, R_u=1.0, outputs=[1])
    np.testing.assert_allclose(loop(law, m.A, m.B, m.C, 300)[0][-1, 1], 1.0, **SETTLED)


def test_feedforward():
    """`target` forces the sum of the errors to 0, so that y overshoots; `optimal` has the least remaining cost.

    Oracle: the cost of the simulated step for shifts of the sums beside the chosen one.
    """
    m = servo_model()
    laws = {each: design(m, TS, Estimator(), **SERVO, feedforward=each) for each in ("optimal", "target", "none")}
    paths = {each: loop(law, m.A, m.B, m.C, 300) for each, law in laws.items()}
    for y, _, _ in paths.values():
        np.testing.assert_allclose(y[-1], 1.0, **SETTLED)
    np.testing.assert_allclose(paths["target"][2][-1], 0.0, atol=1e-7)
    assert paths["target"][0].max() > 1.05
    assert paths["optimal"][0].max() < paths["target"][0].max() - 0.02

    def cost(shift):
        """Cost of a step: after it the sums start ``shift`` away from their value at rest."""
        law, x, q, total = laws["target"], np.zeros((1, 4)), np.array([[shift]]), 0.0
        for k in range(300):
            y = x @ m.C.T
            u = law.control(k, law.init(1)._replace(q=q), y, Estimate(x), np.ones((1, 1)))[1].u
            total += (y[0, 0] - 1.0) ** 2 + 1e-2 * q[0, 0] ** 2 + 1e-6 * u[0, 0] ** 2
            x, q = x @ m.A.T + u @ m.B.T, q + y - 1.0
        return total

    best = -paths["optimal"][2][-1, 0]
    assert cost(best) < min(cost(best - 0.1), cost(best + 0.1), cost(0.0))


def test_linear_law():
    """Oracle: separation, the poles of the augmented model with its gain and those of the filter."""
    rng = np.random.default_rng(3)
    m = random_model(rng, 3, 2, 2)
    filter_ = kalman(m, 300, x0=np.zeros(3), P0=m.Q_w)
    plant = LinearPlant(m.A, m.B, m.C, np.eye(3))
    for on in ("y", "estimate"):
        law = design(m, TS, filter_, Q_x=1.0, Q_i=0.1, R_u=1.0, on=on)
        A = np.block([[m.A, np.zeros((3, 2))], [m.C, np.eye(2)]])
        poles = [np.linalg.eigvals(A - np.vstack([m.B, np.zeros((2, 2))]) @ np.hstack([law.K_x, law.K_q])),
                 np.linalg.eigvals(m.A - filter_.K[-1] @ m.C)]  # fmt: skip
        expected = np.abs(np.concatenate(poles)).max()
        np.testing.assert_allclose(spectral_radius(plant, linear_pair(filter_, law)), expected, rtol=1e-7)


def test_windup():
    """A step that the limits slow down: `none` overshoots more, and its sums grow further."""
    m = servo_model()
    found = {}
    for each in ("none", "clamping", "back-calculation"):
        law = design(m, TS, Estimator(), **SERVO, limits=InputLimits((-40.0, 40.0)), anti_windup=each)
        y, u, q = loop(law, m.A, m.B, m.C, 500)
        assert np.abs(u).max() == 40.0
        np.testing.assert_allclose(y[-1], 1.0, atol=1e-6)
        found[each] = y.max() - 1.0, np.abs(q).max()
    assert found["none"][0] > 0.5
    for each in ("clamping", "back-calculation"):
        assert found[each][0] < 1e-3
        assert found["none"][1] > 1.2 * found[each][1]


def test_windup_of_several_inputs(rng):
    """An error is summed where no limited input is driven further; oracle: the rule, entry by entry."""
    m = random_model(rng, 3, 2, 2, 0.9)
    law = design(m, TS, Estimator(), Q_x=1.0, Q_i=1.0, R_u=0.1, limits=InputLimits([(-0.5, 0.5), (-1.0, 1.0)]))
    free = design(m, TS, Estimator(), Q_x=1.0, Q_i=1.0, R_u=0.1)
    x_hat, y, q = (rng.standard_normal((40, n)) for n in (3, 2, 2))
    given = (y, Estimate(x_hat), np.zeros((1, 2)))
    after, command = law.control(0, law.init(40)._replace(q=q), *given)
    wanted = free.control(0, free.init(40)._replace(q=q), *given)[1].u
    kept = 0
    for run in range(40):
        for j in range(2):
            worse = any((wanted[run, i] - command.u[run, i]) * (-law.K_q[i, j] * y[run, j]) > 0.0 for i in range(2))
            np.testing.assert_allclose(law.sums(after)[run, j], q[run, j] + (0.0 if worse else y[run, j]), rtol=1e-12)
            kept += not worse
    assert 0 < kept < 80


def test_a_missing_measurement_is_not_summed():
    """Oracle: the sums of the other runs and samples."""
    m = servo_model()
    law = design(m, TS, Estimator(), **SERVO)
    y = np.array([[np.nan], [0.3]])
    state, command = law.control(0, law.init(2), y, Estimate(np.zeros((2, 4))), np.ones((1, 1)))
    np.testing.assert_array_equal(law.sums(state), [[0.0], [0.3 - 1.0]])
    assert np.isfinite(command.u).all()


def test_a_missing_measurement_does_not_stop_the_sums_of_other_outputs(rng):
    """Oracle: the error of the measured output; trap: 0 times NaN is NaN."""
    m = random_model(rng, 3, 2, 3)
    law = design(m, TS, Estimator(), Q_x=1.0, Q_i=0.1, R_u=1.0, outputs=[2, 0])
    y = np.array([[0.4, np.nan, 0.3], [np.nan, 0.1, 0.3]])
    state, _ = law.control(0, law.init(2), y, Estimate(np.zeros((2, 3))), np.ones((1, 3)))
    np.testing.assert_allclose(law.sums(state), [[0.3 - 1.0, 0.4 - 1.0], [0.3 - 1.0, 0.0]], rtol=1e-15)


@pytest.mark.parametrize("Q_i", [0.0, 1e-2])
def test_a_disturbance_of_the_model_changes_the_target(Q_i):
    """Its gain is 1 for an input disturbance; the loop has no offset, with sums or without them.

    Oracle: u_s = -d, and y = r on a plant with a constant disturbance and other matrices.
    """
    m = servo_model()
    augmented, n = DisturbedLinear(m, entry_of(m, Disturbance(at="input", drift=1e5))), 300
    filter_ = kalman(augmented, n, x0=np.zeros(5), P0=augmented.Q_w)
    law, plain = (design(each, TS, filter_, Q_y=1.0, Q_i=Q_i, R_u=1e-6) for each in (augmented, m))
    np.testing.assert_allclose(law.K_x[:, :4], plain.K_x, rtol=1e-12)
    np.testing.assert_allclose(law.K_x[:, 4], 1.0, rtol=1e-9)
    A, B = np.block([[0.98 * m.A, m.B], [np.zeros((1, 4)), np.eye(1)]]), np.vstack([m.B, [[0.0]]])
    C, x0 = np.hstack([m.C, [[0.0]]]), [0.0, 0.0, 0.0, 0.0, 7.0]
    y, _, _ = loop(law, A, B, C, n, x0=x0, known=False, filter_=filter_)
    np.testing.assert_allclose(y[-1], 1.0, atol=1e-6)


def test_perturbed_servomechanism():
    """Second simulation of zenere2018: S-MPC stops 0.158 rad beside the reference, lqg ends at it.

    Static friction holds the load within 0.01 rad of it for seconds.
    """
    experiment = loaded("zenere2018/sim2").experiment
    n = experiment.n_steps
    methods = {method.name: method for method in experiment.methods}
    m, filter_ = servo_model(), methods["S-MPC"].estimator
    law = design(m, TS, filter_, **SERVO, limits=InputLimits((-220.0, 220.0)))
    errors = {}
    for method in (methods["S-MPC"], Method("lqg", filter_, law)):
        r = experiment.scenario.reference.sample(n + 1 + method.controller.preview)
        draws = experiment.scenario.draw(experiment.plant, range(1), n)
        record, status = simulate(experiment.plant, method, draws, r, n)
        assert status.tolist() == [Status.OK]
        errors[method.name] = record.y[0, -1, 0] - np.pi / 2
    np.testing.assert_allclose(errors["S-MPC"], -0.158, atol=5e-4)
    assert abs(errors["lqg"]) < 0.015


ZERO_AT_ONE = LinearModel([[0.9, -0.2], [1.0, 0.0]], [[1.0], [0.0]], [[1.0, -1.0]], 1.0, 1.0)
UNREACHABLE = LinearModel([[0.5, 0.0], [0.0, 1.2]], [[1.0], [0.0]], [[1.0, 0.0]], 1.0, 1.0)
PLAIN = {"Q_x": 1.0, "Q_i": 1.0, "R_u": 1.0}


@pytest.mark.parametrize(
    ("m", "keys", "key", "message"),
    [
        (ZERO_AT_ONE, {}, "outputs", "is 2 and must be 3"),
        (UNREACHABLE, {}, "R_u", "no stabilising gain"),
        (None, {"Q_y": 1.0}, "Q_y", "beside `Q_x`"),
        (None, {"Q_x": None}, "Q_x", "needs a weight"),
        (None, {"Q_i": -1.0}, "Q_i", "negative eigenvalue|semidefinite"),
        (None, {"R_u": 0.0}, "R_u", "positive definite"),
        (None, {"Tt": 1.0}, "Tt", "no effect"),
        (None, {"Tt": 0.01, "anti_windup": "back-calculation"}, "Tt", "at least the sampling time"),
        (None, {"Q_i": 0.0, "feedforward": "none"}, "feedforward", "does not use the reference"),
        (None, {"outputs": [0, 0]}, "outputs", "different numbers"),
    ],
)
def test_mistakes(m, keys, key, message):
    """Oracle: the key to blame and the reason."""
    with pytest.raises(DesignError, match=message) as found:
        design(m or LinearModel([[0.5]], [[1.0]], [[1.0]], 1.0, 1.0), TS, Estimator(), **{**PLAIN, **keys})
    assert found.value.parameter == key
