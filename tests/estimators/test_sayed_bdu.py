"""Sayed's filter against its own regularised least squares, brute force, and the Kalman filter."""

import pickle

import numpy as np
import pytest
from conftest import random_model, random_psd
from estimators.uncertain_oracles import P0, X0, at, benchmark
from scipy.optimize import minimize, minimize_scalar

from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.sayed_bdu import design
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.types import DesignError


def system(rng, n_steps=8, nx=3, ny=2, *, varying=False, size=0.3, **changed):
    """Random system with uncertainty in A and Bw only, and noises with means."""
    steps = n_steps + 1 if varying else 1

    def some(*shape):
        return rng.standard_normal((steps, *shape))

    given = {
        "A": 0.4 * some(nx, nx), "B": some(nx, 1), "Bw": some(nx, 2), "C": some(ny, nx), "Dv": np.eye(ny)[None],
        "H_A": size * some(nx, 2), "G_x": some(2, nx), "H_Bw": size * some(nx, 1), "G_w": some(2, 2),
        "W": random_psd(rng, 2).tolist(), "V": random_psd(rng, ny).tolist(),
        "wbar": [0.3, -0.2], "vbar": rng.standard_normal(ny).tolist(),
    }  # fmt: skip
    return uncertain_model(n_steps, **given | changed)


class LeastSquares:
    """One step: min over z = (x(k) - x_hat(k), w(k)) of the worst cost, given y(k+1), x_hat(k) and P(k)."""

    def __init__(self, model, k, x_hat, P, y, u):
        m, after = model.system.at(k), model.system.at(k + 1)
        nominal, self.x_hat, self.nx = model.at(k), x_hat, len(x_hat)
        zero = np.zeros
        self.known = m.B @ u + nominal.f0
        self.map = np.hstack([m.A, m.Bw])
        self.A = after.C @ self.map
        self.b = y - model.at(k + 1).d0 - after.C @ (m.A @ x_hat + self.known)
        self.CM = after.C @ np.hstack([m.H_A, m.H_Bw])
        self.E = np.block([[m.G_x, zero((len(m.G_x), len(model.W)))], [zero((len(m.G_w), self.nx)), m.G_w]])
        self.E_b = -np.concatenate([m.G_x @ x_hat, zero(len(m.G_w))])
        self.Q = np.linalg.inv(np.block([[P, zero((self.nx, len(model.W)))], [zero((len(model.W), self.nx)), model.W]]))
        self.W = np.linalg.inv(model.at(k + 1).R_v)
        self.m = m

    @property
    def lam_l(self):
        """Lower bound of lam."""
        return np.linalg.norm(self.CM.T @ self.W @ self.CM, 2)

    def solve(self, lam):
        """The z of a lam: modified weights."""
        W = np.linalg.inv(np.linalg.inv(self.W) - self.CM @ self.CM.T / lam)
        Q = self.Q + lam * self.E.T @ self.E
        z = np.linalg.solve(Q + self.A.T @ W @ self.A, self.A.T @ W @ self.b + lam * self.E.T @ self.E_b)
        r, s = self.A @ z - self.b, self.E @ z - self.E_b
        return z, z @ self.Q @ z + lam * s @ s + r @ W @ r

    def worst(self, z):
        """The worst cost over Delta, by trying directions of Delta s on a circle, where M has two columns."""
        angles = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        size = np.linalg.norm(self.E @ z - self.E_b)
        r = (self.A @ z - self.b)[:, None] + self.CM @ np.vstack([np.cos(angles), np.sin(angles)]) * size
        return z @ self.Q @ z + np.einsum("ia,ij,ja->a", r, self.W, r).max()

    def x_hat_next(self, z):
        """Estimate of x(k+1)."""
        return self.m.A @ self.x_hat + self.known + self.map @ z


@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("alpha", [0.5, 3.0])
def test_a_step_solves_its_regularised_least_squares(alpha, varying, rng):
    """Oracle: the modified weights as one big linear system; known inputs, means, and lam = (1 + alpha) lam_l."""
    for _ in range(10):
        model = system(rng, varying=varying)
        filter_ = design(model, 8, x0=rng.standard_normal(3), P0=random_psd(rng, 3), alpha=alpha)
        state, past = filter_.init(1), []
        for k in range(8):
            y, u = rng.standard_normal((1, 2)), rng.standard_normal((1, 1))
            state, estimate = filter_.correct(k, state, y)
            if k:
                before, u_before = past[-1]
                problem = LeastSquares(model, k - 1, before.x_hat[0], before.P, y[0], u_before[0])
                z, _ = problem.solve((1 + alpha) * problem.lam_l)
                np.testing.assert_allclose(filter_.extra["lam"][k - 1], (1 + alpha) * problem.lam_l, rtol=1e-10)
                np.testing.assert_allclose(estimate.x_hat[0], problem.x_hat_next(z), atol=1e-8)
            past.append((estimate, u))
            state = filter_.predict(k, state, u)


