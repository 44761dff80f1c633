"""Moving-horizon estimator against the Kalman filter, other solvers and enumeration; statuses, gaps and errors."""

import pickle

import cvxpy as cp
import numpy as np
import pytest
from conftest import STAT, random_model, random_psd
from estimators.horizon_twin import by_enumeration, windows
from scipy.optimize import lsq_linear

from rmpc_bench.estimators import kalman
from rmpc_bench.estimators.moving_horizon import design
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.types import Model, Status

KALMAN = {"rtol": 0.0, "atol": 1e-10}
"""Two ways to write the same estimate of numbers of size 1: a window at once, and sample by sample."""
RAO = {"A": [[0.99, 0.2], [-0.1, 0.3]], "C": [[1.0, -3.0]], "P_w": [0.0, 1.0], "P_v": 0.01}
MEAN, VARIANCE = np.sqrt(2.0 / np.pi), 1.0 - 2.0 / np.pi
"""Moments of |N(0, 1)|."""
SECOND = np.array([[0.0], [1.0]]), np.eye(1)
"""Input and covariance of noise of the second state."""


def run(estimator, y, u):
    """Estimates, statuses and reported values over time."""
    state, found = estimator.init(len(y)), []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, y[:, k])
        found.append(estimate)
        state = estimator.predict(k, state, u[:, k])
    return found


def x_hat(estimator, y, u):
    return np.stack([estimate.x_hat for estimate in run(estimator, y, u)], axis=1)


def signals(rng, model, runs, steps, size=1.0):
    """Measurements and inputs, no matter of which system."""
    shape = (runs, steps + 1)
    return size * rng.standard_normal((*shape, model.ny)), rng.standard_normal((*shape, model.nu))


class Varying(Model):
    """A linear model whose matrices, noises and constant parts change with time."""

    def at(self, k):
        A = np.array([[0.9, 0.2 * np.cos(k)], [0.1, 0.95]])
        Q_w, R_v = np.diag([0.1 + 0.05 * np.sin(k), 0.2]), np.array([[0.5 + 0.2 * np.cos(k)]])
        C, f0, d0 = np.array([[1.0, np.sin(k)]]), np.array([0.1 * np.sin(k), -0.2]), np.array([0.3 * np.cos(k)])
        return LinearModel(A, np.ones((2, 1)), C, Q_w, R_v, f0=f0, d0=d0)

    varies = True


def models():
    """Models of all kinds, each with P0."""
    rng = np.random.default_rng(5)
    full = random_model(rng, 3, 2, 2)
    exact = LinearModel(full.A, full.B, full.C, full.Q_w, np.diag([0.0, 1.0]))
    thin = LinearModel(full.A, full.B, full.C, random_psd(rng, 3, rank=1), full.R_v)
    sizes = {"Bw": (3, 2), "Bv": (3, 2), "H_A": (3, 1), "G_x": (1, 3)}
    given = {name: 0.3 * rng.standard_normal((1, *shape)) for name, shape in sizes.items()}
    given |= {"A": full.A[None], "B": full.B[None], "C": full.C[None], "Dv": np.eye(2)}
    given["Bv"] = 0.0
    uncertain = uncertain_model(30, **given, W=[1.0, 2.0], V=0.5, wbar=[0.2, -1.0], vbar=0.3)
    mixed = mixed_model(30, **RAO | {"P_v": 0.5}, B=[[0.0], [1.0]], w_mean=[0.0, MEAN], v_mean=-0.4)
    return {
        "full": (full, np.eye(3)),
        "exact output": (exact, np.eye(3)),
        "singular Q_w": (thin, np.eye(3)),
        "no noise": (LinearModel(full.A, full.B, full.C, 0.0, full.R_v), np.eye(3)),
        "known start": (thin, np.zeros((3, 3))),
        "varying": (Varying(), np.diag([2.0, 0.5])),
        "uncertain": (uncertain, np.eye(3)),
        "mixed": (mixed, np.eye(2)),
    }


