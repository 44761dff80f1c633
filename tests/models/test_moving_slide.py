"""The model of the parallel robot against its plain twin, finite differences, and what mechanics says."""

import pickle

import numba
import numpy as np
import pytest
from conftest import ALL, ROUND, within_stat
from models import moving_slide_twin as twin

from rmpc_bench.models import moving_slide, moving_slide_kernel
from rmpc_bench.models.moving_slide import SlideNoise, arms, design
from rmpc_bench.models.state_dependent import StateDependentModel, pair_at
from rmpc_bench.noise.bounded import uniform
from rmpc_bench.numerics.s_shape import s_curve
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import DesignError

TWIN = {"rtol": 0.0, "atol": 1e-13}  # two orders of a few hundred sums; the entries are of the size of 1 to 100
SIZES = np.array([0.08, 0.08, 0.3, 0.3, 0.3, 1.0])
AT = np.array([0.05, -0.03, 0.15, 0.3, -0.2, 0.5])


@pytest.fixture
def x(rng):
    """Return states all over the workspace, the centre at rest first."""
    states = rng.uniform(-1.0, 1.0, (20, 6)) * SIZES
    states[0] = 0.0
    return states


def continuous(x, **keys):
    """K = -M^-1 N and G = M^-1 J' of the model, read from Euler's formula with a step of 1 s."""
    A, B = design(1.0, discretisation="euler", **keys).at_state(x)
    return A[:, 3:, 3:] - np.eye(3), B[:, 3:]


def test_the_kernel_is_compiled_and_the_shape_checks_do_not_wrap_it():
    """Oracle: the import hook of conftest.py covers the module beside it only."""
    assert isinstance(moving_slide_kernel.pair_kernel, numba.core.registry.CPUDispatcher)
    assert hasattr(moving_slide.design, "__wrapped__") == ALL


def test_it_is_a_state_dependent_model():
    """Oracle: the base class; a frozen design with a pose for an output."""
    model = design(0.01)
    assert isinstance(model, StateDependentModel)
    assert (model.nx, model.nu, model.ny, model.largest) == (6, 4, 3, 20.0)
    np.testing.assert_array_equal(model.C @ AT, AT[:3])
    with pytest.raises(AttributeError):
        model.Ts = 0.1
    with pytest.raises(
        DesignError, match="choose what linearises at the estimate, the estimator kalman or the controller gpc"
    ) as caught:
        model.at(0)
    assert caught.value.parameter == "kind"


@pytest.mark.parametrize("Ts", [0.01, 0.1, 2.0])
@pytest.mark.parametrize("keys", [{}, {"mass": 0.3, "a": 0.35, "d_sl": 20.0}, {"d_rot": 0.0, "d_sl": 0.0}])
def test_the_sampled_pair_is_the_exponential(x, Ts, keys):
    """Oracle: scipy.linalg.expm of the block matrix of the twin, up to |K| Ts = 50."""
    A, B = design(Ts, **keys).at_state(x)
    for i, state in enumerate(x):
        A_twin, B_twin = twin.pair(twin.robot(**keys), state, Ts)
        scale = 1.0 if Ts < 1.0 else 100.0  # entries grow with Ts^2
        np.testing.assert_allclose(A[i], A_twin, rtol=0.0, atol=scale * 1e-13)
        np.testing.assert_allclose(B[i], B_twin, rtol=0.0, atol=scale * 1e-12)  # entries up to 60 at 1 s


def test_the_frozen_matrices_are_those_of_the_twin(x):
    """Oracle: the twin; Euler's formula is I + Ts A and Ts B and nothing else."""
    A, B = design(0.02, discretisation="euler").at_state(x)
    for i, state in enumerate(x):
        A_bar, B_bar = twin.frozen(twin.robot(), state)
        np.testing.assert_allclose(A[i], np.eye(6) + 0.02 * A_bar, **TWIN)
        np.testing.assert_allclose(B[i], 0.02 * B_bar, **TWIN)


def test_velocities_of_the_arms_are_derivatives_of_their_angles_and_lengths(x):
    """Oracle: central differences of atan2 and of the length; 1e-9 of their rounding and of their third derivative."""
    p, h = twin.robot(), 1e-5
    found = arms(x[:, :3], p["a"], p["b"])
    for i, state in enumerate(x):
        theta, lengths = twin.angles(p, state[:3])
        np.testing.assert_allclose(found.lengths[i], lengths, **ROUND)
        all_J, all_S, all_dJ, *_ = zip(*twin.rows(p, state), strict=True)
        np.testing.assert_allclose(found.J[i], all_J, **TWIN)
        for j in range(3):
            ahead, behind = (twin.angles(p, state[:3] + side * h * np.eye(3)[j]) for side in (1, -1))
            np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * h), np.array(all_J)[:, j], atol=1e-8)
            np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * h), np.array(all_S)[:, j], atol=1e-8)
        drift = np.concatenate([h * state[3:], np.zeros(3)])
        ahead, behind = (twin.matrices(p, state + side * drift)[2] for side in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2 * h), all_dJ, atol=1e-8)