def test_the_least_squares_are_a_min_max(rng):
    """Oracle: brute force; the worst Delta on a circle of directions, the best z by a simplex.

    With the lam where the dual function is least, a filter step gives that z.
    """
    for _ in range(5):
        model = system(rng, 1, nx=2, ny=1, H_A=0.3 * rng.standard_normal((1, 2, 1)))
        y, u, x0, start = rng.standard_normal((2, 1, 1)), np.zeros((1, 1)), rng.standard_normal(2), random_psd(rng, 2)
        first = design(model, 1, x0=x0, P0=start)
        state, estimate = first.correct(0, first.init(1), y[0])
        problem = LeastSquares(model, 0, estimate.x_hat[0], estimate.P, y[1, 0], u[0])
        dual = minimize_scalar(
            lambda t, problem=problem: problem.solve(problem.lam_l * (1 + np.exp(t)))[1],
            bounds=(-12, 12), method="bounded", options={"xatol": 1e-10},
        )  # fmt: skip
        z, cost = problem.solve(problem.lam_l * (1 + np.exp(dual.x)))
        options = {"xatol": 1e-9, "fatol": 1e-12, "maxiter": 20_000, "maxfev": 20_000, "adaptive": True}
        brute = minimize(problem.worst, z + 0.1, method="Nelder-Mead", options=options)
        np.testing.assert_allclose(cost, brute.fun, rtol=1e-4)  # the circle has 720 directions
        np.testing.assert_allclose(problem.worst(z), brute.fun, rtol=1e-4)
        best = design(model, 1, x0=x0, P0=start, alpha=float(np.exp(dual.x)))
        searched = design(model, 1, x0=x0, P0=start, lam="search")
        for filter_, atol in ((best, 1e-8), (searched, 1e-5)):  # the oracle's lam is good to 1e-7
            state, _ = filter_.correct(0, filter_.init(1), y[0])
            _, estimate = filter_.correct(1, filter_.predict(0, state, u), y[1])
            np.testing.assert_allclose(estimate.x_hat[0], problem.x_hat_next(z), atol=atol)


@pytest.mark.parametrize("varying", [False, True])
def test_the_search_finds_the_least_value_at_every_step(varying, rng):
    """Oracle: the published scalar function G(lam), evaluated by its normal equations on a grid of 400 values.

    The estimate of the found lam is that of the modified weights, solved as one big linear system.
    """
    for _ in range(4):
        model = system(rng, varying=varying)
        filter_ = design(model, 8, x0=rng.standard_normal(3), P0=random_psd(rng, 3), lam="search")
        state, past = filter_.init(2), []
        for k in range(9):
            y, u = rng.standard_normal((2, 2)), rng.standard_normal((2, 1))
            state, estimate = filter_.correct(k, state, y)
            for i in range(2 if k else 0):
                before, u_before = past[-1]
                problem = LeastSquares(model, k - 1, before.x_hat[i], before.P[i], y[i], u_before[i])
                lam = estimate.info["lam"][i, 0]
                assert lam > problem.lam_l
                z, least = problem.solve(lam)
                grid = problem.lam_l * (1 + np.logspace(-7, 7, 400))
                # The normal equations lose digits where lam is close to its lower bound.
                assert least <= min(problem.solve(each)[1] for each in grid) * (1 + 1e-6)
                np.testing.assert_allclose(estimate.x_hat[i], problem.x_hat_next(z), atol=1e-5)
            past.append((estimate, u))
            state = filter_.predict(k, state, u)


@pytest.mark.parametrize("form", ["filter", "predictor"])
def test_without_uncertainty_it_is_the_kalman_filter(form, rng):
    """Oracle: `kalman`; where the uncertainty is out of sight (C M = 0), for a plain linear model, and H = 0."""
    blind = {
        "C": [[1.0, 0, 0]],
        "H_A": [[0], [1.0], [0]],
        "H_Bw": [[0], [0], [2.0]],
        "vbar": [0.3],
        "V": 0.5,
        "Dv": 1.0,
    }
    certain = {"H_A": 0, "H_Bw": 0}
    for model in (
        system(rng, **blind),
        system(rng, **certain),
        system(rng, G_x=0, G_w=0, **certain),
        random_model(rng),
    ):
        start = random_psd(rng, 3)
        ours = design(model, 8, x0=np.ones(3), P0=start, form=form)
        theirs = kalman(model, 8, x0=np.ones(3), P0=start, form=form)
        for name in ("F", "K", "L", "P"):
            left, right = np.broadcast_arrays(getattr(ours, name), getattr(theirs, name))
            np.testing.assert_allclose(left, right, atol=1e-11)
        np.testing.assert_array_equal(ours.extra["lam"], np.zeros(9))


