"""Compiled weights and corrections against plain ones in the space of the states (tests/estimators/outlier_twin.py)."""

import numpy as np
import pytest
from conftest import ROUND, random_psd
from estimators import outlier_twin as twin
from filterpy.kalman import KalmanFilter

from rmpc_bench.numerics import output_weights_kernel as kernel
from rmpc_bench.numerics.output_weights import (
    LAWS,
    OwnState,
    WeightLaw,
    corrected,
    measured,
    predicted,
    whitening,
    whitening_of_runs,
)

RUNS = 12


@pytest.fixture(params=[(2, 1), (3, 2), (4, 3)], ids=str)
def data(request, rng):
    """Predictions of some runs, with covariances of their own, and measurements of which many are outliers."""
    n, m = request.param
    C, R = rng.standard_normal((m, n)), random_psd(rng, m)
    P = np.array([random_psd(rng, n) for _ in range(RUNS)])
    x, d = rng.standard_normal((RUNS, n)), rng.standard_normal(m)
    y = x @ C.T + d + rng.standard_normal((RUNS, m)) * rng.choice([0.3, 3.0, 30.0], (RUNS, m))
    return C, d, R, OwnState(x, np.linalg.cholesky(P)), y


def by_kernels(law, C, d, R, state, y):
    T = whitening(R)
    found = measured(C, d, R, whitening_of_runs(T, R, np.isnan(y)), state, y)
    made = corrected(law, state, found.q, found.H, y.shape[1] - np.isnan(y).sum(axis=1))
    return found, made, made.after


def P_of(state):
    return state.root @ state.root.mT


PLAIN = {
    "student": (WeightLaw("student", (3.0, 10.0)), lambda *a: twin.student(*a, 3.0, 10)),
    "huber": (WeightLaw("huber", (1.3,)), lambda *a: twin.iterated(*a, lambda r: twin.huber_weight(r, 1.3), False, "")),
    "correntropy": (
        WeightLaw("correntropy", (4.0,)),
        lambda *a: twin.iterated(*a, lambda r: twin.correntropy_weight(r, 4.0), False, "prediction"),
    ),
    "gate": (WeightLaw("gate", (6.0, 6.0, 6.0)), lambda *a: twin.gated(*a, 6.0)),
}


@pytest.mark.parametrize("name", PLAIN)
def test_against_the_plain_correction(name, data):
    """Oracle: information form with inverses; reweighting by itself stops at 1e-11 of a residual."""
    law, plain = PLAIN[name]
    C, d, R, state, y = data
    _, made, after = by_kernels(law, *data)
    for i in range(RUNS):
        x_hat, P_hat, w = plain(state.x[i], P_of(state)[i], C, R, y[i] - C @ state.x[i] - d)
        loose = 1e-8 if name in ("huber", "correntropy") else 1e-10  # fixed points of slow iterations; inverses
        np.testing.assert_allclose(after.x[i], x_hat, rtol=loose, atol=loose)
        np.testing.assert_allclose(P_of(after)[i], P_hat, rtol=loose, atol=loose)
        np.testing.assert_allclose(made.weight[i], w, rtol=loose, atol=loose)
    assert (made.weight < 0.9).any() and (made.weight > 0.9).any()


@pytest.mark.parametrize(("name", "number"), [("huber", 1.3), ("correntropy", 4.0)])
def test_weights_of_the_prediction(name, number, data):
    """Oracle: the same iteration in the space of the states."""
    weight = twin.huber_weight if name == "huber" else twin.correntropy_weight
    C, d, R, state, y = data
    y = state.x @ C.T + d + np.clip(y - state.x @ C.T - d, -2.0, 2.0)  # so that 200 iterations are enough
    _, _, after = by_kernels(WeightLaw(name, (number,), True), C, d, R, state, y)
    for i in range(RUNS):
        e = y[i] - C @ state.x[i] - d
        start = "prediction" if name == "correntropy" else ""
        x_hat, P_hat, _ = twin.iterated(
            state.x[i], P_of(state)[i], C, R, e, lambda r: weight(r, number), True, start, steps=200
        )
        np.testing.assert_allclose(after.x[i], x_hat, rtol=1e-7, atol=1e-7)  # where an iteration stops
        np.testing.assert_allclose(P_of(after)[i], P_hat, rtol=1e-7, atol=1e-7)


def test_clipped_innovation(data):
    """Oracle: the formula; its P needs the share `kept` of the correction without weights."""
    C, d, R, state, y = data
    _, made, after = by_kernels(WeightLaw("innovation", (1.3,)), *data)
    for i in range(RUNS):
        x_hat, _, w = twin.clipped(state.x[i], P_of(state)[i], C, R, y[i] - C @ state.x[i] - d, 1.3, 0.8)
        np.testing.assert_allclose(after.x[i], x_hat, rtol=1e-10, atol=1e-10)  # two factorisations
        np.testing.assert_allclose(made.weight[i], w, rtol=1e-10)


