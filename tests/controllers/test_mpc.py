"""The predictive controller against brute force on simulated predictions, a QP solver and servo.md."""

import cvxpy as cp
import numpy as np
import pytest
from conftest import SOLVER, random_model, random_psd

from rmpc_bench.controllers.limits import Limits
from rmpc_bench.controllers.mpc import Scale, design
from rmpc_bench.controllers.mpc_law import MpcState
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError, Estimate, Status


def simulated_outputs(m, x, u_previous, moves, Hp):
    """Outputs y(k+1)..y(k+Hp) of the model from x under the input moves, zero after the last, step by step."""
    u, outputs = u_previous.copy(), []
    for j in range(Hp):
        if j < len(moves):
            u = u + moves[j]
        x = m.A @ x + m.B @ u
        outputs.append(m.C @ x)
    return np.array(outputs)


def brute_force(m, x, u_previous, r, Hp, Hu, Q, R, span_u, span_y):
    """u(k) that minimises (2), by lstsq on the weighted residuals of simulated predictions.

    Parameters are those of the law; r holds r(k+1)..r(k+Hp), Q and R are matrices, the spans are vectors.
    """
    root_Q, root_R = np.linalg.cholesky(Q).T, np.linalg.cholesky(R).T  # |z|^2_Q = |root_Q z|^2

    def residuals(moves):
        error = (simulated_outputs(m, x, u_previous, moves, Hp) - r) / span_y
        return np.concatenate([(error @ root_Q.T).ravel(), (moves / span_u @ root_R.T).ravel()])

    at_zero = residuals(np.zeros((Hu, m.nu)))
    columns = [residuals(unit.reshape(Hu, m.nu)) - at_zero for unit in np.eye(Hu * m.nu)]
    moves = np.linalg.lstsq(np.array(columns).T, -at_zero, rcond=None)[0]
    return u_previous + moves[: m.nu]


def estimate_of(x_hat):
    """What the controller is told of an estimate."""
    return Estimate(x_hat, None, None, np.zeros(len(x_hat), dtype=np.int8), {})


def apply(controller, x_hat, u_previous, r):
    """One step of the law for runs with the given estimates and previous inputs; r holds r(k)..r(k+Hp)."""
    return controller.control(0, MpcState(u_previous), np.zeros((len(x_hat), r.shape[1])), estimate_of(x_hat), r)


