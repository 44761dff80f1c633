"""The uncertain linear plant against (24), (25) in plain loops; its noises against section 3.1 of souto2011."""

import numpy as np
import pytest
from conftest import ROUND, random_psd, within_stat
from plants.uncertain_twin import NAMES, SIZES, at, entry_maps, random_contraction, random_given, true_matrices, walk

from rmpc_bench.plants.uncertain_linear import Sequences, Uncertainty, design
from rmpc_bench.types import DesignError, Plant, Status

RUNS, STEPS = 4, 6
LAWS = [
    Uncertainty(), Uncertainty("uniform", 0.0, 1.0, "run"), Uncertainty("extremes"), Uncertainty("extremes", per="run"),
    Uncertainty("fixed", value={"x": 1.0, "w": -0.5}),
]  # fmt: skip
SYSTEMS = pytest.mark.parametrize("sizes", SIZES, ids=lambda sizes: f"nx={sizes['nx']}")
VARIES = pytest.mark.parametrize("n_steps", [0, STEPS], ids=["constant", "varying"])


def generators(runs):
    """One generator per run, the same for a run in whatever block."""
    return [np.random.default_rng((5, run)) for run in runs]


def befalls(rng, plant, runs=RUNS):
    """Start, inputs and noises of some runs, samples k = 0..N."""
    shapes = ((runs, plant.nx), (runs, STEPS + 1, plant.nu), (runs, STEPS + 1, plant.nw), (runs, STEPS + 1, plant.nv))
    return [rng.standard_normal(shape) for shape in shapes]


def travel(plant, delta, x, u, w, v):
    """States k = 0..N+1 and outputs k = 0..N by the plant's own step and output."""
    w, v = plant.mix(delta, w, v)
    xs, ys = [x], []
    for k in range(u.shape[1]):
        ys.append(plant.output(k, delta, xs[-1], v[:, k]))
        motion = plant.step(k, delta, xs[-1], u[:, k], w[:, k])
        np.testing.assert_array_equal(motion.status, np.full(len(x), Status.OK, dtype=np.int8))
        xs.append(motion.x)
    return np.stack(xs, axis=1), np.stack(ys, axis=1)


def agree_with_loops(plant, given, delta, x, u, w, v):
    """Compare with (24), (25) run by run; states grow to some hundreds, so 1e-11 is rounding."""
    ours = travel(plant, delta, x, u, w, v)
    for i in range(len(x)):
        F = {c: getattr(delta, f"F_{c}")[i] for c in NAMES}
        for mine, theirs in zip(ours, walk(given, F, x[i], u[i], w[i], v[i]), strict=True):
            np.testing.assert_allclose(mine[i], theirs, rtol=1e-11, atol=1e-11)


@SYSTEMS
@VARIES
@pytest.mark.parametrize("law", LAWS, ids=str)
def test_it_moves_and_measures_as_the_chapter_says(sizes, n_steps, law, rng):
    """Oracle: (24) and (25) with (34)-(36) in plain Python loops, run by run, at every k."""
    given = random_given(rng, sizes, n_steps)
    plant = design(0.1, STEPS, **given, uncertainty=law)
    delta = plant.draw({}, generators(range(RUNS)), STEPS)
    assert isinstance(plant, Plant) and plant.mixes_noise and plant.has_period
    agree_with_loops(plant, given, delta, *befalls(rng, plant))


@SYSTEMS
@VARIES
def test_F_may_be_any_matrix(sizes, n_steps, rng):
    """Oracle: the same loops, with full contractions that differ in run and k."""
    given = random_given(rng, sizes, n_steps)
    plant = design(0.1, STEPS, **given)
    F = [np.array([[random_contraction(rng, *sizes[c]) for _ in range(STEPS + 1)] for _ in range(RUNS)]) for c in NAMES]
    agree_with_loops(plant, given, Sequences(*F), *befalls(rng, plant))


@pytest.mark.parametrize(
    "left", [("A", "C"), ("A", "C", "Bw", "Dv"), ("A", "C", "H_A", "G_x"), ("A", "C", "H_Dv", "G_v", "Bv")]
)
def test_what_is_not_given_is_zero(left, rng):
    """Oracle: the same loops with zeros for the matrices left out."""
    full = random_given(rng, SIZES[2])
    given = {name: full[name] for name in left}
    plant = design(0.1, STEPS, **given)
    zeros = {name: np.zeros_like(M) for name, M in plant.system.over_time._asdict().items()}
    delta = plant.draw({}, generators(range(RUNS)), STEPS)
    agree_with_loops(plant, {**zeros, **given}, delta, *befalls(rng, plant))


