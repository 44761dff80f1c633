"""The minimax law in the hands of estimators: which sets count, and how close its bound comes to the worst."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND, SOLVER
from controllers import minimax_oracles as oracles
from numerics.test_game_table import nearly_double

from rmpc_bench.controllers.minimax_lq import design
from rmpc_bench.controllers.state_feedback import lqr
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.mixed import design as mixed
from rmpc_bench.estimators.set_membership import design as set_membership
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.types import DesignError, Estimate, Estimator

STEPS = 22
X = np.array([[60.0, -45.0], [3.0, -2.0], [0.2, 0.1], [0.0, 0.0]])
START = {"x0": np.array([60.0, -45.0]), "P0": 100.0 * np.eye(2), "M0": 400.0 * np.eye(2)}
WEIGHTS = {"Q_x": [10.0, 1.0], "R_u": 1.0}
M_W = np.array([[5.0, 2.0], [2.0, 5.0]])


def paper_model(N=20):
    """The model of (72)-(75)."""
    A = oracles.paper_stages(0, STEPS + N).A
    return mixed_model(STEPS, A=A, B=[[1.0], [0.3]], C=[[0.2, 1.0]], P_w=0.25, M_w=M_W, P_v=0.25, M_v=5.0)


def controls(law, k, x, M=None):
    """What a law commands for estimates x."""
    estimate = Estimate(x, None, M, np.zeros(len(x), dtype=np.int8), {})
    return law.control(k, law.init(len(x)), np.zeros((len(x), 1)), estimate, np.zeros((1, 1)))[1].u


def sets_of(name, model):
    """An estimator with the sets that it stands for, M at k = 20 and M_w, by hand."""
    if name == "mixed":
        made = mixed(model, STEPS, **START, use_y0=False)
        return made, made.M[20], M_W
    if name == "set-membership":
        made = set_membership(model, STEPS, **START, use_y0=False)
        p = np.sqrt(10.0 / (0.5 * 5.991464547107979))
        return made, made.M[20], (1 + 1 / p) * M_W + (1 + p) * 0.25 * 5.991464547107979 * np.eye(2)
    made = kalman(model, STEPS, **START, use_y0=False)
    return made, 5.991464547107979 * made.P[20], 0.25 * 5.991464547107979 * np.eye(2)


@pytest.mark.parametrize("name", ["mixed", "set-membership", "kalman"])
@pytest.mark.parametrize("N", [1, 5, 10, 20])
@pytest.mark.parametrize("set", ["stacked", "product"])
def test_the_sets_of_every_estimator(name, N, set):
    """Oracle: the dense form with the sets that mixed-noise control gives to each: M_k, 5.991 P, sums of both."""
    model = paper_model(N)
    estimator, M, M_w = sets_of(name, model)
    law = design(model, STEPS, estimator, horizon=N, set=set, **WEIGHTS)
    wide = np.array([M_w] * N) * (N if set == "product" else 1)
    u = controls(law, 20, X)
    for row, x in enumerate(X):
        rho, U = oracles.dense(oracles.paper_stages(20, N), M, wide, x)
        np.testing.assert_allclose(u[row], U[0], rtol=0.0, atol=1e-9)  # what is asked for
        np.testing.assert_allclose(law.certificate(20, x[None], 1)[0], rho, rtol=1e-11)  # as in test_lq_game


def test_a_price_per_stage_controls_almost_the_same():
    """Oracle: the semidefinite program's optimum is as good (test_lq_game); here the control, against the product's."""
    model = paper_model(10)
    estimator, _, _ = sets_of("mixed", model)
    product, stages = (
        design(model, STEPS, estimator, horizon=10, set=name, **WEIGHTS) for name in ("product", "stages")
    )
    u, v = controls(product, 20, X[:2]), controls(stages, 20, X[:2])
    assert 0.0 < np.abs(u / v - 1.0).max() < 0.01


def test_sets_that_come_with_the_data():
    """Oracle: the same sets as a schedule; every run has its own."""
    model = paper_model(10)
    estimator, M, _ = sets_of("mixed", model)
    law = design(model, STEPS, set_membership(model, STEPS, **START, inflate=False, update="maksarov-norton"),
                 horizon=10, **WEIGHTS)  # fmt: skip
    own = np.array([M, 2.0 * M, 0.5 * M])
    u = controls(law, 20, X[:3], own)
    scheduled = design(model, STEPS, estimator, horizon=10, **WEIGHTS)
    np.testing.assert_allclose(u[0], controls(scheduled, 20, X[:1])[0], rtol=1e-9)  # tables against the exact solver
    for row in range(3):
        _, U = oracles.dense(oracles.paper_stages(20, 10), own[row], np.array([M_W] * 10), X[row])
        np.testing.assert_allclose(u[row], U[0], rtol=0.0, atol=1e-9)  # what is asked for
    assert scheduled.certifies and not law.certifies


def test_where_tables_do_not_hold_the_exact_solver_does(monkeypatch):
    """Oracle: the dense form, for a design whose eigenvalues cross (its tables are refused), and for a huge state."""
    stages, M, M_w = nearly_double(1e-3)
    model = mixed_model(1, A=stages.A[0], B=stages.B[0], C=[[1.0, 0.0]], P_v=1.0, M_w=M_w[0])
    made = kalman(model, 1, x0=np.zeros(2), P0=M / 5.991464547107979, use_y0=False)
    law = design(model, 1, made, horizon=6, Q_x=1.0, R_u=1.0)
    law = replace(law, w_roots=np.sqrt(M_w))  # the same set of w, which a Kalman filter does not believe in
    assert not law._tables.usable[0]
    for x in (np.array([1.0, 0.4]), np.array([1e5, 3e4])):
        _, U = oracles.dense(stages, M, M_w, x)
        np.testing.assert_allclose(controls(law, 0, x[None])[0], U[0], rtol=1e-7)  # what is asked for


@pytest.mark.parametrize("k", [5, 20])
def test_certificates_against_allowed_noise(k):
    """Oracle: noise that is found by search.  Stacked is exceeded, product never, one price per stage attained."""
    model = paper_model(10)
    estimator, _, _ = sets_of("mixed", model)
    for name, low, high in (("stacked", 1.5, 10.0), ("product", 0.5, 1.0), ("stages", 1.0 - 1e-4, 1.0 + 1e-9)):
        rho, worst = design(model, STEPS, estimator, horizon=10, set=name, **WEIGHTS).certificate(k, X, 40)
        assert (worst / rho >= low).all() and (worst / rho <= high).all(), name


def test_without_sets_it_is_linear_quadratic_control():
    """Oracle: lqr; a model without noise and an estimator that is certain."""
    model = LinearModel([[0.9, 0.3], [0.0, 0.7]], [[0.0], [1.0]], [[1.0, 0.0]], 0.0, 1.0)
    estimator = kalman(model, 3, x0=np.zeros(2), P0=np.zeros((2, 2)))
    ours = design(model, 3, estimator, horizon=7, **WEIGHTS)
    expected = lqr(model, 3, estimator, horizon=7, **WEIGHTS)
    np.testing.assert_allclose(controls(ours, 1, X), controls(expected, 1, X), **ROUND)


def test_a_long_horizon():
    """Oracle: a horizon ten times shorter, which the paper's system has forgotten about; N = 1000 works."""
    model = paper_model(1000)
    estimator, _, _ = sets_of("mixed", model)
    u, v = (controls(design(model, 1, mixed(model, 1, **START), horizon=N, **WEIGHTS), 0, X[:2]) for N in (1000, 100))
    np.testing.assert_allclose(u, v, rtol=5e-3)  # one set of noise is shared by ten times as many stages


