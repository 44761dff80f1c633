"""Bounded noise: the paper's law, its variants, and their moments."""

import math
import pickle

import numpy as np
import pytest
from conftest import ROUND, random_psd, within_stat

from rmpc_bench import registry
from rmpc_bench.noise.bounded import corners, ellipsoid, uniform
from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.types import DesignError

PAPER = [[5.0, 2.0], [2.0, 5.0]]  # (74)
CUBE = {"law": "skewed-cube"}
KEYS = {
    "gaussian": {"std": 1.0},
    "uniform": {"radius": 1.0},
    "corners": {"radius": 1.0},
    "ellipsoid": {"shape": 1.0},
    "coloured": {"std": 1.0, "pole": 0.9},
    "drift": {"std": 1.0},
    "half-normal": {"std": 1.0},
    "missing": {"probability": 0.4, "gap": 3.0},
    "outliers": {"std": 1.0, "probability": 0.1, "factor": 10.0},
    "delayed": {"samples": [0, 3]},
    "quantised": {"step": 1.0},
    "student-t": {"dof": 3.0, "scale": 1.0},
}
LAWS = {
    "uniform": {},
    "lower": {"root": "lower"},
    "upper": {"root": "upper"},
    "keep": CUBE,
    "project": CUBE | {"outside": "project"},
    "reject": CUBE | {"outside": "reject"},
}


def drawn(law, n_samples=40_000, seed=1):
    return law.draw(np.random.default_rng(seed), n_samples)


def lengths(w, M, center=0.0):
    """Square roots of (w - center)' M^-1 (w - center)."""
    return np.sqrt(np.einsum("ki,ij,kj->k", w - center, np.linalg.inv(M), w - center))


def uniform_radii(w, M):
    """Whether a share p of the samples lies in every smaller ellipsoid of p times the volume."""
    share = np.arange(1, 10) / 10
    return within_stat(lengths(w, M)[:, None] <= share ** (1 / len(M)), share)


@pytest.mark.parametrize("n", [1, 2, 5, 12])
@pytest.mark.parametrize("name", [*registry.BUILT_IN["noises"], *LAWS])
def test_a_longer_draw_begins_with_the_shorter_one(name, n):
    """Oracle: the protocol's promise, for every registered law and every variant; lengths that end inside any chunk."""
    shape = {"shape": random_psd(np.random.default_rng(n), n)}
    law = ellipsoid(n, **shape, **LAWS[name]) if name in LAWS else registry.get("noises", name)(n, **KEYS[name])
    whole = drawn(law, 300)
    for n_samples in (1, 2, 7, 299):
        np.testing.assert_array_equal(drawn(law, n_samples), whole[:n_samples])


@pytest.mark.parametrize("n", [1, 2, 3, 8])
def test_points_of_the_ball_are_uniform(n):
    """Oracle: P(|u| <= r) = r^n at nine radii; the mean 0, the covariance I / (n + 2) and the fourth moments."""
    u = drawn(ellipsoid(n, shape=1.0))
    assert (lengths(u, np.eye(n)) <= 1.0 + 1e-15).all()  # a rounding of the quotient
    assert uniform_radii(u, np.eye(n))
    assert within_stat(u, 0.0)
    assert within_stat(u[:, :, None] * u[:, None], np.eye(n) / (n + 2))
    assert within_stat(u**4, 3.0 / ((n + 2) * (n + 4)))


@pytest.mark.parametrize("root", ["symmetric", "lower"])
@pytest.mark.parametrize("n", [2, 4])
def test_a_root_maps_the_ball_onto_the_ellipsoid(root, n, rng):
    """Oracle: the definition of the ellipsoid, about its center; nearly all radii of it are met."""
    M, center = random_psd(rng, n, 100.0), np.arange(1.0, n + 1)
    inside = lengths(drawn(ellipsoid(n, shape=M, root=root, center=center.tolist())), M, center)
    assert inside.max() <= 1.0 + 1e-12  # a rounding of the inverse
    assert inside.max() > 0.999


def test_roots_by_hand():
    """Oracle: [[5, 2], [2, 5]] has the eigenvalues 7 and 3 on the diagonals; R' R = M by hand."""
    plus, minus = (math.sqrt(7) + math.sqrt(3)) / 2, (math.sqrt(7) - math.sqrt(3)) / 2
    lower = np.array([[math.sqrt(5), 0.0], [2 / math.sqrt(5), math.sqrt(4.2)]])
    for root, factor in (("symmetric", np.array([[plus, minus], [minus, plus]])), ("lower", lower), ("upper", lower.T)):
        np.testing.assert_allclose(ellipsoid(2, shape=PAPER, root=root).factor, factor, **ROUND)


