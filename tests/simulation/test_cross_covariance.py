"""Noises with a cross-covariance, souto2011 (9), (14), (15): laws, draws, streams and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import random_psd, within_stat
from plants.uncertain_twin import NAMES, SIZES, at, random_contraction, random_given

from rmpc_bench.noise.gaussian import Gaussian, gaussian
from rmpc_bench.plants.uncertain_linear import Sequences, design
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Scenario, with_cross_covariance
from rmpc_bench.types import DesignError, Noise


def independent(W, V, w_bar, v_bar, nx=1, ny=1):
    """A scenario with independent normal noises."""
    return Scenario(
        seed=3, uncertainty={}, parameters={}, x0=np.zeros(nx), x0_noise=(),
        process=(gaussian(len(W), mean=list(map(float, w_bar)), cov=np.array(W)),),
        measurement=(gaussian(len(V), mean=list(map(float, v_bar)), cov=np.array(V)),),
        reference=constant(ny, value=0.0),
    )  # fmt: skip


def random_parts(rng, nw, nv, rank=None):
    """Means and a joint covariance of [w; v]."""
    joint = random_psd(rng, nw + nv, rank=rank)
    return joint, rng.standard_normal(nw), rng.standard_normal(nv)


@pytest.mark.parametrize(("nw", "nv"), [(1, 1), (2, 1), (1, 3), (3, 2)])
@pytest.mark.parametrize("singular", [False, True])
def test_the_laws_are_those_asked_for(nw, nv, singular, rng):
    """Oracle: the joint mean and covariance given, also of rank one."""
    joint, w_bar, v_bar = random_parts(rng, nw, nv, 1 if singular else None)
    before = independent(joint[:nw, :nw], joint[nw:, nw:], w_bar, v_bar)
    after = with_cross_covariance(before, joint[:nw, nw:], nw, nv)
    mean, cov = after.noise_laws(nw, nv)
    np.testing.assert_allclose(mean, [*w_bar, *v_bar], atol=1e-15)
    np.testing.assert_allclose(cov, joint, atol=2e-8 if singular else 1e-13)  # the root of a rounding, where rank ends
    np.testing.assert_array_equal(before.noise_laws(nw, nv)[1][:nw, nw:], np.zeros((nw, nv)))


def test_nothing_is_correlated_unless_asked_for(rng):
    """Oracle: S = 0 leaves means and covariances as they were."""
    before = independent([[2.0]], [[3.0]], [1.0], [-1.0])
    after = with_cross_covariance(before, np.zeros((1, 1)), 1, 1)
    np.testing.assert_allclose(after.noise_laws(1, 1)[1], np.diag([2.0, 3.0]), rtol=1e-14)


def test_the_draws_have_them(rng):
    """Oracle: mean, covariance and cross-covariance of 20000 draws within STAT; white over time."""
    sizes = SIZES[3]
    nw, nv = sizes["nw"], sizes["nv"]
    plant = design(0.1, 39, **random_given(rng, sizes))
    joint, w_bar, v_bar = random_parts(rng, nw, nv)
    some = independent(joint[:nw, :nw], joint[nw:, nw:], w_bar, v_bar, plant.nx, plant.ny)
    draws = with_cross_covariance(some, joint[:nw, nw:], nw, nv).draw(plant, range(500), 39)
    n = np.concatenate([draws.w, draws.v], axis=2)
    deviation = n - np.concatenate([w_bar, v_bar])
    assert within_stat(n.reshape(-1, nw + nv), [*w_bar, *v_bar])
    assert within_stat((deviation[..., :, None] * deviation[..., None, :]).reshape(-1, nw + nv, nw + nv), joint)
    assert within_stat((deviation[:, 1:, :, None] * deviation[:, :-1, None, :]).reshape(-1, nw + nv, nw + nv), 0.0)


def test_the_noises_of_the_plant_have_the_covariances_of_the_chapter(rng):
    """Oracle: (15): Bw W Bw', Bw S Dv', Dv V Dv' with fixed uncertain Bw, Dv; 20000 draws through `mix`."""
    sizes = SIZES[2]
    nw, nv = sizes["nw"], sizes["nv"]
    given = random_given(rng, sizes)
    given = {name: M * (name not in ("Bv", "Dw", "H_Bv", "H_Dw")) for name, M in given.items()}  # (14)
    plant, m = design(0.1, 39, **given), at(given, 0)
    joint, w_bar, v_bar = random_parts(rng, nw, nv)
    some = independent(joint[:nw, :nw], joint[nw:, nw:], w_bar, v_bar, plant.nx, plant.ny)
    draws = with_cross_covariance(some, joint[:nw, nw:], nw, nv).draw(plant, range(500), 39)
    F = {c: random_contraction(rng, *sizes[c]) for c in NAMES}
    delta = Sequences(*(np.broadcast_to(F[c], (500, 40, *F[c].shape)) for c in NAMES))
    Bw, Dv = m["Bw"] + m["H_Bw"] @ F["w"] @ m["G_w"], m["Dv"] + m["H_Dv"] @ F["v"] @ m["G_v"]
    W, V, S = joint[:nw, :nw], joint[nw:, nw:], joint[:nw, nw:]
    expected = np.block([[Bw @ W @ Bw.T, Bw @ S @ Dv.T], [Dv @ S.T @ Bw.T, Dv @ V @ Dv.T]])  # (15)
    mixed = np.concatenate(plant.mix(delta, draws.w, draws.v), axis=2).reshape(20000, -1)
    deviation = mixed - np.concatenate([Bw @ w_bar, Dv @ v_bar])
    assert within_stat(deviation, 0.0)
    assert within_stat(deviation[:, :, None] * deviation[:, None, :], expected)