def filtered(filter_, y, u):
    """Estimates (runs, samples, nx) and matrices P of a filter."""
    state, x_hat, P = filter_.init(len(y)), [], []
    for k in range(y.shape[1]):
        state, estimate = filter_.correct(k, state, y[:, k])
        x_hat.append(estimate.x_hat)
        P.append(estimate.P)
        state = filter_.predict(k, state, u[:, k])
    return np.stack(x_hat, axis=1), P


def test_the_search_without_uncertainty_is_the_kalman_filter(rng):
    """Oracle: `kalman`; where the uncertainty is out of sight (C M = 0) and for a plain linear model; lam is 0."""
    blind = {"C": [[1.0, 0, 0]], "H_A": [[0], [1.0], [0]], "H_Bw": 0, "vbar": [0.3], "V": 0.5, "Dv": 1.0}
    for model in (system(rng, **blind), random_model(rng)):
        start = {"x0": np.ones(3), "P0": random_psd(rng, 3)}
        y, u = rng.standard_normal((4, 9, model.ny)), rng.standard_normal((4, 9, model.nu))
        ours, P = filtered(design(model, 8, **start, lam="search"), y, u)
        theirs, P_theirs = filtered(kalman(model, 8, **start), y, u)
        np.testing.assert_allclose(ours, theirs, atol=1e-11)
        for left, right in zip(P, P_theirs, strict=True):
            np.testing.assert_allclose(left, np.broadcast_to(right, left.shape), atol=1e-12)


