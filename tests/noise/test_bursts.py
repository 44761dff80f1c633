"""Bursts of noise: where they lie, what they do to the noise, and what they leave as it is."""

import math
import pickle
from fractions import Fraction
from inspect import signature

import numpy as np
import pytest
from conftest import ROUND, within_stat

from rmpc_bench import registry
from rmpc_bench.noise.bounded import uniform
from rmpc_bench.noise.bursts import RandomBursts, child_of
from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import DesignError

PAPER = [Burst(3.4, 4.0, 2.0), Burst(6.2, 6.6, 2.0)]  # belda2017, Section VI
RADIUS = 5e-4
RANDOM = RandomBursts(within=[(1.0, 3.8), (4.6, 7.0)], duration=(0.3, 0.8), factor=(1.5, 3.0))
Ts, N = 0.01, 801


def fresh(seed=1):
    """Generator of a run."""
    return np.random.default_rng(seed)


def bursty(bursts, step=Ts, **keys):
    """Noise of the paper under other bursts."""
    return uniform(3, step, **({"radius": RADIUS} | keys), bursts=bursts)


def width(law, seed, n_samples=N):
    """How many times as wide the noise of a run is as without bursts, sample by sample."""
    ratio = law.draw(fresh(seed), n_samples) / uniform(3, radius=RADIUS).draw(fresh(seed), n_samples)
    np.testing.assert_allclose(ratio, ratio[:, :1] * np.ones(3), **ROUND)
    return ratio[:, 0]


# -- the same in every run ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "start", "end"),
    [("0.01", "3.4", "4"), ("0.01", "6.2", "6.6"), ("0.1", "0.3", "0.7"), ("0.1", "0.25", "0.75"),
     ("0.3", "0.9", "1.2"), ("0.07", "0", "0.21"), ("1", "2", "2"), ("0.1", "3.4000000000001", "3.5"),
     ("0.001", "1.157", "1.161")],
)  # fmt: skip
def test_a_burst_holds_its_ends(step, start, end):
    """Oracle: from <= k Ts <= to in exact fractions of the numbers as written, but for a billionth of a sample."""
    law = bursty([Burst(float(start), float(end), 2.0)], float(step))
    a, b, h, tiny = Fraction(start), Fraction(end), Fraction(step), Fraction(1, 10**9)
    inside = [a / h - tiny <= k <= b / h + tiny for k in range(1300)]
    assert any(inside)
    np.testing.assert_array_equal(law.in_burst(fresh(), 1300), inside)


def test_a_burst_widens_and_nothing_else_moves():
    """Oracle: twice every bit of the law without bursts at the samples in bursts, the same bits at all others."""
    steady, law = uniform(3, radius=RADIUS), bursty(PAPER)
    inside = law.in_burst(fresh(), N)
    assert inside.sum() == 61 + 41
    quiet, loud = steady.draw(fresh(), N), law.draw(fresh(), N)
    np.testing.assert_array_equal(loud[~inside], quiet[~inside])
    np.testing.assert_array_equal(loud[inside], 2.0 * quiet[inside])
    assert RADIUS < np.abs(loud).max() <= 2.0 * RADIUS


def test_a_burst_widens_about_the_center():
    """Oracle: center + factor times the deviation; factor 0 leaves the center."""
    keys = {"radius": [1.0, 2.0, 3.0], "center": [10.0, 0.0, -5.0]}
    quiet = uniform(3, **keys).draw(fresh(), 5)
    for factor in (0.0, 1.7):
        loud = bursty([Burst(0.01, 0.03, factor)], **keys).draw(fresh(), 5)
        expected = np.array(keys["center"]) + factor * (quiet - keys["center"])
        np.testing.assert_allclose(loud[1:4], expected[1:4], **ROUND)


def test_factors_multiply_where_bursts_overlap():
    """Oracle: by hand."""
    law = bursty([Burst(0.01, 0.03, 2.0), Burst(0.03, 0.05, 4.0), Burst(0.0, 9.0, 0.5)])
    np.testing.assert_allclose(width(law, 1, 7), [0.5, 1.0, 1.0, 4.0, 2.0, 2.0, 0.5], **ROUND)