def test_functions_of_k(rng):
    """Oracle: the same system as arrays over k."""
    functions = {
        "A": [[0.5, lambda at: 0.1 * at["k"]], [0.0, 0.3]], "C": [[1.0, lambda at: (-1.0) ** at["k"]]],
        "Bw": lambda at: at["k"] - 1.0, "Dv": 1.0, "H_A": [[lambda at: at["k"] / 5.0], [1.0]], "G_x": [[1.0, 0.5]],
    }  # fmt: skip
    plant = design(0.1, STEPS, **functions)
    given = {name: np.array(M) for name, M in plant.system.over_time._asdict().items()}
    k = np.arange(STEPS + 1.0)
    np.testing.assert_array_equal(given["A"][:, 0, 1], 0.1 * k)
    np.testing.assert_array_equal(given["C"][:, 0, 1], (-1.0) ** k)
    np.testing.assert_array_equal(given["Bw"][:, 1, 1], k - 1.0)
    delta = plant.draw({}, generators(range(RUNS)), STEPS)
    agree_with_loops(plant, given, delta, *befalls(rng, plant))


def test_separate_uncertainties_share_an_F(rng):
    """Oracle: (26), (29) with an own F for A and for C: H_A = [h 0], H_C = [0 h'], G_x = [g; g']."""
    h, h_out, g, g_out = (rng.standard_normal(shape) for shape in ((2, 1), (1, 1), (1, 2), (1, 2)))
    A, C = 0.3 * rng.standard_normal((2, 2)), rng.standard_normal((1, 2))
    H_A, H_C = np.hstack([h, np.zeros((2, 1))]), np.hstack([np.zeros((1, 1)), h_out])
    plant = design(0.1, STEPS, A=A, C=C, H_A=H_A, H_C=H_C, G_x=np.vstack([g, g_out]))
    delta = plant.draw({}, generators(range(RUNS)), STEPS)
    x, u, w, v = befalls(rng, plant)
    xs, ys = travel(plant, delta, x, u, w, v)
    for i in range(RUNS):
        for k in range(STEPS + 1):
            F_A, F_C = delta.F_x[i, k, 0, 0], delta.F_x[i, k, 1, 1]
            np.testing.assert_allclose(xs[i, k + 1], (A + h * F_A @ g) @ xs[i, k], **ROUND, atol=1e-13)
            np.testing.assert_allclose(ys[i, k], (C + h_out * F_C @ g_out) @ xs[i, k], **ROUND, atol=1e-13)


def true_noises(plant, F, sizes, samples=1):
    """[Bw Bv; Dw Dv] with their uncertainty, read off the plant: unit noises in, columns out."""
    n = sizes["nw"] + sizes["nv"]
    units = np.broadcast_to(np.eye(n)[:, None], (n, samples, n))
    delta = Sequences(*(np.broadcast_to(F[c], (n, samples, *F[c].shape)) for c in NAMES))
    w, v = plant.mix(delta, units[..., : sizes["nw"]], units[..., sizes["nw"] :])
    return np.concatenate([w, v], axis=2)[:, -1].T


@SYSTEMS
@VARIES
def test_noises_enter_through_their_uncertain_matrices(sizes, n_steps, rng):
    """Oracle: (18), (19) with (35), (36): Bw + H_Bw F_w G_w and so on, at k = N."""
    given = random_given(rng, sizes, n_steps)
    F = {c: random_contraction(rng, *sizes[c]) for c in NAMES}
    ours = true_noises(design(0.1, STEPS, **given), F, sizes, STEPS + 1)
    theirs = true_matrices(at(given, n_steps), F)[:, sizes["nx"] :]
    np.testing.assert_allclose(ours, theirs, atol=1e-13)


def noise_moments(plant, F, sizes, mean, joint):
    """Mean and covariance of [w~; v~] at k = 0, through the plant."""
    T = true_noises(plant, F, sizes)
    return T @ mean, T @ joint @ T.T