def test_the_upper_factor_leaves_the_ellipsoid():
    """Oracle: R u lies in E(0, R R'), another ellipsoid than E(0, R' R), beyond which it reaches by |R'^-1 R|."""
    w = drawn(ellipsoid(2, shape=PAPER, root="upper"))
    R = np.linalg.cholesky(np.array(PAPER)).T
    assert lengths(w, R @ R.T).max() <= 1.0 + 1e-12  # a rounding of the inverse
    beyond = np.linalg.norm(np.linalg.solve(R.T, R), 2)
    assert beyond > 1.05
    np.testing.assert_allclose(lengths(w, np.array(PAPER)).max(), beyond, rtol=1e-3)  # the largest of 40,000


def test_a_flat_ellipsoid():
    """Oracle: M = a a' is the segment from -a to a; its uniform points have the marginal of the ball."""
    a = np.array([3.0, 4.0])
    w = drawn(ellipsoid(2, shape=np.outer(a, a)))
    along = w @ a / 25.0
    np.testing.assert_allclose(w, along[:, None] * a, atol=1e-6)  # root of a rounding of the zero eigenvalue
    assert within_stat(along**2, 0.25)
    np.testing.assert_array_equal(drawn(ellipsoid(2, shape=0.0, center=3.0), 4), np.full((4, 2), 3.0))


@pytest.mark.parametrize("skew", [0.9, 0.5, 0.0, 1.0])
def test_points_of_the_skewed_cube(skew):
    """Oracle: Section V of ma2025: moduli uniform on (0, 1), a share `skew` of positive signs, all independent."""
    u = drawn(ellipsoid(3, shape=1.0, **CUBE, skew=skew))
    sign, modulus, at = np.sign(u), np.abs(u), np.arange(1, 10) / 10
    assert np.all((u > 0.0).mean(axis=0) == skew) or (within_stat(u > 0.0, skew) and 0.0 < skew < 1.0)
    assert within_stat(modulus[:, :, None] <= at, at)
    assert within_stat(modulus[:, :2] * modulus[:, 1:], 0.25)
    if 0.0 < skew < 1.0:
        assert within_stat((sign[:, :2] - 2 * skew + 1) * (sign[:, 1:] - 2 * skew + 1), 0.0)
        assert within_stat((sign - 2 * skew + 1) * (modulus - 0.5), 0.0)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_what_becomes_of_points_outside_the_ball(n):
    """Oracle: `keep` inside, bit for bit; outside the same direction with length 1, or the same signs and inside."""
    keep, project, reject = (
        drawn(ellipsoid(n, shape=1.0, **LAWS[name]), 2000) for name in ("keep", "project", "reject")
    )
    inside = lengths(keep, np.eye(n)) <= 1.0
    assert 0 < inside.sum() < 2000
    np.testing.assert_array_equal(project[inside], keep[inside])
    np.testing.assert_array_equal(reject[inside], keep[inside])
    out = keep[~inside] / lengths(keep[~inside], np.eye(n))[:, None]
    np.testing.assert_allclose(project[~inside], out, **ROUND)
    np.testing.assert_array_equal(np.sign(reject), np.sign(keep))
    assert lengths(reject, np.eye(n)).max() <= 1.0 + 1e-15  # a rounding of the quotient


def drawn_again(n, skew, n_samples, rng):
    """Rejection as the word says: points of the cube, the outer ones thrown away."""
    u = rng.random((40 * n_samples, n)) * np.where(rng.random((40 * n_samples, n)) < skew, 1.0, -1.0)
    return u[(u**2).sum(axis=1) <= 1.0][:n_samples]


@pytest.mark.parametrize("n", [2, 5])
def test_rejected_points_are_those_drawn_again(n, rng):
    """Oracle: rejection in so many words: differences of means of moments and of shares in cells; P(|u| <= r) = r^n."""
    ours, theirs = drawn(ellipsoid(n, shape=1.0, **LAWS["reject"])), drawn_again(n, 0.9, 40_000, rng)
    assert len(theirs) == len(ours)

    def features(u):
        cells = (u[:, :2, None] <= [-0.4, 0.0, 0.2, 0.5, 0.8]).reshape(len(u), -1)
        return np.hstack([u, u**2, u[:, :1] * u[:, 1:], cells])

    assert within_stat(features(ours) - features(theirs), 0.0)
    assert uniform_radii(ours, np.eye(n))