@pytest.mark.parametrize("N", [1, 3, 8])
@pytest.mark.parametrize("name", models())
def test_without_bounds_it_is_the_kalman_filter(name, N, rng):
    """Oracle: `kalman`, also while the window fills; with and without y(0), its P as well."""
    model, P0 = models()[name]
    y, u = signals(rng, model, 3, 30)
    for use_y0 in (True, False):
        start = {"x0": rng.standard_normal(model.nx), "P0": P0, "use_y0": use_y0}
        ours, other = (
            run(each, y, u) for each in (design(model, 30, window=N, **start), kalman.design(model, 30, **start))
        )
        for a, b in zip(ours, other, strict=True):
            np.testing.assert_allclose(a.x_hat, b.x_hat, **KALMAN)
            np.testing.assert_allclose(a.info["e"], b.info["e"], **KALMAN)
            np.testing.assert_array_equal(a.P, b.P)
            assert not a.info["solved"].any() and not a.status.any()


@pytest.mark.parametrize("name", ["full", "singular Q_w", "varying"])
def test_bounds_that_are_not_active_change_nothing(name, rng):
    """Oracle: `kalman`; no program is solved."""
    model, P0 = models()[name]
    y, u = signals(rng, model, 3, 25)
    far = {key: (-1e4, 1e4) for key in "wvx"}
    found = run(design(model, 25, x0=np.zeros(model.nx), P0=P0, window=4, **far), y, u)
    expected = x_hat(kalman.design(model, 25, x0=np.zeros(model.nx), P0=P0), y, u)
    np.testing.assert_allclose(np.stack([each.x_hat for each in found], axis=1), expected, **KALMAN)
    assert not any(each.info["solved"].any() for each in found)


@pytest.mark.parametrize("N", [1, 4])
def test_missing_measurements_are_left_out(N, rng):
    """Oracle: `kalman` with the same gaps; single outputs, whole samples, a long gap, y(0); other runs bit for bit."""
    model, P0 = models()["full"]
    y, u = signals(rng, model, 4, 25)
    start, whole = {"x0": np.zeros(3), "P0": P0}, y.copy()
    y[0, 5, 0] = y[1, 3:12] = y[2, 0] = np.nan
    y[2, [7, 9], [1, 0]] = np.nan
    found, other = (
        run(each(model, 25, **start, **keys), y, u) for each, keys in ((design, {"window": N}), (kalman.design, {}))
    )
    for a, b in zip(found, other, strict=True):
        np.testing.assert_allclose(a.x_hat, b.x_hat, **KALMAN)
        np.testing.assert_allclose(np.broadcast_to(a.P, (4, 3, 3)), np.broadcast_to(b.P, (4, 3, 3)), **KALMAN)
    alone = x_hat(design(model, 25, **start, window=N), whole, u)
    np.testing.assert_array_equal(np.stack([each.x_hat[3] for each in found]), alone[3])


def test_a_run_returns_to_the_common_matrices(rng):
    """Oracle: by hand, P_pred forgets a gap by (1 - L)^2 a step; before and after it is the filter with the gap."""
    model, y, u = (
        LinearModel([[0.5]], [[1.0]], [[1.0]], 1.0, 1.0),
        rng.standard_normal((2, 61, 1)),
        np.zeros((2, 61, 1)),
    )
    y[1, 10] = np.nan
    made = design(model, 60, x0=np.zeros(1), P0=np.eye(1), window=3, w=(-100.0, 100.0))
    state, own = made.init(2), []
    for k in range(61):
        state, _ = made.correct(k, state, y[:, k])
        own.append(state.own)
        state = made.predict(k, state, u[:, k])
    P = np.sqrt(1.0 + 0.25**2 / 4.0) + 0.125  # P = 0.25 P / (1 + P) + 1
    factor = 0.25 / (1.0 + P) ** 2
    steps = np.log(1e-13 * P / (0.25 * P**2 / (1.0 + P))) / np.log(factor)
    gone = np.flatnonzero(np.array(own)[:, 1])
    assert gone[0] == 10 and not np.array(own)[:, 0].any()
    assert abs(gone[-1] - (10 + 3 + steps)) <= 1.0
    expected = x_hat(kalman.design(model, 60, x0=np.zeros(1), P0=np.eye(1)), y, u)
    np.testing.assert_allclose(x_hat(made, y, u), expected, **KALMAN)


