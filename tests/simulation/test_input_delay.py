"""A known delay of the input: stationary values of the whole loop, and the laws of the augmented model."""

import numpy as np
import pytest
import scipy.linalg as la
from conftest import ROUND, within_stat

from rmpc_bench import load_config
from rmpc_bench.models.flow import prediction_flow
from rmpc_bench.models.moving_slide import SlideNoise
from rmpc_bench.models.moving_slide import design as moving_slide
from rmpc_bench.simulation.closed_loop import simulate, simulate_block
from rmpc_bench.simulation.moments import exact_laws
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.types import Command, Controller

A, B, C = np.array([[1.0, 0.1], [0.0, 0.98]]), np.array([[0.005], [0.1]]), np.array([[1.0, 0.0]])
Q, R, QX, RU = np.diag([1e-5, 1e-3]), np.array([[4e-3]]), np.diag([1.0, 0.1]), np.array([[0.1]])
PP = la.solve_discrete_are(A.T, C.T, Q, R)
L = PP @ C.T @ np.linalg.inv(C @ PP @ C.T + R)
MATRICES = "A: [[1, 0.1], [0, 0.98]], B: [[0.005], [0.1]], C: [[1, 0]]"
TEXT = """
version: 1
name: late
seed: 11
runs: RUNS
time: {steps: STEPS}
plant: {kind: linear, MATRICES}
model: {kind: linear, MATRICES, P_w: [1e-5, 1e-3], P_v: 4e-3, delay: same}
noise: {process: same, measurement: {sum: [same, {delayed: LATE}]}, input: INPUT}
initial: {x: START, P: FIRST}
reference: REFERENCE
estimator: {kind: kalman}
controller: CONTROLLER
methods: METHODS
metrics: [mse, input_power]
record: {runs: all, signals: [y, u, u_command, x, x_hat]}
"""
LQR = "{kind: control-lqr, Q_x: [1, 0.1], R_u: 0.1}"


def load(directory, *, delay, methods="{K: {}, N: {model: {delay: none}}}", **keys):
    """Load the system of the page with this delay of the input; other keys replace words of the text."""
    given = {"RUNS": 3, "STEPS": 60, "START": 0, "FIRST": PP.tolist(), "REFERENCE": "{kind: constant, value: 0}"}
    given |= {"LATE": 0, "INPUT": delay if isinstance(delay, str) else f"{{delayed: {delay}}}", "CONTROLLER": LQR}
    text = TEXT.replace("METHODS", methods).replace("MATRICES", MATRICES)
    for name, value in (given | keys).items():
        text = text.replace(name, str(value))
    path = directory / "late.yaml"
    path.write_text(text)
    return load_config(path).experiment


def stationary(of_plant, of_model):
    """Return the spectral radius, E x1^2, E u^2 and estimation_mse of the loop, from a Lyapunov equation.

    Each argument has the delays of the input and of the measurement.  The state is [x(k) .. x(k-D); x_pred; u(k-1) ..].
    """
    K = la.solve_discrete_are(A, B, QX, RU)
    K = np.linalg.solve(RU + B.T @ K @ B, B.T @ K @ A)
    (du, dy), (mu, my), n = of_plant, of_model, 2
    D = max(du, dy, mu + my, 1) + 1
    N = n * (D + 2) + D
    eye = np.eye(N)
    x_pred, past = eye[n * (D + 1) : n * (D + 2)], [eye[n * (D + 2) + j][None] for j in range(D)]
    updated, of_v = x_pred + L @ C @ (eye[n * dy : n * dy + n] - x_pred), np.hstack([np.zeros((n, n)), L])
    ahead, ahead_v, x_hat, x_hat_v = updated, of_v, updated, of_v
    for i in range(my + mu):
        ahead, ahead_v = A @ ahead + B @ past[my + mu - i - 1], A @ ahead_v
        if i == my - 1:
            x_hat, x_hat_v = ahead, ahead_v
    u, u_v = -K @ ahead, -K @ ahead_v
    acting, acting_v = (past[du - 1], 0.0 * u_v) if du else (u, u_v)
    known, known_v = (past[mu + my - 1], 0.0 * u_v) if mu + my else (u, u_v)
    F, G = np.eye(N, k=-n), np.zeros((N, n + 1))
    F[:n], G[:n] = A @ eye[:n] + B @ acting, np.hstack([np.eye(n), np.zeros((n, 1))]) + B @ acting_v
    F[n * (D + 1) : n * (D + 2)], G[n * (D + 1) : n * (D + 2)] = A @ updated + B @ known, A @ of_v + B @ known_v
    F[n * (D + 2) :] = np.vstack([u, *past[:-1]])
    G[n * (D + 2)] = u_v
    W = la.block_diag(Q, R)
    S = la.solve_discrete_lyapunov(F, G @ W @ G.T)
    e = x_hat - eye[:n]
    mse = np.trace(e @ S @ e.T + x_hat_v @ W @ x_hat_v.T) / 2
    power = (u @ S @ u.T + u_v @ W @ u_v.T)[0, 0]
    return max(abs(np.linalg.eigvals(F))), S[0, 0], power, mse