def test_the_limit_of_the_docstring():
    """Oracle: the law without bursts, bit for bit; where none is named it is that law, with its moments."""
    keys = {"radius": [1.0, 2.0, 3.0], "center": 0.1}
    steady = uniform(3, **keys)
    assert (bursty([Burst(0.0, 9.0, 1.0)], **keys).draw(fresh(), 50) == steady.draw(fresh(), 50)).all()
    for none in ([], None):
        law = bursty(none, **keys)
        assert law.mean is not None and law.cov is not None and not law.has_bursts
        np.testing.assert_array_equal(law.draw(fresh(), 50), steady.draw(fresh(), 50))


@pytest.mark.parametrize("bursts", [PAPER, RANDOM])
def test_moments_are_not_told(bursts):
    """Oracle: they depend on k; a law without bursts says nothing of bursts."""
    law = bursty(bursts)
    assert law.has_bursts and law.mean is None and law.cov is None
    assert not gaussian(1, std=1.0).has_bursts


@pytest.mark.parametrize("bursts", [PAPER, RANDOM, [Burst(1e300, 1e301, 2.0)]])
def test_a_longer_draw_begins_with_the_shorter_one(bursts):
    """Oracle: the protocol's promise; a burst beyond the end is no mistake, or a short run would be one."""
    law = bursty(bursts)
    whole, inside = law.draw(fresh(), N), law.in_burst(fresh(), N)
    for n_samples in (1, 2, 350, 800):
        np.testing.assert_array_equal(law.draw(fresh(), n_samples), whole[:n_samples])
        np.testing.assert_array_equal(law.in_burst(fresh(), n_samples), inside[:n_samples])


def test_samples_in_bursts_are_uniform():
    """Oracle: shares of the doubled box; the variance r^2/3 beside bursts and 4 r^2/3 in them."""
    law = bursty([Burst(100.0, 300.0, 2.0)])
    v, inside = law.draw(fresh(), 40_000), law.in_burst(fresh(), 40_000)
    at = np.arange(1, 10) / 10
    for part, r in ((v[inside], 2.0 * RADIUS), (v[~inside], RADIUS)):
        assert within_stat((part / r)[:, :, None] <= 2.0 * at - 1.0, at)
        assert within_stat((part / r) ** 2, 1.0 / 3.0)


def test_mixed_coordinates_burst_together():
    """Oracle: mix diag(radius) u by hand, doubled."""
    mix = [[1.0, 0.0, 0.0], [0.8, 0.2, 0.0], [0.0, 0.0, 1.0]]
    law = bursty([Burst(0.0, 0.04, 2.0)], radius=[1.0, 2.0, 3.0], mix=mix)
    u = uniform(3, radius=1.0).draw(fresh(), 10)
    expected = (u * [1.0, 2.0, 3.0]) @ np.array(mix).T
    expected[:5] *= 2.0
    np.testing.assert_allclose(law.draw(fresh(), 10), expected, **ROUND)


# -- drawn for every run -----------------------------------------------------------------------------------------------


def test_random_bursts_from_their_stream():
    """Oracle: the first child of the run's generator: the factor, then duration and start of every burst."""
    for seed in range(20):
        p = fresh(seed).spawn(1)[0].random(5)
        factor = 1.5 + 1.5 * p[0]
        expected = np.ones(N)
        values = {"burst_factor": factor}
        for number, (a, b) in enumerate(((100, 380), (460, 700))):
            length = round(30.0 + 50.0 * p[1 + 2 * number])
            start = round(a + (b - length - a) * p[2 + 2 * number])
            expected[start : start + length + 1] *= factor
            values |= {f"burst_{number + 1}_from": start / 100, f"burst_{number + 1}_to": (start + length) / 100}
        law = bursty(RANDOM)
        np.testing.assert_allclose(width(law, seed), expected, **ROUND)
        np.testing.assert_array_equal(law.in_burst(fresh(seed), N), expected != 1.0)
        assert law.burst_values(fresh(seed)) == pytest.approx(values, rel=1e-12)  # ROUND
        assert set(law.burst_names) == set(values)


def drawn(law, n_runs=4000):
    """Values of many runs, name by name."""
    rows = [law.burst_values(fresh(seed)) for seed in range(n_runs)]
    return {name: np.array([row[name] for row in rows]) for name in law.burst_names}


