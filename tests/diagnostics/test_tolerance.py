"""The divergence over time against the joint normal density of whole trajectories, and against a study's numbers."""

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd, servo_model

from rmpc_bench.controllers.mpc import Scale
from rmpc_bench.controllers.mpc import design as mpc
from rmpc_bench.diagnostics.stability import linear_pair
from rmpc_bench.diagnostics.tolerance import divergence_over_time
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.robust_kalman import design as robust_kalman
from rmpc_bench.models.disturbance import Disturbance, entry_of
from rmpc_bench.models.disturbed import DisturbedLinear
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.servo import TABLE_1
from rmpc_bench.numerics.linalg import van_loan
from rmpc_bench.plants.servo import linear_part, with_current
from rmpc_bench.types import LinearPlant

N = 5


def trajectories(A, B, C, pair, r, n_steps):
    """x(0..N), y(0..N-1) as affine maps (one column per primitive, the last one for 1) of [x0, w.., v.., 1]."""
    n, ny = len(A), len(C)
    size = n + n_steps * (n + ny) + 1
    unit = np.eye(size)
    w = [unit[n + k * n : n + (k + 1) * n] for k in range(n_steps)]
    v = [unit[n + n_steps * n + k * ny : n + n_steps * n + (k + 1) * ny] for k in range(n_steps)]
    one = unit[-1:]
    f, law = pair
    x, x_pred, u = [unit[:n]], f.x0[:, None] * one, np.zeros((len(law.K_u), size))
    ys = []
    for k in range(n_steps):
        y = C @ x[-1] + v[k]
        x_hat = x_pred + f.L[k] @ (y - f.C[0] @ x_pred)
        ahead = r[k + 1 : k + 1 + law.K_r.shape[1] // ny].reshape(-1, 1)
        u = u + law.K_r @ ahead @ one - law.K_x @ x_hat - law.K_u @ u
        x.append(A @ x[-1] + B @ u + w[k])
        x_pred = f.F[0] @ x_pred + f.B[0] @ u + f.K[k] @ (y - f.C[0] @ x_pred)
        ys.append(y)
    return x, ys


def conditional(maps, mean, cov, k, E):
    """Joint moments of z(k) and Y(k-1): gain, conditional covariance, mean of z, mean and covariance of Y."""
    x, y = maps
    z = np.vstack([E @ x[k + 1], y[k]])
    Y = np.vstack([np.zeros((0, len(mean))), *y[:k]])
    gain = np.linalg.solve(Y @ cov @ Y.T, Y @ cov @ z.T).T
    return gain, z @ cov @ z.T - gain @ Y @ cov @ z.T, z @ mean, Y @ mean, Y @ cov @ Y.T


def moments(x0, P0, Q, R, n_steps, s):
    """Mean and covariance of the primitives; the last one is the number 1."""
    n, ny = len(x0), len(R)
    cov = np.zeros((n + n_steps * (n + ny) + 1,) * 2)
    blocks, at = [P0, *[Q] * n_steps, *[R] * n_steps], 0
    for block in blocks:
        cov[at : at + len(block), at : at + len(block)] = s**2 * block
        at += len(block)
    return np.concatenate([x0, np.zeros(n_steps * (n + ny)), [1.0]]), cov


def case(seed, ny=1):
    """Two plants of four states, a model of three of them, a robust filter and a controller."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, 3, 2, ny)
    plants = [random_model(rng, 4, 2, ny) for _ in range(2)]
    E = np.eye(3, 4) + 0.2 * rng.standard_normal((3, 4))
    truths = [LinearPlant(plant.A, plant.B, plant.C, E) for plant in plants]
    P0, x0 = random_psd(rng, 3), rng.standard_normal(4)
    estimator = robust_kalman(model, N, x0=rng.standard_normal(3), P0=P0, c=0.3)
    pair = linear_pair(estimator, mpc(model, Hp=4, Hu=2, Q=1.0, R=0.3))
    return model, truths, pair, x0, P0, rng.standard_normal((N + 5, ny))


def stacked(truths):
    return LinearPlant(*(np.stack(matrices) for matrices in zip(*truths, strict=True)))


@pytest.mark.parametrize(("seed", "ny", "s"), [(1, 1, 1.0), (2, 1, 0.1), (3, 2, 3.0)])
def test_against_the_joint_density_of_all_data(seed, ny, s):
    """No filter: condition the joint normal density of z(k) and all past outputs, under truth and under belief."""
    model, truths, pair, x0, P0, r = case(seed, ny)
    found = divergence_over_time(stacked(truths), model, pair, x0, P0, r, N)
    believed = trajectories(model.A, model.B, model.C, pair, r, N)
    for run, truth in enumerate(truths):
        lift = np.linalg.pinv(truth.E)
        true = trajectories(truth.A, truth.B, truth.C, pair, r, N)
        of_truth = moments(x0, lift @ P0 @ lift.T, lift @ model.Q_w @ lift.T, model.R_v, N, s)
        of_model = moments(pair.schedule.x0, P0, model.Q_w, model.R_v, N, s)
        for k in range(N):
            gain, K_true, z, Y, S = conditional(true, *of_truth, k, truth.E)
            gain0, K, z0, Y0, _ = conditional(believed, *of_model, k, np.eye(3))
            a = z - z0 - gain0 @ (Y - Y0)  # dm at the mean of the data, which are drawn from the truth
            spread = (gain - gain0) @ S @ (gain - gain0).T
            ratio = np.linalg.solve(K, K_true)
            covariance = 0.5 * (np.trace(ratio) - len(K) - np.linalg.slogdet(ratio)[1])
            # 1e-7: the oracle inverts the covariance of all data, condition number about 1e6 with these plants
            np.testing.assert_allclose(found.covariance[run, k], covariance, rtol=1e-7)
            np.testing.assert_allclose(found.mismatch[run, k] / s**2, 0.5 * a @ np.linalg.solve(K, a), rtol=1e-7)
            noise = 0.5 * np.trace(np.linalg.solve(K, spread))
            np.testing.assert_allclose(found.noise[run, k], noise, rtol=1e-7, atol=1e-12)


def test_a_filter_with_a_disturbance_has_more_states_than_the_model():
    """A plant equal to the model does not diverge from it, whatever the filter of the method estimates besides."""
    rng = np.random.default_rng(7)
    model = random_model(rng, 3, 1, 1)
    disturbed = DisturbedLinear(model, entry_of(model, Disturbance(at="input", drift=2.0)))
    x0, P0 = rng.standard_normal(3), random_psd(rng, 3)
    start = disturbed.start(x0, P0, np.zeros((3, 3)))
    estimator = kalman(disturbed, N, x0=start["x0"], P0=start["P0"])
    pair = linear_pair(estimator, mpc(disturbed, Hp=4, Hu=2, Q=1.0, R=0.3))
    truth = LinearPlant(model.A, model.B, model.C, np.eye(3))
    for part in divergence_over_time(stacked([truth]), model, pair, x0, P0, rng.standard_normal((N + 5, 1)), N):
        np.testing.assert_allclose(part, 0.0, atol=1e-9)  # rounding of the parts, which are of size 1 for other plants


def test_a_plant_equal_to_the_model_does_not_diverge():
    """Nor does it when the method's filter is another than the model's own."""
    model, _, pair, _, P0, r = case(4)
    truth = LinearPlant(model.A, model.B, model.C, np.eye(3))
    found = divergence_over_time(stacked([truth]), model, pair, pair.schedule.x0, P0, r, N)
    np.testing.assert_allclose([found.covariance, found.mismatch], 0.0, atol=1e-20)  # squares of rounding errors
    np.testing.assert_allclose(found.noise, 0.0, atol=1e-12)  # rounding, times covariances of about 100


def test_noise_scale():
    """A model with s times the noise has 1/s^2 times the mismatch; the rest is the same."""
    model, truths, pair, x0, P0, r = case(5)
    louder = LinearModel(model.A, model.B, model.C, 4.0 * model.Q_w, 4.0 * model.R_v)
    one = divergence_over_time(stacked(truths), model, pair, x0, P0, r, N)
    two = divergence_over_time(stacked(truths), louder, pair, x0, 4.0 * P0, r, N)
    for name, factor in (("covariance", 1.0), ("mismatch", 0.25), ("noise", 1.0)):
        np.testing.assert_allclose(getattr(two, name), factor * getattr(one, name), **ROUND)


def test_plants_do_not_notice_each_other():
    """One at a time or together."""
    model, truths, pair, x0, P0, r = case(6)
    together = divergence_over_time(stacked(truths), model, pair, x0, P0, r, N)
    for run, truth in enumerate(truths):
        alone = divergence_over_time(stacked([truth]), model, pair, x0, P0, r, N)
        for part, row in zip(together, alone, strict=True):
            np.testing.assert_allclose(part[run], row[0], rtol=1e-10)  # BLAS sums in another order


def table_2():
    """Real parameters of zenere2018, Table 2, with eps_min = 5 % and eps_max = 10 %."""
    factors = dict.fromkeys(("R", "rho", "k_theta"), 1.05) | dict.fromkeys(("J_m", "beta_m", "K_t", "beta_l"), 1.1)
    return {name: value * factors.get(name, 0.9) for name, value in TABLE_1.items()} | {"L": 0.8}


def servo_divergence(**more):
    model, n_steps = servo_model(), 200
    estimator = kalman(model, n_steps, x0=np.zeros(4), P0=model.Q_w)
    controller = mpc(model, Hp=10, Hu=3, Q=0.1, R=0.1, scale=Scale(u=440.0, y=2 * np.pi))
    truth = linear_part(with_current, table_2(), 0.1)
    r = np.full((n_steps + 11, 1), np.pi / 2)
    return divergence_over_time(
        stacked([truth]), model, linear_pair(estimator, controller), np.zeros(5), model.Q_w, r, n_steps, **more
    )


def test_numbers_of_a_study():
    """servo.md 3.9, found there by sampling ten runs: mean part 45.0 (s = 0.1), 4481 (0.01), 4.5e5, 79 % in 5 s."""
    found = servo_divergence()
    mismatch, noise = found.mismatch.mean(), found.noise.mean()
    for s, expected, digits in ((0.1, 45.0, 0.1), (0.01, 4481.0, 1.0), (1e-3, 4.5e5, 5e3)):
        assert abs(mismatch / s**2 + noise - expected) < digits
    assert abs(found.mismatch[0, :50].sum() / found.mismatch.sum() - 0.79) < 0.005
    # 0.66 at s = 1 there: a third of it is noise, of which ten runs are a small sample
    assert abs(mismatch + noise - 0.66) < 0.05
    assert abs(found.covariance.mean() - 0.0775) < 5e-5


def test_covariance_part_of_the_study():
    """Its 0.111 takes the continuous noise of the model through the plant's own dynamics instead of the model's Q_w."""
    A, _ = with_current(table_2())
    Q = van_loan(A, np.diag([1.0, 1.0, 1.0, 1.0, 0.0]), 0.1)
    assert abs(servo_divergence(Q_true=Q[None]).covariance.mean() - 0.111) < 1e-3
