"""A linear model with stochastic and bounded noises: what is read, what varies, what is refused, and its sets."""

import pickle

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd, within_stat
from estimators.mixed_systems import in_ellipsoid

from rmpc_bench.models.mixed_noise import design
from rmpc_bench.models.noise_sets import NoiseScale, NoiseSets, uniform_covariance, with_noise_kind
from rmpc_bench.numerics.ellipsoid import sum_shape
from rmpc_bench.types import DesignError, Model


class Wave:
    """A function of k that a worker can be sent."""

    def __call__(self, values):
        return 1.0 + 0.1 * np.sin(values["k"])


def test_short_forms():
    """Oracle: by hand; sizes come from C and B, what is not given is zero."""
    model = design(5, A=[0.5, 0.9], B=[[1.0], [2.0]], C=[[1.0, 0.0]], P_w=0.25, M_w=[5.0, 2.0], M_v=4.0, w_mean=0.5)
    now = model.at(0)
    assert (model.nx, model.nu, model.ny) == (2, 1, 1)
    for ours, theirs in (
        (now.A, np.diag([0.5, 0.9])), (now.B, [[1.0], [2.0]]), (now.C, [[1.0, 0.0]]), (now.Q_w, 0.25 * np.eye(2)),
        (now.R_v, [[0.0]]), (now.S_wv, np.zeros((2, 1))), (now.f0, [0.5, 0.5]), (now.d0, [0.0]),
        (model.M_w(0), np.diag([5.0, 2.0])), (model.M_v(0), [[4.0]]), (model.Q_w, now.Q_w), (model.w_law[0], now.f0),
        (model.w_law[1], now.Q_w), (model.v_law[0], now.d0), (model.v_law[1], now.R_v), 
    ):  # fmt: skip
        np.testing.assert_array_equal(ours, theirs)
    assert isinstance(model, Model) and model.has_sets
    np.testing.assert_array_equal(design(0, A=[0.5, 0.9], C=1.0).at(0).B, np.zeros((2, 1)))


def test_what_does_not_vary_is_one_object():
    """Oracle: identity at any k, beyond the last step too."""
    model = design(5, A=0.5, C=1.0, P_w=1.0, M_w=2.0)
    assert model.at(0) is model.at(77) and model.M_w(3) is model.M_w(99) and model.M_v(0) is model.M_v(1)
    partly = design(5, A=0.5, C=1.0, P_w=1.0, M_w=[[Wave()]])
    assert partly.at(0) is partly.at(77) and partly.M_w(3) is partly.M_w(3)
    assert partly.M_w(3) is not partly.M_w(4)


def test_entries_over_time_have_no_end():
    """Oracle: the functions; before and beyond the last step, and after a trip to a worker."""
    model = design(3, A=[[Wave(), 0.1], [0.0, 0.5]], C=[[1.0, 0.0]], P_w=Wave(), M_v=[[Wave()]])
    for each in (model, pickle.loads(pickle.dumps(model))):
        for k in (0, 2, 3, 50):
            wave = 1.0 + 0.1 * np.sin(k)
            np.testing.assert_array_equal(each.at(k).A, [[wave, 0.1], [0.0, 0.5]])
            np.testing.assert_array_equal(each.at(k).Q_w, wave * np.eye(2))
            np.testing.assert_array_equal(each.M_v(k), [[wave]])
            np.testing.assert_array_equal(each.M_w(k), np.zeros((2, 2)))


def test_an_array_over_time_ends():
    """Oracle: its entries; the message says how many there are and who asked."""
    A = np.arange(6.0).reshape(6, 1, 1)
    model = design(5, A=A, C=1.0)
    np.testing.assert_array_equal(model.at(5).A, [[5.0]])
    with pytest.raises(DesignError, match="has 6 entries over k, but k = 6 is needed") as caught:
        model.at(6)
    assert caught.value.parameter == "A"
    with pytest.raises(DesignError, match="k = 6"):
        design(6, A=A, C=1.0)
    assert design(6, A=A[:1], C=1.0).at(9) is not None


@pytest.mark.parametrize(
    ("change", "parameter", "message"),
    [
        ({"A": None}, "A", "missing"),
        ({"C": None}, "C", "missing"),
        ({"A": [[1.0, 2.0]]}, "A", "1 x 2; a square matrix is expected"),
        ({"B": [[1.0]]}, "B", "1 x 1; 2 x nu fits"),
        ({"P_w": [1.0, 2.0, 3.0]}, "P_w", "2 x 2 fits the other matrices"),
        ({"P_w": -1.0}, "P_w", "positive semidefinite"),
        ({"M_w": [[1.0, 2.0], [2.0, 1.0]]}, "M_w", "positive semidefinite"),
        ({"M_v": -5.0}, "M_v", "positive semidefinite"),
        ({"M_w": [[1.0, 2.0], [0.0, 1.0]]}, "M_w", "symmetric"),
        ({"M_w": lambda at: 2.0 - at["k"]}, "M_w", r"positive semidefinite .*\(k = 3\)"),
        ({"A": [[1.0, 2.0], [1.0]]}, "A", "list of rows of the same length"),
        ({"w_mean": [1.0, 2.0, 3.0]}, "w_mean", "does not fit"),
        ({"v_mean": [1.0, 2.0]}, "v_mean", "does not fit"),
    ],
)
def test_what_is_no_model_is_refused(change, parameter, message):
    """Oracle: the parameter to blame, before any run."""
    given = {"A": [0.5, 0.5], "B": [[1.0], [1.0]], "C": [[1.0, 0.0]], "P_w": 1.0, "M_w": 1.0, "M_v": 1.0}
    design(4, **given)
    with pytest.raises(DesignError, match=message) as caught:
        design(4, **{**given, **change})
    assert caught.value.parameter == parameter


