"""Gains after gaps: filters whose gains are computed before the run, against replays in NumPy, run by run.

The replays use plain inverses and covariances.  They take the outputs that are there as the whole measurement.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import random_model, random_psd
from scipy.optimize import brentq

from rmpc_bench.config_file.factories import estimator
from rmpc_bench.estimators.bridging import RunByRun
from rmpc_bench.estimators.kalman import stationary_filter
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.types import DesignError, Status

STEPS = 30
CLOSE = {"rtol": 1e-8, "atol": 1e-10}


@pytest.fixture
def system(rng):
    """Return a model of three states and two outputs, and data of four runs; the first one has no gaps."""
    model = random_model(rng, 3, 1, 2, 0.9)
    model = LinearModel(model.A, model.B, model.C, model.Q_w, model.R_v, f0=[0.1, 0.0, -0.2], d0=[0.3, 0.0])
    y, u = rng.standard_normal((4, STEPS + 1, 2)), rng.standard_normal((4, STEPS + 1, 1))
    y[1:][rng.random((3, STEPS + 1, 2)) < 0.4] = np.nan
    y[2, 8:14] = np.nan
    return model, {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3)}, y, u


def filtered(design, y, u):
    """Return x_hat, P and the status of all runs."""
    state, x_hat, P, status = design.init(len(y)), [], [], []
    for k in range(y.shape[1]):
        state, found = design.correct(k, state, y[:, k])
        x_hat.append(found.x_hat)
        P.append(
            np.zeros((len(y), 1, 1)) if found.P is None else np.broadcast_to(found.P, (len(y), *found.P.shape[-2:]))
        )
        status.append(found.status)
        state = design.predict(k, state, u[:, k])
    return np.stack(x_hat, axis=1), np.stack(P, axis=1), np.stack(status, axis=1)


def replay(model, start, y, u, before, after=lambda V, C, R, P: P):
    """Filter one run: V = before(P_pred), a Kalman correction of V, and P_next from after(V, C, R, P)."""
    x, P, found = start["x0"], start["P0"], []
    for k in range(len(y)):
        there = ~np.isnan(y[k])
        C, R = model.C[there], model.R_v[np.ix_(there, there)]
        V = before(P)
        L = V @ C.T @ np.linalg.inv(C @ V @ C.T + R)
        x_hat = x + L @ (y[k] - model.d0 - model.C @ x)[there]
        P_hat = V - L @ C @ V
        found.append((x_hat, P_hat))
        x = model.A @ x_hat + model.B @ u[k] + model.f0
        P = model.A @ after(V, C, R, P_hat) @ model.A.T + model.Q_w
    return [np.array(each) for each in zip(*found, strict=True)]


def worst(c):
    """Return P -> V of zenere2018, (13) and (16), by a search for theta."""

    def before(P):
        def divergence(theta):
            S = np.linalg.inv(np.eye(len(P)) - theta * P)
            return np.trace(S) - len(P) - np.linalg.slogdet(S)[1] - c

        theta = brentq(divergence, 0.0, (1.0 - 1e-9) / np.linalg.eigvalsh(P)[-1], xtol=1e-16, rtol=1e-14)
        return np.linalg.inv(np.linalg.inv(P) - theta * np.eye(len(P)))

    return before


REPLAYS = {
    "robust-kalman": ({"c": 0.3}, worst(0.3), lambda V, C, R, P: P),
    "risk-sensitive": (
        {"theta": 0.02},
        lambda P: np.linalg.inv(np.linalg.inv(P) - 0.02 * np.eye(3)),
        lambda V, C, R, P: P,
    ),
    "h-infinity": (
        {"theta": 0.02},
        lambda P: P,
        lambda V, C, R, P: np.linalg.inv(np.linalg.inv(V) - 0.02 * np.eye(3) + C.T @ np.linalg.inv(R) @ C),
    ),
    "kalman": ({}, lambda P: P, lambda V, C, R, P: P),
    "fading-kalman": ({"alpha": 1.2}, lambda P: P, lambda V, C, R, P: 1.44 * P),
}


@pytest.mark.parametrize("kind", REPLAYS)
def test_every_run_has_the_gains_of_its_own_gaps(kind, system):
    """Oracle: the recursion with plain inverses, run by run."""
    model, start, y, u = system
    keys, before, after = REPLAYS[kind]
    x_hat, P, status = filtered(estimator(kind, model, n_steps=STEPS, **start, **keys), y, u)
    assert not status.any()
    for run in range(len(y)):
        expected = replay(model, start, y[run], u[run], before, after)
        np.testing.assert_allclose(x_hat[run], expected[0], **CLOSE)
        if kind != "h-infinity":
            np.testing.assert_allclose(P[run], expected[1], **CLOSE)


def test_with_a_tiny_ball_the_robust_filter_bridges_gaps_as_kalman(rng):
    """Oracle: the Kalman filter replayed with inverses; V exceeds P_pred by the factor 1 + (2 c)^1/2 = 1 + 1.4e-6."""
    A, C = np.array([[1.0, 0.1], [0.0, 0.98]]), np.array([[1.0, 0.0]])
    model = LinearModel(A, np.zeros((2, 1)), C, np.diag([1e-4, 1e-2]), [[0.04]])
    n_runs, n_steps = 6, 200
    x, y, u = np.zeros((n_runs, n_steps + 1, 2)), np.zeros((n_runs, n_steps + 1, 1)), np.zeros((n_runs, n_steps + 1, 1))
    x[:, 0] = rng.standard_normal((n_runs, 2))
    for k in range(n_steps):
        x[:, k + 1] = x[:, k] @ A.T + rng.standard_normal((n_runs, 2)) * [1e-2, 1e-1]
    y[:] = x[..., :1] + 0.2 * rng.standard_normal(y.shape)
    begins = rng.random((n_runs, n_steps + 1)) < 0.167  # 60 % are missing
    lost = np.array([[begins[i, max(0, k - 4) : k + 1].any() for k in range(n_steps + 1)] for i in range(n_runs)])
    y[lost] = np.nan
    start = {"x0": np.zeros(2), "P0": np.eye(2)}
    errors = [
        ((filtered(estimator(kind, model, n_steps=n_steps, **start, **keys), y, u)[0] - x) ** 2).mean()
        for kind, keys in (("kalman", {}), ("robust-kalman", {"c": 1e-12}))
    ]
    replayed = [replay(model, start, y[run], u[run], lambda P: P)[0] for run in range(n_runs)]
    np.testing.assert_allclose(errors, ((np.array(replayed) - x) ** 2).mean(), rtol=2e-6)
    assert 0.5 < lost.mean() < 0.7


def uncertain(rng, rows=slice(None)):
    """Return a model with uncertainty in every matrix, with some of its two outputs, and without input."""
    shapes = {"A": (3, 3), "C": (2, 3), "H_A": (3, 2), "G_x": (2, 3), "H_C": (2, 2), "Dw": (2, 2), "Bw": (3, 2)}
    shapes |= {"H_Bw": (3, 1), "G_w": (1, 2), "Dv": (2, 2), "H_Dv": (2, 1), "G_v": (1, 2)}
    given = {name: 0.3 * rng.standard_normal(shape) for name, shape in shapes.items()}
    given |= {"A": given["A"] + 0.3 * np.eye(3), "Dv": given["Dv"] + np.eye(2), "B": np.zeros((3, 1))}
    given |= {name: given[name][rows] for name in ("C", "H_C", "Dw", "Dv", "H_Dv")}
    return uncertain_model(STEPS, **given, W=random_psd(rng, 2).tolist(), V=np.eye(2).tolist())


UNCERTAIN = [
    ("enhanced-robust", {}), ("enhanced-robust", {"tuned": True}), ("enhanced-robust", {"equations": "printed"}),
    ("robust-h-infinity", {"alpha": 20.0, "theta": 1e-3}), ("lmmse", {}), ("lmmse", {"form": "filter"}),
    ("kalman-predictor", {}),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "keys"), UNCERTAIN)
def test_an_output_that_is_always_missing_is_one_that_the_model_does_not_have(kind, keys):
    """Oracle: the design of the uncertain model without that output."""
    models = [uncertain(np.random.default_rng(5), rows) for rows in (slice(None), slice(1, 2), slice(0, 1))]
    start = {"x0": np.array([0.2, -0.1, 0.3]), "P0": np.diag([0.5, 0.2, 0.1])}
    y, u = np.random.default_rng(6).standard_normal((2, STEPS + 1, 2)), np.zeros((2, STEPS + 1, 1))
    whole, *fewer = [estimator(kind, model, n_steps=STEPS, **start, **keys) for model in models]
    for output, design in enumerate(fewer):
        broken = y.copy()
        broken[:, :, output] = np.nan
        found, expected = filtered(whole, broken, u), filtered(design, np.delete(y, output, axis=2), u)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "keys"),
    [
        ("wasserstein-kalman", {"radius": 0.3, "tolerance": 1e-14}),
        ("mixed", {}),
        ("set-membership", {"inflate": False}),
    ],
)
def test_an_output_that_is_always_missing_is_left_out_of_balls_and_sets(kind, keys, rng):
    """Oracle: the design of the model without that output; a gap of all outputs has closed forms."""
    A, C, B = 0.5 * rng.standard_normal((3, 3)), rng.standard_normal((2, 3)), np.zeros((3, 1))
    covariances = {"P_w": random_psd(rng, 3), "P_v": np.diag([0.5, 0.2])}
    sets = {} if kind == "wasserstein-kalman" else {"M_w": np.diag([0.1, 0.2, 0.1])}
    M_v = None if kind == "wasserstein-kalman" else np.diag([0.3, 0.4])
    start = {"x0": np.zeros(3), "P0": np.eye(3)} | ({} if M_v is None else {"M0": 2.0 * np.eye(3)})

    def made(rows):
        given = covariances | {"P_v": covariances["P_v"][np.ix_(rows, rows)]}
        bounded = sets if M_v is None else sets | {"M_v": M_v[np.ix_(rows, rows)]}
        return estimator(
            kind, mixed_model(STEPS, A=A, B=B, C=C[rows], **given, **bounded), n_steps=STEPS, **start, **keys
        )

    y, u = rng.standard_normal((2, 10, 2)), np.zeros((2, 10, 1))
    broken = y.copy()
    broken[:, :, 0] = np.nan
    for one, other in zip(filtered(made([0, 1]), broken, u), filtered(made([1]), y[:, :, 1:], u), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)
    if kind != "wasserstein-kalman":
        return
    broken[:] = np.nan
    P = np.eye(3)
    for found in filtered(made([0, 1]), broken, u)[1][0]:
        P = P * (1.0 + 0.3 / np.sqrt(np.trace(P))) ** 2
        np.testing.assert_allclose(found, P, rtol=1e-9)
        P = A @ P @ A.T + covariances["P_w"]


def test_the_set_of_a_run_with_gaps_contains_the_error(rng):
    """Oracle: worst noises on the boundary of their sets."""
    A, C = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0]])
    model = mixed_model(40, A=A, B=np.zeros((2, 1)), C=C, M_w=0.1, M_v=0.2)
    design = estimator(
        "set-membership", model, n_steps=40, x0=np.zeros(2), P0=np.zeros((2, 2)), M0=np.eye(2), inflate=False
    )
    x, state = 0.7 * rng.uniform(-1.0, 1.0, (20, 2)), design.init(20)
    for k in range(40):
        y = x @ C.T + np.sqrt(0.2) * rng.choice([-1.0, 1.0], (20, 1))
        y[rng.random(20) < 0.5] = np.nan
        state, estimate = design.correct(k, state, y)
        assert not np.any(estimate.status)
        e = x - estimate.x_hat
        M = np.broadcast_to(estimate.M, (20, 2, 2))
        assert (np.einsum("ri,rij,rj->r", e, np.linalg.inv(M), e) <= 1.0 + 1e-9).all()
        state = design.predict(k, state, np.zeros((20, 1)))
        w = rng.standard_normal((20, 2))
        x = x @ A.T + np.sqrt(0.1) * w / np.linalg.norm(w, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", ["steady", "control-lqe"])
def test_steady_gains_end_at_the_first_gap(kind, system):
    """Oracle: kalman from the steady covariance."""
    model, start, y, u = system
    steady = estimator("kalman-predictor", model, n_steps=STEPS, **start, gain="steady")
    P = steady.P[0]
    form = "predictor" if kind == "steady" else "filter"
    design = steady if kind == "steady" else stationary_filter(model, start["x0"], steady.K[0], P, form)
    expected = filtered(estimator("kalman", model, n_steps=STEPS, x0=start["x0"], P0=P, form=form), y, u)
    for one, other in zip(filtered(design, y, u), expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9)


def test_correlated_noises(system, rng):
    """Oracle: the predictor with K = (A P C' + S) (C P C' + R)^-1 of the outputs that are there."""
    model, start, y, u = system
    joint = random_psd(rng, 5)
    model = LinearModel(model.A, model.B, model.C, joint[:3, :3], joint[3:, 3:], S_wv=joint[:3, 3:])
    x_hat, P_found, _ = filtered(estimator("kalman-predictor", model, n_steps=STEPS, **start), y, u)
    for run in range(len(y)):
        x, P = start["x0"], start["P0"]
        for k in range(STEPS + 1):
            np.testing.assert_allclose(x_hat[run, k], x, **CLOSE)
            np.testing.assert_allclose(P_found[run, k], P, **CLOSE)
            there = ~np.isnan(y[run, k])
            C, R, S = model.C[there], model.R_v[np.ix_(there, there)], model.S_wv[:, there]
            Y = C @ P @ C.T + R
            K = (model.A @ P @ C.T + S) @ np.linalg.inv(Y)
            x = model.A @ x + model.B @ u[run, k] + K @ (y[run, k] - model.C @ x)[there]
            P = model.A @ P @ model.A.T + model.Q_w - K @ Y @ K.T


@pytest.mark.parametrize(("kind", "keys"), [("h-infinity", {"fraction": 0.95}), ("risk-sensitive", {"theta": 0.2})])
def test_a_gap_in_which_theta_is_too_large_has_no_weight(kind, keys):
    """Oracle: a scalar recursion, in which theta counts where it is admissible."""
    model = LinearModel([[0.99]], [[0.0]], [[1.0]], [[1.0]], [[1.0]])
    start = {"x0": np.zeros(1), "P0": np.eye(1)}
    y = np.zeros((1, STEPS + 1, 1))
    y[0, 5:25] = np.nan
    design = estimator(kind, model, n_steps=STEPS, **start, **keys)
    x_hat, _, status = filtered(design, y, np.zeros((1, STEPS + 1, 1)))
    theta = design.extra["theta"][0]
    assert np.isfinite(x_hat).all() and not status.any()
    y[0, :5] = y[0, 25:] = 1.0
    x_hat, _, _ = filtered(design, y, np.zeros((1, STEPS + 1, 1)))
    x, P, reduced = 0.0, 1.0, 0
    for k in range(STEPS + 1):
        there = not np.isnan(y[0, k, 0])
        if kind == "risk-sensitive" and theta * P < 1.0:
            P = 1.0 / (1.0 / P - theta)
        L = P / (P + 1.0) if there else 0.0
        x += L * (1.0 - x)
        P -= L * P
        np.testing.assert_allclose(x_hat[0, k, 0], x, **CLOSE)
        reduced += theta * P >= 1.0
        if kind == "h-infinity" and theta * P < 1.0:
            P = 1.0 / (1.0 / P - theta)
        x, P = 0.99 * x, 0.99**2 * P + 1.0
    assert reduced > 5


@pytest.mark.parametrize("error", [ValueError, DesignError])
def test_only_a_run_without_gains_is_infeasible(error, system):
    """Oracle: the same filter whose recursion has gains for every run, bit for bit."""
    model, start, y, u = system
    made = estimator("lmmse", model, n_steps=STEPS, **start)
    fails = []

    def one(k, kept, there):
        if k == 8 and not there.any():
            fails.append(k)
            raise error("no gains")
        return made.recursion.one(k, kept, there)

    y[[1, 3], 8] = 0.5
    found, expected = (filtered(each, y, u) for each in (replace(made, recursion=RunByRun(one)), made))
    assert fails == [8]
    for values, others in zip(found, expected, strict=True):
        np.testing.assert_array_equal(values[[0, 1, 3]], others[[0, 1, 3]])
    assert not found[2][[0, 1, 3]].any() and not found[2][2, :8].any()
    assert (found[2][2, 8:] == Status.INFEASIBLE).all()