@pytest.mark.parametrize("weights", ["numbers", "matrices"])
@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize(("Hp", "Hu"), [(1, 1), (6, 2), (5, 5)])
@pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (4, 1, 1), (3, 2, 2), (3, 2, 1), (3, 1, 2)])
def test_the_law_minimises_the_cost(nx, nu, ny, Hp, Hu, scaled, weights, rng):
    """Oracle: brute force on predictions that are simulated sample by sample; no matrix of prediction.py."""
    m = random_model(rng, nx, nu, ny)
    Q, R = random_psd(rng, ny, 5.0), random_psd(rng, nu, 5.0)
    if weights == "numbers":
        Q, R = 0.7 * np.eye(ny), 0.2 * np.eye(nu)
    span_u, span_y = (rng.uniform(0.5, 3.0, nu), rng.uniform(0.5, 3.0, ny)) if scaled else (np.ones(nu), np.ones(ny))
    controller = design(
        m,
        Hp=Hp,
        Hu=Hu,
        Q=0.7 if weights == "numbers" else Q.tolist(),
        R=0.2 if weights == "numbers" else R.tolist(),
        scale=Scale(u=span_u.tolist(), y=span_y.tolist()),
    )
    x_hat, u_previous = rng.standard_normal((3, nx)), rng.standard_normal((3, nu))
    r = rng.standard_normal((Hp + 1, ny))
    state, command = apply(controller, x_hat, u_previous, r)
    expected = [
        brute_force(m, *pair, r[1:], Hp, Hu, Q, R, span_u, span_y) for pair in zip(x_hat, u_previous, strict=True)
    ]
    np.testing.assert_allclose(command.u, expected, rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(state.u_previous, command.u)


def test_the_law_minimises_the_cost_by_a_qp_solver(rng):
    """Oracle: cvxpy with Clarabel; states, inputs and outputs of the horizon are variables, the model a constraint."""
    m, Hp, Hu = random_model(rng, 3, 2, 2), 6, 3
    Q, R = random_psd(rng, 2, 5.0), random_psd(rng, 2, 5.0)
    x_hat, u_previous, r = rng.standard_normal(3), rng.standard_normal(2), rng.standard_normal((Hp + 1, 2))
    x, u = cp.Variable((Hp + 1, 3)), cp.Variable((Hp, 2))
    du = u - cp.vstack([u_previous[None], u[:-1]])
    cost = sum(cp.quad_form(m.C @ x[j + 1] - r[j + 1], Q) for j in range(Hp))
    cost += sum(cp.quad_form(du[j], R) for j in range(Hu))
    rules = [x[0] == x_hat, *(x[j + 1] == m.A @ x[j] + m.B @ u[j] for j in range(Hp))]
    rules += [du[j] == 0 for j in range(Hu, Hp)]
    cp.Problem(cp.Minimize(cost), rules).solve(solver=cp.CLARABEL)
    controller = design(m, Hp=Hp, Hu=Hu, Q=Q.tolist(), R=R.tolist())
    _, command = apply(controller, x_hat[None], u_previous[None], r)
    np.testing.assert_allclose(command.u[0], u.value[0], **SOLVER)


def test_without_a_cost_of_moves_one_step_reaches_the_reference(rng):
    """Oracle: the stated limit; Hp = Hu = 1, R = 0 and C B square gives y(k+1) = r(k+1)."""
    m = random_model(rng, 3, 2, 2)
    controller = design(m, Hp=1, Hu=1, Q=1.0, R=0.0)
    x_hat, u_previous, r = rng.standard_normal((5, 3)), rng.standard_normal((5, 2)), rng.standard_normal((2, 2))
    _, command = apply(controller, x_hat, u_previous, r)
    same = apply(design(m, Hp=1, Hu=1, Q=1.0, R=0.0, law="printed"), x_hat, u_previous, r)[1].u
    np.testing.assert_allclose(same, command.u, rtol=1e-9)
    y_next = (x_hat @ m.A.T + command.u @ m.B.T) @ m.C.T
    np.testing.assert_allclose(y_next, np.tile(r[1], (5, 1)), atol=1e-11)


def brute_force_printed(m, x, r, Hp, Hu, Q, R, span_u, span_y):
    """u(k) that minimises the sum of |y - r|^2_Q and |u|^2_R, by lstsq on simulated predictions, u held after Hu."""
    root_Q, root_R = np.linalg.cholesky(Q).T, np.linalg.cholesky(R).T

    def residuals(inputs):
        moves = np.diff(inputs, axis=0, prepend=0.0)
        error = (simulated_outputs(m, x, np.zeros(m.nu), moves, Hp) - r) / span_y
        return np.concatenate([(error @ root_Q.T).ravel(), (inputs / span_u @ root_R.T).ravel()])

    at_zero = residuals(np.zeros((Hu, m.nu)))
    columns = [residuals(unit.reshape(Hu, m.nu)) - at_zero for unit in np.eye(Hu * m.nu)]
    return np.linalg.lstsq(np.array(columns).T, -at_zero, rcond=None)[0][: m.nu]


@pytest.mark.parametrize(("Hp", "Hu"), [(1, 1), (6, 2), (5, 5)])
@pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (4, 1, 1), (3, 2, 2), (3, 2, 1), (3, 1, 2)])
def test_the_printed_law_minimises_the_cost_of_inputs(nx, nu, ny, Hp, Hu, rng):
    """Oracle: brute force on predictions that are simulated sample by sample; the past input plays no part."""
    m = random_model(rng, nx, nu, ny)
    Q, R = random_psd(rng, ny, 5.0), random_psd(rng, nu, 5.0)
    span_u, span_y = rng.uniform(0.5, 3.0, nu), rng.uniform(0.5, 3.0, ny)
    scale = Scale(u=span_u.tolist(), y=span_y.tolist())
    controller = design(m, Hp=Hp, Hu=Hu, Q=Q.tolist(), R=R.tolist(), scale=scale, law="printed")
    x_hat, r = rng.standard_normal((3, nx)), rng.standard_normal((Hp + 1, ny))
    expected = [brute_force_printed(m, x, r[1:], Hp, Hu, Q, R, span_u, span_y) for x in x_hat]
    _, command = apply(controller, x_hat, np.zeros((3, nu)), r)
    np.testing.assert_allclose(command.u, expected, rtol=1e-10, atol=1e-10)
    _, after_another = apply(controller, x_hat, 1e6 * rng.standard_normal((3, nu)), r)
    np.testing.assert_array_equal(after_another.u, command.u)


