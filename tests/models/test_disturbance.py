"""Disturbances as further states: places, ranks, what is refused, and the model of every kind against x and d apart."""

import pickle

import numpy as np
import pytest
from conftest import random_model, random_psd

from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.disturbance import Disturbance, DisturbanceGains, augmented, entry_of, rank_and_size
from rmpc_bench.models.disturbed import with_disturbance
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed
from rmpc_bench.models.moving_slide import design as moving_slide
from rmpc_bench.models.servo import ServoNoise
from rmpc_bench.models.servo import design as servo
from rmpc_bench.models.uncertain_linear import design as uncertain
from rmpc_bench.types import DesignError

SERVO = servo(0.1, noise=ServoNoise(1.0, 1.0))
NULL = np.array([1.0, 0.0, 20.0, 0.0, -1.0])
"""Load and motor turn together, and the measurement has the opposite offset: nobody sees it."""


def with_places(model, at, drift=0.1, n_steps=5, **keys):
    return with_disturbance(model, Disturbance(at=at, drift=drift, **keys), n_steps, np.zeros(model.nx))


@pytest.mark.parametrize(
    ("at", "expected"),
    [
        ("input", (5, 5)),
        ("load", (5, 5)),
        ("output", (4, 5)),
        (["input", "output"], (5, 6)),
        (DisturbanceGains(B_d=1.0), (5, 8)),
    ],
)
def test_ranks_of_the_servomechanism(at, expected):
    """Oracle: the null vector of the integrator by hand (output), and one output for nd disturbances."""
    entry = entry_of(SERVO, Disturbance(at=at, drift=1.0))
    found = rank_and_size(SERVO.A, entry.B_d(SERVO.B), SERVO.C, entry.C_d)
    assert found == expected
    if found[0] == found[1]:
        with_places(SERVO, at)
    else:
        with pytest.raises(DesignError, match=rf"rank of \[A - I, B_d; C, C_d\] is {found[0]}, .* = {found[1]} is"):
            with_places(SERVO, at)


def test_the_rank_does_not_depend_on_units(rng):
    """States in other units, a disturbance in other units: the same rank, also far from 1."""
    scale = np.array([1e-6, 1e3, 1e4, 1e-2])
    A, B, C = SERVO.A / scale * scale[:, None], SERVO.B * scale[:, None], SERVO.C / scale
    assert rank_and_size(A, B * 1e7, C, np.zeros((1, 1))) == (5, 5)
    assert rank_and_size(A, np.zeros((4, 1)), C, 1e-5 * np.ones((1, 1))) == (4, 5)


def test_the_covariance_of_a_placement_that_is_not_detectable_grows():
    """The naive model with a disturbance at the output: it can be designed, and its covariance has no bound.

    Oracle: along [v; -1] nothing is measured, and the drift adds the same variance at every step.
    """
    naive = augmented(SERVO, entry_of(SERVO, Disturbance(at="output", drift=10.0)))
    np.testing.assert_allclose(naive.A @ NULL, NULL, atol=1e-12)
    np.testing.assert_allclose(naive.C @ NULL, 0.0, atol=1e-15)
    start = {"x0": np.zeros(5), "P0": naive.Q_w}
    P = kalman(naive, 10_000, **start).P
    along = NULL / np.linalg.norm(NULL)
    sizes = [float(along @ P[k] @ along) for k in (100, 1000, 10_000)]
    np.testing.assert_allclose(sizes, [12.0, 112.0, 1109.0], rtol=0.01)
    assert sizes[2] - sizes[1] == pytest.approx(9000 * (sizes[1] - sizes[0]) / 900, rel=1e-3)
    sound = with_places(SERVO, "input", drift=10.0)
    P = kalman(sound, 2000, x0=np.zeros(5), P0=sound.Q_w).P
    np.testing.assert_allclose(P[1000], P[2000], rtol=1e-9)


def test_the_torque_on_the_load():
    """Oracle: the equation of motion of the load, integrated by many small steps of Euler."""
    B_d = SERVO.disturbance_inputs["load"][:, 0]
    from rmpc_bench.models.servo import TABLE_1, continuous

    A = continuous(TABLE_1)[0]
    x, n = np.zeros(4), 100_000
    for _ in range(n):
        x = x + (A @ x + np.array([0.0, 1.0 / TABLE_1["J_l"], 0.0, 0.0])) * 0.1 / n
    np.testing.assert_allclose(B_d, x, rtol=2e-4, atol=1e-9)


