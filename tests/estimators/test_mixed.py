"""The filter for stochastic and bounded noises: the paper's system, SciPy's minimiser, limits and Monte Carlo."""

import numpy as np
import pytest
from conftest import ROUND, SOLVER, random_model, random_psd, within_stat
from estimators.mixed_systems import (
    M0,
    P0,
    START,
    X0,
    N,
    estimates,
    in_ellipsoid,
    paper_model,
    random_mixed,
    simulated,
    volume_and_trace,
)
from scipy.optimize import minimize, minimize_scalar

from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.mixed import design
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError, Model

SIZES = pytest.mark.parametrize(("nx", "ny"), [(1, 1), (2, 1), (3, 2), (2, 3)])


@pytest.mark.parametrize(
    ("q", "volume", "trace"), [("fixed-point", 295.90, 44.348), ("lag", 295.84, 44.352), ("one-pass", 284.35, 43.946)]
)
def test_volume_and_trace_on_the_papers_system(q, volume, trace):
    """Oracle: an independent implementation, mixed-noise.md section 1, all digits; Table I has 293.07 and 44.1025."""
    found = volume_and_trace(design(paper_model(), N, **START, q=q).M)
    assert (round(found[0], 2), round(found[1], 3)) == (volume, trace)


def cost(L, prior, C, P_v, M_v):
    """tr P + tr M of a gain with the weight that is best for it: the sum of two roots, squared."""
    rest = np.eye(len(C.T)) - L @ C
    sets = np.trace(rest @ prior["M"] @ rest.T), np.trace(L @ M_v @ L.T)
    return np.trace(rest @ prior["P"] @ rest.T + L @ P_v @ L.T) + np.sqrt(np.maximum(sets, 0.0)).sum() ** 2


def least_cost(prior, C, P_v, M_v):
    """Brute force over log q, each with its best gain by least squares, then Brent's method around the best one."""

    def of(z):
        V = prior["P"] + (1 + np.exp(-z)) * prior["M"]
        S = C @ V @ C.T + P_v + (1 + np.exp(z)) * M_v
        return cost(np.linalg.lstsq(S, C @ V, rcond=None)[0].T, prior, C, P_v, M_v)

    grid = np.linspace(-20.0, 20.0, 401)
    best = grid[np.argmin([of(z) for z in grid])]
    return minimize_scalar(of, bounds=(best - 0.1, best + 0.1), method="bounded", options={"xatol": 1e-9}).fun


@SIZES
def test_the_gain_is_the_exact_minimiser(nx, ny, rng):
    """Oracle: a scan of all weights; and BFGS over the entries of the gain, from three places, finds nothing better."""
    model = random_mixed(rng, nx, ny)
    ours = design(model, 6, x0=np.zeros(nx), P0=random_psd(rng, nx), M0=random_psd(rng, nx))
    for k in range(7):
        prior = {"P": ours.extra["P_pred"][k], "M": ours.extra["M_pred"][k]}
        sets = (model.at(k).C, model.at(k).R_v, model.M_v(k))
        least = np.trace(ours.P[k]) + np.trace(ours.M[k])
        np.testing.assert_allclose(least, cost(ours.L[k], prior, *sets), **ROUND)
        np.testing.assert_allclose(least, least_cost(prior, *sets), **SOLVER)
        for start in (ours.L[k].ravel() + 1e-3, np.zeros(nx * ny), rng.standard_normal(nx * ny)):
            theirs = minimize(lambda L, p=prior, s=sets: cost(L.reshape(nx, ny), p, *s), start)
            assert least <= theirs.fun * (1.0 + 1e-7)  # where q is at the edge of its reach, 1e-8 is lost


