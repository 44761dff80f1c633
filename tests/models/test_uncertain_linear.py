"""What is believed of an uncertain system: its nominal part with noises, souto2011 (8)-(17), and what is refused."""

import pickle

import numpy as np
import pytest
from conftest import ROUND, random_psd
from plants.uncertain_twin import SIZES, at, random_given

from rmpc_bench.models.noise_sets import NoiseScale
from rmpc_bench.models.uncertain_linear import design
from rmpc_bench.types import DesignError

NO_UNCERTAINTY = ("H_A", "H_C", "H_Bw", "H_Dw", "H_Bv", "H_Dv")
SYSTEMS = pytest.mark.parametrize("sizes", SIZES, ids=lambda sizes: f"nx={sizes['nx']}")


def random_noises(rng, nw, nv):
    """Means and a joint covariance, as keywords."""
    joint = random_psd(rng, nw + nv)
    return {
        "W": joint[:nw, :nw].tolist(), "V": joint[nw:, nw:].tolist(), "S": joint[:nw, nw:].tolist(),
        "wbar": rng.standard_normal(nw).tolist(), "vbar": rng.standard_normal(nv).tolist(),
    }  # fmt: skip


@SYSTEMS
@pytest.mark.parametrize("n_steps", [0, 3])
def test_the_nominal_part_has_the_noises_of_the_chapter(sizes, n_steps, rng):
    """Oracle: (10), (11) and (13) with all F = 0, the four products of every block written out."""
    given = random_given(rng, sizes, n_steps)
    noises = random_noises(rng, sizes["nw"], sizes["nv"])
    model = design(3, **given, **noises)
    W, V, S = (np.array(noises[name]) for name in "WVS")
    wbar, vbar = np.array(noises["wbar"]), np.array(noises["vbar"])
    for k in range(4):
        m, now = at(given, k), model.at(k)
        Bw, Bv, Dw, Dv = m["Bw"], m["Bv"], m["Dw"], m["Dv"]
        for ours, theirs in (
            (now.A, m["A"]), (now.B, m["B"]), (now.C, m["C"]),
            (now.f0, Bw @ wbar + Bv @ vbar), (now.d0, Dw @ wbar + Dv @ vbar),
            (now.Q_w, Bw @ W @ Bw.T + Bw @ S @ Bv.T + Bv @ S.T @ Bw.T + Bv @ V @ Bv.T),
            (now.R_v, Dw @ W @ Dw.T + Dw @ S @ Dv.T + Dv @ S.T @ Dw.T + Dv @ V @ Dv.T),
            (now.S_wv, Bw @ W @ Dw.T + Bw @ S @ Dv.T + Bv @ S.T @ Dw.T + Bv @ V @ Dv.T),
        ):  # fmt: skip
            np.testing.assert_allclose(ours, theirs, atol=1e-12)  # sums of a few numbers near 1
        np.testing.assert_array_equal(now.Q_w, now.Q_w.T)
        np.testing.assert_array_equal(now.R_v, now.R_v.T)
    assert model.S.any() and (model.nx, model.nu, model.ny) == (sizes["nx"], sizes["nu"], sizes["ny"])
    np.testing.assert_array_equal(model.Q_w, model.at(0).Q_w)


def test_the_first_simplification(rng):
    """Oracle: (14), (15): with Bv = 0 and Dw = 0 all correlation comes from S."""
    given = {**random_given(rng, SIZES[2]), "Bv": 0.0, "Dw": 0.0}
    noises = random_noises(rng, 1, 3)
    now, m = design(0, **given, **noises).at(0), at({k: v for k, v in given.items() if np.ndim(v)}, 0)
    np.testing.assert_allclose(now.Q_w, m["Bw"] @ noises["W"] @ m["Bw"].T, atol=1e-13)
    np.testing.assert_allclose(now.S_wv, m["Bw"] @ noises["S"] @ m["Dv"].T, atol=1e-13)
    np.testing.assert_allclose(now.R_v, m["Dv"] @ noises["V"] @ m["Dv"].T, atol=1e-13)


def test_the_second_simplification(rng):
    """Oracle: (16), (17): without S all correlation comes from Bv and Dw; Monte Carlo of the two noises agrees."""
    given = random_given(rng, SIZES[3])
    noises = random_noises(rng, 3, 2) | {"S": 0.0}
    model, m = design(0, **given, **noises), at(given, 0)
    assert not model.S.any()
    S = m["Bw"] @ noises["W"] @ m["Dw"].T + m["Bv"] @ noises["V"] @ m["Dv"].T
    np.testing.assert_allclose(model.at(0).S_wv, S, atol=1e-13)