def test_without_damping_the_rate_of_the_inertia_less_two_n_is_skew(x):
    """Oracle: what the factorisation promises; dM/dt by central differences."""
    p, h = twin.robot(d_rot=0.0, d_sl=0.0), 1e-5
    K, _ = continuous(x, d_rot=0.0, d_sl=0.0)
    for i, state in enumerate(x):
        drift = np.concatenate([h * state[3:], np.zeros(3)])
        rate = (twin.matrices(p, state + drift)[0] - twin.matrices(p, state - drift)[0]) / (2 * h)
        skew = rate + 2.0 * twin.matrices(p, state)[0] @ K[i]
        np.testing.assert_allclose(skew, -skew.T, atol=1e-8)


def test_at_rest_without_damping_it_is_a_double_integrator(x):
    """Oracle: the limit; A = [[I, Ts I], [0, I]] and B = [Ts^2/2; Ts] M^-1 J'."""
    x[:, 3:], Ts = 0.0, 0.05
    A, B = design(Ts, d_rot=0.0, d_sl=0.0).at_state(x)
    np.testing.assert_allclose(A, np.broadcast_to(np.kron([[1.0, Ts], [0.0, 1.0]], np.eye(3)), A.shape), atol=1e-16)
    _, G = continuous(x)
    np.testing.assert_allclose(B, np.concatenate([0.5 * Ts**2 * G, Ts * G], axis=1), **ROUND)


def test_one_step_of_the_frozen_model_against_the_robot(rng):
    """Oracle: the twin in steps of 1 ms; what is left is of third order in the place with ZOH, of second with Euler."""
    errors = {}
    for kind in ("zoh", "euler"):
        A, B = design(0.01, discretisation=kind).at_state(AT[None])
        worst = np.zeros(2)
        for u in rng.standard_normal((10, 4)):
            off = np.abs(A[0] @ AT + B[0] @ u - twin.step(twin.robot(), AT, u, 0.01, 10))
            worst = np.maximum(worst, [off[:2].max(), off[3:5].max()])
        errors[kind] = worst
    assert errors["zoh"][0] < 1e-6 and errors["zoh"][1] < 2e-4
    assert 1e-5 < errors["euler"][0] < 4e-4  # Ts^2/2 times an acceleration of 1 m/s^2 is 5e-5 m


def test_the_fourth_torque_moves_nothing(x):
    """Oracle: the null space of J', which the model must not feel."""
    _, B = design(0.01).at_state(x)
    for i, state in enumerate(x):
        null = np.linalg.svd(twin.matrices(twin.robot(), state)[2].T)[2][3]
        np.testing.assert_allclose(B[i] @ null, np.zeros(6), atol=1e-15)  # of entries of 0.05


def test_the_robot_in_the_middle():
    """Oracle: by hand; l^2 = 2 (a - b)^2, and the arms are the diagonals: e = (1, 1)/sqrt(2) and its mirrors."""
    p, y = twin.robot(), np.zeros((1, 3))
    l2, found = 2 * 0.22**2, arms(y, 0.30, 0.08)
    np.testing.assert_allclose(found.lengths, np.full((1, 4), np.sqrt(l2)), **ROUND)
    sigma = np.linalg.svd(found.J[0], compute_uv=False)
    np.testing.assert_allclose(sigma, [np.sqrt(2 / l2), np.sqrt(2 / l2), 2 * 0.08 / 0.22], **ROUND)
    np.testing.assert_allclose(sigma, [4.545, 4.545, 0.727], atol=5e-4)
    M = np.diag([2.6 + 1.2 + 0.06 / l2] * 2 + [0.04 + 2.4 * 0.0064 + 0.03 * sigma[2] ** 2])
    np.testing.assert_allclose(twin.matrices(p, np.zeros(6))[0], M, atol=1e-15)
    _, G = continuous(np.zeros((1, 6)))
    np.testing.assert_allclose(M @ G[0], found.J[0].T, atol=1e-15)
    np.testing.assert_allclose(np.diag(M), [4.42, 4.42, 0.0712], atol=5e-3)


def test_where_the_robot_can_be(rng):
    """Oracle: another program; arms of 0.201 to 0.423 m and sigma_3 of 0.694 to 0.726 on the S, 0.502 in the box."""
    on_path = arms(s_curve(np.linspace(0.0, 8.0, 801)), 0.30, 0.08)
    np.testing.assert_allclose([on_path.lengths.min(), on_path.lengths.max()], [0.201, 0.423], atol=1e-3)
    sigma = np.linalg.svd(on_path.J, compute_uv=False)[:, 2]
    np.testing.assert_allclose([sigma.min(), sigma.max()], [0.694, 0.726], atol=1e-3)
    box = rng.uniform(-1.0, 1.0, (4000, 3)) * [0.15, 0.15, np.pi / 6]
    box[:8] = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * [0.15, 0.15, np.pi / 6]
    assert np.linalg.svd(arms(box, 0.30, 0.08).J, compute_uv=False)[:, 2].min() >= 0.502