@pytest.mark.parametrize(
    ("keys", "where", "message"),
    [
        ({"at": "laod"}, "at", "did you mean 'load'"),
        ({"at": "shaft"}, "at", "input, output, load"),
        ({"at": []}, "at", "names no place"),
        ({"at": ["input", "load", "input"]}, "at", "names 'input' twice"),
        ({"at": DisturbanceGains()}, "at", "B_d, C_d or both"),
        ({"at": DisturbanceGains(B_d=[1.0, 0.0, 0.0, 0.0])}, "at.B_d", "ambiguous"),
        ({"at": DisturbanceGains(B_d=[[1.0], [0.0]])}, "at.B_d", r"\(2, 1\) does not fit: 4 x 1"),
        ({"at": DisturbanceGains(B_d=[[1.0]] * 4, C_d=[[1.0, 0.0]])}, "at", "one per disturbance"),
        ({"at": "input", "drift": [1.0, 2.0]}, "drift", "one per disturbance"),
        ({"at": "input", "D0": [1.0, 2.0]}, "D0", "one per disturbance"),
        ({"at": "input", "drift": 0.0}, "drift", "always 0"),
    ],
)
def test_what_is_refused(keys, where, message):
    with pytest.raises(DesignError, match=message) as error:
        entry_of(SERVO, Disturbance(**{"drift": 1.0, **keys}))
    assert error.value.parameter == where