def test_rejection_in_many_dimensions_comes_to_an_end():
    """Oracle: one point of a cube in 2.5e28 is inside the ball of 40 dimensions; P(|u| <= r) = r^40."""
    u = drawn(ellipsoid(40, shape=1.0, **LAWS["reject"]), 4000)
    assert uniform_radii(u, np.eye(40))


@pytest.mark.parametrize(
    ("n", "modulus", "product"),
    [(1, 1 / 2, None), (2, 4 / (3 * math.pi), 1 / (2 * math.pi)), (3, 3 / 8, 2 / (5 * math.pi))],
)
def test_moments_of_rejected_points_by_hand(n, modulus, product):
    """Oracle: E |u_1| and E |u_1 u_2| over an interval, a disc and a ball, integrated in polar coordinates."""
    law = ellipsoid(n, shape=1.0, **LAWS["reject"])  # signs have the mean 0.8
    np.testing.assert_allclose(law.mean, np.full(n, 0.8 * modulus), **ROUND)
    second = law.cov + np.outer(law.mean, law.mean)
    np.testing.assert_allclose(np.diag(second), np.full(n, 1 / 3 if n == 1 else 1 / (n + 2)), **ROUND)
    if n > 1:
        np.testing.assert_allclose(second[~np.eye(n, dtype=bool)], 0.64 * product, **ROUND)


def test_moments_of_the_other_laws_by_hand():
    """Oracle: U(-r, r) has r^2/3; the ellipsoid M/(n + 2); the skewed cube the mean 0.4 and the variance 1/3 - 0.16."""
    box = uniform(2, radius=[3.0, 1.0], center=[1.0, 2.0])
    np.testing.assert_array_equal(box.mean, [1.0, 2.0])
    np.testing.assert_allclose(box.cov, np.diag([3.0, 1 / 3]), **ROUND)
    M = np.array(PAPER)
    for root in ("symmetric", "lower"):
        np.testing.assert_allclose(ellipsoid(2, shape=PAPER, root=root, scale=3.0).cov, 9.0 * M / 4.0, **ROUND)
        law = ellipsoid(2, shape=PAPER, root=root, **CUBE)
        np.testing.assert_allclose(law.cov, (1 / 3 - 0.16) * M, **ROUND)
        np.testing.assert_allclose(law.mean, 0.4 * law.factor.sum(axis=1), **ROUND)


@pytest.mark.parametrize("n", [1, 2, 4])
@pytest.mark.parametrize("name", ["box", *(name for name in LAWS if name != "project")])
def test_moments_are_those_of_the_draws(name, n, rng):
    """Oracle: Monte Carlo, 40,000 samples, STAT on every entry; center, shape and scale at once."""
    M, center = random_psd(rng, n), np.arange(1.0, n + 1).tolist()
    law = (
        uniform(n, radius=center, center=center)
        if name == "box"
        else ellipsoid(n, shape=M, center=center, scale=2.0, **LAWS[name])
    )
    w = drawn(law)
    assert law.mean is not None and law.cov is not None
    assert within_stat(w, law.mean)
    centred = w - law.mean
    assert within_stat(centred[:, :, None] * centred[:, None, :], law.cov)
    assert within_stat((centred[1:, :, None] * centred[:-1, None, :])[::2], 0.0)  # white


def test_the_projected_cube_tells_no_moments():
    """Oracle: there is no closed form for every n; but in one dimension nothing is ever outside."""
    unknown = ellipsoid(2, shape=1.0, **LAWS["project"])
    assert unknown.mean is None and unknown.cov is None
    keep, project, reject = (ellipsoid(1, shape=4.0, **LAWS[name]) for name in ("keep", "project", "reject"))
    for law in (project, reject):
        np.testing.assert_array_equal(law.cov, keep.cov)
        np.testing.assert_array_equal(drawn(law, 50), drawn(keep, 50))


def test_without_skew_rejection_gives_the_uniform_law(rng):
    """Oracle: the limit of the module's docstring, by its moments and by the radii."""
    M = random_psd(rng, 3)
    half, even = ellipsoid(3, shape=M, law="skewed-cube", outside="reject", skew=0.5), ellipsoid(3, shape=M)
    np.testing.assert_allclose(half.mean, even.mean, atol=1e-15)
    np.testing.assert_allclose(half.cov, even.cov, atol=1e-15, **ROUND)
    assert uniform_radii(drawn(half), M)