def test_the_printed_law_is_4(servo):
    """Oracle: [I 0 ..] (Theta' Q Theta + R)^-1 Theta' Q (r - Psi x) with inverses, Theta filled entry by entry."""
    Hp, Hu, q, rho = 10, 3, 0.1, 0.1 * (2.0 * np.pi / 440.0) ** 2
    entry = [(servo.C @ np.linalg.matrix_power(servo.A, i) @ servo.B).item() for i in range(Hp)]
    Theta = np.array([[entry[i - j] if i >= j else 0.0 for j in range(Hu)] for i in range(Hp)])
    Theta[:, -1] = np.cumsum(Theta[:, -1])  # held after Hu
    gain = (np.linalg.inv(Theta.T @ Theta * q + rho * np.eye(Hu)) @ Theta.T * q)[0]
    Psi = np.vstack([servo.C @ np.linalg.matrix_power(servo.A, i + 1) for i in range(Hp)])
    controller = design(servo, Hp=Hp, Hu=Hu, Q=0.1, R=0.1, scale=Scale(u=440.0, y=2.0 * np.pi), law="printed")
    np.testing.assert_allclose(controller.K_r[0], gain, rtol=1e-9)
    np.testing.assert_allclose(controller.K_x[0], gain @ Psi, rtol=1e-9)


def step_response(model, controller, samples=350):
    """y and u of the model itself under the controller, which sees the state; reference pi/2."""
    x, state, y, u = np.zeros((1, 4)), controller.init(1), [0.0], []
    for k in range(samples):
        measured = x[:, :1].copy()
        state, command = controller.control(k, state, measured, estimate_of(x), np.full((11, 1), np.pi / 2))
        x = x @ model.A.T + command.u @ model.B.T
        y.append(x[0, 0])
        u.append(command.u[0, 0])
    return np.array(y), np.array(u)


@pytest.mark.parametrize(
    ("law", "at_5_s", "settles"), [("increment", 1.5588, (3.0, 3.2)), ("printed", 0.5641, (31.0, 33.05))]
)
def test_on_the_servo_the_printed_law_is_too_slow(servo, law, at_5_s, settles):
    """Oracle: servo.md 3.1: y(5 s) = 0.56-0.59 rad, 5 % after 31-33 s; claim 1a: 3.1 s, overshoot 10.3 %."""
    limits = Limits(u=(-220.0, 220.0))
    controller = design(servo, Hp=10, Hu=3, Q=0.1, R=0.1, scale=Scale(u=440.0, y=2.0 * np.pi), limits=limits, law=law)
    y, _ = step_response(servo, controller)
    np.testing.assert_allclose(y[50], at_5_s, rtol=0, atol=5e-5)
    outside = np.flatnonzero(np.abs(y - np.pi / 2) > 0.05 * np.pi / 2)
    assert settles[0] <= 0.1 * (outside[-1] + 1) <= settles[1]
    if law == "increment":
        np.testing.assert_allclose(y.max() / (np.pi / 2) - 1.0, 0.103, rtol=0, atol=5e-4)


@pytest.mark.parametrize(("law", "at_5_s", "peak"), [("increment", 0.0186, 8.94), ("printed", 1.5e-4, 0.0066)])
def test_on_the_servo_unscaled_weights_move_nothing(servo, law, at_5_s, peak):
    """Oracle: servo.md section 1: with Q = R = 0.1 unscaled, y(5 s) = 0.019 and a few volts, or nothing at all."""
    y, u = step_response(servo, design(servo, Hp=10, Hu=3, Q=0.1, R=0.1, law=law))
    np.testing.assert_allclose(y[50], at_5_s, rtol=0.05)
    np.testing.assert_allclose(u.max(), peak, rtol=0.01)
    assert abs(y[-1] - np.pi / 2) > 0.05 * np.pi / 2


@pytest.fixture(scope="module")
def servo_mpc(servo):
    """Return the controller of servo.md section 1."""
    scale = Scale(u=440.0, y=2.0 * np.pi)
    return design(servo, Hp=10, Hu=3, Q=0.1, R=0.1, scale=scale, limits=Limits(u=(-220.0, 220.0)))


def test_on_the_servo_the_published_gains_come_out(servo_mpc):
    """Oracle: the table of servo.md section 1, from another program."""
    np.testing.assert_allclose(servo_mpc.K_r.sum(), 60.80948353980342, rtol=1e-9)
    np.testing.assert_allclose(servo_mpc.K_x[0], [7.6123330405, -0.1419591513, 2.659857525, 0.2882682453], rtol=1e-9)
    np.testing.assert_allclose(1.0 - servo_mpc.K_u[0, 0], 0.8121946749908051, rtol=1e-9)
    assert servo_mpc.preview == 11


def test_on_the_servo_the_first_voltage_is_the_published_one(servo_mpc):
    """Oracle: servo.md section 2: 95.5193 V at rest with the reference pi/2."""
    _, command = apply(servo_mpc, np.zeros((1, 4)), np.zeros((1, 1)), np.full((11, 1), np.pi / 2))
    np.testing.assert_allclose(command.u, [[95.5193]], rtol=0, atol=5e-5)