def test_a_factor_on_the_masses_is_masses_multiplied(x):
    """Oracle: the same robot with its four numbers written out, bit for bit; dampings are what they were."""
    heavy = {name: 2.0 * moving_slide.NUMBERS[name] for name in ("m_p", "I_p", "m_s", "I_arm")}
    for left, right in zip(design(0.01, mass=2.0).at_state(x), design(0.01, **heavy).at_state(x), strict=True):
        np.testing.assert_array_equal(left, right)


def test_a_row_is_a_batch_of_one(x):
    """Oracle: bit for bit; views, arrays that cannot be written and pickles are the same to the model."""
    model = design(0.01)
    together = pair_at(model, 3, x)
    locked = np.asfortranarray(x)
    locked.flags.writeable = False
    for same in (pickle.loads(pickle.dumps(model)).at_state(locked), model.at_state(np.tile(x, 2)[:, :6])):
        for left, right in zip(together, same, strict=True):
            np.testing.assert_array_equal(left, right)
    for i in range(len(x)):
        for left, right in zip(together, model.at_state(x[i : i + 1]), strict=True):
            np.testing.assert_array_equal(left[i : i + 1], right)


def test_a_state_without_meaning_has_no_matrices(x):
    """Oracle: NaN where an arm has no length, or in the state; the other rows do not notice."""
    model, expected = design(0.01), design(0.01).at_state(x)
    x[3], x[5, 4], x[7, 3] = [0.22, 0.22, 0.0, 0.1, 0.1, 0.1], np.nan, 1e200
    A, B = model.at_state(x)
    others = np.delete(np.arange(len(x)), [3, 5, 7])
    np.testing.assert_array_equal(A[others], expected.A[others])
    np.testing.assert_array_equal(B[others], expected.B[others])
    assert all(np.isnan(A[i]).any() for i in (3, 5, 7))


def test_the_assumed_noise():
    """Oracle: a held acceleration moves the place by Ts^2/2 and the velocity by Ts; U(-r, r) has the variance r^2/3."""
    model = design(0.1, noise=SlideNoise(process=[1.0, 2.0, 3.0], measurement=[0.3, 0.6, 0.9]))
    for j, size in enumerate((1.0, 2.0, 3.0)):
        picked = model.Q_w[np.ix_([j, 3 + j], [j, 3 + j])]
        np.testing.assert_allclose(picked, size**2 * np.array([[2.5e-5, 5e-4], [5e-4, 1e-2]]), **ROUND)
    assert np.count_nonzero(model.Q_w) == 12
    np.testing.assert_allclose(model.R_v, np.diag([0.03, 0.12, 0.27]), **ROUND)
    mean, cov = model.w_law
    np.testing.assert_array_equal(mean, np.zeros(6))
    np.testing.assert_array_equal(cov, model.Q_w)
    np.testing.assert_array_equal(model.v_law[1], model.R_v)
    np.testing.assert_allclose(np.sqrt(3 * np.diag(design(0.01).R_v)), np.full(3, 5e-4), **ROUND)


def test_the_covariance_in_bursts_is_that_of_the_noise(rng):
    """Oracle: the empirical variance of the law `uniform` with the same bursts, which overlap, sample by sample."""
    bursts = [Burst(0.05, 0.1, 2.0), Burst(0.08, 0.12, 3.0)]
    model = design(0.01, noise=SlideNoise(measurement=0.3, bursts=bursts))
    draws = np.array([uniform(3, 0.01, radius=0.3, bursts=bursts).draw(rng, 21) for _ in range(4000)])
    for k in range(21):
        assert within_stat(draws[:, k, 1] ** 2, model.R_v_at(k)[1, 1])
    factors = [model.R_v_at(k)[0, 0] / model.R_v[0, 0] for k in (4, 5, 7, 8, 10, 11, 12, 13)]
    np.testing.assert_allclose(factors, [1, 4, 4, 36, 36, 9, 9, 1], **ROUND)
    steady = design(0.01)
    assert all(steady.R_v_at(k) is steady.R_v for k in range(5))
    assert model.R_v_varies and not steady.R_v_varies


@pytest.mark.parametrize(
    ("noise", "parameter", "message"),
    [
        (SlideNoise(process=[1.0, 2.0]), "noise.process", "a number or 3 numbers are required"),
        (SlideNoise(process=-1.0), "noise.process", "must be >= 0"),
        (SlideNoise(measurement=[1.0, -1.0, 1.0]), "noise.measurement", "must be >= 0"),
        (SlideNoise(measurement=np.inf), "noise.measurement", "must be >= 0"),
        (SlideNoise(bursts=[Burst(0.1, 0.2, 2.0), Burst(0.5, 0.4, 2.0)]), "noise.bursts.1.to", "must not be before"),
        (SlideNoise(bursts=[Burst(0.101, 0.109, 2.0)]), "noise.bursts.0", "contains no sample"),
    ],
)
def test_noise_that_is_none(noise, parameter, message):
    """Another size than the pose, or a negative one."""
    with pytest.raises(DesignError, match=message) as caught:
        design(0.01, noise=noise)
    assert caught.value.parameter == parameter