@SIZES
def test_p_and_q_are_those_of_the_paper(nx, ny, rng):
    """Oracle: (17), (18) and (20)-(24) written out with the weights that the design tells."""
    model = random_mixed(rng, nx, ny)
    for rule in ("fixed-point", "lag", "one-pass"):
        ours = design(model, 6, x0=np.zeros(nx), P0=random_psd(rng, nx), M0=random_psd(rng, nx), q=rule)
        for k in range(7):
            now, L, q, p = model.at(k), ours.L[k], ours.extra["q"][k], ours.extra["p"][k]
            P, M, rest = ours.extra["P_pred"][k], ours.extra["M_pred"][k], np.eye(nx) - L @ now.C
            V = P + (1 + 1 / q) * M
            S = now.C @ V @ now.C.T + (1 + q) * model.M_v(k) + now.R_v
            if 1e-6 < q < 1e6:  # at the edges of its reach the gain is that of 1e-8 or 1e8
                np.testing.assert_allclose(L @ S, V @ now.C.T, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(ours.P[k], rest @ P @ rest.T + L @ now.R_v @ L.T, atol=1e-12)
            left = (1 + 1 / q) * rest @ M @ rest.T + (1 + q) * L @ model.M_v(k) @ L.T
            np.testing.assert_allclose(ours.M[k], left, rtol=1e-9, atol=1e-12)
            if k < 6:
                moved = now.A @ ours.M[k] @ now.A.T
                np.testing.assert_allclose(p, np.sqrt(np.trace(moved) / np.trace(model.M_w(k))), **ROUND)
                total = (1 + 1 / p) * moved + (1 + p) * model.M_w(k)
                np.testing.assert_allclose(ours.extra["M_pred"][k + 1], total, atol=1e-12)
                np.testing.assert_allclose(ours.extra["P_pred"][k + 1], now.A @ ours.P[k] @ now.A.T + now.Q_w, **ROUND)


@SIZES
@pytest.mark.parametrize("q", ["fixed-point", "lag", "one-pass"])
def test_without_sets_it_is_the_kalman_filter(nx, ny, q, rng):
    """Oracle: the Kalman filter, on a model that knows no sets and on one whose sets are points."""
    plain = random_model(rng, nx, 1, ny)
    start = {"x0": rng.standard_normal(nx), "P0": random_psd(rng, nx)}
    y = rng.standard_normal((4, 11, ny))
    for model in (plain, random_mixed(rng, nx, ny, 10, M_w=0.0, M_v=0.0)):
        for use_y0 in (True, False):
            theirs = kalman(model, 10, **start, use_y0=use_y0)
            ours = design(model, 10, **start, M0=np.zeros((nx, nx)), q=q, use_y0=use_y0)
            for name in ("L", "K", "P"):
                np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-12, atol=1e-14)
            assert not ours.M.any()
            for a, b in zip(estimates(ours, y), estimates(theirs, y), strict=True):
                np.testing.assert_allclose(a.x_hat, b.x_hat, rtol=1e-12, atol=1e-13)


def test_y0_is_left_out_on_request():
    """Oracle: (16)-(18), which begin with a prediction from x0, P0 and M0."""
    ours = design(paper_model(), N, **START)
    np.testing.assert_array_equal(ours.M[0], M0)
    np.testing.assert_array_equal(ours.P[0], P0)
    np.testing.assert_array_equal(estimates(ours, np.full((2, 1, 1), 1e3))[0].x_hat, [X0, X0])
    with_y0 = design(paper_model(), N, x0=X0, P0=P0, M0=M0)
    assert np.trace(with_y0.M[0]) < np.trace(M0)


@pytest.mark.parametrize("zeros", range(8))
def test_any_set_may_be_a_point(zeros, rng):
    """Oracle: the limit of tiny sets, of shape 1e-13 times the usual one; none divides by zero."""
    names = [name for number, name in enumerate(("M_w", "M_v", "M0")) if zeros >> number & 1]
    seed, found = int(rng.integers(2**31)), []
    for factor in (0.0, 1e-13):
        twin = np.random.default_rng(seed)
        model = random_mixed(twin, 3, 2)
        start = {"x0": np.zeros(3), "P0": random_psd(twin, 3), "M0": random_psd(twin, 3)}
        factors = {name: factor if name in names else 1.0 for name in model.matrices}
        keys = {name: np.asarray(each.given * factors[name]) for name, each in model.matrices.items()}
        start["M0"] *= factor if "M0" in names else 1.0
        same = type(model)({name: each._replace(given=keys[name]) for name, each in model.matrices.items()},
                           model.w_mean, model.v_mean)  # fmt: skip
        with np.errstate(all="raise"):
            found.append(design(same, 6, **start))
    for name in ("L", "P", "M"):
        exact, limit = (getattr(each, name) for each in found)
        assert np.isfinite(exact).all()
        np.testing.assert_allclose(
            exact, limit, atol=2e-4
        )  # a set of size s adds 2 sqrt(s) times the other, 6e-7, and on


def test_a_set_that_nobody_sees_stays(rng):
    """Oracle: by hand; C = 0 moves nothing, whatever the noise."""
    model = random_mixed(rng, 2, 1, C=np.zeros((1, 2)))
    start = {"x0": np.zeros(2), "P0": np.eye(2), "M0": np.eye(2)}
    ours = design(model, 6, **start)
    np.testing.assert_array_equal(ours.L, 0.0)
    np.testing.assert_allclose(ours.M, ours.extra["M_pred"], **ROUND)


