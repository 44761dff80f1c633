"""State feedback over a receding horizon, against SciPy, big matrices and limits."""

import numpy as np
import pytest
from conftest import ROUND, random_model
from controllers import minimax_oracles as oracles
from scipy.linalg import solve_discrete_are

from rmpc_bench.controllers.limits import InputLimits
from rmpc_bench.controllers.state_feedback import game_gain, lqr
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.kalman_disturbance import design as kalman_disturbance
from rmpc_bench.estimators.mixed import design as mixed
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.lq_windows import smallest_multipliers
from rmpc_bench.types import DesignError, Estimate

A, B, C = np.array([[0.9, 0.3], [-0.2, 0.7]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
WEIGHTS = {"Q_x": [2.0, 1.0], "R_u": 0.5}
START = {"x0": np.zeros(2), "P0": np.eye(2)}


def control(law, k, x, **info):
    """What a law commands for one estimate."""
    estimate = Estimate(
        x[None], None, None, np.zeros(1, dtype=np.int8), {name: each[None] for name, each in info.items()}
    )
    return law.control(k, law.init(1), np.zeros((1, 1)), estimate, np.zeros((1, 1)))[1].u[0]


def test_a_long_horizon_is_the_stationary_gain():
    """Oracle: scipy.linalg.solve_discrete_are."""
    model = LinearModel(A, B, C, 1.0, 1.0)
    law = lqr(model, 3, kalman(model, 3, **START), horizon=300, **WEIGHTS)
    P = solve_discrete_are(A, B, np.diag([2.0, 1.0]), 0.5 * np.eye(1))
    K = np.linalg.solve(0.5 + B.T @ P @ B, B.T @ P @ A)
    x = np.array([1.0, -2.0])
    np.testing.assert_allclose(control(law, 2, x), -K @ x, rtol=1e-9)  # of the solver


@pytest.mark.parametrize("mean", ["known", "estimated", "ignored"])
def test_a_known_or_estimated_mean_is_fed_forward(mean):
    """Oracle: the big linear system with the mean at every stage; ignored, without it."""
    d = np.array([0.4, -0.3])
    model = mixed_model(3, A=A, B=B, C=C, P_w=1.0, P_v=1.0, w_mean=(d if mean != "estimated" else 0.0 * d).tolist())
    estimator = kalman_disturbance(model, 3, **START) if mean == "estimated" else kalman(model, 3, **START)
    law = lqr(model, 3, estimator, horizon=6, mean=mean, **WEIGHTS)
    N, x = 6, np.array([1.0, -2.0])
    stages = oracles.Stages(
        *(np.broadcast_to(each, (N, *each.shape)) for each in (A, B, np.diag([2.0, 1.0]), 0.5 * np.eye(1)))
    )
    big = oracles.matrices(stages)
    f = np.tile(0.0 * d if mean == "ignored" else d, N)
    expected = -np.linalg.solve(big.B, big.b @ x + big.D[:, 2:] @ f)
    info = {"w_mean": d} if mean == "estimated" else {}
    np.testing.assert_allclose(control(law, 1, x, **info), expected[:1], **ROUND)


def test_a_mean_that_nobody_estimates_is_refused():
    """Oracle: the rule itself; the message names the estimator that does."""
    model = LinearModel(A, B, C, 1.0, 1.0)
    with pytest.raises(DesignError, match="kalman-disturbance"):
        lqr(model, 3, kalman(model, 3, **START), horizon=3, mean="estimated", **WEIGHTS)


def system(N):
    """A model with a set of w, its mixed filter and its stages."""
    model = mixed_model(3, A=A, B=B, C=C, P_v=1.0, M_w=[[0.5, 0.1], [0.1, 0.2]])
    stages = oracles.Stages(
        *(np.broadcast_to(each, (N, *each.shape)) for each in (A, B, np.diag([2.0, 1.0]), 0.5 * np.eye(1)))
    )
    return model, mixed(model, 3, **START, M0=np.eye(2)), stages, np.broadcast_to([[0.5, 0.1], [0.1, 0.2]], (N, 2, 2))


def test_game_gain_is_the_saddle_of_the_big_game():
    """Oracle: stationarity of the cost less the price in controls and noise together, one big linear system.

    The smallest price is where its Schur complement in the noise, after the controls, loses its sign.
    """
    N, x = 5, np.array([1.0, -2.0])
    model, estimator, stages, M_w = system(N)
    big, (_, M_2) = oracles.matrices(stages), oracles.inverse_sets(np.eye(2), M_w)
    w = slice(2, None)
    price = 1.3 * smallest_multipliers(stages, psd_sqrt(M_w), N)[0]
    saddle = np.block([[big.B, big.D[:, w]], [big.D[:, w].T, big.C[w, w] - price * M_2[w, w]]])
    expected = np.linalg.solve(saddle, -np.concatenate([big.b, big.c[w]]) @ x)
    law = game_gain(model, 3, estimator, horizon=N, ratio=1.3, **WEIGHTS)
    np.testing.assert_allclose(control(law, 0, x), expected[:1], **ROUND)


def test_a_high_price_is_linear_quadratic_control():
    """Oracle: lqr, the limit."""
    model, estimator, _, _ = system(5)
    x = np.array([1.0, -2.0])
    game = game_gain(model, 3, estimator, horizon=5, ratio=1e9, **WEIGHTS)
    np.testing.assert_allclose(
        control(game, 0, x), control(lqr(model, 3, estimator, horizon=5, **WEIGHTS), 0, x), rtol=1e-7
    )
    assert game.series()["L_u"].shape == (3, 1, 2)


@pytest.mark.parametrize("kind", ["lqr", "game"])
def test_the_window_of_k_counts(kind):
    """Oracle: a design whose first window is the one that begins at k = 2, for a system and sets that vary."""
    rng = np.random.default_rng(4)
    stages, (_, M_w) = oracles.random_stages(rng, 2, 1, 9), oracles.random_sets(rng, 2, 9)
    x, u = np.array([1.0, -2.0]), []
    for first in (0, 2):
        model = mixed_model(3, A=stages.A[first:], B=stages.B[first:], C=C, P_v=1.0, M_w=M_w[first:])
        estimator = mixed(model, 3, **START, M0=np.eye(2))
        make = lqr if kind == "lqr" else game_gain
        u.append(control(make(model, 3, estimator, horizon=4, **WEIGHTS), 2 - first, x))
    np.testing.assert_allclose(u[0], u[1], rtol=1e-10)  # prices by halving


def test_limits_clip_the_input_of_lqr():
    """Oracle: the input without limits, clipped; with an operating point the limits are physical ones."""
    model = random_model(np.random.default_rng(6), 3, 2, 2)
    estimator = kalman(model, 3, x0=np.zeros(3), P0=np.eye(3))
    keys = {"horizon": 5, "Q_x": 1.0, "R_u": 0.1}
    free, x = lqr(model, 3, estimator, **keys), 3.0 * np.random.default_rng(7).standard_normal((50, 3))
    for pairs in ((-0.2, 0.3), [(-0.2, 0.3), (-0.1, 0.5)]):
        low, high = np.array(pairs).reshape(-1, 2).T
        law = lqr(model, 3, estimator, **keys, limits=InputLimits(u=pairs))
        u = [each.control(0, each.init(50), x, Estimate(x), np.zeros((1, 3)))[1].u for each in (law, free)]
        np.testing.assert_array_equal(u[0], np.clip(u[1], low, high))
        assert (u[0] != u[1]).any()
        assert free.has_compiled_form
        assert not law.has_compiled_form
    assert lqr(model, 3, estimator, **keys, limits=InputLimits(u=(-0.2, 0.3))).input_limits == (-0.2, 0.3)
    with pytest.raises(DesignError, match="must be below the upper bound") as caught:
        lqr(model, 3, estimator, **keys, limits=InputLimits(u=(0.3, -0.2)))
    assert caught.value.parameter == "limits.u"