def test_laws_of_random_bursts():
    """Oracle: uniform factor and duration, start uniform in what the duration leaves, share by share; on samples."""
    values, at = drawn(bursty(RANDOM, 0.001)), np.arange(1, 10) / 10
    shares = [(values["burst_factor"] - 1.5) / 1.5]
    for number, (a, b) in ((1, (1.0, 3.8)), (2, (4.6, 7.0))):
        start, end = values[f"burst_{number}_from"], values[f"burst_{number}_to"]
        assert (start >= a).all() and (end <= b).all()
        np.testing.assert_array_equal(start, np.round(start, 3))
        shares += [(end - start - 0.3) / 0.5, (start - a) / (b - a - (end - start))]
    shares = np.stack(shares)
    assert within_stat(shares.T[:, :, None] <= at, at)
    pairs = np.triu_indices(len(shares), 1)
    assert within_stat(((shares[pairs[0]] - 0.5) * (shares[pairs[1]] - 0.5)).T, 0.0)


def test_random_bursts_begin_and_end_on_samples():
    """Oracle: multiples of a coarse Ts inside the window, its ends included; all of them are met."""
    law = bursty(RandomBursts([(0.25, 1.05)], (0.1, 0.3), 2.0), 0.1)  # samples 3 to 10
    values = drawn(law, 2000)
    first, last = (np.rint(values[f"burst_1_{end}"] / 0.1).astype(int) for end in ("from", "to"))
    np.testing.assert_allclose(values["burst_1_from"], 0.1 * first, **ROUND)
    assert set(last - first) == {1, 2, 3}
    assert (first.min(), last.max()) == (3, 10)


def test_numbers_instead_of_ranges():
    """Oracle: the range from a number to itself; a burst as long as its window has one place."""
    one = bursty(RandomBursts([(1.0, 3.8)], 0.5, 2.0))
    two = bursty(RandomBursts([(1.0, 3.8)], (0.5, 0.5), (2.0, 2.0)))
    for seed in range(5):
        assert one.burst_values(fresh(seed)) == two.burst_values(fresh(seed))
        np.testing.assert_array_equal(one.draw(fresh(seed), N), two.draw(fresh(seed), N))
    tight = bursty(RandomBursts([(1.0, 3.8)], 2.8, 3.0))
    assert tight.burst_values(fresh()) == {"burst_1_from": 1.0, "burst_1_to": 3.8, "burst_factor": 3.0}


def test_what_does_not_move_random_bursts():
    """Oracle: another window, another factor, another radius: the bursts that were there have the same bits."""
    before = drawn(bursty(RANDOM), 20)
    more = RandomBursts([*RANDOM.within, (0.0, 0.9)], RANDOM.duration, RANDOM.factor)
    wider = RandomBursts(RANDOM.within, RANDOM.duration, (3.0, 6.0))
    for law, scale in ((bursty(more), 1.0), (bursty(wider), 2.0), (bursty(RANDOM, radius=7.0), 1.0)):
        after = drawn(law, 20)
        for name, values in before.items():
            np.testing.assert_array_equal(after[name], values * (scale if name == "burst_factor" else 1.0))


def test_names_of_many_windows():
    """Oracle: two ends for each, from 1 on, and one factor; fixed bursts draw nothing."""
    law = bursty(RandomBursts([(0.0, 0.5)] * 3, 0.1, 2.0))
    ends = [f"burst_{number}_{end}" for number in (1, 2, 3) for end in ("from", "to")]
    assert law.burst_names == (*ends, "burst_factor")
    assert bursty(PAPER).burst_names == () and bursty(PAPER).burst_values(fresh()) == {}


@pytest.mark.parametrize("bursts", [PAPER, RANDOM])
def test_laws_survive_a_process(bursts):
    """Oracle: the same draws, bit for bit."""
    law = bursty(bursts)
    again = pickle.loads(pickle.dumps(law))
    np.testing.assert_array_equal(again.draw(fresh(), N), law.draw(fresh(), N))
    np.testing.assert_array_equal(again.in_burst(fresh(), N), law.in_burst(fresh(), N))


@pytest.mark.parametrize(
    ("bursts", "parameter", "message"),
    [
        ([PAPER[0], Burst(4.0, 3.4, 2.0)], "bursts.1.to", r"must not be before from, 4 \(got 3.4\)"),
        ([Burst(0.011, 0.019, 2.0)], "bursts.0", "contains no sample; the sampling time is 0.01 s"),
        (RandomBursts([], 0.1, 2.0), "bursts.within", "contains no window"),
        (RandomBursts([(0.0, 1.0), (1.0, 1.5)], (0.3, 0.8), 2.0), "bursts.within.1", "no room for a burst of 0.8;"),
        (RandomBursts([(2.0, 1.0)], 0.0, 2.0), "bursts.within.0", "no room"),
        (RandomBursts([(0.0, 1.0)], (0.8, 0.3), 2.0), "bursts.duration", r"smaller end \(got \[0.8, 0.3\]\)"),
        (RandomBursts([(0.0, 1.0)], 0.1, (3.0, 1.5)), "bursts.factor", "smaller end"),
    ],
)
def test_bursts_that_have_no_place(bursts, parameter, message):
    """Oracle: the docstring; the place to blame is named."""
    with pytest.raises(DesignError, match=message) as caught:
        bursty(bursts)
    assert caught.value.parameter == parameter


