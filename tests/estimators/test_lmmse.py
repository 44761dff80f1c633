"""The best linear estimators against one big joint covariance, exact moments and published numbers."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import STAT, random_model, random_psd
from estimators.uncertain_oracles import P0, X0, benchmark, ensemble, random_uncertain

from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.kalman_predictor import design as kalman_predictor
from rmpc_bench.estimators.lmmse import EntryLaw, design
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.types import DesignError

LAWS = pytest.mark.parametrize(("low", "high"), [(-1.0, 1.0), (0.0, 1.0), (-0.5, 0.8)])


def correlated(model, n_steps, S):
    """The same system with a cross-covariance of w and v."""
    given = {name: np.array(M) for name, M in model.system.over_time._asdict().items()}
    noises = {"W": [1.0, 2.0], "V": [0.5, 1.0], "wbar": [1.0, -1.0], "vbar": [0.5, 2.0]}
    return uncertain_model(n_steps, **given, **noises, S=S)


def best_by_joint_moments(model, x0, start, n, low, high, with_last=False):
    """Covariance of x(n) less its best linear estimate from y(0..n-1) and 1, from their joint second moment.

    ``with_last`` adds y(n): a further period in which x stays as it is.
    """
    mean, variance = 0.5 * (low + high), (high - low) ** 2 / 12
    nx, ny, nw = len(x0), model.ny, len(model.W)
    noise = np.concatenate([model.wbar, model.vbar])
    joint = np.block([[model.W, model.S], [model.S.T, model.V]]) + np.outer(noise, noise)
    z = np.concatenate([x0, [1.0]])  # [x; 1; all y so far]
    Z = np.outer(z, z)
    Z[:nx, :nx] += start
    for k in range(n + with_last):
        m, size = model.system.at(k), len(z)
        if k == n:
            still = {name: np.zeros_like(getattr(m, name)) for name in ("Bw", "Bv", "H_A", "H_Bw", "H_Bv")}
            m = m._replace(A=np.eye(nx), **still)

        def map_of(F, m=m, size=size):
            L = np.zeros((size + ny, size + len(noise)))
            L[nx:size, nx:size] = np.eye(size - nx)
            for rows, M, N_w, N_v, H_x, H_w, H_v in (
                (slice(0, nx), m.A, m.Bw, m.Bv, m.H_A, m.H_Bw, m.H_Bv),
                (slice(size, size + ny), m.C, m.Dw, m.Dv, m.H_C, m.H_Dw, m.H_Dv),
            ):
                L[rows, :nx] = M + H_x @ F[0] @ m.G_x
                L[rows, size : size + nw] = N_w + H_w @ F[1] @ m.G_w
                L[rows, size + nw :] = N_v + H_v @ F[2] @ m.G_v
            return L

        zero = [np.zeros((H.shape[1], len(G))) for H, G in ((m.H_A, m.G_x), (m.H_Bw, m.G_w), (m.H_Bv, m.G_v))]
        L_0, parts = map_of(zero), []
        for channel in range(3):
            for i in range(min(zero[channel].shape)):
                F = [part.copy() for part in zero]
                F[channel][i, i] = 1.0
                parts.append(map_of(F) - L_0)
        L_m = L_0 + mean * sum(parts)
        Q = np.block([[Z, np.outer(z, noise)], [np.outer(noise, z), joint]])
        Z = L_m @ Q @ L_m.T + variance * sum(L @ Q @ L.T for L in parts)
        z = L_m @ np.concatenate([z, noise])
    cov = Z[:nx, :nx] - Z[:nx, nx:] @ np.linalg.solve(Z[nx:, nx:], Z[nx:, :nx])
    return cov


@LAWS
@pytest.mark.parametrize("varying", [False, True])
def test_it_is_the_best_linear_predictor(low, high, varying, rng):
    """Oracle: one big joint second moment of x(n) and all measurements; F of several sizes, means, S, time varying."""
    model = correlated(random_uncertain(rng, 6, size=0.5, varying=varying), 6, [[0.1, 0.0], [0.05, -0.1]])
    start = random_psd(rng, 3)
    filter_ = design(model, 6, x0=np.ones(3), P0=start, law=EntryLaw(low=low, high=high))
    for n in (1, 4, 6):
        expected = best_by_joint_moments(model, np.ones(3), start, n, low, high)
        np.testing.assert_allclose(filter_.P[n], expected, rtol=1e-9, atol=1e-9 * np.trace(expected))


@LAWS
@pytest.mark.parametrize("varying", [False, True])
def test_the_filter_form_is_the_best_linear_filter(low, high, varying, rng):
    """Oracle: the joint second moment of x(n) and y(0..n); the predictions are those of the predictor."""
    model = correlated(random_uncertain(rng, 6, size=0.5, varying=varying), 6, [[0.1, 0.0], [0.05, -0.1]])
    keys = {"x0": np.ones(3), "P0": random_psd(rng, 3), "law": EntryLaw(low=low, high=high)}
    filter_, predictor = design(model, 6, form="filter", **keys), design(model, 6, **keys)
    for n in (0, 1, 4, 6):
        expected = best_by_joint_moments(model, keys["x0"], keys["P0"], n, low, high, with_last=True)
        # Two orders of the same sums, with one large linear solve in the oracle.
        np.testing.assert_allclose(filter_.P[n], expected, rtol=1e-9, atol=1e-9 * np.trace(expected))
        assert np.trace(filter_.P[n]) < np.trace(predictor.P[n])
    for name in ("F", "B", "C", "K", "f", "d"):
        np.testing.assert_array_equal(getattr(filter_, name), getattr(predictor, name))
    np.testing.assert_array_equal(filter_.extra["P_pred"], predictor.P)
    assert (filter_.form, predictor.form) == ("filter", "predictor")


def test_without_variance_the_filter_form_is_the_kalman_filter(rng):
    """Oracle: kalman, on a model without uncertainty."""
    plain, start = random_model(rng, 3, 1, 2), random_psd(rng, 3)
    ours = design(plain, 10, x0=np.ones(3), P0=start, form="filter")
    theirs = kalman(plain, 10, x0=np.ones(3), P0=start)
    for name in ("L", "K", "P"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-11, atol=1e-14)  # conditioning


def test_the_filter_form_reaches_the_known_floor_of_wkf2018():
    """Oracle: the error of the filter form in the reference study, 47.9 per state with standard error 1.2."""
    given = {"A": [[0.9802, 0.0196], [0, 0.9802]], "C": [[1, -1]], "H_A": [[0.99], [0]], "G_x": [[0, 1]],
             "Bw": np.eye(2), "Dv": [[1.0]], "W": [[1.9608, 0.0195], [0.0195, 1.9605]], "V": 1.0}  # fmt: skip
    filter_ = design(uncertain_model(500, **given), 500, x0=np.zeros(2), P0=np.eye(2), form="filter")
    assert abs(np.trace(filter_.P[500]) / 2 - 47.9) < STAT * 1.2


@LAWS
def test_P_is_the_exact_covariance_of_the_error(low, high, rng):
    """Oracle: the moments of the closed loop, which do not use that the gain is the best one; no bias."""
    for varying in (False, True):
        model = correlated(random_uncertain(rng, 40, size=0.4, varying=varying), 40, [[0.1, 0.0], [0.05, -0.1]])
        filter_ = design(model, 40, x0=np.ones(3), P0=random_psd(rng, 3), law=EntryLaw(low=low, high=high))
        mean, cov = ensemble(model, filter_, 40, low, high)
        np.testing.assert_allclose(cov, filter_.P, rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(mean, 0.0, atol=1e-11)


def test_no_other_gain_does_better(rng):
    """Oracle: the exact covariance with a perturbed gain is larger in every direction."""
    model = random_uncertain(rng, 5, size=0.5)
    filter_ = design(model, 5, x0=np.ones(3), P0=random_psd(rng, 3))
    for _ in range(20):
        K = filter_.K.copy()
        K[4] += 0.05 * rng.standard_normal((3, 2))
        other = replace(filter_, K=K)
        difference = ensemble(model, other, 5)[1][5] - filter_.P[5]
        assert np.linalg.eigvalsh(difference)[0] > -1e-13 * np.trace(filter_.P[5])
        assert np.trace(difference) > 0


@pytest.mark.parametrize(
    ("law", "diagonal", "trace"),
    [({"low": -1.0, "high": 1.0}, [4.960, 7.936], 12.90), ({"low": 0.0, "high": 1.0}, [5.305, 11.646], 16.95)],
)
def test_the_benchmark_has_the_known_covariance(law, diagonal, trace):
    """Oracle: the reference study section 7; the law by its moments is the same."""
    filter_ = design(benchmark(300), 300, x0=X0, P0=P0, law=EntryLaw(**law))
    np.testing.assert_allclose(np.diag(filter_.P[300]), diagonal, atol=5e-4)
    np.testing.assert_allclose(np.trace(filter_.P[300]), trace, atol=5e-3)
    mean = 0.5 * (law["low"] + law["high"])
    same = design(
        benchmark(300), 300, x0=X0, P0=P0, law=EntryLaw(mean=mean, variance=(law["high"] - law["low"]) ** 2 / 12)
    )
    np.testing.assert_allclose(same.P, filter_.P, rtol=1e-12)
    if mean == 0.0:
        np.testing.assert_array_equal(design(benchmark(300), 300, x0=X0, P0=P0).P, filter_.P)


def test_without_variance_it_is_the_kalman_predictor(rng):
    """Oracle: kalman-predictor on the system with F at its mean; on a plain linear model in any case."""
    model = random_uncertain(rng, 10)
    start = random_psd(rng, 3)
    for mean in (0.0, 0.7):
        ours = design(model, 10, x0=np.ones(3), P0=start, law=EntryLaw(mean=mean, variance=0.0))
        m = model.system.over_time
        given = {name: np.array(M) for name, M in m._asdict().items()}
        for H, G, changed in (
            ("H_A", "G_x", "A"), ("H_C", "G_x", "C"), ("H_Bw", "G_w", "Bw"), ("H_Dw", "G_w", "Dw"),
            ("H_Bv", "G_v", "Bv"), ("H_Dv", "G_v", "Dv"),
        ):  # fmt: skip
            F = mean * np.eye(given[H].shape[2], given[G].shape[1])
            given[changed] = given[changed] + given[H] @ F @ given[G]
        noises = {name: getattr(model, name).tolist() for name in ("W", "V", "wbar", "vbar")}
        theirs = kalman_predictor(uncertain_model(10, **given, **noises), 10, x0=np.ones(3), P0=start)
        for name in ("F", "C", "K", "P", "f", "d"):
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-10, atol=1e-12)
    plain = random_model(rng, 3, 1, 2)
    theirs = kalman_predictor(plain, 10, x0=np.ones(3), P0=start)
    np.testing.assert_allclose(design(plain, 10, x0=np.ones(3), P0=start).P, theirs.P, rtol=1e-12)


def test_a_law_is_said_in_one_way():
    """Oracle: the interface."""
    for wrong in ({}, {"low": -1.0}, {"mean": 0.0}, {"low": -1.0, "high": 1.0, "mean": 0.0}, {"low": 1.0, "high": 0.0}):
        with pytest.raises(ValueError, match="low"):
            EntryLaw(**wrong)
    assert EntryLaw(low=0.0, high=1.0).moments == (0.5, 1 / 12)
    assert EntryLaw(mean=0.2, variance=0.1).moments == (0.2, 0.1)


def test_a_system_that_is_unstable_in_the_mean_square_is_refused():
    """Oracle: by hand; x+ = (0.9 + F) x with F of variance 1 multiplies E x^2 by 1.81, beyond 1e100 at k = 389."""
    model = uncertain_model(600, A=[[0.9]], C=[[1.0]], H_A=[[1.0]], G_x=[[1.0]], Dv=[[1.0]], V=1.0)
    with pytest.raises(DesignError, match=r"beyond 1e\+100 at k = 389"):
        design(model, 600, x0=np.zeros(1), P0=np.eye(1), law=EntryLaw(mean=0.0, variance=1.0))
