"""Laws of the uncertain matrices: what is drawn, run by run, and what is said of it."""

import numpy as np
import pytest
from conftest import STAT, within_stat
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rmpc_bench.plants.uncertain_linear import NAMES, Uncertainty

SHAPES = ((1, 1), (2, 3), (3, 2))
RANDOM = [{"law": law, "per": per} for law in ("uniform", "extremes") for per in ("step", "run")]
LAWS = [*RANDOM, {"law": "fixed"}, {"law": "fixed", "value": {"x": -1.0, "v": 0.5}}]


def generators(runs):
    """One generator per run, the same for a run in whatever block."""
    return [np.random.default_rng((7, run)) for run in runs]


def drawn(law, runs=range(6), n=9, shapes=SHAPES):
    """F of some runs."""
    return Uncertainty(**law).draw(generators(runs), n, shapes)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_every_F_is_a_contraction_of_the_shape_asked_for(law):
    """Oracle: singular values by NumPy; zeros off the diagonal."""
    for F, shape in zip(drawn(law), SHAPES, strict=True):
        assert F.shape == (6, 9, *shape)
        assert np.linalg.norm(F, 2, axis=(2, 3)).max() <= 1.0
        off = np.ones(shape, dtype=bool) & ~np.eye(*shape, dtype=bool)
        assert not F[:, :, off].any()


@example(low=-0.99, width=1.89, seed=0)  # -0.99 + (0.9 - -0.99) > 0.9
@given(low=st.floats(-1, 1), width=st.floats(0, 2), seed=st.integers(0, 1000))
@settings(max_examples=200)
def test_bounds_within_one_stay_within_one_despite_rounding(low, width, seed):
    """Oracle: low <= delta <= high; one rounding of the size of 1 is allowed to `uniform` but never beyond 1."""
    high = min(1.0, round(low + width, 2))
    low = min(low, high)
    for law in ("uniform", "extremes"):
        F = Uncertainty(law, low, high).draw([np.random.default_rng(seed)], 50, ((1, 1),) * 3)
        values = np.concatenate([part.ravel() for part in F])
        assert np.abs(values).max() <= 1.0
        assert values.min() >= low - 3e-16 and values.max() <= high + 3e-16
        if law == "extremes":
            assert set(values) <= {low, high}


@pytest.mark.parametrize("law", RANDOM, ids=str)
def test_a_run_does_not_depend_on_its_block(law):
    """Oracle: each run drawn alone, bit for bit."""
    together = drawn(law)
    for i in range(6):
        for ours, theirs in zip(drawn(law, [i]), together, strict=True):
            np.testing.assert_array_equal(ours[0], theirs[i])


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_longer_draw_begins_with_the_shorter_one(law):
    """Oracle: the shorter one, bit for bit."""
    for short, long in zip(drawn(law, n=4), drawn(law, n=30), strict=True):
        np.testing.assert_array_equal(long[:, :4], short)


@pytest.mark.parametrize("law", RANDOM, ids=str)
def test_a_law_per_run_stands_still_and_one_per_step_does_not(law):
    """Oracle: the first sample of every run; runs and channels differ."""
    F = drawn({**law, "low": -0.9, "high": 0.7}, range(40))
    for part in F:
        assert (part == part[:, :1]).all() == (law["per"] == "run")
        assert len(np.unique(part[:, 0, 0, 0])) == (40 if law["law"] == "uniform" else 2)
    assert not np.array_equal(F.F_x[:, 0, 0, 0], F.F_w[:, 0, 0, 0])