CASES = {
    (0, 0, "same"): (0.872019, 0.005612613, 0.036877631, 0.003402079),
    (1, 0, "same"): (0.872019, 0.006924519, 0.040489586, 0.003402079),
    (1, 0, "none"): (0.927515, 0.006862056, 0.042872365, 0.003619711),
    (0, 2, "same"): (0.872019, 0.008421933, 0.044221661, 0.004585664),
    (0, 2, "none"): (0.957350, 0.009096706, 0.052726569, 0.005385757),
    (1, 2, "same"): (0.872019, 0.010112566, 0.048063835, 0.004585664),
}
"""Delays of the input and the measurement, and the key `delay` -> values of the page, to the digits given."""


@pytest.mark.parametrize(("delay", "late", "known"), CASES)
def test_stationary_values_of_the_whole_loop(tmp_path, delay, late, known):
    """The loop is linear: variances are sums of squares of its answers to single noises.  Oracle: Lyapunov equation."""
    method = f"{{K: {{model: {{delay: {known}}}}}}}"
    experiment = load(tmp_path, delay=delay, LATE=late, STEPS=900, methods=method)
    plant, [method] = experiment.plant, experiment.methods
    draws = experiment.scenario.draw(plant, range(3), 900)
    w, v = np.zeros_like(draws.w), np.zeros_like(draws.v)
    # Late: without its first measurements the filter is not stationary at once.
    w[:2, 200], v[2, 200] = np.sqrt(Q), np.sqrt(R[0])
    record, status = simulate(plant, method, draws._replace(w=w, v=v), np.zeros((904, 1)), 900)
    assert not status.any()
    e = record.x_hat - record.x
    found = [np.sum(record.x[:, :, 0] ** 2), np.sum(record.u**2), np.sum(e**2) / 2]
    radius, *expected = stationary((delay, late), (delay, late) if known == "same" else (0, 0))
    np.testing.assert_allclose(found, expected, rtol=1e-9)  # the answers of 700 samples, of radius 0.957 or less
    np.testing.assert_allclose([radius, *expected], CASES[delay, late, known], rtol=0, atol=5.1e-7)
    np.testing.assert_allclose(expected, CASES[delay, late, known][1:], rtol=0, atol=5.1e-10)


def test_simulated_values(tmp_path):
    """Runs with noise, from the stationary start of the filter; oracle: the same values, 5 standard errors."""
    experiment = load(tmp_path, delay=1, RUNS=100, STEPS=600)
    for method in experiment.methods:
        record = simulate_block(experiment, method, range(100)).traces
        x, u, e = record["x"][:, 200:600], record["u"][:, 200:], record["x_hat"][:, 200:600]
        expected = stationary((1, 0), (1 if method.name == "K" else 0, 0))[1:]
        for samples, value in zip((x[..., 0] ** 2, u[..., 0] ** 2, (e - x) ** 2), expected, strict=True):
            assert within_stat(samples.reshape(100, -1).mean(axis=1), value)


def augmented(d):
    """Return A and B of [x(k); u(k-d) .. u(k-1)]."""
    Aa, Ba = np.zeros((2 + d, 2 + d)), np.zeros((2 + d, 1))
    Aa[:2, :2], Aa[:2, 2], Ba[-1] = A, B[:, 0], 1.0
    Aa[2:-1, 3:] = np.eye(d - 1)
    return Aa, Ba


