"""The one-step predictor against filterpy, SciPy, one big Gaussian and published numbers."""

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd
from estimators.uncertain_oracles import P0, X0, benchmark, ensemble, random_uncertain
from filterpy.kalman import KalmanFilter
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.kalman_predictor import design
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.types import DesignError

SIZES = pytest.mark.parametrize(("nx", "ny"), [(1, 1), (3, 1), (4, 2), (2, 3)])


def correlated_model(rng, nx=3, ny=2, radius=0.95):
    """Random model with correlated noises and constant parts."""
    m, joint = random_model(rng, nx, 1, ny, radius), random_psd(rng, nx + ny)
    return LinearModel(
        m.A, m.B, m.C, joint[:nx, :nx], joint[nx:, nx:], S_wv=joint[:nx, nx:],
        f0=rng.standard_normal(nx), d0=rng.standard_normal(ny),
    )  # fmt: skip


@SIZES
def test_without_correlation_it_is_the_predictor_form_of_the_kalman_filter(nx, ny, rng):
    """Oracle: `kalman` in predictor form, and filterpy's P after its predict step."""
    m, start = random_model(rng, nx, 1, ny), random_psd(rng, nx)
    ours = design(m, 20, x0=np.ones(nx), P0=start)
    theirs = kalman(m, 20, x0=np.ones(nx), P0=start, form="predictor")
    np.testing.assert_allclose(ours.K, theirs.K, atol=1e-11)
    np.testing.assert_allclose(ours.P, theirs.P, atol=1e-11)
    other = KalmanFilter(dim_x=nx, dim_z=ny)
    other.F, other.H, other.Q, other.R, other.P = m.A, m.C, m.Q_w, m.R_v, start
    for k in range(20):
        np.testing.assert_allclose(ours.P[k], other.P, atol=1e-11)
        other.update(np.zeros(ny))
        other.predict()


@SIZES
def test_with_correlation_it_is_a_filter_of_independent_noises(nx, ny, rng):
    """Oracle: Anderson and Moore's change of variables, x+ = (A - S R^-1 C) x + S R^-1 y + w', which has none."""
    m, start = correlated_model(rng, nx, ny), random_psd(rng, nx)
    ours = design(m, 20, x0=np.ones(nx), P0=start)
    T = m.S_wv @ np.linalg.inv(m.R_v)
    changed = LinearModel(m.A - T @ m.C, m.B, m.C, m.Q_w - 0.5 * (T @ m.S_wv.T + m.S_wv @ T.T), m.R_v)
    theirs = kalman(changed, 20, x0=np.ones(nx), P0=start, form="predictor")
    np.testing.assert_allclose(ours.K, theirs.K + T, atol=1e-9)
    np.testing.assert_allclose(ours.P, theirs.P, atol=1e-10)


def test_the_errors_of_an_uncertain_models_nominal_part_have_the_promised_covariance(rng):
    """Oracle: exact moments without uncertainty, time varying, w and v correlated by Bv, Dw and S: unbiased, and P."""
    for varying in (False, True):
        model = random_uncertain(rng, 12, certain=True, varying=varying)
        shared = [[0.1, 0.0], [0.05, -0.1]]
        given = {name: np.array(M) for name, M in model.system.over_time._asdict().items()}
        model = uncertain_model(12, **given, W=[1.0, 2.0], V=[0.5, 1.0], S=shared, wbar=[1.0, -1.0], vbar=[0.5, 2.0])
        filter_ = design(model, 12, x0=np.ones(3), P0=random_psd(rng, 3))
        mean, cov = ensemble(model, filter_, 12, 0.0, 0.0)
        np.testing.assert_allclose(mean, 0.0, atol=1e-12)
        np.testing.assert_allclose(cov, filter_.P, atol=1e-11)


def test_the_classic_predictor_of_the_benchmark_has_the_published_covariance():
    """Oracle: souto2011, section 5, P_classic, one decimal; the reference study section 5, four; R = 0 and R not given.

    The nominal Dv is 0, and the gain tends to an error that is never forgotten (zero of the plant at z = 1).
    """
    for keys in ({}, {"R": 0.0}):
        filter_ = design(benchmark(), 1500, x0=X0, P0=P0, **keys)
        np.testing.assert_allclose(filter_.P[1500], [[3.6016, -0.6034], [-0.6034, 0.1076]], atol=5e-5)
        np.testing.assert_allclose(filter_.series()["rho"][1500], 0.9994, atol=5e-5)


def test_other_R_round_to_the_published_covariance_or_not():
    """Oracle: the reference study section 2: R = 1 and 2 do, R = 5 does not."""
    for R, fits in ((0.1, True), (1.0, True), (2.0, True), (5.0, False)):
        P = design(benchmark(), 1500, x0=X0, P0=P0, R=R).P[1500]
        assert (np.abs(P - [[3.6, -0.6], [-0.6, 0.1]]).max() < 0.05) == fits


