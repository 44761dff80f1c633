"""The innovation gate against SciPy's chi-square law, the Kalman filter, and prediction alone."""

import numpy as np
import pytest
from conftest import STAT, random_model, random_psd
from scipy.stats import chi2

from rmpc_bench.estimators import kalman
from rmpc_bench.estimators.gated_kalman import design
from rmpc_bench.types import DesignError


@pytest.fixture
def case(rng):
    """A model with three states and two outputs, and its start."""
    return random_model(rng, 3, 2, 2), {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3)}


@pytest.mark.parametrize("keys", [{}, {"probability": 0.9}, {"gate": 3.0}], ids=str)
def test_the_gate(case, keys, rng):
    """Oracle: SciPy's quantile, and e' S^-1 e by an inverse; used measurements are those of the Kalman filter."""
    model, start = case
    y = rng.standard_normal((300, 2)) * 10.0 ** rng.uniform(-1.0, 1.0, (300, 1))
    e, S = y - model.C @ start["x0"], model.C @ start["P0"] @ model.C.T + model.R_v
    distance = np.einsum("ri,ij,rj->r", e, np.linalg.inv(S), e)
    used = distance <= keys.get("gate", chi2.ppf(keys.get("probability", 0.99), 2))
    ours, theirs = design(model, 1, **start, **keys), kalman.design(model, 1, **start)
    estimate = ours.correct(0, ours.init(300), y)[1]
    expected = theirs.correct(0, theirs.init(300), y)[1]
    assert 30 < used.sum() < 300
    np.testing.assert_array_equal(estimate.info["weight"], np.tile(used[:, None], 2))
    np.testing.assert_allclose(estimate.x_hat[used], expected.x_hat[used], rtol=1e-11, atol=1e-12)  # two methods
    np.testing.assert_array_equal(estimate.x_hat[~used], np.tile(start["x0"], ((~used).sum(), 1)))
    np.testing.assert_allclose(estimate.P[~used], np.tile(start["P0"], ((~used).sum(), 1, 1)), rtol=1e-12)


def test_share_of_gaussian_innovations_within_the_gate(case, rng):
    """Statistics: the probability holds, also for one output of two."""
    model, start = case
    S, n = model.C @ start["P0"] @ model.C.T + model.R_v, 20000
    y = model.C @ start["x0"] + rng.standard_normal((n, 2)) @ np.linalg.cholesky(S).T
    y[: n // 2, 1] = np.nan
    filter_ = design(model, 1, **start, probability=0.9)
    used = filter_.correct(0, filter_.init(n), y)[1].info["weight"][:, 0]
    for part in (used[: n // 2], used[n // 2 :]):
        assert abs(part.mean() - 0.9) < STAT * np.sqrt(0.9 * 0.1 / len(part))


def test_a_wide_gate_is_the_kalman_filter(case, rng):
    model, start = case
    y, u = rng.standard_normal((4, 21, 2)), rng.standard_normal((4, 21, 2))
    found = []
    for filter_ in (design(model, 20, **start, gate=1e9), kalman.design(model, 20, **start)):
        state, x_hat = filter_.init(4), []
        for k in range(21):
            state, estimate = filter_.correct(k, state, y[:, k])
            x_hat.append(estimate.x_hat)
            state = filter_.predict(k, state, u[:, k])
        found.append(np.array(x_hat))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-11, atol=1e-12)  # rounding over 20 steps


def test_only_one_key(case):
    model, start = case
    with pytest.raises(DesignError, match="either gate or probability") as caught:
        design(model, 20, **start, gate=3.0, probability=0.9)
    assert caught.value.parameter == "probability"