@pytest.mark.parametrize("d", [1, 2, 3])
def test_the_law_is_the_optimal_one_of_the_augmented_state(tmp_path, d):
    """Oracle: the stationary Riccati equation of the state and the inputs on their way, to 5e-14."""
    Aa, Ba = augmented(d)
    X = la.solve_discrete_are(Aa, Ba, la.block_diag(QX, np.zeros((d, d))), RU)
    K = np.linalg.solve(RU + Ba.T @ X @ Ba, Ba.T @ X @ Aa)
    experiment = load(tmp_path, delay=d, RUNS=2)
    traces = simulate_block(experiment, experiment.methods[0], range(2)).traces
    sent = np.hstack([np.zeros((2, d)), traces["u_command"][:, :, 0]])
    for k in range(60):
        state = np.hstack([traces["x_hat"][:, k], sent[:, k : k + d]])
        np.testing.assert_allclose(sent[:, k + d], -state @ K[0], rtol=0, atol=5e-14)
    np.testing.assert_array_equal(traces["u"][:, d:], traces["u_command"][:, :-d])
    assert not traces["u"][:, :d].any()


def same_as_augmented(directory, d, ours, theirs, **keys):
    """Assert that a law with a delay is that of the augmented model with other horizons, and return the inputs."""
    Aa, Ba = augmented(d)
    model = f"kind: linear, A: {Aa.tolist()}, B: {Ba.tolist()}, C: {[[1.0, *[0.0] * (d + 1)]]}"
    noise = f"P_w: {[1e-5, 1e-3, *[0.0] * d]}, P_v: 4e-3"
    known = f"D: {{controller: {{{ours}}}}}"
    other = f"X: {{model: {{{model}, {noise}, delay: none}}, controller: {{{theirs}}}}}"
    given = {"FIRST": "process", "START": "[1, 0]"} | keys
    experiment = load(directory, delay=d, methods=f"{{{known}, {other}}}", **given)
    first, second = (simulate_block(experiment, method, range(3)).traces for method in experiment.methods)
    assert not first["u"][:, :d].any() and np.abs(first["u"]).max() > 1.0
    for signal, ours in first.items():
        theirs = second[signal][..., : ours.shape[2]]
        np.testing.assert_allclose(ours, theirs, **ROUND, atol=1e-12 * np.abs(ours).max())


MPC, LIMITED = "kind: mpc, Hu: 3, Q: 1, R: 0.1", "limits: {u: [-2, 2], du: [-1, 1]}"
OPTIMISED = LIMITED.replace("}", ", enforce: qp}")
GPC = "kind: gpc, Q_yw: 1, Q_u: 0.3"


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (f"{MPC}, Hp: 10", f"{MPC}, Hp: 12"),
        (f"{MPC}, Hp: 10, {LIMITED}", f"{MPC}, Hp: 12, {LIMITED}"),
        (f"{MPC}, Hp: 10, {OPTIMISED}", f"{MPC}, Hp: 12, {OPTIMISED}"),
        (f"{GPC}, Np: 10", f"{GPC}, Np: 12"),
    ],
)
def test_horizons_and_reference_count_from_where_the_input_acts(tmp_path, ours, theirs):
    """Oracle: the law of the model whose states are x and the inputs on their way, with a horizon longer by d."""
    same_as_augmented(tmp_path, 2, ours, theirs, REFERENCE="{kind: square, values: [0, 1], period: 40}")


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("kind: lqr, horizon: 5, Q_x: [1, 0.1], R_u: 0.1", "kind: lqr, horizon: 7, Q_x: [1, 0.1, 0, 0], R_u: 0.1"),
        ("kind: lqg, Q_y: 1, Q_i: 0.05, R_u: 0.1", None),
        ("kind: lqg, Q_y: 1, Q_i: 0.05, R_u: 0.1, on: estimate", None),
        ("kind: lqg, Q_y: 1, Q_i: 0, R_u: 0.1", None),
    ],
)
def test_state_feedback_and_integrals_are_those_of_the_augmented_model(tmp_path, ours, theirs):
    """Oracle: the same design for the augmented model, from a start outside of rest, with the reference 0."""
    same_as_augmented(tmp_path, 2, ours, theirs or ours)


def test_sums_of_lqg_have_the_predicted_errors(tmp_path):
    """Oracle: the law written out from recorded signals without noise; the reference changes."""
    law, r = "{kind: lqg, Q_y: 1, Q_i: 0.05, R_u: 0.1}", "{kind: square, values: [1, 3], period: 20}"
    experiment = load(tmp_path, delay=2, CONTROLLER=law, REFERENCE=r, RUNS=1, methods="{K: {}}")
    plant, [method] = experiment.plant, experiment.methods
    draws = experiment.scenario.draw(plant, range(1), 60)
    draws = draws._replace(w=0.0 * draws.w, v=0.0 * draws.v)
    target = experiment.scenario.reference.sample(70)
    record = simulate(plant, method, draws, target, 60)[0]
    x, u, r, gains = record.x[0], record.u[0], target[:, 0], method.controller
    np.testing.assert_allclose(record.x_hat, record.x, rtol=0, atol=1e-12)
    for k in range(58):
        q = np.sum(x[: k + 2, 0] - r[: k + 2])
        expected = gains.K_r[0, 0] * r[k + 2] - gains.K_x[0] @ x[k + 2] - gains.K_q[0, 0] * q
        np.testing.assert_allclose(u[k + 2, 0], expected, rtol=1e-10, atol=1e-12)