def test_parameters_stretch_and_turn_the_same_draws():
    """Oracle: a factor of two on scale or radius doubles every sample; another skew changes signs and nothing else."""
    pairs = [(uniform(2, radius=[1.0, 3.0]), uniform(2, radius=[2.0, 6.0]))]
    pairs += [
        (ellipsoid(2, shape=PAPER, **keys), ellipsoid(2, shape=PAPER, scale=2.0, **keys)) for keys in LAWS.values()
    ]
    for one, two in pairs:
        np.testing.assert_array_equal(drawn(two, 99), 2.0 * drawn(one, 99))
    few, many = (drawn(ellipsoid(2, shape=1.0, **CUBE, skew=skew), 99) for skew in (0.2, 0.9))
    np.testing.assert_array_equal(np.abs(few), np.abs(many))
    assert ((few > 0.0) <= (many > 0.0)).all() and (few != many).any()


def test_points_of_the_box():
    """Oracle: the definition, share by share."""
    w, at = drawn(uniform(2, radius=[1.0, 0.5], center=[0.0, 2.0])), np.arange(1, 10) / 10
    assert within_stat(((w - [0.0, 2.0]) / [1.0, 0.5])[:, :, None] <= 2.0 * at - 1.0, at)
    assert (np.abs(w - [0.0, 2.0]) <= [1.0, 0.5]).all()
    assert within_stat(w[:, 0] * (w[:, 1] - 2.0), 0.0)


def test_a_radius_and_a_shape_mean_the_same_in_one_dimension():
    """Oracle: (75): E(0, 5) of one number is [-sqrt(5), sqrt(5)]."""
    box, set_ = uniform(1, radius=math.sqrt(5)), ellipsoid(1, shape=5.0)
    np.testing.assert_allclose(box.cov, set_.cov, **ROUND)
    np.testing.assert_allclose(np.abs(drawn(set_)).max(), math.sqrt(5), rtol=1e-3)  # the largest of 40,000


@pytest.mark.parametrize(
    ("keys", "parameter", "message"),
    [
        ({"shape": [1.0, 2.0, 3.0]}, "shape", "2 x 2 numbers are required"),
        ({"shape": [[1.0, 2.0], [2.0, 1.0]]}, "shape", "semidefinite"),
        ({"shape": [[1.0, 2.0], [1.0, 1.0]]}, "shape", "symmetric"),
        ({"shape": 1.0, "center": [1.0, 2.0, 3.0]}, "center", "2 numbers are required"),
        ({"shape": [[1.0, 1.0], [1.0, 1.0]], "root": "lower"}, "root", "singular"),
        ({"shape": [1.0, 1e-13], "root": "upper"}, "root", "singular"),
        ({"shape": 0.0, "root": "lower"}, "root", "singular"),
        ({"shape": 1.0, "outside": "project"}, "outside", "law: skewed-cube"),
        ({"shape": 1.0, "skew": 0.8}, "skew", "law: skewed-cube"),
    ],
)
def test_bad_ellipsoids_are_design_errors(keys, parameter, message):
    """Oracle: the docstring; the parameter to blame is named."""
    with pytest.raises(DesignError, match=message) as caught:
        ellipsoid(2, **keys)
    assert caught.value.parameter == parameter


@pytest.mark.parametrize(
    "keys",
    [
        {"radius": [1.0, 2.0, 3.0]},
        {"center": [1.0, 2.0, 3.0], "radius": 1.0},
        {"mix": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], "radius": 1.0},
    ],
)
def test_bad_boxes_are_design_errors(keys):
    """Oracle: the docstring; the parameter to blame is named."""
    with pytest.raises(DesignError, match="2 numbers are required|2 x 2 numbers are required") as caught:
        uniform(2, **keys)
    assert caught.value.parameter == next(iter(keys))


@pytest.mark.parametrize("law", [gaussian(2, std=1.0), *(ellipsoid(2, shape=PAPER, **keys) for keys in LAWS.values())])
def test_laws_survive_a_process(law):
    """Oracle: the same draws, bit for bit."""
    np.testing.assert_array_equal(drawn(pickle.loads(pickle.dumps(law)), 9), drawn(law, 9))


def test_corners_of_a_box():
    """Oracle: each of the four corners has a share of 1/4; moments of a fair coin; a size that does not fit."""
    law = corners(2, radius=[2.0, 3.0], center=[1.0, -1.0])
    w = drawn(law)
    assert {tuple(each) for each in w.tolist()} == {(-1.0, -4.0), (-1.0, 2.0), (3.0, -4.0), (3.0, 2.0)}
    for corner in np.unique(w, axis=0):
        assert within_stat((w == corner).all(axis=1), 0.25)
    np.testing.assert_array_equal(law.mean, [1.0, -1.0])
    np.testing.assert_array_equal(law.cov, np.diag([4.0, 9.0]))
    with pytest.raises(DesignError, match="3") as caught:
        corners(2, radius=[1.0, 1.0, 1.0])
    assert caught.value.parameter == "radius"