def test_a_given_lam_is_the_approximation_with_that_lam(rng):
    """Oracle: alpha that gives the same lam; a value below the lower bound is refused, with the bound."""
    model = system(rng)
    start = {"x0": np.ones(3), "P0": random_psd(rng, 3)}
    theirs = design(model, 8, **start, alpha=2.0)
    ours = design(model, 8, **start, lam=float(theirs.extra["lam"][0]))
    for name in ("F", "K", "L", "P"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    with pytest.raises(DesignError, match="must be above .* = ") as error:
        design(model, 8, **start, lam=float(theirs.extra["lam"][0]) / 3.1)
    assert error.value.parameter == "lam"


def test_the_search_needs_the_measurement():
    """Oracle: lam of the step to k+1 uses y(k+1), which a predictor does not have."""
    with pytest.raises(DesignError, match="choose filter") as error:
        design(system(np.random.default_rng(1)), 8, x0=np.zeros(3), P0=np.eye(3), lam="search", form="predictor")
    assert error.value.parameter == "form"


def test_the_search_treats_every_run_on_its_own(rng):
    """Oracle: every run alone, and a pickle, bit for bit, beside a run whose measurement is missing."""
    model = system(rng, 12)
    filter_ = design(model, 12, x0=rng.standard_normal(3), P0=random_psd(rng, 3), lam="search")
    y, u = rng.standard_normal((7, 13, 2)), rng.standard_normal((7, 13, 1))
    y[3, 5] = np.nan
    x_hat, P = filtered(pickle.loads(pickle.dumps(filter_)), y, u)
    assert np.isnan(x_hat[3, 5:]).all() and np.isfinite(np.delete(x_hat, 3, axis=0)).all()
    for i in range(7):
        alone, P_alone = filtered(filter_, y[i : i + 1], u[i : i + 1])
        np.testing.assert_array_equal(alone[0], x_hat[i])
        np.testing.assert_array_equal(P_alone[-1][0], P[-1][i])


def test_the_recursion_is_the_papers(rng):
    """Oracle: Step 2 and Step 3 of Sayed (2001) written with inverses and the general E_f, E_g."""
    model = system(rng)
    m, W, R = model.system.at(0), model.W, model.at(0).R_v
    filter_ = design(model, 8, x0=np.zeros(3), P0=random_psd(rng, 3), alpha=0.7)
    E_f, E_g = np.vstack([m.G_x, np.zeros((2, 3))]), np.vstack([np.zeros((2, 2)), m.G_w])
    M, inv = np.hstack([m.H_A, m.H_Bw]), np.linalg.inv
    lam = 1.7 * np.linalg.norm(M.T @ m.C.T @ inv(R) @ m.C @ M, 2)
    for k in range(8):
        P = filter_.P[k]
        Q_hat = inv(inv(W) + lam * E_g.T @ inv(np.eye(4) + lam * E_f @ P @ E_f.T) @ E_g)
        R_hat, P_hat = R - m.C @ M @ M.T @ m.C.T / lam, inv(inv(P) + lam * E_f.T @ E_f)
        G_hat = m.Bw - lam * m.A @ P_hat @ E_f.T @ E_g
        F_hat = (m.A - lam * G_hat @ Q_hat @ E_g.T @ E_f) @ (np.eye(3) - lam * P_hat @ E_f.T @ E_f)
        P_pred = m.A @ P_hat @ m.A.T + G_hat @ Q_hat @ G_hat.T
        np.testing.assert_allclose(filter_.F[k], F_hat, atol=1e-10)
        np.testing.assert_allclose(filter_.extra["P_pred"][k + 1], P_pred, atol=1e-10)
        R_e = R_hat + m.C @ P_pred @ m.C.T
        np.testing.assert_allclose(filter_.P[k + 1], P_pred - P_pred @ m.C.T @ inv(R_e) @ m.C @ P_pred, atol=1e-10)
        np.testing.assert_allclose(filter_.L[k + 1], filter_.P[k + 1] @ m.C.T @ inv(R_hat), atol=1e-9)
        np.testing.assert_allclose(filter_.K[k], F_hat @ filter_.L[k], atol=1e-10)


def test_the_plant_of_the_paper_gets_a_stable_filter():
    """Oracle: the reference study section 8, sayed2001: a slow plant, dA12 = 0.099 at most; here a property only."""
    model = uncertain_model(
        500, A=[[0.9802, 0.0196], [0, 0.9802]], C=[[1, -1]], Bw=1.0, Dv=1.0, V=1.0,
        W=[[1.9608, 0.0195], [0.0195, 1.9605]], H_A=[[0.0198], [0]], G_x=[[0, 5]],
    )  # fmt: skip
    filter_ = design(model, 500, x0=np.zeros(2), P0=np.eye(2))
    m, K, F = model.system.at(0), filter_.K[-1], filter_.F[-1]
    np.testing.assert_allclose(filter_.P[-1], filter_.P[-2], rtol=1e-6)
    for delta in (-1.0, 0.0, 1.0):
        A = m.A + delta * m.H_A @ m.G_x
        both = np.block([[A, np.zeros((2, 2))], [K @ m.C, F - K @ m.C]])
        assert np.abs(np.linalg.eigvals(both)).max() < 1


def test_the_predictor_form_predicts(rng):
    """Oracle: the filter's own prediction."""
    model = system(rng)
    filter_ = design(model, 8, x0=np.ones(3), P0=np.eye(3))
    predictor = design(model, 8, x0=np.ones(3), P0=np.eye(3), form="predictor")
    np.testing.assert_array_equal(predictor.P, filter_.extra["P_pred"])
    np.testing.assert_array_equal(predictor.K, filter_.K)
    assert not predictor.L.any() and at(predictor.L, 3).shape == (3, 2)


def test_bad_parameters_are_design_errors(rng):
    """Oracle: the interface; the benchmark has no nominal measurement noise, so that R must be given."""
    with pytest.raises(DesignError, match="set R of this filter") as error:
        design(benchmark(5), 5, x0=X0, P0=P0)
    assert error.value.parameter == "R"
    design(benchmark(5), 5, x0=X0, P0=P0, R=2e4)
    with pytest.raises(DesignError, match="does not fit") as error:
        design(benchmark(5), 5, x0=X0, P0=P0, R=[1.0, 2.0])
    assert error.value.parameter == "R"
    with pytest.raises(DesignError, match="uncorrelated"):
        design(system(rng, Dw=rng.standard_normal((1, 2, 2))), 8, x0=np.zeros(3), P0=np.eye(3))


def test_a_singular_start_and_noise_are_welcome(rng):
    """Oracle: the limit of regular ones."""
    singular = {"W": [[1.0, 0.0], [0.0, 0.0]]}
    near = {"W": [[1.0, 0.0], [0.0, 1e-12]]}
    seed = np.random.default_rng(5)
    state = seed.bit_generator.state
    ours = design(system(seed, **singular), 8, x0=np.zeros(3), P0=np.zeros((3, 3)))
    seed.bit_generator.state = state
    theirs = design(system(seed, **near), 8, x0=np.zeros(3), P0=1e-12 * np.eye(3))
    np.testing.assert_allclose(ours.P, theirs.P, atol=1e-9)
    np.testing.assert_allclose(ours.K, theirs.K, atol=1e-8)