class Watch(Controller):
    """Sends given inputs and keeps the estimates that it gets."""

    def __init__(self, u):
        self.sent, self.x_hat, self.info = u, [], []

    def init(self, n_runs):
        return None

    def control(self, k, state, y, estimate, r):
        self.x_hat.append(estimate.x_hat)
        return state, Command(np.tile(self.sent[len(self.x_hat) - 1], (len(y), 1)))


def watched(experiment, **changes):
    """Simulate without noise with given inputs; return the record and the predicted estimates of run 0."""
    plant, [method], n = experiment.plant, experiment.methods, experiment.n_steps
    law = Watch(np.random.default_rng(1).standard_normal((n, plant.nu)))
    draws = experiment.scenario.draw(plant, range(2), n)
    draws = draws._replace(w=0.0 * draws.w, v=0.0 * draws.v, **changes)
    record, status = simulate(plant, method._replace(controller=law), draws, np.zeros((n + 9, plant.ny)), n)
    assert not status.any()
    return record, np.array(law.x_hat)[:, 0]


PENDULUM = """
import math

def rhs(t, x, u, p):
    return [x[1], -math.sin(x[0]) - 0.2 * x[1] + u[0] + 0.5 * math.sin(3.0 * t)]

def out(x, p):
    return [x[0]]
"""
NONLINEAR = """
version: 1
name: pendulum
runs: 2
time: {step: 0.1, steps: 30}
plant: {ode: eq.py:rhs, output: eq.py:out, states: [th, om], inputs: [m], outputs: [angle]}
model: {MODEL, noise: {process: 1e-4, measurement: 1e-2}}
noise: {input: {delayed: 3}}
initial: {x: [0.5, -1], x_hat: [0.5, -1], P: 0.1}
reference: {kind: constant, value: 0}
estimator: {kind: ESTIMATOR}
controller: {kind: gpc, Np: 5, Q_yw: 1, Q_u: 1}
methods: {M: {}}
metrics: [mse]
"""


@pytest.mark.parametrize(
    ("model", "filter_"),
    [("nonlinear: plant, at: {x: [0, 0], u: 0}", "extended-kalman"), ("linearise: plant, at: trajectory", "kalman")],
)
def test_nonlinear_models_predict_by_their_equation(tmp_path, model, filter_):
    """Oracle: without noise the filter is exact, and so are its predictions, also of an equation with the time."""
    (tmp_path / "eq.py").write_text(PENDULUM)
    path = tmp_path / "late.yaml"
    path.write_text(NONLINEAR.replace("MODEL", model).replace("ESTIMATOR", filter_))
    experiment = load_config(path).experiment
    assert experiment.methods[0].delay.input == 3
    record, ahead = watched(experiment)
    np.testing.assert_allclose(record.x_hat, record.x, rtol=1e-5, atol=1e-5)  # error control of plant and model
    np.testing.assert_allclose(ahead[:-2], record.x[0, 3:], rtol=1e-5, atol=1e-5)
    method = experiment.methods[0]
    block = simulate_block(experiment, method, range(2))  # the law itself: every sample linearised where it predicts
    assert not block.status.any() and np.isfinite(block.metrics).all()


def test_disturbances_and_means_are_held(tmp_path):
    """Oracle: the exact prediction with the estimated disturbance, and with the estimated mean of the noise."""
    model = "model: {disturbance: {at: input, drift: 1e-3}}"
    experiment = load(tmp_path, delay=2, methods=f"{{K: {{{model}, controller: {{{MPC}, Hp: 9}}}}}}")
    record, ahead = watched(experiment, x0=np.array([[1.0, 2.0]] * 2))
    x = record.x_hat[0, 10]
    for j in (10, 11):
        x = A @ x + B[:, 0] * (record.u[0, j, 0] + ahead[10, 2])
    assert ahead.shape[1] == 3 and abs(ahead[10, 2]) > 1e-3
    np.testing.assert_allclose(ahead[10, :2], x, rtol=1e-12, atol=1e-12)
    filter_ = "estimator: {kind: kalman-disturbance, drift: 1e-3}"
    experiment = load(tmp_path, delay=2, methods=f"{{K: {{{filter_}, controller: {{{MPC}, Hp: 9}}}}}}")
    method = experiment.methods[0]
    assert method.estimator.estimates_mean
    draws = experiment.scenario.draw(experiment.plant, range(2), 60)
    law = Watch(np.ones((60, 1)))
    record, _ = simulate(
        experiment.plant, method._replace(controller=law), draws, np.zeros((70, 1)), 60, info={"w_mean"}
    )
    x = record.x_hat[:, 10]
    for j in (10, 11):
        x = x @ A.T + record.u[:, j] @ B.T + record.info["w_mean"][:, 10]
    np.testing.assert_allclose(law.x_hat[10], x, rtol=1e-12, atol=1e-12)