def test_w_keeps_its_stream_and_runs_their_draws(rng):
    """Oracle: w bit for bit as without correlation; any block, and fewer steps, bit for bit."""
    sizes = SIZES[3]
    nw, nv = sizes["nw"], sizes["nv"]
    plant = design(0.1, 30, **random_given(rng, sizes))
    joint, w_bar, v_bar = random_parts(rng, nw, nv)
    before = independent(joint[:nw, :nw], joint[nw:, nw:], w_bar, v_bar, plant.nx, plant.ny)
    after = with_cross_covariance(before, joint[:nw, nw:], nw, nv)
    whole = after.draw(plant, range(60), 30)
    np.testing.assert_array_equal(whole.w, before.draw(plant, range(60), 30).w)
    for runs in (range(1), range(7, 20), range(59, 60)):
        part = after.draw(plant, runs, 30)
        np.testing.assert_array_equal(part.v, whole.v[runs.start : runs.stop])
    np.testing.assert_array_equal(after.draw(plant, range(60), 12).v, whole.v[:, :13])


def test_perfectly_correlated_noises():
    """Oracle: v = 2 w where V = 4 W and S = 2 W."""
    plant = design(0.1, 9, A=0.5, C=1.0, Bw=1.0, Dv=1.0)
    some = with_cross_covariance(independent([[1.0]], [[4.0]], [3.0], [-1.0]), np.array([[2.0]]), 1, 1)
    draws = some.draw(plant, range(20), 9)
    np.testing.assert_allclose(
        draws.v, 2.0 * (draws.w - 3.0) - 1.0, atol=1e-6
    )  # V - S S' / W is a rounding, its root 1e-8


@pytest.mark.parametrize(
    ("S", "message"),
    [
        (np.array([[1.5]]), "joint covariance of the noises"),
        (np.array([[-1.5]]), "joint covariance of the noises"),
        (np.array([[1.0, 0.0]]), r"shape \(1, 2\) does not fit: 1 x 1 numbers"),
    ],
)
def test_an_impossible_cross_covariance_is_refused(S, message):
    """Oracle: |S| <= sqrt(W V) = 1.41."""
    with pytest.raises(DesignError, match=message):
        with_cross_covariance(independent([[1.0]], [[2.0]], [0.0], [0.0]), S, 1, 1)
    with_cross_covariance(independent([[1.0]], [[2.0]], [0.0], [0.0]), np.array([[1.41]]), 1, 1)


def test_a_noise_that_is_not_there_cannot_be_correlated():
    """Oracle: W = 0 leaves S = 0 only."""
    with pytest.raises(DesignError, match="joint covariance of the noises"):
        with_cross_covariance(independent([[0.0]], [[2.0]], [0.0], [0.0]), np.array([[1e-9]]), 1, 1)
    with pytest.raises(DesignError, match="joint covariance of the noises"):
        with_cross_covariance(independent([[2.0]], [[0.0]], [0.0], [0.0]), np.array([[1e-9]]), 1, 1)
    after = with_cross_covariance(independent(np.diag([0.0, 2.0]), [[2.0]], [0.0, 0.0], [0.0]), np.eye(2, 1, -1), 2, 1)
    np.testing.assert_allclose(after.noise_laws(2, 1)[1], [[0, 0, 0], [0, 2, 1], [0, 1, 2]], atol=1e-14)


def test_it_does_not_depend_on_the_units():
    """Oracle: the correlation 1/2 of two noises, one of them in very small or very large numbers."""
    for scale in (1e-12, 1e-9, 1e9):
        W, V = np.diag([1.0, scale**2]), np.array([[1.0]])
        S = np.array([[0.5], [0.5 * scale]])
        after = with_cross_covariance(independent(W, V, [0.0, 0.0], [0.0]), S, 2, 1)
        np.testing.assert_allclose(after.noise_laws(2, 1)[1][:2, 2:], S, rtol=1e-9)


class Other(Noise):
    """A law that is not gaussian."""

    mean, cov = np.zeros(1), np.eye(1)

    def draw(self, rng, n_samples):
        """Draw signs."""
        return np.sign(rng.standard_normal((n_samples, 1)))


@pytest.mark.parametrize(
    "parts", [{"process": ()}, {"measurement": (Other(),)}, {"process": (gaussian(1, std=1.0),) * 2}]
)
def test_other_laws_have_none(parts):
    """Oracle: one gaussian law for the process."""
    with pytest.raises(DesignError, match="one gaussian law for the process"):
        with_cross_covariance(replace(independent([[1.0]], [[2.0]], [0.0], [0.0]), **parts), np.eye(1), 1, 1)


def test_a_law_without_moments_has_no_joint_law():
    """Oracle: None; without any noise all is zero."""
    some = independent([[1.0]], [[2.0]], [0.5], [0.0])

    class Blank(Noise):
        def draw(self, rng, n_samples):
            return np.zeros((n_samples, 1))

    assert replace(some, process=(Blank(),)).noise_laws(1, 1) is None
    mean, cov = replace(some, process=(), measurement=()).noise_laws(2, 1)
    np.testing.assert_array_equal(mean, np.zeros(3))
    np.testing.assert_array_equal(cov, np.zeros((3, 3)))


def test_the_covariance_of_a_gaussian_law(rng):
    """Oracle: root root'; the covariance given."""
    cov = random_psd(rng, 3)
    np.testing.assert_allclose(gaussian(3, cov=cov).cov, cov, atol=1e-14)
    root = rng.standard_normal((3, 3))
    np.testing.assert_array_equal(Gaussian(np.zeros(3), root).cov, root @ root.T)