def half_normal_data(rng, runs, steps):
    """The system of 2001: states, measurements and no inputs."""
    w, v = np.abs(rng.standard_normal((runs, steps))), 0.1 * rng.standard_normal((runs, steps + 1))
    x = np.zeros((runs, steps + 1, 2))
    for k in range(steps):
        x[:, k + 1] = x[:, k] @ np.array(RAO["A"]).T + [0.0, 1.0] * w[:, k, None]
    return x, x @ np.array(RAO["C"]).T + v[:, :, None], np.zeros((runs, steps + 1, 1))


@pytest.mark.parametrize(("N", "low"), [(3, 0.0), (3, -0.2), (10, 0.0)])
def test_noise_with_a_lower_bound(N, low, rng):
    """Oracle: enumeration of the active bounds (N = 3), bounded least squares of SciPy (BVLS, N = 10)."""
    model, P0 = mixed_model(20, **RAO), np.diag([1.0, 0.5])
    _, y, u = half_normal_data(rng, 3, 20)
    found = run(design(model, 20, x0=np.ones(2), P0=P0, window=N, w=(low, None)), y, u)
    ours = np.stack([each.x_hat for each in found], axis=1)
    assert np.mean([each.info["solved"].mean() for each in found]) > 0.3
    for i in range(3):
        for k, each in windows(model, lambda k: SECOND, (np.ones(2), P0), ours[i], (y[i], u[i]), N):
            M, b = each.least_squares()
            bounded = np.arange(2, M.shape[1])
            if N == 3:
                z = by_enumeration(M, b, bounded, low)[1]
            else:
                z = lsq_linear(M, b, ([-np.inf] * 2 + [low] * len(bounded), np.inf), method="bvls", tol=1e-14).x
            # What is left is the rounding of normal equations with R_v = 0.01.
            np.testing.assert_allclose(ours[i, k], each.last(z), rtol=1e-8, atol=1e-8)


def by_cvxpy(window, w, v, x):
    """Minimum with bounds of everything by cvxpy and Clarabel: the last state and the cost; None if infeasible."""
    M, b = window.least_squares()
    S, s = window.maps()
    z = cp.Variable(M.shape[1])
    rules = [z[window.A.shape[1] :] >= w[0], z[window.A.shape[1] :] <= w[1]] if window.steps else []
    for j, y in enumerate(window.y):
        state = S[j] @ z + s[j]
        rules += [state >= x[0], state <= x[1]]
        rest = y - window.C[j] @ state
        rules += [rest[n] <= v[1] for n in range(len(y)) if not np.isnan(y[n])]
        rules += [rest[n] >= v[0] for n in range(len(y)) if not np.isnan(y[n])]
    problem = cp.Problem(cp.Minimize(cp.sum_squares(M @ z - b)), rules)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
    return window.last(z.value)


@pytest.mark.parametrize("name", ["full", "varying"])
def test_bounds_of_noises_and_states(name, rng):
    """Oracle: cvxpy and Clarabel on the problem in states and noises, sample by sample; a gap in a run."""
    model, P0 = models()[name]
    y, u = signals(rng, model, 2, 12, 1.5)
    y[1, 4, 0] = np.nan
    w, v, x = (-0.8, 1.2), (-2.5, 3.0), (-4.0, 3.5)
    x0 = 0.3 * np.ones(model.nx)
    found = run(design(model, 12, x0=x0, P0=P0, window=3, w=w, v=v, x=x), y, u)
    ours, active = np.stack([each.x_hat for each in found], axis=1), 0
    for i in range(2):
        for k, each in windows(
            model, lambda k: (np.eye(model.nx), model.at(k).Q_w), (x0, P0), ours[i], (y[i], u[i]), 3
        ):
            if found[k].status[i] != Status.OK:
                continue
            np.testing.assert_allclose(ours[i, k], by_cvxpy(each, w, v, x), atol=1e-5)  # what Clarabel reaches
            active += int(found[k].info["solved"][i])
    assert active >= 4


