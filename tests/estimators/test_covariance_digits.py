"""Digits of covariances where P(0) is up to 1e14 times R, against exact rational arithmetic, for every filter."""

from fractions import Fraction
from importlib import import_module

import mpmath as mp
import numpy as np
import pytest

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.numerics.square_root import conditional, corrected, covariance_of, lower_root, root_of
from rmpc_bench.plants.ode import design as ode

N = 20
NINE = {"rtol": 1e-9}
A = [[1.0, 0.1], [0.0, 1.0]]
ONE = [[1.0, 0.0]]


def rational(M):
    return [[Fraction(float(each)) for each in row] for row in np.atleast_2d(M)]


def product(X, Y):
    return [[sum((a * b for a, b in zip(row, column, strict=True)), Fraction(0)) for column in zip(*Y, strict=True)]
            for row in X]  # fmt: skip


def plus(X, Y, sign=1):
    return [[a + sign * b for a, b in zip(x, y, strict=True)] for x, y in zip(X, Y, strict=True)]


def exact(A, C, Q, R, P, first=0):
    """Covariances of predictions and of estimates; measured from a first sample on, R is diagonal."""
    A, C, Q, P = map(rational, (A, C, Q, P))
    transpose, before, after = [list(row) for row in zip(*A, strict=True)], [], []
    for k in range(N):
        before.append(P)
        for c, r in zip(C, np.diag(R), strict=True) if k >= first else ():
            Pc = product(P, [[each] for each in c])
            s = product([c], Pc)[0][0] + Fraction(float(r))
            P = plus(P, [[a * b / s for (b,) in Pc] for (a,) in Pc], -1)
        after.append(P)
        P = plus(product(product(A, P), transpose), Q)
    return tuple(np.array([[float(P[i][i]) for i in range(len(P))] for P in each]) for each in (before, after))


def covariances(module, model, P0, keys, n=2):
    """Variances that a filter reports over k, without measurements of any size."""
    estimator = import_module(f"rmpc_bench.estimators.{module}").design(model, N, x0=np.zeros(n), P0=P0, **keys)
    state, found = estimator.init(2), []
    for k in range(N):
        state, estimate = estimator.correct(k, state, np.zeros((2, model.ny)))
        found.append(np.diagonal(np.broadcast_to(estimate.P, (2, n, n))[1]))
        state = estimator.predict(k, state, np.zeros((2, model.nu)))
    return np.array(found)


SYSTEMS = {
    "one sensor": (A, ONE, 1e-6 * np.eye(2), 1e-4 * np.eye(1)),
    "no process noise": (A, ONE, np.zeros((2, 2)), 1e-4 * np.eye(1)),
    "order of the states": ([[1.0, 0.0], [0.1, 1.0]], [[0.0, 1.0]], 1e-6 * np.eye(2), 1e-4 * np.eye(1)),
    "equal sensors": (A, [[1.0, 0.0], [1.0, 0.0]], 1e-6 * np.eye(2), 1e-4 * np.eye(2)),
    "nearly equal": (A, [[1.0, 0.0], [1.0, 1e-7]], np.zeros((2, 2)), 1e-4 * np.eye(2)),
    "precise beside poor": (A, np.eye(2), 1e-6 * np.eye(2), np.diag([1e-10, 1e-4])),
}
FILTERS = {
    "kalman": {},
    "fading_kalman": {"alpha": 1.0},
    "directional_kalman": {"q": 0.0, "direction": 1.0},
    "kalman_disturbance": {"D0": 0.0},
    "robust_kalman": {"c": 1e-26},
    "risk_sensitive": {"theta": 1e-26},
    "wasserstein_kalman": {"radius": 0.0},
    "mixed": {"M0": np.zeros((2, 2))},
    "moving_horizon": {"window": 5},
    "extended_kalman": {},
    "unscented_kalman": {},
    "gated_kalman": {"gate": 1e12},
    "huber_kalman": {"k": 1e9},
    "correntropy_kalman": {"sigma": 1e12},
    "student_kalman": {"dof": 1e22},
}


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("module", FILTERS)
def test_every_filter_has_nine_digits(module, system):
    """Oracle: rational arithmetic; the keys of a filter are those of its limit, the Kalman filter."""
    P0 = 1e-4 * 1e14 * np.eye(2)
    _, expected = exact(*SYSTEMS[system], P0)
    model = LinearModel(SYSTEMS[system][0], [[0.0], [0.1]], *SYSTEMS[system][1:])
    np.testing.assert_allclose(covariances(module, model, P0, FILTERS[module]), expected, **NINE)