def test_a_single_output_of_two(data, rng):
    """Oracle: the same law with the output that is missing left out of the model."""
    C, d, R, state, y = data
    if len(C) == 1:
        pytest.skip("needs a second output")
    gone = y.copy()
    gone[:, 1] = np.nan
    there = np.arange(len(C)) != 1
    for law, _ in PLAIN.values():
        _, made, after = by_kernels(law, C, d, R, state, gone)
        _, alone, expected = by_kernels(law, C[there], d[there], R[np.ix_(there, there)], state, y[:, there])
        np.testing.assert_allclose(after.x, expected.x, rtol=1e-9, atol=1e-9)  # a stop of an iteration, at another m
        np.testing.assert_allclose(P_of(after), P_of(expected), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(made.weight[:, there], alone.weight, rtol=1e-9)


def test_with_given_weights_it_is_filterpys_filter(data, rng):
    """Oracle: filterpy with R_v over the weights, and its prediction."""
    C, d, R, state, y = data
    n, m = C.shape[1], len(C)
    found = measured(C, d, R, whitening(R)[None], state, y)
    T, A, Q, B, u = whitening(R), rng.standard_normal((n, n)), random_psd(rng, n), np.ones((n, 1)), y[:, :1]
    w, after = corrected(WeightLaw("correntropy", (40.0,)), state, found.q, found.H)
    moved = predicted(A, B, np.zeros(n), Q, after, u)
    for i in range(RUNS):
        theirs = KalmanFilter(dim_x=n, dim_z=m, dim_u=1)
        theirs.x, theirs.P, theirs.H, theirs.F, theirs.Q, theirs.B = state.x[i], P_of(state)[i], C, A, Q, B
        theirs.update(y[i] - d, R=np.linalg.inv(T) @ np.diag(1.0 / np.maximum(w[i], 1e-30)) @ np.linalg.inv(T).T)
        np.testing.assert_allclose(found.e[i], y[i] - d - C @ state.x[i], rtol=1e-10, atol=1e-12)  # rounding of sums
        np.testing.assert_allclose(found.S[i], C @ P_of(state)[i] @ C.T + R, **ROUND)
        np.testing.assert_allclose(after.x[i], theirs.x, rtol=1e-10, atol=1e-10)  # inverses of random matrices
        np.testing.assert_allclose(P_of(after)[i], theirs.P, rtol=1e-10, atol=1e-12)
        theirs.predict(u=u[i])
        np.testing.assert_allclose(moved.x[i], theirs.x, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(P_of(moved)[i], theirs.P, rtol=1e-10, atol=1e-12)


def test_a_weight_of_zero_leaves_the_prediction(data):
    """An output so far away that exp underflows; no division by its weight."""
    C, d, R, state, y = data
    _, made, after = by_kernels(WeightLaw("correntropy", (0.5,)), C, d, R, state, y + 1e5)
    assert (made.weight == 0.0).all()
    np.testing.assert_array_equal(after.x, state.x)
    np.testing.assert_allclose(P_of(after), P_of(state), **ROUND)


def test_a_prediction_without_variance_is_kept(data):
    """P of rank 1: x moves in its range only, also with weights of x - x_pred."""
    C, d, R, state, y = data
    h = np.arange(1.0, C.shape[1] + 1.0)
    flat = OwnState(state.x, np.tile(np.pad(h[:, None], ((0, 0), (0, len(h) - 1))), (RUNS, 1, 1)))
    _, _, after = by_kernels(WeightLaw("huber", (1.3,), True), C, d, R, flat, y)
    move = after.x - state.x
    np.testing.assert_allclose(move, np.outer(move[:, 0], h), rtol=1e-9, atol=1e-9)  # rounding of a difference
    assert np.abs(move).max() > 1e-3


def test_a_run_that_is_not_a_number_ends_and_stays_alone(data):
    """NaN and infinity end no loop and change no other run."""
    C, d, R, state, y = data
    broken = OwnState(state.x.copy(), state.root.copy())
    broken.x[3], broken.root[4], broken.x[5] = np.nan, np.nan, np.inf
    for law in [law for law, _ in PLAIN.values()] + [WeightLaw("huber", (1.0,), True)]:
        _, _, after = by_kernels(law, C, d, R, broken, y)
        _, _, expected = by_kernels(law, C, d, R, state, y)
        np.testing.assert_array_equal(np.delete(after.x, [3, 4, 5], 0), np.delete(expected.x, [3, 4, 5], 0))


def test_names_are_in_the_order_of_the_kernel():
    assert LAWS == ("student", "huber", "correntropy", "gate", "innovation")
    numbers = (kernel.STUDENT, kernel.HUBER, kernel.CORRENTROPY, kernel.GATE, kernel.INNOVATION)
    assert numbers == tuple(range(len(LAWS)))