def test_mistakes_are_refused():
    """Oracle: what a user can get wrong."""
    model = paper_model(5)
    estimator, _, _ = sets_of("mixed", model)
    with pytest.raises(DesignError, match="positive definite"):
        design(model, STEPS, estimator, horizon=5, Q_x=1.0, R_u=0.0)
    with pytest.raises(DesignError, match="must be positive semidefinite"):
        design(model, STEPS, estimator, horizon=5, Q_x=[1.0, -1.0], R_u=1.0)
    with pytest.raises(DesignError, match="neither a set nor a covariance"):
        design(model, STEPS, Estimator(), horizon=5, Q_x=1.0, R_u=1.0)
    known = mixed_model(STEPS, A=np.eye(2), B=[[1.0], [0.3]], C=[[0.2, 1.0]], w_mean=0.1)
    with pytest.raises(DesignError, match="known mean"):
        design(known, STEPS, estimator, horizon=5, Q_x=1.0, R_u=1.0)
    with pytest.raises(DesignError, match="is needed"):
        design(paper_model(5), STEPS, estimator, horizon=40, Q_x=1.0, R_u=1.0)  # A is given for fewer k


def test_tables_travel_with_the_design():
    """Oracle: the design before its trip; what has been made in the parent is not made again."""
    import pickle

    model = paper_model(5)
    law = design(model, STEPS, sets_of("mixed", model)[0], horizon=5, **WEIGHTS)
    law.warm_up()
    copy = pickle.loads(pickle.dumps(law))
    assert "_tables" in vars(copy)
    np.testing.assert_array_equal(controls(copy, 3, X), controls(law, 3, X))