def test_the_law_holds_a_reached_reference(servo_mpc):
    """Oracle: at rest on the reference, where the servo needs no voltage, no voltage is given."""
    x = np.array([[np.pi / 2, 0.0, 20.0 * np.pi / 2, 0.0]])
    _, command = apply(servo_mpc, x, np.zeros((1, 1)), np.full((11, 1), np.pi / 2))
    np.testing.assert_allclose(command.u, 0.0, atol=1e-10)


def test_the_input_is_clipped_and_remembered_clipped(servo_mpc):
    """Oracle: servo.md section 1: u(k-1) is the last applied (clipped) voltage."""
    x = np.array([[-1e3, 0.0, 0.0, 0.0], [1e3, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    state, command = apply(servo_mpc, x, np.zeros((3, 1)), np.zeros((11, 1)))
    np.testing.assert_array_equal(command.u, [[220.0], [-220.0], [0.0]])
    np.testing.assert_array_equal(state.u_previous, command.u)
    np.testing.assert_array_equal(command.status, np.full(3, Status.OK, dtype=np.int8))


def test_the_first_previous_input_is_zero(servo_mpc):
    """Oracle: u(-1) = 0, servo.md section 4, point 14."""
    np.testing.assert_array_equal(servo_mpc.init(3).u_previous, np.zeros((3, 1)))


def test_the_reference_counts_from_the_next_sample_on(servo, rng):
    """Oracle: (2) sums k = 1..Hp; r(k) has no effect, every later sample has."""
    controller = design(servo, Hp=10, Hu=3, Q=0.1, R=0.1, scale=Scale(u=440.0, y=2.0 * np.pi))
    x, u_previous, r = rng.standard_normal((1, 4)), np.zeros((1, 1)), rng.standard_normal((11, 1))
    u = apply(controller, x, u_previous, r)[1].u
    for j in range(11):
        changed = r.copy()
        changed[j] += 1.0
        moved = apply(controller, x, u_previous, changed)[1].u - u
        if j == 0:
            np.testing.assert_array_equal(moved, [[0.0]])
        else:
            np.testing.assert_allclose(moved, controller.K_r[:, j - 1 : j], rtol=1e-9)
            assert abs(moved[0, 0]) > 1e-3


@pytest.mark.parametrize("ratio", [1e-6, 1e-9])
def test_small_weights_of_the_moves_are_no_obstacle(servo, ratio):
    """Oracle: servo.md section 2 uses R/Q down to 1e-9 with Hu = 8; the law must still minimise (2)."""
    controller = design(servo, Hp=10, Hu=8, Q=1.0, R=ratio)
    x, u_previous, r = np.array([0.1, 0.2, 3.0, -1.0]), np.array([5.0]), np.full((11, 1), 1.0)
    expected = brute_force(servo, x, u_previous, r[1:], 10, 8, np.eye(1), ratio * np.eye(1), np.ones(1), np.ones(1))
    _, command = apply(controller, x[None], u_previous[None], r)
    np.testing.assert_allclose(command.u[0], expected, rtol=1e-7)  # condition of the least-squares problem, 1e4..1e5


@pytest.mark.parametrize(
    ("changes", "parameter", "message"),
    [
        ({"Hu": 4}, "Hu", "at most Hp = 3"),
        ({"Q": [[1.0, 2.0], [0.0, 1.0]]}, "Q", "symmetric"),
        ({"Q": -1.0}, "Q", "semidefinite"),
        ({"R": [1.0, 2.0, 3.0]}, "R", "shape"),
        ({"limits": Limits(u=(1.0, -1.0))}, "limits.u", "below"),
    ],
)
def test_bad_parameters_are_design_errors_that_name_them(changes, parameter, message, small_model):
    """Oracle: DesignError.parameter leads to the line of the YAML."""
    with pytest.raises(DesignError, match=message) as caught:
        design(small_model, **{"Hp": 3, "Hu": 2, "Q": 1.0, "R": 1.0, **changes})
    assert caught.value.parameter == parameter


def test_moves_that_the_cost_does_not_determine_are_a_design_error():
    """Oracle: an input without effect and without cost."""
    model = LinearModel(np.eye(2), np.array([[1.0, 0.0], [0.0, 0.0]]), np.eye(2)[:1], np.eye(2), np.eye(1))
    with pytest.raises(DesignError, match="choose R > 0") as caught:
        design(model, Hp=3, Hu=1, Q=1.0, R=0.0)
    assert caught.value.parameter == "R"


@pytest.mark.parametrize("name", ["u", "y"])
def test_spans_of_the_wrong_length_are_design_errors(name, small_model):
    """Oracle: the spans belong to the signals, of which there are two each."""
    with pytest.raises(DesignError, match="shape") as caught:
        design(small_model, Hp=3, Hu=2, Q=1.0, R=1.0, scale=Scale(**{name: [1.0, 2.0, 3.0]}))
    assert caught.value.parameter == f"scale.{name}"