def test_sets_of_an_estimator(rng):
    """Oracle: sums by hand, 5.9915 for two components and 3.8415 for one at 95 %."""
    M, P = random_psd(rng, 2), random_psd(rng, 2)
    model = design(3, A=[0.5, 0.5], C=[[1.0, 0.0]], P_w=P.tolist(), M_w=M.tolist(), P_v=0.25, M_v=5.0)
    c2, c1 = -2.0 * np.log(0.05), 3.841458820694124
    alone, inflated = NoiseSets(model), NoiseSets(model, 0.95)
    sets = pickle.loads(pickle.dumps(NoiseSets(model, 0.95, bounded=False)))
    for k in (0, 9):
        np.testing.assert_array_equal(alone.process(k), M)
        np.testing.assert_array_equal(alone.measurement(k), [[5.0]])
        np.testing.assert_allclose(inflated.process(k), sum_shape(M, c2 * P), **ROUND)
        wide = (np.sqrt(5.0) + np.sqrt(c1 * 0.25)) ** 2
        np.testing.assert_allclose(inflated.measurement(k), [[wide]], rtol=1e-9)  # digits of c1
        np.testing.assert_allclose(sets.process(k), c2 * P, **ROUND)
        np.testing.assert_allclose(sets.measurement(k), [[c1 * 0.25]], rtol=1e-9)
    np.testing.assert_array_equal(alone.of_parts(P, M), M)
    np.testing.assert_allclose(inflated.of_parts(P, M), sum_shape(M, c2 * P), **ROUND)
    np.testing.assert_allclose(sets.of_parts(P, M), c2 * P, **ROUND)


def test_a_model_without_sets_has_none(rng):
    """Oracle: zeros of the right size; with a level the ellipsoid of the covariance alone."""
    model = random_model(rng, 3, 1, 2)
    assert not model.has_sets
    np.testing.assert_array_equal(NoiseSets(model).process(4), np.zeros((3, 3)))
    np.testing.assert_array_equal(NoiseSets(model).measurement(4), np.zeros((2, 2)))
    np.testing.assert_array_equal(NoiseSets(model, 0.9).process(0), NoiseSets(model, 0.9, bounded=False).process(0))
    assert with_noise_kind(model, np.eye(3), np.zeros((3, 3)), "matched")[0].at(2) is model


@pytest.mark.parametrize("n", [1, 2, 4])
def test_the_covariance_of_a_uniform_law(n, rng):
    """Oracle: Monte Carlo, 20,000 points of the ellipsoid."""
    M = random_psd(rng, n)
    points = in_ellipsoid(rng, M, 20_000)
    assert within_stat(points[:, :, None] * points[:, None, :], uniform_covariance(M))


def test_a_matched_model_keeps_the_rest():
    """Oracle: by hand; M / 4 of two states, M / 3 of one output, M0 / 4."""
    model = design(3, A=[0.5, 0.5], C=[[1.0, 0.0]], P_w=1.0, M_w=[4.0, 8.0], P_v=2.0, M_v=6.0, w_mean=1.0, v_mean=2.0)
    matched, P0 = with_noise_kind(model, np.eye(2), 4.0 * np.eye(2), "matched")
    now = matched.at(1)
    for ours, theirs in (
        (now.Q_w, np.diag([2.0, 3.0])), (now.R_v, [[4.0]]), (P0, 2.0 * np.eye(2)), (now.f0, [1.0, 1.0]),
        (now.d0, [2.0]), (now.A, model.at(1).A),
    ):  # fmt: skip
        np.testing.assert_array_equal(ours, theirs)


def test_scale_multiplies_standard_deviations():
    """Oracle: by hand; the sets and the matrices of the system stay."""
    given = {"A": 0.5, "C": 1.0, "P_w": 0.25, "P_v": 4.0, "M_w": 5.0, "M_v": 2.0}
    scaled, model = design(2, **given, scale=NoiseScale(process=3.0, measurement=0.1)), design(2, **given)
    np.testing.assert_array_equal(scaled.at(1).Q_w, [[2.25]])
    np.testing.assert_allclose(scaled.at(1).R_v, [[0.04]], **ROUND)
    for name in ("A", "C", "f0", "d0"):
        np.testing.assert_array_equal(getattr(scaled.at(1), name), getattr(model.at(1), name))
    assert scaled.M_w(1) == model.M_w(1) and scaled.M_v(1) == model.M_v(1)
    assert scaled.at(0) is scaled.at(2)