@pytest.mark.parametrize("system", ["one sensor", "equal sensors", "nearly equal"])
def test_predictors_have_nine_digits(system):
    """Oracle: as above, for P_pred; a model without uncertainty is that of the robust predictors, too."""
    A, C, Q, R = SYSTEMS[system]
    P0 = 1e-4 * 1e14 * np.eye(2)
    before, after = exact(A, C, Q, R, P0)
    none = {"Bw": np.eye(2), "Dv": np.eye(len(C)), "W": Q.tolist(), "V": R.tolist()}
    model = uncertain_model(N, A=np.array(A), B=np.zeros((2, 1)), C=np.array(C), **none)
    for module, keys in (
        ("kalman_predictor", {}),
        ("enhanced_robust", {}),
        ("lmmse", {}),
        ("robust_h_infinity", {"alpha": 1.0}),
        ("h_infinity", {"theta": 0.0, "form": "predictor"}),
        ("sayed_bdu", {"form": "predictor"}),
    ):
        made = import_module(f"rmpc_bench.estimators.{module}").design(model, N, x0=np.zeros(2), P0=P0, **keys)
        P = made.extra["P_pred"] if made.P is None else made.P
        np.testing.assert_allclose(np.diagonal(P[:N], axis1=1, axis2=2), before, **NINE, err_msg=module)
    for module in ("lmmse", "sayed_bdu"):
        keys = {"form": "filter"}
        np.testing.assert_allclose(covariances(module, model, P0, keys), after, **NINE, err_msg=module)


def test_gains_of_every_run_have_nine_digits():
    """Oracle: as above; the first measurement of a run is missing."""
    P0 = 1e-4 * 1e14 * np.eye(2)
    A, C, Q, R = SYSTEMS["one sensor"]
    model = LinearModel(A, [[0.0], [0.1]], C, Q, R)
    _, expected = exact(A, C, Q, R, P0, first=1)
    for module in ("kalman", "moving_horizon", "gated_kalman", "unscented_kalman"):
        estimator = import_module(f"rmpc_bench.estimators.{module}").design(model, N, x0=np.zeros(2), P0=P0)
        state, y = estimator.init(2), np.zeros((2, 1))
        for k in range(N):
            y[1] = np.nan if k == 0 else 0.0
            state, estimate = estimator.correct(k, state, y)
            P = np.broadcast_to(estimate.P, (2, 2, 2))[1]
            np.testing.assert_allclose(np.diagonal(P), expected[k], **NINE)
            state = estimator.predict(k, state, np.zeros((2, 1)))


def test_points_of_a_nonlinear_model_have_nine_digits():
    """Oracle: as above; the maps are linear, but the filters do not know it."""
    plant = ode(
        0.1, N, ode=lambda x, u, p: [x[0] + 0.1 * x[1], x[1]], states=["a", "v"], discrete=True, x0=[0.0, 0.0],
        output=lambda x, p: [x[0]], outputs=["s"],
    )  # fmt: skip
    model = nonlinear(0.1, plant, noise=DesignNoise(1e-6, 1e-4))
    P0 = 1e-4 * 1e14 * np.eye(2)
    _, expected = exact(*SYSTEMS["one sensor"], P0)
    for keys in ({}, {"alpha": 0.5, "beta": 2.0, "kappa": 1.0}):
        np.testing.assert_allclose(covariances("unscented_kalman", model, P0, keys), expected, **NINE)
    # A Jacobian by differences has ten digits.
    np.testing.assert_allclose(covariances("extended_kalman", model, P0, {}), expected, rtol=1e-8)