@SYSTEMS
@pytest.mark.parametrize("simplified", ["", "first", "second"])
def test_the_noises_have_the_moments_of_the_chapter(sizes, simplified, rng):
    """Oracle: (10), (11), (13); with Bv = 0, Dw = 0 (15); with S = 0 (17); block by block; and by Monte Carlo."""
    given = random_given(rng, sizes)
    if simplified == "first":  # (14)
        given = {name: M * (name not in ("Bv", "Dw", "H_Bv", "H_Dw")) for name, M in given.items()}
    nw, nx, joint = sizes["nw"], sizes["nx"], random_psd(rng, sizes["nw"] + sizes["nv"])
    if simplified == "second":  # (16)
        joint[:nw, nw:] = joint[nw:, :nw] = 0.0
    F = {c: random_contraction(rng, *sizes[c]) for c in NAMES}
    mean, plant, m = rng.standard_normal(len(joint)), design(0.1, STEPS, **given), at(given, 0)
    found_mean, found = noise_moments(plant, F, sizes, mean, joint)

    W, V, S = joint[:nw, :nw], joint[nw:, nw:], joint[:nw, nw:]
    Bw, Dw = (m[M] + m[f"H_{M}"] @ F["w"] @ m["G_w"] for M in ("Bw", "Dw"))
    Bv, Dv = (m[M] + m[f"H_{M}"] @ F["v"] @ m["G_v"] for M in ("Bv", "Dv"))
    if simplified == "first":  # (15)
        W_, V_, S_ = Bw @ W @ Bw.T, Dv @ V @ Dv.T, Bw @ S @ Dv.T
    else:  # (17), and what S adds
        more = simplified != "second"
        W_ = Bw @ W @ Bw.T + Bv @ V @ Bv.T + more * (Bw @ S @ Bv.T + Bv @ S.T @ Bw.T)
        V_ = Dw @ W @ Dw.T + Dv @ V @ Dv.T + more * (Dw @ S @ Dv.T + Dv @ S.T @ Dw.T)
        S_ = Bw @ W @ Dw.T + Bv @ V @ Dv.T + more * (Bw @ S @ Dv.T + Bv @ S.T @ Dw.T)
    np.testing.assert_allclose(found_mean[:nx], Bw @ mean[:nw] + Bv @ mean[nw:], atol=1e-12)
    np.testing.assert_allclose(found_mean[nx:], Dw @ mean[:nw] + Dv @ mean[nw:], atol=1e-12)
    np.testing.assert_allclose(found, np.block([[W_, S_], [S_.T, V_]]), atol=1e-12)

    n = rng.multivariate_normal(mean, joint, (100, 200))
    delta = Sequences(*(np.broadcast_to(F[c], (100, 200, *F[c].shape)) for c in NAMES))
    mixed = np.concatenate(plant.mix(delta, n[..., :nw], n[..., nw:]), axis=2).reshape(20000, -1)
    assert within_stat(mixed, found_mean)
    deviation = mixed - found_mean
    assert within_stat(deviation[:, :, None] * deviation[:, None, :], found)


@SYSTEMS
@VARIES
def test_a_period_says_what_the_plant_does(sizes, n_steps, rng):
    """Oracle: M + sum of H F G with any diagonal F is [A Bw Bv; C Dw Dv] with its uncertainty; B; mean and variance."""
    given = random_given(rng, sizes, n_steps)
    plant = design(0.1, STEPS, **given, uncertainty=Uncertainty("extremes", -0.5, 1.0))
    for k in (0, STEPS):
        period = plant.period(k)
        base, maps = entry_maps(at(given, k), {c: sizes[c] for c in NAMES})
        np.testing.assert_allclose(period.M, base, atol=1e-14)
        np.testing.assert_array_equal(period.B, at(given, k)["B"])
        for c, channel in zip(NAMES, period.channels, strict=True):
            F = random_contraction(rng, *sizes[c])
            theirs = true_matrices(at(given, k), {d: F if d == c else np.zeros(sizes[d]) for d in NAMES}) - base
            np.testing.assert_allclose(channel.H @ F @ channel.G, theirs, atol=1e-13)
            np.testing.assert_allclose(channel.mean, 0.25 * np.eye(*sizes[c]))
            assert channel.variance == 0.5625 and len(maps[c]) == min(sizes[c])


def test_a_law_per_run_has_no_period(rng):
    """Oracle: F(k) of a run are all the same, hence not independent."""
    plant = design(0.1, STEPS, **random_given(rng, SIZES[1]), uncertainty=Uncertainty(per="run"))
    assert plant.period(0) is None


def test_fixed_values_have_a_period_without_variance(rng):
    """Oracle: the value on the diagonal of each channel."""
    law = Uncertainty("fixed", value={"x": -1.0, "v": 0.5})
    period = design(0.1, STEPS, **random_given(rng, SIZES[3]), uncertainty=law).period(2)
    for channel, value, c in zip(period.channels, (-1.0, 1.0, 0.5), NAMES, strict=True):
        np.testing.assert_array_equal(channel.mean, value * np.eye(*SIZES[3][c]))
        assert channel.variance == 0.0