@pytest.mark.parametrize("bounds", [(-1.0, 1.0), (0.0, 1.0), (-0.25, 0.5)])
@pytest.mark.parametrize("law", ["uniform", "extremes"])
def test_the_moments_are_those_of_the_law(law, bounds):
    """Oracle: closed forms (a + b) / 2 and (b - a)^2 / 12 or / 4; samples within STAT; entries independent."""
    low, high = bounds
    uncertainty = Uncertainty(law, low, high)
    mean, variance = uncertainty.entry("w")
    np.testing.assert_allclose(mean, 0.5 * (low + high), atol=1e-15)
    np.testing.assert_allclose(variance, (high - low) ** 2 / (12 if law == "uniform" else 4), rtol=1e-14)
    F_x, F_w, F_v = uncertainty.draw(generators(range(20)), 500, SHAPES)
    deltas = [F[:, :, i, i].ravel() for F in (F_x, F_w, F_v) for i in range(min(F.shape[2:]))]
    samples = np.array(deltas).T - mean
    assert within_stat(samples, 0.0)
    assert within_stat(samples**2, variance) or law == "extremes" and np.ptp(samples**2) < 1e-15 + abs(low + high)
    correlation = np.corrcoef(samples.T) - np.eye(len(deltas))
    assert np.abs(correlation).max() < STAT / np.sqrt(len(samples))
    in_time = np.mean((F_x[:, 1:, 0, 0] - mean) * (F_x[:, :-1, 0, 0] - mean)) / variance
    assert abs(in_time) < STAT / np.sqrt(20 * 499)


def test_a_uniform_law_is_uniform():
    """Oracle: Kolmogorov-Smirnov of 20000 numbers; 1.95 / sqrt(n) is passed by chance once in 1000."""
    values = np.sort(Uncertainty("uniform", -0.5, 1.0).draw(generators(range(20)), 1000, ((1, 1),) * 3).F_v.ravel())
    distance = np.abs((values + 0.5) / 1.5 - (np.arange(len(values)) + 0.5) / len(values)).max()
    assert distance < 1.95 / np.sqrt(len(values))


def test_extremes_are_equally_likely():
    """Oracle: binomial, STAT standard errors."""
    values = Uncertainty("extremes", -0.5, 1.0).draw(generators(range(20)), 1000, ((1, 1),) * 3).F_x
    assert set(values.ravel()) == {-0.5, 1.0}
    assert abs((values == 1.0).mean() - 0.5) < STAT * 0.5 / np.sqrt(values.size)


def test_fixed_values():
    """Oracle: the numbers given; 1 where none is."""
    assert dict(Uncertainty("fixed").fixed) == {"x": 1.0, "w": 1.0, "v": 1.0}
    assert dict(Uncertainty("fixed", value=0.0).fixed) == {"x": 0.0, "w": 0.0, "v": 0.0}
    uncertainty = Uncertainty("fixed", value={"w": 0.0, "v": -1.0})
    for F, value, shape, name in zip(
        drawn({"law": "fixed", "value": {"w": 0.0, "v": -1.0}}), (1, 0, -1), SHAPES, NAMES, strict=True
    ):
        np.testing.assert_array_equal(F, np.broadcast_to(value * np.eye(*shape), F.shape))
        assert uncertainty.entry(name) == (value, 0.0)


@pytest.mark.parametrize(("law", "white"), [(law, law.get("per") != "run") for law in LAWS])
def test_which_laws_are_white(law, white):
    """Oracle: by definition; a fixed F is white with variance zero."""
    assert Uncertainty(**law).white == white


def test_what_is_not_given_is_filled_in():
    """Oracle: the defaults of the docstring."""
    usual = Uncertainty()
    assert (usual.law, usual.low, usual.high, usual.per) == ("uniform", -1.0, 1.0, "step")
    assert Uncertainty("extremes", high=0.5).bounds == (-1.0, 0.5)
    assert Uncertainty("greedy", against="m").radius == 1.0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"low": 1.0, "high": 0.5}, "low .1. must not exceed high .0.5."),
        ({"low": 2.0}, "must not exceed"),
        ({"value": 1.0}, "the law 'uniform' has no value; it takes low, high, per"),
        ({"law": "extremes", "radius": 1.0}, "has no radius"),
        ({"law": "fixed", "low": -1.0}, "'fixed' has no low; it takes value"),
        ({"law": "fixed", "per": "run"}, "has no per"),
        ({"law": "greedy"}, "against must name the method"),
        ({"law": "greedy", "against": "m", "high": 1.0}, "'greedy' has no high; it takes against, radius"),
        ({"against": "m"}, "has no against"),
    ],
)
def test_what_a_law_has_not_is_refused(wrong, message):
    """Oracle: words that name the law and what it takes."""
    with pytest.raises(ValueError, match=message):
        Uncertainty(**wrong)