@pytest.mark.parametrize(
    ("low", "R", "variance", "mse", "P"),
    [
        (-1, None, (82.25, 383.2), 465.5, (3.606, 0.130)),
        (0, None, (45.68, 204.9), 2311.7, (3.606, 0.130)),
        (-1, 2e4, (5.143, 8.234), 13.38, (4.281, 3.399)),
        (0, 2e4, (6.466, 15.333), 21.82, (4.281, 3.399)),
    ],
)
def test_its_true_variance_on_the_benchmark(low, R, variance, mse, P):
    """Oracle: the reference study section 7 (k = 300): exact moments under random uncertainty against its own P."""
    model = benchmark(300)
    filter_ = design(model, 300, x0=X0, P0=P0, R=R)
    mean, cov = ensemble(model, filter_, 300, low, 1.0)
    np.testing.assert_allclose(np.diag(cov[-1]), variance, rtol=2e-4)
    np.testing.assert_allclose(np.trace(cov[-1]) + mean[-1] @ mean[-1], mse, rtol=4e-4)
    np.testing.assert_allclose(np.diag(filter_.P[-1]), P, atol=6e-4)


def test_the_classic_variance_grows_without_limit():
    """Oracle: the reference study sections 5 and 10: 323.5 / 1550.9 at k = 1500, slope 0.2002 / 0.9692 per step."""
    model = benchmark()
    filter_ = design(model, 1500, x0=X0, P0=P0, R=0.0)
    _, cov = ensemble(model, filter_, 1500)
    variances = np.diagonal(cov, axis1=1, axis2=2)
    np.testing.assert_allclose(variances[1500], [323.5, 1550.9], rtol=2e-4)
    np.testing.assert_allclose((variances[1500] - variances[1000]) / 500, [0.2002, 0.9692], rtol=1e-3)
    assert (variances[1:] > np.diagonal(filter_.P, axis1=1, axis2=2)[1:]).all()


@pytest.mark.parametrize("radius", [0.5, 0.95, 1.1])
def test_the_steady_gain_solves_the_algebraic_equation(radius, rng):
    """Oracle: scipy.linalg.solve_discrete_are with the cross term, also of an unstable model; one entry for all k."""
    m = correlated_model(rng, radius=radius)
    filter_ = design(m, 30, x0=np.zeros(3), P0=np.eye(3), gain="steady")
    P = solve_discrete_are(m.A.T, m.C.T, m.Q_w, m.R_v, s=m.S_wv)
    assert filter_.K.shape == (1, 3, 2) and filter_.P.shape == (1, 3, 3)
    np.testing.assert_allclose(filter_.P[0], P, **ROUND)
    K = np.linalg.solve(m.C @ P @ m.C.T + m.R_v, (m.A @ P @ m.C.T + m.S_wv).T).T
    np.testing.assert_allclose(filter_.K[0], K, atol=1e-10)
    late = design(m, 500, x0=np.zeros(3), P0=np.eye(3))
    np.testing.assert_allclose(late.P[-1], P, rtol=1e-8)


@pytest.mark.parametrize(("delta", "variance"), [(0.0, 36.0), (0.3, 8352.8), (-0.3, 551.2)])
def test_the_nominal_predictor_of_xie_1994(delta, variance):
    """Oracle: the literature's table (xie1994, the reference study section 8): var(x1) of the true system."""
    given = {"A": [[0, -0.5], [1, 1]], "Bw": [[-6], [1]], "C": [[-100, 10]], "Dv": 1.0, "W": 1.0, "V": 1.0}
    filter_ = design(uncertain_model(10, **given), 10, x0=np.zeros(2), P0=np.eye(2), gain="steady")
    A, C, Bw, K = np.array(given["A"]), np.array(given["C"]), np.array(given["Bw"]), filter_.K[0]
    dA = np.array([[0, 0], [0, delta]])
    both = np.block([[A + dA, np.zeros((2, 2))], [dA, A - K @ C]])  # [x; x - x_pred]
    noise = np.block([[Bw, np.zeros((2, 1))], [Bw, -K]])
    np.testing.assert_allclose(solve_discrete_lyapunov(both, noise @ noise.T)[2, 2], variance, atol=0.05)


def test_what_has_no_steady_gain_is_a_design_error(rng):
    """Oracle: the benchmark with R = 0 (a closed loop eigenvalue at 1), a hidden unstable mode, a model that varies."""
    hidden = LinearModel(np.diag([2.0, 0.5]), np.ones((2, 1)), [[0.0, 1.0]], np.eye(2), np.eye(1))
    for model in (benchmark(5), hidden):
        with pytest.raises(DesignError, match="no stabilising solution") as error:
            design(model, 5, x0=X0, P0=P0, gain="steady")
        assert error.value.parameter == "gain"
    with pytest.raises(DesignError, match="varies"):
        design(random_uncertain(rng, 5, varying=True), 5, x0=np.zeros(3), P0=np.eye(3), gain="steady")


def test_an_R_that_does_not_fit_is_a_design_error(rng):
    """Oracle: the shape, the definiteness, and the Cauchy-Schwarz inequality of the two noises."""
    m = correlated_model(rng)
    for R in ([1.0, 2.0, 3.0], -1.0, 1e-6):
        with pytest.raises(DesignError) as error:
            design(m, 5, x0=np.zeros(3), P0=np.eye(3), R=R)
        assert error.value.parameter == "R"
    design(m, 5, x0=np.zeros(3), P0=np.eye(3), R=[2.0, 3.0])


def test_short_forms_of_R():
    """Oracle: the matrix they stand for."""
    m = LinearModel(0.5 * np.eye(2), np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    full = design(m, 5, x0=X0, P0=P0, R=[[3.0, 0.0], [0.0, 3.0]])
    for R in (3.0, [3.0, 3.0]):
        np.testing.assert_array_equal(design(m, 5, x0=X0, P0=P0, R=R).K, full.K)