def test_an_adversarys_sequence_is_the_same_for_all_runs(rng):
    """Oracle: the sequence given, in draw, in period and in the states."""
    sizes = SIZES[3]
    given = random_given(rng, sizes)
    greedy = design(0.1, STEPS, **given, uncertainty=Uncertainty("greedy", against="m", radius=0.5))
    assert greedy.opponent == ("m", 0.5)
    assert design(0.1, STEPS, **given).opponent is None
    worst = tuple(np.array([random_contraction(rng, *sizes[c]) for _ in range(STEPS + 1)]) for c in NAMES)
    plant = greedy.against(worst)
    delta = plant.draw({}, generators(range(RUNS)), STEPS)
    for F, one in zip(delta, worst, strict=True):
        np.testing.assert_array_equal(F, np.broadcast_to(one, F.shape))
        assert F.shape[0] == RUNS
    for k in range(STEPS + 1):
        for channel, one in zip(plant.period(k).channels, worst, strict=True):
            np.testing.assert_array_equal(channel.mean, one[k])
            assert channel.variance == 0.0
    agree_with_loops(plant, given, delta, *befalls(rng, plant))


@pytest.mark.parametrize("law", LAWS[:4], ids=str)
@VARIES
def test_a_run_is_the_same_in_every_block(law, n_steps, rng):
    """Oracle: the block of all runs, bit for bit, noises mixed with the block or alone."""
    plant = design(0.1, STEPS, **random_given(rng, SIZES[3], n_steps), uncertainty=law)
    befallen = befalls(rng, plant, 7)
    together = travel(plant, plant.draw({}, generators(range(7)), STEPS), *befallen)
    for block in ([0], [5], [2, 3, 4], [6, 1]):
        delta = plant.draw({}, generators(block), STEPS)
        for ours, theirs in zip(travel(plant, delta, *(part[block] for part in befallen)), together, strict=True):
            np.testing.assert_array_equal(ours, theirs[block])


def test_one_missing_noise_stays_in_its_run_and_sample(rng):
    """Oracle: the same noises with a number there."""
    plant = design(0.1, STEPS, **random_given(rng, SIZES[2]))
    delta = plant.draw({}, generators(range(RUNS)), STEPS)
    _, _, w, v = befalls(rng, plant)
    expected = plant.mix(delta, w, v)
    v[2, 3, 0] = np.nan
    for ours, theirs in zip(plant.mix(delta, w, v), expected, strict=True):
        assert np.isnan(ours[2, 3]).any()
        ours[2, 3] = theirs[2, 3]
        np.testing.assert_array_equal(ours, theirs)


def test_the_plant_has_no_names_and_no_units(rng):
    """Oracle: nothing for `perturb`; sizes of the twin."""
    plant = design(0.25, STEPS, **random_given(rng, SIZES[3]))
    assert (plant.Ts, plant.y_unit, plant.u_unit, dict(plant.nominal)) == (0.25, "", "", {})
    assert plant.shapes == tuple(SIZES[3][c] for c in NAMES)
    assert (plant.nx, plant.nu, plant.ny, plant.nw, plant.nv) == (4, 1, 3, 3, 2)


def test_sizes_that_do_not_fit_are_refused():
    """Oracle: the matrix to blame."""
    with pytest.raises(DesignError, match="fits the other matrices") as caught:
        design(0.1, STEPS, A=[[1.0, 0.0], [0.0, 1.0]], C=[[1.0, 2.0, 3.0]])
    assert caught.value.parameter == "C"


@pytest.mark.parametrize(
    ("law", "largest"),
    [
        (Uncertainty(), None),
        (Uncertainty(low=-5.0), "5"),
        (Uncertainty("fixed", value={"x": -2.0}), "2"),
        (Uncertainty("greedy", against="A", radius=1.5), "1.5"),
        (Uncertainty("extremes", low=0.0, high=0.5), None),
    ],
)
def test_a_law_beyond_the_unit_ball_is_remarked(law, largest):
    """Oracle: the largest norm of F by hand; bounds are designed for 1."""
    plant = design(1.0, 1, A=[[0.5]], C=[[1.0]], uncertainty=law)
    assert [f"norm of {largest};" in text for text in plant.remarks] == ([] if largest is None else [True])


def test_what_a_run_draws_once_has_names():
    """Oracle: the diagonals of the F that act, and nothing where every step draws afresh."""
    given = {"A": 0.5, "C": 1.0, "H_A": [[1.0, 0.0]], "G_x": [[1.0], [2.0]], "H_Dv": 1.0, "G_v": 0.0}
    rngs = [np.random.default_rng(run) for run in range(3)]
    frozen = design(1.0, 4, **given, uncertainty=Uncertainty(per="run"))
    delta = frozen.draw({}, rngs, 4)
    drawn = frozen.drawn(delta)
    assert sorted(drawn) == ["F_x.0", "F_x.1"]
    for i in range(2):
        np.testing.assert_array_equal(delta.F_x[:, 3, i, i], drawn[f"F_x.{i}"])
    white = design(1.0, 4, **given)
    assert white.drawn(white.draw({}, rngs, 4)) == {}