def test_laws_of_the_noises():
    """Oracle: the numbers given; [w; v] one below the other."""
    model = design(
        2, A=0.5, C=1.0, Bw=[[1.0, 2.0]], Dv=1.0, W=[4.0, 1.0], V=9.0, S=[[1.0], [2.0]], wbar=[1.0, 2.0], vbar=3.0
    )
    np.testing.assert_array_equal(model.noise[0], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(model.noise[1], [[4, 0, 1], [0, 1, 2], [1, 2, 9]])
    np.testing.assert_array_equal(model.w_law[1], np.diag([4.0, 1.0]))
    np.testing.assert_array_equal(model.v_law[0], [3.0])
    simple = design(2, A=0.5, C=1.0, Bw=[[1.0, 2.0]], W=2.0, wbar=1.0)
    np.testing.assert_array_equal(simple.W, 2.0 * np.eye(2))
    np.testing.assert_array_equal(simple.wbar, [1.0, 1.0])
    np.testing.assert_array_equal(simple.S, np.zeros((2, 1)))


def test_what_does_not_vary_is_one_model(rng):
    """Oracle: identity; a model that varies has one per k, also after a trip to a worker."""
    still = design(5, **random_given(rng, SIZES[1]), W=1.0, V=1.0)
    assert still.at(0) is still.at(5)
    varying = design(5, **random_given(rng, SIZES[1], 5), W=1.0, V=1.0)
    np.testing.assert_array_equal(varying.at(1).A, varying.at(1).A)
    assert not np.array_equal(varying.at(1).A, varying.at(2).A)
    again = pickle.loads(pickle.dumps(varying))
    np.testing.assert_array_equal(again.at(3).Q_w, varying.at(3).Q_w)


@pytest.mark.parametrize(
    ("change", "parameter", "message"),
    [
        ({"W": [1.0, 2.0]}, "W", r"shape \(2,\) does not fit"),
        ({"W": -1.0}, "W", "positive semidefinite"),
        ({"V": [[1.0, 2.0], [0.0, 1.0]]}, "V", "symmetric"),
        ({"wbar": [1.0, 2.0]}, "wbar", "does not fit"),
        ({"vbar": [1.0, 2.0, 3.0]}, "vbar", "does not fit"),
        ({"S": 0.5}, "S", "1 x 2 numbers are required"),
        ({"S": [[0.5], [0.5]]}, "S", "1 x 2 numbers are required"),
        ({"S": [[1.0, 0.1]]}, "S", "joint covariance"),
        ({"W": 0.0, "S": [[0.0, 1e-3]]}, "S", "joint covariance"),
        ({"A": [[1.0, 2.0]]}, "A", "1 x 2; a square matrix is expected"),
    ],
)
def test_what_belongs_to_no_noises_is_refused(change, parameter, message):
    """Oracle: the parameter to blame; |S| = 1 > sqrt(W V) = 1 only with the 0.1 beside it."""
    given = {"A": [0.5, 0.5], "C": [[1, 0], [0, 1]], "Bw": [[1], [1]], "Dv": 1.0, "W": 1.0, "V": 1.0, "S": [[1.0, 0.0]]}
    design(3, **given)
    with pytest.raises(DesignError, match=message) as caught:
        design(3, **{**given, **change})
    assert caught.value.parameter == parameter


def test_a_ragged_cross_covariance_is_refused():
    """Oracle: a DesignError that blames S, not an exception of NumPy."""
    with pytest.raises(DesignError) as caught:
        design(3, A=[0.5, 0.5], C=1.0, Bw=1.0, Dv=1.0, W=1.0, V=1.0, S=[[0.1, 0.1], [0.1]])
    assert caught.value.parameter == "S"


def test_scalars_are_enough():
    """Oracle: x+ = a x + w, y = x + v with covariances 2 and 3."""
    now = design(0, A=0.5, C=1.0, Bw=1.0, Dv=1.0, W=2.0, V=3.0, S=1.0).at(0)
    np.testing.assert_allclose([now.Q_w[0, 0], now.R_v[0, 0], now.S_wv[0, 0]], [2.0, 3.0, 1.0], **ROUND)


@SYSTEMS
def test_scale_multiplies_standard_deviations(sizes, rng):
    """Oracle: the design with the covariances multiplied by hand; means and matrices stay."""
    given, noises = random_given(rng, sizes, 0), random_noises(rng, sizes["nw"], sizes["nv"])
    squares = {"W": 9.0, "V": 0.25, "S": 1.5}
    by_hand = {name: (squares.get(name, 1.0) * np.array(value)).tolist() for name, value in noises.items()}
    scaled, wanted = design(0, **given, **noises, scale=NoiseScale(3.0, 0.5)), design(0, **given, **by_hand)
    for name in ("A", "C", "Q_w", "R_v", "S_wv", "f0", "d0"):
        np.testing.assert_allclose(getattr(scaled.at(0), name), getattr(wanted.at(0), name), **ROUND)
