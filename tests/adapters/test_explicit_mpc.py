"""Explicit laws: regions by enumeration of the active limits, against a bounded least-squares solver and `mpc`."""

import pickle
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from components.one_run import MODEL, designed, experiment, simulated
from conftest import EXACT
from controllers.predictions import predict_moves
from scipy.optimize import lsq_linear

from rmpc_bench import SolverError
from rmpc_bench.adapters.explicit_mpc import explicit_controller, stacked
from rmpc_bench.config_file import factories
from rmpc_bench.types import Status

HP, R = 3, 0.5
CALLS = []


def least_squares():
    """Return M and N of the problem min |M U - N theta|, theta = [x; u(k-1); r] with a constant reference."""
    Psi, Upsilon, Theta = predict_moves(MODEL, HP, HP)
    moves, first = np.eye(HP) - np.eye(HP, k=-1), np.eye(HP)[:, :1]
    error = np.hstack([-Psi, Theta @ first - Upsilon, np.ones((HP, 1))])
    weight = np.sqrt(R) * np.hstack([np.zeros((HP, 2)), first, np.zeros((HP, 1))])
    return np.vstack([Theta @ moves, np.sqrt(R) * moves]), np.vstack([error, weight])


def enumerated(limit, reach):
    """Return one region for every set of active limits: U = A theta + b where E theta <= f, and |theta_i| <= reach."""
    M, N = least_squares()
    Q, H = M.T @ M, -M.T @ N
    box = np.vstack([np.eye(4), -np.eye(4)])
    regions = []
    for signs in product((-1, 0, 1), repeat=HP):
        free, at = np.array(signs) == 0, np.array(signs) != 0
        A, b = np.zeros((HP, 4)), limit * np.array(signs, dtype=float)
        inverse = np.linalg.inv(Q[np.ix_(free, free)])
        A[free], b[free] = -inverse @ H[free], -inverse @ Q[np.ix_(free, at)] @ b[at]
        gradient, constant, sign = Q @ A + H, Q @ b, np.array(signs)[at, None]
        E = [A[free], -A[free], sign * gradient[at], box]
        f = [limit - b[free], limit + b[free], -sign[:, 0] * constant[at], np.full(8, reach)]
        regions.append(SimpleNamespace(A=A, b=b, E=np.vstack(E), f=np.concatenate(f)))
    return regions


@explicit_controller
def law(model, limit: float = 0.4, reach: float = 50.0):
    """Return the regions; `CALLS` counts how often.

    Parameters
    ----------
    limit, reach : largest input, and largest entry of theta
    """
    CALLS.append(limit)
    return enumerated(limit, reach)


def alone(**keys):
    """Return the controller of one run."""
    return law(model=MODEL, prepared=stacked(enumerated(**keys)))


def test_it_is_the_minimiser_of_the_bounded_problem():
    """Oracle: SciPy's active-set method. Half of the random points have an active limit."""
    controller, (M, N) = alone(limit=0.4, reach=50.0), least_squares()
    rng, at_limit = np.random.default_rng(0), 0
    for theta in rng.standard_normal((200, 4)) * [1.0, 1.0, 0.3, 1.0]:
        oracle = lsq_linear(M, N @ theta, (-0.4, 0.4), method="bvls", tol=1e-14).x
        u = controller.control(theta[:2], theta[2:3], theta[3:])
        np.testing.assert_allclose(u, oracle[:1], rtol=0, atol=1e-9)
        at_limit += abs(u[0]) == 0.4
    assert 50 <= at_limit <= 190


def test_in_the_loop_without_active_limits_it_is_mpc():
    """The regions are made once for six runs; a run alone and a copy by pickle have the same bits."""
    CALLS.clear()
    design = designed("controllers", law, limit=100.0)
    got = simulated(experiment(controller=design))
    assert CALLS == [100.0]
    expected = simulated(experiment(controller=factories.controller("mpc", MODEL, Hp=HP, Hu=HP, Q=1.0, R=R)))
    np.testing.assert_allclose(got[2]["u"], expected[2]["u"], rtol=0, atol=1e-9)
    copied = simulated(experiment(controller=pickle.loads(pickle.dumps(design))), 1)
    np.testing.assert_allclose(copied[2]["u"], got[2]["u"], **EXACT)


def test_a_point_on_a_facet_belongs_to_a_region():
    """Plain comparisons with <= lose some points on the facets to rounding; the law does not."""
    regions = enumerated(0.4, 50.0)
    controller, rng, lost = alone(limit=0.4, reach=50.0), np.random.default_rng(1), 0
    every = np.vstack([each.E for each in regions]), np.concatenate([each.f for each in regions])
    for e, bound in zip(*(each[every[0].any(axis=1)] for each in every), strict=True):
        for theta in rng.standard_normal((10, 4)) * 0.3:
            theta += (bound - e @ theta) * e / (e @ e)
            if np.abs(theta).max() < 50.0:
                lost += not any((each.E @ theta <= each.f).all() for each in regions)
                assert abs(controller.control(theta[:2], theta[2:3], theta[3:])[0]) <= 0.4 + 1e-9
    assert lost > 0


def test_outside_of_all_regions_the_run_is_infeasible_or_held():
    """The law is not defined there, and neither an input of a neighbour nor NaN is used."""
    with pytest.raises(SolverError, match="outside of all regions, by ") as caught:
        alone(limit=0.4, reach=1.0).control(np.array([5.0, 0.0]), np.zeros(1), np.zeros(1))
    assert caught.value.infeasible
    with pytest.raises(SolverError):
        alone(limit=0.4, reach=1.0).control(np.array([np.nan, 0.0]), np.zeros(1), np.zeros(1))
    design = designed("controllers", law, reach=1.2)
    assert Status.INFEASIBLE in simulated(experiment(controller=design))[0]
    held = designed("controllers", law, reach=1.2, on_failure="hold", max_held=1.0)
    assert set(simulated(experiment(controller=held))[0]) == {Status.OK}


def test_the_number_of_parameters_must_fit():
    """theta consists of the estimate, the last input and the previewed reference, or of the first of these."""
    with pytest.raises(ValueError, match="the regions have 4 parameters; x_hat, u\\(k-1\\) and 2 r have 5"):
        law(model=MODEL, prepared=stacked(enumerated(0.4, 1.0)), preview=2)