def test_one_state_all_or_nothing():
    """Oracle: by hand; with P = 0 and C = 1 the cost (|1 - L| m + |L| v)^2 is least at L = 0 or 1, the smaller set."""
    for M_v, L, M in ((4.0, 0.0, 1.0), (0.25, 1.0, 0.25)):
        model = paper_like(M_v)
        ours = design(model, 0, x0=np.zeros(1), P0=np.zeros((1, 1)), M0=np.eye(1))
        np.testing.assert_allclose(ours.L[0, 0, 0], L, atol=1e-7)  # q is at the edge of its reach
        np.testing.assert_allclose(ours.M[0, 0, 0], M, rtol=1e-7)


def paper_like(M_v):
    """x(k+1) = x(k), y = x + v, with v in a set only."""
    from rmpc_bench.models.mixed_noise import design as mixed_model

    return mixed_model(0, A=1.0, C=1.0, M_v=M_v)


@pytest.mark.parametrize("q", ["fixed-point", "lag", "one-pass"])
def test_the_errors_are_what_is_promised(q, rng):
    """Oracle: Monte Carlo; without stochastic noise the error stays in E(0, M), without bounded noise it has P."""
    model, runs = random_mixed(rng, 2, 1, 8), 4000
    ours = design(model, 8, x0=np.zeros(2), P0=np.eye(2), M0=np.eye(2), q=q)
    for surface in (False, True):
        start = in_ellipsoid(rng, np.eye(2), runs, surface)
        x, y = simulated(rng, model, runs, 8, start, stochastic=False, surface=surface)
        for k, each in enumerate(estimates(ours, y)):
            error = each.x_hat - x[:, k]
            assert np.einsum("ri,ij,rj->r", error, np.linalg.inv(ours.M[k]), error).max() <= 1.0 + 1e-9  # rounding
    still = random_mixed(np.random.default_rng(20180418), 2, 1, 8)
    x, y = simulated(rng, Quiet(still), runs, 8, rng.standard_normal((runs, 2)))
    for k, each in enumerate(estimates(design(still, 8, x0=np.zeros(2), P0=np.eye(2), M0=np.eye(2), q=q), y)):
        error = each.x_hat - x[:, k]
        assert within_stat(error[:, :, None] * error[:, None, :], each.P)


class Quiet(Model):
    """A model whose bounded noises are next to nothing."""

    has_sets = True

    def __init__(self, model):
        self.at = model.at
        self.M_w = lambda k: 1e-24 * model.M_w(k)
        self.M_v = lambda k: 1e-24 * model.M_v(k)


def test_known_means_count(rng):
    """Oracle: shifting the model's means and the data's alike moves no error."""
    model, shifted = (random_mixed(np.random.default_rng(4), 2, 1, 8, **means)
                      for means in ({}, {"w_mean": [1.0, -2.0], "v_mean": 3.0}))  # fmt: skip
    start = {"x0": np.zeros(2), "P0": np.eye(2), "M0": np.eye(2)}
    errors = []
    for each in (model, shifted):
        x, y = simulated(np.random.default_rng(5), each, 3, 8, np.zeros((3, 2)))
        errors.append([e.x_hat - x[:, k] for k, e in enumerate(estimates(design(each, 8, **start), y))])
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-12)


def test_a_singular_innovation_is_a_design_error():
    """Oracle: a perfect sensor on a perfectly known state; the message names the step."""
    model = LinearModel(np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), np.zeros((1, 1)))
    zero = np.zeros((1, 1))
    with pytest.raises(DesignError, match="k = 0"):
        design(model, 3, x0=np.zeros(1), P0=zero, M0=zero)
    design(model, 1, x0=np.zeros(1), P0=zero, M0=np.eye(1), use_y0=False)  # y(1) tells all of x


def test_a_set_without_bound_is_a_design_error():
    """Oracle: by hand; nobody sees x, and sqrt(M(k)) = 2^k goes beyond 1e50 at k = 167."""
    from rmpc_bench.models.mixed_noise import design as mixed_model

    model = mixed_model(200, A=2.0, C=[[0.0]], P_v=1.0)
    zero = np.zeros((1, 1))
    design(model, 165, x0=np.zeros(1), P0=zero, M0=np.eye(1))
    with pytest.raises(DesignError, match=r"the set of the prediction grows beyond 1e\+100 at k = 167"):
        design(model, 200, x0=np.zeros(1), P0=zero, M0=np.eye(1))


def test_estimates_and_series_show_the_sets(rng):
    """Oracle: the protocol; M and P are those of k, the weights have one entry per sample."""
    ours = design(paper_model(), N, **START)
    for k, each in enumerate(estimates(ours, rng.standard_normal((2, N + 1, 1)))):
        np.testing.assert_array_equal(each.M, ours.M[k])
        np.testing.assert_array_equal(each.P, ours.P[k])
    series = ours.series()
    assert {"K", "L", "P", "M", "P_pred", "M_pred", "p", "q", "rho"} == set(series)
    assert all(len(values) in (1, N + 1) for values in series.values())