def test_a_burst_of_a_single_sample():
    """Oracle: a duration of 0 holds its two ends, which are one sample."""
    law = bursty(RandomBursts([(1.0, 2.0)], 0.0, 2.0))
    for seed in range(5):
        assert law.in_burst(fresh(seed), N).sum() == 1
        values = law.burst_values(fresh(seed))
        assert values["burst_1_from"] == values["burst_1_to"]
        assert math.isclose(width(law, seed).max(), 2.0, rel_tol=1e-12)  # ROUND


# -- of every law ------------------------------------------------------------------------------------------------------

LAWS = {
    "coloured": {"std": 1.0, "pole": 0.9, "mean": 2.0},
    "corners": {"radius": 1.0, "center": 2.0},
    "ellipsoid": {"shape": 2.0, "law": "skewed-cube", "outside": "reject", "center": 2.0},
    "gaussian": {"std": 1.0, "mean": 2.0},
    "half-normal": {"std": 1.0, "center": 2.0},
    "outliers": {"std": 1.0, "probability": 0.2, "factor": 10.0, "mean": 2.0},
    "student-t": {"dof": 3.0, "scale": 1.0, "mean": 2.0},
    "uniform": {"radius": 1.0, "center": 2.0},
}
"""Laws whose deviation from 2 is multiplied in bursts."""
WITHOUT = {"delayed", "drift", "missing", "quantised"}
"""Laws whose bursts enlarge increments, and those that add nothing."""


def test_every_law_has_bursts():
    """Oracle: the registry; a new law gets a line above."""
    assert {*LAWS} | WITHOUT == set(registry.names("noises"))
    taken = {kind: {*signature(registry.get("noises", kind)).parameters} for kind in registry.names("noises")}
    assert {kind for kind, names in taken.items() if "bursts" in names} == {*LAWS, "drift"}


@pytest.mark.parametrize("bursts", [PAPER, RANDOM])
@pytest.mark.parametrize("kind", LAWS)
def test_bursts_multiply_the_deviation_of_every_law(kind, bursts):
    """Oracle: the law without bursts from the same generator: the same bits outside, the factor inside."""
    design, step = registry.get("noises", kind), 0.05
    law, steady = design(2, step, **LAWS[kind], bursts=bursts), design(2, step, **LAWS[kind])
    for seed in range(3):
        loud, quiet, inside = law.draw(fresh(seed), 160), steady.draw(fresh(seed), 160), law.in_burst(fresh(seed), 160)
        factor = law.burst_values(fresh(seed)).get("burst_factor", 2.0)
        assert inside.any() and not inside.all()
        np.testing.assert_array_equal(loud[~inside], quiet[~inside])
        np.testing.assert_allclose(loud[inside] - 2.0, factor * (quiet[inside] - 2.0), atol=1e-12, **ROUND)
    assert law.has_bursts and law.mean is None and law.cov is None


def test_times_of_bursts_do_not_depend_on_what_a_law_draws_from_children():
    """Oracle: children of the generator by NumPy; the outliers take the first one, and the bursts the second."""
    for number in range(3):
        children = fresh().spawn(3)
        np.testing.assert_array_equal(child_of(fresh(), number).random(5), children[number].random(5))
    law = registry.get("noises", "outliers")(1, Ts, std=1.0, probability=0.5, factor=2.0, bursts=RANDOM)
    flags, times = fresh().spawn(2)
    p = times.random(5)
    assert law.burst_values(fresh())["burst_factor"] == 1.5 + 1.5 * p[0]
    outliers = flags.random(801) < 0.5
    z = fresh().standard_normal((801, 1))[:, 0]
    outside = ~law.in_burst(fresh(), 801)
    np.testing.assert_array_equal(law.draw(fresh(), 801)[outside, 0], (np.where(outliers, 2.0, 1.0) * z)[outside])