def test_the_certificate_is_the_semidefinite_program():
    """Oracle: (57) at N = 5 by cvxpy and Clarabel, with the mixed estimator's sets; stacked, as printed."""
    model = paper_model(5)
    estimator, M, M_w = sets_of("mixed", model)
    law = design(model, STEPS, estimator, horizon=5, **WEIGHTS)
    for x in X:
        rho, _ = oracles.semidefinite(oracles.paper_stages(20, 5), M, np.array([M_w] * 5), x)
        np.testing.assert_allclose(law.certificate(20, x[None], 1)[0], rho, **SOLVER)


def test_everything_may_vary():
    """Oracle: the dense form with the matrices and sets of the window that begins at k, all of them different."""
    rng = np.random.default_rng(3)
    stages, (_, M_w) = oracles.random_stages(rng, 2, 1, STEPS + 6), oracles.random_sets(rng, 2, STEPS + 6)
    model = mixed_model(STEPS, A=stages.A, B=stages.B, C=[[0.2, 1.0]], P_w=0.25, M_w=M_w, P_v=0.25, M_v=5.0)
    estimator = mixed(model, STEPS, **START)
    law = design(model, STEPS, estimator, horizon=6, **WEIGHTS)
    for k in (0, 7, STEPS - 1):
        part = oracles.Stages(stages.A[k : k + 6], stages.B[k : k + 6], *(
            np.broadcast_to(each, (6, *each.shape)) for each in (np.diag([10.0, 1.0]), np.eye(1))))  # fmt: skip
        _, U = oracles.dense(part, estimator.M[k], M_w[k : k + 6], X[1])
        np.testing.assert_allclose(controls(law, k, X[1:2])[0], U[0], rtol=1e-7)  # what is asked for


def test_noise_without_bounds_is_refused():
    """Oracle: by hand: 1.5^2000 is no number; a shorter horizon is."""
    model = mixed_model(3, A=[[1.5, 0.3], [0.0, 0.8]], B=[[1.0], [0.5]], C=[[1.0, 0.0]], P_v=1.0, M_w=0.25)
    estimator = mixed(model, 3, **START)
    with pytest.raises(DesignError, match="beyond 1e\\+100") as refused:
        design(model, 3, estimator, horizon=1000, Q_x=1.0, R_u=1.0)
    assert refused.value.parameter == "horizon"
    law = design(model, 3, estimator, horizon=100, Q_x=1.0, R_u=1.0)
    assert np.isfinite(controls(law, 0, X)).all()


def test_matched_moments_count_in_the_sets_too():
    """Oracle: 5.991 (P_w + M_w / 4), by hand, in the dense form."""
    model = paper_model(5)
    made = kalman(model, STEPS, **START, noise="matched")
    law = design(model, STEPS, made, horizon=5, **WEIGHTS)
    M_w = 5.991464547107979 * (0.25 * np.eye(2) + M_W / 4.0)
    _, U = oracles.dense(oracles.paper_stages(20, 5), 5.991464547107979 * made.P[20], np.array([M_w] * 5), X[1])
    np.testing.assert_allclose(controls(law, 20, X[1:2])[0], U[0], rtol=0.0, atol=1e-9)  # what is asked for