def test_lists_have_one_disturbance_per_entry(rng):
    """Oracle: the blocks put together by hand."""
    model = random_model(rng, 3, 2, 3)
    column = [[1.0], [2.0], [3.0]]
    found = with_places(model, ["input", DisturbanceGains(B_d=column)], drift=[1.0, 2.0, 3.0], D0=[4.0, 5.0, 6.0])
    np.testing.assert_array_equal(found.A[:3, 3:], np.hstack([model.B, column]))
    np.testing.assert_array_equal(found.Q_w[3:, 3:], np.diag([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(found.D0, np.diag([4.0, 5.0, 6.0]))
    start = found.start(np.ones(3), 2.0 * np.eye(3), np.eye(3))
    np.testing.assert_array_equal(start["x0"], [1, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(start["P0"], np.diag([2.0, 2, 2, 4, 5, 6]))
    np.testing.assert_array_equal(start["M0"], np.diag([1.0, 1, 1, 0, 0, 0]))


def test_the_linear_model_of_both(rng):
    """Oracle: x and d moved apart; constant parts, correlated noises and signals included."""
    base = random_model(rng, 3, 2, 2)
    S_wv, f0, d0 = 0.01 * rng.standard_normal((3, 2)), rng.standard_normal(3), rng.standard_normal(2)
    Z = rng.standard_normal((1, 3))
    model = LinearModel(
        base.A, base.B, base.C, base.Q_w, base.R_v, S_wv=S_wv, f0=f0, d0=d0, extra_signals={"torque": Z}
    )
    C_d = rng.standard_normal((2, 2))
    both = with_places(model, DisturbanceGains(B_d=rng.standard_normal((3, 2)).tolist(), C_d=C_d.tolist()))
    x, d, u = rng.standard_normal(3), rng.standard_normal(2), rng.standard_normal(2)
    B_d = both.A[:3, 3:]
    z = np.concatenate([x, d])
    np.testing.assert_allclose(both.f(z, u), np.concatenate([model.f(x, u) + B_d @ d, d]), rtol=1e-14)
    np.testing.assert_allclose(both.h(z), model.h(x) + C_d @ d, rtol=1e-14)
    np.testing.assert_array_equal(both.extra_signals["torque"] @ z, Z @ x)
    np.testing.assert_array_equal(both.S_wv, np.vstack([S_wv, np.zeros((2, 2))]))
    assert both.undisturbed is model and both.n_disturbances == 2
    sent = pickle.loads(pickle.dumps(both))
    np.testing.assert_array_equal(sent.A, both.A)


def test_a_model_with_sets_that_varies():
    """Oracle: the matrices at k, by hand."""
    by_k = np.array([[[1.0 + 0.01 * k]] for k in range(6)])
    model = mixed(5, A=0.9, B=by_k, C=1.0, P_w=0.1, M_w=0.2, P_v=0.3, M_v=0.4, w_mean=0.5)
    both = with_places(model, "input")
    for k in (0, 3, 5):
        np.testing.assert_allclose(both.at(k).A, [[0.9, 1.0 + 0.01 * k], [0.0, 1.0]])
        np.testing.assert_array_equal(both.M_w(k), [[0.2, 0.0], [0.0, 0.0]])
        np.testing.assert_array_equal(both.M_v(k), [[0.4]])
        np.testing.assert_array_equal(both.at(k).f0, [0.5, 0.0])
        assert both.at(k) is both.at(k)
    assert both.varies and both.has_sets


def test_an_uncertain_model(rng):
    """Oracle: for drawn F the system of [x; d] is that of x plus what d adds; d itself has no uncertainty."""
    keys = {
        "A": [[0.5, 0.1], [0.0, 0.6]], "B": [[0.0], [1.0]], "Bw": [[1.0], [0.5]], "C": [[1.0, 0.0]], "Dv": 1.0,
        "H_A": [[0.1], [0.2]], "H_C": [[0.3]], "G_x": [[1.0, 2.0]], "H_Bw": [[0.4], [0.5]], "H_Dw": [[0.1]],
        "G_w": [[2.0]],
    }  # fmt: skip
    model = uncertain(5, **keys, W=0.2, V=0.3, S=[[0.1]], wbar=0.7)
    both = with_places(model, "input", drift=0.4)
    m, M = model.system.at(0), both.system.at(0)
    x, d, w, v, F = rng.standard_normal(2), rng.standard_normal(1), rng.standard_normal(1), rng.standard_normal(1), 0.8
    xi, z = rng.standard_normal(1), np.concatenate([x, d])
    full_w = np.concatenate([w, xi])
    moved = (M.A + F * M.H_A @ M.G_x) @ z + (M.Bw + F * M.H_Bw @ M.G_w) @ full_w + M.Bv @ v
    expected = (m.A + F * m.H_A @ m.G_x) @ x + m.B @ d + (m.Bw + F * m.H_Bw @ m.G_w) @ w + m.Bv @ v
    np.testing.assert_allclose(moved, np.concatenate([expected, d + xi]), rtol=1e-13)
    seen = (M.C + F * M.H_C @ M.G_x) @ z + (M.Dw + F * M.H_Dw @ M.G_w) @ full_w + M.Dv @ v
    np.testing.assert_allclose(seen, (m.C + F * m.H_C @ m.G_x) @ x + (m.Dw + F * m.H_Dw @ m.G_w) @ w + m.Dv @ v)
    np.testing.assert_array_equal(both.W, np.diag([0.2, 0.4]))
    np.testing.assert_array_equal(both.at(0).Q_w[2, 2], 0.4)
    np.testing.assert_allclose(both.at(0).f0, np.concatenate([model.at(0).f0, [0.0]]))


def test_a_state_dependent_model(rng):
    """Oracle: the pair of the robot at x; the disturbance enters by its own B(x)."""
    model = moving_slide(0.01)
    at = DisturbanceGains(B_d=np.vstack([np.zeros((3, 3)), np.eye(3)]).tolist())
    both = with_disturbance(model, Disturbance(at=at, drift=1.0), 5, np.zeros(6))
    z = np.hstack([0.02 * rng.standard_normal((4, 6)), 100.0 * rng.standard_normal((4, 3))])
    (A, B), (A_x, B_x) = both.at_state(z), model.at_state(np.ascontiguousarray(z[:, :6]))
    np.testing.assert_array_equal(A[:, :6, :6], A_x)
    np.testing.assert_array_equal(A[:, 3:6, 6:], np.broadcast_to(np.eye(3), (4, 3, 3)))
    np.testing.assert_array_equal(B, np.concatenate([B_x, np.zeros((4, 3, 4))], axis=1))
    # Forces of more than the limit of a coordinate of x are no failure.
    state = kalman(both, 5, x0=np.zeros(9), P0=np.eye(9)).init(4)._replace(x_hat=z)
    _, estimate = kalman(both, 5, x0=np.zeros(9), P0=np.eye(9), use_y0=False).correct(0, state, np.zeros((4, 3)))
    assert not estimate.status.any()
    with pytest.raises(DesignError, match="4 disturbances, but 3 outputs"):
        with_disturbance(model, Disturbance(at="input", drift=1.0), 5, np.zeros(6))


def test_the_filter_estimates_what_a_whole_batch_does(rng):
    """Oracle: the Gaussian posterior of [x(0); d(0); w; xi] from all measurements at once."""
    model, n = random_model(rng, 2, 1, 1), 6
    both = with_places(model, "input", drift=0.3, D0=0.7)
    P0 = random_psd(rng, 2)
    start = both.start(rng.standard_normal(2), P0, np.zeros((2, 2)))
    filter_, y = kalman(both, n, x0=start["x0"], P0=start["P0"]), rng.standard_normal((1, n + 1, 1))
    state = filter_.init(1)
    for k in range(n + 1):
        state, estimate = filter_.correct(k, state, y[:, k])
        state = filter_.predict(k, state, np.zeros((1, 1)))
    # z(k) = A^k z(0) + sum of A^(k-1-j) n(j), all stacked.
    nz, A = 3, both.A
    T = np.zeros(((n + 1) * nz, (n + 1) * nz))
    for k in range(n + 1):
        for j in range(k + 1):
            T[k * nz : (k + 1) * nz, j * nz : (j + 1) * nz] = np.linalg.matrix_power(A, k - j)
    cov = np.kron(np.eye(n + 1), both.Q_w)
    cov[:nz, :nz] = start["P0"]
    joint, mean = T @ cov @ T.T, T[:, :nz] @ start["x0"]
    C = np.kron(np.eye(n + 1), both.C)
    gain = joint @ C.T @ np.linalg.inv(C @ joint @ C.T + np.kron(np.eye(n + 1), model.R_v))
    expected = mean + gain @ (y[0, :, 0] - C @ mean)
    np.testing.assert_allclose(estimate.x_hat[0], expected[-nz:], rtol=1e-9, atol=1e-10)