def test_a_model_that_depends_on_the_state_predicts_with_its_matrices(rng):
    """Oracle: the matrices at the state, sample by sample."""
    slide = moving_slide(0.01, noise=SlideNoise(process=1.0, measurement=1e-6))
    flow, x = prediction_flow(slide), 0.1 * rng.standard_normal((3, slide.nx))
    u = rng.standard_normal((3, slide.nu))
    pair = slide.at_state(x)
    expected = [a @ z + b @ v for a, b, z, v in zip(pair.A, pair.B, x, u, strict=True)]
    np.testing.assert_allclose(flow.advance(0, x, u), expected, **ROUND, atol=1e-15)
    np.testing.assert_allclose(flow.measure(0, x), x @ slide.C.T, **ROUND)


def test_pid_uses_y_as_it_is(tmp_path):
    """`on: y` is the law without the key; `on: estimate` controls the prediction.  Oracle: P control written out."""
    law = "kind: pid, Kp: 2"
    methods = ", ".join(
        f"{name}: {{model: {{delay: {delay}}}, controller: {{{law}, on: {on}}}}}"
        for name, delay, on in (("K", "same", "y"), ("N", "none", "y"), ("P", "same", "estimate"))
    )
    keys = {"START": "[1, 0]", "REFERENCE": "{kind: square, values: [0, 1], period: 10}"}
    experiment = load(tmp_path, delay=2, methods=f"{{{methods}}}", **keys)
    known, unknown, predicted = (simulate_block(experiment, each, range(2)).traces for each in experiment.methods)
    np.testing.assert_array_equal(known["u"], unknown["u"])
    r = experiment.scenario.reference.sample(70)[:, 0]
    for k in range(2, 58):
        x = predicted["x_hat"][:, k]
        for j in (k, k + 1):
            x = x @ A.T + predicted["u"][:, j] @ B.T
        np.testing.assert_allclose(predicted["u_command"][:, k, 0], 2.0 * (r[k + 2] - x[:, 0]), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("law", ["kind: mpc, Hp: 10, Hu: 3, Q: 1, R: 0.01", "kind: gpc, Np: 8, Q_yw: 1, Q_u: 0.1"])
def test_a_constant_reference_needs_no_preview(tmp_path, law):
    """Oracle: the law that knows it; a step of the reference is not known before it comes."""
    laws = "{K: {controller: {LAW}}, N: {controller: {LAW, preview: false}}}".replace("LAW", law)
    records = []
    for reference in ("{kind: constant, value: 1}", "{kind: square, values: [0, 1], period: 40}"):
        found = load(tmp_path, delay=2, methods=laws, REFERENCE=reference, LATE=0)
        draws = found.scenario.draw(found.plant, range(1), found.n_steps)
        r = found.scenario.reference.sample(found.n_steps + 30)
        records += [simulate(found.plant, method, draws, r, found.n_steps)[0] for method in found.methods]
    np.testing.assert_allclose(records[0].u, records[1].u, **ROUND)
    step, blind = records[2:]
    still = load(tmp_path, delay=2, methods=laws, LATE=0)
    r = np.zeros((still.n_steps + 30, 1))
    rest = simulate(still.plant, still.methods[1], draws, r, still.n_steps)[0]
    np.testing.assert_array_equal(blind.command[:, :20], rest.command[:, :20])
    assert np.abs(step.command[:, :20] - rest.command[:, :20]).max() > 1e-3


def test_exact_moments_refuse_it(tmp_path):
    """The moments of an estimator that predicts with u(k-d) are not computed."""
    found = load(tmp_path, delay="none", methods="{K: {model: {delay: {input: 2}}}}")
    method = found.methods[0]._replace(controller=Rest(1))
    assert exact_laws(found.plant, method, found.scenario) == "the design model has a delay of the input"