@pytest.mark.parametrize("N", [2, 10])
def test_a_block_gives_the_bits_of_single_runs(N, rng):
    """Oracle: 50 runs at once and each alone, bit for bit, with active bounds and gaps; also after a pickle."""
    _, y, u = half_normal_data(rng, 50, 20)
    y[7, 5] = y[30, 0] = np.nan
    made = design(mixed_model(20, **RAO), 20, x0=np.ones(2), P0=np.eye(2), window=N, w=(0.0, None), x=(-20.0, 30.0))
    together = x_hat(made, y, u)
    again = pickle.loads(pickle.dumps(made))
    for i in [*range(0, 50, 10), 7]:
        np.testing.assert_array_equal(x_hat(again, y[i : i + 1], u[i : i + 1])[0], together[i])


def test_bounds_contain_the_mean_of_the_noise(rng):
    """Oracle: the same system with the noise w - mean and bounds minus the mean; of v as well."""
    _, y, u = half_normal_data(rng, 5, 20)
    start = {"x0": np.zeros(2), "P0": np.eye(2), "window": 4}
    both = mixed_model(20, **RAO, w_mean=[0.0, MEAN], v_mean=0.3)
    A, C = np.array(RAO["A"]), np.array(RAO["C"])
    plain = LinearModel(A, np.zeros((2, 1)), C, [0.0, 1.0], 0.01, f0=[0.0, MEAN], d0=[0.3])
    ours = x_hat(design(both, 20, **start, w=[(None, None), (0.0, 3.0)], v=(-0.1, 0.5)), y, u)
    other = design(plain, 20, **start, w=[(None, None), (-MEAN, 3.0 - MEAN)], v=(-0.4, 0.2))
    np.testing.assert_allclose(ours, x_hat(other, y, u), **KALMAN)


def test_noise_of_an_uncertain_model_is_that_of_its_input(rng):
    """Oracle: the linear model with noise 2 w in the second state, so that w >= 0 is a bound of that coordinate."""
    _, y, u = half_normal_data(rng, 5, 20)
    start = {"x0": np.zeros(2), "P0": np.eye(2), "window": 4}
    parts = {"A": RAO["A"], "C": RAO["C"], "B": [[0.0], [0.0]], "Bw": [[0.0], [-2.0]], "Dv": 1.0}
    uncertain = uncertain_model(20, **parts, W=0.25, V=0.01, wbar=-0.1, vbar=0.2)
    linear = mixed_model(20, **RAO, w_mean=[0.0, 0.2], v_mean=0.2)
    ours = x_hat(design(uncertain, 20, **start, w=(-1.0, 0.0), v=(-0.1, 0.5)), y, u)
    np.testing.assert_allclose(ours, x_hat(design(linear, 20, **start, w=(0.0, 2.0), v=(-0.1, 0.5)), y, u), **KALMAN)


def test_a_long_experiment_shares_its_windows():
    """Oracle: the number of different windows; a gain that settles is that of one window."""
    model = LinearModel([[0.5]], [[1.0]], [[1.0]], 1.0, 1.0)
    made = design(model, 500, x0=np.zeros(1), P0=np.eye(1), window=5, w=(-1.0, 1.0))
    assert len(made.programs) == 501 and len({id(each) for each in made.programs}) < 40


@pytest.mark.slow
def test_what_bounds_buy():
    """Oracle: an independent program gave 17.93(52), 0.392(27) and 0.380(37) for squared errors of 100 samples."""
    runs, steps = 400, 100
    x, y, u = half_normal_data(np.random.default_rng(2001), runs, steps)
    start = {"x0": np.zeros(2), "P0": np.eye(2)}
    zero, known = mixed_model(steps, **RAO), mixed_model(steps, **RAO | {"P_w": [0.0, VARIANCE]}, w_mean=[0.0, MEAN])
    designs = {
        (17.93, 0.52): kalman.design(zero, steps, **start),
        (0.392, 0.027): design(zero, steps, **start, window=10, w=(0.0, None)),
        (0.380, 0.037): kalman.design(known, steps, **start),
    }
    for (expected, se), made in designs.items():
        squares = np.mean(np.sum((x_hat(made, y, u) - x) ** 2, axis=2), axis=1)
        both = np.hypot(se, squares.std(ddof=1) / np.sqrt(runs))
        assert abs(squares.mean() - expected) < STAT * both
