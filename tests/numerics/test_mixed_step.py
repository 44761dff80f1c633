"""One correction of a covariance and an ellipsoid: the search for its weight against a scan, at all sizes of sets."""

import numpy as np
import pytest
from conftest import random_psd
from scipy.optimize import minimize_scalar

from rmpc_bench.numerics import mixed_step as module
from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.mixed_step import Prior, mixed_step
from rmpc_bench.numerics.riccati import filter_step
from rmpc_bench.numerics.square_root import covariance_of


def drawn(rng, nx, ny, spread):
    """A prior whose four matrices differ in size by a factor of 10^spread, the sets flat now and then."""
    sizes = 10.0 ** rng.uniform(-spread, spread, 4)
    ranks = [nx, rng.integers(1, nx + 1), ny, rng.integers(1, ny + 1)]
    matrices = [
        size * random_psd(rng, n, rank=rank) for size, n, rank in zip(sizes, (nx, nx, ny, ny), ranks, strict=True)
    ]
    P, M, P_v, M_v = matrices
    return Prior(rng.standard_normal((ny, nx)), *map(psd_sqrt, (P, M, P_v, M_v)))


def total(prior, q):
    """tr P + tr M of the best gain for a weight."""
    step = prior.corrected(prior.gain(q))
    return np.trace(step.P) + np.trace(step.M)


@pytest.mark.parametrize("spread", [0.0, 2.0, 4.0])
@pytest.mark.parametrize(("nx", "ny"), [(1, 1), (2, 1), (4, 2)])
def test_no_other_weight_is_better(nx, ny, spread, rng, monkeypatch):
    """Oracle: a scan of log q with SciPy's minimiser around its best point; the search is short."""
    calls, of = [0], module._distance

    def counted(prior, z):
        calls[0] += 1
        return of(prior, z)

    monkeypatch.setattr(module, "_distance", counted)
    for _ in range(10):
        prior = drawn(rng, nx, ny, spread)
        step, calls[0] = mixed_step(prior), 0
        grid = np.linspace(-25.0, 25.0, 201)
        best = grid[np.argmin([total(prior, np.exp(z)) for z in grid])]
        theirs = minimize_scalar(lambda z, p=prior: total(p, np.exp(z)), bounds=(best - 0.25, best + 0.25),
                                 method="bounded", options={"xatol": 1e-9}).fun  # fmt: skip
        assert np.trace(step.P) + np.trace(step.M) <= theirs * (1.0 + 1e-6)  # edges of the reach, flat sets
        mixed_step(prior)
        assert calls[0] < module.MOST


def test_points_take_part_with_weight_one(rng):
    """Oracle: the usual step, with R_v = P_v + M_v without a predicted set, V = P + M without a measured one."""
    prior, A = drawn(rng, 3, 2, 0.0), np.eye(3)
    P, M, P_v, M_v = map(covariance_of, prior[1:])
    for changed, R, V in (
        (prior._replace(M=0 * prior.M), P_v + M_v, P),
        (prior._replace(M_v=0 * prior.M_v), P_v, P + M),
        (prior._replace(M=0 * prior.M, M_v=0 * prior.M_v), P_v, P),
    ):
        for rule in ("fixed-point", "lag", "one-pass"):
            theirs = filter_step(A, prior.C, 0 * A, R, psd_sqrt(V))
            np.testing.assert_allclose(mixed_step(changed, rule).L, theirs.L, rtol=1e-10, atol=1e-13)


def test_one_state_by_hand():
    """Oracle: P = P_v = 1, M = M_v = m: by symmetry L = 1/2, q = 1, P = 1/2 and M = m."""
    one = np.ones((1, 1))
    for m in (1e-6, 1.0, 1e6):
        step = mixed_step(Prior(one, one, m**0.5 * one, one, m**0.5 * one))
        np.testing.assert_allclose([step.L.item(), step.q, step.P.item(), step.M.item() / m], [0.5, 1.0, 0.5, 1.0])


def test_what_is_kept_is_the_prediction(rng):
    """Oracle: the prior itself; there is no gain."""
    prior = drawn(rng, 3, 2, 0.0)
    step = prior.kept()
    np.testing.assert_array_equal(step.P_root, prior.P)
    np.testing.assert_array_equal(step.M_root, prior.M)
    assert step.L.shape == (3, 2) and not step.L.any()