def ball(P, c):
    """V of (13), (16) of zenere2018 by bisection."""
    lam, U = mp.eigsy(P)
    low, high = mp.mpf(0), 1 / max(lam)
    for _ in range(150):
        middle = (low + high) / 2
        above = sum(1 / (1 - middle * each) - 1 + mp.log(1 - middle * each) for each in lam) > c
        low, high = (low, middle) if above else (middle, high)
    return U * mp.diag([each / (1 - low * each) for each in lam]) * U.T


@pytest.mark.parametrize("sensors", [1, 2])
@pytest.mark.parametrize("module", ["robust_kalman", "risk_sensitive", "h_infinity"])
def test_inflated_covariances_have_nine_digits(module, sensors):
    """Oracle: the formulas in 40 digits (mpmath); the ball is not small, c = 0.1, and theta lambda_max(P(0)) = 0.2."""
    P0, theta, C = 1e10 * np.eye(2), 2e-11, [[1.0, 0.0]] * sensors
    keys = {"c": 0.1} if module == "robust_kalman" else {"theta": theta}
    keys |= {"form": "predictor"} if module == "h_infinity" else {}
    model = LinearModel(A, [[0.0], [0.1]], C, 1e-6, 1e-4)
    made = import_module(f"rmpc_bench.estimators.{module}").design(model, N, x0=np.zeros(2), P0=P0, **keys)
    with mp.workdps(40):
        F, H, Q, R = mp.matrix(A), mp.matrix(C), 1e-6 * mp.eye(2), 1e-4 * mp.eye(sensors)
        P, expected = mp.matrix(P0.tolist()), []
        for _ in range(N):
            expected.append([float(P[i, i]) for i in range(2)])
            V = ball(P, mp.mpf(0.1)) if "c" in keys else mp.inverse(mp.inverse(P) - mp.mpf(theta) * mp.eye(2))
            P = V - V * H.T * mp.inverse(H * V * H.T + R) * H * V
            P = F * P * F.T + Q
    np.testing.assert_allclose(np.diagonal(made.extra["P_pred"][:N], axis1=1, axis2=2), expected, **NINE)


def test_weights_have_nine_digits():
    """Oracle: the iteration of student-kalman with two equal sensors in 40 digits (mpmath), P(0) of 1e14 R."""
    model = LinearModel(A, [[0.0], [0.1]], [[1.0, 0.0]] * 2, 1e-6, 1.0)
    start = {"x0": np.zeros(2), "P0": 1e14 * np.eye(2)}
    estimator = import_module("rmpc_bench.estimators.student_kalman").design(model, N, **start, dof=3.0, iterations=6)
    _, estimate = estimator.correct(0, estimator.init(1), np.array([[5.0, 9.0]]))
    with mp.workdps(40):
        w, p = mp.mpf(1), mp.mpf(10) ** 14
        for _ in range(6):
            variance = 1 / (1 / p + 2 * w)
            x_hat, last = variance * w * 14, w
            w = (3 + 2) / (3 + (5 - x_hat) ** 2 + (9 - x_hat) ** 2 + 2 * variance)
    found = [estimate.x_hat[0, 0], estimate.P[0, 0, 0], estimate.info["weight"][0, 0]]
    np.testing.assert_allclose(found, [float(x_hat), float(variance), float(last)], **NINE)


def test_sensors_that_are_equal_or_nearly_so():
    """Oracle: by hand, 1 / (1 / P0 + 2 / R) and, for outputs x_1 and x_1 + 1e-7 x_2, 199.9996."""
    equal = corrected(np.array([[1.0, 0.0]] * 2), 1e-5 * np.eye(2), 1e3 * np.eye(2))
    assert covariance_of(equal.root)[0, 0] == pytest.approx(5e-11, rel=1e-12) and equal.regular
    near = corrected(np.array([[1.0, 0.0], [1.0, 1e-7]]), 1e-6 * np.eye(2), 1e4 * np.eye(2))
    assert covariance_of(near.root)[1, 1] == pytest.approx(199.9996, rel=1e-10)
    np.testing.assert_allclose(near.gain @ [1.0, 1.0 + 2e-7], [1.0, 2.0], rtol=4e-6)  # R / P of x_2


@pytest.mark.parametrize(
    ("module", "keys"), [("gated_kalman", {"gate": 1e12}), ("huber_kalman", {"k": 1e9}), ("gated_kalman", {}),
                         ("student_kalman", {"iterations": 1}), ("huber_kalman", {"variant": "innovation"})]
)  # fmt: skip
def test_two_equal_sensors_are_no_outliers(module, keys):
    """Oracle: e' S^-1 e = 1e-6 for x = [1, 2] without noise, P_11(0) = 5e-9 and x_hat_1 = 1."""
    model = LinearModel(A, [[0.0], [0.1]], [[1.0, 0.0]] * 2, 1e-6, 1e-8)
    start = {"x0": np.zeros(2), "P0": 1e6 * np.eye(2)}
    estimator = import_module(f"rmpc_bench.estimators.{module}").design(model, N, **start, **keys)
    _, estimate = estimator.correct(0, estimator.init(1), np.ones((1, 2)))
    np.testing.assert_allclose(estimate.x_hat[0, 0], 1.0, rtol=1e-12)
    if "variant" not in keys:
        np.testing.assert_allclose(estimate.P[0, 0, 0], 5e-9, rtol=1e-9)
    np.testing.assert_array_equal(estimate.info["weight"], 1.0)


def test_an_outlier_beside_a_good_sensor_is_clipped_at_any_start():
    """Oracle: the information form with the weight of the clipped output, k over its residual, P0 of 1e14 R."""
    model = LinearModel(A, [[0.0], [0.1]], [[1.0, 0.0]] * 2, 1e-6, 1.0)
    estimator = import_module("rmpc_bench.estimators.huber_kalman").design(
        model, N, x0=np.zeros(2), P0=1e14 * np.eye(2), k=2.0
    )
    _, estimate = estimator.correct(0, estimator.init(1), np.array([[5.0, 105.0]]))
    # x - 5 = 2, the force of the clipped output; P0^-1 x is 1e-13.
    np.testing.assert_allclose(estimate.x_hat[0, 0], 7.0, rtol=1e-9)
    np.testing.assert_allclose(estimate.info["weight"], [[1.0, 2.0 / 98.0]], rtol=1e-9)


def test_the_triangle_is_that_of_the_sum(rng):
    """Oracle: U' U = W' W for arrays of any shape; every matrix of a stack is computed alone."""
    for shape in ((3, 2), (2, 4), (5, 6, 3), (1, 1)):
        F = rng.standard_normal(shape)
        P = F @ F.mT
        root = lower_root(F)
        np.testing.assert_allclose(root @ root.mT, P, rtol=1e-12, atol=1e-13)
        np.testing.assert_array_equal(root, np.tril(root))
    np.testing.assert_array_equal(lower_root(F[None])[0], lower_root(F))


def test_a_singular_run_of_a_stack_has_the_pseudo_inverse(rng):
    """Oracle: numpy.linalg.pinv; a run that is not a number stays alone."""
    Y, Z = rng.standard_normal((4, 2, 3)), rng.standard_normal((4, 2, 3))
    Y[1, 1], Y[2, 0, 0] = 2.0 * Y[1, 0], np.nan
    found = conditional(Y, Z)
    assert found.regular.tolist() == [True, False, False, True]
    for i in (0, 1, 3):
        # Outputs scaled to variance 1 have another pseudo-inverse, with the same effect on outputs that can occur.
        np.testing.assert_allclose(found.gain[i] @ Y[i], Z[i] @ np.linalg.pinv(Y[i]) @ Y[i], rtol=1e-10)
        rest = Z[i] - found.gain[i] @ Y[i]
        np.testing.assert_allclose(covariance_of(found.root[i]), rest @ rest.T, rtol=1e-9, atol=1e-14)
    assert np.isnan(found.gain[2]).any() and np.isfinite(root_of(np.zeros((2, 2)))).all()
